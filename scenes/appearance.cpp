#include "scenes/appearance.h"

#include <map>

#include "generator/core/error.h"
#include "generator/dataset/codecs.h"

namespace moomill {
namespace {

TexturePlacement placement_of(const TextureUse& use) {
  return {use.wrap_u, use.wrap_v, use.offset, use.scale, use.rotation};
}

// Adds textures to the appearance, each image decoded once per rig.
class TexturePool {
 public:
  TexturePool(Appearance& appearance, StageCounts& counts) : appearance_(appearance), counts_(counts) {}

  int add(const Species& species, const TextureUse& use) {
    if (use.image < 0) return -1;
    const auto key = std::pair(&species.rig, use.image);
    auto found = decoded_.find(key);
    if (found == decoded_.end()) {
      const EncodedImage& image = species.rig.images[use.image];
      found = decoded_.emplace(key, read_image8(image.bytes, species.rig.source + ": image " + image.name)).first;
      ++counts_.images;
    }
    return add(Texture{found->second, placement_of(use)});
  }
  int add(Texture texture) {
    for (std::size_t i = 0; i < appearance_.textures.size(); ++i) {
      const Texture& t = *appearance_.textures[i];
      if (t.placement == texture.placement && t.image.width == texture.image.width && t.image.data == texture.image.data)
        return static_cast<int>(i);
    }
    appearance_.textures.push_back(std::make_shared<Texture>(std::move(texture)));
    return static_cast<int>(appearance_.textures.size()) - 1;
  }

 private:
  Appearance& appearance_;
  StageCounts& counts_;
  std::map<std::pair<const Rig*, int>, Image8> decoded_;
};

std::vector<Coat> coats_of(const SceneSpec& scene, std::size_t animal) {
  const AnimalSpec& spec = scene.animals[animal];
  const auto folder = std::filesystem::path(scene.file).parent_path();
  std::vector<std::string> names;
  for (int index : scene.coat_indices)
    names.push_back(spec.coats.empty() ? "own" : spec.coats.size() == 1 ? spec.coats[0] : spec.coats[index]);
  std::vector<Coat> coats;
  for (const std::string& name : names) coats.push_back(read_coat(name, spec.species, folder));
  return coats;
}

// What the coats of one species share, made when it is first asked for.
class Baker {
 public:
  Baker(const Species& species, const std::string& name, int resolution)
      : species_(species), finish_(read_finish(name)), resolution_(resolution) {}

  Image8 coat(const ProceduralCoat& coat) {
    prepare();
    know_parts(*hide_, coat);
    return bake_coat(ready_coat(coat, *hide_), *hide_, texels_);
  }
  FinishMaps finish() {
    prepare();
    return bake_finish(finish_, *hide_, texels_);
  }
  int normal = -1, roughness = -1;  // the finish among the appearance's textures, once it is

 private:
  void prepare() {
    if (hide_) return;
    hide_ = make_hide(species_.rig.surface, species_.rig.part_names, finish_.hair);
    texels_ = map_texels(*hide_, resolution_);
  }
  const Species& species_;
  Finish finish_;
  int resolution_;
  std::optional<Hide> hide_;
  TexelMap texels_;
};

// The image of a coat in the rig's UV space, or nothing for one that wears the rig's own materials.
std::optional<Image8> image_of(const Coat& coat, const Species& species, Baker& baker, StageCounts& counts) {
  if (const auto* procedural = std::get_if<ProceduralCoat>(&coat.source)) {
    ++counts.coats;
    return baker.coat(*procedural);
  }
  if (const auto* file = std::get_if<ImageCoat>(&coat.source)) {
    if (species.rig.surface.uvs.empty())
      input_error("{}: the rig {} has no UVs, so it cannot wear an image; give it UVs or the coat \"own\"", file->file, species.rig.source);
    ++counts.images;
    return read_image8(std::filesystem::path(file->file));
  }
  return std::nullopt;
}

Paint constant_paint(const vec3& color, int coats) {
  Paint p;
  p.coats.assign(coats, {color, -1, false});
  return p;
}

}  // namespace

BuiltAppearance build_appearance(const SceneSpec& scene, const std::vector<const Species*>& species, bool with_light,
                                 StageCounts& counts) {
  BuiltAppearance built;
  built.appearance = std::make_shared<Appearance>();
  Appearance& a = *built.appearance;
  a.coat_count = with_light ? static_cast<int>(scene.coat_indices.size()) : 0;
  if (with_light && (a.coat_count < 1 || a.coat_count > 32))
    input_error("{}: {} coats at once; a run shades 1 to 32, so choose some with --coats", scene.file, a.coat_count);
  TexturePool pool(a, counts);
  std::map<const Species*, Baker> bakers;  // animals of a species share theirs

  for (std::size_t animal = 0; animal < species.size(); ++animal) {
    const Species& s = *species[animal];
    const bool has_uvs = !s.rig.surface.uvs.empty();
    std::vector<int> materials;

    // Coats that are images are one paint for all materials; a coat "own" wants one paint a material.
    std::vector<std::optional<Image8>> images;
    int shared_paint = -1;
    int finish_normal = -1, finish_roughness = -1;
    if (with_light) {
      const std::string& name = scene.animals[animal].species;
      Baker& baker = bakers.try_emplace(&s, s, name, scene.render.coat_resolution).first->second;
      // Whatever its coats: a coat must look the same alone and beside others.
      if (has_uvs && !find_finish(name).empty()) {
        if (baker.normal < 0) {
          FinishMaps maps = baker.finish();
          ++counts.finishes;
          const TexturePlacement clamped{Wrap::clamp, Wrap::clamp};
          baker.normal = pool.add(Texture{std::move(maps.normal), clamped});
          baker.roughness = pool.add(Texture{std::move(maps.roughness), clamped});
        }
        finish_normal = baker.normal;
        finish_roughness = baker.roughness;
      }
      for (const Coat& coat : coats_of(scene, animal)) {
        // Animals that wear one coat beside many of the first need not bake it again.
        const bool repeated = !images.empty() && scene.animals[animal].coats.size() <= 1;
        images.push_back(repeated ? images.front() : image_of(coat, s, baker, counts));
      }
      bool stackable = images[0].has_value();
      for (const auto& im : images)
        stackable = stackable && im && im->width == images[0]->width && im->height == images[0]->height && im->channels >= 3;
      if (stackable) {
        auto paint = std::make_shared<Paint>(constant_paint(vec3(1), a.coat_count));
        std::vector<const Image8*> pointers;
        for (const auto& im : images) pointers.push_back(&*im);
        paint->stack_placement.wrap_u = paint->stack_placement.wrap_v = Wrap::clamp;
        build_stack(*paint, pointers);
        shared_paint = static_cast<int>(a.paints.size());
        a.paints.push_back(std::move(paint));
        images.clear();
      }
    }
    std::vector<int> coat_textures;
    for (auto& im : images) {
      Texture t;
      t.placement.wrap_u = t.placement.wrap_v = Wrap::clamp;
      if (im) t.image = std::move(*im);
      coat_textures.push_back(t.image.empty() ? -1 : pool.add(std::move(t)));
    }

    for (const RigMaterial& m : s.rig.materials) {
      Material out;
      out.alpha = m.alpha;
      if (m.alpha_mask) {
        out.alpha_cutoff = m.alpha_cutoff;
        out.alpha_texture = has_uvs ? pool.add(s, m.base_texture) : -1;
      }
      if (with_light) {
        out.roughness = m.roughness;
        out.metallic = m.metallic;
        if (has_uvs) {
          out.metallic_roughness_texture = pool.add(s, m.metallic_roughness_texture);
          out.normal_texture = pool.add(s, m.normal_texture);
          out.normal_scale = m.normal_scale;
        }
        if (finish_normal >= 0) {
          out.roughness = 1;
          out.metallic = 0;
          out.metallic_roughness_texture = finish_roughness;
          out.normal_texture = finish_normal;
          out.normal_scale = 1;
        }
        out.paint = shared_paint;
        if (shared_paint < 0) {
          auto paint = std::make_shared<Paint>();
          for (int texture : coat_textures)
            paint->coats.push_back(texture >= 0 ? Paint::PerCoat{vec3(1), texture, false}
                                                : Paint::PerCoat{m.base_color, has_uvs ? pool.add(s, m.base_texture) : -1, true});
          out.paint = static_cast<int>(a.paints.size());
          a.paints.push_back(std::move(paint));
        }
      }
      materials.push_back(static_cast<int>(a.materials.size()));
      a.materials.push_back(out);
    }
    built.materials.push_back(std::move(materials));
  }

  if (scene.ground.present) {
    Material ground;
    if (with_light) {
      ground.paint = static_cast<int>(a.paints.size());
      a.paints.push_back(std::make_shared<Paint>(constant_paint(vec3(0.5f), a.coat_count)));
    }
    built.ground_material = static_cast<int>(a.materials.size());
    a.materials.push_back(ground);
  }
  return built;
}

}  // namespace moomill

#include "scenes/appearance.h"

#include <map>
#include <mutex>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/core/stage_times.h"
#include "generator/dataset/codecs.h"
#include "scenes/breed_file.h"

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

// What the coats of one species share, made when it is first asked for.
class Baker {
 public:
  Baker(const Species& species, const std::string& name, int resolution)
      : species_(species), finish_(read_finish(name)), resolution_(resolution) {}

  // All at once: what is learnt of the hide is learnt before any is baked.
  std::vector<std::optional<Image8>> bake(const std::vector<const ProceduralCoat*>& coats, const std::vector<Coat>& named) {
    std::vector<std::optional<Image8>> out(coats.size());
    bool any = false;
    for (const ProceduralCoat* coat : coats) {
      if (!coat) continue;
      any = true;
      prepare();
      know_parts(*hide_, *coat);
    }
    if (any)
      parallel_for(coats.size(), 1, [&](std::size_t i) {
        if (!coats[i]) return;
        const StageTimer timer("bake coat", named[i].name);
        out[i] = bake_coat(ready_coat(*coats[i], *hide_), *hide_, texels_);
      });
    return out;
  }
  FinishMaps finish() {
    prepare();
    const StageTimer timer("bake finish");
    return bake_finish(finish_, *hide_, texels_);
  }
  int normal = -1, roughness = -1;  // the finish among the appearance's textures, once it is

 private:
  void prepare() {
    if (hide_) return;
    const StageTimer timer("hide");
    hide_ = make_hide(species_.rig.surface, species_.rig.part_names, finish_.hair);
    texels_ = map_texels(*hide_, resolution_);
  }
  const Species& species_;
  Finish finish_;
  int resolution_;
  std::optional<Hide> hide_;
  TexelMap texels_;
};

Paint constant_paint(const vec3& color, int coats) {
  Paint p;
  p.coats.assign(coats, {color, -1, false});
  return p;
}

}  // namespace

BatchPlan plan_batches(const SceneSpec& scene) {
  // Light held by vertices takes 39 numbers a vertex and coat while it is gathered: batches stay small.
  const double most = scene.render.surface_light ? 32 : most_coats;
  const double memory = scene.render.memory_mb * 1e6, eighth = memory / 8;
  const double resolution = scene.render.coat_resolution, animals = static_cast<double>(scene.animals.size());
  const double baked = 3 * resolution * resolution * animals;
  const double picture = 4.0 * sizeof(float) * scene.cameras.width * scene.cameras.height;
  const double each = std::max(baked, picture / 2);
  if (each > eighth)
    input_error("{}: render.memory_mb = {:.0f} is too little for one coat of {} x {} texels and pictures of {} x {}; give it {:.0f}, or a smaller "
                "coat_resolution", scene.file, scene.render.memory_mb, resolution, resolution, scene.cameras.width, scene.cameras.height,
                std::ceil(8 * each / 1e6));
  BatchPlan plan;
  const double n = static_cast<double>(scene.coat_indices.size());
  plan.coats = static_cast<int>(std::min({most, std::floor(eighth / each), std::max(1.0, n)}));
  const double batches = std::ceil(n / plan.coats);
  plan.kept = static_cast<int>(std::clamp(std::floor(memory / 4 / (baked * plan.coats)), 1.0, std::max(1.0, batches)));
  plan.bytes = plan.coats * baked * (plan.kept + std::clamp(batches - plan.kept, 0.0, 2.0)) + 2 * plan.coats * picture;
  return plan;
}

struct Wardrobe::State {
  SceneSpec scene;
  std::vector<const Species*> species;
  StageCounts& counts;
  std::mutex mutex;
  std::vector<std::shared_ptr<Baker>> bakers;  // per animal; those of one species share theirs
  std::map<std::string, Breed> breeds;
  std::vector<std::vector<int>> own_textures;          // per animal, per rig material: its own base texture
  std::vector<std::shared_ptr<const Appearance>> kept;      // per batch
  std::vector<std::weak_ptr<const Appearance>> in_use;      // per batch
  std::size_t most_kept = 0;

  Coat coat(std::size_t animal, int index) {
    const AnimalSpec& spec = scene.animals[animal];
    const auto folder = std::filesystem::path(scene.file).parent_path();
    if (spec.coats.empty()) return read_coat("own", spec.species, folder);
    const std::size_t i = spec.coats.size() == 1 ? 0 : static_cast<std::size_t>(index);
    if (const Individual* one = spec.individual(i)) {
      auto found = breeds.find(one->breed);
      if (found == breeds.end())
        found = breeds.emplace(one->breed, read_breed(one->breed, find_species(spec.species, folder).stem().string(), folder)).first;
      return individual(found->second, one->seed, one->index);
    }
    return read_coat(spec.coats[i], spec.species, folder);
  }

  // The images of some coats in the rig's UV space, or nothing for one that wears the rig's own materials.
  std::vector<std::optional<Image8>> images_of(std::size_t animal, const std::vector<Coat>& coats) {
    const Species& s = *species[animal];
    std::vector<const ProceduralCoat*> procedural(coats.size(), nullptr);
    for (std::size_t i = 0; i < coats.size(); ++i)
      if ((procedural[i] = std::get_if<ProceduralCoat>(&coats[i].source))) ++counts.coats;
    std::vector<std::optional<Image8>> out = bakers[animal]->bake(procedural, coats);
    for (std::size_t i = 0; i < coats.size(); ++i) {
      const auto* file = std::get_if<ImageCoat>(&coats[i].source);
      if (!file) continue;
      if (s.rig.surface.uvs.empty())
        input_error("{}: the rig {} has no UVs, so it cannot wear an image; give it UVs or the coat \"own\"", file->file, s.rig.source);
      ++counts.images;
      out[i] = read_image8(std::filesystem::path(file->file));
    }
    return out;
  }

  std::vector<std::optional<Image8>> images_of_batch(std::size_t animal, const std::vector<int>& batch) {
    const bool one = scene.animals[animal].coats.size() <= 1;  // worn beside all coats of the first: baked once
    std::vector<Coat> coats;
    for (std::size_t i = 0; i < (one ? 1 : batch.size()); ++i) coats.push_back(coat(animal, batch[i]));
    std::vector<std::optional<Image8>> images = images_of(animal, coats);
    if (one) images.resize(batch.size(), std::optional<Image8>(images[0]));
    return images;
  }

  std::shared_ptr<const Appearance> make(const Appearance& bare, const std::vector<int>& batch,
                                         const std::vector<std::vector<int>>& materials, int ground_material);
};

std::shared_ptr<const Appearance> Wardrobe::State::make(const Appearance& bare, const std::vector<int>& batch,
                                                        const std::vector<std::vector<int>>& materials,
                                                        int ground_material) {
  auto dressed = std::make_shared<Appearance>(bare);
  Appearance& a = *dressed;
  a.coat_count = static_cast<int>(batch.size());
  for (std::size_t animal = 0; animal < species.size(); ++animal) {
    const Species& s = *species[animal];
    std::vector<std::optional<Image8>> images = images_of_batch(animal, batch);
    // Coats that are images are one paint for all materials; a coat "own" wants one paint a material.
    bool stackable = images[0].has_value();
    for (const auto& im : images)
      stackable = stackable && im && im->width == images[0]->width && im->height == images[0]->height && im->channels >= 3;
    if (stackable) {
      auto paint = std::make_shared<Paint>(constant_paint(vec3(1), a.coat_count));
      std::vector<const Image8*> pointers;
      for (const auto& im : images) pointers.push_back(&*im);
      paint->stack_placement.wrap_u = paint->stack_placement.wrap_v = Wrap::clamp;
      build_stack(*paint, pointers);
      for (const int m : materials[animal]) a.materials[m].paint = static_cast<int>(a.paints.size());
      a.paints.push_back(std::move(paint));
      continue;
    }
    std::vector<int> coat_textures;
    for (auto& im : images) {
      coat_textures.push_back(-1);
      if (!im) continue;
      auto t = std::make_shared<Texture>();
      t->placement.wrap_u = t->placement.wrap_v = Wrap::clamp;
      t->image = std::move(*im);
      coat_textures.back() = static_cast<int>(a.textures.size());
      a.textures.push_back(std::move(t));
    }
    for (std::size_t m = 0; m < s.rig.materials.size(); ++m) {
      auto paint = std::make_shared<Paint>();
      for (int texture : coat_textures)
        paint->coats.push_back(texture >= 0 ? Paint::PerCoat{vec3(1), texture, false}
                                            : Paint::PerCoat{s.rig.materials[m].base_color, own_textures[animal][m], true});
      a.materials[materials[animal][m]].paint = static_cast<int>(a.paints.size());
      a.paints.push_back(std::move(paint));
    }
  }
  if (ground_material >= 0) {
    a.materials[ground_material].paint = static_cast<int>(a.paints.size());
    a.paints.push_back(std::make_shared<Paint>(constant_paint(vec3(0.5f), a.coat_count)));
  }
  return dressed;
}

Wardrobe::~Wardrobe() = default;

Wardrobe::Wardrobe(const SceneSpec& scene, const std::vector<const Species*>& species, bool with_light,
                   StageCounts& counts)
    : state_(new State{scene, species, counts, {}, {}, {}, {}, {}, {}, 0}) {
  BatchPlan plan;
  if (with_light) plan = plan_batches(scene);  // too little memory is said before anything is baked
  auto bare = std::make_shared<Appearance>();
  TexturePool pool(*bare, counts);
  std::map<const Species*, std::shared_ptr<Baker>> by_species;
  for (std::size_t animal = 0; animal < species.size(); ++animal) {
    const Species& s = *species[animal];
    const AnimalSpec& spec = scene.animals[animal];
    const bool has_uvs = !s.rig.surface.uvs.empty();
    const bool wears_own = spec.coats.empty() || std::find(spec.coats.begin(), spec.coats.end(), "own") != spec.coats.end();
    std::shared_ptr<Baker>& baker = by_species[&s];
    if (!baker) baker = std::make_shared<Baker>(s, spec.species, scene.render.coat_resolution);
    // Whatever its coats: a coat must look the same alone and beside others.
    const bool finish = with_light && has_uvs && !find_finish(spec.species).empty();
    if (finish && baker->normal < 0) {
      FinishMaps maps = baker->finish();
      ++counts.finishes;
      const TexturePlacement clamped{Wrap::clamp, Wrap::clamp};
      baker->normal = pool.add(Texture{std::move(maps.normal), clamped});
      baker->roughness = pool.add(Texture{std::move(maps.roughness), clamped});
    }
    std::vector<int> materials;
    std::vector<int> own;
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
        if (finish) {
          out.roughness = 1;
          out.metallic = 0;
          out.metallic_roughness_texture = baker->roughness;
          out.normal_texture = baker->normal;
          out.normal_scale = 1;
        }
      }
      own.push_back(with_light && wears_own && has_uvs ? pool.add(s, m.base_texture) : -1);
      materials.push_back(static_cast<int>(bare->materials.size()));
      bare->materials.push_back(out);
    }
    materials_.push_back(std::move(materials));
    state_->own_textures.push_back(std::move(own));
    state_->bakers.push_back(baker);
  }
  if (scene.ground.present) {
    ground_material_ = static_cast<int>(bare->materials.size());
    bare->materials.push_back({});
  }
  bare_ = std::move(bare);
  if (!with_light) return;

  const std::size_t n = scene.coat_indices.size(), lanes = static_cast<std::size_t>(plan.coats);
  for (std::size_t first = 0; first < n; first += lanes)
    batches_.emplace_back(scene.coat_indices.begin() + first, scene.coat_indices.begin() + std::min(n, first + lanes));
  state_->kept.resize(batches_.size());
  state_->in_use.resize(batches_.size());
  state_->most_kept = static_cast<std::size_t>(plan.kept);
  // The first batch is made now, so that what is wrong with a coat is said before anything is rendered.
  dress(0);
}

std::shared_ptr<const Appearance> Wardrobe::dress(int b) const {
  State& s = *state_;
  std::lock_guard lock(s.mutex);
  if (s.kept[b]) return s.kept[b];
  if (auto alive = s.in_use[b].lock()) return alive;
  auto made = s.make(*bare_, batches_[b], materials_, ground_material_);
  if (static_cast<std::size_t>(b) < s.most_kept)
    s.kept[b] = made;
  else
    s.in_use[b] = made;
  return made;
}

}  // namespace moomill

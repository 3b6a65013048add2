#include "generator/render/labels.h"

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/core/stage_times.h"
#include "generator/render/sampler.h"

namespace moomill {
namespace {

// Interpolates a vertex attribute in double; barycentrics are exact to their float rounding.
template <class V>
auto interpolate(const std::vector<V>& attribute, const uvec3& t, double u, double v) {
  using D = std::conditional_t<std::is_same_v<V, vec2>, dvec2, dvec3>;
  return (1.0 - u - v) * D(attribute[t[0]]) + u * D(attribute[t[1]]) + v * D(attribute[t[2]]);
}

bool labelled(const Scene& scene, std::uint32_t instance, int only_animal) {
  if (instance == no_hit) return false;
  const int animal = scene.instances[instance].animal;
  return animal >= 0 && (only_animal < 0 || animal == only_animal);
}

// Writes one label of one hit.
void write_label(Map& map, std::size_t pixel, const Scene& scene, const FirstHits& hits) {
  const Instance& in = scene.instances[hits.instance[pixel]];
  const Surface& surface = *in.surface;
  const std::uint32_t triangle = hits.triangle[pixel];
  const uvec3 t = surface.triangles[triangle];
  const double u = hits.u[pixel], v = hits.v[pixel];
  switch (map.modality) {
    case Modality::silhouette: map.u.data[pixel] = 255; break;
    case Modality::depth: map.f.data[pixel] = hits.depth[pixel]; break;
    case Modality::nnopcs: {
      const dvec3 c = interpolate(surface.nnopcs, t, u, v);
      for (int k = 0; k < 3; ++k) map.f.data[3 * pixel + k] = static_cast<float>(c[k]);
      break;
    }
    case Modality::normal: {
      const dvec3 n = glm::normalize(interpolate(in.posed.normals, t, u, v));
      for (int k = 0; k < 3; ++k) map.f.data[3 * pixel + k] = static_cast<float>(std::isfinite(n[k]) ? n[k] : 0.0);
      break;
    }
    case Modality::uv: {
      const dvec2 c = surface.uvs.empty() ? dvec2(-1) : interpolate(surface.uvs, t, u, v);
      for (int k = 0; k < 2; ++k) map.f.data[2 * pixel + k] = static_cast<float>(c[k]);
      break;
    }
    case Modality::part: map.u.data[pixel] = 1u + surface.parts[triangle]; break;
    case Modality::instance: map.u.data[pixel] = 1u + in.animal; break;
    case Modality::triangle:
      map.u.data[pixel] = 1u + triangle;
      map.f.data[2 * pixel] = hits.u[pixel];
      map.f.data[2 * pixel + 1] = hits.v[pixel];
      break;
    default: check(false, "not a label modality");
  }
}

bool is_label(Modality m) {
  return m != Modality::rgb && m != Modality::coverage && m != Modality::keypoints && m != Modality::occlusion;
}

}  // namespace

void add_labels(View& view, const Scene& scene, const FirstHits& hits, const LabelRequest& request) {
  // An animal covers a tenth of a view: every modality walks these pixels, not all.
  std::vector<std::uint32_t> of_any, of_labelled;
  for (std::size_t p = 0; p < hits.instance.size(); ++p)
    if (labelled(scene, hits.instance[p], -1)) of_any.push_back(static_cast<std::uint32_t>(p));
  if (request.only_animal >= 0)
    for (std::uint32_t p : of_any)
      if (labelled(scene, hits.instance[p], request.only_animal)) of_labelled.push_back(p);
  for (const ModalityRow& r : modality_table()) {
    if (!request.modalities.has(r.id) || !is_label(r.id)) continue;
    const StageTimer timer("labels", r.name);
    Map map;
    map.modality = r.id;
    const auto background = static_cast<float>(r.background);
    const bool integers = r.storage == Storage::png8 || r.storage == Storage::png16 || r.storage == Storage::exr_ids;
    if (integers) map.u = ImageU32(hits.width, hits.height, 1);
    if (r.storage == Storage::exr_ids) map.f = ImageF(hits.width, hits.height, 2);
    if (r.storage == Storage::exr32) map.f = ImageF(hits.width, hits.height, r.channels, background);
    const bool every_animal = r.id == Modality::instance || request.only_animal < 0;
    for (std::uint32_t p : every_animal ? of_any : of_labelled) write_label(map, p, scene, hits);
    view.maps.push_back(std::move(map));
  }
}

ImageF trace_coverage(const Scene& scene, const Accel& accel, const Camera& camera, const FirstHits& hits, std::uint64_t stream) {
  ImageF coverage(camera.width, camera.height, 1);
  const PixelMask outline = outlines(scene, camera);
  constexpr int rays_per_pixel = 64;
  const dvec3 origin = camera.centre - scene.origin;
  parallel_for(camera.height, 4, [&](std::size_t row_index) {
    const int y = static_cast<int>(row_index);
    for (int x = 0; x < camera.width; ++x) {
      const std::size_t p = hits.index(x, y);
      if (!outline.get(x, y)) {
        coverage.data[p] = labelled(scene, hits.instance[p], -1) ? 1.0f : 0.0f;
        continue;
      }
      const PixelSampler sampler(stream, p);
      int covered = 0;
      for (int s = 0; s < rays_per_pixel; s += 8) {
        Ray8 rays;
        for (int i = 0; i < 8; ++i) {
          const vec2 xi = sampler.get(0, s + i);
          const dvec3 d = camera.direction(x + double(xi.x), y + double(xi.y));
          rays.ox[i] = static_cast<float>(origin.x), rays.oy[i] = static_cast<float>(origin.y), rays.oz[i] = static_cast<float>(origin.z);
          rays.dx[i] = static_cast<float>(d.x), rays.dy[i] = static_cast<float>(d.y), rays.dz[i] = static_cast<float>(d.z);
          rays.near[i] = 0;
          rays.far[i] = std::numeric_limits<float>::infinity();
          rays.active[i] = 1;
        }
        accel.intersect8(rays, true);
        for (int i = 0; i < 8; ++i) covered += labelled(scene, rays.instance[i], -1);
      }
      coverage.data[p] = static_cast<float>(covered) / rays_per_pixel;
    }
  });
  return coverage;
}

void add_occlusion(View& view, const Scene& scene, const Accel& accel, const Camera& camera, const FirstHits& hits) {
  const int animals = scene.animal_count;
  view.occlusion.assign(animals, OcclusionView{});
  for (int a = 0; a < animals; ++a) {
    OcclusionView& o = view.occlusion[a];
    o.occluded.assign(animals, 0);
    Map map;
    map.modality = Modality::occlusion;
    map.animal = a;
    map.u = ImageU32(hits.width, hits.height, 1);
    // Pixels where something else is in front: only there a second ray is needed.
    PixelMask behind(hits.width, hits.height);
    bool any = false;
    for (int y = 0; y < hits.height; ++y)
      for (int x = 0; x < hits.width; ++x) {
        const std::size_t p = hits.index(x, y);
        if (hits.instance[p] == no_hit) continue;
        if (scene.instances[hits.instance[p]].animal == a) {
          map.u.data[p] = 255;
          ++o.visible_pixels;
        } else {
          behind.set_span(y, x, x);
          any = true;
        }
      }
    o.whole_pixels = o.visible_pixels;
    if (any) {
      const FirstHits alone = trace_first_hits(scene, accel, camera, behind, animal_mask(a));
      for (std::size_t p = 0; p < alone.instance.size(); ++p) {
        if (alone.instance[p] == no_hit) continue;
        map.u.data[p] = 255;
        ++o.whole_pixels;
        const int other = scene.instances[hits.instance[p]].animal;
        if (other >= 0) ++o.occluded[other];
      }
    }
    o.hidden_fraction = o.whole_pixels ? 1.0 - static_cast<double>(o.visible_pixels) / o.whole_pixels : 0.0;
    view.maps.push_back(std::move(map));
  }
}

KeypointView trace_keypoint(const Scene& scene, const Accel& accel, const Camera& camera, int animal, const KeypointQuery& q) {
  KeypointView k;
  const dvec3 p = camera.to_camera(q.position);
  k.depth = p.z;
  if (!(p.z > 0)) return k;  // also not-a-number
  k.pixel = camera.project(p);
  if (!(k.pixel.x >= 0 && k.pixel.y >= 0 && k.pixel.x < camera.width && k.pixel.y < camera.height)) return k;
  const dvec3 direction = camera.direction(k.pixel.x, k.pixel.y);
  const PreciseHit hit = trace_precise(scene, accel, camera, direction);
  k.visibility = Visibility::visible;
  k.cause = HiddenBy::nothing;
  if (!hit.valid()) return k;
  k.margin = (p.z - hit.t) * glm::length(direction);  // metres along the ray
  const int other = scene.instances[hit.instance].animal;
  // A point on the very surface must not be hidden by the rounding of world coordinates and of the ray.
  const double size = std::max({1.0, p.z, glm::length(q.position), glm::length(camera.centre)});
  if (k.margin <= 1e-12 * size * glm::length(direction)) return k;
  if (other == animal && k.margin <= q.tolerance) return k;
  k.visibility = Visibility::hidden;
  k.cause = other == animal ? HiddenBy::self : other >= 0 ? HiddenBy::other_animal : HiddenBy::scenery;
  if (k.cause == HiddenBy::other_animal) k.occluder = other;
  return k;
}

}  // namespace moomill

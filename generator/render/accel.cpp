#include "generator/render/accel.h"

#include <embree3/rtcore.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <atomic>
#include <cstddef>

#include "generator/core/error.h"

namespace moomill {
namespace {

std::atomic<std::uint64_t> builds{0};

[[noreturn]] void throw_embree(RTCError code, const char* text) {
  if (code == RTC_ERROR_OUT_OF_MEMORY) run_error("Embree ran out of memory; use a smaller mesh or fewer threads");
  run_error("Embree failed with error {}: {}", static_cast<int>(code), text ? text : "no description");
}

// One device for the process. Its option threads=1 would hold all of oneTBB to one thread, not just builds.
RTCDevice device() {
  static RTCDevice shared = [] {
    RTCDevice d = rtcNewDevice("isa=avx2");
    if (!d) throw_embree(rtcGetDeviceError(nullptr), "no device (the processor must have AVX2)");
    if (!rtcGetDeviceProperty(d, RTC_DEVICE_PROPERTY_RAY_MASK_SUPPORTED) ||
        !rtcGetDeviceProperty(d, RTC_DEVICE_PROPERTY_FILTER_FUNCTION_SUPPORTED))
      throw_embree(RTC_ERROR_UNSUPPORTED_CPU, "this build of Embree lacks ray masks or filter functions");
    return d;
  }();
  return shared;
}

void check_device(const char* doing) {
  if (const RTCError e = rtcGetDeviceError(device()); e != RTC_ERROR_NONE) throw_embree(e, doing);
}

// rtcCommitScene builds in the arena of its caller; one slot makes the order of triangles, and with it every tie, the
// same on any machine.
void commit_on_one_thread(RTCScene scene) {
  tbb::task_arena one(1);
  one.execute([&] { rtcCommitScene(scene); });
}

// What the alpha filter of a geometry needs.
struct FilterData {
  const Scene* scene;
  const Instance* instance;
};

bool is_cut_out(const FilterData& f, std::uint32_t triangle, float u, float v) {
  const Surface& s = *f.instance->surface;
  const Material& m = f.scene->material(*f.instance, triangle);
  if (m.alpha_cutoff < 0) return false;
  float alpha = m.alpha;
  if (m.alpha_texture >= 0 && !s.uvs.empty()) {
    const uvec3 t = s.triangles[triangle];
    const vec2 uv = (1 - u - v) * s.uvs[t[0]] + u * s.uvs[t[1]] + v * s.uvs[t[2]];
    const Texture& texture = *f.scene->appearance->textures[m.alpha_texture];
    if (texture.image.channels == 2 || texture.image.channels == 4)
      alpha *= texture_value(texture, uv, texture.image.channels - 1);
  }
  return alpha < m.alpha_cutoff;
}

void alpha_filter(const RTCFilterFunctionNArguments* args) {
  const auto& f = *static_cast<const FilterData*>(args->geometryUserPtr);
  for (unsigned i = 0; i < args->N; ++i)
    if (args->valid[i] == -1 && is_cut_out(f, RTCHitN_primID(args->hit, args->N, i), RTCHitN_u(args->hit, args->N, i),
                                           RTCHitN_v(args->hit, args->N, i)))
      args->valid[i] = 0;
}

}  // namespace

struct Accel::State {
  const Scene* scene;
  BuildKind kind;
  RTCScene embree = nullptr;
  std::vector<RTCGeometry> geometries;
  std::vector<FilterData> filters;
  Box box_of_all, box_of_animals;
  void measure() {
    box_of_all = scene->bounds(false);
    box_of_animals = scene->bounds(true);
  }
  ~State() {
    for (RTCGeometry g : geometries) rtcReleaseGeometry(g);
    if (embree) rtcReleaseScene(embree);
  }
  void copy_positions(std::size_t i) {
    const auto& p = scene->instances[i].posed.positions;
    void* to = rtcGetGeometryBufferData(geometries[i], RTC_BUFFER_TYPE_VERTEX, 0);
    std::copy(p.begin(), p.end(), static_cast<vec3*>(to));  // of nothing, too, where memcpy wants no null
  }
};

Accel::Accel(const Scene& scene, BuildKind kind) : state_(std::make_unique<State>()) {
  State& s = *state_;
  s.scene = &scene;
  s.kind = kind;
  s.embree = rtcNewScene(device());
  check_device("a new scene");
  rtcSetSceneFlags(s.embree, kind == BuildKind::refit ? RTC_SCENE_FLAG_ROBUST | RTC_SCENE_FLAG_DYNAMIC : RTC_SCENE_FLAG_ROBUST);
  rtcSetSceneBuildQuality(s.embree, RTC_BUILD_QUALITY_MEDIUM);
  s.filters.resize(scene.instances.size());
  for (std::size_t i = 0; i < scene.instances.size(); ++i) {
    const Instance& instance = scene.instances[i];
    const Surface& surface = *instance.surface;
    check(instance.posed.positions.size() == surface.rest.size(), "an instance has another number of vertices than its surface");
    RTCGeometry g = rtcNewGeometry(device(), RTC_GEOMETRY_TYPE_TRIANGLE);
    s.geometries.push_back(g);
    rtcSetGeometryBuildQuality(g, kind == BuildKind::refit ? RTC_BUILD_QUALITY_REFIT : RTC_BUILD_QUALITY_MEDIUM);
    rtcSetNewGeometryBuffer(g, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, sizeof(vec3), instance.posed.positions.size());
    void* indices = rtcSetNewGeometryBuffer(g, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, sizeof(uvec3), surface.triangles.size());
    check_device("geometry buffers");
    std::copy(surface.triangles.begin(), surface.triangles.end(), static_cast<uvec3*>(indices));
    s.copy_positions(i);
    rtcSetGeometryMask(g, animal_mask(instance.animal));
    s.filters[i] = {&scene, &instance};
    if (scene.cut_out(instance)) {
      rtcSetGeometryUserData(g, &s.filters[i]);
      rtcSetGeometryIntersectFilterFunction(g, alpha_filter);
      rtcSetGeometryOccludedFilterFunction(g, alpha_filter);
    }
    rtcCommitGeometry(g);
    rtcAttachGeometryByID(s.embree, g, static_cast<unsigned>(i));
  }
  commit_on_one_thread(s.embree);
  check_device("building the hierarchy");
  s.measure();
  ++builds;
}

Accel::~Accel() = default;

void Accel::update() {
  State& s = *state_;
  for (std::size_t i = 0; i < s.geometries.size(); ++i) {
    s.copy_positions(i);
    rtcUpdateGeometryBuffer(s.geometries[i], RTC_BUFFER_TYPE_VERTEX, 0);
    rtcCommitGeometry(s.geometries[i]);
  }
  commit_on_one_thread(s.embree);
  check_device("updating the hierarchy");
  s.measure();
  ++builds;
}

SurfaceHit Accel::intersect(const Ray& ray, std::uint32_t mask) const {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  RTCRayHit r;
  r.ray = {ray.origin.x, ray.origin.y, ray.origin.z, ray.near, ray.direction.x, ray.direction.y, ray.direction.z, 0, ray.far, mask, 0, 0};
  r.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  rtcIntersect1(state_->embree, &context, &r);
  SurfaceHit hit;
  if (r.hit.geomID != RTC_INVALID_GEOMETRY_ID) hit = {r.hit.geomID, r.hit.primID, r.hit.u, r.hit.v, r.ray.tfar};
  return hit;
}

bool Accel::occluded(const Ray& ray, std::uint32_t mask) const {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  RTCRay r{ray.origin.x, ray.origin.y, ray.origin.z, ray.near, ray.direction.x, ray.direction.y, ray.direction.z, 0, ray.far, mask, 0, 0};
  rtcOccluded1(state_->embree, &context, &r);
  return r.tfar < 0;
}

// Ray8 is RTCRayHit8 with `active` behind it.
static_assert(offsetof(Ray8, near) == offsetof(RTCRayHit8, ray.tnear) && offsetof(Ray8, time) == offsetof(RTCRayHit8, ray.time) &&
              offsetof(Ray8, far) == offsetof(RTCRayHit8, ray.tfar) && offsetof(Ray8, mask) == offsetof(RTCRayHit8, ray.mask) &&
              offsetof(Ray8, id) == offsetof(RTCRayHit8, ray.id) && offsetof(Ray8, flags) == offsetof(RTCRayHit8, ray.flags) &&
              offsetof(Ray8, normal_x) == offsetof(RTCRayHit8, hit.Ng_x) && offsetof(Ray8, u) == offsetof(RTCRayHit8, hit.u) &&
              offsetof(Ray8, triangle) == offsetof(RTCRayHit8, hit.primID) &&
              offsetof(Ray8, instance) == offsetof(RTCRayHit8, hit.geomID) &&
              offsetof(Ray8, parent) == offsetof(RTCRayHit8, hit.instID) && offsetof(Ray8, active) == sizeof(RTCRayHit8) &&
              alignof(Ray8) == alignof(RTCRayHit8) && no_hit == RTC_INVALID_GEOMETRY_ID);

void Accel::intersect8(Ray8& rays, bool coherent, std::uint32_t mask) const {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = coherent ? RTC_INTERSECT_CONTEXT_FLAG_COHERENT : RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
  alignas(32) std::array<int, 8> valid;
  for (int i = 0; i < 8; ++i) valid[i] = rays.active[i] ? -1 : 0;
  rays.time.fill(0);
  rays.mask.fill(mask);
  rays.id.fill(0);
  rays.flags.fill(0);
  // What Embree leaves alone where a ray is off or meets nothing.
  rays.u.fill(0);
  rays.v.fill(0);
  rays.triangle.fill(no_hit);
  rays.instance.fill(no_hit);
  rays.parent.fill(no_hit);
  rtcIntersect8(valid.data(), state_->embree, &context, reinterpret_cast<RTCRayHit8*>(&rays));
}

void Accel::occluded8(Ray8& rays, bool coherent, std::uint32_t mask) const {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = coherent ? RTC_INTERSECT_CONTEXT_FLAG_COHERENT : RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
  alignas(32) RTCRay8 r;
  alignas(32) int valid[8];
  for (int i = 0; i < 8; ++i) {
    valid[i] = rays.active[i] ? -1 : 0;
    r.org_x[i] = rays.ox[i], r.org_y[i] = rays.oy[i], r.org_z[i] = rays.oz[i];
    r.dir_x[i] = rays.dx[i], r.dir_y[i] = rays.dy[i], r.dir_z[i] = rays.dz[i];
    r.tnear[i] = rays.near[i], r.tfar[i] = rays.far[i];
    r.time[i] = 0;
    r.mask[i] = mask;
    r.id[i] = 0;
    r.flags[i] = 0;
  }
  rtcOccluded8(valid, state_->embree, &context, &r);
  for (int i = 0; i < 8; ++i) rays.instance[i] = valid[i] && r.tfar[i] < 0 ? 0 : no_hit;
}

const Box& Accel::bounds(bool animals_only) const { return animals_only ? state_->box_of_animals : state_->box_of_all; }

std::uint64_t Accel::build_count() { return builds; }

}  // namespace moomill

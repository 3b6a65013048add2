#pragma once
// Which pixels can meet an animal, and what the ray through each pixel centre meets first, to double precision.
#include <cstdint>
#include <memory>
#include <vector>

#include "generator/render/accel.h"
#include "generator/render/camera.h"
#include "generator/render/scene.h"

namespace moomill {

// One bit per pixel.
struct PixelMask {
  int width = 0, height = 0, words = 0;  // 64-bit words per row
  std::vector<std::uint64_t> bits;
  PixelMask() = default;
  PixelMask(int w, int h) : width(w), height(h), words((w + 63) / 64), bits(static_cast<std::size_t>(words) * h) {}
  bool get(int x, int y) const { return bits[static_cast<std::size_t>(y) * words + x / 64] >> (x % 64) & 1u; }
  void set_span(int y, int x0, int x1);  // [x0, x1], clipped to the image
  void fill();
  std::uint64_t count() const;
};

// Pixels whose footprint (a square of `radius` pixels around the centre) may touch a triangle of the scene's animals.
// Conservative: projects every triangle and widens it; anything not safely in front of the camera marks all pixels.
PixelMask footprint(const Scene& scene, const Camera& camera, double radius);

// Pixels that an outline may cross: edges with one triangle, or between a front and a back face, widened by half a
// pixel. Outside it, a pixel is covered wholly or not at all.
PixelMask outlines(const Scene& scene, const Camera& camera);

// A vector that leaves its new elements unset: clearing five maps of a view, 16 MB, would cost a tenth of what tracing them does.
template <class T>
struct Unset : std::allocator<T> {
  template <class U>
  struct rebind {
    using other = Unset<U>;
  };
  template <class U>
  void construct(U* p) noexcept { ::new (static_cast<void*>(p)) U; }
  template <class U, class... Arguments>
  void construct(U* p, Arguments&&... arguments) { ::new (static_cast<void*>(p)) U(std::forward<Arguments>(arguments)...); }
};
template <class T>
using PixelVector = std::vector<T, Unset<T>>;

// Per pixel; where nothing is met, instance is no_hit and depth 0. Triangle and barycentrics mean something only where there is a hit;
// outside the mask that was traced they are not even set.
struct FirstHits {
  int width = 0, height = 0;
  PixelVector<std::uint32_t> instance, triangle;
  PixelVector<float> u, v;    // barycentrics of the second and third vertex, rounded from double
  PixelVector<float> depth;   // metres, camera z, rounded from double
  std::uint64_t rays = 0;     // traced
  std::uint64_t resolved = 0; // near an edge, where Embree's float had chosen a neighbour, or at a vertex
  FirstHits() = default;
  FirstHits(int w, int h);  // pixels are not set yet
  std::size_t index(int x, int y) const { return static_cast<std::size_t>(y) * width + x; }
};

// Embree finds the triangle; the hit itself is the intersection of the double-precision ray with the float vertices.
// Where that lies outside the triangle found, or the pixel's centre is a vertex, rays beside it name candidates and the
// nearest true hit is taken.
FirstHits trace_first_hits(const Scene& scene, const Accel& accel, const Camera& camera, const PixelMask& mask,
                           std::uint32_t ray_mask = everything_mask);

// A single ray from the camera centre along `direction` (camera z of 1), refined alike. t is camera z in metres.
struct PreciseHit {
  std::uint32_t instance = no_hit, triangle = no_hit;
  double u = 0, v = 0, t = 0;
  bool valid() const { return instance != no_hit; }
};
PreciseHit trace_precise(const Scene& scene, const Accel& accel, const Camera& camera, const dvec3& direction,
                         std::uint32_t ray_mask = everything_mask);

// Ray (origin relative to the vertices) against a triangle in double (Moeller & Trumbore 1997). False when it is
// missed by more than `slack` in barycentrics, or parallel.
bool intersect_triangle(const dvec3& origin, const dvec3& direction, const vec3& p0, const vec3& p1, const vec3& p2,
                        double slack, double& t, double& u, double& v);

// Whether a camera stands inside a closed animal; then no view of it makes sense.
bool camera_is_inside(const Scene& scene, const Accel& accel, const Camera& camera);

}  // namespace moomill

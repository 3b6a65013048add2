#pragma once
// The boundary to Embree; accel.cpp is the one file that includes it. Robust mode, one instruction set (avx2), built
// by one thread, so that the order of triangles, and with it every tie, is the same on any number of threads.
#include <array>
#include <cstdint>
#include <limits>
#include <memory>

#include "generator/render/scene.h"

namespace moomill {

inline constexpr std::uint32_t no_hit = 0xffffffffu;
inline constexpr std::uint32_t everything_mask = 0xffffffffu;
// Ray mask of one animal (masks of animals beyond 30 would collide; the loader refuses so many).
inline constexpr int max_animals = 30;
inline std::uint32_t animal_mask(int animal) { return animal < 0 ? 1u << 31 : 1u << animal; }

struct Ray {
  vec3 origin{0};
  float near = 0;
  vec3 direction{0, 0, 1};
  float far = std::numeric_limits<float>::infinity();
};

struct SurfaceHit {
  std::uint32_t instance = no_hit, triangle = no_hit;
  float u = 0, v = 0, t = 0;  // barycentrics of the second and third vertex; distance in lengths of the direction
  bool valid() const { return instance != no_hit; }
};

// Eight rays side by side, laid out as Embree wants them, so that nothing is copied. Set origins, directions, near, far and
// active (1 or 0); filled in: far (the distance), u, v, instance, triangle. The rest is between accel.cpp and Embree.
struct alignas(32) Ray8 {
  std::array<float, 8> ox, oy, oz, near, dx, dy, dz, time, far;
  std::array<std::uint32_t, 8> mask, id, flags;
  std::array<float, 8> normal_x, normal_y, normal_z, u, v;
  std::array<std::uint32_t, 8> triangle, instance, parent;
  std::array<std::int32_t, 8> active;
  void set(int i, const Ray& r, bool on) {
    ox[i] = r.origin.x, oy[i] = r.origin.y, oz[i] = r.origin.z;
    dx[i] = r.direction.x, dy[i] = r.direction.y, dz[i] = r.direction.z;
    near[i] = r.near, far[i] = r.far;
    active[i] = on;
  }
};

enum class BuildKind : std::uint8_t {
  rebuild,  // a new hierarchy per pose
  refit,    // topology of the first pose, boxes of this one
};

class Accel {
 public:
  // The scene must outlive it and keep its vertices in place until the next update().
  explicit Accel(const Scene& scene, BuildKind kind = BuildKind::rebuild);
  ~Accel();
  Accel(const Accel&) = delete;
  Accel& operator=(const Accel&) = delete;

  void update();  // after the scene's positions changed (same topology)

  SurfaceHit intersect(const Ray& ray, std::uint32_t mask = everything_mask) const;
  bool occluded(const Ray& ray, std::uint32_t mask = everything_mask) const;
  // Nearest hits of up to eight rays; `far` becomes the distance. coherent: a hint that they are much alike.
  void intersect8(Ray8& rays, bool coherent, std::uint32_t mask = everything_mask) const;

  // Whether the rays meet anything: `instance` becomes no_hit where they do not, any other number where they do.
  void occluded8(Ray8& rays, bool coherent, std::uint32_t mask = everything_mask) const;

  const Box& bounds(bool animals_only) const;  // of the scene when built, relative to its origin

  static std::uint64_t build_count();  // hierarchies built in this process; tests of what is left out read it
 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace moomill

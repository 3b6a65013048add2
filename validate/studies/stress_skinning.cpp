// Stress cases of skinning: bones and weights at the ends of what a rig may hold, against plain sums in long double.
#include <glm/gtc/matrix_inverse.hpp>
#include <glm/gtc/matrix_transform.hpp>

#include "generator/core/error.h"
#include "generator/core/random.h"
#include "rigs/pose.h"
#include "validate/studies/stress.h"
#include "validate/studies/stress_scenes.h"

namespace moomill {
namespace {

using L = long double;
using LVec = glm::vec<3, L>;
using LMat = glm::mat<4, 4, L>;

double random_unit(std::uint64_t a, std::uint64_t b) {
  return to_unit(hash_identity({0x736b696e, a, b}));
}

// A tube along z from 0 to 2 m of radius 0.2 m on two joints at 0 and 1 m; weights blend from 0.5 to 1.5 m.
Rig tube(int rings = 21, int sides = 16) {
  Rig rig;
  rig.source = "tube";
  rig.nodes = {{.name = "lower"}, {.name = "upper", .parent = 0, .translation = {0, 0, 1}}};
  rig.bones = {{0, dmat4(1.0)}, {1, glm::inverse(compose({.translation = {0, 0, 1}}))}};
  rig.influence_begin = {0};
  for (int r = 0; r < rings; ++r)
    for (int s = 0; s < sides; ++s) {
      const double z = 2.0 * r / (rings - 1), a = 2 * pi * s / sides;
      rig.surface.rest.push_back(vec3(0.2 * std::cos(a), 0.2 * std::sin(a), z));
      rig.surface.normals.push_back(vec3(std::cos(a), std::sin(a), 0));
      const float w = static_cast<float>(std::clamp(z - 0.5, 0.0, 1.0));
      if (w < 1) rig.influences.push_back({0, 1 - w});
      if (w > 0) rig.influences.push_back({1, w});
      rig.influence_begin.push_back(static_cast<std::uint32_t>(rig.influences.size()));
      if (r == 0) continue;
      const auto at = [&](int ring, int side) { return static_cast<std::uint32_t>(ring * sides + side % sides); };
      rig.surface.triangles.push_back({at(r - 1, s), at(r - 1, s + 1), at(r, s + 1)});
      rig.surface.triangles.push_back({at(r - 1, s), at(r, s + 1), at(r, s)});
    }
  finish_rig(rig);
  return rig;
}

Pose with_upper(const Rig& rig, const LocalTransform& upper) {
  Pose pose = bind_pose(rig);
  pose.local[1] = upper;
  return pose;
}
LocalTransform upper(const dquat& rotation, const dvec3& scale = dvec3(1)) {
  return {{0, 0, 1}, rotation, scale};
}
dquat turn(const dvec3& axis, double angle_deg) {
  return glm::angleAxis(angle_deg * degrees, glm::normalize(axis));
}

PosedSurface skinned(const Rig& rig, const Pose& pose, SkinningMethod method, const dvec3& origin = dvec3(0)) {
  return skin(rig, bone_matrices(rig, world_transforms(rig, pose)), pose.morph_weights, method, origin);
}

// Node to world in long double, each local transform by Rodrigues' formula rather than by a library.
std::vector<LMat> plain_world(const Rig& rig, const Pose& pose) {
  std::vector<LMat> world;
  for (std::size_t i = 0; i < rig.nodes.size(); ++i) {
    const Node& n = rig.nodes[i];
    const LocalTransform t = pose.local[i] ? *pose.local[i] : LocalTransform{n.translation, n.rotation, n.scale};
    const L w = t.rotation.w;
    const LVec v(t.rotation.x, t.rotation.y, t.rotation.z);
    LMat m(1);
    for (int k = 0; k < 3; ++k) {
      LVec e(0);
      e[k] = 1;
      e += L(2) * glm::cross(v, glm::cross(v, e) + w * e);
      m[k] = glm::vec<4, L>(e * L(t.scale[k]), 0);
    }
    m[3] = glm::vec<4, L>(LVec(t.translation), 1);
    world.push_back((n.parent < 0 ? LMat(pose.placement) : world[n.parent]) * m);
  }
  return world;
}

std::vector<LVec> plain_linear(const Rig& rig, const Pose& pose) {
  const std::vector<LMat> world = plain_world(rig, pose);
  std::vector<LVec> out;
  for (std::size_t v = 0; v < rig.surface.rest.size(); ++v) {
    glm::vec<4, L> sum(0);
    L weights = 0;
    for (std::uint32_t i = rig.influence_begin[v]; i < rig.influence_begin[v + 1]; ++i) {
      const Bone& bone = rig.bones[rig.influences[i].bone];
      sum += L(rig.influences[i].weight) *
             (world[bone.node] * (LMat(bone.inverse_bind) * glm::vec<4, L>(LVec(rig.surface.rest[v]), 1)));
      weights += rig.influences[i].weight;
    }
    out.push_back(LVec(sum) / weights);
  }
  return out;
}

// Kavan's dual quaternions as a rotation about a screw: rotations and translations of rigid bones, blended, in long
// double.
std::vector<LVec> plain_dual(const Rig& rig, const std::vector<dquat>& turns, const std::vector<dvec3>& shifts) {
  struct Q {
    L w;
    LVec v;
  };
  const auto product = [](const Q& a, const Q& b) {
    return Q{a.w * b.w - glm::dot(a.v, b.v), a.w * b.v + b.w * a.v + glm::cross(a.v, b.v)};
  };
  std::vector<LVec> out;
  for (std::size_t v = 0; v < rig.surface.rest.size(); ++v) {
    std::uint32_t pivot = rig.influence_begin[v];
    for (std::uint32_t i = pivot; i < rig.influence_begin[v + 1]; ++i)
      if (rig.influences[i].weight > rig.influences[pivot].weight) pivot = i;
    const dquat& reference = turns[rig.influences[pivot].bone];
    Q real{0, LVec(0)}, dual{0, LVec(0)};
    for (std::uint32_t i = rig.influence_begin[v]; i < rig.influence_begin[v + 1]; ++i) {
      const dquat& q = turns[rig.influences[i].bone];
      const L weight = rig.influences[i].weight * (glm::dot(q, reference) < 0 ? L(-1) : L(1));
      const Q r{L(q.w), LVec(q.x, q.y, q.z)}, d = product({0, L(0.5) * LVec(shifts[rig.influences[i].bone])}, r);
      real = {real.w + weight * r.w, real.v + weight * r.v};
      dual = {dual.w + weight * d.w, dual.v + weight * d.v};
    }
    const L squared = real.w * real.w + glm::dot(real.v, real.v);
    const LVec p(rig.surface.rest[v]);
    const Q turned = product(product(real, {0, p}), {real.w, -real.v}), moved = product(dual, {real.w, -real.v});
    out.push_back((turned.v + L(2) * moved.v) / squared);
  }
  return out;
}

// Largest distance, in metres, plus 1 for every normal that is not of length 1 to float rounding.
double distance(const PosedSurface& posed, const std::vector<LVec>& truth) {
  double worst = 0, bad = 0;
  for (std::size_t v = 0; v < truth.size(); ++v) {
    const LVec difference = LVec(posed.positions[v]) - truth[v] + LVec(posed.origin);
    const double d = static_cast<double>(std::sqrt(glm::dot(difference, difference)));
    if (!std::isfinite(d)) return std::numeric_limits<double>::infinity();
    worst = std::max(worst, d);
    bad += !(std::abs(glm::length(dvec3(posed.normals[v])) - 1) < 1e-6);
  }
  return bad > 0 ? bad : worst;
}

// A turn of the upper bone in steps, both methods, with q and with -q.
double sweep(const dvec3& axis, SkinningMethod method) {
  const Rig rig = tube();
  double worst = 0;
  for (int step = 0; step <= 48; ++step)
    for (const double sign : {1.0, -1.0}) {
      const dquat q = sign * turn(axis, 15.0 * step);
      // Exactly half a turn: both ways round are as short, and the sign of a rounding decides. That case is one of its
      // own.
      if (method == SkinningMethod::dual_quaternion && step % 24 == 12) continue;
      const Pose pose = with_upper(rig, upper(q));
      const PosedSurface posed = skinned(rig, pose, method);
      worst = std::max(worst, distance(posed, method == SkinningMethod::linear_blend
                                                  ? plain_linear(rig, pose)
                                                  : plain_dual(rig, {dquat(1, 0, 0, 0), q},
                                                               {dvec3(0), dvec3(0, 0, 1) - q * dvec3(0, 0, 1)})));
    }
  return worst;
}

// Keys of a clip that are the same rotation with opposite signs, and nearly so: the joint must stand still between
// them.
double antipodal_keys(const StressOptions&) {
  const Rig rig = tube(3, 3);
  double worst = 0;
  for (int i = 0; i < 200; ++i) {
    const dquat q = glm::normalize(
        dquat(random_unit(i, 0) - 0.5, random_unit(i, 1) - 0.5, random_unit(i, 2) - 0.5, random_unit(i, 3) - 0.5));
    for (const double off : {0.0, 1e-16, 1e-12, 1e-9}) {
      const dquat other = glm::normalize(-q + dquat(0, off, 0, 0));
      Clip clip{.name = "still", .duration = 1};
      clip.channels.push_back({.node = 1,
                               .path = ChannelPath::rotation,
                               .times = {0, 1},
                               .values = {q.x, q.y, q.z, q.w, other.x, other.y, other.z, other.w}});
      for (const double time : {0.0, 1e-9, 0.3, 0.5, 1 - 1e-9, 1.0}) {
        const dquat now = sample_clip(rig, clip, time).local[1]->rotation;
        worst = std::max(worst, std::abs(std::abs(glm::dot(now, q)) - 1) - off);
        if (!std::isfinite(glm::dot(now, now))) return 1;
      }
    }
  }
  return worst;
}

// Linear blending by half a turn: a ring of weight w shrinks to |1 - 2 w| of its radius, to a point in the middle.
double half_twist_linear(const StressOptions&) {
  const Rig rig = tube();
  const Pose pose = with_upper(rig, upper(dquat(0, 0, 0, 1)));
  const PosedSurface posed = skinned(rig, pose, SkinningMethod::linear_blend);
  double worst = distance(posed, plain_linear(rig, pose));
  for (std::size_t v = 0; v < posed.positions.size(); ++v) {
    const double w = std::clamp(double(rig.surface.rest[v].z) - 0.5, 0.0, 1.0);
    worst = std::max(worst, std::abs(std::hypot(double(posed.positions[v].x), double(posed.positions[v].y)) -
                                     0.2 * std::abs(1 - 2 * w)));
  }
  return worst;
}

// Dual quaternions by half a turn, and a hair less and more: every ring keeps its radius and height.
double half_twist_dual(const StressOptions&) {
  const Rig rig = tube();
  double worst = 0;
  for (const double angle : {180.0, 180 - 1e-9, 180 + 1e-9, 540.0, -180.0}) {
    const PosedSurface posed =
        skinned(rig, with_upper(rig, upper(turn({0, 0, 1}, angle))), SkinningMethod::dual_quaternion);
    for (std::size_t v = 0; v < posed.positions.size(); ++v) {
      const vec3 &p = posed.positions[v], &r = rig.surface.rest[v];
      worst = std::max({worst, std::abs(std::hypot(double(p.x), double(p.y)) - std::hypot(double(r.x), double(r.y))),
                        double(std::abs(p.z - r.z))});
      if (!all_finite(p) || !(std::abs(glm::length(dvec3(posed.normals[v])) - 1) < 1e-6)) return 1;
    }
  }
  return worst;
}

double scaled(const dvec3& scale, SkinningMethod method) {
  const Rig rig = tube();
  const Pose pose = with_upper(rig, upper(dquat(1, 0, 0, 0), scale));
  // Without a turn both methods are the same sum.
  return distance(skinned(rig, pose, method), plain_linear(rig, pose));
}
double scaled_both(const dvec3& scale) {
  return std::max(scaled(scale, SkinningMethod::linear_blend), scaled(scale, SkinningMethod::dual_quaternion));
}

// Normals of a ball on one joint stretched by (1, 2, 1/4) and mirrored: those of the ellipsoid, by its gradient.
double ellipsoid_normals(const StressOptions&) {
  Rig rig;
  rig.source = "ball";
  rig.surface = stress_sphere(24, 48, 1);
  rig.surface.normals.clear();
  for (const vec3& p : rig.surface.rest) rig.surface.normals.push_back(glm::normalize(p));
  finish_rig(rig);
  double worst = 0;
  for (const dvec3 scale : {dvec3(1, 2, 0.25), dvec3(-1, 2, 0.25), dvec3(1e-6, 1, 1e6), dvec3(-1, -1, -1)}) {
    Pose pose = bind_pose(rig);
    pose.local[0] = LocalTransform{.scale = scale};
    const PosedSurface posed = skinned(rig, pose, SkinningMethod::linear_blend);
    for (std::size_t v = 0; v < rig.surface.rest.size(); ++v) {
      const dvec3 truth = glm::normalize(dvec3(rig.surface.normals[v]) / scale);
      worst = std::max(worst, glm::length(dvec3(posed.normals[v]) - truth));
    }
  }
  return worst;
}

// Inverse bind matrices of joints that were nearly or wholly flattened.
double flattened_bind(double flat, SkinningMethod method) {
  Rig rig = tube();
  rig.bones[1].inverse_bind = rig.bones[1].inverse_bind * glm::scale(dmat4(1.0), dvec3(1, flat, 1));
  const Pose pose = with_upper(rig, upper(turn({1, 2, 3}, 40)));
  const PosedSurface posed = skinned(rig, pose, method);
  if (method == SkinningMethod::linear_blend) return distance(posed, plain_linear(rig, pose));
  double bad = 0;  // what dual quaternions make of it has no formula: it must be finite and near
  for (std::size_t v = 0; v < posed.positions.size(); ++v)
    bad += !all_finite(posed.positions[v]) || !(std::abs(glm::length(dvec3(posed.normals[v])) - 1) < 1e-6) ||
           glm::length(posed.positions[v]) > 10;
  return bad;
}

// All bones move alike: the body moves rigidly, whatever the weights sum to in the file.
double weights_off(double off) {
  Rig rig = tube();
  for (std::size_t i = 0; i < rig.influences.size(); ++i)
    rig.influences[i].weight *= static_cast<float>(1 + off * (2 * random_unit(i, 9) - 1));
  finish_rig(rig);
  Pose pose = bind_pose(rig);
  pose.placement = compose({{30, -20, 10}, turn({1, 2, 3}, 70), dvec3(1)});
  double worst = 0;
  for (const SkinningMethod method : {SkinningMethod::linear_blend, SkinningMethod::dual_quaternion}) {
    const dvec3 origin(30, -20, 10);
    const PosedSurface posed = skinned(rig, pose, method, origin);
    for (std::size_t v = 0; v < posed.positions.size(); ++v) {
      const dvec3 truth = transform_point(pose.placement, dvec3(rig.surface.rest[v])) - origin;
      worst = std::max(worst, glm::length(dvec3(posed.positions[v]) - truth));
    }
  }
  return worst;
}

// Vertices on so many joints, each turned and moved by its own.
double many_influences(int count) {
  Rig rig;
  rig.source = "many";
  rig.surface = stress_sphere(12, 24, 1);
  for (int b = 0; b < 64; ++b) {
    rig.nodes.push_back({.name = fmt::format("joint{}", b)});
    rig.bones.push_back({b, dmat4(1.0)});
  }
  rig.influence_begin = {0};
  for (std::size_t v = 0; v < rig.surface.rest.size(); ++v) {
    for (int i = 0; i < count; ++i)
      rig.influences.push_back({static_cast<std::uint32_t>((v * 5 + i) % 64),
                                static_cast<float>((0.01 + random_unit(v, i)) / (0.51 * count))});
    rig.influence_begin.push_back(static_cast<std::uint32_t>(rig.influences.size()));
  }
  finish_rig(rig);
  Pose pose = bind_pose(rig);
  for (int b = 0; b < 64; ++b)
    pose.local[b] =
        LocalTransform{0.1 * dvec3(random_unit(b, 20), random_unit(b, 21), random_unit(b, 22)),
                       turn({random_unit(b, 23) - 0.5, random_unit(b, 24), 0.3}, 60 * random_unit(b, 25)), dvec3(1)};
  std::vector<dquat> turns;
  std::vector<dvec3> shifts;
  for (int b = 0; b < 64; ++b) {
    turns.push_back(pose.local[b]->rotation);
    shifts.push_back(pose.local[b]->translation);
  }
  return std::max(distance(skinned(rig, pose, SkinningMethod::linear_blend), plain_linear(rig, pose)),
                  distance(skinned(rig, pose, SkinningMethod::dual_quaternion), plain_dual(rig, turns, shifts)));
}

// A chain of 200 joints, a metre apart, each turned and scaled; relative error of the last one's matrix.
double chain(double scale) {
  Rig rig;
  rig.source = "chain";
  rig.surface = stress_sphere(4, 8, 1);
  for (int i = 0; i < 200; ++i)
    rig.nodes.push_back({.name = fmt::format("j{}", i), .parent = i - 1, .translation = {0, 0, 1}});
  finish_rig(rig);
  Pose pose = bind_pose(rig);
  for (int i = 0; i < 200; ++i)
    pose.local[i] = LocalTransform{{0, 0, 1}, turn({1.0 + i % 3, 0.5, 0.25 * (i % 5)}, 7.3), dvec3(scale)};
  const std::vector<dmat4> world = world_transforms(rig, pose);
  const std::vector<LMat> truth = plain_world(rig, pose);
  double worst = 0;
  for (int i = 0; i < 200; ++i) {
    L difference = 0, size = 0;
    for (int c = 0; c < 4; ++c)
      for (int r = 0; r < 3; ++r) {
        difference = std::max(difference, std::abs(L(world[i][c][r]) - truth[i][c][r]));
        size = std::max(size, std::abs(truth[i][c][r]));
      }
    worst = std::max(worst, static_cast<double>(difference / size));
  }
  return worst;
}

// Posed a million metres away, relative to an origin there, against the same pose here.
double far_placement(const StressOptions&) {
  const Rig rig = tube();
  double worst = 0;
  for (const SkinningMethod method : {SkinningMethod::linear_blend, SkinningMethod::dual_quaternion}) {
    Pose pose = with_upper(rig, upper(turn({1, 2, 3}, 50)));
    const PosedSurface here = skinned(rig, pose, method);
    const dvec3 far(1e6, -1e6, 5e5);
    pose.placement = glm::translate(dmat4(1.0), far);
    const PosedSurface there = skinned(rig, pose, method, far);
    for (std::size_t v = 0; v < here.positions.size(); ++v)
      worst = std::max<double>(worst, glm::length(dvec3(here.positions[v]) - dvec3(there.positions[v])));
  }
  return worst;
}

double rest_is_rest(const StressOptions&) {
  Rig rig = tube();
  rig.nodes[0].rotation = turn({1, 1, 0}, 30);  // saved in the middle of a clip
  rig.nodes[1].scale = {1, 3, 0.2};
  double worst = 0;
  for (const SkinningMethod method : {SkinningMethod::linear_blend, SkinningMethod::dual_quaternion}) {
    const PosedSurface posed = skinned(rig, rest_pose(rig), method);
    for (std::size_t v = 0; v < posed.positions.size(); ++v)
      worst = std::max<double>(worst, glm::length(dvec3(posed.positions[v]) - dvec3(rig.surface.rest[v])));
  }
  return worst;
}

// Matrices of every kind taken apart and put together: what a translation, rotation and scale can hold must come back.
double taken_apart(const StressOptions&) {
  double worst = 0;
  for (int i = 0; i < 500; ++i) {
    LocalTransform t{dvec3(random_unit(i, 30), 1e6 * random_unit(i, 31), 0),
                     turn({random_unit(i, 32) - 0.5, random_unit(i, 33) - 0.5, 0.1}, 360 * random_unit(i, 34)),
                     {}};
    for (int k = 0; k < 3; ++k) t.scale[k] = std::pow(10.0, 12 * random_unit(i, 35 + k) - 6);
    if (i % 4 == 1) t.scale[i % 3] *= -1;
    if (i % 4 == 2) t.scale[i % 3] = 0;
    if (i % 4 == 3) t.scale = dvec3(0), t.scale[i % 3] = 1;
    const dmat4 m = compose(t), back = compose(decompose(m));
    for (int c = 0; c < 3; ++c) {
      const double off = glm::length(dvec3(back[c]) - dvec3(m[c])), size = glm::length(dvec3(m[c]));
      worst = std::max(worst, size > 0 ? off / size : off);
    }
  }
  return worst;
}

double refused_weights(const StressOptions&) {
  double taken = 0;
  const std::vector<std::function<void(Rig&)>> spoilt = {
      [](Rig& r) { r.influences[7].weight = std::numeric_limits<float>::quiet_NaN(); },
      [](Rig& r) { r.influences[7].weight = std::numeric_limits<float>::infinity(); },
      [](Rig& r) { r.influences[7].weight = -0.25f; },
      [](Rig& r) { r.influences[7].bone = 2; },
      [](Rig& r) { r.influences[7].weight = 0; },
      [](Rig& r) { r.influence_begin[5] = 4'000'000'000u; },
  };
  for (const auto& spoil : spoilt) {
    Rig rig = tube();
    spoil(rig);
    try {
      finish_rig(rig);
      ++taken;
    } catch (const InputError& e) {
      taken += std::string(e.what()).rfind("tube: ", 0) != 0;
    }
  }
  return taken;
}

}  // namespace

std::vector<StressCase> skinning_stress() {
  constexpr Oracle analytic = Oracle::analytic, precise = Oracle::high_precision, predicate = Oracle::exact_predicate;
  // A position is rounded to float once per axis; the tube reaches 2.3 m from its origin.
  constexpr double rounding = 4 * float_rounding;
  const char* const rounded = "computed in double; each axis rounded to float once, at up to 4 m: 2.4e-7 m";
  constexpr auto linear = SkinningMethod::linear_blend, dual = SkinningMethod::dual_quaternion;
  return {
      {"any turn, linear", "a bone turned by 0 to 720 degrees, by q and by -q", precise, rounding, "m", rounded,
       [](const StressOptions&) {
         return std::max(sweep({1, 0.2, 0.1}, linear), sweep({0, 0, 1}, linear));
       }},
      {"antipodal quaternions", "a bone turned by 0 to 720 degrees, by q and by -q, dual quaternions", precise,
       rounding, "m", rounded,
       [](const StressOptions&) {
         return std::max(sweep({1, 0.2, 0.1}, dual), sweep({0, 0, 1}, dual));
       }},
      {"antipodal keys", "clips whose two keys are q and -q, or nearly", analytic, 1e-15, "",
       "the cosine of a joint that stands still is 1 to the roundings of two unit quaternions and their product",
       antipodal_keys},
      {"180 degree twist, linear", "half a turn about the bone", analytic, rounding, "m",
       "the ring's radius is |1 - 2 w| of what it was, rounded to float; normals keep length 1", half_twist_linear},
      {"180 degree twist, dual quaternions", "half a turn about the bone, and 1e-9 degrees less and more", analytic,
       rounding, "m", "rings keep radius and height, rounded to float; normals keep length 1", half_twist_dual},
      {"joint scale of zero", "the upper joint scaled by 0, on all axes and on one; both methods", precise, rounding,
       "m", rounded,
       [](const StressOptions&) {
         return std::max(scaled_both(dvec3(0)), scaled_both({1, 0, 1}));
       }},
      {"negative joint scale", "the upper joint mirrored on one axis and on all; both methods", precise, rounding, "m",
       rounded,
       [](const StressOptions&) { return std::max(scaled(dvec3(-1, 1, 1), linear), scaled(dvec3(-1), linear)); }},
      {"mirrored joint, dual quaternions", "the upper joint mirrored on one axis, each in turn, also stretched",
       precise, rounding, "m", rounded,
       [](const StressOptions&) {
         return std::max(
             {scaled(dvec3(-1, 1, 1), dual), scaled(dvec3(1, -2, 1), dual), scaled(dvec3(1, 1, -0.5), dual)});
       }},
      {"non-uniform joint scale", "the upper joint scaled by (3, 0.01, 1); both methods", precise, rounding, "m",
       rounded,
       [](const StressOptions&) {
         return scaled_both({3, 0.01, 1});
       }},
      {"normals under stretch", "a ball stretched by up to 1e12 between axes, and mirrored", analytic, 2e-7, "",
       "the normal of an ellipsoid is its gradient; each of three components is rounded to float once",
       ellipsoid_normals},
      {"near-singular bind matrix", "an inverse bind matrix flattened to 1e-12 of its height", precise, rounding, "m",
       rounded, [](const StressOptions&) { return flattened_bind(1e-12, linear); }},
      {"singular bind matrix", "an inverse bind matrix flattened to nothing", precise, rounding, "m", rounded,
       [](const StressOptions&) { return flattened_bind(0, linear); }},
      {"singular bind matrix, dual quaternions", "flattened to 1e-12 and to nothing", predicate, 0, "vertices",
       "positions are finite and near the body, normals of length 1",
       [](const StressOptions&) { return flattened_bind(1e-12, dual) + flattened_bind(0, dual); }},
      {"weights off by 1e-3", "weights that sum to 1 within 1e-3, all bones moved alike, 37 m away", analytic, rounding,
       "m", "a rigid motion is one whatever the weights; rounded to float relative to the animal's origin",
       [](const StressOptions&) { return weights_off(1e-3); }},
      {"weights off by half", "weights that sum to 1 within 0.5", analytic, rounding, "m", "as above",
       [](const StressOptions&) { return weights_off(0.5); }},
      {"1 influence", "a ball on 64 joints, one a vertex; both methods", precise, rounding, "m", rounded,
       [](const StressOptions&) { return many_influences(1); }},
      {"4 influences", "four a vertex; both methods", precise, rounding, "m", rounded,
       [](const StressOptions&) { return many_influences(4); }},
      {"8 influences", "eight a vertex; both methods", precise, rounding, "m", rounded,
       [](const StressOptions&) { return many_influences(8); }},
      {"64 influences", "sixty-four a vertex; both methods", precise, rounding, "m", rounded,
       [](const StressOptions&) { return many_influences(64); }},
      {"chain of 200 joints", "each turned by 7.3 degrees; every joint's matrix", precise, 1e-13, "",
       "200 products of matrices: at most 200 x 4 roundings, 9e-14", [](const StressOptions&) { return chain(1); }},
      {"chain of 200 growing joints", "each also scaled by 1.1: 2e8 in all", precise, 1e-13, "",
       "relative to the largest entry, scale costs no digits", [](const StressOptions&) { return chain(1.1); }},
      {"posed 1e6 m away", "the same pose here and at (1e6, -1e6, 5e5) m; both methods", analytic, 2 * rounding + 4e-10,
       "m", "placement is rounded to 1.2e-10 m there; each result is rounded to float once", far_placement},
      {"rest pose of a rig saved in motion", "nodes that differ from their bind matrices, both methods", analytic,
       rounding, "m", rounded, rest_is_rest},
      {"matrices taken apart",
       "500 of scales from 1e-6 to 1e6, mirrored, with one or two axes flat, put together again", analytic, 1e-9, "",
       "Gram-Schmidt begins with the longest axis: what is 1e-12 of it keeps its direction to 1e-16 / 1e-12 at worst, "
       "mostly to rounding",
       taken_apart},
      {"weights that cannot be used", "not-a-number, infinite, negative, of no joint, none at all", predicate, 0,
       "rigs", "each is refused with a sentence that names the file", refused_weights},
  };
}

}  // namespace moomill

#pragma once
// What the quadruped builder refuses, each with the place and the mend. Internal to the quadruped builder.
#include <vector>

#include "rigs/quadruped.h"
#include "rigs/remesh.h"
#include "rigs/solids.h"

namespace moomill {

// All joints, twins of mirrored ones included, parents before children, else in the order of the spec. Throws
// InputError on doubles, unknown parents, cycles, several roots, and joints without their mirror image.
std::vector<QuadrupedJoint> ordered_joints(const QuadrupedSpec& spec);

// Throws InputError on numbers that are not finite or not positive, and on solids without sections or on the wrong side.
void check_numbers(const QuadrupedSpec& spec);

// Of what was polygonised: drops hollows within the body, which nobody sees; throws InputError where the solids form
// several bodies, naming two that should meet and the gap between them.
void keep_one_body(const QuadrupedSpec& spec, const Field& field, HalfMesh& mesh);

// Throws InputError where a joint is farther outside the body than a tenth of the body's diagonal.
void check_joints_inside(const QuadrupedSpec& spec, const std::vector<QuadrupedJoint>& joints, const Field& field,
                         const HalfMesh& mesh);

// Throws InputError where the whole surface is no closed manifold; adds a warning to the rig where it has not as many
// handles as the spec says, or cuts itself.
void check_surface(const QuadrupedSpec& spec, const Field& field, Rig& rig);

}  // namespace moomill

#pragma once
// What is traced: plain values, parts refer to each other by index. Positions are float, relative to a double origin.
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "generator/core/math.h"
#include "generator/core/surface.h"
#include "generator/render/texture.h"

namespace moomill {

// A finish (what all coats share) and how base colours are found.
struct Material {
  float roughness = 1, metallic = 0;
  float specular = 1;  // scales what a dielectric reflects at its surface; 0: Lambert's matt surface
  int metallic_roughness_texture = -1;  // Appearance::textures; G roughness, B metallic
  int normal_texture = -1;
  float normal_scale = 1;
  int alpha_texture = -1;    // channel 3 below the cutoff is not there
  float alpha = 1;           // multiplies the texture's alpha
  float alpha_cutoff = -1;   // negative: opaque
  int paint = -1;            // Appearance::paints; -1 where no light is asked for
};

struct Instance {
  const Surface* surface = nullptr;  // not owned; outlives the scene
  PosedSurface posed;                // origin equals the scene's
  std::vector<int> materials;        // of the surface's material indices, into Appearance::materials
  int animal = -1;                   // which animal, or -1: scenery, which has no labels
};

// Finishes, textures and coats. Frames share what is heavy; a copy is cheap.
struct Appearance {
  std::vector<Material> materials;
  std::vector<std::shared_ptr<const Texture>> textures;
  std::vector<std::shared_ptr<const Paint>> paints;  // every one with coat_count coats
  int coat_count = 0;
};

struct Scene {
  dvec3 origin{0};  // metres, world
  std::vector<Instance> instances;
  std::shared_ptr<const Appearance> appearance = std::make_shared<Appearance>();
  int animal_count = 0;

  const Material& material(const Instance& instance, std::uint32_t triangle) const {
    return appearance->materials[instance.materials[instance.surface->materials[triangle]]];
  }
  // Whether any material of the instance has holes.
  bool cut_out(const Instance& instance) const;
  Box bounds(bool animals_only) const;  // relative to origin
};

}  // namespace moomill

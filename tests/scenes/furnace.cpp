// The shipped cow, posed, in a white world.
#include <doctest/doctest.h>

#include "generator/render/accel.h"
#include "generator/render/path.h"
#include "scenes/runner.h"

using namespace moomill;

TEST_CASE("white furnace: a white cow disappears but for what the shading terminator takes") {
  SceneSpec spec = read_scene(data_root() / "scenes/quick.toml");
  Overrides o;
  o.modalities = {"depth"};
  o.resolution = {48, 36};
  o.cameras = {2};
  apply_overrides(spec, o);
  const Mill mill(spec);
  const Frame frame = mill.prepare(1);
  Scene scene = frame.geometry->scene;  // shares the surfaces
  auto white = std::make_shared<Appearance>();
  Paint paint;
  paint.coats = {{vec3(1), -1, false}};
  white->paints = {std::make_shared<Paint>(paint)};
  white->coat_count = 1;
  Material matt;
  matt.specular = 0;
  matt.paint = 0;
  white->materials = {matt};
  scene.appearance = white;
  for (Instance& in : scene.instances) std::fill(in.materials.begin(), in.materials.end(), 0);
  Lights lights;
  lights.environment = std::make_shared<Environment>(vec3(1));
  lights.prepare(vec3(0));
  const auto seen = [&](float roughness, float specular) {
    white->materials[0].roughness = roughness;
    white->materials[0].specular = specular;
    const Accel accel(scene);
    const CameraRecord& c = frame.cameras.at(0);
    const Camera camera = Camera::from_matrix(c.world_to_camera, c.fx, c.fy, c.cx, c.cy, c.width, c.height);
    PathOptions options;
    options.samples = 64;
    const Radiance r = trace_radiance(scene, lights, accel, camera, footprint(scene, camera, options.filter_radius), options);
    CHECK(r.not_finite == 0);
    double radiance = 0, alpha = 0;
    for (std::size_t p = 0; p < r.coats[0].data.size(); p += 4) radiance += r.coats[0].data[p + 1], alpha += r.coats[0].data[p + 3];
    REQUIRE(alpha > 50);
    return radiance / alpha;
  };
  for (const bool flat : {false, true}) {
    if (flat)
      for (Instance& in : scene.instances) std::fill(in.posed.normals.begin(), in.posed.normals.end(), vec3(0));  // then the triangle's own is taken
    for (const auto& [roughness, specular] : {std::pair(1.0f, 0.0f), std::pair(0.5f, 1.0f)}) {
      const double mean = seen(roughness, specular);
      MESSAGE(std::string(flat ? "flat" : "smooth"), " normals, roughness ", roughness, ", specular ", specular, ": ", mean);
      CAPTURE(flat);
      CHECK(mean < 1.005);
      CHECK(mean > (flat ? 0.995 : 0.98));
    }
  }
}

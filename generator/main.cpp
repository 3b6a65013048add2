// The command line of moomill: commands, options, help. What the commands do is in commands.cpp.
#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdlib>

#include "generator/command_line.h"
#include "generator/commands.h"
#include "generator/core/parallel.h"

namespace {

using namespace moomill;

void add_scene_options(CLI::App* app, SceneOptions& o) {
  app->add_option("--frames", o.frames, "frames A to B only, both included")->type_name("A:B");
  app->add_option("--cameras", o.cameras, "these cameras only")->type_name("0,2,5:7");
  app->add_option("--coats", o.coats, "these coats only, by index")->type_name("0,11");
  app->add_option("--modalities", o.modalities, "these instead of the scene's, or all")->type_name("rgb,depth");
  app->add_option("--resolution", o.resolution, "of the pictures")->type_name("WxH");
  app->add_option("--spp", o.samples, "samples per pixel")->type_name("N");
  app->add_option("--target-error", o.target_error, "relative error of the pictures, 0.001 to 1, instead of --spp: 0.02 is smooth to the eye")->type_name("E");
  app->add_flag("--surface-light", o.surface_light, "gather light on the animals once per frame: faster for large pictures, with a small bias");
}

// CLI::Range takes what is not a number for one within it.
const CLI::Validator a_number([](const std::string& text) { return std::isnan(std::strtod(text.c_str(), nullptr)) ? text + " is not a number" : std::string(); }, "", "");

int run(int argc, char** argv) {
  CLI::App app("The mill: synthetic multi-view datasets of articulated animals with exact ground truth.", "moomill");
  app.set_version_flag("--version", "moomill " MOOMILL_VERSION);
  app.require_subcommand(1);
  add_example(&app, "moomill generate scenes/quick.toml -o out/quick");
  int status = 0;

  PlanCommand plan;
  CLI::App* c = add_command(app, "plan", "What generate would do: stages, images, disk, time",
                            "moomill plan scenes/nepumoo.toml", status, [&] { return run_plan(plan); });
  c->add_option("scene", plan.scene, "scene file")->required()->type_name("SCENE");
  c->add_flag("--json", plan.json, "for programs");
  c->add_option("--probe", plan.probe_seconds, "seconds of work, after loading, that the time is measured by; default 5; 0: typical figures, nothing is loaded")
      ->type_name("SECONDS")
      ->check(CLI::Range(0.0, 3600.0))
      ->check(a_number);
  add_scene_options(c, plan.options);

  GenerateCommand generate;
  c = add_command(app, "generate", "Make a dataset, or go on with it where an earlier run ended",
                  "moomill generate scenes/nepumoo.toml -o out/multiview_cow --shard 0/16", status,
                  [&] { return run_generate(generate, stop_wanted); });
  c->add_option("scene", generate.scene, "scene file")->required()->type_name("SCENE");
  c->add_option("-o,--out", generate.out, "folder of the dataset")->required()->type_name("DIR");
  c->add_option("--layout", generate.layout, "layout on disk")->type_name("nepumoo")->check(CLI::IsMember({"nepumoo"}));
  c->add_option("--shard", generate.shard, "this share of the frames only; join the shards by merge")->type_name("I/N");
  c->add_option("--threads", generate.threads, "0: one per core")->type_name("N")->check(CLI::Range(0, 4096));
  add_scene_options(c, generate.options);

  RenderCommand render;
  c = add_command(app, "render", "Render one view; every modality is a layer of the EXR",
                  "moomill render scenes/quick.toml --frame 1 --camera 3 --coat 0 -o out/view.exr", status,
                  [&] { return run_render(render); });
  c->add_option("scene", render.scene, "scene file")->required()->type_name("SCENE");
  c->add_option("--frame", render.frame, "frame, as numbered")->required()->type_name("F");
  c->add_option("--camera", render.camera, "camera id")->required()->type_name("C");
  c->add_option("--coat", render.coat, "coat index")->type_name("T");
  c->add_option("-o,--out", render.out, "picture")->required()->type_name("FILE.exr");
  c->add_option("--modalities", render.options.modalities, "these instead of the scene's, or all")
      ->type_name("rgb,depth");
  c->add_option("--resolution", render.options.resolution, "of the picture")->type_name("WxH");
  c->add_option("--spp", render.options.samples, "samples per pixel")->type_name("N");
  c->add_option("--target-error", render.options.target_error, "relative error of the picture, 0.001 to 1, instead of --spp")->type_name("E");
  c->add_flag("--surface-light", render.options.surface_light, "gather light on the animals first: a small bias");

  MergeCommand merge;
  c = add_command(app, "merge", "Join shards into one dataset", "moomill merge out/shard0 out/shard1 -o out/whole",
                  status, [&] { return run_merge(merge); });
  c->add_option("shards", merge.shards, "folders that generate --shard made")->required()->type_name("DIR");
  c->add_option("-o,--out", merge.out, "folder of the whole")->required()->type_name("DIR");
  c->add_flag("--allow-missing", merge.allow_missing, "also when frames are missing");

  PreviewCommand preview;
  c = add_command(app, "preview", "Contact sheet of a dataset, a scene or a rig", "moomill preview out/quick -o out/quick.png",
                  status, [&] { return run_preview(preview, stop_wanted); });
  c->add_option("source", preview.source, "dataset folder, scene file, species or rig file")->required()->type_name("DIR|SCENE|RIG");
  c->add_option("-o,--out", preview.out, "picture")->required()->type_name("FILE.png");
  c->add_option("--frame", preview.frame, "default: the first")->type_name("F");
  c->add_option("--camera", preview.camera, "of --modalities; default: the first")->type_name("C");
  c->add_option("--coat", preview.coat, "default: the first")->type_name("T");
  c->add_flag("--modalities", preview.modalities, "every modality of one view instead of every view of one frame");
  c->add_option("--strip", preview.strip, "so many frames of a scene side by side, from one camera")->type_name("N")->check(CLI::Range(1, 200));
  c->add_option("--frames", preview.frames, "of --strip: spread over frames A to B")->type_name("A:B");
  c->add_flag("--coats", preview.coats, "one view of a scene in all its coats");

  CrosscheckCommand crosscheck;
  c = add_command(app, "crosscheck", "The same frame by Blender's Cycles, compared",
                  "moomill crosscheck scenes/quick.toml -o out/crosscheck --cameras 0,13 --coats 0 --enforce", status,
                  [&] { return run_crosscheck(crosscheck, stop_wanted); });
  c->add_option("scene", crosscheck.scene, "scene file")->required()->type_name("SCENE");
  c->add_option("-o,--out", crosscheck.out, "folder for tables, figures and pictures")->required()->type_name("DIR");
  c->add_option("--frame", crosscheck.frame, "default: the first")->type_name("F");
  c->add_option("--cameras", crosscheck.options.cameras, "default: three of them")->type_name("0,2,5:7");
  c->add_option("--coats", crosscheck.options.coats, "default: two of them")->type_name("0,11");
  c->add_option("--resolution", crosscheck.options.resolution, "of the pictures")->type_name("WxH");
  c->add_option("--spp", crosscheck.options.samples, "samples per pixel of both")->type_name("N");
  c->add_option("--label-scale", crosscheck.label_scale, "odd: Cycles' labels so many times finer, of which the middle pixels count; default 3")
      ->type_name("N")
      ->check(CLI::Range(1, 99));
  c->add_option("--threads", crosscheck.threads, "of Blender; 0: one per core")->type_name("N")->check(CLI::Range(0, 4096));
  c->add_option("--blender", crosscheck.blender, "program, where it is not on the PATH")->type_name("FILE");
  CLI::Option* timing = c->add_option("--timing", crosscheck.timing, "no comparison: convergence.csv with the run time of Blender's own material at each of these samples")
                            ->type_name("16,64");
  c->add_option("--reference", crosscheck.reference, "with --timing: samples of the pictures that errors are taken against; those already in the folder are kept")
      ->type_name("N")
      ->check(CLI::Range(1, largest_samples))
      ->needs(timing);
  c->add_flag("--enforce", crosscheck.enforce, "exit status 1 where a figure misses its bound");

  std::string folder;
  c = add_command(app, "validate", "Check every invariant of a dataset; exit 1 and a list where one fails",
                  "moomill validate out/quick", status, [&] { return run_validate(folder); });
  c->add_option("dataset", folder, "dataset folder")->required()->type_name("DIR");

  ConvergeCommand converge;
  c = add_command(app, "converge", "Error of the pictures of a scene against samples and run time, and against another renderer's",
                  "moomill converge scenes/quick.toml -o out/converge --max-spp 256", status, [&] { return run_converge(converge, stop_wanted); });
  c->add_option("scene", converge.scene, "scene file")->required()->type_name("SCENE");
  c->add_option("-o,--out", converge.out, "folder for convergence.csv, summary.json, table.md and plots")->required()->type_name("DIR");
  c->add_option("--against", converge.against, "convergence.csv of another run or renderer, or its folder; gives the speed-up at equal error")->type_name("DIR");
  c->add_option("--at-spp", converge.at_samples, "of --against: reach its error at so many samples; default 64")->type_name("N")->check(CLI::Range(1, largest_samples));
  c->add_option("--frames,--frame", converge.options.frames, "frames A to B; default: the first")->type_name("A:B");
  c->add_option("--cameras", converge.options.cameras, "camera ids; default: three spread over the scene's")->type_name("0,2,5:7");
  c->add_option("--coats", converge.options.coats, "coat indices; default: the scene's first and last")->type_name("0,11");
  c->add_option("--resolution", converge.options.resolution, "of the pictures; default: 160 pixels wide")->type_name("WxH");
  c->add_option("--min-spp", converge.min_samples, "measure from so many samples on; default 1")->type_name("N")->check(CLI::Range(1, 65536));
  c->add_option("--max-spp", converge.max_samples, "measure 1, 2, 4, ... samples per pixel up to this; default 1024")->type_name("N")->check(CLI::Range(1, 65536));
  c->add_option("--repeats", converge.repetitions, "of every sample count, with independent samples; default 3")->type_name("N")->check(CLI::Range(1, 1000));
  c->add_option("--reference-spp", converge.reference_samples, "of the references; default 16 times --max-spp")->type_name("N")->check(CLI::Range(2, largest_samples));
  c->add_option("--target-errors", converge.target_errors, "measure pictures of these target errors instead of sample counts")->type_name("0.1,0.05");
  c->add_flag("--surface-light", converge.options.surface_light, "measure pictures with gathered light, against references by paths: the errors hold its bias");
  c->add_option("--threads", converge.threads, "0: one per core")->type_name("N")->check(CLI::Range(0, 4096));
  c->add_option("--slope-at-most", converge.slope_at_most, "bound of the slope of MSE against samples; default -0.97")->type_name("X")->check(a_number);
  c->add_flag("--enforce", converge.enforce, "exit status 1 where a figure misses its bound");

  LeaveOutCommand leave_out;
  c = add_command(app, "leave-out", "Time and memory that a scene saves with one modality, one light, one coat less",
                  "moomill leave-out scenes/quick.toml -o out/leave_out", status, [&] { return run_leave_out(leave_out, stop_wanted); });
  c->add_option("scene", leave_out.scene, "scene file")->required()->type_name("SCENE");
  c->add_option("-o,--out", leave_out.out, "folder for summary.json and table.md")->required()->type_name("DIR");
  c->add_option("--parts", leave_out.parts, "these only; default: every modality, light and coat")->type_name("'modality depth,coat 11'");
  c->add_option("--repeats", leave_out.repetitions, "pairs of runs of every part; default 5")->type_name("N")->check(CLI::Range(1, 1000));
  c->add_flag("--enforce", leave_out.enforce, "exit status 1 where a figure misses its bound");
  add_scene_options(c, leave_out.options);

  StressCommand stress;
  c = add_command(app, "stress", "Numerical stability on extreme cases, each against an oracle; a table of errors and bounds",
                  "moomill stress -o out/stress --enforce", status, [&] { return run_stress_study(stress, stop_wanted); });
  c->add_option("-o,--out", stress.out, "folder for stress.md, stress.csv, summary.json and table.md")->required()->type_name("DIR");
  c->add_option("--group", stress.group, "only these cases: geometry, skinning, light, sampling, keypoints, statistics")->type_name("GROUP");
  c->add_option("--rays", stress.rays, "of the search for cracks between triangles; default 10000000")
      ->type_name("N")
      ->check(CLI::Range(1000, 1000000000));
  c->add_flag("--enforce", stress.enforce, "exit status 1 where a case is out of bounds");

  CLI::App* rig = app.add_subcommand("rig", "Look at rigs and species");
  rig->require_subcommand(1);
  add_example(rig, "moomill rig check cow");
  std::string rig_name, rig_out;
  c = add_command(*rig, "info", "Joints, clips, size, weights, materials", "moomill rig info fox.glb", status,
                  [&] { return run_rig_info(rig_name); });
  c->add_option("rig", rig_name, "rig file, species file or species name")->required()->type_name("RIG");
  c = add_command(*rig, "check", "What is wrong or suspicious about a rig; exit 1 when something is wrong",
                  "moomill rig check cow", status, [&] { return run_rig_check(rig_name); });
  c->add_option("rig", rig_name, "rig file, species file or species name")->required()->type_name("RIG");
  c = add_command(*rig, "build", "Write the rig of a species as one .glb",
                  "moomill rig build rigs/cow/cow.toml -o out/cow.glb", status,
                  [&] { return run_rig_build(rig_name, rig_out); });
  c->add_option("species", rig_name, "species file or species name")->required()->type_name("SPEC");
  c->add_option("-o,--out", rig_out, "rig file to write")->required()->type_name("RIG.glb");
  CompareCommand compare;
  c = add_command(*rig, "compare", "Overlap of silhouettes with a reference mesh, after fitting place, pose and three scales",
                  "moomill rig compare cow --against validate/silhouettes/holstein.toml -o out/holstein", status,
                  [&] { return run_rig_compare(compare); });
  c->add_option("rig", compare.rig, "rig file, species file or species name")->required()->type_name("RIG");
  c->add_option("--against", compare.reference, "reference, as in validate/silhouettes")->required()->type_name("FILE.toml");
  c->add_option("-o,--out", compare.out, "folder for figures and pictures")->required()->type_name("DIR");

  std::string bind_mesh, bind_keypoints;
  c = add_command(*rig, "bind", "Make a rig of a static mesh and clicked keypoints; writes its species file beside it",
                  "moomill rig bind cow.glb --skeleton rigs/scans/holstein.toml -o out/holstein.glb", status,
                  [&] { return run_rig_bind(bind_mesh, bind_keypoints, rig_out); });
  c->add_option("mesh", bind_mesh, "static mesh: glTF, FBX, Collada or OBJ")->required()->type_name("MESH");
  c->add_option("--skeleton", bind_keypoints, "species and keypoints")->required()->type_name("SPEC.toml");
  c->add_option("-o,--out", rig_out, "rig file to write")->required()->type_name("RIG.glb");

  int motion_samples = 200;
  c = add_command(*rig, "motion", "How well clips move: feet, slip, limits; of a scene also its poses; exit 1 when a bound is missed",
                  "moomill rig motion scenes/nepumoo.toml -o out/motion", status,
                  [&] { return run_rig_motion(rig_name, motion_samples, rig_out); });
  c->add_option("source", rig_name, "scene file, rig file, species file or species name")->required()->type_name("SCENE|RIG");
  c->add_option("-o,--out", rig_out, "folder for summary.json and table.md")->type_name("DIR");
  c->add_option("--samples", motion_samples, "per clip")->type_name("N")->check(CLI::Range(2, 100000));

  std::string deform_scene;
  SceneOptions deform_options;
  c = add_command(*rig, "deform", "How well the skin holds in the poses of a scene; exit 1 when a bound is missed",
                  "moomill rig deform scenes/nepumoo.toml -o out/deform", status,
                  [&] { return run_rig_deform(deform_scene, deform_options, rig_out); });
  c->add_option("scene", deform_scene, "scene file; the poses of its first animal")->required()->type_name("SCENE");
  c->add_option("-o,--out", rig_out, "folder for summary.json and table.md")->type_name("DIR");
  c->add_option("--frames", deform_options.frames, "frames A to B only, both included")->type_name("A:B");

  CLI::App* coat = app.add_subcommand("coat", "Look at coats and bake them");
  coat->require_subcommand(1);
  add_example(coat, "moomill coat list cow");
  std::string coat_species, coat_out;
  c = add_command(*coat, "list", "The coats that ship for a species, by index", "moomill coat list cow", status,
                  [&] { return run_coat_list(coat_species); });
  c->add_option("species", coat_species, "species name")->required()->type_name("SPECIES");
  CoatBakeCommand bake;
  c = add_command(*coat, "bake", "Bake a coat file over a rig's UV atlas",
                  "moomill coat bake 00_holstein --rig cow -o out/holstein.png", status,
                  [&] { return run_coat_bake(bake); });
  CLI::Option* bake_coat = c->add_option("coat", bake.coat, "coat name or .toml")->type_name("COAT");
  c->add_option("--breed", bake.breed, "instead of a coat: individuals of this breed, into the folder -o")
      ->type_name("BREED")
      ->excludes(bake_coat);
  c->add_option("--count", bake.count, "with --breed: how many; default 12")->type_name("N")->check(CLI::Range(1, 1000000));
  c->add_option("--first", bake.first, "with --breed: index of the first; default 0")->type_name("N")->check(CLI::Range(0, 1000000));
  c->add_option("--seed", bake.seed, "with --breed: which herd; default 0")->type_name("N");
  c->add_option("--rig", bake.rig, "species name, species file or rig file")->required()->type_name("RIG");
  c->add_option("--resolution", bake.resolution, "texels a side; default 2048")
      ->type_name("N")
      ->check(CLI::Range(1, 32768));
  c->add_option("-o,--out", bake.out, "picture, or folder with --breed")->required()->type_name("FILE.png");
  IndividualsCommand individuals;
  c = add_command(*coat, "individuals", "Whether the individuals of a breed differ, and how they vary; exit 1 when too many are alike",
                  "moomill coat individuals cow --breed holstein --count 10000 -o out/individuals", status,
                  [&] { return run_coat_individuals(individuals); });
  c->add_option("species", individuals.species, "species name")->required()->type_name("SPECIES");
  c->add_option("--breed", individuals.breed, "breed name or .toml")->required()->type_name("BREED");
  c->add_option("--count", individuals.count, "how many; default 10000")->type_name("N")->check(CLI::Range(2, 100000));
  c->add_option("--seed", individuals.seed, "which herd; default 0")->type_name("N");
  c->add_option("-o,--out", individuals.out, "folder for summary.json and table.md")->type_name("DIR");
  c = add_command(*coat, "compare", "How different the coats of a species look; exit 1 when a pair misses its bound",
                  "moomill coat compare cow -o out/coats", status,
                  [&] { return run_coat_compare(coat_species, coat_out); });
  c->add_option("species", coat_species, "species name")->required()->type_name("SPECIES");
  c->add_option("-o,--out", coat_out, "folder for summary.json and table.md")->type_name("DIR");

  return parse_and_run(app, argc, argv, status);
}

}  // namespace

int main(int argc, char** argv) {
  keep_memory_flat();
  return run_program("moomill", "use fewer --threads or a smaller --resolution", [&] { return run(argc, argv); });
}

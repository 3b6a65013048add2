"""Rebuilds a frame that `moomill crosscheck` exported, and renders it with Cycles on the CPU.

    blender -b --factory-startup --python-exit-code 1 -P validate/blender/crosscheck.py -- FOLDER --labels --surface diffuse --spp 64

FOLDER holds scene.json and the arrays it names (validate/studies/crosscheck.h). Into FOLDER/cycles go
    labels_CAMERA.exr                      depth, object index, NNOPCS: one sample through (nearly) the pixel centre
    rgb_SURFACE_CAMERA_COAT_SPP.exr        scene-linear colour, premultiplied, with alpha
    rgb_..._SPP.exr.json                   what was measured of this render, and with --sources what it was made from
    renders.csv                            a row per colour render; the error columns are left to moomill
    build.json                             seconds of what is not in these rows: start, building, first synchronisation
Surfaces: `diffuse` and `full` are matched to moomill's (README.md says how), `principled` is Blender's own material with the
same textures, which is what a Blender user would render and what run times are taken of.
"""
import argparse
import csv
import json
import os
import struct
import sys
import time

import bpy

began = time.time()
sys.dont_write_bytecode = True
sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from rebuild import AOV, Export, Materials, build_lights, build_mesh, move_to_camera, place_camera

COLUMNS = ["renderer", "frame", "camera", "coat", "spp", "seconds", "core_seconds", "mse", "relative_mse", "ciede2000"]


# --- rendering ---

def set_up_cycles(scene, arguments, export):
    scene.render.engine = "CYCLES"
    c = scene.cycles
    c.device = "CPU"
    c.use_adaptive_sampling = False
    c.use_denoising = False
    c.sample_clamp_direct = c.sample_clamp_indirect = 0.0
    c.light_sampling_threshold = 0.0
    c.blur_glossy = 0.0
    c.caustics_reflective = c.caustics_refractive = True
    c.use_auto_tile = False
    c.film_exposure = 1.0
    c.pixel_filter_type = "BLACKMAN_HARRIS"
    # moomill counts surfaces whose light is gathered, Cycles those after the first; 0 is no cap, of which 1024 is next.
    cap = export.data["max_bounces"]
    bounces = cap - 1 if cap > 0 else 1024
    for name in ("max_bounces", "diffuse_bounces", "glossy_bounces", "transmission_bounces", "volume_bounces"):
        setattr(c, name, bounces)
    c.transparent_max_bounces = 1024
    scene.render.film_transparent = not export.data["environment_visible"]
    scene.render.use_persistent_data = True
    scene.render.use_compositing = scene.render.use_sequencer = False
    scene.render.dither_intensity = 0.0
    scene.render.use_motion_blur = False
    scene.render.threads_mode = "FIXED"
    scene.render.threads = arguments.threads or len(os.sched_getaffinity(0))
    scene.view_settings.view_transform = "Raw"  # EXR are scene-linear whatever it says; nothing may hang on it
    scene.view_settings.look = "None"
    scene.view_settings.exposure, scene.view_settings.gamma = 0.0, 1.0
    scene.render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
    scene.render.image_settings.color_depth = "32"
    scene.render.image_settings.exr_codec = "ZIP"


def exr_attributes(path):
    """The text attributes in an EXR's header."""
    found = {}
    with open(path, "rb") as file:
        data = file.read(65536)
    at = 8
    while data[at] != 0:
        end = data.index(b"\0", at)
        name, at = data[at:end].decode(), end + 1
        end = data.index(b"\0", at)
        kind, at = data[at:end], end + 1
        size = struct.unpack_from("<i", data, at)[0]
        at += 4
        if kind == b"string":
            found[name] = data[at:at + size].decode(errors="replace")
        at += size
    return found


def seconds_of(text):
    """`01:02.34` or `1:00:02.34` as seconds."""
    total = 0.0
    for part in text.split(":"):
        total = 60 * total + float(part)
    return total


def cores():
    t = os.times()
    return t.user + t.system


def render(scene, samples, seed, path):
    """Renders into `path`; wall and core seconds of bpy.ops.render.render(), and the seconds Cycles says it traced."""
    scene.cycles.samples = samples
    scene.cycles.seed = seed
    scene.update_tag()  # or persistent data would go on with the settings of the render before
    wall, core = time.perf_counter(), cores()
    bpy.ops.render.render()
    wall, core = time.perf_counter() - wall, cores() - core
    os.makedirs(os.path.dirname(path), exist_ok=True)
    bpy.data.images["Render Result"].save_render(path, scene=scene)
    text = exr_attributes(path)
    made = [int(v) for k, v in text.items() if k.startswith("cycles.") and k.endswith(".samples")]
    if made != [samples]:
        raise RuntimeError(f"{path} was rendered with {made} samples instead of {samples}")
    told = {k.split(".")[-1]: seconds_of(v) for k, v in text.items() if k.startswith("cycles.") and k.endswith("_time")}
    return wall, core, told


def write_beside(path, values):
    with open(path + ".json.tmp", "w") as file:
        json.dump(values, file, indent=1)
    os.replace(path + ".json.tmp", path + ".json")


def numbers(text):
    return [int(word) for word in text.split(",")] if text else None


def main():
    parser = argparse.ArgumentParser(prog="crosscheck.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder")
    parser.add_argument("--labels", action="store_true", help="render depth, object index and NNOPCS")
    parser.add_argument("--label-scale", type=int, default=1, help="odd; labels are rendered so many times larger, of which the middle pixels count")
    parser.add_argument("--surface", default="", help="diffuse, full, principled, or several with commas")
    parser.add_argument("--spp", default="64", help="samples per pixel, or several with commas")
    parser.add_argument("--threads", type=int, default=0, help="0: one per core")
    parser.add_argument("--cameras", default="", help="these of the exported ones only")
    parser.add_argument("--coats", default="", help="these of the exported ones only")
    parser.add_argument("--repeat", type=int, default=1, help="times every colour render is made and timed")
    parser.add_argument("--sources", default="", help="kept beside every colour render: a hash by which moomill finds whether it may be kept")
    parser.add_argument("--skip", default="", help="names of colour renders that are kept instead of made again, with commas")
    parser.add_argument("--launched", type=float, default=0, help="when Blender was started, seconds since 1970: to tell how long it took to get here")
    arguments = parser.parse_args(sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else [])
    if arguments.label_scale % 2 == 0:
        parser.error("--label-scale must be odd, or no pixel centre stays one")

    building = time.perf_counter()
    export = Export(arguments.folder)
    out = os.path.join(arguments.folder, "cycles")
    os.makedirs(out, exist_ok=True)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    set_up_cycles(scene, arguments, export)
    materials = Materials(export)
    things = [build_mesh(export, instance, i, materials) for i, instance in enumerate(export.data["instances"])]
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    layer = scene.view_layers[0]
    layer.name = "View"
    if arguments.labels:  # renders for their run time do without
        aov = layer.aovs.add()
        aov.name, aov.type = AOV, "COLOR"

    def use(surface):
        for thing, instance in zip(things, export.data["instances"]):
            slots = thing.data.materials
            made = [materials.get(surface, i) for i in instance["materials"]]
            # Slots are replaced in place: clearing them would reset the faces' material indices.
            for i, material in enumerate(made):
                if i < len(slots):
                    slots[i] = material
                else:
                    slots.append(material)

    def passes(labels):
        layer.use_pass_z = layer.use_pass_object_index = labels
        layer.use_pass_combined = True

    cameras = [c for c in export.data["cameras"] if numbers(arguments.cameras) is None or c["id"] in numbers(arguments.cameras)]
    coats = [(i, c) for i, c in enumerate(export.data["coats"]) if numbers(arguments.coats) is None or c in numbers(arguments.coats)]
    told = {"blender": bpy.app.version_string, "threads": scene.render.threads, "start_seconds": began - arguments.launched if arguments.launched else None}

    if arguments.labels:
        use("diffuse")
        passes(True)
        bounces = scene.cycles.max_bounces
        scene.cycles.max_bounces = 0
        scene.cycles.filter_width = 0.01  # the least there is: rays within 0.01 pixels of the centre
        for camera in cameras:
            place_camera(scene, camera, arguments.label_scale)
            move_to_camera(export, things, camera)
            render(scene, 1, 0, os.path.join(out, f"labels_{camera['id']:03}.exr"))
        scene.cycles.max_bounces = bounces
        move_to_camera(export, things, None)
    told["build_seconds"] = time.perf_counter() - building

    rows, skip = [], set(arguments.skip.split(","))
    passes(False)
    scene.cycles.filter_width = export.data["filter_radius"]  # Cycles' window is twice as wide as this, from -w to w
    for surface in [s for s in arguments.surface.split(",") if s]:
        use(surface)
        lights = None
        for position, coat in coats:
            materials.wear(surface, position)
            for camera in cameras:
                place_camera(scene, camera, 1)
                if camera["lights"] != lights:
                    lights = camera["lights"]
                    build_lights(export, lights)
                for spp in numbers(arguments.spp):
                    for repeat in range(arguments.repeat):
                        # Other samples for every count, so that an error against a reference is not that of shared samples.
                        path = os.path.join(out, f"rgb_{surface}_{camera['id']:03}_{coat:03}_{spp}.exr")
                        if os.path.basename(path) in skip:
                            continue
                        if os.path.exists(path + ".json"):
                            os.remove(path + ".json")  # or a kill between here and below would leave a picture with another's hash
                        wall, core, times = render(scene, spp, spp + 65537 * repeat, path)
                        rows.append([f"cycles {surface}", export.data["frame"], camera["id"], coat, spp, f"{wall:.4f}", f"{core:.4f}", "", "", ""])
                        told.setdefault("renders", []).append({"camera": camera["id"], "coat": coat, "spp": spp, "surface": surface,
                                                               "wall_seconds": wall, "core_seconds": core, **times})
                        write_beside(path, {"sources": arguments.sources, **told["renders"][-1]})
                        print(f"crosscheck: {rows[-1][0]} camera {camera['id']} coat {coat} spp {spp}: {wall:.2f} s, {core:.2f} core s, {times}", flush=True)
    with open(os.path.join(out, "renders.csv"), "w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([COLUMNS] + rows)
    with open(os.path.join(out, "build.json"), "w") as file:
        json.dump(told, file, indent=1)


main()

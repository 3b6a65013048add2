"""Opens a built rig in Blender and checks that it came in whole: an armature with the rig's joints, all vertices, all
clips as actions, and a clip that moves the mesh.

    blender --background --factory-startup --python validate/gltf/open_in_blender.py -- out/cow.glb

Prints what it found; the exit status is 1 when something is missing. The numbers it compares with are read from the
.glb itself. Needs `blender` and `python3-numpy` (section crosscheck of apt-packages.txt); Blender 3.4's importer uses
`numpy.bool`, which later NumPy versions no longer have, so it is put back first.
"""
import json
import struct
import sys

import bpy
import numpy

if "bool" not in numpy.__dict__:
    numpy.bool = bool


def read_document(path):
    """The JSON chunk of a .glb."""
    with open(path, "rb") as file:
        magic, _, _ = struct.unpack("<4sII", file.read(12))
        size, kind = struct.unpack("<I4s", file.read(8))
        if magic != b"glTF" or kind != b"JSON":
            raise ValueError(f"{path} is no .glb file")
        return json.loads(file.read(size))


def positions(meshes, frame):
    """All vertices of the evaluated meshes at a frame, world space, as one array."""
    bpy.context.scene.frame_set(frame)
    graph = bpy.context.evaluated_depsgraph_get()
    out = []
    for thing in meshes:
        evaluated = thing.evaluated_get(graph)
        mesh = evaluated.to_mesh()
        flat = numpy.empty(3 * len(mesh.vertices), dtype=numpy.float32)
        mesh.vertices.foreach_get("co", flat)
        world = numpy.array(evaluated.matrix_world, dtype=numpy.float64)
        out.append(flat.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3])
        evaluated.to_mesh_clear()
    return numpy.concatenate(out)


def check(path):
    document = read_document(path)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    # Vertices must come in one for one to be counted.
    bpy.ops.import_scene.gltf(filepath=path, merge_vertices=False)
    meshes = [o for o in bpy.data.objects if o.type == "MESH" and any(m.type == "ARMATURE" for m in o.modifiers)]
    armatures = [o for o in bpy.data.objects if o.type == "ARMATURE"]
    faults = []

    def compare(what, found, wanted):
        print(f"{what:<28}{found} of {wanted}")
        if found != wanted:
            faults.append(what)

    accessors = document["accessors"]
    wanted_vertices = wanted_triangles = 0
    for mesh in document["meshes"]:
        seen = set()  # primitives share their vertices; Blender gives each its own copy
        for primitive in mesh["primitives"]:
            seen.add(primitive["attributes"]["POSITION"])
            wanted_triangles += accessors[primitive["indices"]]["count"] // 3
        wanted_vertices += sum(accessors[a]["count"] for a in seen)
    joints = {j for skin in document.get("skins", []) for j in skin["joints"]}
    names = {document["nodes"][j].get("name") for j in joints}
    bones = {b.name for a in armatures for b in a.data.bones}
    compare("armatures", len(armatures), 1)
    compare("joints among the bones", len(names & bones), len(names))
    one_material = all(len(m["primitives"]) == 1 for m in document["meshes"])
    found_vertices = sum(len(o.data.vertices) for o in meshes)
    if one_material:
        compare("vertices", found_vertices, wanted_vertices)
    compare("triangles", sum(len(o.data.polygons) for o in meshes), wanted_triangles)
    animations = [a.get("name") for a in document.get("animations", [])]
    actions = [a for a in bpy.data.actions if any(a.name.startswith(n) for n in animations)]
    compare("clips as actions", len(actions), len(animations))
    unweighted = sum(1 for o in meshes for v in o.data.vertices if abs(sum(g.weight for g in v.groups) - 1) > 1e-3)
    compare("vertices without weight", unweighted, 0)

    if actions and len(armatures) == 1:
        armature = armatures[0]
        for track in armature.animation_data.nla_tracks if armature.animation_data else []:
            track.mute = True
        rest = None
        for action in actions:
            armature.animation_data_create()
            armature.animation_data.action = action
            first, last = (int(f) for f in action.frame_range)
            here = positions(meshes, first)
            moved = max(numpy.abs(positions(meshes, f) - here).max() for f in numpy.linspace(first, last, 5).astype(int))
            print(f"clip {action.name:<23}frames {first} to {last}, vertices move by up to {moved:.3f} m")
            if not numpy.isfinite(moved) or moved < 1e-4:
                faults.append(f"motion of {action.name}")
            rest = here if rest is None else rest
        size = rest.max(axis=0) - rest.min(axis=0)
        print("size in the first clip      " + " x ".join(f"{s:.3f}" for s in size) + " m")
    return faults


def main():
    arguments = sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else []
    if not arguments:
        print("name the files after --")
        sys.exit(2)
    failed = False
    for path in arguments:
        print(path)
        try:
            faults = check(path)
        except Exception as error:  # Blender would go on and exit with 0
            faults = [str(error)]
        print(f"{path}: " + ("whole" if not faults else "MISSING: " + ", ".join(faults)))
        failed = failed or bool(faults)
    sys.stdout.flush()
    sys.exit(1 if failed else 0)


main()

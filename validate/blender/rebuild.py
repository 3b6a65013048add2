"""What `moomill crosscheck` exported, as a Blender scene: meshes, materials, cameras, lights. Used by crosscheck.py; README.md says
where the conventions differ and how they were brought together.
"""
import json
import math
import os

import bpy
import numpy
from mathutils import Matrix

from lobes import METAL_IOR, lobe_tables

AOV = "nnopcs"
# Cycles has meanings of its own for the names "tangent" and "vertex_color".
COLOR, TANGENT, SIDE = "moomill_color", "moomill_tangent", "moomill_side"


# --- reading what moomill wrote ---

class Export:
    def __init__(self, folder):
        self.folder = folder
        with open(os.path.join(folder, "scene.json")) as file:
            self.data = json.load(file)
        if self.data["schema"] != "moomill crosscheck 1":
            raise ValueError(f"{folder}/scene.json has the schema {self.data['schema']}; export it again")

    def array(self, name, kind, *shape):
        values = numpy.fromfile(os.path.join(self.folder, name), dtype=kind)
        return values.reshape(shape)


def srgb_to_linear(bytes_):
    table = numpy.arange(256, dtype=numpy.float64) / 255
    table = numpy.where(table <= 0.04045, table / 12.92, ((table + 0.055) / 1.055) ** 2.4).astype(numpy.float32)
    return table[bytes_]


# --- images ---

def new_image(name, pixels, color_space, is_float):
    """pixels: [height, width, 4], top row first; Blender wants the bottom row first."""
    height, width = pixels.shape[:2]
    image = bpy.data.images.new(name, width, height, alpha=True, float_buffer=is_float, is_data=color_space == "Non-Color")
    image.colorspace_settings.name = color_space
    image.alpha_mode = "CHANNEL_PACKED"
    image.pixels.foreach_set(numpy.ascontiguousarray(pixels[::-1], dtype=numpy.float32).ravel())
    image.update()
    return image


class Images:
    """Each texture once for each use."""

    def __init__(self, export):
        self.export = export
        self.made = {}

    def get(self, index, use):
        """use: `linear` (floats, filtered after the conversion from sRGB), `srgb` (bytes as Blender users have them), `data`."""
        key = (index, use)
        if key not in self.made:
            t = self.export.data["textures"][index]
            raw = self.export.array(t["file"], numpy.uint8, t["height"], t["width"], t["channels"])
            # One and two channels are grey and grey with alpha for colours; for data the last channel repeats.
            if t["channels"] < 3:
                order = [0, 0, 0] if use != "data" else [min(c, t["channels"] - 1) for c in range(3)]
                rgb, alpha = raw[..., order], raw[..., 1:] if t["channels"] == 2 else None
            else:
                rgb, alpha = raw[..., :3], raw[..., 3:] if t["channels"] == 4 else None
            pixels = numpy.ones(raw.shape[:2] + (4,), dtype=numpy.float32)
            pixels[..., :3] = srgb_to_linear(rgb) if use == "linear" else rgb.astype(numpy.float32) / 255
            if alpha is not None:
                pixels[..., 3:] = alpha.astype(numpy.float32) / 255
            space = "sRGB" if use == "srgb" else "Non-Color"
            self.made[key] = new_image(f"texture{index}_{use}", pixels, space, use == "linear")
        return self.made[key]


# --- materials ---

class Nodes:
    """A few words for building node trees; inputs are sockets or constants."""

    def __init__(self, tree):
        self.tree = tree

    def add(self, kind, **properties):
        node = self.tree.nodes.new(kind)
        for name, value in properties.items():
            setattr(node, name, value)
        return node

    def set(self, socket, value):
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(value, socket)
        elif hasattr(socket.default_value, "__len__") and not hasattr(value, "__len__"):
            socket.default_value = [value] * len(socket.default_value)
        elif hasattr(value, "__len__"):
            socket.default_value = list(value) + [1.0] * (len(socket.default_value) - len(value))
        else:
            socket.default_value = value

    def math(self, operation, *values, clamp=False):
        node = self.add("ShaderNodeMath", operation=operation, use_clamp=clamp)
        for socket, value in zip(node.inputs, values):
            self.set(socket, value)
        return node.outputs["Value"]

    def vector(self, operation, *values):
        node = self.add("ShaderNodeVectorMath", operation=operation)
        for socket, value in zip(node.inputs, values):
            self.set(socket, value)
        return node.outputs["Value" if operation == "DOT_PRODUCT" else "Vector"]

    def scale(self, vector, factor):
        node = self.add("ShaderNodeVectorMath", operation="SCALE")
        self.set(node.inputs["Vector"], vector)
        self.set(node.inputs["Scale"], factor)
        return node.outputs["Vector"]

    def attribute(self, name):
        return self.add("ShaderNodeAttribute", attribute_name=name).outputs

    def image(self, image, uv_name, extension, name=""):
        node = self.add("ShaderNodeTexImage", image=image, interpolation="Linear", extension=extension, name=name)
        if uv_name is not None:
            self.set(node.inputs["Vector"], self.add("ShaderNodeUVMap", uv_map=uv_name).outputs["UV"])
        return node

    def split(self, color):
        node = self.add("ShaderNodeSeparateColor")
        self.set(node.inputs["Color"], color)
        return node.outputs


class Materials:
    def __init__(self, export):
        self.export = export
        self.images = Images(export)
        self.made = {}  # (surface, index): material and what a coat changes in it
        self.placements = []  # distinct ones; the k-th has its own UV layer
        for t in export.data["textures"]:
            if t["wrap"] == "mirror":
                raise ValueError(f"texture {t['file']} is mirrored beyond its border, which Blender 3.4 cannot; give it another wrap mode")
            if t["placement"] not in self.placements:
                self.placements.append(t["placement"])
        self.tables = None

    def texture(self, n, index, use, name=""):
        t = self.export.data["textures"][index]
        layer = f"uv{self.placements.index(t['placement'])}"
        return n.image(self.images.get(index, use), layer, {"clamp": "EXTEND", "repeat": "REPEAT"}[t["wrap"]], name)

    def get(self, surface, index):
        if (surface, index) not in self.made:
            self.made[surface, index] = self.build(surface, index)
        return self.made[surface, index]

    def paints(self, index):
        return self.export.data["paints"][self.export.data["materials"][index]["paint"]]

    def build(self, surface, index):
        m = self.export.data["materials"][index]
        material = bpy.data.materials.new(f"{surface}{index}")
        material.use_nodes = True
        material.node_tree.nodes.clear()
        n = Nodes(material.node_tree)
        output = n.add("ShaderNodeOutputMaterial")
        aov = n.add("ShaderNodeOutputAOV", name=AOV)
        n.set(aov.inputs["Color"], n.attribute(AOV)["Vector"])

        # Base colour: a factor, times the coat's texture, times vertex colours. wear() sets what differs between coats.
        first = self.paints(index)[0]
        color = n.add("ShaderNodeRGB", name="factor").outputs["Color"]
        if first["texture"] >= 0:
            color = n.vector("MULTIPLY", color, self.texture(n, first["texture"], "srgb" if surface == "principled" else "linear", "coat").outputs["Color"])
        if first["vertex_colors"] and any(i["colors"] for i in self.export.data["instances"]):
            color = n.vector("MULTIPLY", color, n.attribute(COLOR)["Vector"])

        if surface == "diffuse":
            shader = n.add("ShaderNodeBsdfDiffuse")
            n.set(shader.inputs["Color"], color)
            n.set(shader.inputs["Roughness"], 0.0)
            n.set(shader.inputs["Normal"], self.leaned(n, None))
            closure = shader.outputs["BSDF"]
        else:
            closure = self.shiny(n, surface, m, color)
        if m["alpha_cutoff"] >= 0:
            alpha = m["alpha"]
            if m["alpha_texture"] >= 0:
                alpha = n.math("MULTIPLY", self.texture(n, m["alpha_texture"], "data").outputs["Alpha"], alpha)
            mix = n.add("ShaderNodeMixShader")
            n.set(mix.inputs["Fac"], n.math("LESS_THAN", alpha, m["alpha_cutoff"]))
            n.set(mix.inputs[1], closure)
            n.set(mix.inputs[2], n.add("ShaderNodeBsdfTransparent").outputs["BSDF"])
            closure = mix.outputs["Shader"]
        n.set(output.inputs["Surface"], closure)
        return material

    def shiny(self, n, surface, m, color):
        roughness, metallic = m["roughness"], m["metallic"]
        if m["metallic_roughness_texture"] >= 0:
            channels = n.split(self.texture(n, m["metallic_roughness_texture"], "data").outputs["Color"])
            roughness = n.math("MULTIPLY", channels["Green"], roughness)
            metallic = n.math("MULTIPLY", channels["Blue"], metallic) if metallic > 0 else 0.0
        normal = None
        if m["normal_texture"] >= 0:
            texel = self.texture(n, m["normal_texture"], "data").outputs["Color"]
            normal = self.blender_normal(n, m, texel) if surface == "principled" else self.normal(n, m, texel)
        if surface == "principled":
            shader = self.principled(n, color, roughness, metallic, normal)
            return shader.outputs["BSDF"]

        roughness = n.math("MAXIMUM", roughness, math.sqrt(1e-3))  # moomill's smallest alpha
        normal = self.leaned(n, normal)
        eye = n.add("ShaderNodeNewGeometry").outputs["Incoming"]
        es, ed, es_ratio, ed_ratio, schlick_ratio = self.look_up(n, n.vector("DOT_PRODUCT", normal, eye), roughness)

        matt = n.add("ShaderNodeBsdfDiffuse")
        n.set(matt.inputs["Color"], n.scale(color, n.math("SUBTRACT", 1.0, ed)))
        n.set(matt.inputs["Roughness"], 0.0)
        n.set(matt.inputs["Normal"], normal)
        lobe = self.principled(n, (0.0, 0.0, 0.0), roughness, 0.0, normal).outputs["BSDF"]
        both = self.sum(n, matt.outputs["BSDF"], self.times(n, lobe, ed_ratio))
        if not isinstance(metallic, bpy.types.NodeSocket) and metallic == 0:
            return both
        mix = n.add("ShaderNodeMixShader")
        n.set(mix.inputs["Fac"], metallic)
        n.set(mix.inputs[1], both)
        n.set(mix.inputs[2], self.metal(n, color, roughness, normal, es, es_ratio, schlick_ratio))
        return mix.outputs["Shader"]

    @staticmethod
    def leaned(n, normal):
        """As moomill does: a shading normal (none: the mesh's) that leans away from the eye is leaned back, to a cosine of about 0.02."""
        geometry = n.add("ShaderNodeNewGeometry").outputs
        normal = normal or geometry["Normal"]
        missing = n.math("MAXIMUM", n.math("SUBTRACT", 0.02, n.vector("DOT_PRODUCT", normal, geometry["Incoming"])), 0.0)
        return n.vector("NORMALIZE", n.vector("ADD", normal, n.scale(geometry["Incoming"], missing)))

    def look_up(self, n, cosine, roughness):
        if self.tables is None:
            table = lobe_tables()
            self.tables = []
            for k in (0, 2):
                pixels = numpy.ones(table.shape[:2] + (4,), dtype=numpy.float32)
                pixels[..., :3] = table[::-1, :, k:k + 3]  # row of roughness 0 at the bottom, where v is 0
                self.tables.append(new_image(f"lobes{k}", pixels, "Non-Color", True))
        place = n.add("ShaderNodeCombineXYZ")
        n.set(place.inputs["X"], n.math("DIVIDE", n.math("ADD", n.math("MULTIPLY", n.math("SQRT", n.math("MAXIMUM", cosine, 0.0)), 63.0), 0.5), 64.0))
        n.set(place.inputs["Y"], n.math("DIVIDE", n.math("ADD", n.math("MULTIPLY", roughness, 64.0), 0.5), 65.0))
        out = []
        for image in self.tables:
            node = n.image(image, None, "EXTEND")
            n.set(node.inputs["Vector"], place.outputs["Vector"])
            out.append(n.split(node.outputs["Color"]))
        return out[0]["Red"], out[0]["Green"], out[1]["Red"], out[1]["Green"], out[1]["Blue"]

    def metal(self, n, color, roughness, normal, es, es_ratio, schlick_ratio):
        """moomill's metal is F (1 + b k) with Schlick's F = b + (1 - b) s and Turquin's k = (1 - Es) / Es. Here b is a Glossy BSDF, and s
        the dielectric's curve of METAL_IOR, scaled so that its albedo is that of s. How much of s differs between channels, but a
        closure has one weight: it gets that of the darkest channel, and in the others a base colour takes away what is too much."""
        k = n.math("DIVIDE", n.math("SUBTRACT", 1.0, es), es)
        gain = n.vector("ADD", n.scale(color, k), (1.0, 1.0, 1.0))
        edge = n.scale(n.vector("MULTIPLY", n.vector("SUBTRACT", (1.0, 1.0, 1.0), color), gain), schlick_ratio)
        part = n.add("ShaderNodeSeparateXYZ")
        n.set(part.inputs["Vector"], edge)
        most = n.math("MAXIMUM", n.math("MAXIMUM", part.outputs["X"], part.outputs["Y"]), n.math("MAXIMUM", part.outputs["Z"], 1e-4))
        tint = n.vector("SUBTRACT", (1.0, 1.0, 1.0), n.scale(edge, n.math("DIVIDE", 1.0, most)))
        lobe = self.principled(n, tint, roughness, 1.0, normal)
        n.set(lobe.inputs["Specular"], ((METAL_IOR - 1) / (METAL_IOR + 1)) ** 2 / 0.08)
        even = n.add("ShaderNodeBsdfGlossy", distribution="GGX")
        n.set(even.inputs["Color"], n.vector("SUBTRACT", n.scale(n.vector("MULTIPLY", color, gain), es_ratio), n.scale(tint, most)))
        n.set(even.inputs["Roughness"], roughness)
        n.set(even.inputs["Normal"], normal)
        return self.sum(n, self.times(n, lobe.outputs["BSDF"], most), even.outputs["BSDF"])

    @staticmethod
    def times(n, closure, factor):
        """A closure times 0 to 2: a Mix Shader with nothing clamps its factor to 1, so what is above comes from a second."""
        parts = []
        for f in (factor, n.math("SUBTRACT", factor, 1.0)):
            mix = n.add("ShaderNodeMixShader")
            n.set(mix.inputs["Fac"], f)
            n.set(mix.inputs[2], closure)
            parts.append(mix.outputs["Shader"])
        return Materials.sum(n, *parts)

    @staticmethod
    def sum(n, a, b):
        both = n.add("ShaderNodeAddShader")
        n.set(both.inputs[0], a)
        n.set(both.inputs[1], b)
        return both.outputs["Shader"]

    @staticmethod
    def principled(n, color, roughness, metallic, normal, distribution="GGX"):
        shader = n.add("ShaderNodeBsdfPrincipled", distribution=distribution)
        n.set(shader.inputs["Base Color"], color)
        n.set(shader.inputs["Roughness"], roughness)
        n.set(shader.inputs["Metallic"], metallic)
        n.set(shader.inputs["Specular"], 0.5)  # a reflectance of 0.04 head on: IOR 1.5
        n.set(shader.inputs["Sheen"], 0.0)
        n.set(shader.inputs["Clearcoat"], 0.0)
        if normal:
            n.set(shader.inputs["Normal"], normal)
        return shader

    @staticmethod
    def blender_normal(n, m, texel):
        node = n.add("ShaderNodeNormalMap", space="TANGENT", uv_map="uv0")
        n.set(node.inputs["Strength"], m["normal_scale"])
        n.set(node.inputs["Color"], texel)
        return node.outputs["Normal"]

    @staticmethod
    def normal(n, m, texel):
        """moomill's frame: x along u of the triangle, made square to the shading normal (Blender's node would take MikkTSpace's,
        smoothed over vertices)."""
        up = n.add("ShaderNodeNewGeometry").outputs["Normal"]
        tangent = n.attribute(TANGENT)["Vector"]
        x = n.vector("NORMALIZE", n.vector("SUBTRACT", tangent, n.scale(up, n.vector("DOT_PRODUCT", up, tangent))))
        y = n.scale(n.vector("CROSS_PRODUCT", up, x), n.attribute(SIDE)["Fac"])
        local = n.vector("SUBTRACT", n.scale(texel, 2.0), (1.0, 1.0, 1.0))
        part = n.add("ShaderNodeSeparateXYZ")
        n.set(part.inputs["Vector"], local)
        across = n.vector("ADD", n.scale(x, n.math("MULTIPLY", part.outputs["X"], m["normal_scale"])),
                          n.scale(y, n.math("MULTIPLY", part.outputs["Y"], m["normal_scale"])))
        return n.vector("NORMALIZE", n.vector("ADD", across, n.scale(up, part.outputs["Z"])))

    def wear(self, surface, coat):
        """Dresses every material of this surface in the coat at this place of the exported list."""
        for (s, index), material in self.made.items():
            if s != surface:
                continue
            paint = self.paints(index)[coat]
            material.node_tree.nodes["factor"].outputs["Color"].default_value = list(paint["factor"]) + [1.0]
            if paint["texture"] >= 0:
                material.node_tree.nodes["coat"].image = self.images.get(paint["texture"], "srgb" if surface == "principled" else "linear")


# --- geometry, cameras, lights ---

def build_mesh(export, instance, number, materials):
    vertices, triangles = instance["vertices"], instance["triangles"]
    positions = export.array(instance["positions"], numpy.float32, vertices, 3)
    faces = export.array(instance["faces"], numpy.uint32, triangles, 3)
    mesh = bpy.data.meshes.new(f"instance{number}")
    mesh.vertices.add(vertices)
    mesh.vertices.foreach_set("co", positions.ravel())
    mesh.loops.add(3 * triangles)
    mesh.loops.foreach_set("vertex_index", faces.astype(numpy.int32).ravel())
    mesh.polygons.add(triangles)
    mesh.polygons.foreach_set("loop_start", numpy.arange(0, 3 * triangles, 3, dtype=numpy.int32))
    mesh.polygons.foreach_set("loop_total", numpy.full(triangles, 3, dtype=numpy.int32))
    mesh.polygons.foreach_set("material_index", export.array(instance["face_materials"], numpy.uint16, triangles).astype(numpy.int32))
    mesh.polygons.foreach_set("use_smooth", numpy.ones(triangles, dtype=bool))
    mesh.update(calc_edges=True)

    def attribute(name, kind, domain, values, member):
        mesh.attributes.new(name, kind, domain).data.foreach_set(member, numpy.ascontiguousarray(values, dtype=numpy.float32).ravel())

    if instance["nnopcs"]:
        attribute(AOV, "FLOAT_VECTOR", "POINT", export.array(instance["nnopcs"], numpy.float32, vertices, 3), "vector")
    if instance["colors"]:
        attribute(COLOR, "FLOAT_VECTOR", "POINT", export.array(instance["colors"], numpy.float32, vertices, 3), "vector")
    if instance["uvs"]:
        uv = export.array(instance["uvs"], numpy.float32, vertices, 2).astype(numpy.float64)
        for k, p in enumerate(materials.placements):
            q = uv * p["scale"]
            c, s = math.cos(p["rotation"]), math.sin(p["rotation"])
            q = numpy.stack([c * q[:, 0] + s * q[:, 1], -s * q[:, 0] + c * q[:, 1]], axis=1) + p["offset"]
            q[:, 1] = 1 - q[:, 1]  # glTF counts v from the top, Blender from the bottom
            mesh.uv_layers.new(name=f"uv{k}").data.foreach_set("uv", q[faces.ravel()].astype(numpy.float32).ravel())
        corner, edge1, edge2 = (positions[faces[:, 0]].astype(numpy.float64), positions[faces[:, 1]], positions[faces[:, 2]])
        edge1, edge2 = edge1 - corner, edge2 - corner
        d1, d2 = uv[faces[:, 1]] - uv[faces[:, 0]], uv[faces[:, 2]] - uv[faces[:, 0]]
        det = d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]
        sign = numpy.where(det < 0, -1.0, 1.0)
        tangent = (edge1 * d2[:, 1:] - edge2 * d1[:, 1:]) * sign[:, None]
        # Tiny triangles in a tiny atlas would give tangents of 1e-12, which nodes take for nothing.
        tangent /= numpy.maximum(numpy.linalg.norm(tangent, axis=1), 1e-30)[:, None]
        attribute(TANGENT, "FLOAT_VECTOR", "FACE", tangent, "vector")
        attribute(SIDE, "FLOAT", "FACE", -sign, "value")
    mesh.use_auto_smooth = True  # or custom normals would not be used
    mesh.normals_split_custom_set_from_vertices(export.array(instance["normals"], numpy.float32, vertices, 3).tolist())
    thing = bpy.data.objects.new(f"instance{number}", mesh)
    thing.pass_index = number + 1
    thing.cycles.shadow_terminator_offset = 0.0
    thing.cycles.shadow_terminator_geometry_offset = 0.0
    bpy.context.scene.collection.objects.link(thing)
    return thing


def place_camera(scene, camera, scale):
    """OpenCV's K and world_to_camera to Blender's camera (-Z forward, +Y up; lens, sensor and shift in widths)."""
    width, height = camera["width"], camera["height"]
    fx, fy, cx, cy = camera["fx"], camera["fy"], camera["cx"], camera["cy"]
    data, thing = scene.camera.data, scene.camera
    scene.render.resolution_x, scene.render.resolution_y = width * scale, height * scale
    scene.render.resolution_percentage = 100
    scene.render.pixel_aspect_x = max(1.0, fy / fx)
    scene.render.pixel_aspect_y = max(1.0, fx / fy)
    data.type = "PERSP"
    data.sensor_fit = "HORIZONTAL"
    data.sensor_width = 36.0
    data.lens = fx * data.sensor_width / width
    data.shift_x = 0.5 - cx / width
    # Shifts count in widths of the picture, also upwards, with pixels as they are on the sensor.
    data.shift_y = (cy - 0.5 * height) / width * (scene.render.pixel_aspect_y / scene.render.pixel_aspect_x)
    data.clip_start, data.clip_end = 1e-3, 1e6
    data.dof.use_dof = False
    thing.matrix_world = Matrix(world_of(camera).tolist())  # nested lists would be taken for columns


def world_of(camera):
    """Where a camera of Blender's axes stands in the exported world, [4, 4]."""
    m = numpy.array(camera["world_to_camera"], dtype=numpy.float64).reshape(3, 4)
    world = numpy.eye(4)
    world[:3, :3] = m[:, :3].T @ numpy.diag([1.0, -1.0, -1.0])
    world[:3, 3] = -m[:, :3].T @ m[:, 3]
    return world


def move_to_camera(export, things, camera):
    """Moves the vertices into the camera's own axes, in double, and the camera to the origin. Cycles' floats then round the
    turn of the camera not at all and the direction of a ray, seen from its origin, by a tenth; without a camera the
    vertices go back to the exported world."""
    for thing, instance in zip(things, export.data["instances"]):
        positions = export.array(instance["positions"], numpy.float32, instance["vertices"], 3)
        if camera is not None:
            inverse = numpy.linalg.inv(world_of(camera))
            positions = positions.astype(numpy.float64) @ inverse[:3, :3].T + inverse[:3, 3]
        thing.data.vertices.foreach_set("co", positions.astype(numpy.float32).ravel())
        thing.data.update()
        thing.update_tag()
    if camera is not None:
        bpy.context.scene.camera.matrix_world = Matrix.Identity(4)


def build_lights(export, lights):
    """Of one view; takes the place of those there were."""
    scene = bpy.context.scene
    for thing in [o for o in scene.objects if o.type == "LIGHT"]:
        data = thing.data
        bpy.data.objects.remove(thing)
        bpy.data.lights.remove(data)
    world = scene.world or bpy.data.worlds.new("sky")
    scene.world = world
    world.use_nodes = True
    world.node_tree.nodes.clear()
    n = Nodes(world.node_tree)
    background = n.add("ShaderNodeBackground")
    n.set(n.add("ShaderNodeOutputWorld").inputs["Surface"], background.outputs["Background"])
    n.set(background.inputs["Strength"], 1.0)
    sky = lights["environment"]
    if sky["map"]:
        e = sky["map"]
        rgb = export.array(e["file"], numpy.float32, e["height"], e["width"], 3)
        pixels = numpy.ones(rgb.shape[:2] + (4,), dtype=numpy.float32)
        pixels[..., :3] = rgb
        texture = n.add("ShaderNodeTexEnvironment", image=new_image("sky", pixels, "Non-Color", True), interpolation="Closest", projection="EQUIRECTANGULAR")
        # moomill: u = 1/2 - (azimuth + 90 deg - yaw) / 360 deg; Blender: u = 1/2 - azimuth / 360 deg.
        mapping = n.add("ShaderNodeMapping", vector_type="POINT")
        n.set(mapping.inputs["Vector"], n.add("ShaderNodeTexCoord").outputs["Generated"])
        n.set(mapping.inputs["Rotation"], (0.0, 0.0, math.pi / 2 - sky["yaw_rad"]))
        n.set(texture.inputs["Vector"], mapping.outputs["Vector"])
        n.set(background.inputs["Color"], texture.outputs["Color"])
        world.cycles.sampling_method = "MANUAL"
        world.cycles.sample_map_resolution = e["width"]
    else:
        n.set(background.inputs["Color"], sky["constant"])
        world.cycles.sampling_method = "NONE"  # even: left to BSDF sampling, as moomill does

    def add(name, kind, color, z_axis, place):
        data = bpy.data.lights.new(name, kind)
        strength = max(color)
        data.color = [c / strength for c in color] if strength > 0 else (0, 0, 0)
        data.cycles.use_multiple_importance_sampling = True
        data.cycles.max_bounces = 1024
        thing = bpy.data.objects.new(name, data)
        thing.visible_camera = False
        # Lights of Blender shine along -Z.
        z = numpy.array(z_axis, dtype=numpy.float64)
        z /= numpy.linalg.norm(z)
        x = place.get("x")
        if x is None:
            x = numpy.cross([0.0, 1.0, 0.0] if abs(z[2]) > 0.9 else [0.0, 0.0, 1.0], z)
        x = numpy.array(x, dtype=numpy.float64) / numpy.linalg.norm(x)
        world_matrix = numpy.eye(4)
        world_matrix[:3, :3] = numpy.stack([x, numpy.cross(z, x), z], axis=1)
        world_matrix[:3, 3] = place.get("centre", (0, 0, 0))
        thing.matrix_world = Matrix(world_matrix.tolist())
        scene.collection.objects.link(thing)
        return data, strength

    for i, s in enumerate(lights["suns"]):
        data, strength = add(f"sun{i}", "SUN", s["irradiance"], s["direction"], {})
        data.energy = strength  # W/m^2 on a surface that faces it
        data.angle = 2 * s["angular_radius_rad"]
    for i, r in enumerate(lights["rectangles"]):
        u, v = numpy.array(r["edge_u"]), numpy.array(r["edge_v"])
        data, strength = add(f"rectangle{i}", "AREA", r["radiance"], -numpy.cross(u, v),
                             {"x": u, "centre": numpy.array(r["corner"]) + 0.5 * (u + v)})
        data.shape = "RECTANGLE"
        data.size, data.size_y = float(numpy.linalg.norm(u)), float(numpy.linalg.norm(v))
        data.energy = 4 * strength * data.size * data.size_y  # Cycles makes a radiance of energy / (4 area)

"""Renders white furnaces, or edges of shadow if SCENE has "edge": `blender -b --factory-startup --python
scene.py -- SCENE.json MEANS.json`.

A camera that sees in parallel looks straight down on slabs of 1 m, each in uniform white light, or in a
sun straight above that reaches the right half and which a white diffuse surface returns as 1. A slab of
SCENE is {"lines": Python that sets the inputs of `bsdf`, a Principled BSDF} or {"eta", "g",
"sigma_a", "sigma_s"}: a volume of coefficients in 1/m, three each, behind a smooth glass. MEANS gets
for each slab the mean and its standard error, of red, green and blue, off the slab's edges; of edges
of shadow those of each column of pixels."""

import json
import sys

import bpy  # type: ignore[import]
import numpy as np

ROWS, EDGE = 40, 200  # pixels of a slab, and of one with an edge from left to right


def principled(tree, slab) -> None:
    """Nothing but the walk: no reflection of the surface."""
    node = tree.nodes["Principled BSDF"]
    node.inputs["Specular"].default_value = 0
    node.inputs["Roughness"].default_value = 0.4
    exec(slab["lines"], {"bsdf": node})


def volume(tree, slab) -> None:
    def add(kind: str, **inputs):
        node = tree.nodes.new("ShaderNode" + kind)
        for name, value in inputs.items():
            node.inputs[name].default_value = value
        return node

    tree.nodes.clear()
    output, both = add("OutputMaterial"), add("AddShader")
    glass = add("BsdfGlass", IOR=slab["eta"], Color=(1, 1, 1, 1))
    glass.distribution = "SHARP"
    tree.links.new(glass.outputs[0], output.inputs["Surface"])
    tree.links.new(both.outputs[0], output.inputs["Volume"])
    s, a = max(slab["sigma_s"]), max(slab["sigma_a"])
    scatter = (*(one / s for one in slab["sigma_s"]), 1)
    absorb = (*(1 - one / a for one in slab["sigma_a"]), 1)
    parts = [add("VolumeScatter", Density=s, Anisotropy=slab["g"], Color=scatter),
             add("VolumeAbsorption", Density=a, Color=absorb)]  # fmt: skip
    for socket, part in zip(both.inputs, parts):
        tree.links.new(part.outputs[0], socket)


def light_edges(scene, count: int) -> None:
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy, sun.data.angle = np.pi, 0
    scene.collection.objects.link(sun)
    black = bpy.data.materials.new("black")
    black.diffuse_color = (0, 0, 0, 1)
    black.use_nodes = True
    black.node_tree.nodes.clear()
    for i in range(count):
        bpy.ops.mesh.primitive_plane_add(size=1, location=(i - 0.25, 0, 2))
        bpy.context.object.data.materials.append(black)
        bpy.context.object.scale = (0.5, 2, 1)
        bpy.context.object.visible_camera = False


def render(scene, slabs, samples: int, side: int, file: str) -> None:
    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.device, cycles.samples = "CPU", samples
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    for kind in ("", "diffuse_", "glossy_", "transmission_"):
        setattr(cycles, kind + ("bounces" if kind else "max_bounces"), 1024)
    cycles.volume_bounces, cycles.sample_clamp_indirect, cycles.blur_glossy = 1024, 0, 0
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 0.01
    scene.world = bpy.data.worlds.new("white")
    scene.world.use_nodes = True
    white = float(side == ROWS)
    scene.world.node_tree.nodes["Background"].inputs[0].default_value = (white, white, white, 1)
    if side == EDGE:
        light_edges(scene, len(slabs))
    for i, slab in enumerate(slabs):
        bpy.ops.mesh.primitive_cube_add(size=1, location=(i, 0, 0))
        material = bpy.data.materials.new(f"slab {i}")
        material.use_nodes = True
        (principled if "lines" in slab else volume)(material.node_tree, slab)
        bpy.context.object.data.materials.append(material)
        bpy.context.object.scale = (0.99, 0.99, 1)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    camera.data.type, camera.data.ortho_scale = "ORTHO", len(slabs)
    camera.location = ((len(slabs) - 1) / 2, 0, 5)
    scene.render.resolution_x, scene.render.resolution_y = side * len(slabs), ROWS
    scene.render.threads_mode, scene.render.threads = "FIXED", 2
    scene.view_settings.view_transform = "Raw"
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.filepath = file
    bpy.ops.render.render(write_still=True)


def main() -> None:
    source, target = sys.argv[sys.argv.index("--") + 1 :]
    with open(source) as file:
        asked = json.load(file)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    side = EDGE if asked.get("edge") else ROWS
    render(bpy.context.scene, asked["slabs"], asked["samples"], side, target + ".exr")
    image = bpy.data.images.load(target + ".exr")
    image.colorspace_settings.name = "Non-Color"
    pixels = np.array(image.pixels[:]).reshape(ROWS, -1, 4)[..., :3]
    means = []
    for i in range(len(asked["slabs"])):
        part = pixels[:, i * side : (i + 1) * side]
        part = part if side == EDGE else part[4:-4, 4:-4].reshape(-1, 3)
        means.append([part.mean(0).tolist(), (part.std(0) / len(part) ** 0.5).tolist()])
    with open(target, "w") as file:
        json.dump(means, file)


main()

"""Renders white furnaces: `blender -b --factory-startup --python scene.py -- SCENE.json MEANS.json`.

A camera that sees in parallel looks straight down on slabs of 1 m, each in uniform white light. A slab
of SCENE is {"lines": Python that sets the inputs of `bsdf`, a Principled BSDF} or {"eta", "g",
"sigma_a", "sigma_s"}: a volume of coefficients in 1/m, three each, behind a smooth glass. MEANS gets
for each slab the mean and its standard error, of red, green and blue, off the slab's edges."""

from __future__ import annotations

import json
import sys

import bpy  # type: ignore[import]
import numpy as np

SIDE = 40  # pixels of a slab


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


def render(scene, slabs, samples: int, file: str) -> None:
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
    scene.world.node_tree.nodes["Background"].inputs[0].default_value = (1, 1, 1, 1)
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
    scene.render.resolution_x, scene.render.resolution_y = SIDE * len(slabs), SIDE
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
    render(bpy.context.scene, asked["slabs"], asked["samples"], target + ".exr")
    image = bpy.data.images.load(target + ".exr")
    image.colorspace_settings.name = "Non-Color"
    pixels = np.array(image.pixels[:]).reshape(SIDE, -1, 4)[..., :3]
    means = []
    for i in range(len(asked["slabs"])):
        part = pixels[4:-4, i * SIDE + 4 : (i + 1) * SIDE - 4].reshape(-1, 3)
        means.append([part.mean(0).tolist(), (part.std(0) / len(part) ** 0.5).tolist()])
    with open(target, "w") as file:
        json.dump(means, file)


main()

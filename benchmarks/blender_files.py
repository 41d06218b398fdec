"""Files as Blender 5 writes them: view layers, the compositor's result, stereo; each read back without options.

Two interpreters: ``bpy`` has its own (Python 3.11, NumPy 1), so files are made by it and read by the product's.

    python3.11 -m venv blender && blender/bin/pip install bpy==5.0.1 "numpy<2"
    blender/bin/python benchmarks/blender_files.py make FOLDER
    python benchmarks/blender_files.py read FOLDER

The scene is a card at 2 m that fills the left half of the picture, before a wall at 8 m; card and wall shine by
themselves, so that every value is known: colour, depth in metres, motion in px per frame.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path

WIDTH, HEIGHT = 96, 64
NEAR_M, FAR_M = 2.0, 8.0
STEP_M = 0.1
"""How far the card moves to the right in a frame."""
FOCAL_MM, SENSOR_MM = 50.0, 36.0
COLOUR_TOLERANCE = 0.01
"""Relative: Cycles estimates emission, too."""
NEAR_COLOUR, FAR_COLOUR = (0.8, 0.1, 0.05), (0.2, 0.4, 0.6)


def make(folder: Path) -> None:
    """Render and write the files; needs ``bpy``."""
    import bpy

    _scene(bpy)
    _render(bpy, folder / "single_layer.exr")
    image = bpy.context.scene.render.image_settings
    image.use_exr_interleave = True  # all channels in one part
    _render(bpy, folder / "interleaved.exr")
    image.use_exr_interleave = False
    _second_layer(bpy)
    _render(bpy, folder / "two_layers.exr")
    _compositor(bpy)
    _render(bpy, folder / "compositor.exr")
    bpy.context.scene.render.use_compositing = False
    bpy.context.scene.render.use_multiview = True
    image.views_format = "MULTIVIEW"
    _render(bpy, folder / "stereo.exr")


def _scene(bpy) -> None:
    """Build the scene: a camera that looks along y, the wall, and the card that moves."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    render = scene.render
    render.engine, scene.cycles.samples, scene.cycles.pixel_filter_type = "CYCLES", 1, "BOX"
    render.resolution_x, render.resolution_y, render.resolution_percentage = WIDTH, HEIGHT, 100
    scene.view_layers[0].name = "ViewLayer"
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.lens, camera.data.sensor_width = FOCAL_MM, SENSOR_MM
    camera.rotation_euler = (1.5707963267948966, 0, 0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    _card(bpy, "wall", FAR_M, 0.0, 20.0, FAR_COLOUR)
    card = _card(bpy, "card", NEAR_M, -1.0, 2.0, NEAR_COLOUR)
    for frame in (0, 1, 2):
        card.location.x = -1.0 + STEP_M * (frame - 1)
        card.keyframe_insert("location", frame=frame)
    for curve in _curves(card):
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"
    scene.frame_set(1)
    _passes(scene.view_layers[0])
    image = render.image_settings
    image.media_type, image.file_format, image.color_depth = "MULTI_LAYER_IMAGE", "OPEN_EXR_MULTILAYER", "32"


def _curves(item) -> list:
    """Return the animation curves of an object, wherever this version keeps them."""
    action = item.animation_data.action
    return [
        curve for layer in action.layers for strip in layer.strips for bag in strip.channelbags for curve in bag.fcurves
    ]


def _card(bpy, name: str, depth: float, x: float, size: float, colour: tuple[float, float, float]):
    """Add a square that faces the camera and shines."""
    half = size / 2
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(-half, 0, -half), (half, 0, -half), (half, 0, half), (-half, 0, half)], [], [(0, 1, 2, 3)])
    material = bpy.data.materials.new(name)
    nodes = material.node_tree.nodes
    nodes.clear()
    light, output = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
    light.inputs["Color"].default_value = (*colour, 1)
    material.node_tree.links.new(light.outputs[0], output.inputs[0])
    mesh.materials.append(material)
    item = bpy.data.objects.new(name, mesh)
    item.location = (x, depth, 0)
    bpy.context.scene.collection.objects.link(item)
    return item


def _passes(layer) -> None:
    layer.use_pass_z = layer.use_pass_vector = layer.use_pass_normal = layer.use_pass_mist = True


def _second_layer(bpy) -> None:
    """Add a view layer whose picture is another: without the card."""
    scene = bpy.context.scene
    collection = bpy.data.collections.new("cards")
    scene.collection.children.link(collection)
    card = bpy.data.objects["card"]
    scene.collection.objects.unlink(card)
    collection.objects.link(card)
    layer = scene.view_layers.new("Background")
    layer.layer_collection.children["cards"].exclude = True
    _passes(layer)


def _compositor(bpy) -> None:
    """Let the compositor pass the first layer's picture on, half as bright."""
    scene = bpy.context.scene
    tree = bpy.data.node_groups.new("composite", "CompositorNodeTree")
    tree.interface.new_socket(name="Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    layers, exposure, output = (
        tree.nodes.new(kind) for kind in ("CompositorNodeRLayers", "CompositorNodeExposure", "NodeGroupOutput")
    )
    exposure.inputs["Exposure"].default_value = -1.0
    tree.links.new(layers.outputs["Image"], exposure.inputs["Image"])
    tree.links.new(exposure.outputs[0], output.inputs[0])
    scene.compositing_node_group = tree
    scene.render.use_compositing = True


def _render(bpy, path: Path) -> None:
    bpy.context.scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)


# --- Reading -------------------------------------------------------------------------------------------------------


def read(folder: Path) -> int:
    """Read every file without options and compare it with what the scene is; return how many differ."""
    wrong = 0
    for path in sorted(folder.glob("*.exr")):
        error = _compare(path)
        print(f"{path.name:20} {error or 'as rendered'}")
        wrong += bool(error)
    return wrong


def _compare(path: Path) -> str:
    """Return what differs between a file's frame and the scene, or nothing."""
    import numpy as np

    import spreadlets as sp

    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            frame = sp.read_frame(path)
        except sp.errors.SpreadletsError as error:
            return str(error)
    for each in told:
        print(f"    {each.message}")
    exposure = 0.5 if path.stem == "compositor" else 1.0
    shift = STEP_M * FOCAL_MM / SENSOR_MM * WIDTH / NEAR_M  # px per frame
    row, sides = HEIGHT // 2, {"card": (8, NEAR_COLOUR, NEAR_M, shift), "wall": (WIDTH - 8, FAR_COLOUR, FAR_M, 0.0)}
    for name, (col, colour, depth, motion) in sides.items():
        found = frame.radiance[row, col, :3], frame.depth[row, col], frame.motion[row, col]
        if not np.allclose(found[0], np.multiply(exposure, colour), rtol=COLOUR_TOLERANCE):
            return f"{name}: colour {found[0]}"
        if not np.isclose(found[1], depth, rtol=1e-4):
            return f"{name}: depth {found[1]}"
        if not np.allclose(found[2], (motion, 0), atol=0.01):
            return f"{name}: motion {found[2]}, not {motion}"
    return ""


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("make", "read"))
    parser.add_argument("folder", type=Path)
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    if given.what == "make":
        make(given.folder)
    else:
        sys.exit(read(given.folder) > 0)

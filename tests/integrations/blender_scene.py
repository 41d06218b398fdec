"""Run by a Python that has `bpy`: a small scene, blurred by the extension and by Cycles itself; prints what happened.

    python blender_scene.py FOLDER PROGRAM [--size 256] [--samples 256]

PROGRAM is the command or a Python for the preferences; "" takes the package in this Python.
"""

import argparse
import importlib.util
import json
import sys
import time
from pathlib import Path

import bpy

EXTENSION = Path(__file__).resolve().parents[2] / "integrations" / "blender"
PINHOLE_SAMPLES = 64


def load_extension():
    """Import the extension from its folder, as Blender does under a name of its own, and register it."""
    name = "spreadlets_extension"
    spec = importlib.util.spec_from_file_location(
        name, EXTENSION / "__init__.py", submodule_search_locations=[str(EXTENSION)]
    )
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    module.register()
    return module


def material(name, colours, scale=None):
    """A material that shines in one colour, or as a checkerboard of two."""
    made = bpy.data.materials.new(name)
    if bpy.app.version < (5,):
        made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    light, output = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(light.outputs[0], output.inputs[0])
    light.inputs["Color"].default_value = (*colours[0], 1)
    if scale:
        checker, place = tree.nodes.new("ShaderNodeTexChecker"), tree.nodes.new("ShaderNodeTexCoord")
        checker.inputs["Scale"].default_value = scale
        for socket, colour in zip(("Color1", "Color2"), colours, strict=True):
            checker.inputs[socket].default_value = (*colour, 1)
        tree.links.new(place.outputs["Generated"], checker.inputs["Vector"])
        tree.links.new(checker.outputs["Color"], light.inputs["Color"])
    return made


def ball(name, place, radius, made):
    bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=24, radius=radius, location=place)
    item = bpy.context.object
    item.name = name
    item.data.materials.append(made)
    bpy.ops.object.shade_smooth()
    return item


def curves(item):
    """Curves of an animation, wherever this version of Blender keeps them."""
    action = item.animation_data.action
    if hasattr(action, "fcurves"):
        return list(action.fcurves)
    bags = (bag for layer in action.layers for strip in layer.strips for bag in strip.channelbags)
    return [curve for bag in bags for curve in bag.fcurves]


def build_scene(size):
    """A wall, a floor, balls from near to far, lamps far away; one ball flies, and the focus follows another."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.device, scene.cycles.use_denoising = "CYCLES", "CPU", False
    scene.render.resolution_x = scene.render.resolution_y = size
    bpy.ops.mesh.primitive_plane_add(size=40, location=(0, 12, 0), rotation=(1.5707963, 0, 0))
    bpy.context.object.data.materials.append(material("wall", ((0.02, 0.03, 0.08), (0.05, 0.06, 0.12)), 24.0))
    bpy.ops.mesh.primitive_plane_add(size=40, location=(0, 0, -1))
    bpy.context.object.data.materials.append(material("floor", ((0.30, 0.28, 0.25), (0.12, 0.11, 0.10)), 40.0))
    ball("near", (-0.55, 2.2, -0.3), 0.28, material("near", ((0.7, 0.15, 0.08), (0.5, 0.4, 0.3)), 6.0))
    middle = ball("middle", (0.1, 4.0, -0.35), 0.6, material("middle", ((0.1, 0.45, 0.2), (0.6, 0.6, 0.5)), 8.0))
    flying = ball("flying", (1.2, 5.0, 0.7), 0.4, material("flying", ((0.8, 0.6, 0.1), (0.2, 0.1, 0.4)), 5.0))
    lamp = material("lamp", ((9.0, 7.0, 4.0),))
    for index in range(7):
        ball(f"lamp{index}", (-3.0 + index, 11.0, 1.2 + 0.5 * (index % 3)), 0.09, lamp)
    for frame in (0, 1, 2):
        flying.location.x = 1.2 + 0.12 * (frame - 1)
        flying.keyframe_insert("location", frame=frame)
    # Vectors are those of straight paths from frame to frame.
    for curve in curves(flying):
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.rotation_euler = (1.5707963, 0, 0)
    camera.data.lens, camera.data.sensor_width = 50.0, 36.0
    camera.data.dof.use_dof, camera.data.dof.aperture_fstop, camera.data.dof.focus_object = True, 0.4, middle
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 0.5
    scene.frame_set(1)
    return scene


def settings_of(scene):
    """All that the extension may have changed."""
    image, render, layer = scene.render.image_settings, scene.render, scene.view_layers[0]
    owners = (image, render, layer, scene.camera.data.dof, scene)
    return [
        (type(owner).__name__, name, str(getattr(owner, name)))
        for owner in owners
        for name in sorted(each.identifier for each in owner.bl_rna.properties)
        if name not in ("rna_type", "use_nodes")
    ]


def cycles(scene, path, samples):
    """Render with Cycles' own blur."""
    before = scene.render.filepath, scene.render.image_settings.file_format, scene.cycles.samples
    scene.render.filepath, scene.render.image_settings.file_format = str(path), "OPEN_EXR"
    scene.cycles.samples = samples
    bpy.ops.render.render(write_still=True)
    scene.render.filepath, scene.render.image_settings.file_format, scene.cycles.samples = before


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("program")
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--samples", type=int, default=256)
    arguments = parser.parse_args()
    scene = build_scene(arguments.size)
    cycles(scene, arguments.folder / "cycles.exr", arguments.samples)
    scene.cycles.samples = PINHOLE_SAMPLES
    extension = load_extension()
    from spreadlets_extension import loop, preferences, process

    maker = process.Served(arguments.program) if arguments.program else process.InProcess()
    preferences._makers[""] = maker
    calls, run = [], maker.run

    def timed(*request):
        begin = time.perf_counter()
        try:
            return run(*request)
        finally:
            calls.append(time.perf_counter() - begin)

    maker.run = timed
    told = {"check": maker.check(), "in_process": process.InProcess.is_possible()}
    before = settings_of(scene)
    # The current frame, twice: the second time everything is warm.
    for name in ("first_s", "warm_s"):
        begin = time.perf_counter()
        told["result"] = list(bpy.ops.render.spreadlets_blur())
        told[name] = time.perf_counter() - begin
    told["call_s"] = calls[-1]
    image = bpy.data.images[loop.IMAGE_NAME]
    told["images"] = [each.name for each in bpy.data.images if each.type != "RENDER_RESULT"]
    image.filepath_raw, image.file_format = str(arguments.folder / "blurred.exr"), "OPEN_EXR"
    image.save()
    told["changed"] = [pair for pair in zip(before, settings_of(scene), strict=True) if pair[0] != pair[1]]
    # Errors are one line, and change nothing.
    scene.spreadlets.options = "--layers 999"
    try:
        bpy.ops.render.spreadlets_blur()
    except RuntimeError as error:
        told["error"] = str(error).strip()
    scene.spreadlets.options = ""
    told["changed"] += [pair for pair in zip(before, settings_of(scene), strict=True) if pair[0] != pair[1]]
    # Cancelled while it blurs.
    steps = loop.blur_frames(bpy.context, [1], maker, animation=False, interactive=False)
    told["cancelled_at"] = next(steps).text
    steps.close()
    told["changed"] += [pair for pair in zip(before, settings_of(scene), strict=True) if pair[0] != pair[1]]
    # A range.
    scene.frame_start, scene.frame_end = 1, 2
    scene.spreadlets.output = str(arguments.folder / "range" / "##.exr")
    scene.cycles.samples = 4
    bpy.ops.render.spreadlets_blur(animation=True)
    told["range"] = sorted(path.name for path in (arguments.folder / "range").iterdir())
    told["current"] = scene.frame_current
    extension.unregister()
    told["registered"] = hasattr(bpy.types.Scene, "spreadlets")
    (arguments.folder / "told.json").write_text(json.dumps(told))


if __name__ == "__main__":
    main()

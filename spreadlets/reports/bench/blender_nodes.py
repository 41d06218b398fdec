"""A peer that compositors have at hand: Blender's Defocus and Vector Blur nodes, run in a process of their own.

``python -m spreadlets.reports.bench.blender_nodes FRAME.exr SETTINGS.json OUT.exr`` needs package bpy, 5.0 or newer.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from spreadlets.errors import InvalidFileError
from spreadlets.files.exr_frames import read_image, write_frame
from spreadlets.reports.bench.subjects import Subject

BLUR_SLACK = 1.1
"""Blender searches as far as its largest blur: it is told the frame's, with this slack."""
TIMEOUT_S = 600.0


class NodesImage(np.ndarray[Any, np.dtype[np.float32]]):
    """An image that knows how many seconds its making took, without starting Blender."""

    seconds: float


def run_nodes(subject: Subject) -> npt.NDArray[np.float32]:
    """Blur a subject's frame with Blender's nodes.

    Returns
    -------
    ndarray of shape (H, W, 4), float32
        A `NodesImage`.

    Raises
    ------
    InvalidFileError
        If Blender fails; the message holds the end of what it said.
    """
    # Tell the nodes what the camera is, and how far its blur reaches.
    camera = subject.camera
    height, width = subject.frame.shape
    largest = np.abs(camera.coc_radius(subject.frame.layers[0].depth, width)).max()
    settings = {
        "blur_max": BLUR_SLACK * float(largest) + 1.0,
        "lens": camera.focal_length_mm,
        "sensor": camera.sensor_width_mm,
        "f_stop": camera.f_number,
        "focus": min(camera.focus_distance_m, 1e6),
        "shutter": camera.shutter_duration,
        "size": [width, height],
    }
    # Blur the frame in a process of its own: Blender does not share one.
    with tempfile.TemporaryDirectory() as folder:
        source, output = Path(folder) / "frame.exr", Path(folder) / "out.exr"
        write_frame(source, subject.frame, preset="blender")
        told = Path(folder) / "settings.json"
        told.write_text(json.dumps(settings))
        command = [sys.executable, "-m", "spreadlets.reports.bench.blender_nodes", str(source), str(told), str(output)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
        if done.returncode or not output.exists():
            raise InvalidFileError(f"Blender's nodes failed: {(done.stderr or done.stdout).strip()[-300:]}")
        # Read its image, and its own time.
        image = read_image(output).view(NodesImage)
        image.seconds = float(done.stdout.rsplit("seconds", 1)[1])
    return image


def main(frame: str, settings: str, output: str) -> None:
    """Run the nodes in this process and print the seconds of the compositor."""
    import time

    import bpy

    # Set the scene up, with a group of nodes for its compositor.
    given = json.loads(Path(settings).read_text())
    scene = bpy.context.scene
    _set_scene(scene, given, output)
    tree = bpy.data.node_groups.new("blur", "CompositorNodeTree")
    scene.compositing_node_group = tree
    tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    # Make the nodes: image, defocus, vector blur.
    image = tree.nodes.new("CompositorNodeImage")
    image.image = bpy.data.images.load(frame)
    defocus, blur = tree.nodes.new("CompositorNodeDefocus"), tree.nodes.new("CompositorNodeVecBlur")
    defocus.scene, defocus.use_zbuffer, defocus.f_stop = scene, True, given["f_stop"]
    defocus.blur_max, defocus.bokeh = given["blur_max"], "CIRCLE"
    blur.inputs["Shutter"].default_value = given["shutter"]
    # Link them.
    end = tree.nodes.new("NodeGroupOutput")
    for source, target in (
        (image.outputs["Combined"], defocus.inputs["Image"]),
        (image.outputs["Depth"], defocus.inputs["Z"]),
        (defocus.outputs[0], blur.inputs["Image"]),
        (image.outputs["Vector"], blur.inputs["Speed"]),
        (image.outputs["Depth"], blur.inputs["Z"]),
        (blur.outputs[0], end.inputs[0]),
    ):
        tree.links.new(source, target)
    # Measure the compositor.
    begin = time.perf_counter()
    bpy.ops.render.render(write_still=True)
    print("seconds", time.perf_counter() - begin)


def _set_scene(scene: Any, given: dict[str, Any], output: str) -> None:
    """Set size, camera and output; nothing is rendered, as no node asks for it."""
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 1
    scene.render.resolution_x, scene.render.resolution_y = given["size"]
    scene.render.resolution_percentage = 100
    scene.render.filepath = output
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.view_settings.view_transform = "Raw"
    camera = scene.camera.data
    camera.lens, camera.sensor_width = given["lens"], given["sensor"]
    camera.dof.use_dof, camera.dof.focus_distance = True, given["focus"]
    camera.dof.aperture_fstop = given["f_stop"]


if __name__ == "__main__":
    main(*sys.argv[1:])

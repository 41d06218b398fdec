# SPDX-License-Identifier: GPL-3.0-or-later
"""The loop: scene, pinhole render, blur, image; in steps, so that Blender can go on and the user can leave."""

from __future__ import annotations

import json
import shlex
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import bpy

from .camera import camera_values, effect_options
from .pinhole import Settings, prepare
from .process import Call, InProcess, MakerError, Served

IMAGE_NAME = "Spreadlets"


class Step(NamedTuple):
    """How far a loop is."""

    done: int
    total: int
    text: str


def blur_frames(
    context: Any, frames: Sequence[int], maker: InProcess | Served, *, animation: bool, interactive: bool
) -> Iterator[Step]:
    """Render and blur frames; yields while it waits. Closing it puts everything back and leaves no files.

    Parameters
    ----------
    context : bpy.types.Context
    frames : sequence of int
    maker : InProcess or Served
    animation : bool
        Write files as the scene's settings say; otherwise the result becomes an image in Blender.
    interactive : bool
        Render beside the interface, and not before going on.
    """
    scene, current = context.scene, context.scene.frame_current
    with tempfile.TemporaryDirectory(prefix="spreadlets-") as name:
        folder = Path(name)
        try:
            for done, frame in enumerate(frames):
                if scene.frame_current != frame:
                    scene.frame_set(frame)
                yield from (Step(done, len(frames), text) for text in _one(context, folder, maker, interactive))
                result = folder / "blurred.exr"
                if animation:
                    target = output_path(scene, frame)
                    target.parent.mkdir(parents=True, exist_ok=True)
                    result.replace(target) if target.drive == result.drive else target.write_bytes(result.read_bytes())
                else:
                    show(scene, result)
        finally:
            if scene.frame_current != current:
                scene.frame_set(current)
    yield Step(len(frames), len(frames), "done")


def _one(context: Any, folder: Path, maker: InProcess | Served, interactive: bool) -> Iterator[str]:
    """Render and blur the current frame into the folder."""
    scene = context.scene
    camera = camera_values(scene, context.evaluated_depsgraph_get())
    (folder / "camera.json").write_text(json.dumps(camera))
    options = [*effect_options(scene), *layer_options(context), *shlex.split(scene.spreadlets.options)]
    settings = Settings()
    try:
        prepare(scene, folder / "pinhole.exr", settings)
        yield from _rendered(interactive)
    finally:
        settings.put_back()
    arguments = ["synth", "pinhole.exr", "-o", "blurred.exr", "--camera", "camera.json", *options]
    call = Call(maker, arguments, str(folder))
    call.start()
    try:
        while call.is_alive():
            call.join(0.02)
            yield "blurring"
    except GeneratorExit:
        maker.stop()
        call.join()
        raise
    if call.error:
        raise MakerError(call.error)


def _rendered(interactive: bool) -> Iterator[str]:
    """Render the scene; waits for the end if the interface goes on meanwhile."""
    ended: list[bool] = []
    handlers = ((bpy.app.handlers.render_complete, True), (bpy.app.handlers.render_cancel, False))
    added = [(listed, lambda *_, well=well: ended.append(well)) for listed, well in handlers]
    for listed, handler in added:
        listed.append(handler)
    try:
        bpy.ops.render.render("INVOKE_DEFAULT" if interactive else "EXEC_DEFAULT", write_still=True)
        while not ended:
            yield "rendering"
    finally:
        for listed, handler in added:
            listed.remove(handler)
    if not ended[0]:
        raise MakerError("the render was cancelled")


def layer_options(context: Any) -> list[str]:
    """Return the options for the scene's view layers: all of them as depth layers, or the one that is shown."""
    scene = context.scene
    layers = [layer.name for layer in scene.view_layers if layer.use]
    if len(layers) < 2 or scene.render.use_single_layer:
        return []
    if scene.spreadlets.depth_layers:
        return ["--colour-layer", ",".join(layers)]
    return ["--colour-layer", context.view_layer.name if context.view_layer.name in layers else layers[0]]


def output_path(scene: Any, frame: int) -> Path:
    """Return where a frame of an animation goes."""
    path = bpy.path.abspath(scene.spreadlets.output)
    counter = path.count("#")
    if not counter:
        stem = Path(path)
        return stem.with_name(f"{stem.stem}{frame:04d}{stem.suffix or '.exr'}")
    return Path(path.replace("#" * counter, f"{frame:0{counter}d}"))


def show(scene: Any, path: Path) -> Any:
    """Make the result an image in Blender, which holds its pixels itself, and show it in the compositor."""
    old = bpy.data.images.get(IMAGE_NAME)
    image = bpy.data.images.load(str(path))
    image.pack()
    if old is not None:
        old.user_remap(image)
        bpy.data.images.remove(old)
    image.name = IMAGE_NAME
    tree = getattr(scene, "compositing_node_group", None) or getattr(scene, "node_tree", None)
    if tree is not None:
        node = tree.nodes.get(IMAGE_NAME) or tree.nodes.new("CompositorNodeImage")
        node.name, node.image = IMAGE_NAME, image
    return image

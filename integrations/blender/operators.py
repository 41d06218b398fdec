# SPDX-License-Identifier: GPL-3.0-or-later
"""What the buttons do: blur the current frame, or the range of the scene."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import bpy

from .camera import CameraError
from .loop import Step, blur_frames
from .preferences import maker
from .process import MakerError

TICK_S = 0.1


class SpreadletsSettings(bpy.types.PropertyGroup):
    """What a scene says about its blur."""

    output: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Output",
        description="Files of an animation; # is a digit of the frame",
        default="//blurred/####.exr",
        subtype="FILE_PATH",
    )
    depth_layers: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="View Layers Are Depth Layers",
        description="Blur all view layers together, the first nearest; each shows what nearer ones hide",
    )
    options: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Options", description="Further options of the command spreadlets synth, such as --max-coc 40"
    )


class SPREADLETS_OT_blur(bpy.types.Operator):
    """Render without depth of field and motion blur, and put them on the result"""  # noqa: D400

    bl_idname = "render.spreadlets_blur"
    bl_label = "Blur with Spreadlets"

    animation: bpy.props.BoolProperty(name="Animation", options={"SKIP_SAVE"})  # type: ignore[valid-type]

    def execute(self, context: Any) -> set[str]:
        """Do it before going on."""
        try:
            for _ in self._loop(context, interactive=False):
                pass
        except (CameraError, MakerError, OSError, ValueError) as error:
            return self._failed(error)
        return {"FINISHED"}

    def invoke(self, context: Any, event: Any) -> set[str]:
        """Do it beside the interface."""
        self._steps = self._loop(context, interactive=True)
        self._timer = context.window_manager.event_timer_add(TICK_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        context.window_manager.progress_begin(0.0, 1.0)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        """Go a step further; Escape cancels."""
        if event.type == "ESC":
            self._steps.close()
            self._leave(context)
            self.report({"WARNING"}, "cancelled")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        try:
            step = next(self._steps)
        except StopIteration:
            self._leave(context)
            return {"FINISHED"}
        except (CameraError, MakerError, OSError, ValueError) as error:
            self._leave(context)
            return self._failed(error)
        context.window_manager.progress_update(step.done / step.total)
        context.workspace.status_text_set(f"{step.text}, {step.done} of {step.total} frames; Esc cancels")
        return {"RUNNING_MODAL"}

    def _loop(self, context: Any, interactive: bool) -> Iterator[Step]:
        scene = context.scene
        frames = [scene.frame_current]
        if self.animation:
            frames = list(range(scene.frame_start, scene.frame_end + 1, scene.frame_step))
        return blur_frames(context, frames, maker(context), animation=self.animation, interactive=interactive)

    def _leave(self, context: Any) -> None:
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.progress_end()
        context.workspace.status_text_set(None)

    def _failed(self, error: Exception) -> set[str]:
        self.report({"ERROR"}, str(error))
        return {"CANCELLED"}


CLASSES = (SpreadletsSettings, SPREADLETS_OT_blur)


def register() -> None:
    """Add the operator, and the settings of scenes."""
    for each in CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Scene.spreadlets = bpy.props.PointerProperty(type=SpreadletsSettings)


def unregister() -> None:
    """Take them out."""
    del bpy.types.Scene.spreadlets
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)

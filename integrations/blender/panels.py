# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel, in the properties of the camera and of rendering."""

from __future__ import annotations

from typing import Any

import bpy

from .operators import SPREADLETS_OT_blur


class _Panel:
    bl_label = "Spreadlets"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: Any) -> None:
        """Show the buttons and the settings."""
        layout, scene = self.layout, context.scene  # type: ignore[attr-defined]
        layout.use_property_split = True
        row = layout.row()
        row.operator(SPREADLETS_OT_blur.bl_idname, text="Blur Frame", icon="RENDER_STILL")
        row.operator(SPREADLETS_OT_blur.bl_idname, text="Blur Range", icon="RENDER_ANIMATION").animation = True
        if scene.camera is not None:
            layout.prop(scene.camera.data.dof, "use_dof", text="Depth of Field")
        layout.prop(scene.render, "use_motion_blur")
        for name in ("depth_layers", "output", "options"):
            layout.prop(scene.spreadlets, name)


class SPREADLETS_PT_camera(_Panel, bpy.types.Panel):
    """Beside the camera's depth of field."""

    bl_context = "data"
    COMPAT_ENGINES = {"CYCLES", "BLENDER_EEVEE", "BLENDER_EEVEE_NEXT"}

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Show it for cameras."""
        return getattr(context, "camera", None) is not None


class SPREADLETS_PT_render(_Panel, bpy.types.Panel):
    """Beside the renderer's motion blur."""

    bl_context = "render"


CLASSES = (SPREADLETS_PT_camera, SPREADLETS_PT_render)


def register() -> None:
    """Add the panels."""
    for each in CLASSES:
        bpy.utils.register_class(each)


def unregister() -> None:
    """Take them out."""
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)

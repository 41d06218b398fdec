# SPDX-License-Identifier: GPL-3.0-or-later
"""Preferences: where the command is; and the one maker of images for all scenes."""

from __future__ import annotations

import atexit
from typing import Any

import bpy

from .process import InProcess, MakerError, Served

_makers: dict[str, InProcess | Served] = {}


def maker(context: Any) -> InProcess | Served:
    """Return who makes images: this Python if it has the package and no program is named, else a process."""
    addon = context.preferences.addons.get(__package__)
    program = addon.preferences.program if addon else ""
    if program not in _makers:
        stop_all()
        _makers[program] = InProcess() if not program and InProcess.is_possible() else Served(program or "spreadlets")
    return _makers[program]


def stop_all() -> None:
    """End the processes that make images."""
    while _makers:
        _makers.popitem()[1].stop()


class SPREADLETS_OT_check(bpy.types.Operator):
    """Look whether images can be made"""  # noqa: D400 (Blender shows it, and puts the full stop)

    bl_idname = "spreadlets.check"
    bl_label = "Check"

    def execute(self, context: Any) -> set[str]:
        """Say what was found."""
        try:
            self.report({"INFO"}, maker(context).check())
        except MakerError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class SPREADLETS_AP_preferences(bpy.types.AddonPreferences):
    """Where the package is."""

    bl_idname = __package__

    program: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Command or Python",
        description="The command spreadlets, or a Python that has the package; empty: Blender's own Python, or else "
        "the command on the search path",
        subtype="FILE_PATH",
        update=lambda self, context: stop_all(),
    )

    def draw(self, context: Any) -> None:
        """Show them."""
        row = self.layout.row()
        row.prop(self, "program")
        row.operator(SPREADLETS_OT_check.bl_idname)


CLASSES = (SPREADLETS_OT_check, SPREADLETS_AP_preferences)


def register() -> None:
    """Add the preferences; Blender leaves without unregistering, so the processes are ended then, too."""
    atexit.register(stop_all)
    for each in CLASSES:
        bpy.utils.register_class(each)


def unregister() -> None:
    """End the processes, and take the preferences out."""
    atexit.unregister(stop_all)
    stop_all()
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)

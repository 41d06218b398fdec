# SPDX-License-Identifier: GPL-3.0-or-later
"""Spreadlets in Blender: renders a pinhole frame, and puts the camera's depth of field and the motion blur on it."""

from . import operators, panels, preferences


def register() -> None:
    """Add the extension's classes and properties to Blender."""
    for module in (preferences, operators, panels):
        module.register()


def unregister() -> None:
    """Take them out again, and end the process that makes images."""
    for module in (panels, operators, preferences):
        module.unregister()

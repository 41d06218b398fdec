# SPDX-License-Identifier: GPL-3.0-or-later
"""The settings of a pinhole render with the passes that blurring needs, and those of the scene put back after it."""

from __future__ import annotations

from pathlib import Path
from typing import Any


class Settings:
    """Settings that are changed for a while."""

    def __init__(self) -> None:
        self._kept: list[tuple[Any, str, Any]] = []

    def set(self, owner: Any, name: str, value: Any) -> None:
        """Change a setting, if this version of Blender has it."""
        if not hasattr(owner, name):
            return
        before = getattr(owner, name)
        if before != value:
            setattr(owner, name, value)
            self._kept.append((owner, name, before))

    def put_back(self) -> None:
        """Give every setting the value that it had, the last change first."""
        while self._kept:
            owner, name, value = self._kept.pop()
            setattr(owner, name, value)


def prepare(scene: Any, path: Path, settings: Settings) -> None:
    """Let the next render of a scene be sharp, whole, with depth and motion, and be written as OpenEXR."""
    render, image = scene.render, scene.render.image_settings
    # What blurs is off: it comes later. The vectors of Cycles and EEVEE are there only without motion blur.
    settings.set(render, "use_motion_blur", False)
    settings.set(scene.camera.data.dof, "use_dof", False)
    # What comes after rendering is off: it would work on the sharp frame.
    settings.set(render, "use_compositing", False)
    settings.set(render, "use_sequencer", False)
    # Blur needs what surrounds a border.
    settings.set(render, "use_border", False)
    for layer in scene.view_layers:
        for name in ("use_pass_combined", "use_pass_z", "use_pass_vector"):
            settings.set(layer, name, True)
    settings.set(image, "media_type", "MULTI_LAYER_IMAGE")  # Blender 5
    settings.set(image, "file_format", "OPEN_EXR_MULTILAYER")
    settings.set(image, "color_depth", "32")
    settings.set(render, "use_file_extension", False)
    settings.set(render, "use_overwrite", True)
    settings.set(render, "use_placeholder", False)
    settings.set(render, "filepath", str(path))

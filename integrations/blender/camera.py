# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene's camera, as a camera file of spreadlets has it."""

from __future__ import annotations

from typing import Any


class CameraError(ValueError):
    """The scene has no camera that can be used; the message says why."""


def camera_values(scene: Any, depsgraph: Any) -> dict[str, Any]:
    """Return lens, sensor, focus and shutter at the current frame.

    A unit of Blender is taken for a metre, whatever the scene's unit scale, as Cycles does for the lens.
    """
    if scene.camera is None:
        raise CameraError("the scene has no camera")
    camera = scene.camera.evaluated_get(depsgraph)
    data = camera.data
    if data.type != "PERSP":
        raise CameraError(f"the camera {camera.name} is {data.type.lower()}: only perspective cameras have a thin lens")
    return {
        "focal_length_mm": data.lens,
        "sensor_width_mm": data.sensor_width,
        "sensor_height_mm": data.sensor_height,
        "sensor_fit": data.sensor_fit.lower(),
        "f_number": data.dof.aperture_fstop,
        "focus_distance_m": _focus_distance(camera, data.dof, depsgraph),
        "shutter_open_close_frames": _shutter(scene),
    }


def effect_options(scene: Any) -> list[str]:
    """Return the options that leave out what the scene has switched off."""
    options = [] if scene.camera.data.dof.use_dof else ["--no-defocus"]
    return options if scene.render.use_motion_blur else [*options, "--no-motion"]


def _focus_distance(camera: Any, dof: Any, depsgraph: Any) -> float:
    """Return the distance of the plane in focus along the camera's axis."""
    if dof.focus_object is None:
        return float(dof.focus_distance)
    target = dof.focus_object.evaluated_get(depsgraph)
    place = target.matrix_world
    bone = target.pose.bones.get(dof.focus_subtarget) if target.pose and dof.focus_subtarget else None
    if bone is not None:
        place = place @ bone.matrix
    axis = camera.matrix_world.to_3x3().col[2].normalized()
    return abs(float((camera.matrix_world.translation - place.translation).dot(axis)))


def _shutter(scene: Any) -> list[float]:
    """Return when the shutter opens and closes, in frames from the current one."""
    # Before Blender 4.2 it was a setting of Cycles alone.
    position = getattr(scene.render, "motion_blur_position", None) or scene.cycles.motion_blur_position
    length = float(scene.render.motion_blur_shutter)
    begin = {"START": 0.0, "CENTER": -0.5, "END": -1.0}[position] * length
    return [begin, begin + length]

"""What is doubtful about values that are allowed one by one, but do not fit each other: units, order, lens and time."""

from __future__ import annotations

import math

import numpy as np

from spreadlets.arrays import FloatArray
from spreadlets.errors import option
from spreadlets.scans import visible_range
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame, Layer
from spreadlets.scene.samples import SampleBuffer, valid_values

FAR = 1e8
"""Depth in metres from which on renderers mean the background: Cycles writes 1e10."""

FOCUS_RATIO = 5.0
"""A focus nearer than the nearest depth, or farther than the farthest, by more than this ratio is doubted."""

WIDEST_VIEW = 170.0
NARROWEST_VIEW = 0.2
"""Fields of view in degrees beyond which a focal length and a sensor's width are doubted."""

LONGEST_SHUTTER = 2.0
"""Frames beyond which a shutter is doubted."""

DISC_TOLERANCE = 1.01
"""Radius of the lens, in its own radii, beyond which samples are doubted."""

BEHIND = 1.01
"""Ratio by which the depth of a nearer layer must exceed that of a farther one to lie behind it."""

BEHIND_SHARE = 0.01
"""Share of the pixels that two layers have in common, that may lie in the wrong order without doubt."""


def camera_doubts(camera: ThinLens) -> list[str]:
    """Return warnings of values of a camera that do not fit each other."""
    found = []
    view = math.degrees(2 * math.atan(0.5 * camera.sensor_width_mm / camera.focal_length_mm))
    if not NARROWEST_VIEW <= view <= WIDEST_VIEW:
        found.append(
            f"the field of view is {view:.3g} degrees: the focal length is {camera.focal_length_mm:g} mm, the sensor's "
            f"width {camera.sensor_width_mm:g} mm; are both in millimetres?"
        )
    if camera.shutter_duration > LONGEST_SHUTTER:
        found.append(
            f"the shutter is open for {camera.shutter_duration:g} frames; it is counted in frames, not in degrees: 180 "
            "degrees are half a frame"
        )
    return found


def frame_doubts(frame: Frame, camera: ThinLens, depths: tuple[float, float] | None = None) -> list[str]:
    """Return warnings of what does not fit between a frame and its camera.

    Parameters
    ----------
    frame : Frame
        Labelled pixels.
    camera : ThinLens
        Lens and shutter, fitted to the frame or not.
    depths : tuple of two floats, optional
        Its `depth_range`, where that is known.

    Returns
    -------
    list of str
    """
    # Does the sensor's shape fit the frame's?
    found = camera_doubts(camera.fitted(frame.raster.display.shape, frame.raster.pixel_aspect))
    height, width = frame.raster.display.shape
    sensor_height = camera.sensor_height_mm
    if camera.sensor_fit == "horizontal" and sensor_height is not None and sensor_height != camera.sensor_width_mm:
        if (height > width) != (sensor_height > camera.sensor_width_mm) and height != width:
            found.append(
                f"of the frame, {width} x {height} px, and the sensor, {camera.sensor_width_mm:g} x {sensor_height:g} "
                f"mm, one is upright and the other not; the widths are taken to agree: say {option('sensor_fit')}"
            )
    # Is the focus near the depths?
    nearest, farthest = depth_range(frame) if depths is None else depths
    focus = camera.focus_distance_m
    if not (nearest <= farthest and math.isfinite(focus)):
        return found
    if focus < nearest / FOCUS_RATIO or focus > farthest * FOCUS_RATIO:
        found.append(
            f"the focus is at {focus:g} m, but the depths are {nearest:.3g} to {farthest:.3g} m; is the depth in other "
            f"units ({option('depth_scale')} 0.01 for centimetres, 0.001 for millimetres), or the focus?"
        )
    return found


def depth_range(frame: Frame) -> tuple[float, float]:
    """Return the nearest and the farthest depth of what is visible, metres, without the background; inf, 0 if none."""
    ends = [visible_range(layer.depth, layer.radiance, FAR) for layer in frame.layers]
    return min((low for low, _ in ends), default=math.inf), max((high for _, high in ends), default=0.0)


def layer_doubts(frame: Frame) -> list[str]:
    """Return warnings of an order of layers that cannot be nearest first, or hides what lies behind.

    Parameters
    ----------
    frame : Frame
        One or more layers.

    Returns
    -------
    list of str
    """
    found = []
    for index, (near, far) in enumerate(zip(frame.layers[:-1], frame.layers[1:], strict=True)):
        # Does the layer hide all others?
        alpha, behind = near.radiance[..., 3], far.radiance[..., 3]
        if (alpha == 1).all():
            found.append(f"layer {index} is opaque everywhere and hides the layers behind it; layers are nearest first")
            continue
        # Does it lie behind the next one where both are seen, or on the whole?
        shared = (alpha > 0) & (behind > 0)
        wrong = shared & (near.depth > np.float32(BEHIND) * far.depth)
        n_wrong, n_shared = int(np.count_nonzero(wrong)), int(np.count_nonzero(shared))
        if n_wrong > BEHIND_SHARE * n_shared:
            found.append(
                f"layer {index} lies behind layer {index + 1} at {n_wrong} of the {n_shared} pixels that both cover; "
                "layers are nearest first"
            )
        elif _middle(near) > np.float32(BEHIND) * _middle(far):
            found.append(
                f"layer {index} is mostly farther ({_middle(near):.3g} m) than layer {index + 1} ({_middle(far):.3g} "
                "m); layers are nearest first"
            )
    return found


def _middle(layer: Layer) -> float:
    """Return the median depth of what is visible, or NaN."""
    seen = layer.depth[layer.radiance[..., 3] > 0]
    return float(np.median(seen)) if seen.size else math.nan


def sample_doubts(samples: SampleBuffer, camera: ThinLens) -> list[str]:
    """Return warnings of what does not fit between labelled samples and their camera.

    Parameters
    ----------
    samples : SampleBuffer
        Labelled samples.
    camera : ThinLens
        Lens and shutter.

    Returns
    -------
    list of str
    """
    found = camera_doubts(camera.fitted(samples.raster.display.shape, samples.raster.pixel_aspect))
    # What the samples alone can tell is not taken from the camera.
    if camera.moves_picture:
        found.append(
            "keys of the camera's pose or focal length are not used: how samples move is told by their motion alone, "
            "which has to hold the camera's"
        )
    if camera.readout_frames:
        found.append("readout_frames is not used: each sample has a time of its own")
    lens, time = valid_values(samples.lens_uv, samples.valid), valid_values(samples.time, samples.valid)
    if not len(lens):
        return found
    # Do the lens samples fill the unit disc?
    radius = float(np.sqrt((lens[:, 0] ** 2 + lens[:, 1] ** 2).max()))
    if radius > DISC_TOLERANCE:
        found.append(f"lens samples lie up to {radius:.3g} radii from the lens's centre; the disc ends at 1")
    sides = [axis for axis, values in zip("uv", lens.T, strict=True) if _one_sided(values)]
    if sides:
        found.append(
            f"lens samples lie on one side of the lens only (lens.{', lens.'.join(sides)}); they run from -1 to 1, not "
            "from 0 to 1"
        )
    # Were the samples taken while the shutter is open?
    opens, closes = camera.shutter
    slack = 0.01 * max(closes - opens, 0.01)
    if time.min() < opens - slack or time.max() > closes + slack:
        found.append(
            f"sample times run from {time.min():.3g} to {time.max():.3g} frames, the shutter is open from {opens:g} to "
            f"{closes:g}"
        )
    return found


def _one_sided(values: FloatArray) -> bool:
    """Tell whether many values, not all alike, have one sign."""
    return len(values) > 16 and bool(values.min() != values.max()) and bool((values >= 0).all() or (values <= 0).all())

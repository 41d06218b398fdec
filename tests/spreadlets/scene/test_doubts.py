"""Values that are allowed one by one are doubted where they do not fit each other; what fits is not."""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import spreadlets as sp
from spreadlets.scene.doubts import camera_doubts, frame_doubts, layer_doubts, sample_doubts

SHAPE = (6, 8)
DATA = Path(__file__).parents[2] / "data"


def lens(**changes):
    values = {"focal_length_mm": 50.0, "sensor_width_mm": 36.0, "f_number": 2.0, "focus_distance_m": 3.0}
    return sp.ThinLens(**(values | changes))


def flat(depth, alpha=1.0, columns=slice(None)):
    radiance = np.zeros((*SHAPE, 4))
    radiance[:, columns] = alpha
    return sp.Frame(radiance, np.full(SHAPE, float(depth)))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sensor_width_mm": 0.036}, "field of view is 0.0413 degrees"),
        ({"focal_length_mm": 0.1}, "field of view is 179 degrees"),
        ({"shutter": (-90.0, 90.0)}, "open for 180 frames; it is counted in frames"),
    ],
)
def test_impossible_looking_cameras_are_doubted(changes, message):
    (doubt,) = camera_doubts(lens(**changes))
    assert message in doubt
    assert camera_doubts(lens(shutter=(-1.0, 1.0))) == []


@pytest.mark.parametrize("depth", [15.1, 0.59, 300])
def test_a_focus_far_outside_the_depths_is_doubted(depth):
    (doubt,) = frame_doubts(flat(depth), lens())
    assert "the focus is at 3 m" in doubt and "depth_scale 0.01 for centimetres" in doubt


@pytest.mark.parametrize("depth", [14.9, 3, 0.61, np.inf])
def test_a_focus_near_the_depths_is_not(depth):
    assert frame_doubts(flat(depth), lens()) == []
    assert frame_doubts(flat(300), lens(focus_distance_m=np.inf)) == []


def test_depths_of_empty_pixels_do_not_count():
    frame = sp.Frame(np.zeros((*SHAPE, 4)), np.full(SHAPE, 300.0))
    assert frame_doubts(frame, lens()) == []


def test_an_upright_frame_of_a_lying_sensor_is_doubted():
    frame = sp.Frame(np.ones((9, 4, 3)), np.full((9, 4), 3.0))
    (doubt,) = frame_doubts(frame, lens(sensor_height_mm=24.0))
    assert "say sensor_fit" in doubt
    assert frame_doubts(frame, lens(sensor_height_mm=24.0, sensor_fit="auto")) == []


def test_synthesis_says_what_is_doubtful():
    with pytest.warns(sp.errors.AmbiguousInputWarning, match="the focus is at 3 m"):
        sp.synthesize(flat(300), lens(), "simplelens")


@pytest.mark.parametrize(
    ("layers", "message"),
    [
        ([flat(2), flat(5)], "layer 0 is opaque everywhere"),
        ([flat(5, 0.5), flat(2)], "layer 0 lies behind layer 1 at 48 of the 48 pixels"),
        ([flat(5, 1, slice(0, 4)), flat(2, 1, slice(4, 8))], r"layer 0 is mostly farther (5 m) than layer 1 (2 m)"),
    ],
)
def test_layers_in_a_wrong_order_are_doubted(layers, message):
    (doubt,) = layer_doubts(sp.Frame.from_layers(layers))
    assert message in doubt


def test_layers_nearest_first_are_not_doubted():
    right = [flat(2, 0.5), flat(5, 1, slice(4, 8)), flat(np.inf)]
    assert layer_doubts(sp.Frame.from_layers(right)) == []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sp.read_frame([DATA / f"fence_layer{index}.exr" for index in range(3)])


def samples(lens_uv=None, time=None):
    rng = np.random.default_rng(2)
    shape = (4, 4, 4)
    uv = rng.uniform(-0.7, 0.7, (*shape, 2)) if lens_uv is None else lens_uv(rng, (*shape, 2))
    times = rng.uniform(-0.25, 0.25, shape) if time is None else time(rng, shape)
    return sp.SampleBuffer(np.ones((*shape, 3)), np.full(shape, 3.0), np.zeros((*shape, 2)), uv, times)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"lens_uv": lambda rng, shape: rng.uniform(0, 0.7, shape)}, "on one side of the lens only (lens.u, lens.v)"),
        ({"lens_uv": lambda rng, shape: rng.uniform(-1, 1, shape)}, "radii from the lens's centre; the disc ends at 1"),
        ({"time": lambda rng, shape: rng.uniform(0, 1, shape)}, "the shutter is open from -0.25 to 0.25"),
    ],
)
def test_samples_that_do_not_fit_lens_and_shutter_are_doubted(changes, message):
    (doubt,) = sample_doubts(samples(**changes), lens())
    assert message in doubt
    with pytest.warns(sp.errors.AmbiguousInputWarning, match="lens|shutter"):
        sp.reconstruct(samples(**changes), lens(), method="mean")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"keys": (sp.LensKey(0, focal_length_mm=40), sp.LensKey(1, focal_length_mm=60))}, "focal length are not used"),
        ({"readout_frames": 0.3}, "readout_frames is not used"),
    ],
)
def test_what_of_a_moving_camera_samples_do_not_use_is_said(changes, message):
    (doubt,) = sample_doubts(samples(), replace(lens(), **changes))
    assert message in doubt


def test_a_focus_pull_over_samples_is_not_doubted():
    pull = replace(lens(), keys=(sp.LensKey(0, focus_distance_m=2), sp.LensKey(1, focus_distance_m=4)))
    assert sample_doubts(samples(), pull) == []


def test_samples_over_the_lens_or_at_its_centre_are_not_doubted():
    assert sample_doubts(samples(), lens()) == []
    still = samples(lens_uv=lambda rng, shape: np.zeros(shape), time=lambda rng, shape: np.zeros(shape))
    assert sample_doubts(still, lens()) == []

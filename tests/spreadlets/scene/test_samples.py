import numpy as np
import pytest

from spreadlets.errors import InvalidFrameError, InvalidParameterError
from spreadlets.scene.samples import SampleBuffer

SHAPE = (3, 5, 4)


def arrays(seed=0, **changes):
    rng = np.random.default_rng(seed)
    radiance = rng.random((*SHAPE, 4))
    radiance[..., 3] = rng.random(SHAPE)
    values = {
        "radiance": radiance,
        "depth": 1 + rng.random(SHAPE),
        "motion": rng.normal(size=(*SHAPE, 2)),
        "lens_uv": rng.uniform(-0.7, 0.7, (*SHAPE, 2)),
        "time": rng.uniform(-0.25, 0.25, SHAPE),
        "offset": rng.uniform(-0.5, 0.5, (*SHAPE, 2)),
    }
    return values | changes


def test_arrays_become_contiguous_float32():
    values = arrays()
    samples = SampleBuffer(**values)
    assert samples.shape == SHAPE[:2] and samples.n_samples == SHAPE[2]
    for name, array in values.items():
        found = getattr(samples, name)
        assert found.dtype == np.float32 and found.flags.c_contiguous
        np.testing.assert_array_equal(found, array.astype(np.float32), err_msg=name)
    assert samples.valid.all() and samples.dropped_samples == 0
    assert samples.coc_radius is None and samples.motion_prev is None


def test_rgb_samples_are_opaque_and_centred_by_default():
    values = arrays(offset=None)
    values["radiance"] = values["radiance"][..., :3]
    samples = SampleBuffer(**values)
    assert (samples.radiance[..., 3] == 1).all() and not samples.offset.any()


def test_missing_samples_may_hold_anything_and_come_out_empty():
    values = arrays(coc_radius=np.ones(SHAPE))
    valid = np.ones(SHAPE, bool)
    valid[1, 2, 3] = False
    for name in ("radiance", "depth", "motion", "time", "coc_radius"):
        values[name][1, 2, 3] = np.nan
    samples = SampleBuffer(**values, valid=valid)
    np.testing.assert_array_equal(samples.valid, valid)
    assert not samples.radiance[1, 2, 3].any() and np.isinf(samples.depth[1, 2, 3])
    assert samples.time[1, 2, 3] == 0 == samples.coc_radius[1, 2, 3]


def test_take_gives_the_first_samples_of_every_label():
    extra = {"motion_prev": np.ones((*SHAPE, 2)), "motion_next": np.zeros((*SHAPE, 2)), "coc_radius": np.ones(SHAPE)}
    samples = SampleBuffer(**arrays(**extra), valid=np.arange(4) < np.full(SHAPE, 3))
    taken = samples.take(2)
    assert taken.n_samples == 2 and taken.labels.keys() == samples.labels.keys()
    for name, values in samples.labels.items():
        np.testing.assert_array_equal(taken.labels[name], values[:, :, :2], err_msg=name)
    np.testing.assert_array_equal(taken.radiance, samples.radiance[:, :, :2])
    np.testing.assert_array_equal(taken.valid, samples.valid[:, :, :2])
    for n in (0, 5):
        with pytest.raises(InvalidParameterError, match="holds 4"):
            samples.take(n)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("radiance", np.nan, "radiance is not finite"),
        ("depth", np.nan, "depth is NaN"),
        ("depth", -1, "depth is zero or negative"),
        ("depth", 0, "depth is zero or negative"),
        ("motion", np.inf, "motion is not finite"),
        ("time", np.nan, "time is not finite"),
        ("offset", np.inf, "offset is not finite"),
        ("lens_uv", 1.1, "lens_uv is outside the lens"),
        ("coc_radius", np.inf, "coc_radius is not finite"),
        ("motion_next", np.nan, "motion_next is not finite"),
    ],
)
def test_bad_samples_are_named_or_dropped(name, value, message):
    values = arrays(coc_radius=np.ones(SHAPE), motion_prev=np.ones((*SHAPE, 2)), motion_next=np.ones((*SHAPE, 2)))
    values[name][2, 1, 3] = value
    values[name][2, 4, 0] = value
    with pytest.raises(InvalidFrameError, match=rf"{message} at 2 of 60 samples, first at \(row 2, col 1, sample 3\)"):
        SampleBuffer(**values)
    samples = SampleBuffer(**values, repair=True)
    assert samples.dropped_samples == 2 and not samples.valid[2, 1, 3] and samples.valid.sum() == 58
    assert all(np.isfinite(v).all() for label, v in samples.labels.items() if label != "depth")
    assert not samples.radiance[2, 4, 0].any()


def test_alpha_is_clipped_a_little_and_refused_beyond():
    values = arrays()
    values["radiance"][0, 0, 0, 3] = 1.0005
    assert SampleBuffer(**values).radiance[..., 3].max() <= 1
    values["radiance"][0, 0, 0, 3] = 1.1
    with pytest.raises(InvalidFrameError, match="alpha .* out of range at 1 of 60 samples"):
        SampleBuffer(**values)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"radiance": np.ones((3, 5, 3))}, r"\(H, W, S, 3\)"),
        ({"radiance": np.ones((3, 0, 4, 3))}, "at least one sample"),
        ({"depth": np.ones((3, 5))}, r"depth has shape \(3, 5\), but the radiance asks for \(3, 5, 4\)"),
        ({"motion": np.ones((3, 5, 4, 3))}, "motion has shape"),
        ({"lens_uv": "x"}, "lens_uv has dtype"),
        ({"valid": np.ones(SHAPE)}, "valid has .* float64; it must be .* bool"),
        ({"valid": np.ones((3, 5), bool)}, "valid has shape"),
        ({"motion_prev": np.ones((*SHAPE, 2))}, "come together"),
    ],
)
def test_wrong_shapes_and_types_are_refused(changes, message):
    with pytest.raises(InvalidFrameError, match=message):
        SampleBuffer(**arrays(**changes))

import numpy as np
import pytest

from spreadlets.errors import AmbiguousInputWarning, InvalidFrameError
from spreadlets.scene.frame import Frame

SHAPE = (4, 6)


def arrays(alpha=1.0, **changes):
    rng = np.random.default_rng(1)
    radiance = rng.random((*SHAPE, 4))
    radiance[..., 3] = alpha
    values = {"radiance": radiance, "depth": 1 + rng.random(SHAPE), "motion": rng.normal(size=(*SHAPE, 2))}
    return {**values, **changes}


def spoiled(name, pixel, value):
    """Return a frame's arrays with one pixel set to a value."""
    values = arrays()
    for path in ("motion_prev", "motion_next") if name in ("motion_prev", "motion_next") else ():
        values[path] = np.ones((*SHAPE, 2))
    values[name][pixel] = value
    return values


def test_arrays_become_contiguous_float32_with_alpha():
    values = arrays()
    frame = Frame(np.asfortranarray(values["radiance"][..., :3]), values["depth"].tolist(), values["motion"])
    (layer,) = frame.layers
    for array in (layer.radiance, layer.depth, layer.motion):
        assert array.dtype == np.float32 and array.flags.c_contiguous
    assert frame.shape == layer.shape == SHAPE
    assert (layer.radiance[..., 3] == 1).all()
    np.testing.assert_array_equal(layer.radiance[..., :3], values["radiance"][..., :3].astype(np.float32))
    assert frame.radiance is layer.radiance and frame.depth is layer.depth and frame.motion is layer.motion
    assert frame.dropped_pixels == 0


def test_valid_float32_arrays_are_not_copied():
    radiance, depth = np.ones((*SHAPE, 4), np.float32), np.ones(SHAPE, np.float32)
    frame = Frame(radiance, depth)
    assert np.shares_memory(frame.radiance, radiance) and np.shares_memory(frame.depth, depth)


def test_without_motion_a_frame_is_still():
    layer = Frame(**arrays(motion=None)).layers[0]
    assert not layer.has_motion and not layer.motion.any()
    assert layer.motion_prev is None and layer.motion_next is None
    assert Frame(**arrays()).layers[0].has_motion


def test_motion_is_the_mean_of_a_curved_path_unless_given():
    before, after = np.full((*SHAPE, 2), 1.0), np.full((*SHAPE, 2), 4.0)
    layer = Frame(**arrays(motion=None), motion_prev=before, motion_next=after).layers[0]
    assert layer.has_motion and (layer.motion == 2.5).all()
    assert (layer.motion_prev == 1).all() and (layer.motion_next == 4).all()
    values = arrays()
    given = Frame(**values, motion_prev=before, motion_next=after)
    np.testing.assert_array_equal(given.motion, values["motion"].astype(np.float32))


@pytest.mark.parametrize("name", ["motion_prev", "motion_next"])
def test_half_a_curved_path_is_refused(name):
    with pytest.raises(InvalidFrameError, match="come together"):
        Frame(**arrays(), **{name: np.zeros((*SHAPE, 2))})


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("radiance", (4, 6)),
        ("radiance", (4, 6, 2)),
        ("radiance", (0, 6, 3)),
        ("depth", (4, 7)),
        ("depth", (4, 6, 1)),
        ("motion", (4, 6)),
        ("motion", (4, 6, 3)),
        ("motion", (6, 4, 2)),
    ],
)
def test_wrong_shapes_are_refused_with_the_shape(name, shape):
    with pytest.raises(InvalidFrameError) as error:
        Frame(**arrays(**{name: np.ones(shape)}))
    assert name in str(error.value) and str(shape) in str(error.value)


def test_shape_mismatch_prints_both_shapes():
    with pytest.raises(InvalidFrameError, match=r"depth has shape \(5, 6\), but .* \(4, 6\)"):
        Frame(**arrays(depth=np.ones((5, 6))))


@pytest.mark.parametrize("values", [np.ones(SHAPE, complex), np.full(SHAPE, "a"), np.ones(SHAPE, bool), [[1, 2], [3]]])
def test_arrays_that_are_not_of_numbers_are_refused(values):
    with pytest.raises(InvalidFrameError, match="depth"):
        Frame(**arrays(depth=values))


OFFENCES = [
    ("radiance", np.nan, "radiance", "not finite"),
    ("radiance", -np.inf, "radiance", "not finite"),
    ("radiance", [1e39, 0, 0, 1], "radiance", "not finite"),
    ("radiance", [0, 0, 0, 1.1], "alpha", "0 to 1"),
    ("radiance", [0, 0, 0, -0.1], "alpha", "0 to 1"),
    ("depth", np.nan, "depth", "NaN"),
    ("depth", 0.0, "depth", "zero or negative"),
    ("depth", -2.0, "depth", "zero or negative"),
    ("depth", -np.inf, "depth", "zero or negative"),
    ("motion", np.nan, "motion", "not finite"),
    ("motion", np.inf, "motion", "not finite"),
    ("motion_prev", np.nan, "motion_prev", "not finite"),
    ("motion_next", -np.inf, "motion_next", "not finite"),
]


@pytest.mark.parametrize(("name", "value", "label", "what"), OFFENCES)
def test_bad_values_are_refused_naming_array_pixel_and_count(name, value, label, what):
    pixels = ([1, 3], [4, 0])
    with pytest.raises(InvalidFrameError) as error:
        Frame(**spoiled(name, pixels, value))
    message = str(error.value)
    assert message.startswith(label) and what in message and "allowed" in message
    assert "2 of 24 pixels" in message and "(row 1, col 4)" in message


@pytest.mark.parametrize(("name", "value", "label", "what"), OFFENCES)
def test_repair_mends_exactly_the_bad_pixels(name, value, label, what):
    """A bad label leaves the colour as it is; a bad colour is that of the pixels around, which are all alike here."""
    values = spoiled(name, ([1, 3], [4, 0]), value)
    colour = np.broadcast_to(np.float32([0.25, 0.5, 0.75, 1]), (*SHAPE, 4))
    good = np.isfinite(values["radiance"]) & (np.abs(values["radiance"]) < 1e38)
    values["radiance"][good] = colour[good]
    if label == "alpha":
        values["radiance"][[1, 3], [4, 0], 3] = value[3]
    before = values[name].copy()
    frame = Frame(**values, repair=True)
    assert (frame.repaired_pixels, frame.dropped_pixels) == (2, 0)
    if label == "alpha":
        np.testing.assert_array_equal(frame.radiance[[1, 3], [4, 0], 3], 1 if value[3] > 1 else 0)
    else:
        np.testing.assert_array_equal(frame.radiance, colour)
    if label == "depth":
        bad = np.zeros(SHAPE, bool)
        bad[[1, 3], [4, 0]] = True
        np.testing.assert_array_equal(np.isinf(frame.depth), bad)
    if label == "motion":
        assert not frame.motion[[1, 3], [4, 0]].any()
    assert (frame.depth > 0).all() and np.isfinite(frame.motion).all()
    np.testing.assert_array_equal(values[name], before, err_msg="the caller's array was changed")


def test_a_pixel_with_several_faults_is_mended_once():
    values = arrays()
    values["radiance"][0, 0], values["depth"][0, 0], values["motion"][0, 0] = np.nan, -1, np.nan
    assert Frame(**values, repair=True).repaired_pixels == 1


def test_a_bad_colour_comes_from_the_surface_that_it_belongs_to():
    """A block of bad pixels over the edge of a near, red surface before a far, blue one."""
    radiance, depth = np.zeros((8, 10, 4), np.float32), np.full((8, 10), 20, np.float32)
    radiance[..., 2:] = 1
    radiance[:, :5], depth[:, :5] = (1, 0, 0, 1), 2
    truth = radiance.copy()
    radiance[2:6, 3:8] = np.nan
    frame = Frame(radiance, depth, repair=True)
    np.testing.assert_array_equal(frame.radiance, truth)
    assert frame.repaired_pixels == 20


def test_a_frame_without_any_valid_colour_is_dropped():
    frame = Frame(np.full((2, 3, 3), np.nan), np.ones((2, 3)), repair=True)
    assert (frame.repaired_pixels, frame.dropped_pixels) == (0, 6) and not frame.radiance.any()


def test_alpha_of_a_sharpening_filter_is_clipped_with_a_warning():
    values = arrays()
    values["radiance"][0, :2, 3] = 1.02, -0.02
    with pytest.warns(AmbiguousInputWarning, match="alpha is -0.02 to 1.02.*at 2 pixels; it is clipped"):
        alpha = Frame(**values).radiance[..., 3]
    assert alpha[0, 0] == 1 and alpha[0, 1] == 0


def test_eight_bit_pictures_are_no_radiance():
    with pytest.raises(InvalidFrameError, match="radiance holds 8-bit integers"):
        Frame(np.ones((4, 6, 3), np.uint8), np.ones((4, 6)))


def test_the_sign_of_depth_is_named_when_all_of_it_is_negative():
    with pytest.raises(InvalidFrameError, match="the sign is turned, say depth_scale -1"):
        Frame(np.ones((4, 6, 3)), np.full((4, 6), -2.0))


def test_background_depth_is_allowed():
    assert np.isinf(Frame(**arrays(depth=np.full(SHAPE, np.inf))).depth).all()


def test_empty_pixels_may_have_any_labels():
    values = arrays(depth=np.full(SHAPE, np.nan), motion=np.full((*SHAPE, 2), np.inf))
    values["radiance"][:] = 0
    values["depth"][2, 2], values["motion"][2, 2] = 3.5, (1, 2)
    frame = Frame(**values)
    assert frame.depth[2, 2] == 3.5 and tuple(frame.motion[2, 2]) == (1, 2)
    assert np.isinf(frame.depth[0, 0]) and not frame.motion[0, 0].any()
    assert frame.dropped_pixels == 0


def test_alpha_within_the_tolerance_is_clipped():
    values = arrays()
    values["radiance"][0, :2, 3] = 1.0005, -0.0005
    alpha = Frame(**values).radiance[..., 3]
    assert alpha[0, 0] == 1 and alpha[0, 1] == 0


def test_from_layers_stacks_frames_and_tuples():
    values = arrays()
    near = Frame(**arrays(alpha=0.5))
    frame = Frame.from_layers([near, (values["radiance"], values["depth"]), tuple(values.values())])
    assert len(frame.layers) == 3 and frame.shape == SHAPE
    assert frame.layers[0] is near.layers[0]
    assert [layer.has_motion for layer in frame.layers] == [True, False, True]
    assert "3 layers" in repr(frame)
    for name in ("radiance", "depth", "motion"):
        with pytest.raises(InvalidFrameError, match="3 layers"):
            getattr(frame, name)


def test_from_layers_repairs_and_counts():
    bad = spoiled("depth", (0, 0), -1)
    layers = [tuple(bad.values()), Frame(**bad, repair=True)]
    assert Frame.from_layers(layers, repair=True).repaired_pixels == 2
    with pytest.raises(InvalidFrameError, match="layer 0: depth"):
        Frame.from_layers(layers)


def test_from_layers_refuses_no_layers_other_things_and_other_shapes():
    frame = Frame(**arrays())
    with pytest.raises(InvalidFrameError, match="at least one layer"):
        Frame.from_layers([])
    with pytest.raises(InvalidFrameError, match="layer 1 is a str"):
        Frame.from_layers([frame, "x"])
    with pytest.raises(InvalidFrameError, match=r"layer 1 is displayed as 2 x 2 px at \(0, 0\), layer 0 as 6 x 4 px"):
        Frame.from_layers([frame, (np.ones((2, 2, 3)), np.ones((2, 2)))])


def test_values_under_a_mask_are_not_taken():
    values = arrays()
    values["depth"] = np.ma.masked_less(values["depth"], np.inf)
    with pytest.raises(InvalidFrameError, match="depth is masked in places"):
        Frame(**values)

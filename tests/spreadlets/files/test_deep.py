"""Deep images: tidying against the document's own steps and against marching, and files through to depth layers."""

import struct

import numpy as np
import OpenEXR
import pytest
from naive.deep import flatten, integrate
from naive.deep import tidy as tidy_reference

from spreadlets.errors import InvalidFileError, InvalidFrameError, InvalidParameterError
from spreadlets.files import deep, exr_file
from spreadlets.files import exr_frames as exr
from spreadlets.files.conventions import Scale, stored_depth
from spreadlets.files.deep import DeepImage, layer_cuts, write_deep
from spreadlets.files.exr_chunks import deep_sample_bytes, read_deep_part
from spreadlets.scene.camera import ThinLens

SHAPE = (4, 6)
CAMERA = ThinLens(40, 32, 2.0, 3.0)


def of_open(function, path, *arguments):
    """What a function makes of an open file."""
    with open(path, "rb") as file:
        return function(file, *arguments)


def random_image(seed=0, *, volumes=True, motion=False, most=5, opaque=0.2):
    """Samples on a lattice of depths, so that many begin, end or lie at the same place."""
    rng = np.random.default_rng(seed)
    counts = rng.integers(0, most + 1, SHAPE)
    n = counts.sum()
    alpha = rng.random((n, 1))
    alpha[rng.random((n, 1)) < opaque] = 1
    front = 1 + 0.5 * rng.integers(0, 6, n)
    length = 0.5 * rng.integers(0, 4, n) if volumes else np.zeros(n)
    radiance = np.concatenate([rng.random((n, 3)) * alpha, alpha], axis=1)
    arrays = [a.astype(np.float32) for a in (radiance, front, front + length)]
    return DeepImage(counts, *arrays, rng.normal(size=(n, 2)).astype(np.float32) if motion else None)


def pixels(image):
    """Return the samples of each pixel as the reference takes them."""
    ends = np.cumsum(image.counts)
    rows = list(zip(image.depth, image.depth_back, image.radiance.astype(float), strict=True))
    samples = [(float(z), float(back), colour[3], colour[:3]) for z, back, colour in rows]
    return [samples[end - count : end] for end, count in zip(ends, image.counts.ravel(), strict=True)]


def composited(frame):
    colour = np.zeros((*frame.shape, 4))
    for layer in reversed(frame.layers):
        colour = layer.radiance + (1 - layer.radiance[..., 3:]) * colour
    return colour


@pytest.mark.interpreted
@pytest.mark.parametrize("seed", range(6))
def test_tidying_is_the_documents(seed):
    # Of three opaque samples at one place the document's pairs give unequal shares; they are tested apart.
    image = random_image(seed, opaque=0.0)
    for found, samples in zip(pixels(image.tidy()), pixels(image), strict=True):
        expected = tidy_reference(samples)
        assert [s[:2] for s in found] == [s[:2] for s in expected]
        np.testing.assert_allclose([s[2] for s in found], [s[2] for s in expected], rtol=1e-5, atol=1e-7)
        np.testing.assert_allclose(
            [s[3] for s in found] or [[]], [s[3] for s in expected] or [[]], rtol=1e-5, atol=1e-7
        )


def test_tidying_with_opaque_samples_hides_what_is_behind():
    image = random_image(3, opaque=0.5)
    for found, samples in zip(pixels(image.tidy()), pixels(image), strict=True):
        expected = tidy_reference(samples)
        assert [s[:2] for s in found] == [s[:2] for s in expected]
        np.testing.assert_allclose([s[2] for s in found], [s[2] for s in expected], rtol=1e-5)


def one_pixel(*samples):
    """Return an image of one pixel; a sample is (front, back, alpha, grey)."""
    rows = np.array(samples, np.float32)
    radiance = np.concatenate([np.repeat(rows[:, 3:], 3, axis=1), rows[:, 2:3]], axis=1)
    return DeepImage(np.array([[len(rows)]]), radiance, rows[:, 0], rows[:, 1])


def test_coinciding_opaque_samples_share_alike():
    tidy = one_pixel((2, 2, 1, 0.3), (2, 2, 1, 0.6), (2, 2, 1, 0.9), (2, 2, 0.5, 9.0)).tidy()
    assert tidy.counts.tolist() == [[1]]
    np.testing.assert_allclose(tidy.radiance[0], (0.6, 0.6, 0.6, 1), rtol=1e-6)


def test_a_sample_without_alpha_that_glows_keeps_its_light():
    tidy = one_pixel((1, 3, 0.0, 0.8), (2, 2, 0.5, 0.1)).tidy()
    np.testing.assert_allclose(tidy.radiance[:, 0], (0.4, 0.1, 0.4), rtol=1e-6)
    assert tidy.radiance[:, 3].tolist() == [0, 0.5, 0]


def test_overlapping_volumes_look_as_marching_through_them():
    samples = [(1.0, 3.0, 0.7, 0.5), (2.0, 5.0, 0.4, 0.1), (2.5, 2.75, 0.9, 0.8)]
    (tidy,) = pixels(one_pixel(*samples).tidy())
    colour, alpha = integrate([(*sample[:3], np.full(3, sample[3])) for sample in samples])
    found_colour, found_alpha = flatten(tidy)
    np.testing.assert_allclose(found_colour, colour, rtol=1e-3)
    np.testing.assert_allclose(found_alpha, alpha, rtol=1e-3)
    assert found_alpha == pytest.approx(1 - 0.3 * 0.6 * 0.1, rel=1e-5)


# --- Layers --------------------------------------------------------------------------------------------------------


@pytest.mark.interpreted
@pytest.mark.parametrize("max_layers", [1, 2, 3, 8])
@pytest.mark.parametrize("volumes", [True, False])
def test_layers_follow_each_other_in_depth_and_flatten_to_the_image(volumes, max_layers):
    image = random_image(1, volumes=volumes, motion=True)
    frame = image.layers(max_layers)
    assert 1 <= len(frame.layers) <= max_layers
    flat = [np.append(*flatten(samples)) for samples in pixels(image.tidy())]
    np.testing.assert_allclose(composited(frame).reshape(-1, 4), flat, rtol=1e-5, atol=1e-6)
    for near, far in zip(frame.layers[:-1], frame.layers[1:], strict=True):
        nearest, farthest = far.depth.min(), near.depth[near.radiance[..., 3] > 0].max()
        assert farthest < nearest


def two_surfaces(front=2.0):
    """Return a slanted floor behind a bar that leaves gaps, seen through it: two samples where the bar is."""
    height, width = 16, 24
    floor = np.broadcast_to(np.linspace(4, 12, height)[:, None], (height, width))
    bar = np.zeros((height, width), bool)
    bar[:, 5:10] = True
    counts = 1 + bar.astype(np.int64)
    depth = np.concatenate([[front, z] if b else [z] for b, z in zip(bar.ravel(), floor.ravel(), strict=True)])
    alpha = np.concatenate([[0.5, 1.0] if b else [1.0] for b in bar.ravel()])
    radiance = np.repeat(alpha[:, None], 4, axis=1).astype(np.float32)
    depth = depth.astype(np.float32)
    return DeepImage(counts, radiance, depth, depth), bar, floor.astype(np.float32)


def test_a_surface_before_another_is_a_layer_and_neither_is_cut():
    image, bar, floor = two_surfaces()
    front, back = image.layers().layers
    np.testing.assert_array_equal(front.radiance[..., 3], np.where(bar, 0.5, 0))
    assert (front.depth[bar] == 2).all() and np.isinf(front.depth[~bar]).all()
    np.testing.assert_allclose(back.depth, floor, rtol=1e-6)
    assert (back.radiance[..., 3] == 1).all()


def test_a_cut_that_costs_more_than_it_parts_is_not_made():
    image, bar, floor = two_surfaces()
    (layer,) = image.layers(1).layers
    assert (layer.radiance[..., 3] == 1).all()
    few = image.counts.cumsum().reshape(bar.shape)[3, 5] - 2  # keep the bar in one pixel only, near the floor's depth
    kept = np.ones(len(image.depth), bool)
    starts = np.concatenate([[0], np.cumsum(image.counts)])[:-1].reshape(bar.shape)
    kept[starts[bar]] = False
    kept[few] = True
    counts = np.ones(bar.shape, np.int64)
    counts[3, 5] = 2
    depth = image.depth.copy()
    depth[few] = 5.0  # parting it from the floor would cut the floor all along a row
    one = DeepImage(counts, image.radiance[kept], depth[kept], depth[kept])
    assert len(one.layers().layers) == 1


def cuts_by_search(image):
    """Return the best single cut by trying every one: pairs parted less half the samples parted from a neighbour's."""
    samples = [[1 / s[0] for s in pixel] for pixel in pixels(image)]
    low, high = min(min(p) for p in samples if p), max(max(p) for p in samples if p)
    bins = [[min(int((v - low) / (high - low) * 2048), 2047) for v in p] for p in samples]
    grid = np.empty(image.counts.shape, object)
    for index, pixel in zip(np.ndindex(grid.shape), bins, strict=True):
        grid[index] = pixel
    scores = {}
    for t in range(1, 2048):
        score = sum(a >= t > b for p in bins for a, b in zip(p[:-1], p[1:], strict=True))
        for a, b in [(grid[:, 1:], grid[:, :-1]), (grid[1:], grid[:-1])]:
            for p, q in [*zip(a.ravel(), b.ravel(), strict=True), *zip(b.ravel(), a.ravel(), strict=True)]:
                if q:
                    nearest = [min(q, key=lambda v, x=x: (abs(v - x), v)) for x in p]
                    score -= 0.25 * sum((x >= t) != (y >= t) for x, y in zip(p, nearest, strict=True))
        scores[t] = score
    best = max(scores.values())
    return [low + t / 2048 * (high - low) for t, score in scores.items() if score == best], best


@pytest.mark.parametrize("seed", [pytest.param(0, marks=pytest.mark.interpreted), 1, 2])
def test_the_best_cut_is_found(seed):
    image = random_image(seed, volumes=False, most=3).tidy()
    inverse = 1 / image.depth.astype(np.float64)
    start = np.concatenate([[0], np.cumsum(image.counts)])
    cuts = layer_cuts(inverse, start, SHAPE[1], 2)
    allowed, best = cuts_by_search(image)
    assert (len(cuts) == 0) == (best <= 0)
    assert all(np.isclose(cut, allowed).any() for cut in cuts)


def test_layers_that_take_too_much_memory_are_refused(monkeypatch):
    monkeypatch.setattr(deep, "MAX_VALUES", 2 * 16 * 24 * 6 - 1)
    with pytest.raises(InvalidParameterError, match="2 layers hold 4608 values; at most 4607"):
        two_surfaces()[0].layers()


def test_samples_of_a_layer_are_composited():
    (layer,) = one_pixel((10, 10, 0.5, 0.2), (11, 11, 1.0, 0.4)).layers(1).layers
    # 10 m is seen with .5, 11 m with .5 behind it.
    np.testing.assert_allclose(layer.depth[0, 0], 10.5, rtol=1e-6)
    np.testing.assert_allclose(layer.radiance[0, 0], (0.4, 0.4, 0.4, 1), rtol=1e-6)


def test_composited_neighbours_share_their_motion_and_the_background_stays_far():
    rows = {"depth": np.float32([3, np.inf]), "depth_back": np.float32([3, np.inf])}
    for alpha, depth, motion in ((0.75, 3, 1.0), (0.25, np.inf, 3.0)):
        radiance = np.float32([[alpha, alpha, alpha, alpha], [1, 1, 1, 1]])
        image = DeepImage(np.array([[2]]), radiance, **rows, motion=np.float32([[0, 0], [4, 4]]))
        (layer,) = image.layers(1).layers
        assert layer.depth[0, 0] == depth
        np.testing.assert_allclose(layer.motion[0, 0], motion, rtol=1e-6)


def test_a_volume_lies_in_its_middle():
    (layer,) = one_pixel((2, 4, 0.5, 0.2)).layers().layers
    assert layer.depth[0, 0] == 3


def test_an_image_without_samples_is_one_empty_layer():
    empty = DeepImage(np.zeros(SHAPE, np.int64), np.zeros((0, 4)), np.zeros(0), np.zeros(0))
    (layer,) = empty.layers().layers
    assert not layer.radiance.any() and np.isinf(layer.depth).all()
    with pytest.raises(InvalidParameterError, match="max_layers is 0"):
        empty.layers(0)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("radiance", np.nan, "radiance is not finite"),
        ("depth", -1, "depth is NaN, zero or negative"),
        ("depth_back", 0.5, "depth_back is NaN or nearer"),
        ("depth_back", np.inf, "infinite behind a finite depth"),
        ("motion", np.inf, "motion is not finite"),
    ],
)
def test_bad_samples_are_named(name, value, message):
    image = random_image(motion=True)
    arrays = {key: getattr(image, key).copy() for key in ("radiance", "depth", "depth_back", "motion")}
    pixel = int(np.flatnonzero(image.counts.ravel() > 1)[2])
    arrays[name][image.counts.ravel()[:pixel].sum() + 1] = value
    row, col = divmod(pixel, SHAPE[1])
    with pytest.raises(InvalidFrameError, match=rf"{message}.* at 1 of .* first at \(row {row}, col {col}\)"):
        DeepImage(image.counts, **arrays)


def test_wrong_shapes_are_refused():
    with pytest.raises(InvalidFrameError, match=r"depth has shape \(2,\); the counts ask for \(3,\)"):
        DeepImage(np.array([[3]]), np.ones((3, 4)), np.ones(2), np.ones(3))


# --- Files ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("motion", [True, False])
def test_a_deep_file_becomes_the_layers_of_its_image(tmp_path, motion):
    image = random_image(4, motion=motion)
    write_deep(tmp_path / "deep.exr", image)
    found, expected = exr.read_frame(tmp_path / "deep.exr"), image.layers()
    assert len(found.layers) == len(expected.layers) > 1
    for a, b in zip(found.layers, expected.layers, strict=True):
        for name in ("radiance", "depth", "motion"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
        assert a.has_motion == motion
    assert len(exr.read_frame(tmp_path / "deep.exr", max_layers=1).layers) == 1


def write(path, channels, counts, **header):
    stored = {}
    for name, flat in channels.items():
        stored[name] = np.empty(counts.shape, object)
        for index, values in zip(np.ndindex(counts.shape), np.split(flat, np.cumsum(counts)[:-1]), strict=True):
            stored[name][index] = values.astype(np.float32)
    header = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION, **header}
    OpenEXR.File(header, stored).write(str(path))
    return path


def channels(n, **changes):
    values = {"R": 0.5, "G": 0.5, "B": 0.5, "A": 0.5, "Z": 3.0} | changes
    return {name: np.broadcast_to(np.float32(value), n).copy() for name, value in values.items() if value is not None}


def test_conventions_hold_for_deep_samples_too(tmp_path):
    counts = np.full(SHAPE, 2)
    planar = np.full(SHAPE, 5.0, np.float32)
    options = {"camera": CAMERA, "depth_scale": 0.01, "baseline_m": 0.1}
    for convention in ("planar", "ray", "inverse", "disparity"):
        front, back = (np.repeat(stored_depth(convention, d * planar, Scale(**options)), 2) for d in (1, 1.2))
        flat = channels(counts.sum(), Z=front, ZBack=back) | {
            "velocity.R": np.full(48, 0.25, np.float32),
            "velocity.G": np.full(48, -0.5, np.float32),
        }
        path = write(tmp_path / "deep.exr", flat, counts)
        frame = exr.read_frame(path, depth_convention=convention, motion_convention="ndc", **options)
        np.testing.assert_allclose(frame.layers[0].depth, 5.5, rtol=1e-6)
        np.testing.assert_allclose(frame.layers[0].motion[0, 0], (0.25 * 3, 0.5 * 2), rtol=1e-6)


def test_curved_motion_of_deep_samples_is_averaged(tmp_path):
    vector = {f"Vector.{axis}": value for axis, value in zip("XYZW", (-3, 2, -5, 4), strict=True)}
    path = write(tmp_path / "deep.exr", channels(24, **vector), np.ones(SHAPE, np.int64))
    assert (exr.read_frame(path).layers[0].motion == (4, 3)).all()


def test_a_cropped_deep_file_and_unpremultiplied_colours(tmp_path):
    display = (np.array([0, 0], np.int32), np.array([7, 5], np.int32))
    data = (np.array([1, 2], np.int32), np.array([6, 5], np.int32))
    counts = np.ones(SHAPE, np.int64)
    path = write(tmp_path / "deep.exr", channels(24), counts, displayWindow=display, dataWindow=data)
    (layer,) = exr.read_frame(path, unpremultiplied=True).layers
    assert layer.shape == (6, 8)
    assert (layer.radiance[2:6, 1:7] == (0.25, 0.25, 0.25, 0.5)).all() and layer.radiance[..., 3].sum() == 12


def test_bad_deep_samples_are_refused_or_dropped_and_empty_ones_ignored(tmp_path):
    z = np.full(24, 3.0)
    z[7] = -1
    colours = {"R": np.where(np.arange(24) == 9, 0, 0.5), "A": np.where(np.arange(24) == 9, 0, 0.5)}
    z[9] = -1  # nothing to see there
    flat = channels(24, Z=z, **colours)
    flat["G"][9] = flat["B"][9] = 0
    path = write(tmp_path / "deep.exr", flat, np.ones(SHAPE, np.int64))
    with pytest.raises(InvalidFrameError, match=r"deep\.exr: depth .* at 1 of 23 deep samples, first at \(row 1,"):
        exr.read_frame(path)
    with pytest.warns(UserWarning, match="1 invalid deep samples were mended"):
        frame = exr.read_frame(path, repair=True)
    alpha = np.sum([layer.radiance[..., 3] > 0 for layer in frame.layers], axis=0)
    assert np.count_nonzero(alpha) == 23
    assert sum(np.count_nonzero(np.isinf(each.depth) & (each.radiance[..., 3] > 0)) for each in frame.layers) == 1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"A": None}, "lacks alpha, which deep samples need"),
        ({"Z": None}, "lacks a depth channel"),
        ({"R": None}, "lacks colour channels"),
    ],
)
def test_missing_deep_channels_are_named(tmp_path, changes, message):
    path = write(tmp_path / "deep.exr", channels(24, **changes), np.ones(SHAPE, np.int64))
    with pytest.raises(InvalidFileError, match=message):
        exr.read_frame(path)


def test_flat_readers_refuse_deep_files(tmp_path):
    write_deep(tmp_path / "deep.exr", random_image())
    with pytest.raises(InvalidFileError, match="holds a deep image; only flat images can be read here"):
        exr.read_image(tmp_path / "deep.exr")


def test_velocities_in_space_are_for_flat_images(tmp_path):
    path = write(
        tmp_path / "deep.exr",
        channels(24, **{f"dPdtime.{c}": 1.0 for c in "rgb"}),
        np.ones(SHAPE, np.int64),
    )
    with pytest.raises(InvalidParameterError, match="camera-velocity is for flat images only"):
        exr.read_frame(path, camera=CAMERA, motion_convention="camera-velocity")


@pytest.mark.parametrize("compression", ["NO_COMPRESSION", "RLE_COMPRESSION", "ZIPS_COMPRESSION"])
@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.uint32])
def test_unpacking_is_the_librarys(tmp_path, compression, dtype):
    rng = np.random.default_rng(1)
    shape = (5, 9)
    stored = {name: np.empty(shape, object) for name in ("A", "R", "Z")}
    counts = rng.integers(0, 4, shape) * (rng.random(shape) > 0.3)
    for index in np.ndindex(shape):
        for name, plane in stored.items():  # A repeats itself, so that it packs; R does not
            values = rng.random(counts[index]) * 1e4 if name == "R" else np.full(counts[index], 7)
            plane[index] = values.astype(dtype)
    header = {"type": OpenEXR.deepscanline, "compression": getattr(OpenEXR, compression)}
    window = (np.array([2, 3], np.int32), np.array([10, 7], np.int32))
    OpenEXR.File({**header, "dataWindow": window, "displayWindow": window}, stored).write(str(tmp_path / "deep.exr"))
    expected = OpenEXR.File(str(tmp_path / "deep.exr"), separate_channels=True).parts[0].channels
    found = of_open(read_deep_part, tmp_path / "deep.exr", 0)
    np.testing.assert_array_equal(found.counts, counts)
    for name, channel in expected.items():
        values = [pixel for pixel in channel.pixels.ravel() if pixel is not None]
        np.testing.assert_array_equal(found.channels[name], np.concatenate(values).astype(np.float32))


@pytest.mark.parametrize("damage", ["wrong", "missing"])
def test_a_damaged_checksum_of_packed_samples_is_found(tmp_path, damage):
    path = tmp_path / "deep.exr"
    write_deep(path, random_image())
    content = bytearray(path.read_bytes())
    if damage == "wrong":
        content[-1] ^= 1  # the last line's samples end with it
    else:
        lines = random_image().counts.shape[0]
        first = next(i for i in range(len(content)) if content[i : i + 8] == struct.pack("<Q", i + 8 * lines))
        size = struct.unpack_from("<Q", content, first + 8 * (lines - 1))[0] + 12
        struct.pack_into("<Q", content, size, struct.unpack_from("<Q", content, size)[0] - 4)
    path.write_bytes(content)
    with pytest.raises(InvalidFileError, match="truncated or corrupt"):
        of_open(read_deep_part, path, 0)


@pytest.mark.parametrize("seed", range(30))
def test_damaged_deep_files_are_refused_or_read_but_nothing_else(tmp_path, seed):
    path = tmp_path / "deep.exr"
    write_deep(path, random_image())
    content = bytearray(path.read_bytes())
    rng = np.random.default_rng(seed)
    for at in rng.integers(8, len(content), 3):
        content[at] = rng.integers(256)
    path.write_bytes(content)
    try:
        exr.read_frame(path, depth_convention="planar")
    except (InvalidFileError, InvalidFrameError):
        pass


# --- Sizes before memory -------------------------------------------------------------------------------------------


def test_the_size_of_the_samples_is_known_before_they_are_read(tmp_path, monkeypatch):
    image = random_image(5, motion=True)
    write_deep(tmp_path / "deep.exr", image)
    n_bytes = 8 * 4 * int(image.counts.sum())
    assert of_open(deep_sample_bytes, tmp_path / "deep.exr") == n_bytes
    limit = 8 * image.counts.size + n_bytes // 4
    monkeypatch.setattr(exr_file, "MAX_VALUES", limit - 1)
    with pytest.raises(InvalidFileError, match=f"holds {limit} values"):
        exr.read_frame(tmp_path / "deep.exr")
    monkeypatch.setattr(exr_file, "MAX_VALUES", limit)
    exr.read_frame(tmp_path / "deep.exr")


def test_only_the_deep_part_of_a_file_of_several_parts_counts(tmp_path):
    header = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION, "name": "deep"}
    counts = np.ones(SHAPE, np.int64)
    path = write(tmp_path / "one.exr", channels(24), counts)
    deep = OpenEXR.File(str(path), separate_channels=True).parts[0].channels
    flat = {"R": np.ones(SHAPE, np.float32)}
    parts = [OpenEXR.Part({"type": OpenEXR.scanlineimage, "name": "flat"}, flat)]
    parts.append(OpenEXR.Part(header, {name: channel.pixels for name, channel in deep.items()}))
    OpenEXR.File(parts).write(str(tmp_path / "two.exr"))
    assert of_open(deep_sample_bytes, tmp_path / "two.exr") == 5 * 24 * 4
    assert (exr.read_frame(tmp_path / "two.exr").layers[0].depth == 3).all()


@pytest.mark.parametrize("share", [0.1, 0.3, 0.6, 0.95])
def test_truncated_deep_files_are_refused(tmp_path, share, capfd):
    path = tmp_path / "deep.exr"
    write_deep(path, random_image())
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(InvalidFileError) as error:
        exr.read_frame(path)
    assert str(path) in str(error.value) and "\n" not in str(error.value)
    assert capfd.readouterr() == ("", "")


def test_a_window_that_the_library_does_not_understand_is_refused(tmp_path):
    path = tmp_path / "deep.exr"
    write_deep(path, random_image())
    content = (
        path.read_bytes().replace(b"dataWindow\0box2i", b"dataWindow\0box3i").replace(b"chunkCount", b"chunkcount")
    )
    path.write_bytes(content)
    with pytest.raises(InvalidFileError):
        exr.read_frame(path)


@pytest.mark.parametrize("count", [-5, 2**31 - 1])
def test_lies_about_the_number_of_chunks_are_refused(tmp_path, count):
    path = tmp_path / "deep.exr"
    write_deep(path, random_image())
    content = path.read_bytes()
    at = content.index(b"chunkCount\0int\0") + len(b"chunkCount\0int\0") + 4
    path.write_bytes(content[:at] + struct.pack("<i", count) + content[at + 4 :])
    with pytest.raises(InvalidFileError):
        of_open(deep_sample_bytes, path)
    with pytest.raises(InvalidFileError):
        exr.read_frame(path)


def deep_scene(objects):
    """Discs at depths, (mask, depth, colour), each opaque."""
    objects = sorted(objects, key=lambda item: item[1])
    counts = sum(mask.astype(np.int64) for mask, _, _ in objects)
    found = [(colour, z) for place in np.ndindex(counts.shape) for mask, z, colour in objects if mask[place]]
    radiance = np.array([(*colour, 1) for colour, _ in found], np.float32)
    z = np.array([z for _, z in found], np.float32)
    return DeepImage(counts, radiance, z, z)


def test_deep_files_of_one_scene_are_merged_sample_by_sample(tmp_path):
    """Each file holds something in front of and behind what the other holds."""
    rng = np.random.default_rng(3)
    masks = rng.random((4, 10, 12)) < 0.5
    objects = [(mask, z, rng.random(3)) for mask, z in zip(masks, (2.0, 3.0, 6.0, 9.0), strict=True)]
    parts = objects[0::2], objects[1::2]
    for name, part in zip("ab", parts, strict=True):
        write_deep(tmp_path / f"{name}.exr", deep_scene(part))
    write_deep(tmp_path / "whole.exr", deep_scene(objects))
    whole = exr.read_frame(tmp_path / "whole.exr")
    for order in ("ab", "ba"):
        frame = exr.read_frame([tmp_path / f"{name}.exr" for name in order])
        for layer, truth in zip(frame.layers, whole.layers, strict=True):
            np.testing.assert_array_equal(layer.radiance, truth.radiance)
            np.testing.assert_array_equal(layer.depth, truth.depth)


def test_deep_images_of_other_shapes_are_not_merged():
    images = [random_image(), deep_scene([(np.ones((2, 2), bool), 1.0, (1, 1, 1))])]
    with pytest.raises(InvalidFrameError, match="deep image 1 has shape"):
        DeepImage.merged(images)


def test_alpha_of_deep_files_may_have_other_names(tmp_path):
    counts = np.ones(SHAPE, np.int64)
    for names in ({"AR": 0.25, "AG": 0.5, "AB": 0.75}, {"alpha": 0.5}):
        flat = {name: value for name, value in channels(24).items() if name != "A"}
        path = write(
            tmp_path / "deep.exr", flat | {name: np.full(24, v, np.float32) for name, v in names.items()}, counts
        )
        assert np.allclose(exr.read_frame(path).layers[0].radiance[..., 3], 0.5)

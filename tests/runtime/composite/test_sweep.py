"""The blur by a swept disc against a sum over its pixels, one by one."""

import numpy as np
import pytest

from spreadlets.runtime.composite.sweep import reduction, sweep_blur, sweep_spans


def naive(image, radius, path):
    """Mean of the pixels of each span around each pixel; beyond the border the nearest repeat."""
    first, last = sweep_spans(radius, path)
    n = len(first) // 2
    result = np.zeros_like(image)
    for row, col in np.ndindex(*image.shape):
        values = [
            image[min(max(row + each - n, 0), image.shape[0] - 1), min(max(col + x, 0), image.shape[1] - 1)]
            for each in range(len(first))
            for x in range(first[each], last[each] + 1)
        ]
        result[row, col] = np.mean(values)
    return result


@pytest.mark.interpreted
@pytest.mark.parametrize(("radius", "path"), [(0.7, (0, 0)), (1.0, (0, 0)), (3.2, (4.0, -2.0)), (0.0, (7.0, 3.0))])
@pytest.mark.parametrize("shape", [(9, 14), (4, 5)])
def test_the_blur_is_the_mean_over_the_spans(radius, path, shape):
    image = np.random.default_rng(0).random(shape).astype(np.float32)
    assert np.allclose(sweep_blur(image, radius, path), naive(image, radius, path), atol=1e-6)


@pytest.mark.parametrize(
    ("radius", "path"), [(5.0, (0.0, 0.0)), (5.0, (9.0, 0.0)), (4.0, (6.0, 8.0)), (9.0, (-3.0, 20.0))]
)
def test_the_spans_are_those_of_a_swept_disc(radius, path):
    first, last = sweep_spans(radius, path)
    n = len(first) // 2
    y, x = np.mgrid[-n : n + 1, -40:41]
    along = np.clip((x * path[0] + y * path[1]) / max(np.hypot(*path) ** 2, 1e-9), -0.5, 0.5)
    inside = np.hypot(x - along * path[0], y - along * path[1]) <= radius
    spans = (x >= first[:, None]) & (x <= last[:, None])
    assert (spans ^ inside).sum() <= 0.04 * inside.sum()
    assert len(first) == 2 * int(radius + abs(path[1]) / 2) + 1


@pytest.mark.parametrize(("radius", "path"), [(20.0, (0.0, 0.0)), (40.0, (10.0, 5.0)), (3.0, (60.0, 20.0))])
def test_a_wide_blur_at_reduced_size_is_close_to_that_at_full_size(radius, path):
    image = np.zeros((150, 170), np.float32)
    image[40:90, 50:110] = 1.0
    assert np.abs(sweep_blur(image, radius, path) - naive_by_shift(image, radius, path)).max() < 0.03


def naive_by_shift(image, radius, path):
    """The same as `naive`, a span at a time."""
    first, last = sweep_spans(radius, path)
    n = len(first) // 2
    margin = n + int(np.abs([first, last]).max()) + 1
    padded = np.pad(image.astype(float), margin, mode="edge")
    sums = np.pad(padded.cumsum(axis=1), ((0, 0), (1, 0)))
    height, width = image.shape
    total = np.zeros(image.shape)
    for each in range(len(first)):
        rows = sums[margin + each - n :][:height]
        total += rows[:, margin + last[each] + 1 :][:, :width] - rows[:, margin + first[each] :][:, :width]
    return total / (last - first + 1).sum()


def test_a_blur_within_a_pixel_changes_nothing():
    image = np.random.default_rng(0).random((6, 7)).astype(np.float32)
    assert np.array_equal(sweep_blur(image, 0.3, (0.2, 0.1)), image)


@pytest.mark.parametrize("radius", [3.0, 30.0])
def test_one_value_stays_that_value(radius):
    assert np.abs(sweep_blur(np.full((40, 50), 0.7, np.float32), radius, (5.0, 2.0)) - 0.7).max() < 1e-6


@pytest.mark.parametrize(("radius", "path"), [(1e9, (0.0, 0.0)), (3.0, (1e30, -1e30)), (1e30, (0.0, 0.0))])
def test_a_blur_wider_than_any_image_is_the_mean_and_costs_no_more(radius, path):
    image = np.random.default_rng(0).random((40, 50)).astype(np.float32)
    assert reduction(radius, path) <= 1 << 24  # the work grows with it
    assert np.abs(sweep_blur(image, radius, path) - image.mean()).max() < 1e-6

"""Layers that blur alike hide each other together: compared with what each point of the lens sees."""

import numpy as np
import pytest

import spreadlets as sp
from spreadlets.runtime.composite import overlap, visibility

SIZE = 160
DEPTHS = 3.0, 3.3, 9.0
POINTS = 17


def camera():
    return sp.ThinLens(focal_length_mm=50.0, focus_distance_m=2.0, f_number=0.2, sensor_width_mm=18.0)


def planes():
    """Return leaves in two planes, half of each empty, and a wall, (H, W, 4) each, nearest first."""
    rng = np.random.default_rng(3)
    leaves = [np.kron(rng.random((SIZE // 4, SIZE // 4)) < 0.5, np.ones((4, 4))) for _ in range(2)]
    colours = (0.1, 0.3, 0.05), (0.4, 0.1, 0.05), (0.9, 0.9, 1.0)
    covers = [*leaves, np.ones((SIZE, SIZE))]
    return [
        np.concatenate([np.multiply.outer(a, c), a[..., None]], axis=-1) for a, c in zip(covers, colours, strict=True)
    ]


def moved(padded, far, down, across):
    """Return an image that was padded by so many pixels as it is when moved, bilinear."""
    row, col = int(np.floor(-down)), int(np.floor(-across))
    found = 0.0
    for i, of_row in enumerate((1.0 + row + down, -row - down)):
        for j, of_col in enumerate((1.0 + col + across, -col - across)):
            top, left = far + row + i, far + col + j
            found = found + of_row * of_col * padded[top : top + SIZE, left : left + SIZE]
    return found


def through_the_lens(layers, radii):
    """Return the mean of what points of the lens see."""
    far = int(max(map(abs, radii))) + 2
    padded = [np.pad(each, ((far, far), (far, far), (0, 0)), mode="edge") for each in layers]
    axis = (np.arange(POINTS) + 0.5) / POINTS * 2.0 - 1.0
    places = [(x, y) for x in axis for y in axis if np.hypot(x, y) <= 1.0]
    total = 0.0
    for x, y in places:
        seen = np.zeros((SIZE, SIZE, 4))
        for layer, radius in zip(padded, radii, strict=True):
            seen += (1.0 - seen[..., 3:]) * moved(layer, far, radius * y, radius * x)
        total = total + seen
    return total / len(places)


@pytest.fixture(scope="module")
def truth():
    radii = [float(np.asarray(camera().coc_radius(np.float32(z), SIZE))) for z in DEPTHS]
    return through_the_lens(planes(), radii)


def inner_error(image, truth):
    inner = slice(32, -32)
    return float(np.abs(image - truth)[inner, inner].mean())


def in_layers():
    return sp.Frame.from_layers([(each, np.full((SIZE, SIZE), z)) for each, z in zip(planes(), DEPTHS, strict=True)])


def test_leaves_before_leaves_are_seen_as_points_of_the_lens_see_them(truth, monkeypatch):
    error = inner_error(sp.synthesize(in_layers(), camera()), truth)
    monkeypatch.setattr(visibility, "find_overlap", lambda *given, **options: None)
    apart = inner_error(sp.synthesize(in_layers(), camera()), truth)
    assert error < 0.5 * apart
    assert error < 0.01


def test_what_is_even_or_in_focus_has_no_overlap(monkeypatch):
    found = []
    monkeypatch.setattr(
        visibility, "find_overlap", lambda *given, **options: found.append(overlap.find_overlap(*given, **options))
    )
    veils = [np.full((SIZE, SIZE, 4), 0.5), np.full((SIZE, SIZE, 4), 0.5), np.ones((SIZE, SIZE, 4))]
    sp.synthesize(
        sp.Frame.from_layers([(each, np.full((SIZE, SIZE), z)) for each, z in zip(veils, DEPTHS, strict=True)]),
        camera(),
    )
    sharp = [(each, np.full((SIZE, SIZE), 2.0 + 1e-4 * k)) for k, each in enumerate(planes())]
    sp.synthesize(sp.Frame.from_layers(sharp), camera())
    assert found == [None, None]


def test_points_are_spread_evenly_over_lens_and_shutter():
    points = overlap._points()
    assert np.abs(points.mean(axis=0)).max() < 1e-12
    assert np.abs((points[:, :2] ** 2).mean(axis=0) - 0.25).max() < 0.01
    assert abs((points[:, 2] ** 2).mean() - 1.0 / 12.0) < 0.001

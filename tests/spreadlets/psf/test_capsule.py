"""PSFs of a round thin lens in closed form."""

import numpy as np
import pytest
from naive.psfs import capsule_psf, disc_coverage

from spreadlets.metrics import psf_similarity
from spreadlets.parallel import limit_threads
from spreadlets.psf.capsule import exact_capsules

SHAPES = [(0.3, 30.0, 0.4), (1.0, 0.0, 0.0), (2.5, 7.0, -1.2), (4.0, 10.0, 2.2), (12.0, 0.0, 0.0), (20.0, 20.0, 2.0)]


def drawn(radius, length, angle):
    """The dense PSF of one capsule, (h, w)."""
    one = exact_capsules(np.array([[radius, length]]), np.array([angle]), np.array([1]))
    return next(one).to_dense()[..., 0]


def on_window(psf, shape):
    """Cut or pad a centred PSF to a shape of odd sides."""
    rows, cols = (max(have - want, 0) // 2 for have, want in zip(psf.shape, shape, strict=True))
    cut = psf[rows : psf.shape[0] - rows, cols : psf.shape[1] - cols]
    return np.pad(cut, [((want - have) // 2,) * 2 for have, want in zip(cut.shape, shape, strict=True)])


@pytest.mark.parametrize(("radius", "length", "angle"), SHAPES)
def test_a_capsule_is_the_disc_swept_along_its_path(radius, length, angle):
    exact = capsule_psf(radius, length, angle) if length else disc_coverage(radius)
    psf = on_window(drawn(radius, length, angle), exact.shape)
    assert psf.sum() == pytest.approx(1.0, abs=1e-5)
    assert np.abs(psf - exact).max() < 0.025 * exact.max()  # measured .022, of the thinnest; .01 of the others
    assert psf_similarity(exact, psf) > 0.9999


@pytest.mark.parametrize("angle", [0.0, 0.5 * np.pi, 1.0])
def test_a_line_without_width_is_a_line_without_gaps(angle):
    """Pixels along the path get the same light each; no line through a pixel may miss the disc."""
    psf = drawn(0.0, 21.0, angle)
    assert psf.sum() == pytest.approx(1.0, abs=1e-5)
    row, col = (int(round(8 * each)) for each in (np.sin(angle), np.cos(angle)))
    half = np.array(psf.shape) // 2
    along = psf.sum(axis=0 if abs(np.cos(angle)) > abs(np.sin(angle)) else 1)
    middle = along[len(along) // 2 - 4 : len(along) // 2 + 5]
    assert np.ptp(middle) < 0.08 * middle.mean()  # measured .05
    assert psf[half[0] + row, half[1] + col] > 0.0


def test_capsules_do_not_depend_on_each_other_or_on_threads():
    coordinate, angle = np.array(SHAPES)[:, :2], np.array(SHAPES)[:, 2]
    side = np.ones(len(SHAPES), np.int64)
    together = list(exact_capsules(coordinate, angle, side))
    with limit_threads(1):
        alone = list(exact_capsules(coordinate, angle, side))
    for psf, same, shape in zip(together, alone, SHAPES, strict=True):
        assert psf.direct and (np.diff(psf.offset_rc[:, 0]) >= 0).all(), "rows ascend"
        np.testing.assert_array_equal(psf.value, same.value)
        np.testing.assert_array_equal(psf.to_dense()[..., 0], drawn(*shape))


def test_what_does_not_move_has_no_direction():
    still = exact_capsules(np.array([[5.0], [5.0]]), np.array([0.0, 1.0]), np.array([1, -1]))
    one, other = (psf.to_dense() for psf in still)
    np.testing.assert_array_equal(one, other)
    np.testing.assert_allclose(one, one[::-1, ::-1], atol=1e-9)


def test_exact_capsules_are_drawn_once(monkeypatch):
    given = np.array([[5.03125, 7.0], [6.03125, 0.0]]), np.array([0.25, 0.0]), np.array([1, 1])
    first = list(exact_capsules(*given))
    monkeypatch.setattr("spreadlets.psf.capsule.for_bands", None)
    again = list(exact_capsules(*(each[::-1] for each in given)))
    for one, other in zip(first, again[::-1], strict=True):
        np.testing.assert_array_equal(one.to_dense(), other.to_dense())

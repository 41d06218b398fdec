import itertools

import numpy as np
import pytest
from naive.psfs import capsule_psf

from spreadlets.errors import InvalidParameterError
from spreadlets.psf.laplacian import laplacian
from spreadlets.psf.spreadlet import Spreadlet


def whole_laplacian(psf):
    """The spreadlet that holds every pixel of a PSF's Laplacian."""
    field = laplacian(np.asarray(psf, dtype=np.float64))
    points = np.argwhere(field != 0)
    value = field[points[:, 0], points[:, 1], None]
    return Spreadlet((points - np.array(field.shape) // 2).astype(np.int16), value.astype(np.float32))


def test_reconstruction_is_exact_to_single_precision():
    psf = capsule_psf(4.0, 7.0, 0.3)
    dense = whole_laplacian(psf).to_dense()[1:-1, 1:-1, 0]
    half = np.array(dense.shape) // 2
    full = np.zeros_like(dense)
    reach = np.array(psf.shape) // 2
    rows, cols = (slice(max(h - r, 0), h + r + 1) for h, r in zip(half, reach, strict=True))
    cut = tuple(slice(max(r - h, 0), r + h + 1) for h, r in zip(half, reach, strict=True))
    full[rows, cols] = psf[cut]
    np.testing.assert_allclose(dense, full, atol=1e-6 * psf.max())


def test_margin_grows_the_window_about_the_same_centre():
    spreadlet = whole_laplacian(capsule_psf(3.0, 0.0, 0.0))
    tight, wide = spreadlet.to_dense(), spreadlet.to_dense(margin=5)
    assert wide.shape == (tight.shape[0] + 10, tight.shape[1] + 10, 1)
    np.testing.assert_allclose(wide[5:-5, 5:-5], tight, atol=1e-12)


def test_direct_points_are_pixels():
    offset = np.array([[0, 0], [-2, 1]], dtype=np.int16)
    value = np.array([[0.75, 0.5], [0.25, 0.5]], dtype=np.float32)
    dense = Spreadlet(offset, value, direct=True).to_dense()
    assert dense.shape == (5, 3, 2)
    np.testing.assert_array_equal(dense[2, 1], value[0])
    np.testing.assert_array_equal(dense[0, 2], value[1])
    assert np.count_nonzero(dense) == 4


def test_moments_of_a_psf_s_laplacian():
    moments = whole_laplacian(capsule_psf(4.0, 7.0, 0.3)).moments()
    np.testing.assert_allclose(moments[:, 0], [0, 0, 0, 0, 2, 2], atol=1e-5)


@pytest.mark.parametrize("flags", list(itertools.product([False, True], repeat=3)))
def test_symmetries_commute_with_reconstruction(flags):
    transpose, flip_row, flip_col = flags
    spreadlet = whole_laplacian(capsule_psf(3.0, 5.0, 0.3))
    expected = spreadlet.to_dense()
    expected = expected.swapaxes(0, 1) if transpose else expected
    expected = expected[:: -1 if flip_row else 1, :: -1 if flip_col else 1]
    moved = spreadlet.transformed(transpose=transpose, flip_row=flip_row, flip_col=flip_col)
    np.testing.assert_allclose(moved.to_dense(), expected, atol=1e-9)
    assert moved.offset_rc.dtype == np.int16


def test_counts_and_extent():
    spreadlet = Spreadlet(np.array([[-3, 1], [2, -7]], dtype=np.int16), np.zeros((2, 3), dtype=np.float32))
    assert (spreadlet.n_points, spreadlet.n_channels, spreadlet.extent) == (2, 3, (3, 7))
    empty = Spreadlet(np.zeros((0, 2), dtype=np.int16), np.zeros((0, 1), dtype=np.float32))
    assert empty.extent == (0, 0)
    assert empty.to_dense().shape == (1, 1, 1)


@pytest.mark.parametrize(
    ("offset", "value", "message"),
    [
        (np.zeros((2, 2)), np.zeros((2, 1), np.float32), "int16"),
        (np.zeros((2, 2), np.int16), np.zeros((2, 1)), "float32"),
        (np.zeros((2, 3), np.int16), np.zeros((2, 1), np.float32), "shape"),
        (np.zeros((2, 2), np.int16), np.zeros((3, 1), np.float32), "shape"),
        (np.zeros((2, 2), np.int16), np.zeros(2, np.float32), "shape"),
    ],
)
def test_ill_fitting_arrays_are_refused(offset, value, message):
    with pytest.raises(InvalidParameterError, match=message):
        Spreadlet(offset, value)


def test_negative_margin_is_refused():
    with pytest.raises(InvalidParameterError, match="margin must be at least 0 px, not -1"):
        whole_laplacian(np.ones((1, 1))).to_dense(margin=-1)

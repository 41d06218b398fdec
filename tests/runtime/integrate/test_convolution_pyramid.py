import warnings

import numpy as np
import pytest
from naive.pyramid import published_naive, pyramid_naive
from threads import for_thread_counts

from spreadlets.errors import InvalidParameterError
from spreadlets.parallel import thread_count
from spreadlets.psf.laplacian import laplacian, solve_dirichlet
from spreadlets.runtime.integrate.convolution_pyramid import (
    COARSER_FILTERS,
    COARSEST_SIDE,
    FINEST_FILTERS,
    PUBLISHED_FILTERS,
    Integrator,
    UnbalancedSourceWarning,
    complete_taps,
    integrate,
)
from spreadlets.runtime.options import DEFAULT_INTEGRATOR, INTEGRATORS

FLOAT32_ROUNDING = 5e-6
"""Relative error that float32 leaves in any of the integrators on some hundred pixels."""

DISC_BUDGET = {"exact": 5e-6, "pyramid": 6e-3, "multigrid": 4e-6, "pyramid-f5": 0.12, "pyramid-f7": 0.075}
"""Relative L2 error on hard discs of radius 12 to 60, a quarter above what was measured; two cycles."""
ONE_CYCLE_BUDGET = 2e-4
"""The same with one cycle, the default."""
RINGING_BUDGET = 0.012
"""Worst pixel of `pyramid` on the same, relative to the disc's value."""
CYCLE_FACTOR = 10
"""Least reduction of the error by a cycle, until float32 ends it."""


def disc(shape, radius, centre=None, value=1.0):
    row, col = centre or (0.5 * shape[0] + 0.3, 0.5 * shape[1] - 0.1)
    y, x = np.mgrid[: shape[0], : shape[1]]
    return (value * (np.hypot(y - row, x - col) < radius)).astype(np.float32)


def source_of(*planes):
    """Laplacian of an image given by its channels."""
    return np.ascontiguousarray(laplacian(np.stack(planes, axis=2))[1:-1, 1:-1])


def relative_error(image, expected):
    return np.linalg.norm(image.astype(np.float64) - expected) / np.linalg.norm(expected)


def neutral_points(shape, seed, count=60):
    """Random points, their values projected so that the moments up to the second vanish."""
    rng = np.random.default_rng(seed)
    at = np.stack([rng.integers(side // 3, side - side // 3, count) for side in shape], axis=1)
    y, x = (at / shape - 0.5).T
    moments = np.stack([np.ones(count), x, y, x * y, x * x, y * y])
    values = rng.normal(size=count)
    values -= moments.T @ np.linalg.solve(moments @ moments.T, moments @ values)
    plane = np.zeros(shape, np.float32)
    np.add.at(plane, tuple(at.T), values)
    return plane


class TestAccuracy:
    @pytest.mark.parametrize("method", INTEGRATORS)
    @pytest.mark.parametrize("radius", [12, 60])
    def test_reconstructs_a_disc_within_budget(self, method, radius):
        image = disc((255, 255), radius)
        result = integrate(source_of(image), method, cycles=2)[:, :, 0]
        assert relative_error(result, image) < DISC_BUDGET[method]
        if method == "pyramid":
            assert np.abs(result - image).max() < RINGING_BUDGET

    @pytest.mark.parametrize("plane", [disc((127, 127), 20), neutral_points((127, 127), 0)])
    def test_each_cycle_reduces_the_error(self, plane):
        source = source_of(plane) if plane.max() == 1 else plane[:, :, None]
        exact = solve_dirichlet(source.astype(np.float64))
        errors = [relative_error(integrate(source, "multigrid", cycles=n), exact) for n in range(4)]
        for before, after in zip(errors, errors[1:], strict=False):
            assert after < max(before / CYCLE_FACTOR, FLOAT32_ROUNDING)
        assert errors[-1] < FLOAT32_ROUNDING

    @pytest.mark.parametrize(
        "shape", [(1, 90), (90, 1), (64, 64), (97, 101), (80, 211), (17, 400), (63, 130), (66, 1100)]
    )
    @pytest.mark.filterwarnings("ignore::spreadlets.runtime.integrate.convolution_pyramid.UnbalancedSourceWarning")
    def test_any_shape_is_as_accurate(self, shape):
        # One row or column cannot hold a whole Laplacian; the answer that is zero around it is defined all the same.
        image = disc(shape, 0.3 * min(shape) + 0.5, centre=(shape[0] // 2, shape[1] // 2))
        source = source_of(image, 0.5 * image)
        for method in ("exact", "multigrid"):
            assert (
                relative_error(integrate(source, method, cycles=2)[:, :, 1], 0.5 * image) < 2 * DISC_BUDGET["multigrid"]
            )
        assert relative_error(integrate(source, "pyramid")[:, :, 0], image) < 2 * DISC_BUDGET["pyramid"]

    @pytest.mark.parametrize("method", INTEGRATORS)
    def test_the_smallest_images_work(self, method):
        result = integrate(np.zeros((1, 1, 1), np.float32), method)
        assert result.tolist() == [[[0]]]

    @pytest.mark.parametrize("method", INTEGRATORS)
    @pytest.mark.parametrize("n_channels", [1, 3, 4, 5])
    def test_channels_do_not_mix(self, method, n_channels):
        planes = [disc((70, 75), 5 + 3 * c, value=1 + c) for c in range(n_channels)]
        together = integrate(source_of(*planes), method)
        for channel, plane in enumerate(planes):
            alone = integrate(source_of(plane), method)[:, :, 0]
            # Vector and scalar loops may contract their multiply-adds differently.
            np.testing.assert_allclose(together[:, :, channel], alone, atol=FLOAT32_ROUNDING * plane.max())

    def test_a_psf_as_wide_as_the_image(self):
        image = disc((130, 130), 64, centre=(64.5, 64.5))
        assert (
            relative_error(integrate(source_of(image), "multigrid", cycles=2)[:, :, 0], image)
            < DISC_BUDGET["multigrid"]
        )

    def test_a_highlight_costs_its_neighbours_no_more_than_its_own_relative_error(self):
        bright = disc((200, 200), 20, centre=(60, 60), value=1e6)
        dark = disc((200, 200), 20, centre=(140, 140))
        result = integrate(source_of(bright + dark), "multigrid", cycles=4)[:, :, 0]
        assert np.abs(result - bright - dark).max() < 1e6 * FLOAT32_ROUNDING

    def test_a_wide_image_is_worked_in_strips_without_seams(self):
        image = disc((64, 2300), 12, centre=(32, 1024))
        result = integrate(source_of(image), "multigrid", cycles=3)[:, :, 0]
        assert np.abs(result - image).max() < FLOAT32_ROUNDING


class TestTwins:
    @pytest.mark.interpreted
    @pytest.mark.parametrize("method", PUBLISHED_FILTERS)
    @pytest.mark.parametrize("shape", [(30, 30), (23, 41)])
    def test_published_pyramids_match_their_naive_twin(self, method, shape):
        plane = np.random.default_rng(2).normal(size=shape).astype(np.float32)
        plane -= plane.mean()
        result = integrate(plane[:, :, None], method)[:, :, 0]
        expected = published_naive(plane.astype(np.float64), PUBLISHED_FILTERS[method])
        assert relative_error(result, expected) < FLOAT32_ROUNDING

    @pytest.mark.interpreted
    @pytest.mark.parametrize("shape", [(63, 63), (127, 191)])
    def test_the_pyramid_matches_its_naive_twin(self, shape):
        rng = np.random.default_rng(3)
        plane = rng.normal(size=shape).astype(np.float32)
        filters = [
            (complete_taps(f.down).astype(np.float64), complete_taps(f.up).astype(np.float64), f.weights)
            for f in (FINEST_FILTERS, COARSER_FILTERS)
        ]
        expected = pyramid_naive(plane.astype(np.float64), filters, COARSEST_SIDE)
        with pytest.warns(UnbalancedSourceWarning):
            result = integrate(plane[:, :, None], "pyramid")[:, :, 0]
        assert relative_error(result, expected) < FLOAT32_ROUNDING

    @pytest.mark.parametrize("radius", [12, 60])
    def test_the_default_is_invisible(self, radius):
        image = disc((191, 191), radius)
        assert relative_error(integrate(source_of(image))[:, :, 0], image) < ONE_CYCLE_BUDGET

    def test_multigrid_without_cycles_is_the_pyramid(self):
        source = source_of(disc((100, 100), 20))
        assert np.array_equal(integrate(source, "multigrid", cycles=0), integrate(source, "pyramid"))


class TestThreads:
    @pytest.mark.parametrize("method", [m for m in INTEGRATORS if m != "exact"])
    def test_the_image_does_not_depend_on_their_number(self, method):
        source = source_of(*(disc((190, 210), 10 + 7 * c) for c in range(4)))
        first, *others = for_thread_counts(lambda: integrate(source, method))
        assert all(np.array_equal(first, other) for other in others)

    def test_the_number_is_given_back(self):
        before = thread_count()
        integrate(source_of(disc((70, 70), 9)), threads=1)
        assert thread_count() == before

    @pytest.mark.parametrize("threads", [0, 100_000, 1.5])
    def test_an_impossible_number_is_refused(self, threads):
        with pytest.raises(InvalidParameterError, match="threads is"):
            integrate(np.zeros((8, 8, 1), np.float32), threads=threads)


class TestIntegrator:
    def test_keeps_its_buffers_and_is_clean_after_a_failure(self):
        integrator = Integrator("multigrid")
        source = source_of(disc((100, 120), 20))
        first = integrator(source)
        solver = integrator._solver
        broken = source.copy()
        broken[50, 60, 0] = np.nan
        with pytest.raises(InvalidParameterError, match=r"1 values .* \(50, 60, 0\)"):
            integrator(broken)
        assert np.array_equal(integrator(source), first)
        assert integrator._solver is solver

    def test_follows_a_change_of_size(self):
        integrator = Integrator("pyramid")
        for shape in ((64, 80), (100, 70), (64, 80)):
            source = source_of(disc(shape, 9))
            assert np.array_equal(integrator(source), integrate(source, "pyramid"))

    def test_writes_to_the_array_that_it_is_given(self):
        source = source_of(disc((80, 90), 12))
        out = np.full_like(source, np.nan)
        assert integrate(source, "pyramid", out=out) is out
        assert np.array_equal(out, integrate(source, "pyramid"))

    def test_leaves_the_source_alone(self):
        source = source_of(disc((80, 90), 12))
        kept = source.copy()
        for method in INTEGRATORS:
            integrate(source, method)
        assert np.array_equal(source, kept)

    def test_stops_at_the_tolerance_and_reports_the_residual(self):
        plane = disc((150, 150), 30)
        source = source_of(plane)
        integrator = Integrator("multigrid", cycles=9, tolerance=1e-4)
        image = integrator(source)
        report = integrator.report
        left = laplacian(image.astype(np.float64))[1:-1, 1:-1] - source
        # The border's stencil reaches into the padding, where the image is not zero but tiny.
        assert np.abs(left).max() / np.abs(source).max() == pytest.approx(report.residual, rel=0.05)
        assert report.residual <= 1e-4
        assert 0 < report.cycles < 9
        assert np.array_equal(image, integrate(source, "multigrid", cycles=report.cycles))

    def test_reports_a_tolerance_that_is_out_of_reach(self):
        integrator = Integrator("multigrid", cycles=1, tolerance=0.0)
        integrator(source_of(disc((100, 100), 30)))
        assert integrator.report.cycles == 1
        assert integrator.report.residual > 0

    def test_measures_no_residual_unless_asked(self):
        integrator = Integrator("multigrid", cycles=1)
        integrator(source_of(disc((70, 70), 12)))
        assert integrator.report.residual is None


class TestNetSource:
    @pytest.mark.parametrize("method", INTEGRATORS)
    @pytest.mark.parametrize("corner", [(0, 0), (69, 0), (0, 79), (69, 79)])
    def test_a_lone_point_in_a_corner_gets_a_warning_and_an_answer(self, method, corner):
        source = np.zeros((70, 80, 2), np.float32)
        source[*corner, 1] = 1
        with pytest.warns(UnbalancedSourceWarning, match="sums to"):
            image = integrate(source, method)
        assert np.isfinite(image).all()
        assert np.abs(image[:, :, 0]).max() == 0
        assert np.unravel_index(np.abs(image[:, :, 1]).argmax(), (70, 80)) == corner

    @pytest.mark.parametrize("method", INTEGRATORS)
    def test_neutral_sources_pass_without_one(self, method):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            integrate(neutral_points((90, 90), 5)[:, :, None], method)


class TestRefusals:
    def test_an_unknown_method(self):
        with pytest.raises(InvalidParameterError, match="magic.*multigrid"):
            integrate(np.zeros((8, 8, 1), np.float32), "magic")

    @pytest.mark.parametrize(
        "source", [np.zeros((8, 8)), np.zeros((0, 8, 1)), np.zeros((8, 8, 1), int), np.zeros((2, 8, 8, 1))]
    )
    def test_an_array_that_is_no_image(self, source):
        with pytest.raises(InvalidParameterError, match="shape"):
            integrate(source)

    @pytest.mark.parametrize("options", [{"cycles": -1}, {"tolerance": -1.0}, {"tolerance": float("nan")}])
    def test_an_impossible_option(self, options):
        with pytest.raises(InvalidParameterError, match=next(iter(options))):
            integrate(np.zeros((8, 8, 1), np.float32), "multigrid", **options)

    @pytest.mark.parametrize(
        "out", [np.zeros((8, 8, 2), np.float32), np.zeros((8, 8, 1)), np.zeros((8, 16, 1), "f4")[:, ::2]]
    )
    def test_an_unfit_target(self, out):
        with pytest.raises(InvalidParameterError, match="out has shape"):
            integrate(np.zeros((8, 8, 1), np.float32), out=out)

    def test_integrating_in_place(self):
        source = np.zeros((8, 8, 1), np.float32)
        with pytest.raises(InvalidParameterError, match="shares memory"):
            integrate(source, out=source)

    @pytest.mark.parametrize("method", INTEGRATORS)
    @pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
    @pytest.mark.parametrize("at", [(0, 0, 0), (69, 79, 1)])
    def test_values_that_are_not_finite(self, method, value, at):
        source = np.zeros((70, 80, 2))
        source[at] = value
        with pytest.raises(InvalidParameterError, match="not finite"):
            integrate(source, method)

    @pytest.mark.parametrize("method", INTEGRATORS)
    def test_an_answer_beyond_float32(self, method):
        source = np.zeros((70, 70, 1), np.float32)
        source[30:40, 30:40] = 3e38
        with pytest.raises(InvalidParameterError, match="range of float32"):
            integrate(source, method)

    @pytest.mark.parametrize("method", INTEGRATORS)
    def test_large_values_within_range_pass(self, method):
        image = disc((100, 100), 20, value=1e30)
        assert relative_error(integrate(source_of(image), method)[:, :, 0] / 1e30, image / 1e30) < 0.1


def test_every_weight_is_stable_and_every_filter_keeps_sums():
    for filters in (FINEST_FILTERS, COARSER_FILTERS):
        assert list(filters.weights) == sorted(filters.weights, reverse=True)
        for outer in (filters.down, filters.up):
            taps = complete_taps(outer)
            assert taps[0] + 2 * taps[2] == pytest.approx(1)
            assert 2 * (taps[1] + taps[3]) == pytest.approx(1)
    assert DEFAULT_INTEGRATOR in INTEGRATORS

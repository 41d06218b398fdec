"""What is drawn between the cells, against the exact PSF."""

import numpy as np
import pytest
from naive.psfs import disc_coverage

from spreadlets.precompute.build import between_cells
from spreadlets.psf import exact
from spreadlets.psf.database import open_database
from spreadlets.psf.spreadlet import Spreadlet

LEAST = {  # highlights: mean and worst hundredth; dim pixels: mean
    "simplelens": (0.997, 0.99, 0.98),
    "combined": (0.997, 0.98, 0.945),
    "stylized": (0.998, 0.99, 0.97),
    "physicallens": (0.97, 0.90, 0.78),
    "volume": (0.998, 0.998, 0.998),
}
"""Measured at a thousand coordinates: .9988, .9959, .989; .9989, .9936, .956; .9993, .9973, .979; .998, .987, .885."""


def figures(name, count, monkeypatch, rays=None):
    monkeypatch.setattr(between_cells, "N_COORDINATES", count)
    monkeypatch.setattr(between_cells, "N_TRACED", 4)
    with open_database(name) as database:
        return between_cells.between_cells(database.grid, database.cell, rays)


@pytest.mark.parametrize("name", LEAST)
def test_highlights_of_shipped_databases_are_exact_and_dim_pixels_near(name, monkeypatch):
    found = figures(name, 12 if name == "physicallens" else 60, monkeypatch, rays=1 << 18)
    mean, worst, dim = LEAST[name]
    assert found["highlight"]["mean"] > mean
    assert found["highlight"]["percentile_1"] > worst
    assert found["dim"]["mean"] > dim
    if name != "volume":  # which has no rim
        assert found["highlight"]["radius_error"] < 0.01 and found["highlight"]["centre_error_px"] < 0.25


def test_coarse_steps_are_seen(monkeypatch):
    monkeypatch.setattr(exact, "RADIUS_STEPS", 4.0)
    found = figures("simplelens", 60, monkeypatch)
    assert found["highlight"]["mean"] < 0.98 and found["highlight"]["radius_error"] > 0.01


def test_coordinates_cover_the_remapped_range():
    with open_database("combined") as database:
        grid = database.grid
    places = between_cells.random_places(grid, 400)
    assert (places.side == 1).all(), "both sides of the focus are alike"
    assert places.coordinate[:, 0].min() < 1.1 < grid.model.axes[0].floor, "also where there are no cells"
    unit = (places.coordinate / grid.maximum) ** (1 / grid.power)
    first = np.array([(1.0 / grid.maximum[0]) ** (1 / grid.power[0]), 0.0])
    unit = (unit - first) / (1 - first)
    assert unit.mean(axis=0) == pytest.approx([0.5, 0.5], abs=0.05) and unit.min() >= 0 and unit.max() <= 1
    assert np.ptp(places.angle) > 6.0


@pytest.mark.parametrize("centre", [(0.0, 0.0), (0.3, -0.4)])
def test_the_rim_of_a_disc_is_where_it_is(centre):
    radius, row, col = between_cells.rim(disc_coverage(7.3, centre, 25)[..., None])
    assert radius == pytest.approx(7.3, rel=2e-3)
    assert (col, row) == pytest.approx(centre, abs=0.01)


def test_what_was_left_out_is_not_counted(small_combined):
    some = between_cells.between_cells(small_combined.grid, small_combined.cell)
    none = between_cells.between_cells(small_combined.grid, lambda cell, pose: None)
    assert none["dim"]["mean"] > some["dim"]["mean"], "what is drawn in closed form is left"
    assert "mean_large" not in none["dim"] and none["highlight"] == some["highlight"]
    blank = Spreadlet(np.zeros((1, 2), np.int16), np.ones((1, 1), np.float32), True)
    assert between_cells.between_cells(small_combined.grid, lambda cell, pose: blank)["dim"]["mean"] < 0.6


def test_a_build_records_the_figures(small_combined):
    recorded = small_combined.summary()["between_cells"]
    assert recorded == between_cells.between_cells(small_combined.grid, small_combined.cell)
    assert recorded["coordinates"] == between_cells.N_COORDINATES

import pytest

from spreadlets.precompute.build import between_cells
from spreadlets.precompute.build.build import build_database
from spreadlets.psf.database import open_database

# Databases that tests build are compared with the exact PSF at a few places: a thousand take many seconds.
between_cells.N_COORDINATES, between_cells.N_TRACED = 16, 2


@pytest.fixture(scope="session")
def small_combined_path(tmp_path_factory):
    """A database of a few cells, built once for the whole run: CoC to 12 px, motion to 16 px."""
    path = tmp_path_factory.mktemp("databases") / "small.h5"
    build_database("combined", path, samples=28, max_coc=12.0, max_motion=16.0, seed=1)
    return path


@pytest.fixture
def small_combined(small_combined_path):
    with open_database(small_combined_path) as database:
        yield database

from inspect import Parameter, signature

import pytest

import spreadlets as sp
from spreadlets.models import RANGES, TYPES, option_names
from spreadlets.precompute.models.aperture import Aperture
from spreadlets.precompute.models.registry import REGISTRY
from spreadlets.psf.model import MODELS


def test_every_model_has_a_type_axes_and_a_tracer():
    assert TYPES.keys() == MODELS.keys() == REGISTRY.keys()


@pytest.mark.parametrize("name", TYPES)
def test_the_options_of_a_type_are_those_that_its_model_reads(name):
    parameters = signature(REGISTRY[name].read_settings).parameters.values()
    wanted = {each.name for each in parameters if each.kind is not Parameter.VAR_KEYWORD}
    if len(wanted) < len(parameters):
        wanted |= set(Aperture.__dataclass_fields__)
    assert set(option_names(name)) == wanted


def test_ranges_are_no_options_and_what_is_not_given_is_left_out():
    model = sp.models.Combined(max_coc=8.0, max_motion=4.0, samples=12, blades=5)
    assert model.options() == {"max_coc": 8.0, "max_motion": 4.0, "samples": 12, "blades": 5}
    assert not set(RANGES) & set(option_names("combined"))


def test_a_database_is_built_for_a_typed_model(tmp_path):
    sp.build_database(sp.models.SimpleLens(samples=3, max_coc=3.0, squeeze=0.5), tmp_path / "a.h5", rays=2000, jobs=1)
    sp.build_database("simplelens", tmp_path / "b.h5", samples=3, max_coc=3.0, squeeze=0.5, rays=2000, jobs=1)
    with sp.open_database(tmp_path / "a.h5") as typed, sp.open_database(tmp_path / "b.h5") as named:
        assert typed.grid == named.grid and typed.grid.model.settings["aperture"]["squeeze"] == 0.5

import json
import warnings

import numba
import numpy as np
import pytest
from click.testing import CliRunner

import spreadlets as sp
from spreadlets.cli.main import cli
from spreadlets.compiled import count_compiled, kernel_folder
from spreadlets.reports.demo import run_demo, run_reconstruction_demo
from spreadlets.warmup import warm_up

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="is about compiled code")


def test_after_it_nothing_is_compiled(tmp_path):
    told = []
    assert warm_up(progress=lambda *each: told.append(each)).folder == str(kernel_folder())
    assert [done for done, _ in told] == list(range(told[0][1] + 1))
    before = count_compiled()
    run_demo(tmp_path)
    run_reconstruction_demo(tmp_path)
    # Layers in fog ask how much of their opacity is scattered, by paths that are followed when they are drawn.
    card, wall = (sp.Frame(np.full((16, 16, 4), 0.5), np.full((16, 16), each)) for each in (3.0, 9.0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it was built for another camera
        sp.synthesize([card, wall], sp.ThinLens(50, 36, 2, 3), "volume")
    assert count_compiled() == before


def test_the_command_says_what_it_did():
    first, second = (json.loads(CliRunner().invoke(cli, ["warmup", "--json"]).stdout) for _ in range(2))
    assert first.keys() == {"compiled", "compile_s", "folder"}
    assert second["compiled"] == 0 and second["compile_s"] == 0.0 and np.isfinite(first["compile_s"])

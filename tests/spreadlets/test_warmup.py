import json
import subprocess
import sys

import numba
import numpy as np
import pytest
from click.testing import CliRunner

from spreadlets.cli.main import cli
from spreadlets.compiled import kernel_folder
from spreadlets.warmup import warm_up

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="is about compiled code")


AFTERWARDS = """
import warnings
import numpy as np
import spreadlets as sp
from spreadlets.ahead import RUNS, described, listed
from spreadlets.compiled import first_calls
from spreadlets.warmup import warm_up

warm_up()
known = first_calls()[:]
missing = [entry for entry in listed(*RUNS) if entry not in map(described, known)]
# Layers in fog ask how much of their opacity is scattered, by paths that are followed when they are drawn.
card, wall = (sp.Frame(np.full((16, 16, 4), 0.5), np.full((16, 16), each)) for each in (3.0, 9.0))
warnings.simplefilter("ignore")  # it was built for another camera
sp.synthesize([card, wall], sp.ThinLens(50, 36, 2, 3), "volume")
print([entry[:2] for entry in missing + [described(each) for each in first_calls()[len(known):]]])
"""


def test_after_it_nothing_is_compiled():
    """In a process of its own: in this one, other tests have called most kernels."""
    assert subprocess.run([sys.executable, "-c", AFTERWARDS], capture_output=True, text=True).stdout == "[]\n"


def test_it_tells_how_far_it_is_and_where_kernels_are():
    told = []
    assert warm_up(progress=lambda *each: told.append(each)).folder == str(kernel_folder())
    assert [done for done, _ in told] == list(range(told[0][1] + 1))


def test_the_command_says_what_it_did():
    first, second = (json.loads(CliRunner().invoke(cli, ["warmup", "--json"]).stdout) for _ in range(2))
    assert first.keys() == {"compiled", "compile_s", "folder"}
    assert second["compiled"] == 0 and second["compile_s"] == 0.0 and np.isfinite(first["compile_s"])

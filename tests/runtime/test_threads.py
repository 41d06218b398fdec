"""Several threads of a program in the product at once."""

import os
import subprocess
import sys

import numba
import pytest

CODE = """
import sys
from concurrent.futures import ThreadPoolExecutor
import numpy as np
import spreadlets as sp

camera = sp.ThinLens(focal_length_mm=50, sensor_width_mm=36, f_number=1.4, focus_distance_m=2, shutter=(-0.25, 0.25))
database, rng = sp.open_database(sys.argv[1]), np.random.default_rng(1)
frames = [
    sp.Frame(rng.random((96, 96, 4), np.float32), np.float32(1.5) + rng.random((96, 96), np.float32),
             8 * rng.random((96, 96, 2), np.float32))
    for _ in range(3)
]
draw = lambda frame: sp.synthesize(frame, camera, database, layers=2)
with ThreadPoolExecutor(3) as pool:
    together = list(pool.map(draw, frames))
assert all(np.array_equal(image, draw(frame)) for image, frame in zip(together, frames))
assert len({image.tobytes() for image in together}) == 3
print("fine")
"""


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="is about compiled code")
def test_three_threads_at_once_get_the_right_images(small_combined_path):
    environment = os.environ | {"NUMBA_NUM_THREADS": "3"}
    command = [sys.executable, "-W", "ignore", "-c", CODE, str(small_combined_path)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stdout.strip(), done.stderr) == (0, "fine", "")

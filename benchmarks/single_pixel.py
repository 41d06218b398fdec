"""A single bright pixel at random places, CoC, motion and direction: centroid and energy against the analytic PSF.

    python benchmarks/single_pixel.py [--db combined] [--count 200]

Writes single_pixel.txt to benchmarks/results. A third of the pixels lie one pixel from the frame's border. The energy
there is compared with the share of the analytic PSF that the border leaves in the frame.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

import spreadlets as sp

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from naive.psfs import capsule_psf, disc_coverage  # noqa: E402

RESULTS = Path(__file__).parent / "results"
SIZE = 321
CAMERA = sp.ThinLens(
    focal_length_mm=50, sensor_width_mm=36, f_number=0.002, focus_distance_m=4.0, shutter=(-0.25, 0.25)
)


def spot_frame(place: tuple[int, int], coc: float, path: np.ndarray) -> sp.Frame:
    """Return a black frame with one bright pixel; CoC (px) and path over the shutter (dx, dy) are the same all over."""
    radiance = np.zeros((SIZE, SIZE, 3), np.float32)
    radiance[place] = 1.0
    scale = 0.5 * (0.05 / CAMERA.f_number) * (50 / 36 * SIZE)
    depth = np.full((SIZE, SIZE), 1 / (1 / CAMERA.focus_distance_m - coc / scale))
    return sp.Frame(radiance, depth, np.broadcast_to(path / CAMERA.shutter_duration, (SIZE, SIZE, 2)))


def moments(image: np.ndarray) -> np.ndarray:
    """Return energy and centroid (row, col)."""
    rows, cols = np.indices(image.shape)
    return np.array([image.sum(), (image * rows).sum() / image.sum(), (image * cols).sum() / image.sum()])


def expected(place: tuple[int, int], coc: float, length: float, angle: float) -> np.ndarray:
    """Return the analytic PSF about a place, cut off by the frame."""
    size = 2 * int(coc + length / 2 + 3) + 1
    psf = capsule_psf(coc, length, angle, size) if length > 0 else disc_coverage(coc, size=size)
    canvas = np.zeros((SIZE + size - 1, SIZE + size - 1))
    canvas[place[0] : place[0] + size, place[1] : place[1] + size] = psf
    half = size // 2
    return canvas[half : half + SIZE, half : half + SIZE]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--db", default="combined")
    parser.add_argument("--count", type=int, default=200)
    arguments = parser.parse_args()
    rng = np.random.default_rng(0)
    errors: dict[bool, list[np.ndarray]] = {False: [], True: []}
    with sp.open_database(arguments.db) as database:
        limit = database.grid.maximum
        for number in range(arguments.count):
            coc, length = rng.random(2) ** 2 * limit
            angle = rng.uniform(-np.pi, np.pi)
            at_border = number % 3 == 0
            reach = int(coc + length / 2 + 3)
            place = tuple(int(x) for x in rng.integers(reach, max(SIZE - reach, reach + 1), 2))
            place = (1, place[1]) if at_border else place
            path = length * np.array([np.cos(angle), np.sin(angle)])
            frame = spot_frame(place, coc * rng.choice([-1, 1]), path)
            image = sp.synthesize(frame, CAMERA, database)[..., 0].astype(np.float64)
            difference = moments(image) - moments(expected(place, coc, length, angle))
            errors[at_border].append(
                np.abs([difference[0] / moments(expected(place, coc, length, angle))[0], *difference[1:]])
            )
    lines = [f"{'':>12}{'pixels':>8}{'energy mean':>14}{'worst':>10}{'centroid mean px':>18}{'worst':>10}"]
    for at_border, rows in errors.items():
        energy, centroid = np.array(rows)[:, 0], np.array(rows)[:, 1:].max(axis=1)
        name = "at border" if at_border else "inside"
        lines.append(
            f"{name:>12}{len(rows):>8}{energy.mean():>14.5f}{energy.max():>10.5f}{centroid.mean():>18.4f}{centroid.max():>10.4f}"
        )
    print("\n".join(lines))
    (RESULTS / "single_pixel.txt").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()

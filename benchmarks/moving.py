"""What changes while the shutter is open, against the mean of many moments drawn with exact PSFs.

    python benchmarks/moving.py [--times 256]

A textured plane with small lamps, 200 x 300 px, its truth drawn wider than the frame. At each of so many moments it is
convolved with the disc of its circle of confusion (16 x 16 subsamples a pixel), moved or scaled, and the moments are
averaged: nothing of that is the package's but the camera's formula for the radius. For the physical lens, lamps before
black move across the frame, each drawn at each moment with the PSF that the lens traces at the lamp's place.
Columns: SSIM, PSNR, the SSIM of the frame at mid-shutter alone, and seconds. Writes moving.txt to benchmarks/results.
"""

import argparse
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy import ndimage

import spreadlets as sp
from spreadlets.precompute.models.registry import exact_psf

RESULTS = Path(__file__).parent / "results"
HEIGHT, WIDTH, MARGIN = 200, 300, 200
SHUTTER = (-0.25, 0.25)
FOCUS = 3.0
LAMP = 40.0


def picture() -> np.ndarray:
    """Return a texture with lamps, with a margin around the frame."""
    rng = np.random.default_rng(0)
    shape = HEIGHT + 2 * MARGIN, WIDTH + 2 * MARGIN
    texture = ndimage.gaussian_filter(rng.random((*shape, 3)), (2, 2, 0))
    shown = np.clip(4.0 * texture - 1.5, 0.02, 1.0)
    for row, col in rng.integers((MARGIN, MARGIN), (MARGIN + HEIGHT, MARGIN + WIDTH), (25, 2)):
        shown[row, col] = LAMP
    return shown


def inner(image: np.ndarray) -> np.ndarray:
    """Return the frame within its margin."""
    return image[MARGIN : MARGIN + HEIGHT, MARGIN : MARGIN + WIDTH]


def disc(radius: float, samples: int = 16) -> np.ndarray:
    """Return a disc of unit sum, by so many subsamples along each axis of a pixel."""
    half = int(np.ceil(radius)) + 1
    fine = (np.arange((2 * half + 1) * samples) + 0.5) / samples - half - 0.5
    inside = np.hypot(*np.meshgrid(fine, fine)) <= max(radius, 0.05)
    coverage = inside.reshape(2 * half + 1, samples, 2 * half + 1, samples).mean(axis=(1, 3))
    return coverage / coverage.sum()


def blurred(shown: np.ndarray, camera: sp.ThinLens, depth: float) -> np.ndarray:
    """Return the plane as a thin lens shows it."""
    kernel = disc(abs(float(camera.coc_radius(depth, WIDTH))))
    planes = [ndimage.convolve(shown[..., c], kernel, mode="nearest") for c in range(3)]
    return np.stack(planes, axis=-1)


def scaled(shown: np.ndarray, growth: float) -> np.ndarray:
    """Return a picture that a zoom has enlarged about its middle."""
    middle = (np.array(shown.shape[:2]) - 1) / 2
    matrix, offset = np.eye(2) / growth, middle - middle / growth
    planes = [ndimage.affine_transform(shown[..., c], matrix, offset, order=3, mode="nearest") for c in range(3)]
    return np.stack(planes, axis=-1)


def plane(shown: np.ndarray, depth: float, **labels: np.ndarray) -> sp.Frame:
    """Return the frame of the textured plane."""
    return sp.Frame(inner(shown), np.full((HEIGHT, WIDTH), depth), **labels)


def lens(*keys: sp.LensKey, f_number: float = 1.4) -> sp.ThinLens:
    """Return the camera of all thin-lens cases."""
    return sp.ThinLens(85, 36, f_number, FOCUS, shutter=SHUTTER, keys=keys)


def row(name: str, frame: sp.Frame, camera: sp.ThinLens, truth: np.ndarray, database: str = "combined") -> str:
    """Return a row of the table."""
    still = sp.Frame(frame.radiance, frame.depth)
    image, report = sp.synthesize(frame, camera, database, report=True)
    begin = time.perf_counter()
    sp.synthesize(frame, camera, database)
    took = time.perf_counter() - begin
    alone = sp.metrics.compare(sp.synthesize(still, camera.at(0.0), database), truth)
    found = sp.metrics.compare(image, truth)
    return f"{name:34}{found['ssim']:10.4f}{found['psnr']:8.2f}{alone['ssim']:10.4f}{took:9.2f}"


def thin_lens_rows(times: np.ndarray) -> list[str]:
    """Return the rows of the textured plane."""
    shown, depth = picture(), 5.0
    pull = lens(sp.LensKey(-0.25, focus_distance_m=2.0), sp.LensKey(0.25, focus_distance_m=4.0))
    truth = mean(lambda t: blurred(shown, pull.at(t), depth), times)
    rows = [row("focus pulled by 2 m", plane(shown, depth), pull, truth)]
    # 1/depth changes evenly, by the parabola through the depths of three frames.
    near, far = 1 / (0.2 + 0.09), 1 / (0.2 - 0.09)
    depths = {"depth_prev": np.full((HEIGHT, WIDTH), far), "depth_next": np.full((HEIGHT, WIDTH), near)}
    truth = mean(lambda t: blurred(shown, lens(), 1 / (0.2 + 0.09 * t)), times)
    rows.append(row("motion in depth", plane(shown, depth, **depths), lens(), truth))
    zoom = lens(sp.LensKey(-0.25, focal_length_mm=80), sp.LensKey(0.25, focal_length_mm=90), f_number=2.0)

    def zoomed(t: float) -> np.ndarray:
        # The lens blurs the enlarged picture.
        return blurred(scaled(shown, zoom.value_at("focal_length_mm", t) / 85.0), zoom.at(t), depth)

    rows.append(row("zoom, 80 to 90 mm", plane(shown, depth), zoom, mean(zoomed, times)))
    iris = lens(sp.LensKey(-0.25, f_number=0.7), sp.LensKey(0.25, f_number=4.0))
    truth = mean(lambda t: blurred(shown, iris.at(t), depth), times)
    rows.append(row("iris, f/.7 to f/4", plane(shown, depth), iris, truth))
    rows.append(dolly_row(shown, depth, times))
    still = blurred(shown, lens(), depth)
    motion = np.broadcast_to(np.float32([40.0, 20.0]), (HEIGHT, WIDTH, 2))
    truth = mean(lambda t: ndimage.shift(still, (20 * t, 40 * t, 0), order=3, mode="nearest"), times)
    for database in ("combined", "simplelens"):
        rows.append(row(f"straight motion, {database}", plane(shown, depth, motion=motion), lens(), truth, database))
    return rows


def dolly_row(shown: np.ndarray, depth: float, times: np.ndarray) -> str:
    """Return the row of a camera that comes nearer by 2 m in a frame, with no labels but its poses."""
    keys = []
    for time_ in SHUTTER:
        pose = np.eye(4)
        pose[2, 3] = -2.0 * time_
        keys.append(sp.LensKey(time_, camera_to_world=pose))

    def nearer(t: float) -> np.ndarray:
        left = depth - 2.0 * t
        return blurred(scaled(shown, depth / left), lens(), left)

    return row("the camera comes nearer by 1 m", plane(shown, depth), lens(*keys), mean(nearer, times))


def mean(moment: Callable[[float], np.ndarray], times: np.ndarray) -> np.ndarray:
    """Return the mean of the frame at some times."""
    total = sum(inner(moment(float(each))) for each in times)
    return np.ascontiguousarray(total / len(times), np.float32)


def lamps_row(times: np.ndarray) -> str:
    """Return the row of lamps that move before a physical lens."""
    rng = np.random.default_rng(1)
    with sp.open_database("physicallens") as database:
        model = database.grid.model
    view = model.settings["view"]
    camera = sp.ThinLens(
        view["focal_length_mm"], view["sensor_width_mm"], view["f_number"], 1 / view["focus_per_m"], shutter=SHUTTER
    )
    height, width = 288, int(view["width_px"])
    limit = min(24.0, float(model.axes[0].maximum))
    depth = 1 / (1 / camera.focus_distance_m - limit / camera.coc_scale(width))
    radiance, motion = np.zeros((height, width, 3), np.float32), np.zeros((height, width, 2), np.float32)
    truth = np.zeros((height, width, 3))
    trace, mm_per_px = exact_psf(model), view["sensor_width_mm"] / width
    assert trace is not None
    for _ in range(12):
        r, c = int(rng.integers(40, height - 40)), int(rng.integers(60, width - 60))
        path = rng.uniform(-60, 60, 2)
        radiance[r, c], motion[r, c] = 500.0, path
        x, y = c - 0.5 * (width - 1), r - 0.5 * (height - 1)
        # The PSF at the place where the lamp is seen at mid-shutter: it hardly changes along the path.
        place = np.array([[limit, np.hypot(x, y) * mm_per_px]])
        psf = next(iter(trace(place, np.array([np.arctan2(y, x)]), np.array([1])))).to_dense()
        for t in times:
            moved = ndimage.shift(np.pad(psf, ((40, 40), (40, 40), (0, 0))), (path[1] * t, path[0] * t, 0), order=1)
            half = moved.shape[0] // 2, moved.shape[1] // 2
            top, left = r - half[0], c - half[1]
            rows = slice(max(top, 0), min(top + moved.shape[0], height))
            cols = slice(max(left, 0), min(left + moved.shape[1], width))
            seen = moved[rows.start - top : rows.stop - top, cols.start - left : cols.stop - left]
            truth[rows, cols] += 500.0 / len(times) * seen
    frame = sp.Frame(radiance, np.full((height, width), depth), motion=motion)
    return row("lamps move, physicallens", frame, camera, truth.astype(np.float32), "physicallens")


def main() -> None:
    """Measure and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=256, help="moments in the shutter")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    times = SHUTTER[0] + (np.arange(given.times) + 0.5) / given.times * (SHUTTER[1] - SHUTTER[0])
    lines = [f"{'':34}{'SSIM':>10}{'PSNR':>8}{'mid alone':>10}{'seconds':>9}", *thin_lens_rows(times), lamps_row(times)]
    (RESULTS / "moving.txt").write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main()

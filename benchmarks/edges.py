"""Edges, thin things and what lies behind them: a drawn study, and rendered frames.

Drawn cases, each against its truth in layers: a disc, stick or half plane before a patterned plane, with colours
filtered as renderers do (box, Blackman-Harris, Gaussian), depth point-sampled or filtered, or an element over nothing;
focused on the near or the far one. Further: a dark slanted floor behind something near and wide, and a subject in focus
before a blurred background. The frames of ``--frames`` that have a pinhole view and a reference are measured,
too. Writes edges.txt and pictures of the worst cases to benchmarks/results.

    python benchmarks/edges.py [--frames DIR] [--cases 200]
"""

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scenes import parser, result_path, scenes
from scipy import ndimage

import spreadlets as sp
from spreadlets.scene.display import display_encode

SIDE, FINE, MARGIN = 96, 8, 6
"""Pixels of a drawn frame, samples of each along an axis, and pixels at the border that are not judged."""
FOCUS = 4.0
CAMERA = sp.ThinLens(
    focal_length_mm=50.0, sensor_width_mm=36.0, f_number=0.05, focus_distance_m=FOCUS, shutter=(-0.25, 0.25)
)
OFF = 0.1
"""An error, as displayed, that anybody sees."""


@dataclass(frozen=True)
class Drawing:
    """A near shape before a plane.

    Attributes
    ----------
    shape : str
        ``disc``, ``stick`` or ``edge``.
    size : float
        Radius or width, px.
    angle : float
        Of a stick or an edge, degrees.
    kernel : str
        Filter of the renderer.
    depth : str
        ``point``, ``filtered`` or ``element``, which has nothing behind.
    near, far : float
        CoC radii, px.
    seed : int
    """

    shape: str
    size: float
    angle: float
    kernel: str
    depth: str
    near: float
    far: float
    seed: int

    def __str__(self) -> str:
        about = f"{self.shape} {self.size:.1f} px at {self.angle:.0f} deg, {self.kernel}, {self.depth} depth"
        return f"{about}, CoC {self.near:.1f} before {self.far:.1f} px"


FILTERS = {
    "box 1": lambda x: (np.abs(x) <= 0.5).astype(float),
    "Blackman-Harris 3": lambda x: _blackman_harris(x, 3.0),
    "Gaussian 2": lambda x: np.exp(-2.0 * x**2) * (np.abs(x) <= 1.0),
    "Gaussian 3": lambda x: np.exp(-2.0 * (x / 1.5) ** 2) * (np.abs(x) <= 1.5),
}
"""By name and full width, px: as Cycles (1.5 px there), RenderMan and Arnold have them."""


def _blackman_harris(x: np.ndarray, width: float) -> np.ndarray:
    phase = 2 * np.pi * (x / width + 0.5)
    value = 0.35875 - 0.48829 * np.cos(phase) + 0.14128 * np.cos(2 * phase) - 0.01168 * np.cos(3 * phase)
    return np.where(np.abs(x) <= 0.5 * width, value, 0.0)


def drawings(count: int) -> list[Drawing]:
    """Return cases that go evenly through shapes, filters and kinds of depth, at random in all else."""
    rng = np.random.default_rng(0)
    found = []
    for number in range(count):
        shape = ("disc", "stick", "stick", "edge")[number % 4]
        low, high = {"disc": (1.0, 64.0), "stick": (0.5, 6.0), "edge": (1.0, 1.0)}[shape]
        blurred, is_near = rng.uniform(3.0, 12.0), rng.random() < 0.5
        found.append(
            Drawing(
                shape,
                float(np.exp(rng.uniform(np.log(low), np.log(high)))),
                float(rng.uniform(0.0, 90.0)),
                list(FILTERS)[number // 4 % 4],
                ("point", "filtered", "element")[number // 16 % 3],
                -blurred if is_near else 0.0,
                0.0 if is_near else blurred,
                number,
            )
        )
    return found


def coverage(drawing: Drawing) -> np.ndarray:
    """Return where the shape is, (SIDE * FINE, SIDE * FINE)."""
    y, x = (np.mgrid[: SIDE * FINE, : SIDE * FINE] + 0.5) / FINE - 0.5 * SIDE
    shift = np.random.default_rng(drawing.seed).uniform(-1, 1, 2)
    x, y = x + shift[0], y + shift[1]
    turned = x * np.cos(np.radians(drawing.angle)) + y * np.sin(np.radians(drawing.angle))
    if drawing.shape == "disc":
        return np.hypot(x, y) < drawing.size
    return turned < 0 if drawing.shape == "edge" else np.abs(turned) < 0.5 * drawing.size


def filtered(fine: np.ndarray, kernel: str) -> np.ndarray:
    """Return the image of samples (n, n, ...) through a filter, at the pixels' centres."""
    taps = FILTERS[kernel](np.arange(-2 * FINE, 2 * FINE + 1) / FINE)
    taps /= taps.sum()
    for axis in (0, 1):
        # An even number of samples has its middle between two.
        fine = ndimage.convolve1d(fine, taps, axis=axis, mode="nearest")
        low, high = (np.take(fine, np.arange(FINE // 2 - 1 + k, fine.shape[axis], FINE), axis) for k in (0, 1))
        fine = 0.5 * (low + high)
    return fine


def depth_of(coc: float) -> float:
    """Return the depth, metres, of a CoC radius, px."""
    return 1.0 / (1.0 / FOCUS - coc / CAMERA.coc_scale(SIDE))


def pattern(rng: np.random.Generator) -> np.ndarray:
    """Return the plane's colours: a checkerboard or soft noise, (SIDE * FINE, SIDE * FINE, 3)."""
    n = SIDE * FINE
    first, second = rng.uniform(0.05, 0.95, (2, 3))
    if rng.random() < 0.5:
        cell = rng.uniform(6.0, 20.0) * FINE
        y, x = np.mgrid[:n, :n]
        share = ((x // cell + y // cell) % 2).astype(float)
    else:
        share = ndimage.zoom(ndimage.gaussian_filter(rng.random((SIDE, SIDE)), rng.uniform(1.5, 4.0)), FINE, order=1)
        share = (share - share.min()) / np.ptp(share)
    return first + share[..., None] * (second - first)


def frames(drawing: Drawing) -> tuple[sp.Frame, sp.Frame]:
    """Return the frame of one layer, and the same with the hidden surface in a layer of its own."""
    rng = np.random.default_rng(1000 + drawing.seed)
    inside = coverage(drawing)
    colour = rng.uniform(0.05, 0.95, 3)
    shade = 1.0 + 0.2 * ndimage.zoom(rng.random((6, 6)), SIDE * FINE / 6, order=1)[..., None] - 0.1
    element = filtered(np.dstack([inside[..., None] * colour * shade, inside]), drawing.kernel)
    behind = filtered(pattern(rng), drawing.kernel)
    near, far = depth_of(drawing.near), depth_of(drawing.far)
    depth = np.where(inside, near, far)
    shown = depth[FINE // 2 :: FINE, FINE // 2 :: FINE] if drawing.depth == "point" else filtered(depth, drawing.kernel)
    alpha = element[..., 3:]
    if drawing.depth == "element":
        return sp.Frame(element, shown), sp.Frame(element, np.full((SIDE, SIDE), near))
    flat = element[..., :3] + (1.0 - alpha) * behind
    layers = [(element, np.full((SIDE, SIDE), near)), (behind, np.full((SIDE, SIDE), far))]
    return sp.Frame(flat, shown), sp.Frame.from_layers(layers)


def inner(image: np.ndarray) -> np.ndarray:
    return image[MARGIN:-MARGIN, MARGIN:-MARGIN]


def worst_error(drawing: Drawing, database: sp.Database) -> tuple[float, float]:
    """Return the largest and the mean error of a case, in linear values."""
    flat, layered = frames(drawing)
    image, truth = (sp.synthesize(each, CAMERA, database, tolerance=0.0) for each in (flat, layered))
    error = inner(np.abs(image - truth)[..., :3].max(axis=2))
    return float(error.max()), float(error.mean())


def stripes(database: sp.Database) -> float:
    """Return the largest second difference between rows, 8-bit steps, of a dark slanted floor behind a near, wide post.

    The floor goes away from the lens row by row, under a bright sky; nothing in it changes from one row to the next but
    its blur, so its rows should, too.
    """
    size = 2 * SIDE
    rows, cols = np.indices((size, size))
    coc = np.where(rows < 40, 16.0, np.linspace(16.0, -2.0, size)[:, None])
    radiance = np.where(rows[..., None] < 40, 1.2, 0.03) * np.ones(3)
    post = np.abs(cols - size // 3) < 8
    radiance[post], coc = (0.02, 0.05, 0.02), np.where(post, -22.0, coc)
    depth = 1.0 / (1.0 / FOCUS - coc / CAMERA.coc_scale(size))
    image = display_encode(sp.synthesize(sp.Frame(radiance, depth), CAMERA, database)[..., :3])
    floor = image[72:-16, 16:-16]
    return float(255.0 * np.abs(np.diff(floor, 2, axis=0)).max())


def bleed(database: sp.Database, layers: int) -> float:
    """Return how far, px, a blurred background shows over a subject in focus that hides it."""
    size = 2 * SIDE
    y, x = np.indices((size, size)) - size / 2
    inside = np.hypot(x, y) < 50.0
    shade = ndimage.gaussian_filter(np.random.default_rng(0).random((size, size, 3)), (3, 3, 0))
    radiance = np.where(inside[..., None], 0.1 + 0.1 * shade, 1.0 + shade)
    near = np.hypot(x + 70, y + 70) < 20
    radiance[near] = (0.3, 0.1, 0.1)
    coc = np.where(near, -14.0, np.where(inside, 0.4 * x / 50.0, 13.0))
    depth = 1.0 / (1.0 / FOCUS - coc / CAMERA.coc_scale(size))
    image = sp.synthesize(sp.Frame(radiance, depth), CAMERA, database, layers=layers)
    wrong = (np.abs(image[..., :3] - radiance).max(axis=2) > 0.02) & inside & (np.hypot(x + 70, y + 70) > 36)
    return float((50.0 - np.hypot(x, y))[wrong].max(initial=0.0))


def frame_line(pinhole: Path, camera: Path, reference: Path, database: sp.Database) -> str:
    """Return a line about a rendered frame."""
    frame, truth = sp.read_frame(pinhole), sp.read_image(reference)
    image, report = sp.synthesize(frame, sp.read_camera(camera), database, report=True)
    found = sp.metrics.compare(image, truth)
    off = np.abs(display_encode(image[..., :3]) - display_encode(truth[..., :3])).max(axis=2) > OFF
    tiles = worst_tile(image, truth)
    figures = f"SSIM {found['ssim']:.4f}  FLIP {found['flip']:.4f}  PSNR {found['psnr']:.2f}"
    return (
        f"{reference.stem:<20} {figures}  off by more than {OFF}: {100 * off.mean():.2f} %  "
        f"worst tile {tiles[0]:.0f} %, beyond 5 %: {tiles[1]:.2f}  "
        f"layers {report['plan']['layers']}  {report['time_s']['total']:.2f} s"
    )


def worst_tile(image: np.ndarray, truth: np.ndarray, size: int = 16, border: int = 32) -> tuple[float, float]:
    """Return the largest relative error, %, of the means of tiles off the border, and the share of them beyond 5 %."""
    height, width = ((side - 2 * border) // size for side in truth.shape[:2])

    def means(each: np.ndarray) -> np.ndarray:
        part = each[border : border + height * size, border : border + width * size, :3]
        return part.reshape(height, size, width, size, 3).mean(axis=(1, 3))

    error = 100 * np.abs(means(image) / np.maximum(means(truth), 1e-3) - 1).max(axis=2)
    return float(error.max()), float((error > 5).mean())


FURTHER = (
    ("foliage_pinhole.exr", "foliage.json", "foliage_ref_dofmb.exr"),
    ("rain_pinhole.exr", "rain_thin.json", "rain_ref_thin.exr"),
)
"""Anti-aliased frames."""


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--cases", type=int, default=200)
    arguments = options.parse_args()
    found = scenes(arguments.frames, "_pinhole.exr", "_ref_dofmb.exr")
    frames_found = [[arguments.frames / name for name in names] for names in FURTHER]
    frames_found += [[scene.path(each) for each in ("_pinhole.exr", ".json", "_ref_dofmb.exr")] for scene in found]
    warnings.simplefilter("ignore")
    lines = []
    with sp.open_database("combined") as database:
        cases = drawings(arguments.cases)
        errors = np.array([worst_error(each, database) for each in cases])
        order = np.argsort(errors[:, 0])[::-1]
        lines.append(f"{len(cases)} drawn cases, largest error: median {np.median(errors[:, 0]):.3f}, ")
        lines[-1] += f"90 % {np.quantile(errors[:, 0], 0.9):.3f}, worst {errors[:, 0].max():.3f}"
        for name in ("shape", "kernel", "depth"):
            for value in dict.fromkeys(getattr(each, name) for each in cases):
                some = errors[[getattr(each, name) == value for each in cases], 0]
                lines.append(f"  {value:<18} {len(some):>4} median {np.median(some):.3f}  worst {some.max():.3f}")
        lines += ["the worst", *(f"  {errors[n, 0]:.3f} (mean {errors[n, 1]:.4f})  {cases[n]}" for n in order[:15])]
        lines.append(f"slanted dark floor behind a near post, second difference of rows: {stripes(database):.2f} steps")
        for layers in (4, 8, 12):
            lines.append(f"subject in focus, at most {layers} layers: bleeds {bleed(database, layers):.1f} px")
        lines += [frame_line(*each, database) for each in frames_found if all(path.exists() for path in each)]
    print("\n".join(lines))
    result_path("edges.txt").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()

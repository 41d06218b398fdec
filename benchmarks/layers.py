"""Depth layers on three rendered frames: similarity, softness, seams, halos at foreground edges, and time.

    python benchmarks/layers.py [--frames DIR] [--rounds 7]

Every figure is against the renderer's own lens and shutter. ``layered`` input holds the hidden surfaces, ``single``
does not: it is divided into depth layers here, and what they hide is filled. One layer is the plain sum, normalised by
its accumulated weight. Seams are measured on a slanted plane, on which nothing hides anything: there, dividing into
layers should change nothing. Times are medians of interleaved rounds with two threads. Writes layers.txt, layers.png
and a picture of each frame to benchmarks/results: single-layer input, layered input, the reference, and 4 times the
difference of the first from the reference.
"""

import statistics

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scenes import Report, Scene, parser, result_path, save_pictures, scenes
from scipy import ndimage
from speed import rendered

import spreadlets as sp
from spreadlets.parallel import limit_threads, thread_count
from spreadlets.scene.display import display_encode

COUNTS = (1, 2, 4, 8, 16)
SOFTNESS = {"soft": 1.0, "hard": 0.0}
SIZES = (512, 1024)
STEPS = ("plan", "splat", "integrate", "composite")
TILE = 16
BORDER_TILES = 2
"""Tiles at the border, where light from beyond it is missing in the input, that the second row leaves out."""
HALO_GOAL = 0.05
GOAL_SINGLE = {"coins": 0.97, "whirl": 0.97, "fence": 0.90}
NODES = {"coins": 0.927, "whirl": 0.965, "fence": 0.807}
"""Similarity of Blender's Defocus and Vector Blur nodes on the pinhole frame, from the frames' own notes."""


def similarity(scene: Scene, database: sp.Database, report: Report) -> None:
    """Add the rows of a scene's synthesis, sparse and dense, and save its picture."""
    images = {}
    given = [("layered", scene.layered, 0.97)] if scene.path("_layer0.exr").exists() else []
    for kind, frame, goal in (*given, ("single", scene.pinhole, GOAL_SINGLE[scene.name])):
        images[kind] = sp.synthesize(frame, scene.camera, database)
        dense = sp.synthesize(frame, scene.camera, database, method="dense")
        found, ceiling = (sp.metrics.ssim(each, scene.reference) for each in (images[kind], dense))
        nodes = NODES[scene.name] if kind == "single" else "-"
        report.row(f"{scene.name}, {kind}", found, f">= {goal}", ceiling, ceiling - found, "<= 0.005", nodes)
    save_pictures(result_path(f"layers_{scene.name}.png"), list(images.values())[::-1], scene.reference)


def halo(scene: Scene, kind: str, frame: sp.Frame, database: sp.Database, report: Report) -> None:
    """Add the rows of the tile whose mean differs most from the reference's, for linear and for displayed values."""
    image = sp.synthesize(frame, scene.camera, database)[..., :3]
    for values, encode in (("linear", np.asarray), ("displayed", display_encode)):
        means, expected = (tile_means(encode(each)) for each in (image, scene.reference[..., :3]))
        for where, margin in (("all", 0), ("inside", BORDER_TILES)):
            error = (means / expected - 1)[margin : means.shape[0] - margin, margin : means.shape[1] - margin]
            row, col = np.unravel_index(np.abs(error).argmax(), error.shape)
            place = f"({TILE * (row + margin)}, {TILE * (col + margin)})"
            beyond = f"{np.count_nonzero(np.abs(error) > HALO_GOAL)} of {error.size}"
            title = f"{scene.name}, {kind}, {values}, {where}"
            report.row(title, f"{100 * error[row, col]:+.1f} %", place, beyond, width=18, first=34)


def tile_means(image: np.ndarray) -> np.ndarray:
    """Return the means of an image's tiles over their pixels and channels."""
    rows, cols = (side // TILE for side in image.shape[:2])
    tiles = image[: rows * TILE, : cols * TILE].reshape(rows, TILE, cols, TILE, -1)
    return tiles.mean(axis=(1, 3, 4))


def by_number(scene: Scene, database: sp.Database) -> dict[str, list[float]]:
    """Return the similarity of single-layer input for each number of layers, soft and hard."""
    found = {}
    for name, softness in SOFTNESS.items():
        options = [{"layers": count, "softness": softness} for count in COUNTS]
        images = [sp.synthesize(scene.pinhole, scene.camera, database, **each) for each in options]
        found[name] = [sp.metrics.ssim(image, scene.reference) for image in images]
    return found


def seams(database: sp.Database, report: Report) -> None:
    """Add how much layers change the displayed image of a textured plane from 0.8 m to 5 m, in focus half-way up."""
    rng = np.random.default_rng(0)
    size = 256
    texture = 0.4 + 0.25 * np.clip(ndimage.gaussian_filter(rng.normal(size=(size, size, 1)), (2, 2, 0)) * 6, -1, 1)
    depth = np.repeat((1 / np.linspace(1 / 5.0, 1 / 0.8, size))[:, None], size, axis=1)
    camera = sp.ThinLens(focal_length_mm=50, sensor_width_mm=36, f_number=2.0, focus_distance_m=1.4)
    frame = sp.Frame(np.repeat(texture, 3, axis=2), depth)
    plain = display_encode(sp.synthesize(frame, camera, database, layers=1)[..., :3])
    for name, softness in SOFTNESS.items():
        options = [{"layers": count, "softness": softness} for count in COUNTS[1:]]
        changes = [
            np.abs(display_encode(sp.synthesize(frame, camera, database, **each)[..., :3]) - plain) for each in options
        ]
        report.row(f"{name}: worst", *(float(change.max()) for change in changes))
        report.row(f"{name}: mean", *(float(change.mean()) for change in changes))


def times(scene: Scene, size: int, rounds: int, database: sp.Database) -> list[dict[str, float]]:
    """Return the median seconds of each step for each number of layers, interleaved."""
    frame, camera = rendered(scene, size)
    found: dict[int, list[dict[str, float]]] = {count: [] for count in COUNTS}
    for number in range(rounds + 1):
        for count in COUNTS:
            _, report = sp.synthesize(frame, camera, database, layers=count, report=True)
            if number:  # the first round compiles and warms up
                found[count].append(report["time_s"])
    return [{step: statistics.median(each[step] for each in runs) for step in runs[0]} for runs in found.values()]


def time_rows(scenes: list[Scene], rounds: int, database: sp.Database, report: Report) -> None:
    """Add the tables of time against the number of layers: whole, and by steps."""
    found = {
        f"{scene.name}, {size} x {size}": times(scene, size, rounds, database) for size in SIZES for scene in scenes
    }
    report.row("time over that of 1 layer", *COUNTS, "1 layer, ms")
    for name, each in found.items():
        first = each[0]["total"]
        report.row(name, *(medians["total"] / first for medians in each), f"{1000 * first:.0f}")
    report.add("(goal: <= 1.6 from 1 to 8 layers)")
    report.add()
    report.row("ms at 1 -> 8 layers", *STEPS, width=16)
    one, eight = COUNTS.index(1), COUNTS.index(8)
    for name, each in found.items():
        changes = (f"{1000 * each[one][step]:.0f} -> {1000 * each[eight][step]:.0f}" for step in STEPS)
        report.row(name, *changes, width=16)


def draw(curves: dict[str, dict[str, list[float]]]) -> None:
    """Draw similarity against the number of layers; dotted: the plain sum."""
    figure, axes = plt.subplots(1, len(curves), figsize=(10, 3.3), layout="constrained", squeeze=False)
    for axis, (scene, found) in zip(axes[0], curves.items(), strict=True):
        for (name, values), style in zip(found.items(), ("-o", "--s"), strict=True):
            axis.plot(COUNTS, values, style, label=name)
        axis.axhline(found["soft"][0], color="k", linestyle=":", label="plain sum")
        axis.set_xscale("log", base=2)
        axis.set(title=scene, xlabel="layers", xticks=COUNTS, xticklabels=COUNTS)
    axes[0, 0].set_ylabel("SSIM, single-layer input")
    axes[0, 0].legend()
    figure.savefig(result_path("layers.png"), dpi=80)


@limit_threads(min(2, thread_count()))
def main() -> None:
    arguments = parser(__doc__)
    arguments.add_argument("--rounds", type=int, default=7)
    given = arguments.parse_args()
    found = [each for each in scenes(given.frames, "_pinhole.exr", "_ref_dofmb.exr") if each.name in GOAL_SINGLE]
    report, curves = Report(), {}
    with sp.open_database("combined") as database:
        report.row("synthesis, SSIM", "ours", "goal", "dense", "loss", "goal", "nodes")
        for scene in found:
            similarity(scene, database, report)
        report.add()
        report.row("single-layer input, layers", *COUNTS)
        for scene in found:
            curves[scene.name] = by_number(scene, database)
            for name, values in curves[scene.name].items():
                report.row(f"{scene.name}, {name}, SSIM", *values)
        report.add("(goal: layering beats 1 layer, the plain sum, on each frame; default: soft)")
        report.add()
        report.row("slanted plane, layers", *COUNTS[1:])
        seams(database, report)
        report.add("(change of the displayed image, whose range is 1, against 1 layer)")
        report.add()
        report.row("worst 16 x 16 tile mean", "error", "tile (row, col)", "beyond 5 %", width=18, first=34)
        if found[-1].path("_layer0.exr").exists():
            halo(found[-1], "layered", found[-1].layered, database, report)
        halo(found[-1], "single", found[-1].pinhole, database, report)
        report.add(f"(goal: within 5 %; inside: {BORDER_TILES * TILE} px and more from the border)")
        report.add()
        time_rows(found, given.rounds, database, report)
    report.save("layers.txt")
    draw(curves)


if __name__ == "__main__":
    main()

"""Error against the tolerance of the level of detail: what is traded, what it buys, and whether the bound holds.

    python benchmarks/tolerance.py [--frames DIR]

On the rendered frames of ``--frames`` (default frames; the small ones that ship where missing). Errors
are changes of the displayed image against tolerance 0. The bound is that of pixels drawn as blocks; coarse pixels,
which keep the tolerance by themselves, add to the change. Writes tolerance.txt and tolerance.png to benchmarks/results.
"""

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scenes import parser, result_path, scenes

import spreadlets as sp
from spreadlets.scene.display import display_encode

TOLERANCES = (0.0005, 0.001, 0.002, 0.004, 0.008, 0.016, 0.032, 0.064)
ROUNDS = 5


def measure(frame: sp.Frame, camera: sp.ThinLens, database: sp.Database) -> list[dict[str, float]]:
    """Return the figures of each tolerance, the first being 0."""
    rows = []
    for tolerance in (0.0, *TOLERANCES):
        runs = [sp.synthesize(frame, camera, database, tolerance=tolerance, report=True) for _ in range(ROUNDS)]
        image, report = runs[-1]
        if tolerance == 0.0:
            exact = image
        change = np.abs(display_encode(image[..., :3]) - display_encode(exact[..., :3]))
        rows.append(
            {
                "tolerance": tolerance,
                "bound": report["plan"]["error_bound"],
                "worst": float(change.max()),
                "mean": float(change.mean()),
                "1-SSIM": 1 - sp.metrics.ssim(image, exact),
                "points": report["plan"]["points_splatted"] / frame.depth.size,
                "splat ms": 1000 * min(each["time_s"]["splat"] for _, each in runs),
            }
        )
    return rows


def draw(results: dict[str, list[dict[str, float]]]) -> None:
    """Draw the errors and their bound, and the points, against the tolerance."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    left.loglog(TOLERANCES, TOLERANCES, "k:", label="tolerance")
    for number, (scene, rows) in enumerate(results.items()):
        for name, style in (("bound", "--"), ("worst", "-"), ("mean", "-.")):
            left.loglog(TOLERANCES, [row[name] for row in rows[1:]], f"C{number}{style}", label=f"{scene}, {name}")
        right.semilogx(TOLERANCES, [row["points"] for row in rows[1:]], f"C{number}-", label=scene)
        right.axhline(rows[0]["points"], color=f"C{number}", linestyle=":")
    left.set(xlabel="tolerance", ylabel="change of the displayed image")
    right.set(xlabel="tolerance", ylabel="points per pixel (dotted: tolerance 0)", ylim=(0, None))
    left.legend(fontsize=7)
    right.legend(fontsize=7)
    figure.savefig(result_path("tolerance.png"), dpi=80)


def main() -> None:
    found = scenes(parser(__doc__).parse_args().frames, "_pinhole.exr")
    results, lines = {}, []
    with sp.open_database("combined") as database:
        for scene in found:
            rows = results[scene.name] = measure(scene.pinhole, scene.camera, database)
            lines += [f"{scene.name:>8}" + "".join(f"{name:>11}" for name in rows[0])]
            lines += ["        " + "".join(f"{value:>11.5g}" for value in row.values()) for row in rows]
    print("\n".join(lines))
    result_path("tolerance.txt").write_text("\n".join(lines) + "\n")
    draw(results)


if __name__ == "__main__":
    main()

"""Synthesis on rendered frames with ground truth: spreadlets against the same PSFs splatted in full, and gathered.

Reads pinhole frames, cameras and references from ``--frames`` (default frames), or else the small frames that ship.
Writes frames.txt and a picture of each frame to benchmarks/results.

    python benchmarks/frames.py [--frames DIR] [--db combined]
"""

from pathlib import Path

import numpy as np
from scenes import Scene, parser, result_path, scenes
from skimage.transform import downscale_local_mean

import spreadlets as sp
from spreadlets.scene.display import display_encode

EFFECTS = {"dofmb": {}, "dof": {"motion": False}, "mb": {"defocus": False}}
COLUMNS = ("scene", "effect", "ssim gather", "ssim dense", "ssim", "loss", "mean ratio", "points/px", "dense s", "s")


def measure(scene: Scene, effect: str, database: sp.Database) -> tuple[list[object], list[np.ndarray]]:
    """Return a row of the table, and the images: pinhole, spreadlets, gathered, dense, reference."""
    frame, camera, reference = scene.pinhole, scene.camera, sp.read_image(scene.path(f"_ref_{effect}.exr"))
    sparse, report = sp.synthesize(frame, camera, database, report=True, **EFFECTS[effect])
    gathered = sp.synthesize(frame, camera, database, method="gather", **EFFECTS[effect])
    dense, dense_report = sp.synthesize(frame, camera, database, method="dense", report=True, **EFFECTS[effect])
    similarity = [sp.metrics.ssim(image, reference) for image in (gathered, dense, sparse)]
    row = [
        scene.name,
        effect,
        *similarity,
        similarity[1] - similarity[2],
        float(sparse[..., :3].mean() / dense[..., :3].mean()),
        report["plan"]["points_splatted"] / frame.depth.size,
        dense_report["time_s"]["total"],
        report["time_s"]["total"],
    ]
    return row, [frame.radiance, sparse, gathered, dense, reference]


def save_picture(path: Path, images: list[np.ndarray]) -> None:
    """Save the images side by side at half size."""
    half = [downscale_local_mean(display_encode(image[..., :3]), (2, 2, 1)) for image in images]
    from PIL import Image

    Image.fromarray(np.rint(255 * np.concatenate(half, axis=1)).astype(np.uint8)).save(path, optimize=True)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--db", default="combined")
    arguments = options.parse_args()
    found = scenes(arguments.frames, "_pinhole.exr", "_ref_dofmb.exr")
    lines = ["".join(f"{name:>12}" for name in COLUMNS)]
    with sp.open_database(arguments.db) as database:
        measure(found[0], "dofmb", database)  # compiles
        for scene in found:
            for effect in EFFECTS:
                if not scene.path(f"_ref_{effect}.exr").exists():
                    continue
                row, images = measure(scene, effect, database)
                lines.append("".join(f"{cell:>12.4f}" if isinstance(cell, float) else f"{cell:>12}" for cell in row))
                print(lines[-1], flush=True)
                if effect == "dofmb":
                    save_picture(result_path(f"frames_{scene.name}.png"), images)
    result_path("frames.txt").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()

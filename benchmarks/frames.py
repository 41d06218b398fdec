"""Synthesis on three rendered frames with ground truth: spreadlets against dense splatting of the same PSFs.

Reads coins, whirl and fence (pinhole frame, camera, references) from ``--frames`` (default frames) and skips
cleanly where they are missing. Writes frames.txt and a picture of each frame to benchmarks/results.

    python benchmarks/frames.py [--frames DIR] [--db combined]
"""

import argparse
from pathlib import Path

import numpy as np
from skimage.transform import downscale_local_mean

import spreadlets as sp
from spreadlets.scene.display import display_encode

RESULTS = Path(__file__).parent / "results"
SCENES = ("coins", "whirl", "fence")
EFFECTS = {"dofmb": {}, "dof": {"motion": False}, "mb": {"defocus": False}}
COLUMNS = ("scene", "effect", "ssim dense", "ssim", "loss", "mean ratio", "points/px", "dense s", "s")


def measure(folder: Path, scene: str, effect: str, database: sp.Database) -> tuple[list[object], list[np.ndarray]]:
    """Return a row of the table, and the images: pinhole, spreadlets, dense, reference."""
    frame = sp.read_frame(folder / f"{scene}_pinhole.exr")
    camera = sp.read_camera(folder / f"{scene}.json")
    reference = sp.read_image(folder / f"{scene}_ref_{effect}.exr")
    sparse, report = sp.synthesize(frame, camera, database, report=True, **EFFECTS[effect])
    dense, dense_report = sp.synthesize(frame, camera, database, method="dense", report=True, **EFFECTS[effect])
    similarity = [sp.metrics.ssim(image, reference) for image in (dense, sparse)]
    row = [
        scene,
        effect,
        *similarity,
        similarity[0] - similarity[1],
        float(sparse[..., :3].mean() / dense[..., :3].mean()),
        report["plan"]["points_splatted"] / frame.depth.size,
        dense_report["time_s"]["total"],
        report["time_s"]["total"],
    ]
    return row, [frame.radiance, sparse, dense, reference]


def save_picture(path: Path, images: list[np.ndarray]) -> None:
    """Save the images side by side at half size."""
    half = [downscale_local_mean(display_encode(image[..., :3]), (2, 2, 1)) for image in images]
    from PIL import Image

    Image.fromarray(np.rint(255 * np.concatenate(half, axis=1)).astype(np.uint8)).save(path, optimize=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=Path, default=Path("frames"))
    parser.add_argument("--db", default="combined")
    arguments = parser.parse_args()
    if not (arguments.frames / "coins_pinhole.exr").exists():
        print(f"skipped: no frames in {arguments.frames}")
        return
    lines = ["".join(f"{name:>12}" for name in COLUMNS)]
    with sp.open_database(arguments.db) as database:
        measure(arguments.frames, "coins", "dofmb", database)  # compiles
        for scene in SCENES:
            for effect in EFFECTS:
                row, images = measure(arguments.frames, scene, effect, database)
                lines.append("".join(f"{cell:>12.4f}" if isinstance(cell, float) else f"{cell:>12}" for cell in row))
                print(lines[-1], flush=True)
                if effect == "dofmb":
                    save_picture(RESULTS / f"frames_{scene}.png", images)
    (RESULTS / "frames.txt").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()

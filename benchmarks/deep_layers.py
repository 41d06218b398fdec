"""Deep images as depth layers: cut where surfaces part, by rank, and the layers as they were rendered.

The rendered depth layers of coins and fence (``--frames``, default frames, or else the small ones that ship) are stored
as one deep image each and read again. SSIM is against the renderer's own depth of field and motion blur. Writes
deep_layers.txt to benchmarks/results.

    python benchmarks/deep_layers.py [--frames DIR] [--db combined]
"""

import tempfile

import numpy as np
from scenes import parser, result_path, scenes

import spreadlets as sp

SCENES = ("coins", "fence")
COLUMNS = ("scene", "layers", "made", "ssim")


def deep_of(layers: list[sp.Frame]) -> sp.DeepImage:
    """Return the visible pixels of layers as deep samples, nearest first."""
    alpha = np.stack([layer.radiance[..., 3] for layer in layers], axis=2)
    there = alpha > 0
    radiance, depth, motion = (
        np.stack([getattr(layer, name) for layer in layers], axis=2)[there] for name in ("radiance", "depth", "motion")
    )
    return sp.DeepImage(there.sum(axis=2), radiance, depth, depth, motion)


def by_rank(layers: list[sp.Frame]) -> sp.Frame:
    """Return a frame whose layer k holds the k-th sample of every pixel."""
    order = np.argsort(np.stack([layer.radiance[..., 3] == 0 for layer in layers]), axis=0, kind="stable")
    arrays = [np.stack([getattr(layer, name) for layer in layers]) for name in ("radiance", "depth", "motion")]
    ranked = [np.take_along_axis(a, order.reshape(order.shape + (1,) * (a.ndim - 3)), axis=0) for a in arrays]
    return sp.Frame.from_layers(list(zip(*ranked, strict=True)))


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--db", default="combined")
    arguments = options.parse_args()
    found = [scene for scene in scenes(arguments.frames, "_layer0.exr", "_ref_dofmb.exr") if scene.name in SCENES]
    lines = [f"{COLUMNS[0]:<8}{COLUMNS[1]:<14}{COLUMNS[2]:>6}{COLUMNS[3]:>8}"]
    with sp.open_database(arguments.db) as database, tempfile.TemporaryDirectory() as folder:
        for scene in found:
            layers = list(scene.layered.layers)
            sp.write_deep(f"{folder}/deep.exr", deep_of(layers))
            cut = sp.read_frame(f"{folder}/deep.exr")
            frames = {"as rendered": scene.layered, "deep, cut": cut, "deep, by rank": by_rank(layers)}
            for name, frame in frames.items():
                ssim = sp.metrics.ssim(sp.synthesize(frame, scene.camera, database), scene.reference)
                lines.append(f"{scene.name:<8}{name:<14}{len(frame.layers):>6}{ssim:>8.4f}")
                print(lines[-1], flush=True)
    result_path("deep_layers.txt").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()

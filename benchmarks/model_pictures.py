"""Pictures of every PSF model for docs/models.md: PSFs over the parameters, their points, and a frame.

Reads the databases that ship, and the frame ``coins`` from ``--frames`` (default frames), or else the small one
that ships, whose pictures are written to benchmarks/results/small. Writes to docs/models.

    python benchmarks/model_pictures.py [--frames DIR]
"""

import warnings
from pathlib import Path

import matplotlib.image
import numpy as np
from scenes import Scene, parser, result_path, scenes

import spreadlets as sp
from spreadlets.precompute.models.grids import model_settings
from spreadlets.precompute.models.registry import trace_psf
from spreadlets.psf.database import open_database
from spreadlets.psf.model import get_model
from spreadlets.psf.spreadlet import Spreadlet
from spreadlets.scene.display import display_encode

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "docs" / "models"
TILE = 90
"""Half-side of a tile, px."""

PLACES = {
    "simplelens": [[4.0], [16.0], [40.0], [60.0]],
    "combined": [[4.0, 60.0], [16.0, 16.0], [20.0, 60.0], [40.0, 60.0]],
    "stylized": [[4.0], [16.0], [40.0], [60.0]],
    "volume": [[0.2], [1.0], [2.0], [3.8]],
}
LENS_PLACES = [(1, 0.0, 0.0), (1, 28.0, 2.0), (1, 28.0, 12.0), (1, 28.0, 22.0), (-1, 28.0, 22.0)]
"""Side of the focus, CoC radius in px, image height in mm."""

APERTURES = {
    "blades": {"blades": 6, "rotation": 10.0},
    "curved": {"blades": 5, "blade_curvature": 0.5},
    "cats_eye": {"cats_eye": 0.7},
    "anamorphic": {"squeeze": 0.5},
    "dark_rim": {"spherical_aberration": 0.4},
    "bright_rim": {"spherical_aberration": -0.4},
    "obstruction": {"obstruction": 0.45},
}


def tile(psf: np.ndarray, gain: float = 1.0) -> np.ndarray:
    """Cut or pad a PSF to a tile, scale it to its peak, and encode it for display; (2 TILE + 1, 2 TILE + 1, 3)."""
    canvas = np.zeros((2 * TILE + 1, 2 * TILE + 1, 3))
    half = [min(size // 2, TILE) for size in psf.shape[:2]]
    centre = [size // 2 for size in psf.shape[:2]]
    rows, cols = (slice(c - h, c + h + 1) for c, h in zip(centre, half, strict=True))
    canvas[TILE - half[0] : TILE + half[0] + 1, TILE - half[1] : TILE + half[1] + 1] = psf[rows, cols]
    return display_encode(np.clip(gain * canvas / canvas.max(), 0, 1))


def points_tile(spreadlet: Spreadlet) -> np.ndarray:
    """Draw the points: red above 0, blue below, as large as they can be told apart."""
    canvas = np.full((2 * TILE + 1, 2 * TILE + 1, 3), 0.08)
    sign = spreadlet.value.sum(axis=1)
    for (row, col), value in zip(spreadlet.offset_rc.astype(int), sign, strict=True):
        if max(abs(row), abs(col)) <= TILE:
            canvas[TILE + row, TILE + col] = (1.0, 0.45, 0.3) if value > 0 else (0.35, 0.6, 1.0)
    return canvas


def save(name: str, rows: list[list[np.ndarray]]) -> None:
    """Write rows of tiles as a PNG, with thin lines between them."""
    lined = [[np.pad(each, ((0, 2), (0, 2), (0, 0)), constant_values=0.3) for each in row] for row in rows]
    image = np.concatenate([np.concatenate(row, axis=1) for row in lined], axis=0)
    matplotlib.image.imsave(FOLDER / f"{name}.png", (255 * image.clip(0, 1)).astype(np.uint8))


def database_picture(name: str) -> None:
    """Show PSFs of a shipped database as their spreadlets stand for them, and the points."""
    shown: list[list[np.ndarray]] = [[], []]
    with open_database(name) as database:
        if name == "physicallens":
            spots = [(database.grid.find([coc, height]), side) for side, coc, height in LENS_PLACES]
        else:
            spots = [(database.find(place), 1) for place in PLACES[name]]
        for cell, side in spots:
            number = database.grid.nearest_pose(int(cell), 0.0 if name != "combined" else 0.6, side < 0)[0]
            spreadlet = database.cell(int(cell), int(number))
            # A halo is a thousand times darker than the light that passes straight.
            gain = 300.0 if name == "volume" else 1.0
            shown[0].append(tile(np.maximum(spreadlet.to_dense(TILE), 0), gain))
            shown[1].append(points_tile(spreadlet))
    save(name, shown)


def aperture_picture() -> None:
    """Show every aperture behind and in front of focus, and in motion."""
    rows: list[list[np.ndarray]] = [[], [], []]
    for options in APERTURES.values():
        still = get_model("simplelens", settings=model_settings("simplelens", options))
        moving = get_model("combined", settings=model_settings("combined", options))
        behind = trace_psf(still, [[60.0, 60.0]])
        stored = still.symmetry.sign == "stored"
        front = trace_psf(still, [[60.0, 60.0]], side=-1) if stored else behind[::-1, ::-1]
        streak = trace_psf(moving, [[40.0, 40.0], [90.0, 90.0]], angle=0.6)
        for row, psf in zip(rows, (behind, front, streak), strict=True):
            row.append(tile(np.broadcast_to(psf, (*psf.shape[:2], 3)))[::2, ::2])
    save("apertures", rows)


def radial_picture() -> None:
    """Show lamps behind and in front of the focus through a cat's eye that grows towards the corners."""
    camera = sp.ThinLens(focal_length_mm=50, sensor_width_mm=36, f_number=0.5, focus_distance_m=2.0)
    light = np.full((256, 384, 3), 0.003, np.float32)
    light[20::36, 24::48] = 60.0
    shown = []
    for depth in (20.0, 0.95):
        frame = sp.Frame(light, np.full(light.shape[:2], depth, np.float32))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            image = sp.synthesize(frame, camera, sp.models.SimpleLens(cats_eye=0.9, cats_eye_radial=True))
        shown.append(display_encode(image[..., :3]))
    save("radial", [shown])


def frame_picture(name: str, scene: Scene, path: Path) -> None:
    """Show the frame as a model blurs it."""
    frame, camera = scene.pinhole, scene.camera
    if name == "volume":
        # The scene is some metres deep: a thinner fog, of the same optical depth as a smaller scene's.
        layer = frame.layers[0]
        frame = sp.Frame(layer.radiance[..., :3], layer.depth / 4.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        image = sp.synthesize(frame, camera, name, motion=name == "combined")
    matplotlib.image.imsave(path, _eight_bit(image[..., :3]))


def _eight_bit(image: np.ndarray) -> np.ndarray:
    """Encode for display, reduced to half the size."""
    height, width = (size // 2 * 2 for size in image.shape[:2])
    small = image[:height, :width].reshape(height // 2, 2, width // 2, 2, 3).mean(axis=(1, 3))
    return np.asarray(255 * display_encode(small).clip(0, 1), np.uint8)


def main() -> None:
    given = parser(__doc__).parse_args().frames
    coins = next(scene for scene in scenes(given, "_pinhole.exr") if scene.name == "coins")
    whole = coins.folders == (given,)
    FOLDER.mkdir(exist_ok=True)
    aperture_picture()
    radial_picture()
    for name in (*PLACES, "physicallens"):
        database_picture(name)
        picture = f"{name}_frame.png"
        frame_picture(name, coins, FOLDER / picture if whole else result_path(picture))


if __name__ == "__main__":
    main()

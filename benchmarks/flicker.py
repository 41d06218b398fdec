"""Flicker: what jumps from frame to frame, over 24 frames of a rack focus, of a dolly and of a camera at rest.

    python benchmarks/flicker.py [--frames 24] [--size 256]

Three cards stand at 2, 3.5 and 6 m, textured and anti-aliased, 4 x 4 samples in each pixel, with small lamps on the
farthest. Rack: the focus goes from 2 to 6 m, evenly in 1 / distance. Dolly: the camera comes nearer by 1 m, so every
card moves and grows. At rest: nothing changes. Frames have overscan, so that they hold all that the truth shows. They
are drawn in layers, as a renderer gives them, or in one, which does not hold what is hidden: there what is guessed
counts, too. The truth of every frame is drawn as dense as can be: each card by itself, convolved with the exact disc of
its CoC (64 x 64 samples in each pixel), colour and alpha, and put over the farther ones.

``known``: the truth of each frame by itself, if what nearer cards hide in it were filled smoothly from around, with no
lamps: how much of the differences single frames cannot know, as lamps that come out from behind a card.

Columns: RMS of the differences between one frame and the next, less that of the truth, displayed (sRGB), as a share of
the range, and the same as PSNR; the worst pair of frames; in which pair it is; the SSIM of the worst frame. ``dense``:
the cells' PSFs drawn in full. Writes flicker.txt to benchmarks/results.
"""

import argparse
import warnings
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from moving import disc
from scenes import Report
from scipy import ndimage, signal

import spreadlets as sp
from spreadlets.metrics import ssim
from spreadlets.scene.display import display_encode
from spreadlets.scene.raster import Raster, Window

DEPTHS = (2.0, 3.5, 6.0)
"""Of the cards, metres, the nearest first."""
SUBSAMPLES = 4
LAMP = 30.0
WIDTHS = ((0.0, 6), (2.4, 5))
"""Strips of the two nearer cards: first phase, and how many there are across the picture."""
FOCAL_MM, SENSOR_MM, F_NUMBER = 60.0, 36.0, 0.7
DOLLY_M = 1.0


class Card(NamedTuple):
    """A card as it is seen: premultiplied colour and alpha (H, W, 4), and its depth, metres."""

    picture: np.ndarray
    depth: float


def textures(size: int, contrast: float = 3.0) -> list[np.ndarray]:
    """Return the texture (2 size, 2 size, 4) of each card, which is seen at half of that size from where it begins."""
    rng, made = np.random.default_rng(0), []
    for number in range(len(DEPTHS)):
        noise = ndimage.gaussian_filter(rng.random((2 * size, 2 * size, 3)), (3, 3, 0), mode="wrap")
        colour = np.clip(0.5 + contrast * (noise - 0.5) + 0.1 * number, 0.02, 1.0)
        alpha = np.ones((2 * size, 2 * size, 1))
        if number < len(WIDTHS):
            phase, count = WIDTHS[number]
            across = np.arange(2 * size) / (2 * size)
            alpha[:] = (np.sin(2 * np.pi * count * across + phase) > 0.5)[None, :, None]
        else:
            for row, col in rng.integers(0, 2 * size, (60, 2)):
                colour[row : row + 2, col : col + 2] = LAMP
        made.append(np.concatenate([colour * alpha, alpha], axis=2))
    return made


def seen(texture: np.ndarray, size: int, growth: float, margin: int) -> np.ndarray:
    """Return a card, grown about the picture's middle, (size + 2 margin, ..., 4), anti-aliased."""
    side = (size + 2 * margin) * SUBSAMPLES
    place = ((np.arange(side) + 0.5) / SUBSAMPLES - margin - size / 2) / growth + size
    index = np.floor(place).astype(int) % texture.shape[0]
    fine = texture[index[:, None], index[None, :]]
    return fine.reshape(size + 2 * margin, SUBSAMPLES, size + 2 * margin, SUBSAMPLES, 4).mean(axis=(1, 3))


def cards(size: int, move: float, margin: int) -> list[Card]:
    """Return the cards as a camera sees them that has come nearer by so many metres."""
    return [
        Card(seen(texture, size, depth / (depth - move), margin), depth - move)
        for texture, depth in zip(textures(size), DEPTHS, strict=True)
    ]


def truth(shown: list[Card], camera: sp.ThinLens, size: int, margin: int) -> np.ndarray:
    """Return the picture: each card blurred by its own disc, over the farther ones."""
    image = np.zeros((size, size, 4))
    for card in shown:
        kernel = disc(abs(float(camera.coc_radius(card.depth, size))), 64)
        whole = signal.fftconvolve(card.picture, kernel[..., None], mode="same", axes=(0, 1))
        blurred = whole[margin:-margin, margin:-margin]
        image += (1.0 - image[..., 3:]) * blurred
    return np.clip(image, 0.0, None)


def filled(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return values (H, W, 3), those that are not known interpolated: from as near as there are enough."""
    found = None
    for sigma in 2.0 ** np.arange(6, -1, -1):
        weight = ndimage.gaussian_filter(known, sigma)[..., None]
        mean = ndimage.gaussian_filter(values * known[..., None], (sigma, sigma, 0)) / np.maximum(weight, 1e-9)
        sure = np.clip(weight / 0.2, 0, 1)
        found = mean if found is None else found + sure * (mean - found)
    return found


def as_known(shown: list[Card]) -> list[Card]:
    """Return the cards with the colours of what nearer ones hide filled from around, without lamps."""
    seen, known = np.ones_like(shown[0].picture[..., 0]), []
    for card in shown:
        colour, alpha = card.picture[..., :3], card.picture[..., 3:]
        straight = colour / np.maximum(alpha, 1e-6)
        told = (seen > 0.999) & (alpha[..., 0] > 0.5) & (straight.max(axis=2) < 1.01)
        guess = alpha * filled(straight, told.astype(float))
        known.append(Card(np.concatenate([guess + seen[..., None] * (colour - guess), alpha], axis=2), card.depth))
        seen = seen * (1.0 - alpha[..., 0])
    return known


def frames_of(shown: list[Card], margin: int) -> dict[str, sp.Frame]:
    """Return the frame in layers, and in one, with overscan."""
    layers = [np.ascontiguousarray(card.picture, np.float32) for card in shown]
    depths = [np.full(layer.shape[:2], card.depth, np.float32) for layer, card in zip(layers, shown, strict=True)]
    whole, depth = np.zeros_like(layers[0]), depths[-1]
    side = len(whole)
    inner = Window(0, 0, side - 2 * margin, side - 2 * margin)
    raster = Raster(Window(-margin, -margin, side, side), inner)
    for layer, each in zip(layers[::-1], depths[::-1], strict=True):
        whole = layer + (1.0 - layer[..., 3:]) * whole
        depth = np.where(layer[..., 3] > 0.5, each, depth)
    stacked = sp.Frame.from_layers([sp.Frame(*pair, raster=raster) for pair in zip(layers, depths, strict=True)])
    return {"layered": stacked, "single": sp.Frame(whole, depth, raster=raster)}


def displayed(image: np.ndarray) -> np.ndarray:
    """Return what a display shows, 0 to 1."""
    return np.clip(display_encode(np.asarray(image[..., :3], np.float32)), 0.0, 1.0)


def flicker(images: Sequence[np.ndarray], expected: Sequence[np.ndarray]) -> list[object]:
    """Return the columns of a sequence but for the last: RMS, PSNR, the worst pair of frames, and which it is."""
    jumps, wanted = (np.diff([displayed(image) for image in each], axis=0) for each in (images, expected))
    per_pair = np.sqrt(((jumps - wanted) ** 2).mean(axis=(1, 2, 3)))
    total = float(np.sqrt((per_pair**2).mean()))
    psnr = -20 * np.log10(max(total, 1e-9))
    return [f"{total:.5f}", f"{psnr:.2f}", f"{per_pair.max():.5f}", int(per_pair.argmax())]


def case(
    name: str,
    camera_at: Callable[[float], sp.ThinLens],
    move_at: Callable[[float], float],
    n_frames: int,
    size: int,
    report: Report,
) -> None:
    """Add the rows of one sequence."""
    margin = 48
    made: dict[str, list[np.ndarray]] = {}
    expected = []
    for part in np.linspace(0.0, 1.0, n_frames):
        shown, camera = cards(size, move_at(part), margin), camera_at(part)
        expected.append(truth(shown, camera, size, margin)[..., :3])
        made.setdefault("known", []).append(truth(as_known(shown), camera, size, margin)[..., :3])
        for form, frame in frames_of(shown, margin).items():
            for method in ("spreadlets", "dense"):
                whole = sp.synthesize(frame, camera, "combined", method=method)
                made.setdefault(f"{form}, {method}", []).append(whole[margin:-margin, margin:-margin, :3])
    for row, images in made.items():
        least = min(ssim(*pair) for pair in zip(images, expected, strict=True))
        report.row(f"{name}, {row}", *flicker(images, expected), least, first=34)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--size", type=int, default=256)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    near, far = 1 / DEPTHS[0], 1 / DEPTHS[-1]

    def focused(inverse: float) -> sp.ThinLens:
        return sp.ThinLens(FOCAL_MM, SENSOR_MM, F_NUMBER, 1 / inverse)

    report = Report()
    report.row("", "RMS", "PSNR", "worst pair", "at", "least SSIM", first=34)
    sequences = {
        "rack focus": (lambda part: focused(near + part * (far - near)), lambda _: 0.0),
        "dolly": (lambda _: focused(1 / DEPTHS[1]), lambda part: part * DOLLY_M),
        "at rest": (lambda _: focused(1 / DEPTHS[1]), lambda _: 0.0),
    }
    for name, (camera_at, move_at) in sequences.items():
        case(name, camera_at, move_at, given.frames, given.size, report)
    report.save("flicker.txt")


if __name__ == "__main__":
    main()

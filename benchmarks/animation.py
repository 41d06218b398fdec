"""An animation, after LRDM's figure 7: a camera flies past cards, and each frame is reconstructed from its samples.

    python benchmarks/animation.py [--frames 16] [--size 192] [--samples 4] [--truth 512]

The cards are those of ``benchmarks/flicker.py``, with more contrast: two of strips, at 2 and 3.5 m, before one with
small lamps at 6 m. The camera moves ahead and to the right by .8 m, and keeps its focus at 3 m from itself: what is
sharp changes, the nearest card is blurred by up to 10 px and moves by up to 17 px from frame to frame. Samples are
drawn through lens and shutter, stratified in each pixel, with new random numbers in each frame (its number is the
seed), so that noise that is left flickers. The truth is the mean of many samples that are drawn the same way.

Columns: RMS of the differences between one frame and the next, less that of the truth, displayed (sRGB), as a share of
the range, and the same as PSNR; the worst pair of frames, and which it is; SSIM of all frames, and of the worst;
seconds of a processor for a frame, with one thread, and of the slowest frame over that. The paper has times alone, of
renderer and reconstruction together: 25 to 33 ms for 1920 x 1080 px on a graphics card. ``halves of the truth``: what
noise the truth itself has, one half of its samples against the other, twice that of all of them.

Writes animation.txt and animation.png (the last frame of each method and of the truth; below it one row of pixels, from
the first frame down to the last) to benchmarks/results.
"""

import argparse
import time
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from flicker import DEPTHS, FOCAL_MM, SENSOR_MM, displayed, flicker, textures
from PIL import Image
from scenes import RESULTS, Report
from scipy.stats import qmc

import spreadlets as sp
from spreadlets.metrics import ssim
from spreadlets.parallel import limit_threads

METHODS = ("mean", "spreadlets", "lrdm", "lrdm-sheared", "lrdm-ewa", "tlfr")
CAMERA = sp.ThinLens(FOCAL_MM, SENSOR_MM, f_number=0.5, focus_distance_m=3.0, shutter=(-0.25, 0.25))
COLUMNS = "RMS", "PSNR, dB", "worst pair", "at", "SSIM", "least", "CPU s", "slowest x"
AHEAD_M, RIGHT_M = 0.8, 0.8
"""How far the camera moves in all."""
CONTRAST = 10.0
"""Of the cards' textures, which makes noise."""
TRUTH_SEED = 1_000_000
SHOWN = 160
"""Side of the part of a frame that is shown, px."""
ROW_HEIGHT = 4
"""Of a frame's row of pixels in the picture below, px."""


class Flight:
    """The cards, as a camera sees them that moves evenly."""

    def __init__(self, n_frames: int, size: int) -> None:
        self.size, self.textures = size, textures(size, CONTRAST)
        self.ahead, self.right = AHEAD_M / n_frames, RIGHT_M / n_frames
        self.focal_px = FOCAL_MM / SENSOR_MM * size

    def draw(self, frame: int, points: np.ndarray) -> dict[str, np.ndarray]:
        """Draw a sample in each pixel.

        Parameters
        ----------
        frame : int
            Its number.
        points : ndarray of shape (H, W, 5)
            Uniform numbers: two for the lens, one for the shutter, two for the place in the pixel.

        Returns
        -------
        arrays : dict of str to ndarray
            What `SampleBuffer` takes, each (H, W, ...).
        """
        size, (begin, end) = self.size, CAMERA.shutter
        # Choose lens, time and place.
        radius, angle = np.sqrt(points[..., 0]), 2 * np.pi * points[..., 1]
        lens = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
        time_frames, offset = begin + (end - begin) * points[..., 2], points[..., 3:] - 0.5
        moment = frame + time_frames
        place = np.stack(np.meshgrid(np.arange(size), np.arange(size)), axis=-1) + 0.5 + offset - size / 2

        radiance, depth = np.zeros((size, size, 3)), np.zeros((size, size))
        motion, open_yet = np.zeros((size, size, 2)), np.ones((size, size), bool)
        for texture, first_depth in zip(self.textures, DEPTHS, strict=True):
            # Where the middle of the lens sees the card there, and what is drawn on it: a texel was a pixel at first.
            away = first_depth - self.ahead * moment
            seen = place - CAMERA.coc_radius(away, size)[..., None] * lens
            moved = self.focal_px * self.right * moment / first_depth
            texel = seen * (away / first_depth)[..., None] + size
            columns, rows = (np.floor(each).astype(int) % (2 * size) for each in (texel[..., 0] + moved, texel[..., 1]))
            found = texture[rows, columns]
            # Keep the nearest card.
            hit = open_yet & (found[..., 3] > 0.5)
            sideways = np.array([self.focal_px * self.right, 0.0])
            speed = (seen * self.ahead - sideways) / away[..., None]
            radiance[hit], depth[hit], motion[hit] = found[hit, :3], away[hit], speed[hit]
            open_yet &= ~hit
        return {
            "radiance": radiance,
            "depth": depth,
            "motion": motion,
            "lens_uv": lens,
            "time": time_frames,
            "offset": offset,
        }

    def drawn(self, frame: int, count: int, seed: int) -> Iterator[dict[str, np.ndarray]]:
        """Draw samples in each pixel, one after the other: an even sequence, moved by a random step in each pixel."""
        step = np.random.default_rng(seed).random((self.size, self.size, 5))
        for even in qmc.Sobol(5, scramble=False).random(count):
            yield self.draw(frame, (even + step) % 1.0)

    def samples(self, frame: int, count: int) -> sp.SampleBuffer:
        """Return the samples of a frame."""
        drawn = list(self.drawn(frame, count, seed=frame))
        return sp.SampleBuffer(**{name: np.stack([each[name] for each in drawn], axis=2) for name in drawn[0]})

    def truth(self, frame: int, count: int) -> list[np.ndarray]:
        """Return two halves of the truth: images that are the means of half of the samples each."""
        seeds = TRUTH_SEED + 2 * frame, TRUTH_SEED + 2 * frame + 1
        return [sum(each["radiance"] for each in self.drawn(frame, count // 2, seed)) / (count // 2) for seed in seeds]


def figures(images: Sequence[np.ndarray], expected: Sequence[np.ndarray]) -> list[object]:
    """Return the columns of a sequence but for its times."""
    similarity = [ssim(*pair) for pair in zip(images, expected, strict=True)]
    return [*flicker(images, expected), float(np.mean(similarity)), min(similarity)]


def save_strips(sequences: Iterable[Sequence[np.ndarray]]) -> None:
    """Save the last frame of each sequence side by side, and below each one row of pixels over time."""
    strips = []
    for images in sequences:
        shown = [displayed(image) for image in images]
        middle = len(shown[0]) // 2
        part = slice(middle - SHOWN // 2, middle + SHOWN // 2)
        over_time = np.repeat([image[middle, part] for image in shown], ROW_HEIGHT, axis=0)
        strips.append(np.concatenate([shown[-1][part, part], over_time]))
    picture = np.rint(255 * np.concatenate(strips, axis=1)).astype(np.uint8)
    Image.fromarray(picture).save(RESULTS / "animation.png", optimize=True)


@limit_threads(1)
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=16)
    parser.add_argument("--size", type=int, default=192, help="of the square frames, px (default: 192)")
    parser.add_argument("--samples", type=int, default=4, help="in each pixel (default: 4)")
    parser.add_argument("--truth", type=int, default=512, help="samples of the truth (default: 512)")
    given = parser.parse_args()
    flight = Flight(given.frames, given.size)
    made, seconds = ({method: [] for method in METHODS} for _ in range(2))
    halves = []
    for frame in range(given.frames):
        samples = flight.samples(frame, given.samples)
        for method in METHODS:
            if frame == 0:  # compiles
                sp.reconstruct(samples, CAMERA, method=method)
            begin = time.process_time()
            made[method].append(sp.reconstruct(samples, CAMERA, method=method)[..., :3])
            seconds[method].append(time.process_time() - begin)
        halves.append(flight.truth(frame, given.truth))
        print(f"frame {frame + 1} of {given.frames}", flush=True)
    truth = [sum(pair) / 2 for pair in halves]
    report = Report()
    report.row(f"{given.samples} samples", *COLUMNS)
    for method, images in made.items():
        taken = seconds[method]
        times = f"{np.mean(taken):.3f}", f"{max(taken) / np.mean(taken):.2f}"
        report.row(method, *figures(images, truth), *times)
    report.row("halves of the truth", *figures(*zip(*halves, strict=True)), "-", "-")
    report.save("animation.txt")
    save_strips([*made.values(), truth])


if __name__ == "__main__":
    main()

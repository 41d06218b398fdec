"""Render a frame in all the forms that studies take, with Cycles: pinhole, layers, references, noisy images, samples.

    pip install '.[scenes]'                                     # Python 3.11; in an environment of its own
    python scenes/render.py coins --size 512 -o frames
    python scenes/render.py gear --parts pinhole references --effort 0.1 -o trial

What each file holds is in README.md beside this script. Parts that are rendered again replace their files; times of
rendering, by number of samples, are kept in the camera's file.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from frame_files import FAR_M, channels, filled, motion_at_frame, write_camera, write_image, write_samples
from glass_camera import WIDEST_PART, attach, detach, part_of_pupil, source
from passes import Renderer
from references import reference as made_of

SCENES = ("coins", "whirl", "fence", "gear", "rain")
SAMPLES = {
    "pinhole": 64,
    "layer": 32,
    "ref_dof": 512,
    "ref_mb": 256,
    "ref_dofmb": 1024,
    "ref_lens": 512,
    "ref_thin": 512,
}
"""In each pixel, at an effort of 1."""
NOISY = (1, 4, 16)
N_VIEWS, SAMPLES_OF_A_PIXEL = 64, 4
"""Points of lens, shutter and pixel that samples are taken at, and how many of them a pixel gets."""
HALVES = (7, 20)
"""Seeds: a reference is made of two renderings, which also tell how much noise is left."""


class Frame:
    """A frame that is being rendered: writes its files, and keeps the camera's up to date."""

    def __init__(self, name: str, width: int, folder: Path, effort: float) -> None:
        self.module = importlib.import_module(name)
        self.name, self.folder, self.effort = name, folder, effort
        self.shot, self.width = self.module.SHOT, width
        self.renderer = Renderer(self.shot, width)
        self.module.build()

    def count(self, kind: str) -> int:
        """Return the number of samples in a pixel of an image."""
        return max(2, round(SAMPLES[kind] * self.effort))

    def path(self, ending: str) -> Path:
        """Return the path of a file."""
        return self.folder / f"{self.name}_{ending}.exr"

    def tell(self, what: str, samples: int, seconds: float, **further: float) -> None:
        """Print and keep how long an image took, and what else is known of it."""
        found = {"render_time_s": round(seconds, 2), **further}
        print(f"{self.name}_{what}: {samples} samples in a pixel", found, flush=True)
        cameras = {self.name: self.shot.description(self.width)}
        if self.shot.glass:
            cameras = {f"{self.name}_thin": cameras[self.name], self.name: self.shot.glass_description(self.width)}
        for name, description in cameras.items():
            path = self.folder / f"{name}.json"
            write_camera(path, {"scene": self.name, **description}, what, samples, found)


def pinhole(frame: Frame) -> None:
    """Render the frame without lens and shutter; depth and motion at the pixels' centres."""
    count = frame.count("pinhole")
    image = frame.renderer.render(count)
    labels = frame.renderer.render(1, points=True)
    write_image(frame.path("pinhole"), channels(image.colour[..., :3], labels.depth, labels.vectors))
    frame.tell("pinhole", count, image.seconds)


def layers(frame: Frame) -> None:
    """Render the depth layers, nearest first, each as if it were alone."""
    count = frame.count("layer")
    if frame.shot.n_layers == 1:
        return
    for layer in range(frame.shot.n_layers):
        image = frame.renderer.render(count, layer=layer)
        labels = frame.renderer.render(1, points=True, layer=layer)
        there = labels.depth < FAR_M
        colour = np.where(image.colour[..., 3:] > 0, image.colour, 0)
        write_image(
            frame.path(f"layer{layer}"),
            channels(colour, filled(labels.depth, there), filled(labels.vectors, there)),
        )
        frame.tell(f"layer{layer}", count, image.seconds)


def references(frame: Frame) -> None:
    """Render what lens, shutter, and both make of the frame; or what the glass makes of it, and its thin lens."""
    if frame.shot.glass:
        return glass_references(frame)
    for effect in ("dofmb", "dof", "mb"):
        reference(frame, f"ref_{effect}", defocus="dof" in effect, motion_blur="mb" in effect)


def glass_references(frame: Frame) -> None:
    """Render through the lens of glass, and through its thin lens."""
    lens, lamps = frame.module.LENS, frame.module.lamps()
    data = frame.renderer.camera.data
    for ending, focus in (("ref_lens", None), ("ref_thin", frame.shot.focus_distance_m)):
        parts = [part_of_pupil(lens, lamp.place, lamp.radius, focus_m=focus) for lamp in lamps]
        small = [part for part in parts if part[-1] < WIDEST_PART]
        attach(data, source(lens, frame.shot.aspect, small, focus_m=focus))
        reference(frame, ending)
    detach(data)


def reference(frame: Frame, ending: str, **blurs: bool) -> None:
    """Render an image in two halves, and write what they make together."""
    count = frame.count(ending) // 2
    halves = [frame.renderer.render(count, seed=seed, **blurs) for seed in HALVES]
    image, found = made_of(*(half.colour[..., :3] for half in halves))
    write_image(frame.path(ending), channels(image))
    frame.tell(ending, 2 * count, sum(half.seconds for half in halves), **found)


def noisy(frame: Frame) -> None:
    """Render with lens and shutter at few samples: plain Monte Carlo."""
    for count in NOISY:
        image = frame.renderer.render(count, defocus=True, motion_blur=True, seed=1000 + count)
        write_image(frame.path(f"noisy{count}"), channels(image.colour[..., :3]))
        frame.tell(f"noisy{count}", count, image.seconds)


def evenly(count: int, dimensions: int) -> np.ndarray:
    """Return points spread evenly over the unit cube, (count, dimensions): an additive recurrence.

    Notes
    -----
    Its steps are the powers of the root of x^(d+1) = x + 1, a golden ratio of more dimensions.
    """
    root = 2.0
    for _ in range(64):
        root = (1 + root) ** (1 / (dimensions + 1))
    steps = root ** -np.arange(1.0, dimensions + 1)
    return (0.5 + np.arange(1, count + 1)[:, None] * steps) % 1


def samples(frame: Frame) -> None:
    """Render through many points of the lens, at many times, and give each pixel some of them at random."""
    points = evenly(N_VIEWS, 5)
    radius, angle = np.sqrt(points[:, 0]), 2 * np.pi * points[:, 1]
    lens = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1).astype(np.float16)
    times = ((points[:, 2] - 0.5) * frame.shot.shutter).astype(np.float16)
    offsets = (points[:, 3:] - 0.5).astype(np.float16)
    height, width = frame.shot.shape(frame.width)
    chance = np.random.default_rng(1).random((height, width, N_VIEWS), np.float32)
    taken = np.argsort(chance, axis=2)[..., :SAMPLES_OF_A_PIXEL]
    found = {
        "lens.u": lens[taken, 0],
        "lens.v": lens[taken, 1],
        "time": times[taken],
        "offset.x": offsets[taken, 0],
        "offset.y": offsets[taken, 1],
    }
    rendered = {name: np.zeros(taken.shape, np.float32) for name in ("R", "G", "B", "Z", "motion.x", "motion.y")}
    seconds, lit = 0.0, frame.shot.light_samples
    for view in range(N_VIEWS):
        frame.renderer.look_through(*map(float, lens[view]), tuple(map(float, offsets[view])))
        image = frame.renderer.render(lit, points=True, time_frames=float(times[view]), seed=view)
        motion = motion_at_frame(image.vectors, float(times[view]))
        values = (*np.moveaxis(image.colour[..., :3], -1, 0), image.depth, *np.moveaxis(motion, -1, 0))
        here = taken == view
        for name, each in zip(rendered, values, strict=True):
            rendered[name][here] = np.broadcast_to(each[..., None], here.shape)[here]
        seconds += image.seconds
    frame.renderer.look_through(0.0, 0.0, (0.0, 0.0))
    write_samples(frame.path("samples"), rendered | found)
    frame.tell("samples", lit * N_VIEWS, seconds)


PARTS: dict[str, Callable[[Frame], None]] = {
    "pinhole": pinhole,
    "layers": layers,
    "references": references,
    "noisy": noisy,
    "samples": samples,
}


def main() -> None:
    """Render what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", choices=SCENES)
    parser.add_argument("--size", type=int, default=512, help="width of the image, px (default: 512)")
    parser.add_argument("-o", "--out", type=Path, default=Path("frames"), help="folder (default: frames)")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS), help="default: all")
    parser.add_argument("--effort", type=float, default=1.0, help="multiplies numbers of samples (default: 1)")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    frame = Frame(given.scene, given.size, given.out, given.effort)
    for part in given.parts:
        PARTS[part](frame)


if __name__ == "__main__":
    main()

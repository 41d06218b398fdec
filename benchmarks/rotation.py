"""Curved motion: a turning propeller against a supersampled reference, with curved and with straight paths.

    python benchmarks/rotation.py [--size 192]

The scene is drawn by this script: striped blades on a striped disc, turning about their centre before a still, textured
background. The pinhole frame carries the exact vectors to the previous and to the next frame. The reference is the mean
of 256 times in the shutter, which is open for half a frame, of 3 x 3 samples in each pixel. Columns: SSIM with
``curved`` paths, which use both vectors, and with ``straight`` ones along their mean, as of a frame that carries one
vector; the gain. ``layered``: the background behind the propeller is in the input; ``blurred``: the same, everything
out of focus by 3 px; ``single``: one layer; ``1 sample``, ``4 samples``: stochastic samples in each pixel, each at a
time of its own, with the vectors of what it met. Writes rotation.txt, rotation.png (the figure) and
rotation_pictures.png (layered, 60 degrees: curved, straight, the reference, 4 times the difference of the first) to
benchmarks/results.
"""

import argparse

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scenes import RESULTS, Report, save_pictures
from scipy import signal

import spreadlets as sp

DEGREES = (10, 20, 30, 45, 60, 90)
"""Rotation per frame."""
SAMPLES = (1, 4)
"""Stochastic samples in a pixel."""
TIMES = 256
SUPERSAMPLING = 3
BLUR = 3.0
"""CoC radius of the blurred scene, px."""
NEAR, FAR = 4.0, 8.0
"""Depths of the propeller and of the background, metres."""
SHOWN = 60
WHITE, RED, BLUE = (0.9, 0.9, 0.85), (0.75, 0.08, 0.05), (0.05, 0.15, 0.6)


def background(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the colour (..., 3) of the background; places are in units of half the image."""
    rng = np.random.default_rng(0)
    value = np.zeros(x.shape)
    for frequency in (3, 5, 9, 14):
        angle, phase = rng.uniform(0, np.pi), rng.uniform(0, 2 * np.pi)
        value += np.sin(frequency * (x * np.cos(angle) + y * np.sin(angle)) * np.pi + phase)
    return (0.22 + 0.04 * value)[..., None] * np.array([1.0, 0.9, 0.7])


def propeller(radius: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return the premultiplied colour and alpha (..., 4) of the propeller at polar coordinates of its own."""
    blade = (np.abs(np.mod(angle, 2 * np.pi / 3) - np.pi / 3) < 0.35) & (radius < 0.85)
    disc = radius < 0.45
    first = np.where(disc, np.mod(angle * 9 / (2 * np.pi), 1) < 0.5, np.mod(radius * 12, 1) < 0.5)
    colours = np.array([(*RED, 1.0), (*WHITE, 1.0), (*BLUE, 1.0), (0.0, 0.0, 0.0, 0.0)])
    number = np.where(first, 1, np.where(disc, 2, 0))
    return colours[np.where(blade | disc, number, 3)]


def places(size: int, per_pixel: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the places (x, y) of the samples of all pixels, in units of half the image."""
    inside = (np.arange(per_pixel) + 0.5) / per_pixel
    centre = np.arange(size)
    grids = [np.meshgrid(centre + dx, centre + dy) for dy in inside for dx in inside]
    return [(x / (size / 2) - 1, y / (size / 2) - 1) for x, y in grids]


def drawn(size: int, turns: np.ndarray, per_pixel: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean of the propeller (H, W, 4) over some angles, radians, and the background (H, W, 3)."""
    nearer, farther = np.zeros((size, size, 4)), np.zeros((size, size, 3))
    for x, y in places(size, per_pixel):
        radius, angle = np.hypot(x, y), np.arctan2(y, x)
        farther += background(x, y)
        for turn in turns:
            nearer += propeller(radius, angle - turn)
    return nearer / (len(turns) * per_pixel**2), farther / per_pixel**2


def reference(size: int, degrees: float, shutter: tuple[float, float]) -> np.ndarray:
    """Return what is seen while the shutter is open: the propeller's mean over the background."""
    times = shutter[0] + (np.arange(TIMES) + 0.5) / TIMES * (shutter[1] - shutter[0])
    nearer, farther = drawn(size, np.deg2rad(degrees) * times, SUPERSAMPLING)
    return nearer[..., :3] + (1 - nearer[..., 3:]) * farther


def motion(size: int, degrees: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the vectors (H, W, 2), px, of the propeller from the previous frame and to the next."""
    return vectors_at(np.stack(places(size, 1)[0], axis=-1) * (size / 2), degrees)


def vectors_at(offset: np.ndarray, degrees: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the vectors, px, at some places (..., 2), px from the propeller's middle."""
    cos, sin = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    turn = np.array([[cos, -sin], [sin, cos]])
    return offset - offset @ turn, offset @ turn.T - offset


def frames(size: int, degrees: float) -> dict[str, dict[str, sp.Frame]]:
    """Return the pinhole frames: layered and single, each with curved and straight paths."""
    nearer, farther = drawn(size, np.zeros(1), SUPERSAMPLING)
    previous, following = motion(size, degrees)
    near, far = np.full((size, size), NEAR), np.full((size, size), FAR)
    behind = sp.Frame(farther, far, np.zeros((size, size, 2)))
    alpha = nearer[..., 3:]
    single = nearer[..., :3] + (1 - alpha) * farther
    seen = alpha > 0.5
    paths = {
        "curved": {"motion_prev": previous, "motion_next": following},
        "straight": {"motion": 0.5 * (previous + following)},
    }
    made: dict[str, dict[str, sp.Frame]] = {"layered": {}, "single": {}}
    for name, vectors in paths.items():
        masked = {label: np.where(seen, values, 0) for label, values in vectors.items()}
        made["layered"][name] = sp.Frame.from_layers([sp.Frame(nearer, near, **vectors), behind])
        made["single"][name] = sp.Frame(single, np.where(seen[..., 0], NEAR, FAR), **masked)
    return made


def samples(size: int, degrees: float, count: int, shutter: tuple[float, float]) -> dict[str, sp.SampleBuffer]:
    """Return a buffer of stochastic samples, with curved and with straight paths."""
    rng, shape = np.random.default_rng(0), (size, size, count)
    time, offset = rng.uniform(*shutter, shape), rng.uniform(-0.5, 0.5, (*shape, 2))
    centre = np.stack(np.meshgrid(np.arange(size), np.arange(size)), axis=-1)[:, :, None] + 0.5
    x, y = np.moveaxis((centre + offset) / (size / 2) - 1, -1, 0)
    # What a sample meets at its time lies, at the frame's, where that part of the propeller is then.
    radius, angle = np.hypot(x, y), np.arctan2(y, x) - np.deg2rad(degrees) * time
    met = propeller(radius, angle)
    seen, still = met[..., 3:] > 0, np.zeros((*shape, 2))
    colour = np.where(seen, met[..., :3], background(x, y))
    place = radius[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1) * (size / 2)
    previous, following = (np.where(seen, vectors, 0) for vectors in vectors_at(place, degrees))
    paths = {
        "curved": {"motion": 0.5 * (previous + following), "motion_prev": previous, "motion_next": following},
        "straight": {"motion": 0.5 * (previous + following)},
    }
    depth = np.where(seen[..., 0], NEAR, FAR)
    given = {"radiance": colour, "depth": depth, "lens_uv": still, "time": time, "offset": offset}
    return {name: sp.SampleBuffer(**given, **vectors) for name, vectors in paths.items()}


def disc(radius: float) -> np.ndarray:
    """Return the PSF of a lens, 8 x 8 samples in each pixel."""
    half = int(np.ceil(radius))
    side = np.arange(-half - 0.5 + 1 / 16, half + 0.5, 1 / 8)
    covered = np.hypot(*np.meshgrid(side, side)) < radius
    psf = covered.reshape(2 * half + 1, 8, 2 * half + 1, 8).mean(axis=(1, 3))
    return psf / psf.sum()


def blurred(image: np.ndarray, radius: float) -> np.ndarray:
    """Return an image out of focus; beyond its border it is mirrored."""
    psf = disc(radius)
    channels = [signal.convolve2d(image[..., c], psf, mode="same", boundary="symm") for c in range(3)]
    return np.stack(channels, axis=-1)


def defocused(frame: sp.Frame) -> sp.Frame:
    """Return the layers of a frame, all at the same depth."""
    depth = np.full(frame.shape, NEAR)
    return sp.Frame.from_layers(
        [
            sp.Frame(layer.radiance, depth, layer.motion, motion_prev=layer.motion_prev, motion_next=layer.motion_next)
            for layer in frame.layers
        ]
    )


def camera_for(size: int) -> sp.ThinLens:
    """Return a camera that is out of focus at the propeller by `BLUR`."""
    camera = sp.ThinLens(focal_length_mm=50, sensor_width_mm=36, f_number=1.0, focus_distance_m=2 * NEAR)
    return sp.ThinLens(50, 36, abs(float(camera.coc_radius(NEAR, size))) / BLUR, 2 * NEAR)


def measure(size: int, degrees: float, database: sp.Database, report: Report) -> dict[str, float]:
    """Add the rows of one speed and return the gains of curved paths."""
    camera, gains = camera_for(size), {}
    truth = reference(size, degrees, camera.shutter)
    made = frames(size, degrees)
    cases = {name: (made[name], truth, False) for name in ("layered", "single")}
    cases["blurred"] = ({name: defocused(f) for name, f in made["layered"].items()}, blurred(truth, BLUR), True)
    for case, (given, expected, defocus) in cases.items():
        images = {name: sp.synthesize(frame, camera, database, defocus=defocus) for name, frame in given.items()}
        found = {name: sp.metrics.ssim(image, expected) for name, image in images.items()}
        gains[case] = found["curved"] - found["straight"]
        report.row(f"{degrees} degrees per frame, {case}", found["curved"], found["straight"], gains[case], first=34)
        if degrees == SHOWN and case == "layered":
            save_pictures(RESULTS / "rotation_pictures.png", list(images.values()), expected, shrink=1)
    for count in SAMPLES:
        buffers = samples(size, degrees, count, camera.shutter)
        found = {
            name: sp.metrics.ssim(sp.reconstruct(each, camera, database, defocus=False), truth)
            for name, each in buffers.items()
        }
        case = f"{count} sample{'s' if count > 1 else ''}"
        gains[case] = found["curved"] - found["straight"]
        report.row(f"{degrees} degrees per frame, {case}", found["curved"], found["straight"], gains[case], first=34)
    return gains


def draw(gains: list[dict[str, float]]) -> None:
    """Draw the gain of curved paths against the speed."""
    figure, axis = plt.subplots(figsize=(5, 3.3), layout="constrained")
    for case in gains[0]:
        axis.plot(DEGREES, [each[case] for each in gains], "-o", label=case)
    axis.axhline(0, color="k", linestyle=":")
    axis.set(xlabel="degrees per frame", ylabel="SSIM, curved - straight")
    axis.legend()
    figure.savefig(RESULTS / "rotation.png", dpi=80)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=192)
    size = parser.parse_args().size
    report = Report()
    report.row("", "curved", "straight", "gain", first=34)
    with sp.open_database("combined") as database:
        gains = [measure(size, degrees, database, report) for degrees in DEGREES]
    report.save("rotation.txt")
    draw(gains)


if __name__ == "__main__":
    main()

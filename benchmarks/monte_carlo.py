"""Fog and bokeh of any shape against a Monte Carlo that shares nothing with the product but the metrics.

    python benchmarks/monte_carlo.py [--paths 2048] [--lamp-paths 16000000] [--lens-points 512] [--seed 0]

A small scene is drawn: a disc, a turned board, a wall of which half is dark, and lamps among them. What a camera sees
of it is estimated twice, from different random numbers. The truth is their mean; how well the two agree, its noise.

Through the heart (`stylized`), each pixel looks through points of the lens, which are as dense as docs/models/heart.png
is bright, and sees the first surface on its way. Lamps send their light through such points to the pixels, if nothing
is in its way.

In fog (`volume`), a path from each pixel is scattered until it meets a surface. Paths from the lamps are scattered,
too, and shine at the camera from wherever that happens. The model says of itself that it leaves two things to the
compositor (docs/models.md), so that they are taken from the truth: light from beyond the radius of the PSF, and how
much darker a white plane looks at its distance. What the fog really looks like, scaled to the brightness of the image,
is given as "all light".

Each frame is drawn with the database that ships, of all its layers and of the one that a renderer gives. Light is that
of the image over that of the truth. Single pixels are compared by themselves: their similarity, in fog without the
pixel itself, next to which nothing else would count; the share of light less than 16 px away, in fog of what is not in
the pixel, and what is in it; how far red is from blue, px, or how much blue there is to red.

Takes some three minutes of processor time. Writes monte_carlo.txt and monte_carlo.png to benchmarks/results. The
picture shows the frame, the truth, the image of all layers and of one, and four times the difference of the first:
above through the heart, below in fog.
"""

# ruff: noqa: NPY002 (compiled loops have no other random numbers)

import argparse
import math
import warnings
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
from PIL import Image
from scenes import DIFFERENCE_GAIN, DIFFERENCE_LEVELS, Report, result_path
from scipy import ndimage
from scipy.interpolate import CubicSpline

import spreadlets as sp
from spreadlets.scene.display import display_encode

SIDE, MARGIN, FINE = 192, 128, 4
"""Pixels of the judged image and around it, which is what fog spreads light over; samples of a pixel along an axis."""
WHOLE = SIDE + 2 * MARGIN
FOCAL_PX = 50.0 / 36.0 * 512
"""Focal length of the database of fog, which is made for frames of 512 px."""
DEPTHS = np.array([0.9, 1.8, 3.6])
"""Metres: disc, board, wall."""
FOCUS, F_NUMBER = 1.8, 0.5
"""CoC radii of 20, 0 and 10 px."""
CAMERA = sp.ThinLens(
    focal_length_mm=50.0, sensor_width_mm=36.0 * WHOLE / 512, f_number=F_NUMBER, focus_distance_m=FOCUS
)

HEART = Path(__file__).resolve().parent.parent / "docs" / "models" / "heart.png"
COLOUR_OFFSET = 0.06
"""Radii by which red is to the right and blue to the left."""

DENSITY, ANISOTROPY, ALBEDO = 0.9, 0.8, np.array([1.0, 1.0, 0.9])
"""Of the fog: collisions per metre, mean cosine of the scattering angle, light that is kept."""
RADIUS_PX = 128.0
"""Where the PSFs of the database of fog end."""

TINTS = np.array(
    [
        ((0.7, 0.25, 0.1), (0.1, 0.05, 0.03)),
        ((0.15, 0.5, 0.6), (0.5, 0.5, 0.1)),
        ((0.3, 0.4, 0.6), (0.08, 0.06, 0.04)),
    ]
)
"""The two colours of each layer."""
DARK = 0.004
"""Of half of the wall."""
SURFACE, LAMP = 1, 2
"""What there is at a place of a layer, beside nothing."""
LAMPS = np.array(
    [
        # layer, x and y of the centre and radius in px, R, G, B
        (0, 46.0, 62.0, 2.0, 30.0, 24.0, 15.0),
        (1, 62.0, -6.0, 2.0, 12.0, 12.0, 14.0),
        (2, 22.0, -58.0, 2.5, 60.0, 50.0, 40.0),
        (2, 68.0, -70.0, 2.0, 25.0, 40.0, 60.0),
        (2, 78.0, 36.0, 2.0, 60.0, 25.0, 15.0),
    ]
)
NEAR, NEAREST, BLOCK = 0.4, 0.04, 16
"""Shares of a lamp's depth. What fog scatters nearer to the camera than the first is smooth on the screen, and noisy:
it is counted in blocks of pixels. Nearer than the second, fog is taken to be as bright as it is from there to twice as
far."""
PARTS = 64
"""Of the paths, for threads; each has random numbers of its own."""
LEAST_Z, MOST_ASIDE = -1.5, 4.0
"""Metres from the camera at which a path is given up: what comes back from there is less than the noise."""
MOST_COLLISIONS = 200
LAMP_POINTS = 1_000_000
"""Of each lamp, through the lens."""
PIXEL_POINTS = 4_000_000
"""Of a single pixel, through the lens."""
AXIS_PATHS = 4_000_000
"""Of a single pixel in fog."""
PIXEL_COCS = (6.0, 12.0, -12.0, -24.0)
"""CoC radii, px, of single pixels; negative before the focus."""
NEAR_PX = 16
"""Radius of what is near a pixel."""


# --- The scene -------------------------------------------------------------------------------------------------------


class Drawn(NamedTuple):
    """The scene: layers from near to far, at `FINE` samples of a pixel along an axis.

    Attributes
    ----------
    kind : ndarray of shape (3, n, n), uint8
        0 for nothing, `SURFACE` or `LAMP`.
    colour : ndarray of shape (3, n, n, 3), float32
    """

    kind: np.ndarray
    colour: np.ndarray


def draw_scene() -> Drawn:
    """Draw the layers."""
    n = WHOLE * FINE
    y, x = (np.mgrid[:n, :n] + 0.5) / FINE - 0.5 * WHOLE
    kind, colour = np.zeros((3, n, n), np.uint8), np.zeros((3, n, n, 3), np.float32)
    # A disc with rings, a turned board of squares, a wall of stripes.
    along, across, away = 0.9 * x + 0.436 * y, 0.9 * y - 0.436 * x, np.hypot(x + 48, y + 44)
    inside = away < 26, (np.abs(along + 12) < 40) & (np.abs(across - 42) < 24), np.ones((n, n), np.bool_)
    pattern = (
        0.5 + 0.5 * np.cos(0.9 * away),
        (along // 8 + across // 8) % 2,
        0.5 + 0.25 * np.sin(0.35 * x + 0.1 * y) + 0.25 * np.sin(0.3 * y),
    )
    for layer, (one, other) in enumerate(TINTS):
        colour[layer] = other + pattern[layer][..., None] * (one - other)
        kind[layer][inside[layer]] = SURFACE
    colour[2][x > 0] = DARK
    for layer, at_x, at_y, radius, *light in LAMPS:
        lit = np.hypot(x - at_x, y - at_y) < radius
        # As much light as that of a disc, however many samples it has.
        share = math.pi * (radius * FINE) ** 2 / np.count_nonzero(lit)
        kind[int(layer)][lit], colour[int(layer)][lit] = LAMP, share * np.array(light)
    return Drawn(kind, colour)


def to_pixels(fine: np.ndarray) -> np.ndarray:
    """Return the means of pixels."""
    return fine.reshape(WHOLE, FINE, WHOLE, FINE, -1).mean(axis=(1, 3))


def frames(drawn: Drawn) -> dict[str, sp.Frame]:
    """Return the frame in its layers, and as a renderer gives it: colours of pixels, the depth of their middles."""
    covered = drawn.kind > 0
    layers = [
        to_pixels(np.dstack([colour * some[..., None], some]))
        for colour, some in zip(drawn.colour, covered, strict=True)
    ]
    flat = layers[2]
    for layer in layers[1::-1]:
        flat = layer + (1.0 - layer[..., 3:]) * flat
    middle = covered[:, FINE // 2 :: FINE, FINE // 2 :: FINE]
    depth = DEPTHS[np.argmax(middle, axis=0)]
    stacked = [(layer, np.full((WHOLE, WHOLE), each)) for layer, each in zip(layers, DEPTHS, strict=True)]
    return {"in layers": sp.Frame.from_layers(stacked), "in one layer": sp.Frame(flat, depth)}


def inner(image: np.ndarray) -> np.ndarray:
    """Return what is judged of an image."""
    return np.asarray(image[MARGIN:-MARGIN, MARGIN:-MARGIN, :3])


@numba.njit
def look_up(kind, layer, x, y):
    """Return what there is at a place (px from the middle) of a layer, and its row and column; nothing beyond."""
    row, col = int(math.floor((y + 0.5 * WHOLE) * FINE)), int(math.floor((x + 0.5 * WHOLE) * FINE))
    if min(row, col) < 0 or max(row, col) >= WHOLE * FINE:
        return 0, 0, 0
    return kind[layer, row, col], row, col


# --- Through the heart -----------------------------------------------------------------------------------------------


class Aperture(NamedTuple):
    """An image as the density of points of the lens.

    Attributes
    ----------
    steps : ndarray of shape (3, h * w), float64
        Sums of the light up to each sample, as a share of all, of each channel.
    width : int
    radius : float
        Samples of the image from its middle to the farther border: the unit of the lens.
    middle : ndarray of shape (2,), float64
        Column and row of the image's middle.
    """

    steps: np.ndarray
    width: int
    radius: float
    middle: np.ndarray


def read_aperture() -> Aperture:
    """Read the heart: its light is linear, and as much of it as its alpha says."""
    pixels = np.asarray(Image.open(HEART).convert("RGBA"), np.float64) / 255.0
    colours = pixels[..., :3]
    light = np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4) * pixels[..., 3:]
    height, width = light.shape[:2]
    steps = np.cumsum(light.reshape(-1, 3), axis=0).T
    middle = 0.5 * (np.array([width, height]) - 1.0)
    return Aperture(steps / steps[:, -1:], width, 0.5 * max(width, height), middle)


@numba.njit
def lens_point(aperture, channel, share):
    """Return a point of the lens for a channel, at a share of its light; between samples of the image it is linear."""
    at = np.searchsorted(aperture.steps[channel], share)
    col = at % aperture.width + np.random.random() + np.random.random() - 1.0 - aperture.middle[0]
    row = at // aperture.width + np.random.random() + np.random.random() - 1.0 - aperture.middle[1]
    return col / aperture.radius + COLOUR_OFFSET * (1 - channel), row / aperture.radius


@numba.njit(parallel=True)
def gather(kind, colour, cocs, aperture, count, seed):
    """Return what each pixel sees of the surfaces through the lens, (SIDE, SIDE, 3); lamps are dark."""
    out = np.zeros((SIDE, SIDE, 3))
    for row in numba.prange(SIDE):
        np.random.seed(seed + row)
        for col in range(SIDE):
            for channel in range(3):
                for number in range(count):
                    u, v = lens_point(aperture, channel, (number + np.random.random()) / count)
                    x, y = col - 0.5 * SIDE + np.random.random(), row - 0.5 * SIDE + np.random.random()
                    for layer in range(len(cocs)):
                        what, i, j = look_up(kind, layer, x - cocs[layer] * u, y - cocs[layer] * v)
                        if what == SURFACE:
                            out[row, col, channel] += colour[layer, i, j, channel] / count
                        if what:
                            break
    return out


@numba.njit
def scatter(kind, cocs, aperture, lamp, count, seed):
    """Return the light of a lamp in each pixel, (SIDE, SIDE, 3), as far as nothing is in its way."""
    np.random.seed(seed)
    out, layer = np.zeros((SIDE, SIDE, 3)), int(lamp[0])
    for channel in range(3):
        for number in range(count):
            u, v = lens_point(aperture, channel, (number + np.random.random()) / count)
            away, turn = lamp[3] * math.sqrt(np.random.random()), 2.0 * math.pi * np.random.random()
            x = lamp[1] + away * math.cos(turn) + cocs[layer] * u
            y = lamp[2] + away * math.sin(turn) + cocs[layer] * v
            row, col = int(math.floor(y + 0.5 * SIDE)), int(math.floor(x + 0.5 * SIDE))
            hidden = False
            for nearer in range(layer):
                hidden = hidden or look_up(kind, nearer, x - cocs[nearer] * u, y - cocs[nearer] * v)[0] > 0
            if not hidden and 0 <= row < SIDE and 0 <= col < SIDE:
                out[row, col, channel] += lamp[4 + channel] * math.pi * lamp[3] ** 2 / count
    return out


def heart_truth(drawn: Drawn, aperture: Aperture, count: int, seed: int) -> np.ndarray:
    """Return what the camera sees through the heart, which is upright on both sides of the focus."""
    cocs = np.abs(CAMERA.coc_scale(WHOLE) * (1.0 / FOCUS - 1.0 / DEPTHS))
    image = gather(drawn.kind, drawn.colour, cocs, aperture, count, seed)
    for number, lamp in enumerate(LAMPS):
        image += scatter(drawn.kind, cocs, aperture, lamp, LAMP_POINTS, seed + SIDE + number)
    return image


def heart_of_a_pixel(aperture: Aperture, coc: float, seed: int) -> np.ndarray:
    """Return the image (2 * MARGIN + 1, 2 * MARGIN + 1, 3) of a point in the middle of its middle pixel."""
    rng, side = np.random.default_rng(seed), 2 * MARGIN + 1
    planes = []
    for channel, steps in enumerate(aperture.steps):
        at = np.searchsorted(steps, (np.arange(PIXEL_POINTS) + rng.random(PIXEL_POINTS)) / PIXEL_POINTS)
        places = np.stack([at % aperture.width, at // aperture.width], axis=1) - aperture.middle
        places = (places + rng.random((PIXEL_POINTS, 2)) + rng.random((PIXEL_POINTS, 2)) - 1.0) / aperture.radius
        x, y = (abs(coc) * (places + [COLOUR_OFFSET * (1 - channel), 0.0])).T
        edges = np.arange(side + 1) - 0.5 * side
        planes.append(np.histogram2d(y, x, bins=(edges, edges))[0] / PIXEL_POINTS)
    return np.stack(planes, axis=-1)


# --- In fog ----------------------------------------------------------------------------------------------------------


def scattering_cosines(count: int = 1 << 16) -> np.ndarray:
    """Return cosines of the scattering angle at even steps of probability, by summing the phase function up.

    Its law is that of Henyey and Greenstein (1941): ``(1 - g^2) / (1 + g^2 - 2 g c)^1.5 / 2``.
    """
    cosine = -np.cos(np.linspace(0.0, np.pi, 8 * count + 1))
    density = (1.0 + ANISOTROPY**2 - 2.0 * ANISOTROPY * cosine) ** -1.5
    total = np.append(0.0, np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(cosine)))
    return np.interp((np.arange(count) + 0.5) / count, total / total[-1], cosine)


@numba.njit
def turned(x, y, z, cosine):
    """Return a direction at this angle from another, anywhere around it."""
    sine, turn = math.sqrt(max(0.0, 1.0 - cosine * cosine)), 2.0 * math.pi * np.random.random()
    # Two directions across: one level, one that is across both.
    if abs(z) < 0.9:
        length = math.hypot(x, y)
        ax, ay, az = -y / length, x / length, 0.0
    else:
        length = math.hypot(y, z)
        ax, ay, az = 0.0, -z / length, y / length
    bx, by, bz = y * az - z * ay, z * ax - x * az, x * ay - y * ax
    a, b = sine * math.cos(turn), sine * math.sin(turn)
    return cosine * x + a * ax + b * bx, cosine * y + a * ay + b * by, cosine * z + a * az + b * bz


@numba.njit
def first_surface(kind, x, y, z, dx, dy, dz, reach):
    """Return the distance of what a ray meets first before a reach, or -1; its layer; row and column there."""
    for step in range(len(DEPTHS)):
        layer = step if dz > 0.0 else len(DEPTHS) - 1 - step
        away = (DEPTHS[layer] - z) / dz if dz != 0.0 else -1.0
        if 1e-9 < away < reach:
            scale = FOCAL_PX / DEPTHS[layer]
            what, i, j = look_up(kind, layer, (x + away * dx) * scale, (y + away * dy) * scale)
            if what or layer == len(DEPTHS) - 1:
                return away, layer, i, j
    return -1.0, 0, 0, 0


@numba.njit
def is_astray(x, y, z):
    """Return whether a path has gone so far that it hardly comes back."""
    return z < LEAST_Z or max(abs(x), abs(y)) > MOST_ASIDE


@numba.njit
def at_distance(gains, x, y, z):
    """Return what makes a white plane white at the distance of a place, from a table of steps of 1/16 m."""
    at = 16.0 * math.sqrt(x * x + y * y + z * z)
    low = min(int(at), len(gains) - 2)
    return gains[low] + (at - low) * (gains[low + 1] - gains[low])


@numba.njit
def walk(kind, colour, gains, cosines, pixel, out):
    """Follow a path from a pixel (x, y) through fog, and add the light of surfaces that it finds to ``out`` (2, 3)."""
    length = math.sqrt(pixel[0] ** 2 + pixel[1] ** 2 + FOCAL_PX**2)
    x, y, z, dx, dy, dz = 0.0, 0.0, 0.0, pixel[0] / length, pixel[1] / length, FOCAL_PX / length
    # Add what is seen straight on, lamps too; the rest of the light is scattered before that.
    away, layer, i, j = first_surface(kind, x, y, z, dx, dy, dz, 1e9)
    straight = math.exp(-DENSITY * away)
    out[0] += straight * at_distance(gains, away * dx, away * dy, away * dz) * colour[layer, i, j]
    out[1] += straight * colour[layer, i, j]
    step = -math.log(1.0 - (1.0 - straight) * np.random.random()) / DENSITY
    weight = np.full(3, 1.0 - straight)
    for _ in range(MOST_COLLISIONS):
        # Go to the collision, and on in another direction until the next one or a surface.
        x, y, z = x + step * dx, y + step * dy, z + step * dz
        weight *= ALBEDO
        dx, dy, dz = turned(dx, dy, dz, cosines[int(np.random.random() * len(cosines))])
        step = -math.log(1.0 - np.random.random()) / DENSITY
        away, layer, i, j = first_surface(kind, x, y, z, dx, dy, dz, step)
        if away > 0.0:
            if dz > 0.0 and kind[layer, i, j] == SURFACE:
                x, y, z = x + away * dx, y + away * dy, z + away * dz
                weight *= colour[layer, i, j]
                out[1] += weight
                if math.hypot(x * FOCAL_PX / z - pixel[0], y * FOCAL_PX / z - pixel[1]) < RADIUS_PX:
                    out[0] += at_distance(gains, x, y, z) * weight
            return
        if is_astray(x + step * dx, y + step * dy, z + step * dz):
            return


@numba.njit(parallel=True)
def walk_from_pixels(kind, colour, gains, cosines, count, seed):
    """Return the surfaces in fog, (SIDE, SIDE, 2, 3): what the model draws, and all light."""
    out = np.zeros((SIDE, SIDE, 2, 3))
    for row in numba.prange(SIDE):
        np.random.seed(seed + row)
        for col in range(SIDE):
            for _ in range(count):
                pixel = col - 0.5 * SIDE + np.random.random(), row - 0.5 * SIDE + np.random.random()
                walk(kind, colour, gains, cosines, pixel, out[row, col])
    return out / count


@numba.njit
def show(kind, place, direction, light, depth, image, near):
    """Add what a place scatters to the camera of a lamp's light (3,), if the camera sees it, to one of two images."""
    x, y, z = place
    distance = math.sqrt(x * x + y * y + z * z)
    if z <= 0.0 or max(abs(x), abs(y)) * FOCAL_PX >= 0.5 * SIDE * z or distance < NEAREST * depth:
        return
    dx, dy, dz = x / distance, y / distance, z / distance
    if first_surface(kind, 0.0, 0.0, 0.0, dx, dy, dz, distance)[0] > 0.0:
        return
    cosine, g = -dx * direction[0] - dy * direction[1] - dz * direction[2], ANISOTROPY
    phase = (1.0 - g * g) / (4.0 * math.pi * (1.0 + g * g - 2.0 * g * cosine) ** 1.5)
    # The solid angle of a pixel is cos^3 / FOCAL_PX^2.
    share = phase * math.exp(-DENSITY * distance) / distance**2 * FOCAL_PX**2 / dz**3
    if distance < 2.0 * NEAREST * depth:
        share *= 1.0 + math.exp(DENSITY * NEAREST * depth)
    row, col = int(y * FOCAL_PX / z + 0.5 * SIDE), int(x * FOCAL_PX / z + 0.5 * SIDE)
    if distance < NEAR * depth:
        near[row // BLOCK, col // BLOCK] += share / BLOCK**2 * light
    else:
        image[row, col] += share * light


@numba.njit(parallel=True)
def walk_from_lamp(kind, lamp, cosines, count, seed):
    """Return the scattered light of a lamp, in pixels (SIDE, SIDE, 3), and in blocks that of near the camera."""
    images, nears = np.zeros((PARTS, SIDE, SIDE, 3)), np.zeros((PARTS, SIDE // BLOCK, SIDE // BLOCK, 3))
    depth, scale = DEPTHS[int(lamp[0])], DEPTHS[int(lamp[0])] / FOCAL_PX
    for part in numba.prange(PARTS):
        np.random.seed(seed + part)
        for _ in range(count // PARTS):
            # Begin anywhere on the lamp, in any direction by the cosine law.
            away, turn = lamp[3] * math.sqrt(np.random.random()), 2.0 * math.pi * np.random.random()
            x, y, z = (lamp[1] + away * math.cos(turn)) * scale, (lamp[2] + away * math.sin(turn)) * scale, depth
            sine, turn = math.sqrt(np.random.random()), 2.0 * math.pi * np.random.random()
            dx, dy, dz = sine * math.cos(turn), sine * math.sin(turn), -math.sqrt(1.0 - sine * sine)
            light = lamp[4:] * (math.pi * math.pi * (lamp[3] * scale) ** 2 / (count // PARTS * PARTS))
            for _ in range(MOST_COLLISIONS):
                step = -math.log(1.0 - np.random.random()) / DENSITY
                if first_surface(kind, x, y, z, dx, dy, dz, step)[0] > 0.0:
                    break
                x, y, z = x + step * dx, y + step * dy, z + step * dz
                if is_astray(x, y, z):
                    break
                light *= ALBEDO
                show(kind, (x, y, z), (dx, dy, dz), light, depth, images[part], nears[part])
                dx, dy, dz = turned(dx, dy, dz, cosines[int(np.random.random() * len(cosines))])
    return images.sum(axis=0), nears.sum(axis=0)


@numba.njit(parallel=True)
def walk_axis(distance, cosines, count, seed):
    """Return where a pixel on the axis gets its scattered light from, of a plane at a distance, as shares of all.

    Returns
    -------
    ndarray of shape (2 * RADIUS_PX + 1, 2 * RADIUS_PX + 1, 3), float64
    """
    half = int(RADIUS_PX)
    out = np.zeros((PARTS, 2 * half + 1, 2 * half + 1, 3))
    straight = math.exp(-DENSITY * distance)
    for part in numba.prange(PARTS):
        np.random.seed(seed + part)
        for _ in range(count // PARTS):
            x, y, z, dx, dy, dz, weight = 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, np.ones(3)
            step = -math.log(1.0 - (1.0 - straight) * np.random.random()) / DENSITY
            for _ in range(MOST_COLLISIONS):
                x, y, z = x + step * dx, y + step * dy, z + step * dz
                weight *= ALBEDO
                dx, dy, dz = turned(dx, dy, dz, cosines[int(np.random.random() * len(cosines))])
                step = -math.log(1.0 - np.random.random()) / DENSITY
                if z + step * dz >= distance:
                    away = (distance - z) / dz
                    px, py = (x + away * dx) * FOCAL_PX / distance, (y + away * dy) * FOCAL_PX / distance
                    if math.hypot(px, py) < RADIUS_PX:
                        out[part, int(round(py)) + half, int(round(px)) + half] += weight
                    break
                if is_astray(x + step * dx, y + step * dy, z + step * dz):
                    break
    return out.sum(axis=0) * ((1.0 - straight) / (count // PARTS * PARTS))


def fog_of_a_pixel(distance: float, cosines: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Return the PSF of a distance, as shares of the light that comes from there."""
    psf = walk_axis(distance, cosines, count, seed)
    psf[int(RADIUS_PX), int(RADIUS_PX)] += math.exp(-DENSITY * distance)
    return psf


def gains_of_distances(cosines: np.ndarray, seed: int) -> np.ndarray:
    """Return what makes a white plane white, at distances in steps of 1/16 m up to more than the wall's."""
    known = np.array([0.5, 0.9, 1.4, 1.8, 2.4, 3.0, 3.6, 4.0])
    shares = [fog_of_a_pixel(each, cosines, AXIS_PATHS // 8, seed).sum(axis=(0, 1)).mean() for each in known]
    return np.asarray(np.exp(-CubicSpline(known, np.log(shares))(np.arange(65) / 16.0)))


def fog_truth(drawn: Drawn, gains: np.ndarray, cosines: np.ndarray, counts: tuple[int, int], seed: int) -> np.ndarray:
    """Return what a pinhole sees in fog, (2, SIDE, SIDE, 3): what the model draws of it, and all of it.

    ``counts`` are the paths of a pixel and of a lamp.
    """
    modelled, whole = np.moveaxis(walk_from_pixels(drawn.kind, drawn.colour, gains, cosines, counts[0], seed), 2, 0)
    at = np.arange(SIDE) - 0.5 * (SIDE - 1)
    for number, lamp in enumerate(LAMPS):
        image, near = walk_from_lamp(drawn.kind, lamp, cosines, counts[1], seed + SIDE + PARTS * number)
        image = image + ndimage.zoom(near, (BLOCK, BLOCK, 1), order=1, mode="nearest", grid_mode=True)
        inside = np.hypot(at - lamp[1], at[:, None] - lamp[2]) < RADIUS_PX
        scale = DEPTHS[int(lamp[0])] / FOCAL_PX
        gain = at_distance(gains, lamp[1] * scale, lamp[2] * scale, DEPTHS[int(lamp[0])])
        modelled, whole = modelled + gain * inside[..., None] * image, whole + image
    return np.stack([modelled, whole])


# --- The comparison --------------------------------------------------------------------------------------------------


def places(drawn: Drawn) -> list[np.ndarray]:
    """Return where the image is judged for its light: everywhere, on the disc, on the board; (SIDE, SIDE), bool."""
    on = drawn.kind[:, FINE // 2 :: FINE, FINE // 2 :: FINE][:, MARGIN:-MARGIN, MARGIN:-MARGIN] == SURFACE
    return [np.ones((SIDE, SIDE), np.bool_), on[0], on[1]]


def figures(image: np.ndarray, truth: np.ndarray, where: list[np.ndarray]) -> list[str]:
    """Return the columns of an image; its light is that over the truth's."""
    found = sp.metrics.compare(image, truth)
    lights = [image[each].mean() / truth[each].mean() for each in where]
    numbers = found["ssim"], found["psnr"], found.get("flip", math.nan), *lights
    return [f"{number:.{digits}f}" for number, digits in zip(numbers, (4, 2, 4, 4, 4, 4), strict=True)]


def compare_frame(
    report: Report, name: str, truths: list[np.ndarray], images: dict[str, np.ndarray], where: list[np.ndarray]
) -> None:
    """Add the rows of a model: its images against the mean of two truths, and those against each other."""
    truth = np.mean(truths, axis=0)
    for kind, image in images.items():
        report.row(f"{name}, {kind}", *figures(image, truth, where))
    report.row("halves of the truth", *figures(*truths, where))


def single_pixel(database: str, depth: float) -> np.ndarray:
    """Return what becomes of one white pixel on black, (n, n, 3), as a PSF: of unit sum as the mean of channels."""
    side = 2 * MARGIN + 1
    radiance = np.zeros((side, side, 3), np.float32)
    radiance[MARGIN, MARGIN] = 1000.0
    camera = sp.ThinLens(
        focal_length_mm=50.0, sensor_width_mm=36.0 * side / 512, f_number=F_NUMBER, focus_distance_m=FOCUS
    )
    frame = sp.Frame(radiance, np.full((side, side), depth))
    return sp.synthesize(frame, camera, database)[..., :3].astype(np.float64) / 1000.0


def near_share(psf: np.ndarray, spike: bool = False) -> float:
    """Return the share of a PSF's light that is near its pixel, without the pixel if it has a spike."""
    distance = np.hypot(*(np.indices(psf.shape[:2]) - len(psf) // 2))
    light = psf.sum(axis=2) * (distance > 0 if spike else 1.0)
    return float(light[distance < NEAR_PX].sum() / light.sum())


def without_spike(psf: np.ndarray) -> np.ndarray:
    """Return a PSF whose middle pixel is as bright as those beside it."""
    rest, mid = psf.copy(), len(psf) // 2
    rest[mid, mid] = 0.25 * (psf[mid - 1, mid] + psf[mid + 1, mid] + psf[mid, mid - 1] + psf[mid, mid + 1])
    return rest


def compare_hearts(report: Report, aperture: Aperture, seed: int) -> None:
    """Add the rows of single pixels through the heart."""
    report.row("a pixel through the heart", "similarity", "of halves", "near it", "true", "red - blue", "true")
    column = np.arange(2 * MARGIN + 1) - MARGIN
    for coc in PIXEL_COCS:
        made = single_pixel("stylized", 1.0 / (1.0 / FOCUS - coc / CAMERA.coc_scale(WHOLE)))
        pair = [heart_of_a_pixel(aperture, coc, seed + half) for half in (0, 1)]
        truth = np.mean(pair, axis=0)
        similar = (sp.metrics.psf_similarity(*both) for both in ((truth, made), pair))
        # The middles of red and blue are apart by twice the offset.
        apart = [float(column @ (psf[..., 0] - psf[..., 2]).sum(axis=0)) for psf in (made, truth)]
        near = [near_share(psf) for psf in (made, truth)]
        report.row(f"CoC of {coc:g} px", *similar, *(f"{number:.3f}" for number in (*near, *apart)))


def compare_fogs(report: Report, cosines: np.ndarray, seed: int) -> None:
    """Add the rows of single pixels in fog; near it are shares of what is not in the pixel."""
    columns = "similarity", "of halves", "near it", "true", "in it", "true", "blue / red", "true"
    report.row("a pixel in fog", *columns)
    for depth in DEPTHS:
        made = single_pixel("volume", depth)
        pair = [fog_of_a_pixel(depth, cosines, AXIS_PATHS, seed + half * PARTS) for half in (0, 1)]
        pair = [psf * (3.0 / psf.sum()) for psf in pair]
        both = made, np.mean(pair, axis=0)
        halos = [without_spike(psf) for psf in (both[1], made, *pair)]
        similar = (sp.metrics.psf_similarity(*each) for each in (halos[:2], halos[2:]))
        near = [near_share(psf, spike=True) for psf in both]
        middle = [float(psf[MARGIN, MARGIN].mean()) for psf in both]
        tint = [float(halo[..., 2].sum() / halo[..., 0].sum()) for halo in (halos[1], halos[0])]
        report.row(f"at {depth:g} m", *similar, *(f"{number:.3f}" for number in (*near, *middle, *tint)))


def save_picture(rows: list[list[np.ndarray]]) -> None:
    """Save rows of images; at the end of each, by how much the third differs from the second, which is the truth."""
    shown = []
    for row in rows:
        row = [display_encode(each) for each in row]
        difference = np.clip(0.5 + DIFFERENCE_GAIN * (row[2] - row[1]), 0.0, 1.0)
        shown.append(np.concatenate([*row, np.rint(DIFFERENCE_LEVELS * difference) / DIFFERENCE_LEVELS], axis=1))
    picture = Image.fromarray(np.rint(255 * np.concatenate(shown)).astype(np.uint8))
    picture.quantize(256, dither=Image.Dither.NONE).save(result_path("monte_carlo.png"), optimize=True)


def draw_frames(given: dict[str, sp.Frame]) -> dict[str, dict[str, np.ndarray]]:
    """Return the images of each model; those of fog, which takes no notice of the lens, also without its blur."""
    made = {
        name: {kind: inner(sp.synthesize(frame, CAMERA, name)) for kind, frame in given.items()}
        for name in ("stylized", "volume")
    }
    sharp = sp.synthesize(given["in one layer"], CAMERA, "volume", defocus=False)
    made["volume"]["the same, no defocus"] = inner(sharp)
    return made


def compare_frames(
    report: Report,
    truths: tuple[list[np.ndarray], list[np.ndarray]],
    images: dict[str, dict[str, np.ndarray]],
    where: list[np.ndarray],
) -> None:
    """Add the rows of the frames; the truths are two of what `heart_truth` returns and two of `fog_truth`."""
    hearts, fogs = truths
    report.row("frame", "SSIM", "PSNR, dB", "FLIP", "light", "on disc", "on board")
    compare_frame(report, "heart", hearts, images["stylized"], where)
    compare_frame(report, "fog", [fog[0] for fog in fogs], images["volume"], where)
    in_layers = images["volume"]["in layers"]
    exposure = in_layers.mean() / np.mean([fog[1].mean() for fog in fogs])
    compare_frame(report, "fog, all light", [exposure * fog[1] for fog in fogs], {"in layers": in_layers}, where)
    report.add()


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--lens-points", type=int, default=512, help="of each pixel and colour, through the heart")
    options.add_argument("--paths", type=int, default=2048, help="of each pixel, in fog")
    options.add_argument("--lamp-paths", type=int, default=16_000_000, help="of each lamp, in fog")
    options.add_argument("--seed", type=int, default=0)
    arguments, report = options.parse_args(), Report()
    warnings.filterwarnings("ignore", "the database's model 'volume' has no axis")
    drawn, aperture, cosines = draw_scene(), read_aperture(), scattering_cosines()
    given = frames(drawn)
    images = draw_frames(given)
    seeds = [int(seed) for seed in np.random.SeedSequence(arguments.seed).generate_state(5) % 2**30]
    # The truth, each in two halves.
    hearts = [heart_truth(drawn, aperture, arguments.lens_points // 2, seed) for seed in seeds[:2]]
    gains = gains_of_distances(cosines, seeds[2])
    counts = arguments.paths // 2, arguments.lamp_paths // 2
    fogs = [fog_truth(drawn, gains, cosines, counts, seed) for seed in seeds[:2]]
    # Frames and single pixels.
    compare_frames(report, (hearts, fogs), images, places(drawn))
    compare_hearts(report, aperture, seeds[3])
    report.add()
    compare_fogs(report, cosines, seeds[4])
    report.save("monte_carlo.txt")
    pinhole = inner(given["in one layer"].layers[0].radiance)
    truths = np.mean(hearts, axis=0), np.mean([fog[0] for fog in fogs], axis=0)
    rows = zip(truths, images.values(), strict=True)
    save_picture([[pinhole, truth, made["in layers"], made["in one layer"]] for truth, made in rows])


if __name__ == "__main__":
    main()

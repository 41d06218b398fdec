"""Cases of edges and hidden surfaces in a frame of one layer, each against a truth that is drawn in layers."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import shift

from spreadlets.reports.stability.lab import CAMERA, Array, Lab, case, cases, depth_of, texture, worst
from spreadlets.scene.display import display_encode
from spreadlets.scene.frame import Frame

SIDE = 96
FINE = 6
"""Samples of a pixel along each axis."""
MARGIN = 8
"""Pixels at the border that are not judged: what lies outside is a guess in each layer."""
DISPLAY_STEP = 1.0 / 255.0


def coverage(shape: Array) -> Array:
    """Return the mean over each pixel of samples (SIDE * FINE, SIDE * FINE)."""
    return np.asarray(shape.reshape(SIDE, FINE, SIDE, FINE).mean(axis=(1, 3)))


def fine_grid() -> tuple[Array, Array]:
    """Return the places (y, x) of the samples, px from the middle."""
    y, x = (np.mgrid[: SIDE * FINE, : SIDE * FINE] + 0.5) / FINE - 0.5 * SIDE
    return y, x


def error_before(lab: Lab, inside: Array, near: tuple[Array, Array], far: tuple[Array, Array]) -> Array:
    """Return the errors (H, W) of a shape before a plane, each of a colour (H, W, 3) and CoC radii (H, W).

    ``inside`` tells which samples show the shape; the frame has the depth of each pixel's centre.
    """
    share = coverage(inside.astype(float))[..., None]
    centre = inside[FINE // 2 :: FINE, FINE // 2 :: FINE]
    depths = [depth_of(coc, SIDE) * np.ones((SIDE, SIDE)) for _, coc in (near, far)]
    flat = Frame(share * near[0] + (1 - share) * far[0], np.where(centre, *depths))
    element = np.concatenate([share * near[0], share], axis=2)
    truth = lab.render(Frame.from_layers([(element, depths[0]), (far[0], depths[1])]))
    inner = slice(MARGIN, -MARGIN)
    return np.asarray(np.abs(lab.render(flat) - truth)[inner, inner, :3].max(axis=2))


def even(*colour: float) -> Array:
    """Return an image of one colour."""
    return np.broadcast_to(np.array(colour), (SIDE, SIDE, 3))


@cases(
    "edges",
    "a shape of {} px at a slant",
    (1.0, 3.0, 20.0),
    given="a stick before an even plane, filtered colours, point-sampled depths, one of both 8 px out of focus",
    oracle="the same in layers",
    budget=0.05,
)
def slanted_stick(lab: Lab, width: float) -> float:
    """Neither dashes nor a second outline."""
    y, x = fine_grid()
    inside = np.abs(x - 0.35 * y + 0.3) < 0.5 * width
    colours = even(0.9, 0.3, 0.05), even(0.2, 0.4, 0.6)
    return max(
        worst(error_before(lab, inside, (colours[0], np.array(near)), (colours[1], np.array(far))))
        for near, far in ((-8.0, 0.0), (0.0, 8.0))
    )


@case(
    "edges",
    "sharp and wide within one tile",
    given="a grating in focus, 4 px bars and gaps, before a plane 10 px out of focus",
    oracle="the same in layers",
    budget=0.1,
)
def sharp_before_wide(lab: Lab) -> float:
    """A layer that is sharp lets through what is wide between its bars only."""
    _, x = fine_grid()
    inside = ((x + 0.2 * fine_grid()[0]) // 4) % 2 == 0
    return worst(error_before(lab, inside, (even(0.1, 0.1, 0.1), np.array(0.0)), (even(0.9, 0.8, 0.7), np.array(10.0))))


def through_the_lens(layers: list[Array], radii: tuple[float, ...]) -> Array:
    """Return the mean of what points of the lens see of layers (H, W, 4), nearest first, out of focus by radii, px."""
    axis = np.linspace(-0.95, 0.95, 20)
    places = [(x, y) for x in axis for y in axis if x * x + y * y <= 1.0]
    total = np.zeros_like(layers[0])
    for x, y in places:
        seen = np.zeros_like(total)
        for layer, radius in zip(layers, radii, strict=True):
            moved = shift(layer, (radius * y, radius * x, 0.0), order=1, mode="nearest")
            seen += (1.0 - seen[..., 3:]) * moved
        total += seen / len(places)
    return total


@case(
    "edges",
    "leaves before leaves",
    given="two layers of random leaves of 4 px, 9 and 11 px out of focus, before a bright wall; in layers",
    oracle="the mean of what points of the lens see",
    budget=0.015,
)
def leaves(lab: Lab) -> float:
    """Layers that blur alike hide each other together; by their mean visibilities the error is twice as large."""
    covers = [np.kron(np.random.default_rng(seed).random((SIDE // 4,) * 2) < 0.5, np.ones((4, 4))) for seed in (1, 2)]
    colours, radii = ((0.1, 0.3, 0.05), (0.4, 0.1, 0.05), (0.9, 0.9, 1.0)), (9.0, 11.0, 21.0)
    layers = [
        np.concatenate([np.multiply.outer(cover, colour), cover[..., None]], axis=2)
        for cover, colour in zip((*covers, np.ones((SIDE, SIDE))), colours, strict=True)
    ]
    given = [(each, depth_of(radius, SIDE) * np.ones((SIDE, SIDE))) for each, radius in zip(layers, radii, strict=True)]
    inner = slice(24, -24)
    difference = lab.render(Frame.from_layers(given)) - through_the_lens(layers, radii)
    return float(np.abs(difference[inner, inner]).mean())


@case(
    "edges",
    "a slanted surface before itself",
    given="one colour on a plane from 10 px before to 10 px behind focus",
    oracle="the colour",
    budget=DISPLAY_STEP / 2,
)
def slanted_plane(lab: Lab) -> float:
    """It hides nothing of itself."""
    coc = np.broadcast_to(np.linspace(-10, 10, SIDE), (SIDE, SIDE))
    image = lab.render(Frame(even(0.5, 0.5, 0.5), depth_of(coc, SIDE)))
    return worst(image[..., :3] - 0.5)


@case(
    "edges",
    "a moving edge before a texture",
    given="a half plane that moves by 12 px over the shutter, before a still texture; both in focus",
    oracle="the same in layers",
    budget=0.2,
    limit="what a moving edge uncovers of a texture in focus is a guess",
)
def moving_edge(lab: Lab) -> float:
    """Where it was, the texture goes on."""
    y, x = fine_grid()
    inside = x + 0.3 * y < 0.0
    share = coverage(inside.astype(float))[..., None]
    centre = inside[FINE // 2 :: FINE, FINE // 2 :: FINE]
    depths = [np.full((SIDE, SIDE), float(depth_of(coc, SIDE))) for coc in (-3.0, 0.0)]
    motion = np.array((12.0, 0.0)) / CAMERA.shutter_duration * np.ones((SIDE, SIDE, 2))
    behind, still = texture(SIDE, SIDE), np.zeros((SIDE, SIDE, 2))
    colour = even(0.9, 0.3, 0.05)
    flat = Frame(
        share * colour + (1 - share) * behind, np.where(centre, *depths), np.where(centre[..., None], motion, still)
    )
    element = np.concatenate([share * colour, share], axis=2)
    truth = lab.render(Frame.from_layers([(element, depths[0], motion), (behind, depths[1], still)]))
    inner = slice(16, -16)
    return worst((lab.render(flat) - truth)[inner, inner, :3])


@case(
    "edges",
    "a dark slanted floor behind something near and wide",
    given="a floor of one colour under a bright sky, a post 22 px out of focus before it",
    oracle="rows that change as evenly as the blur does: second difference, as displayed",
    budget=DISPLAY_STEP / 2,
)
def slanted_floor(lab: Lab) -> float:
    """No stripes where layers meet."""
    rows, cols = np.indices((2 * SIDE, 2 * SIDE))
    coc = np.where(rows < 40, 16.0, np.linspace(16.0, -2.0, 2 * SIDE)[:, None])
    radiance = np.where(rows[..., None] < 40, 1.2, 0.03) * np.ones(3)
    post = np.abs(cols - 64) < 8
    radiance[post], coc = (0.02, 0.05, 0.02), np.where(post, -22.0, coc)
    image = display_encode(lab.render(Frame(radiance, depth_of(coc, 2 * SIDE)))[..., :3].astype(np.float32))
    return worst(np.diff(image[72:-16, 16:-16], 2, axis=0))


@cases(
    "edges",
    "a subject in focus, at most {} layers",
    (4, 8),
    given="a disc in focus before a bright plane 13 px out of focus",
    oracle="the disc, but for two pixels at its edge",
    budget=DISPLAY_STEP,
)
def subject_in_focus(lab: Lab, layers: int) -> float:
    """The background does not bleed over it."""
    y, x = np.indices((SIDE, SIDE)) - SIDE / 2
    radius = np.hypot(x, y)
    radiance = np.where(radius[..., None] < 25, 0.3 * texture(SIDE, SIDE), 1.0 + texture(SIDE, SIDE, 1))
    coc = np.where(radius < 25, 0.4 * x / 25, 13.0)
    image = lab.render(Frame(radiance, depth_of(coc, SIDE)), layers=layers)
    return worst((image[..., :3] - radiance)[radius < 23])

"""Cases of numbers: conditioning of the solver, highlights, radiance at the ends of float32, sums, small alpha."""

from __future__ import annotations

import warnings

import numpy as np
from scipy import fft

from spreadlets.api import reconstruct
from spreadlets.psf.laplacian import laplacian, solve_dirichlet
from spreadlets.reports.stability.lab import (
    CAMERA,
    Array,
    Lab,
    case,
    cases,
    depth_of,
    frame_of,
    island,
    relative_l2,
    spot,
    texture,
    worst,
)
from spreadlets.runtime.integrate.convolution_pyramid import UnbalancedSourceWarning, integrate
from spreadlets.scene.frame import Frame
from spreadlets.scene.samples import SampleBuffer

SOLVER_BUDGET = 6e-4
"""Relative L2 error of one multigrid cycle: far below a display's step, 4e-3."""
COLOUR = (0.8, 0.4, 0.1)

# --- the solver


def disc(height: int, width: int, radius: float) -> Array:
    """Draw a hard disc in the middle."""
    rows, cols = np.indices((height, width)) - np.array([height // 2, width // 2])[:, None, None]
    return np.asarray(np.hypot(rows, cols) < radius, np.float64)


def solver_error(image: Array) -> float:
    """Integrate the Laplacian of an image and return the relative error."""
    source = laplacian(image)[1:-1, 1:-1, None].astype(np.float32)
    with warnings.catch_warnings():
        # Where the disc touches the border, its Laplacian is cut; zero beyond the border is right there.
        warnings.simplefilter("ignore", UnbalancedSourceWarning)
        return relative_l2(integrate(source)[..., 0].astype(np.float64), image)


@cases(
    "solver",
    "disc of radius {} px",
    (2, 8, 32, 128, 512),
    given="Laplacian of a hard disc with a margin of 32 px",
    oracle="the disc",
    budget=SOLVER_BUDGET,
)
def disc_width(lab: Lab, radius: int) -> float:
    """Condition against the width of the PSF."""
    side = 2 * radius + 64
    return solver_error(disc(side, side, radius))


@cases(
    "solver",
    "image of {} px",
    (33, 64, 257, 512, 2048),
    given="Laplacian of a disc of 0.4 of the side (2048: 512 in the tests)",
    oracle="the disc",
    budget=SOLVER_BUDGET,
)
def image_size(lab: Lab, side: int) -> float:
    """Condition against the size of the image."""
    side = min(side, lab.size(512, side))
    return solver_error(disc(side, side, 0.4 * side))


@cases(
    "solver",
    "{} px",
    ("1 x 1", "1 x 500", "500 x 1", "17 x 4000", "257 x 509"),
    given="Laplacian of a disc in an image of that shape",
    oracle="the disc",
    budget=SOLVER_BUDGET,
)
def odd_shape(lab: Lab, shape: str) -> float:
    """Shapes without room for levels, and prime sides."""
    height, width = (int(side) for side in shape.split(" x "))
    return solver_error(disc(height, width, 0.4 * min(height, width) + 0.2))


@case(
    "solver",
    "PSF as wide as the image",
    given="Laplacian of a disc that touches all four sides, 400 px",
    oracle="the disc",
    budget=SOLVER_BUDGET,
)
def touching_disc(lab: Lab) -> float:
    """Sources on the border."""
    return solver_error(disc(400, 400, 199))


@cases(
    "solver",
    "values of 1e{}",
    (-36, 33),
    given="Laplacian of a disc of that value",
    oracle="the disc",
    budget=SOLVER_BUDGET,
)
def solver_values(lab: Lab, exponent: int) -> float:
    """Ends of float32 within the solver."""
    image = disc(200, 200, 60) * 10.0**exponent
    source = laplacian(image)[1:-1, 1:-1, None].astype(np.float32)
    return relative_l2(integrate(source)[..., 0].astype(np.float64) / 10.0**exponent, image / 10.0**exponent)


# --- highlights

RATIOS = (1e2, 1e4, 1e6, 1e8)


@cases(
    "highlights",
    "{} : 1, the highlight's own light",
    RATIOS,
    given="one pixel of that value on 1, CoC 10 px",
    oracle="the same PSF drawn in full; L1 error of what the pixel adds, relative to it",
    budget=0.04,
)
def highlight_itself(lab: Lab, ratio: float) -> float:
    """The highlight's disc scales with it."""
    frame = frame_of(spot(97, 48, 48, ratio) + 1.0, 10.0)
    light, expected = (lab.render(frame, method=method)[..., :3] - 1.0 for method in ("spreadlets", "dense"))
    return float(np.abs(light - expected).sum() / expected.sum())


@cases(
    "highlights",
    "{} : 1, shadows around it",
    RATIOS,
    given="one pixel of that value on 1, CoC 10 px",
    oracle="1, farther than 2 CoC from the highlight",
    budget=0.004,
)
def highlight_shadow(lab: Lab, ratio: float) -> float:
    """What a highlight does to the dark around it."""
    size = 193
    image = lab.render(frame_of(spot(size, 96, 96, ratio) + 1.0, 10.0))[..., :3]
    rows, cols = np.indices((size, size)) - 96
    return worst(image[np.hypot(rows, cols) > 20] - 1.0)


# --- radiance at the ends of float32


@cases(
    "radiance",
    "times 1e{}",
    (-30, -20, 20, 30),
    given="a texture of that brightness, CoC 6 px, path (9, 4) px",
    oracle="the image of the texture, scaled",
    budget=1e-5,
)
def scaled_radiance(lab: Lab, exponent: int) -> float:
    """Rendering is homogeneous."""
    colours = texture(48, 48)
    plain = lab.render(frame_of(colours, 6.0, (9, 4)))[..., :3]
    scaled = lab.render(frame_of(colours * np.float32(10.0**exponent), 6.0, (9, 4)))[..., :3]
    return worst(scaled / 10.0**exponent - plain)


@case(
    "radiance",
    "denormals",
    given="a texture of 1e-40, below float32's normal range, CoC 6 px",
    oracle="the image of the texture, scaled; float32's steps are 1e-5 of it there",
    budget=0.01,
)
def denormals(lab: Lab) -> float:
    """Gradual underflow."""
    colours = texture(48, 48)
    plain = lab.render(frame_of(colours, 6.0))[..., :3]
    tiny = lab.render(frame_of(colours * np.float32(1e-40), 6.0))[..., :3]
    return worst(tiny / 1e-40 - plain)


# --- precision


def twin(lab: Lab, radiance: Array, coc: float, path: tuple[float, float]) -> Array:
    """Return channel 0 of what rendering amounts to, in float64: convolve with the points, solve exactly."""
    length = float(np.hypot(*path))
    cell = int(lab.database.find([coc, length]))
    number, transpose, flip_row, flip_col = lab.database.grid.nearest_pose(cell, np.arctan2(path[1], path[0]))
    spreadlet = lab.database.cell(cell, int(number)).transformed(
        transpose=bool(transpose), flip_row=bool(flip_row), flip_col=bool(flip_col)
    )
    half = max(spreadlet.extent)
    kernel = np.zeros((2 * half + 1, 2 * half + 1))
    kernel[tuple(spreadlet.offset_rc.T.astype(np.int64) + half)] = spreadlet.value[:, 0]
    room = [size + 2 * half for size in radiance.shape[:2]]
    spectra = [fft.rfftn(each, room) for each in (radiance[..., 0].astype(np.float64), kernel)]
    source = fft.irfftn(spectra[0] * spectra[1], room)
    solved = source if spreadlet.direct else solve_dirichlet(source)
    return np.asarray(solved[half:-half, half:-half])


@cases(
    "float32",
    "CoC {0[0]:g} px, path {0[1]} px, {0[2]}",
    ((5.0, (0, 0), "exact"), (20.0, (14, -8), "exact"), (20.0, (14, -8), "multigrid"), (60.0, (0, 0), "exact")),
    given="a texture with a transparent margin and that integrator",
    oracle="convolution with the spreadlet's points and an exact solve, in float64",
    budget=3e-4,
)
def single_precision(lab: Lab, label: tuple[float, tuple[float, float], str]) -> float:
    """Everything in float32 against everything in float64."""
    coc, path, integrator = label
    margin = int(coc + np.hypot(*path)) + 8
    radiance = island(2 * margin + 80, 2 * margin + 80, margin)
    image = lab.render(frame_of(radiance, coc, path), integrator=integrator)
    return worst(image[..., 0] - twin(lab, radiance, coc, path))


@case(
    "float32",
    "10^9 adds",
    given="2048 x 2048 pixels (256 x 256 in the tests) of noise, some of them 500 times as bright, CoC 60 px",
    oracle="convolution with the spreadlet's points and an exact solve, in float64; error relative to the image's peak",
    budget=3e-4,
)
def many_adds(lab: Lab) -> float:
    """Rounding of long sums."""
    side, margin = lab.size(256, 2048), 72
    radiance = island(side + 2 * margin, side + 2 * margin, margin)
    bright = np.random.default_rng(1).random(radiance.shape[:2]) < 1e-4
    radiance[..., :3][bright & (radiance[..., 3] > 0)] = 500.0
    # All of it is below white: the twin draws a single cell.
    radiance[..., :3] /= 512.0
    image = lab.render(frame_of(radiance, 60.0), integrator="exact")
    expected = twin(lab, radiance, 60.0, (0.0, 0.0))
    return worst(image[..., 0] - expected) / float(expected.max())


# --- alpha


@cases(
    "alpha",
    "{}",
    (1.0, 0.5, 1e-3, 1e-5, 1e-7),
    given="one colour under that alpha, CoC -12 to 12 px, random",
    oracle="the colour, after division by alpha",
    budget=2e-3,
)
def small_alpha(lab: Lab, alpha: float) -> float:
    """Division by small weights."""
    coc = np.random.default_rng(2).uniform(-12, 12, (40, 40))
    colour = np.array([*COLOUR, 1.0])
    image = lab.render(frame_of(np.broadcast_to(colour * alpha, (40, 40, 4)), coc))
    return worst(image[..., :3] / image[..., 3:] - colour[:3])


@case(
    "alpha",
    "0",
    given="a frame without anything in it",
    oracle="nothing",
    budget=0.0,
)
def no_alpha(lab: Lab) -> float:
    """Nothing divided by nothing."""
    return worst(lab.render(frame_of(np.zeros((40, 40, 4)), 5.0)))


@case(
    "alpha",
    "1e-7 in front of an opaque layer",
    given="a red layer of alpha 1e-7, CoC -9 px, before a texture in focus",
    oracle="the texture",
    budget=1e-5,
)
def faint_layer(lab: Lab) -> float:
    """A layer that is nearly nothing hides nearly nothing."""
    faint = np.zeros((40, 40, 4), np.float32)
    faint[10:30, 10:30] = 1e-7, 0, 0, 1e-7
    back = texture(40, 40)
    focus = np.full((40, 40), CAMERA.focus_distance_m)
    layers = Frame.from_layers([(faint, np.full((40, 40), depth_of(-9.0, 40))), (back, focus)])
    return worst(lab.render(layers)[..., :3] - back)


# --- samples


def sample_buffer(valid: Array, alpha: float = 1.0) -> SampleBuffer:
    """Return one sample of one colour in each pixel, with random labels."""
    rng = np.random.default_rng(4)
    shape = (*valid.shape, 1)
    colour = np.broadcast_to(np.array([*COLOUR, 1.0]) * alpha, (*shape, 4))
    lens = rng.uniform(-0.7, 0.7, (*shape, 2))
    depth = depth_of(rng.uniform(-10, 10, shape), shape[1])
    motion, time = rng.uniform(-20, 20, (*shape, 2)), rng.uniform(-0.25, 0.25, shape)
    return SampleBuffer(colour, depth, motion, lens, time, valid=valid[..., None])


def sample_error(lab: Lab, samples: SampleBuffer) -> float:
    """Reconstruct and return how far the colours are from the one that went in, after division by alpha."""
    image = reconstruct(samples, CAMERA, lab.database).astype(np.float64)
    return worst(image[..., :3] / image[..., 3:] - np.array(COLOUR))


@cases(
    "samples",
    "{} of the pixels have one",
    (1.0, 0.1, 0.001),
    given="samples of one colour, random places on the lens, times, CoC radii and motions",
    oracle="the colour",
    budget=2e-3,
)
def sparse_samples(lab: Lab, share: float) -> float:
    """Filling from few samples."""
    valid = np.random.default_rng(5).random((48, 48)) < share
    valid[24, 24] = True
    return sample_error(lab, sample_buffer(valid))


@cases(
    "samples",
    "alpha {}",
    (1e-3, 1e-7),
    given="samples of one colour under that alpha",
    oracle="the colour, after division by alpha",
    budget=2e-3,
)
def faint_samples(lab: Lab, alpha: float) -> float:
    """Division by small weights."""
    return sample_error(lab, sample_buffer(np.ones((48, 48), np.bool_), alpha))

"""Lights: the highlights of samples, drawn past what nearer samples hide of the lens.

A layer is normalised by how much of it was seen, and put behind what nearer ones hide on average. Under the bokeh of a
lamp that is not enough. A post before it cuts a piece out of the disc, as sharp as the post's edge is on the lens; and
where few samples were seen, filling from around blurs the rim. Highlights are few and bright. So their light is not
splatted into layers, but added to the image by itself: each is drawn with its own PSF, cut by the shadow that nearer
samples throw on the lens, and with the light that its samples have. That is the mean of the samples: nothing is to be
normalised, or calibrated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from spreadlets.arrays import BoolArray, FloatArray, Image, IntArray
from spreadlets.parallel import for_bands
from spreadlets.runtime.finish import _light_kernels
from spreadlets.runtime.finish._light_kernels import ACROSS, COC, LEAST_APART, PATH_X, PATH_Y, X, Y
from spreadlets.runtime.label.lists import Pixels
from spreadlets.runtime.plan.plan import Plan

LONGEST = 256.0
"""Path, px, up to which a sample may hide another: what is longer is too thin to be counted."""
CELL_PX = 8
MARGIN_PX = 64
"""How far beyond the frame samples may hide a light, px."""
MOST, MOST_STILL = 6000, 40000
"""Samples looked at for each group of lights: at each of several times, or once, where nothing moves."""
GROUP_PX = np.array((2.0, 2.0, 1.0, 2.0, 2.0), np.float32)
"""Steps of the columns of lights within which the same is hidden of them, px."""


class _Lights(NamedTuple):
    """Lights as columns of the kernels (n, 5); their colours (n, 3), for one pixel; the variants of their PSFs (n,)."""

    lights: FloatArray
    colour: FloatArray
    label: IntArray


def add_lights(image: Image, plan: Plan, pixel_sets: Sequence[Pixels], valid: BoolArray) -> None:
    """Add the lights of a plan to an image, in place.

    Parameters
    ----------
    image : ndarray of shape (H, W, 4), float32
    plan : Plan
        Of stochastic samples.
    pixel_sets : sequence of Pixels
        What it was made of: first one set for each sample of a pixel, with shifts.
    valid : ndarray of shape (H, W, S), bool
        Which samples there are.
    """
    found = _listed(plan, pixel_sets, valid)
    if not len(found.label):
        return
    # Find what is hidden of lights that lie side by side and move alike.
    _, group, count = np.unique(np.floor(found.lights / GROUP_PX), axis=0, return_inverse=True, return_counts=True)
    groups = np.zeros((len(count), found.lights.shape[1]), np.float64)
    np.add.at(groups, group, found.lights)
    lights = (groups / count[:, None]).astype(np.float32)
    reach, cells = _occluders(lights, pixel_sets[: valid.shape[2]])
    clear, hides = np.empty((len(lights), ACROSS, ACROSS), np.float32), np.empty(len(lights), np.bool_)
    density, still = float(valid.sum() / valid[..., 0].size), not any(each.labels.length.any() for each in pixel_sets)
    given = lights, reach, cells, density, MOST_STILL if still else MOST, clear, hides
    for_bands(_light_kernels.clear_shares, len(lights), *given)
    # Draw each past that, with the light of its sample.
    scale = np.empty(len(group), np.float32)
    points = _light_kernels.Points(plan.table.offset_rc, plan.table.value, plan.table.point_start)
    for_bands(_light_kernels.light_scales, len(group), group, lights, clear, hides, found.label, points, scale)
    place = np.ascontiguousarray(found.lights[:, : Y + 1])
    past = place, found.colour, group, lights, clear, found.label, points, scale
    for_bands(_light_kernels.add_lights, len(image), *past, image)


def _listed(plan: Plan, pixel_sets: Sequence[Pixels], valid: BoolArray) -> _Lights:
    """List the lights that reach into the frame."""
    highlights, reaches, shape = plan.highlights, plan.table.reaches, valid.shape[1::-1]
    parts = [_Lights(np.zeros((0, 5), np.float32), np.zeros((0, 3), np.float32), np.zeros(0, np.int64))]
    share = np.float32(1.0) / np.maximum(valid.sum(axis=2), 1).astype(np.float32)
    for pixels, at, number, chosen in zip(pixel_sets, *highlights[:2], highlights.lights, strict=True):
        labels = pixels.labels
        if not chosen.any() or labels.shift is None:
            continue
        row, col = np.unravel_index(at[chosen], labels.coc.shape)
        there = np.stack([col, row], axis=1) + labels.shift[row, col]
        columns = np.concatenate([there, labels.coc[row, col, None], labels.whole_path[row, col]], axis=1)
        colour = pixels.radiance[row, col, :3] * share[row, col, None]
        label = number[chosen].astype(np.int64) + plan.first_highlight
        beyond = np.maximum(-there, there - np.array(shape) + 1.0).max(axis=1)
        parts.append(_Lights(*(each[beyond <= reaches[label]] for each in (columns.astype(np.float32), colour, label))))
    return _Lights(*map(np.concatenate, zip(*parts, strict=True)))


def _occluders(lights: FloatArray, pixel_sets: Sequence[Pixels]) -> tuple[IntArray, _light_kernels.Cells]:
    """Return how far off samples may hide each light, px, and those samples in cells."""
    # Find the farthest off that anything in front of a light can lie.
    farthest = np.float32(lights[:, COC].max()) - np.float32(LEAST_APART)
    nearest = min(float(each.labels.coc.min()) for each in pixel_sets)
    longest = min(max(float(each.labels.length.max()) for each in pixel_sets), LONGEST)
    path = np.hypot(lights[:, PATH_X], lights[:, PATH_Y])
    shape = pixel_sets[0].labels.coc.shape
    far_off = lights[:, COC] - nearest + 0.5 * (path + longest)
    reach = np.ceil(np.minimum(far_off, sum(shape) + 2.0 * MARGIN_PX)).astype(np.int64)
    # Mark the cells there, and list the samples in them.
    rows, cols = (math.ceil((size + 2 * MARGIN_PX) / CELL_PX) for size in shape)
    wanted = np.zeros((rows, cols), np.bool_)
    cells = np.stack([lights[:, Y] - reach, lights[:, Y] + reach, lights[:, X] - reach, lights[:, X] + reach], axis=1)
    for top, bottom, left, right in np.clip((cells + MARGIN_PX) // CELL_PX, 0, None).astype(int).tolist():
        wanted[top : bottom + 1, left : right + 1] = True
    count = np.zeros(wanted.shape, np.int64)
    for each in pixel_sets:
        taken = each.labels.shift, each.labels.coc, each.radiance, farthest, wanted
        _light_kernels.count_occluders(*taken, CELL_PX, MARGIN_PX, count)
    start = np.concatenate([np.zeros(1, np.int64), np.cumsum(count)])
    samples, place = np.empty((start[-1], 6), np.float32), start[:-1].reshape(count.shape).copy()
    for each in pixel_sets:
        taken = each.labels.shift, each.labels.coc, each.radiance, farthest, wanted
        _light_kernels.list_occluders(*taken, CELL_PX, MARGIN_PX, each.labels.whole_path, place, samples)
    return reach, _light_kernels.Cells(samples, start, cols, CELL_PX, MARGIN_PX)

"""Naive twin of TLFR: every view of every pixel asks every sample, and every triangle."""

from itertools import combinations

import numpy as np


def seen_by_views(trajectories, views):
    """Sums (H, W, L, 6) of what all views of each pixel see, by layers of CoC."""
    height, width = views.pattern.shape
    sums = np.zeros((height, width, len(views.near), 6))
    for row, col in np.ndindex(height, width):
        for view in views.place[views.pattern[row, col]].astype(np.float64):
            place = np.array([col, row]) + view[3:]
            found = seen(trajectories, views, view[:3], place, float(views.radius[row, col]))
            if found is not None:
                colour, coc = found
                layer = max(k for k, begin in enumerate(views.near) if begin <= coc)
                sums[row, col, layer] += [*colour, 1, 0]
        count = sums[row, col, :, 4]
        sums[row, col, :, 5] = [count[k:].sum() for k in range(len(count))]
    return sums


def seen(trajectories, views, view, place, radius):
    """Colour and CoC of what a view sees at a place, or None."""
    path = trajectories.path.astype(np.float64)
    offset = path[:, :2] + path[:, 2:3] * view[:2] + path[:, 3:5] * view[2] - place
    distance = np.hypot(*offset.T)
    surfaces = surfaces_within(radius, distance, trajectories, views)
    if len(surfaces) != 1 and not (surfaces and len({tuple(offset[i] >= 0) for i in surfaces[0]}) == 4):
        surfaces = surfaces_within(2 * radius, distance, trajectories, views)
        if not surfaces:
            return None
        # A surface of fewer than four samples joins the next one behind it.
        merged = [[]]
        for surface in surfaces:
            if len(merged[-1]) >= 4:
                merged.append([])
            merged[-1] += surface
        covering = [each for each in merged if has_triangle(offset[each], radius)]
        surfaces = [*covering, merged[-1]]
    chosen = np.array(surfaces[0])
    nearest = chosen[np.argmin(distance[chosen])]
    weight = np.maximum(1 - distance[chosen] / radius, 0)
    if not weight.any():
        return trajectories.colour[nearest], path[nearest, 2]
    return weight @ trajectories.colour[chosen] / weight.sum(), path[nearest, 2]


def surfaces_within(radius, distance, trajectories, views):
    """Lists of the samples of each surface within a radius, near to far."""
    found = np.flatnonzero(distance < radius)
    surfaces = []
    for i in found[np.argsort(trajectories.depth[found], kind="stable")]:
        if surfaces and not any(crosses(trajectories.path[i], trajectories.path[j], views) for j in surfaces[-1]):
            surfaces[-1].append(i)
        else:
            surfaces.append([i])
    return surfaces


def crosses(one, other, views):
    """Whether two paths meet on the lens, or change sides while the shutter is open."""
    at, coc, motion = np.split((one - other).astype(np.float64), [2, 3])
    opening, closing = at - motion * views.half_shutter, at + motion * views.half_shutter
    if opening @ closing < -(float(views.tolerance) ** 2):
        return True
    along = closing - opening
    share = np.clip(-(opening @ along) / (along @ along), 0, 1) if along.any() else 0.0
    return np.hypot(*(opening + share * along)) < abs(coc[0]) - views.tolerance


def has_triangle(offset, radius):
    """Whether a triangle of samples that fits a disc of that radius, one corner within it, holds the origin."""
    near = offset[np.hypot(*offset.T) < 2 * radius]
    for corners in combinations(near, 3):
        edges = [b - a for a, b in zip(corners, (*corners[1:], corners[0]), strict=True)]
        if max(np.hypot(*edge) for edge in edges) > 2 * radius or min(np.hypot(*c) for c in corners) >= radius:
            continue
        sides = [a[0] * b[1] - a[1] * b[0] for a, b in zip(corners, (*corners[1:], corners[0]), strict=True)]
        if min(sides) > 0 or max(sides) < 0:
            return True
    return False

"""Numba kernels of sequential ray tracing through conic surfaces."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel

PASSED, BLOCKED, MISSED, REFLECTED = 0, 1, 2, 3
"""What a surface did to a ray: it passed, lay beyond the rim, missed the surface, was totally reflected."""

FAILED_CLEARANCE = -1.0
"""Clearance of rays that do not get to the sensor."""


@helper
def _refract(ray, curvature, conic, ratio):
    """Move a ray, relative to a surface's vertex, to that surface, and refract it there; return what happened.

    The surface is ``c (x^2 + y^2 + (1 + k) z^2) = 2 z``; of the two intersections the one near the vertex counts. Its
    gradient along the ray is the root of the intersection's equation, and of unit length on a sphere.
    """
    dx, dy, dz = ray[3], ray[4], ray[5]
    # From the vertex's plane the near intersection is well told from the far one, even within a ball.
    ahead = -ray[2] / dz
    x, y = ray[0] + ahead * dx, ray[1] + ahead * dy
    a = curvature * (1.0 + conic * dz * dz)
    b = curvature * (x * dx + y * dy) - dz
    c = curvature * (x * x + y * y)
    root = b * b - a * c
    if not root >= 0.0:
        return MISSED
    inward = math.sqrt(root)
    step = c / (inward - b)
    x, y, z = x + step * dx, y + step * dy, step * dz
    ray[0], ray[1], ray[2] = x, y, z
    if ratio == 1.0:
        return PASSED
    nx, ny, nz = -curvature * x, -curvature * y, 1.0 - (1.0 + conic) * curvature * z
    if conic != 0.0:
        norm = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz, inward = nx * norm, ny * norm, nz * norm, inward * norm
    through = 1.0 - ratio * ratio * (1.0 - inward * inward)
    if not through >= 0.0:
        return REFLECTED
    along = math.sqrt(through) - ratio * inward
    ray[3], ray[4], ray[5] = ratio * dx + along * nx, ratio * dy + along * ny, ratio * dz + along * nz
    return PASSED


@helper
def trace_one(ray, table, index, sensor_distance):
    """Trace a ray through a lens onto the sensor.

    Parameters
    ----------
    ray : float64 array of shape (6,)
        Position relative to the vertex of the first surface, and unit direction; becomes those on the sensor, relative
        to its middle.
    table : float64 array of shape (n_surfaces, 4)
        `precompute.models.prescription.Prescription.table`.
    index : float64 array of shape (n_surfaces,)
        Refractive index behind each surface.
    sensor_distance : float
        From the last surface.

    Returns
    -------
    clearance : float
        Smallest over the surfaces of ``1 - (r / semi-diameter)^2``: below 0, the ray is blocked.
    surface, event : int
        Which surface leaves the least clearance or fails, and `PASSED`, `BLOCKED`, `MISSED` or `REFLECTED`.
    """
    clearance, narrowest = 1.0, 0
    before = 1.0
    last = table.shape[0] - 1
    for number in range(last + 1):
        event = _refract(ray, table[number, 0], table[number, 2], before / index[number])
        if event != PASSED:
            return FAILED_CLEARANCE, number, event
        before = index[number]
        room = 1.0 - (ray[0] * ray[0] + ray[1] * ray[1]) / (table[number, 3] * table[number, 3])
        if room < clearance:
            clearance, narrowest = room, number
        ray[2] -= table[number, 1] if number < last else sensor_distance
    step = -ray[2] / ray[5]
    ray[0] += step * ray[3]
    ray[1] += step * ray[4]
    ray[2] = 0.0
    return clearance, narrowest, PASSED if clearance >= 0.0 else BLOCKED


@kernel
def trace_lines(begin, end, place, slope, index, table, distances, out, events):
    """Trace rays along straight lines across the entrance pupil.

    Parameters
    ----------
    place : float64 array of shape (n, K, 2)
        Where rays cross the plane of the entrance pupil, mm.
    slope : float64 array of shape (n, K, 2)
        dx / dz and dy / dz there.
    index : float64 array of shape (n, n_surfaces)
        Refractive indices for each line.
    table : float64 array of shape (n_surfaces, 4)
        The lens.
    distances : tuple of two floats
        Entrance pupil behind the first surface, sensor behind the last, mm.
    out : float64 array of shape (n, K, 3)
        Filled with x and y on the sensor, mm, and the clearance.
    events : int64 array of shape (n, n_surfaces, 4)
        Counts what each surface did to the rays of each line: see `PASSED`.
    """
    pupil_distance, sensor_distance = distances
    for line in range(begin, end):
        ray = np.empty(6)
        for node in range(place.shape[1]):
            sx, sy = slope[line, node, 0], slope[line, node, 1]
            norm = 1.0 / math.sqrt(1.0 + sx * sx + sy * sy)
            ray[0], ray[1], ray[2] = place[line, node, 0], place[line, node, 1], pupil_distance
            ray[3], ray[4], ray[5] = sx * norm, sy * norm, norm
            clearance, surface, event = trace_one(ray, table, index[line], sensor_distance)
            out[line, node, 0], out[line, node, 1], out[line, node, 2] = ray[0], ray[1], clearance
            events[line, surface, event] += 1

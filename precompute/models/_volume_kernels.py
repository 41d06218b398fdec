"""Numba kernels of light in a scattering medium: free paths, phase function, random walks.

Every path draws its random numbers from a generator of its own, seeded with its number, so that results do not depend
on which thread traces it.
"""

import math

import numpy as np

from spreadlets.compiled import helper, kernel

MAX_COLLISIONS = 512
"""A path that has collided so often has lost its way."""

MAJORANT = 1.25
"""Rate of tentative collisions, in units of the density (Woodcock tracking); what exceeds the density is passed by."""

_U = np.uint64


@kernel
def seed_state(seed: int, path: int) -> np.ndarray:
    """Return the generator's state for a path, uint64 of shape (1,)."""
    state = np.empty(1, np.uint64)
    state[0] = _U(seed) * _U(0xD1342543DE82EF95) + _U(path) * _U(0x9E3779B97F4A7C15)
    return state


@kernel
def uniform(state: np.ndarray) -> float:
    """Return the next number in (0, 1] (SplitMix64; Steele, Lea and Flood 2014)."""
    state[0] += _U(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> _U(30))) * _U(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> _U(27))) * _U(0x94D049BB133111EB)
    z = z ^ (z >> _U(31))
    return (float(z >> _U(11)) + 1.0) * 2.0**-53


@kernel
def free_path(density: float, state: np.ndarray) -> float:
    """Return the distance to the next collision by Woodcock tracking."""
    distance = 0.0
    while True:
        distance -= math.log(uniform(state)) / (MAJORANT * density)
        if uniform(state) <= 1.0 / MAJORANT:
            return distance


@kernel
def scattering_cosine(g: float, u: float) -> float:
    """Return the cosine of the scattering angle of Henyey and Greenstein, by its inverse distribution function."""
    if abs(g) < 1e-6:
        return 2.0 * u - 1.0
    part = (1.0 - g * g) / (1.0 - g + 2.0 * g * u)
    return min(max((1.0 + g * g - part * part) / (2.0 * g), -1.0), 1.0)


@helper
def _turn(x: float, y: float, z: float, cosine: float, angle: float) -> tuple[float, float, float]:
    """Turn a direction by a polar angle, given by its cosine, and an azimuth about itself."""
    sine = math.sqrt(max(1.0 - cosine * cosine, 0.0))
    across, up = sine * math.cos(angle), sine * math.sin(angle)
    # A basis about the direction without a branch that loses precision (Duff et al. 2017).
    sign = math.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    new_x = across * (1.0 + sign * x * x * a) + up * b + cosine * x
    new_y = across * sign * b + up * (sign + y * y * a) + cosine * y
    new_z = -across * sign * x - up * y + cosine * z
    norm = math.sqrt(new_x * new_x + new_y * new_y + new_z * new_z)
    return new_x / norm, new_y / norm, new_z / norm


@helper
def _first_collision(density: float, distance: float, state: np.ndarray) -> float:
    """Return the distance of a first collision that lies before a given distance."""
    before = -math.expm1(-density * distance)
    return min(-math.log1p(-before * (1.0 - uniform(state))) / density, distance)


@kernel
def _distance(u: float, low: float, high: float) -> float:
    """Map a uniform number to the tent over [low, high], see `precompute.trace.line_sample.tent`."""
    t = math.sqrt(2.0 * u) - 1.0 if u < 0.5 else 1.0 - math.sqrt(2.0 - 2.0 * u)
    return 0.5 * (low + high) + 0.5 * (high - low) * t


@helper
def _walk_one(distance, properties, scale, state, weight, rings, absorbed, lost):
    """Trace one path whose first collision lies before the plane; ``weight`` (C,) is its light, used up."""
    density, g = properties[0], properties[1]
    x, y, z = 0.0, 0.0, 0.0
    dx, dy, dz = 0.0, 0.0, 1.0
    step = _first_collision(density, distance, state)
    for _ in range(MAX_COLLISIONS):
        # A free path that crosses the plane ends there: deposit the light in its ring.
        if z + step * dz >= distance:
            step = (distance - z) / dz
            x, y = x + step * dx, y + step * dy
            ring = min(math.sqrt(x * x + y * y) / distance * scale, rings.shape[0] - 1.0)
            for channel in range(len(weight)):
                rings[int(ring), channel] += weight[channel]
            return
        # Move to the collision, which absorbs a part of the light.
        x, y, z = x + step * dx, y + step * dy, z + step * dz
        for channel in range(len(weight)):
            absorbed[channel] += weight[channel] * (1.0 - properties[2 + channel])
            weight[channel] *= properties[2 + channel]
        # Sample the direction after it, and the next free path.
        cosine = scattering_cosine(g, uniform(state))
        dx, dy, dz = _turn(dx, dy, dz, cosine, 2.0 * math.pi * uniform(state))
        step = free_path(density, state)
    # After too many collisions, give the path up.
    for channel in range(len(weight)):
        lost[channel] += weight[channel]


@kernel
def walk(begin, end, n_paths, seed, properties, geometry, rings, absorbed, lost):
    """Trace paths that collide at least once before they reach the plane.

    Parameters
    ----------
    n_paths, seed : int
    properties : float64 array of shape (2 + C,)
        Density, anisotropy, albedo of each channel.
    geometry : float64 array of shape (3,)
        Nearest and farthest distance of the plane; rings per unit of the tangent of the angle of sight.
    rings : float64 array of shape (n_blocks, R, C)
        Energy that arrives, by distance from the axis; the last ring takes all that lies beyond.
    absorbed, lost : float64 array of shape (n_blocks, C)
        Energy that does not arrive. The shares depend on n_blocks alone.
    """
    n_blocks, _, n_channels = rings.shape
    density, low, high = properties[0], geometry[0], geometry[1]
    # Planes at which more light is scattered get more paths: each path stands for the same energy.
    most = -math.expm1(-density * high)
    for block in range(begin, end):
        weight = np.empty(n_channels)
        for path in range(n_paths * block // n_blocks, n_paths * (block + 1) // n_blocks):
            state = seed_state(seed, path)
            distance = _distance((path + 0.5) / n_paths, low, high)
            while high > low and uniform(state) * most > -math.expm1(-density * distance):
                distance = _distance(uniform(state), low, high)
            weight[:] = 1.0
            _walk_one(distance, properties, geometry[2], state, weight, rings[block], absorbed[block], lost[block])

"""What nearer samples hide of a light, in plain NumPy: twins of `runtime.finish._light_kernels`."""

import numpy as np

from spreadlets.runtime.finish._light_kernels import ACROSS, FOOTPRINT, LEAST_CLEAR, STEP, TIMES

PLACES = -1.0 + STEP * np.arange(ACROSS)


def overlap(centre, half):
    """How much of the cell of each place on an axis a stretch about a centre covers."""
    begin, end = np.maximum(PLACES - STEP / 2, centre - half), np.minimum(PLACES + STEP / 2, centre + half)
    return np.maximum(end - begin, 0.0)


def hidden_shares(light, samples, density):
    """Shares (TIMES, ACROSS, ACROSS) of each place on the lens that samples hide of a light at each time."""
    hidden = np.zeros((TIMES, ACROSS, ACROSS))
    for x, y, coc, path_x, path_y, cover in np.asarray(samples, np.float64):
        apart = light[2] - coc
        if apart < 1.0:
            continue
        half = max(0.5 * np.sqrt(FOOTPRINT / density) / apart, STEP / 2)
        amount = cover / (density * (apart * 2 * half * STEP) ** 2)
        for number in range(TIMES):
            time = (number + 0.5) / TIMES - 0.5
            u = (x - light[0] + (path_x - light[3]) * time) / apart
            v = (y - light[1] + (path_y - light[4]) * time) / apart
            hidden[number] += amount * np.outer(overlap(v, half), overlap(u, half))
    return hidden


def interpolated(plane, row, col):
    """A plane between its places, held at its border."""
    row, col = np.clip(row, 0, ACROSS - 1), np.clip(col, 0, ACROSS - 1)
    i, j = min(int(row), ACROSS - 2), min(int(col), ACROSS - 2)
    down, right = row - i, col - j
    return (1 - down) * ((1 - right) * plane[i, j] + right * plane[i, j + 1]) + down * (
        (1 - right) * plane[i + 1, j] + right * plane[i + 1, j + 1]
    )


def clear_shares(light, samples, density):
    """The share (ACROSS, ACROSS) that is clear at places across the box about the light's PSF."""
    light = np.asarray(light, np.float64)
    hidden = hidden_shares(light, samples, density)
    clear = np.empty((ACROSS, ACROSS))
    for i, j in np.ndindex(clear.shape):
        x, y = (PLACES[j], PLACES[i]) * (abs(light[2]) + np.abs(light[3:]) / 2)
        values, nearest = [], (np.inf, 0.0)
        for number in range(TIMES):
            time = (number + 0.5) / TIMES - 0.5
            place = np.array([x - light[3] * time, y - light[4] * time]) / light[2]
            distance = np.hypot(*place)
            place /= max(distance, 1.0)
            value = interpolated(hidden[number], (place[1] + 1) / STEP, (place[0] + 1) / STEP)
            nearest = min(nearest, (distance, value))
            if distance <= 1 + STEP:
                values.append(value)
        clear[i, j] = 1.0 - (np.mean(values) if values else nearest[1])
    return np.clip(clear, LEAST_CLEAR, 1.0)


def points_through(light, clear, offset_rc, value):
    """The values of a PSF's points past what hides them, with as much light as before."""
    wide, tall = abs(light[2]) + np.abs(light[3:]) / 2
    share = [
        interpolated(clear, (row / tall + 1) / STEP, (col / wide + 1) / STEP) for row, col in np.asarray(offset_rc)
    ]
    through = np.array(share) * value
    return through * value.sum() / through.sum()

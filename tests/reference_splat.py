"""Naive twin of the splat step: one pixel after the other, one point after the other, in float64."""

import numpy as np


def splat_naive(shape, source, table, padding, wanted):
    """Draw a pass as `runtime.splat.splat` does into an empty image of the given shape."""
    image = np.zeros(shape)
    for row, col in np.argwhere(source.variant >= 0):
        variant = source.variant[row, col]
        if not wanted[variant]:
            continue
        points = slice(table.point_start[variant], table.point_start[variant + 1])
        shift = source.shift[row, col] if len(source.shift) else 0
        centre = np.array([row, col]) + source.origin + shift + padding
        for offset, value in zip(table.offset_rc[points], table.value[points], strict=True):
            weight = value if len(value) == 1 else np.append(value, value.mean())
            image[tuple(centre + offset)] += weight * source.radiance[row, col].astype(np.float64)
    return image

"""Naive twin of the splat step: one pixel after the other, one point after the other, in float64."""

import numpy as np

from spreadlets.runtime.splat.passes import GROUPS


def splat_naive(canvas, sources, group, table):
    """Draw one group of passes, of single pixels or blocks, as `runtime.splat` does, into an empty canvas."""
    image = np.zeros((canvas.rows, canvas.cols, 4))
    layer, kind = divmod(group, GROUPS)
    for source in sources:
        for row, col in np.argwhere(source.label >= 0):
            of_layer, variant = divmod(int(source.label[row, col]), table.n_variants)
            if of_layer != layer or table.group[variant] != kind:
                continue
            points = slice(table.point_start[variant], table.point_start[variant + 1])
            shift = source.shift[row, col] if len(source.shift) else 0
            first = np.array([row, col]) * source.stride + source.origin + shift - (canvas.top, canvas.left)
            for centre in (first + corner for corner in np.ndindex(source.stride, source.stride)):
                for offset, value in zip(table.offset_rc[points], table.value[points], strict=True):
                    weight = value if len(value) == 1 else np.append(value, value.mean())
                    image[tuple(centre + offset)] += weight * source.radiance[row, col].astype(np.float64)
    return image

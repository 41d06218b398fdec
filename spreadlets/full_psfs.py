"""What one half of the tree traces for the other: PSFs in full, for methods that draw them and for highlights; haze."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from spreadlets.psf.database import Database
from spreadlets.psf.database_file import refusing

if TYPE_CHECKING:
    from spreadlets.psf.exact import ExactPsf
    from spreadlets.runtime.composite.haze import BlurredShare
    from spreadlets.runtime.options import Options


@dataclass(frozen=True)
class DensePsfs:
    """The full PSFs of a database's cells, traced as its build did; see `runtime.plan.variant.DensePsf`."""

    database: Database
    by_rows: bool = False

    def __call__(self, cell: int, pose: int, scale: float) -> npt.NDArray[np.float64]:
        """Return the PSF of a cell and pose, its parameters times a scale, as an array (h, w, C)."""
        from spreadlets.precompute.models.registry import trace_psf

        grid = self.database.grid
        stretch = np.array([[scale if axis.scales else 1.0] for axis in grid.model.axes])
        with refusing(self.database.path):  # the model's settings are the file's
            return trace_psf(
                grid.model,
                grid.box(cell) * stretch,
                angle=float(self.database.angles(cell)[pose]),
                angle_half_width=grid.angle_half_width(cell),
                side=grid.side(cell, pose),
            )


def full_psfs(opened: Database, options: Options) -> tuple[DensePsfs | None, ExactPsf | None]:
    """Return where methods that draw PSFs in full take them from, and what makes the PSFs of highlights."""
    from spreadlets.precompute.models.registry import exact_psf

    dense_psfs = DensePsfs(opened, by_rows=options.method == "dense-rows") if options.draws_in_full else None
    with refusing(opened.path):  # the model's settings are the file's
        return dense_psfs, exact_psf(opened.grid.model)


def blurred_share(opened: Database) -> BlurredShare | None:
    """Return how much of a layer's opacity is blurred to one beyond; None where there is no medium between."""
    from spreadlets.precompute.models import registry

    with refusing(opened.path):  # the model's settings are the file's
        return registry.blurred_share(opened.grid.model)

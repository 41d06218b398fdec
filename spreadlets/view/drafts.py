"""Drafts: what is seen while something is dragged, fast, and as like the whole picture as that allows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from spreadlets.bokeh import Progress
from spreadlets.models import Model
from spreadlets.psf.database import Database
from spreadlets.renderer import Renderer
from spreadlets.scene.frame import Frame

if TYPE_CHECKING:
    from spreadlets.runtime.options import Options

LEAST_SIDE = 512
"""Longer side, px, below which no proxy goes."""
FIRST_SIDE = 768
"""That of the first proxy, at most."""
SHARES = (1.0, 0.75, 0.625, 0.5, 0.375, 0.25, 0.1875, 0.125)
"""Sizes of proxies."""
TOO_SLOW_S, FAST_S = 0.075, 0.04
"""Times of a draft, s, from which a smaller one is taken next, and below which a larger one: that takes up to 1.8 times
as long, and is not too slow then."""
DRAFT_LAYERS = 2
"""Depth layers of a draft, while that is fast enough."""
DRAFT: Mapping[str, Any] = {"tolerance": 0.1, "cycles": 0}
"""Options of a draft: where all moves, steps of the display go unseen. The solver's last step is left out."""
LEFT_OUT = (
    "curved paths",
    "several surfaces in a pixel but for lights",
    "what lies hidden",
    "last step of the solver",
)
"""What a draft leaves out of the whole picture."""
ALL_BUT_ONE_LAYER = "depth layers"
"""What one in one layer leaves out, too."""


class DraftRenderer(Renderer):
    """Renders drafts: paths are straight, and a mixed pixel belongs to one of its surfaces, unless it shows a light.

    What nearer layers hide is filled from around when layers are put behind one another, and not looked for.

    Parameters
    ----------
    frame : Frame
    database : Database, Model or str, optional
    progress : callable, optional
        All as for `Renderer`.
    """

    def __init__(
        self, frame: Frame, database: Database | Model | str | None = None, *, progress: Progress | None = None
    ) -> None:
        from spreadlets.runtime.label.surfaces import KeptSurfaces, split_lights

        straight = Frame.of([layer.straight() for layer in frame.layers])
        super().__init__(straight, database, progress=progress)
        self._split = KeptSurfaces(split_lights)

    def _drawing(self, database: Database, options: Options) -> dict[str, Any]:
        """Return what divides the pixels of lights, and looks for nothing hidden."""
        return {**super()._drawing(database, options), "hidden": False}


def ladder(longer_side: int) -> list[tuple[float, int]]:
    """Return the drafts of a frame, from slow to fast: their share of its size, and their layers."""
    shares = [share for share in SHARES if share * longer_side >= LEAST_SIDE] or [1.0]
    return [*((share, DRAFT_LAYERS) for share in shares), (shares[-1], 1)]

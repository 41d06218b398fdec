"""Visibility: how much each depth layer leaves to be seen of what lies beyond, of a frame and of stochastic samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import NOTHING, Image
from spreadlets.runtime.composite import layers
from spreadlets.runtime.composite.composite import COUNT, COVERAGE, LEAST_SEEN, REST
from spreadlets.runtime.composite.lanes import LEAST_LENGTH, Lanes, find_lanes
from spreadlets.runtime.composite.layers import CoverPart, Pass
from spreadlets.runtime.composite.overlap import Overlap, find_overlap
from spreadlets.runtime.label.labels import Labels
from spreadlets.runtime.label.lists import Pixels
from spreadlets.runtime.label.sampled import sample_paths, sample_pixels
from spreadlets.runtime.plan.layering import BEHIND_ALL, Membership
from spreadlets.runtime.plan.plan import Plan
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.samples import SampleBuffer

LEAST_SAMPLES = 5.0, 4.0
"""Samples that must have met a layer, or passed it, for a pixel, of whatever level, to stand for itself."""


class ShareBeyond:
    """Of what each layer leaves of the pixels of a frame, how much lies beyond it and is not hidden by nearer ones.

    Parameters
    ----------
    pixel_sets : sequence of Pixels
    plan : Plan
        Of them.
    known : ndarray of shape (H, W), uint64
        Bits of the layers in which each pixel is known, see `runtime.plan.behind.Behind`.
    n_hidden : int
        Lists, at the end, of hidden pixels.
    closed : bool
        Whether the frame is opaque.
    """

    kind = REST
    least = LEAST_SEEN

    def __init__(
        self,
        pixel_sets: Sequence[Pixels],
        plan: Plan,
        known: npt.NDArray[np.uint64],
        n_hidden: int,
        *,
        closed: bool,
    ) -> None:
        covers = [layers.cover_part(*each) for each in zip(plan.members, pixel_sets, strict=True)]
        n_seen = len(covers) - n_hidden
        labels = pixel_sets[0].labels
        # Of what is not opaque, some is seen through it everywhere.
        blur = np.abs(labels.coc) + np.float32(0.5) * labels.length if closed else NOTHING
        self.cover = layers.Cover(covers[0], covers[1:n_seen], covers[n_seen:], known, blur)
        self.moments = layers.layer_moments(
            [(each, each.labels.whole_path, members) for each, members in zip(pixel_sets, plan.members, strict=True)],
            plan.n_layers,
        )
        frame = self.cover.frame, pixel_sets[0].labels
        self._overlap = find_overlap([frame], self.cover.seen, self.moments, closed=closed, hiding=True)

    def beyond(self, number: int) -> Image:
        """Return how much more is seen of a layer than nearer ones leave in the mean, see `find_overlap`."""
        return NOTHING if self._overlap is None else self._overlap.of(number)

    def seen(self, number: int) -> Image | None:
        """Return the share beyond a layer of what it leaves, all blurred as the layer is."""
        moments = self.moments[number]
        return None if moments is None else layers.share_beyond(self.cover, number, moments)

    def guessed_blur(self, number: int) -> float | None:
        """Return how far a layer blurs, px: what lies hidden of it is guessed, and has no lamps."""
        moments = self.moments[number]
        return None if moments is None else moments.disc_radius()

    def lanes(self, number: int) -> None:
        """Return no lanes: the pixels of a frame are not noisy."""
        return


class GivenLayer:
    """A layer of a frame that comes in layers: nothing of it was hidden.

    Parameters
    ----------
    number : int
        Of the layer, the nearest is 0.
    overlap : Overlap or None
        Of all layers, see `overlap_of_layers`.
    """

    kind = COVERAGE
    least = LEAST_SEEN

    def __init__(self, number: int, overlap: Overlap | None) -> None:
        self._number, self._overlap = number, overlap

    def seen(self, number: int) -> Image | None:
        """Return nothing to measure by: all of it was seen."""
        return None

    def beyond(self, number: int) -> Image:
        """Return how much more is seen of the layer than nearer ones leave in the mean."""
        return NOTHING if self._overlap is None else self._overlap.of(self._number)

    def guessed_blur(self, number: int) -> None:
        """Return nothing: all of it was seen."""
        return

    def lanes(self, number: int) -> None:
        """Return no lanes: the pixels of a frame are not noisy."""
        return


def overlap_of_layers(groups: Sequence[Sequence[Pixels]], *, closed: bool) -> Overlap | None:
    """Find how the layers of a frame overlap that comes in such, by the sets of pixels of each; see `find_overlap`."""
    if len(groups) < 2 + closed:
        return None
    frames, lists, labelled = list[tuple[CoverPart, Labels]](), list[CoverPart](), []
    for number, group in enumerate(groups):
        # All of a set's pixels lie in its layer.
        for pixels in group:
            shape, labels = pixels.labels.coc.shape, pixels.labels
            whole = Membership(np.zeros(shape, np.int32), np.full(shape, number, np.int32), np.zeros(shape, np.float32))
            part = layers.cover_part(whole, pixels)
            labelled.append((pixels, labels.whole_path, whole))
            if part.at is None:
                frames.append((part, labels))
            else:
                lists.append(part)
    moments = layers.layer_moments(labelled, len(groups))
    return find_overlap(frames, lists, moments, closed=closed, hiding=False)


class PassingSamples:
    """How many samples have passed each layer.

    Parameters
    ----------
    samples : SampleBuffer
    camera : ThinLens
    pixel_sets : sequence of Pixels
        All samples at mid-shutter, one set for each of a pixel.
    drawn : sequence of Pixels
        What is drawn of each of these sets.
    plan : Plan
        Of what is drawn.
    weights : sequence of sequences of ndarray of shape (H, W), float32
        Of each sample where it passed a layer, for each layer and set, see `runtime.plan.evening.evened`.
    defocus : bool
        Whether that is blurred.

    Attributes
    ----------
    paths, offsets : list of ndarray of shape (H, W, 2), float32
        Of one sample of each pixel: how far it moves while the shutter is open, and where in its pixel it was seen, px.
    """

    kind = COUNT
    least = LEAST_SAMPLES

    def __init__(
        self,
        samples: SampleBuffer,
        camera: ThinLens,
        pixel_sets: Sequence[Pixels],
        drawn: Sequence[Pixels],
        plan: Plan,
        weights: Sequence[Sequence[Image]],
        *,
        defocus: bool,
    ) -> None:
        self.members, self._weights = [], weights
        for number, (pixels, members) in enumerate(zip(drawn, plan.members, strict=True)):
            # What lists draw at steps of time has been met, too.
            variant = members.variant if pixels.curved is None else np.where(pixels.curved, 0, members.variant)
            met_nothing = samples.valid[:, :, number] & (samples.radiance[:, :, number, 3] == 0)
            layer = np.where(samples.valid[:, :, number], members.layer, np.int32(0))  # a missing one passes nothing
            layer = np.where(met_nothing, np.int32(BEHIND_ALL), layer)
            self.members.append(members._replace(variant=variant.astype(np.int32, copy=False), layer=layer))
        self.samples, self._pixel_sets = samples, pixel_sets
        # Where each was seen, and its places on the lens and in time, laid out once for all layers.
        since_centre = samples.time - np.float32(camera.shutter_centre)
        self.offsets, lens, time, alpha = (
            [np.ascontiguousarray(each[:, :, i]) for i in range(samples.n_samples)]
            for each in (samples.offset, samples.lens_uv, since_centre, samples.radiance[..., 3])
        )
        self._passes = list(zip(self.members, self.offsets, lens, time, alpha, strict=True))
        self.paths = sample_paths(samples, pixel_sets, camera)
        self._duration = camera.shutter_duration
        self.moments = self._moments(pixel_sets, plan.n_layers)
        if not defocus:
            # They passed the layers through the lens that took them, even where its blur is taken out of the image.
            taken = self._moments(sample_pixels(samples, camera, defocus=True, motion=False), plan.n_layers)
            self.moments = [
                None if mean is None or through is None else mean._replace(coc=through.coc)
                for mean, through in zip(self.moments, taken, strict=True)
            ]

    def _moments(self, pixel_sets: Sequence[Pixels], n_layers: int) -> list[layers.Moments | None]:
        motion = np.ascontiguousarray(np.moveaxis(self.samples.motion, 2, 0))
        return layers.layer_moments(
            [(each, path, m) for each, path, m in zip(pixel_sets, motion, self.members, strict=True)], n_layers
        )

    def beyond(self, number: int) -> Image:
        """Return nothing: what passed is counted together already."""
        return NOTHING

    def seen(self, number: int) -> Image | None:
        """Return the number of samples that passed a layer."""
        moments = self.moments[number]
        if moments is None:
            return None
        passes = [Pass(*each, weight) for each, weight in zip(self._passes, self._weights[number], strict=True)]
        return layers.passing_samples(passes, self.paths, number, moments, self._duration)

    def guessed_blur(self, number: int) -> None:
        """Return nothing: other samples saw what lies hidden."""
        return

    def lanes(self, number: int) -> Lanes | None:
        """Return the lanes of what moves far in focus in a layer, if anything does."""
        moments = self.moments[number]
        if moments is None or moments.length_squared <= LEAST_LENGTH**2:
            return None
        radiance, coc = [each.radiance for each in self._pixel_sets], [each.labels.coc for each in self._pixel_sets]
        return find_lanes(self.members, radiance, coc, self.paths, number)


Visibility = ShareBeyond | GivenLayer | PassingSamples

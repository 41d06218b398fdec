"""Sets of labelled pixels: all those of a frame, or lists of some of them.

What few pixels of a frame need, such as a second surface, is a list: arrays of as many rows as it takes.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import NOTHING, BoolArray, Image, IntArray
from spreadlets.runtime.label.labels import Labels, Places
from spreadlets.runtime.label.trail import Trail
from spreadlets.scene.frame import Layer

LIST_WIDTH = 1024
"""Pixels in a row of a list: rows are what threads divide."""

_Number = TypeVar("_Number", bound=np.generic)


class Pixels(NamedTuple):
    """One label for each pixel of a frame, or of a list of its pixels.

    Attributes
    ----------
    radiance : ndarray of shape (H, W, 4), float32
        Premultiplied colour, C-contiguous.
    labels : Labels
        With the places of the pixels, if they are a list.
    weight : ndarray of shape (H, W) or (0, 0), float32
        Share of the pixel that is drawn by this label; empty if it is the whole.
    frame : ndarray of shape (frame's H, W, 4), float32, or None
        The colours of the frame that the pixels of a list are from.
    curved : ndarray of shape (H, W), bool, or None
        The pixels of a frame whose weight is 0 because a list draws them, at steps of the shutter's time.
    """

    radiance: Image
    labels: Labels
    weight: Image = NOTHING
    frame: Image | None = None
    curved: BoolArray | None = None

    @property
    def is_list(self) -> bool:
        """Whether the pixels are a list."""
        return self.labels.view.places is not None


def rows_of(chosen: IntArray) -> IntArray:
    """Return the numbers of some pixels in rows of a list, the last one filled up with the first."""
    index = np.full((-(-len(chosen) // LIST_WIDTH), LIST_WIDTH), chosen[0] if len(chosen) else 0, np.int64)
    index.ravel()[: len(chosen)] = chosen
    return index


def listed(layer: Layer, pixels: Pixels, chosen: IntArray) -> tuple[Layer, Pixels]:
    """Return some pixels as a list, with as many rows as it takes.

    Parameters
    ----------
    layer : Layer
        What the labels were made of.
    pixels : Pixels
        Of a frame or of a list, weighted.
    chosen : ndarray of shape (n,), int64
        Their numbers in raster order.

    Returns
    -------
    layer : Layer
    pixels : Pixels
        The last row is filled up with the first pixel, of weight 0.
    """
    index = rows_of(chosen)
    labels, view = pixels.labels, pixels.labels.view
    in_frame = np.stack(np.divmod(index, pixels.radiance.shape[1]), axis=-1).astype(np.int32)
    at = in_frame if view.places is None else _taken(view.places.at, index)
    weight = _taken(pixels.weight, index)
    weight.ravel()[len(chosen) :] = 0.0
    # Take what is known of them.
    take = partial(_taken, index=index)
    part = layer.mapped(take, take, take(pixels.radiance))
    labels = Labels(
        take(labels.coc),
        take(labels.path),
        take(labels.length),
        None if labels.shift is None else take(labels.shift),
        view._replace(depth=part.depth, places=Places(at, view.frame_shape)),
        None if labels.sweep is None else take(labels.sweep),
    )
    return part, Pixels(part.radiance, labels, weight, pixels.frame)


def _taken(values: npt.NDArray[_Number], index: IntArray) -> npt.NDArray[_Number]:
    """Return the values (H, W, ...) of pixels, by their numbers in raster order."""
    return values.reshape(-1, *values.shape[2:])[index]


def _joined_trails(labels: Sequence[Labels]) -> Trail | None:
    if all(each.trail is None for each in labels):
        return None
    return Trail.joined([Trail.unmoved(each.coc.shape) if each.trail is None else each.trail for each in labels])


def joined(lists: Sequence[Pixels], frame: Image) -> Pixels:
    """Return several lists as one, of a frame of colours (frame's H, W, 4)."""
    labels = [each.labels for each in lists]
    at = [each.view.places.at for each in labels if each.view.places is not None]
    places = Places(np.concatenate(at), labels[0].view.frame_shape)
    return Pixels(
        np.concatenate([each.radiance for each in lists]),
        Labels(
            np.concatenate([each.coc for each in labels]),
            np.concatenate([each.path for each in labels]),
            np.concatenate([each.length for each in labels]),
            np.concatenate([np.zeros_like(each.path) if each.shift is None else each.shift for each in labels]),
            labels[0].view._replace(depth=np.concatenate([each.view.depth for each in labels]), places=places),
            np.concatenate([each.whole_path for each in labels]),
            _joined_trails(labels),
        ),
        np.concatenate([each.weight for each in lists]),
        frame,
    )

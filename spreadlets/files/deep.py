"""Deep images: any number of samples behind each other in a pixel, points and volumes, and their depth layers.

Samples are read as OpenEXR's "Interpreting OpenEXR Deep Pixels" says: colours are premultiplied, Z is where a sample
begins, ZBack where it ends, and a volume's light is absorbed and emitted evenly along its length.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenEXR

from spreadlets.arrays import FloatArray, PathLike
from spreadlets.errors import InvalidFrameError, InvalidParameterError
from spreadlets.files._deep_kernels import ALPHA, BACK, COLOUR, FRONT, LABELS, collect_layers, seam_lengths, tidy_pixels
from spreadlets.files.atomic import atomic_path
from spreadlets.files.exr_chunks import DeepPart
from spreadlets.files.exr_file import MAX_VALUES, library_messages
from spreadlets.scene.frame import ALPHA_TOLERANCE, Frame
from spreadlets.scene.raster import Window

DEFAULT_LAYERS = 8
"""Most depth layers that are made of a deep image unless the caller says otherwise: each costs memory for a frame."""

CUT_BINS = 2048
"""Places, evenly spaced in 1 over the depth, where layers may be cut."""

SEAM_PRICE = 0.5
"""Pairs of samples that a cut must part for each sample that it parts from a neighbour."""


@dataclass(frozen=True, eq=False)
class DeepImage:
    """Samples of a deep image, pixel by pixel.

    Attributes
    ----------
    counts : ndarray of shape (H, W), int64
        Samples in each pixel.
    radiance : ndarray of shape (N, 4), float32
        Premultiplied linear RGB and alpha of each sample by itself, in the pixels' row-major order.
    depth, depth_back : ndarray of shape (N,), float32
        Where the sample begins and ends, planar metres; equal for a surface.
    motion : ndarray of shape (N, 2), float32, or None
        px per frame, y down, forward.

    Examples
    --------
    Glass in front of a wall in one pixel, the wall alone in the other:

    >>> import numpy as np
    >>> image = sp.DeepImage(
    ...     counts=np.array([[2, 1]]),
    ...     radiance=np.array([[0.1, 0.1, 0.1, 0.2], [1, 1, 1, 1], [1, 1, 1, 1]], np.float32),
    ...     depth=np.array([1, 4, 4], np.float32),
    ...     depth_back=np.array([1, 4, 4], np.float32),
    ...     motion=None,
    ... )
    >>> image.layers()
    Frame(1 x 2 px, 2 layers)
    """

    counts: npt.NDArray[np.int64]
    radiance: FloatArray
    depth: FloatArray
    depth_back: FloatArray
    motion: FloatArray | None = None

    def __post_init__(self) -> None:
        n = int(self.counts.sum())
        shapes = {"radiance": (n, 4), "depth": (n,), "depth_back": (n,)}
        shapes |= {} if self.motion is None else {"motion": (n, 2)}
        for name, shape in shapes.items():
            found = getattr(self, name).shape
            if found != shape:
                raise InvalidFrameError(f"{name} has shape {found}; the counts ask for {shape}")
        for (name, what), bad in _problems(self.radiance, self.depth, self.depth_back, self.motion).items():
            pixel = int(np.searchsorted(np.cumsum(self.counts), int(np.argmax(bad)), side="right"))
            row, col = divmod(pixel, self.counts.shape[1])
            raise InvalidFrameError(
                f"{name} is {what} at {np.count_nonzero(bad)} of {bad.size} deep samples, first at "
                f"(row {row}, col {col})"
            )

    @staticmethod
    def merged(images: Sequence[DeepImage]) -> DeepImage:
        """Return the samples of several images of one scene in one; what has no motion is still.

        Parameters
        ----------
        images : sequence of DeepImage
            At least one; of one shape.

        Raises
        ------
        InvalidFrameError
            If the shapes differ.

        Examples
        --------
        >>> import numpy as np
        >>> one = np.ones(1, np.float32)
        >>> image = sp.DeepImage(np.array([[1]]), np.ones((1, 4), np.float32), one, one)
        >>> sp.DeepImage.merged([image, image]).counts.item()
        2
        """
        # Check that all have one shape.
        first = images[0]
        for index, image in enumerate(images):
            if image.counts.shape != first.counts.shape:
                raise InvalidFrameError(
                    f"deep image {index} has shape {image.counts.shape}, image 0 has {first.counts.shape}; all images "
                    "of a scene share one shape"
                )
        if len(images) == 1:
            return first
        # Sort the samples by pixel; those of a pixel keep the images' order.
        pixel = np.concatenate([np.repeat(np.arange(image.counts.size), image.counts.ravel()) for image in images])
        order = np.argsort(pixel, kind="stable")
        # Give motion to all samples, if any have it.
        moving = any(image.motion is not None for image in images)
        motions = [
            np.zeros((len(each.depth), 2), np.float32) if each.motion is None else each.motion for each in images
        ]
        return DeepImage(
            np.sum([image.counts for image in images], axis=0),
            np.concatenate([image.radiance for image in images])[order],
            np.concatenate([image.depth for image in images])[order],
            np.concatenate([image.depth_back for image in images])[order],
            np.concatenate(motions)[order] if moving else None,
        )

    def tidy(self) -> DeepImage:
        """Return the image with samples sorted, split where others begin or end, and coinciding ones merged.

        Returns
        -------
        DeepImage
            In each pixel samples are nearest first and do not overlap.

        Notes
        -----
        "Interpreting OpenEXR Deep Pixels", making an image tidy.
        """
        table, start = self._table(), self._start()
        out = np.empty((3 * len(table), table.shape[1]))
        counts = np.empty(self.counts.size, np.int64)
        tidy_pixels(start, table, out, counts)
        return self._of(out, 3 * start, counts)

    def layers(self, max_layers: int = DEFAULT_LAYERS) -> Frame:
        """Return a frame of depth layers, nearest first.

        The image is cut at few depths, the same for all pixels, so that what lies behind each other in a pixel comes
        into different layers, and what is one surface is seldom cut; see `layer_cuts`.

        Parameters
        ----------
        max_layers : int
            Most layers, at least 1.

        Returns
        -------
        Frame
            Samples of a pixel that share a layer are composited; depth and motion are means by visible alpha, the depth
            of a volume is its middle. Composited nearest over farthest, the layers give the flattened image.

        Raises
        ------
        InvalidParameterError
            If `max_layers` is less than 1, or the layers would take too much memory.
        """
        if max_layers < 1:
            raise InvalidParameterError(f"max_layers is {max_layers}; it must be at least 1")
        tidy = self.tidy()
        table, start = tidy._table(), tidy._start()
        inverse = 2 / (table[:, FRONT] + table[:, BACK])
        cuts = layer_cuts(inverse, start, self.counts.shape[1], max_layers)
        layer = (inverse[:, None] < cuts).sum(axis=1)
        shape = len(cuts) + 1, self.counts.size, table.shape[1]
        if math.prod(shape) > MAX_VALUES:
            raise InvalidParameterError(
                f"{shape[0]} layers hold {math.prod(shape)} values; at most {MAX_VALUES} are made"
            )
        out = np.zeros(shape, np.float32)
        out[..., FRONT] = out[..., BACK] = np.inf
        collect_layers(start, table, layer, out)
        return Frame.from_layers([self._layer(values) for values in out])

    def _layer(self, values: FloatArray) -> Frame:
        """Return one layer of the table that `collect_layers` fills."""
        values = values.reshape(*self.counts.shape, -1)
        radiance = np.concatenate([values[..., COLOUR:LABELS], values[..., ALPHA, None]], axis=2)
        depth = 0.5 * values[..., FRONT] + 0.5 * values[..., BACK]
        return Frame(radiance, depth, None if self.motion is None else values[..., LABELS:])

    def _table(self) -> npt.NDArray[np.float64]:
        """Return the samples as the kernels take them: front, back, alpha, colour, labels."""
        alpha = np.clip(self.radiance[:, 3:], 0, 1)
        motion = [] if self.motion is None else [self.motion]
        columns = [self.depth[:, None], self.depth_back[:, None], alpha, self.radiance[:, :3], *motion]
        return np.concatenate(columns, axis=1).astype(np.float64)

    def _start(self) -> npt.NDArray[np.int64]:
        return np.concatenate([[0], np.cumsum(self.counts)]).astype(np.int64)

    def _of(self, table: npt.NDArray[np.float64], start: npt.NDArray[np.int64], counts: Any) -> DeepImage:
        """Return the image of the first samples of each pixel in a table."""
        within = np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts)
        kept = table[np.repeat(start[:-1], counts) + within].astype(np.float32)
        return DeepImage(
            counts.reshape(self.counts.shape),
            np.concatenate([kept[:, COLOUR:LABELS], kept[:, ALPHA, None]], axis=1),
            kept[:, FRONT],
            kept[:, BACK],
            None if self.motion is None else kept[:, LABELS:],
        )


def _problems(
    radiance: FloatArray, depth: FloatArray, depth_back: FloatArray, motion: FloatArray | None
) -> dict[tuple[str, str], npt.NDArray[np.bool_]]:
    """Return which samples are bad, by the name of the array and what is wrong."""
    alpha = radiance[:, 3]
    checks: dict[tuple[str, str], Any] = {
        ("radiance", "not finite"): ~np.isfinite(radiance).all(axis=1),
        ("alpha", "outside 0 to 1"): (alpha < -ALPHA_TOLERANCE) | (alpha > 1 + ALPHA_TOLERANCE),
        ("depth", "NaN, zero or negative"): ~(depth > 0),
        ("depth_back", "NaN or nearer than the depth"): ~(depth_back >= depth),
        ("depth_back", "infinite behind a finite depth"): np.isinf(depth_back) & np.isfinite(depth),
    }
    if motion is not None:
        checks["motion", "not finite"] = ~np.isfinite(motion).all(axis=1)
    return {name: bad for name, bad in checks.items() if bad.any()}


def layer_cuts(
    inverse: npt.NDArray[np.float64], start: npt.NDArray[np.int64], width: int, max_layers: int
) -> npt.NDArray[np.float64]:
    """Choose the depths at which a deep image is cut into layers.

    Parameters
    ----------
    inverse : ndarray of shape (N,), float64
        1 over the depth of each sample, descending within a pixel.
    start : ndarray of shape (n_pixels + 1,), int64
        First sample of each pixel.
    width : int
        Pixels in a row of the image.
    max_layers : int
        One more than the most cuts.

    Returns
    -------
    ndarray of shape (n,), float64
        Descending in 1 over the depth.

    Notes
    -----
    A cut gains the pairs of neighbouring samples of a pixel that it is the first to part, and costs the seams that it
    makes: samples that it parts from the nearest in depth of those in the next pixel. The best cut is taken, one after
    the other, until none gains more than it costs. Our own; renderers' layers, made by object, are the model.
    """
    low, high = (float(inverse.min()), float(inverse.max())) if len(inverse) else (0.0, 0.0)
    if not high > low:
        return np.zeros(0)
    # Divide inverse depth into bins, and price a cut by the seams that it leaves in surfaces.
    bins = np.minimum((inverse - low) / (high - low) * CUT_BINS, CUT_BINS - 1).astype(np.int64)
    seam = np.zeros(CUT_BINS + 1)
    seam_lengths(start, bins, width, seam)
    cost = SEAM_PRICE * np.cumsum(seam)
    # List the neighbouring samples of each pixel, which a cut could part.
    pixel = np.repeat(np.arange(len(start) - 1), np.diff(start))
    together = pixel[1:] == pixel[:-1]
    near, far = bins[:-1][together], bins[1:][together]
    cuts: list[int] = []
    # Cut where that parts the most of them for the price, as long as it gains anything.
    while len(cuts) < max_layers - 1:
        gain = np.bincount(far + 1, minlength=CUT_BINS + 1) - np.bincount(near + 1, minlength=CUT_BINS + 1)
        score = np.cumsum(gain) - cost
        best = _middle_of_best(score)
        if score[best] <= 0:
            break
        cuts.append(best)
        parted = (far < best) & (near >= best)
        near, far = near[~parted], far[~parted]
    return low + np.array(sorted(cuts, reverse=True)) / CUT_BINS * (high - low)


def _middle_of_best(score: npt.NDArray[np.float64]) -> int:
    """Return the middle of the first run of largest values."""
    first = int(np.argmax(score))
    others = np.flatnonzero(score[first:] != score[first])
    return first + (int(others[0]) if len(others) else len(score) - first) // 2


# --- Files ---------------------------------------------------------------------------------------------------------


def write_deep(path: PathLike, image: DeepImage) -> None:
    """Write a deep image as scanlines, which every program can read; the file appears whole or not at all.

    Parameters
    ----------
    path : path
        Where to write; an existing file is replaced.
    image : DeepImage
        Stored as 32-bit floats R, G, B, A, Z, ZBack and, if it has motion, motion.x, motion.y.

    Raises
    ------
    InvalidFileError
        If the file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> image = sp.DeepImage(
    ...     counts=np.array([[1, 1]]),
    ...     radiance=np.ones((2, 4), np.float32),
    ...     depth=np.ones(2, np.float32),
    ...     depth_back=np.ones(2, np.float32),
    ...     motion=None,
    ... )
    >>> sp.write_deep("deep.exr", image)
    >>> sp.read_frame("deep.exr")
    Frame(1 x 2 px, 1 layer)
    """
    values = {name: image.radiance[:, index] for index, name in enumerate("RGBA")}
    values |= {"Z": image.depth, "ZBack": image.depth_back}
    if image.motion is not None:
        values |= {"motion.x": image.motion[:, 0], "motion.y": image.motion[:, 1]}
    header = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}
    with atomic_path(path, ".exr") as temporary, library_messages():
        OpenEXR.File(header, {name: _pixels(flat, image.counts) for name, flat in values.items()}).write(str(temporary))


def deep_image(
    part: DeepPart,
    data: Window,
    display: Window,
    names: Mapping[str, Sequence[str]],
    *,
    to_planar: Callable[[FloatArray, npt.NDArray[np.int64]], FloatArray],
    to_motion: Callable[[FloatArray], FloatArray],
    unpremultiplied: bool = False,
    repair: bool = False,
) -> tuple[DeepImage, int]:
    """Return the samples of a part of a deep file, in the display window; what adds nothing is left out.

    Parameters
    ----------
    part : DeepPart
        Samples in the data window.
    data, display : Window
        The part's windows.
    names : mapping of str to sequence of str
        The channels that are colour, alpha (if several, their mean), depth, and motion, if there is any; ZBack beside
        the depth is found.
    to_planar : callable
        Makes planar metres of stored depths and the pixels of the display window that they are in.
    to_motion : callable
        Makes px per frame of motion channels, (N, n) to (N, 2).
    unpremultiplied : bool
        Multiply the colours by alpha.
    repair : bool
        Mend invalid labels (a bad depth becomes background, a bad motion still) and drop samples with invalid colours,
        instead of raising.

    Returns
    -------
    image : DeepImage
    bad : int
        How many invalid samples were mended or dropped.
    """
    # Gather colours, with alpha premultiplied.
    shape = display.height, display.width
    pixel = _display_pixels(part, data, display)
    shown = pixel >= 0
    alpha = np.mean([part.channels[name] for name in names["alpha"]], axis=0, dtype=np.float32)
    radiance = np.stack([*(part.channels[name] for name in names["colour"]), alpha], axis=1)
    if unpremultiplied:
        radiance[:, :3] *= radiance[:, 3:]
    # Gather depths and motion in our conventions.
    (depth_name,) = names["depth"]
    ends = [
        to_planar(part.channels[name], pixel) for name in (depth_name, depth_name + "Back") if name in part.channels
    ]
    depth, depth_back = (
        np.minimum(ends[0], ends[-1]),
        np.maximum(ends[0], ends[-1]),
    )  # 1 over the depth turns them round
    motion = None
    if "motion" in names:
        motion = to_motion(np.stack([part.channels[name] for name in names["motion"]], axis=1))
    # Mend bad labels; samples of bad colours are dropped.
    visible = shown & (radiance != 0).any(axis=1)
    bad: npt.NDArray[np.bool_] = np.zeros(len(depth), np.bool_)
    dropped = bad
    if repair:
        for places in _problems(radiance, depth, depth_back, motion).values():
            bad |= places & visible
        depth, depth_back = _mended_depths(depth, depth_back)
        motion = None if motion is None else np.where(np.isfinite(motion).all(axis=1, keepdims=True), motion, 0)
        radiance[:, 3] = np.clip(radiance[:, 3], 0, 1)
        dropped = np.asarray(~np.isfinite(radiance).all(axis=1))
    # List what is left, pixel by pixel.
    kept = visible & ~dropped
    counts = np.bincount(pixel[kept], minlength=shape[0] * shape[1]).reshape(shape)
    labels = None if motion is None else motion[kept]
    return DeepImage(counts, radiance[kept], depth[kept], depth_back[kept], labels), int(np.count_nonzero(bad))


def _mended_depths(depth: FloatArray, depth_back: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return depths with background for bad ones, and with the front for bad backs."""
    depth = np.where(depth > 0, depth, np.float32(np.inf))
    good = (depth_back >= depth) & (np.isinf(depth) | np.isfinite(depth_back))
    return depth, np.where(good, depth_back, depth)


def _display_pixels(part: DeepPart, data: Window, display: Window) -> npt.NDArray[np.int64]:
    """Return the pixel of the display window that each sample is in, -1 outside."""
    row = np.arange(data.height)[:, None] + data.top - display.top
    col = np.arange(data.width)[None, :] + data.left - display.left
    inside = (row >= 0) & (row < display.height) & (col >= 0) & (col < display.width)
    return np.repeat(np.where(inside, row * display.width + col, -1).ravel(), part.counts.ravel())


def _pixels(flat: FloatArray, counts: npt.NDArray[np.int64]) -> npt.NDArray[Any]:
    """Return a channel as the binding takes it: an array of an array for each pixel."""
    pixels = np.empty(counts.size, object)
    for index, values in enumerate(np.split(np.ascontiguousarray(flat, np.float32), np.cumsum(counts)[:-1])):
        pixels[index] = values
    return pixels.reshape(counts.shape)

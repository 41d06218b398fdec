"""Samples as flat arrays in the order of the pixels that they lie in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray, IntArray
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.samples import SampleBuffer


@dataclass(frozen=True)
class Samples:
    """N samples, sorted by pixel, row by row.

    Attributes
    ----------
    colour : ndarray of shape (N, 4), float32
        Linear, premultiplied.
    place : ndarray of shape (N, 2), float32
        Where the sample lies in the image, ``(x, y)`` px: pixel (row, col) has its centre at (col, row).
    lens : ndarray of shape (N, 2), float32
        Place on the lens, the unit disc for a round aperture.
    time : ndarray of shape (N,), float32
        Frames from the middle of the shutter.
    motion : ndarray of shape (N, 2), float32
        ``(dx, dy)``, px per frame.
    coc : ndarray of shape (N,), float32
        Signed radius of the circle of confusion, px: seen from the lens's centre at mid-shutter, the sample would be
        at ``place - coc * lens - motion * time``.
    depth : ndarray of shape (N,), float32
        Metres, > 0; infinite where a sample met nothing.
    first : ndarray of shape (H * W + 1,), int64
        The samples in pixel ``row * W + col`` are ``first[pixel]`` to ``first[pixel + 1] - 1``.
    shape : tuple of int
        Height and width of the image, px.
    half_shutter : float
        Frames from the middle of the shutter to where it opens or closes.
    """

    colour: FloatArray
    place: FloatArray
    lens: FloatArray
    time: FloatArray
    motion: FloatArray
    coc: FloatArray
    depth: FloatArray
    first: IntArray
    shape: tuple[int, int]
    half_shutter: float

    @classmethod
    def from_buffer(
        cls, buffer: SampleBuffer, camera: ThinLens, *, defocus: bool = True, motion: bool = True
    ) -> Samples:
        """Flatten a buffer.

        Parameters
        ----------
        buffer : SampleBuffer
            Labelled samples; missing ones are left out. Paths are taken as straight.
        camera : ThinLens
            Gives the CoC radius, unless the buffer has it, and the middle of the shutter.
        defocus, motion : bool
            Without an effect, samples are moved to where they would lie without it, and have no CoC or motion.

        Returns
        -------
        Samples
        """
        # Find each sample's place on the screen.
        there = buffer.valid.ravel()
        height, width = buffer.shape
        rows = np.broadcast_to(np.arange(height, dtype=np.float32)[:, None, None], buffer.depth.shape)
        cols = np.broadcast_to(np.arange(width, dtype=np.float32)[None, :, None], buffer.depth.shape)
        place = _those(np.stack([cols, rows], axis=-1) + buffer.offset, there)
        shown = buffer.raster.display.width
        # Find its CoC radius, and its time from the middle of the shutter.
        coc = buffer.coc_radius if buffer.coc_radius is not None else camera.coc_radius(buffer.depth, shown)
        time = buffer.time - np.float32(camera.shutter_centre)
        # List the valid samples pixel by pixel.
        samples = cls(
            colour=_those(buffer.radiance, there),
            place=place,
            lens=_those(buffer.lens_uv, there),
            time=_those(time, there),
            motion=_those(buffer.motion, there),
            coc=_those(coc, there),
            depth=_those(buffer.depth, there),
            first=_first(buffer.valid.sum(axis=2)),
            shape=(height, width),
            half_shutter=0.5 * (camera.shutter[1] - camera.shutter[0]),
        )
        return samples if defocus and motion else samples._without(defocus=defocus, motion=motion)

    @property
    def per_pixel(self) -> float:
        """Mean number of samples in a pixel."""
        return len(self.coc) / (self.shape[0] * self.shape[1])

    def _without(self, *, defocus: bool, motion: bool) -> Samples:
        """Return the samples moved to where they lie without an effect, in their new order."""
        place, coc, path = self.place, self.coc, self.motion
        # Undo the displacement over the lens, and over time.
        if not defocus:
            place, coc = place - coc[:, None] * self.lens, np.zeros_like(coc)
        if not motion:
            place, path = place - path * self.time[:, None], np.zeros_like(path)
        # Sort the samples into the pixels that they are moved to.
        height, width = self.shape
        col = np.clip(np.rint(place[:, 0]).astype(np.int64), 0, width - 1)
        row = np.clip(np.rint(place[:, 1]).astype(np.int64), 0, height - 1)
        pixel = row * width + col
        order = np.argsort(pixel, kind="stable")
        return Samples(
            colour=self.colour[order],
            place=place[order],
            lens=self.lens[order],
            time=self.time[order],
            motion=path[order],
            coc=coc[order],
            depth=self.depth[order],
            first=_first(np.bincount(pixel, minlength=height * width)),
            shape=self.shape,
            half_shutter=self.half_shutter,
        )


def _first(count: npt.NDArray[np.integer]) -> IntArray:
    """Return where the samples of each pixel begin, and where all end, for the number in each pixel."""
    return np.concatenate([[0], np.cumsum(count)]).astype(np.int64)


def _those(values: npt.NDArray[np.floating], there: npt.NDArray[np.bool_]) -> FloatArray:
    """Return an array (H, W, S, ...) as rows (N, ...) of the samples that are there."""
    rows = np.ascontiguousarray(values, np.float32).reshape(there.size, *values.shape[3:])
    return rows if there.all() else np.ascontiguousarray(rows[there])

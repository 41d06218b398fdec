"""The ``stylized`` model: any image as the PSF, as large as the circle of confusion (LKS section 5.1).

The image is traced along parallel lines, between whose samples it is linear, so that no pixel of the image shows as a
square in the PSF.
"""

from __future__ import annotations

import base64
import math
import struct
import zlib
from collections.abc import Callable, Mapping
from typing import Any, BinaryIO

import numpy as np
from PIL import Image

from spreadlets.arrays import DoubleArray
from spreadlets.errors import InvalidFileError, InvalidParameterError, option
from spreadlets.precompute.trace.line_sample import Segments, Tracer, polylines, tent, unchanged
from spreadlets.psf.model import PsfModel

N_DIMENSIONS = 2
"""Place of the line, circle of confusion."""

LINE_ANGLE = 0.3
"""Direction of all lines, radians: far from the lattice's axes and diagonals, to which parallel lines would beat."""

RAYS_PER_PIXEL = 256
"""Point-equivalent deposits: parallel lines are spread so evenly that few of them draw a smooth image."""

SAMPLES_PER_PIXEL = 2
"""Samples along a line for each pixel of the image: an oblique line's light is not quite linear between pixels."""

MAX_SIDE = 160
"""Images are reduced to so many pixels: more than a PSF can show, and small enough to go with the database."""

MAX_FILE_SIDE = 8192
"""Most pixels in a row or column of an image that is read: 800 MB as it is unpacked."""

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"

MAX_COLOUR_OFFSET = 0.5
"""Largest sideways offset of red and blue, as a share of the PSF's radius."""


def read_settings(*, image: str | None = None, colour_offset: float = 0.0) -> dict[str, Any]:
    """Return the settings of a model whose PSF is an image.

    Parameters
    ----------
    image : str
        A PNG file. Colours are taken as sRGB; where there is alpha it multiplies them.
    colour_offset : float
        Shift of red to the right and of blue to the left, as a share of the PSF's radius: lateral colour.

    Raises
    ------
    InvalidParameterError
        If the image or its light is missing, or the offset is out of range.
    InvalidFileError
        If the file cannot be read.
    """
    if image is None:
        raise InvalidParameterError(f"the model 'stylized' needs an image as its PSF: give {option('image')}")
    if not abs(colour_offset) <= MAX_COLOUR_OFFSET:
        raise InvalidParameterError(
            f"{option('colour_offset')} is {colour_offset}: allowed are "
            f"-{MAX_COLOUR_OFFSET} to {MAX_COLOUR_OFFSET} of the radius"
        )
    return {"image": encode(_read_light(image)), "colour_offset": float(colour_offset)}


def _read_light(path: str) -> DoubleArray:
    """Read a PNG as linear light (h, w, 3), reduced to at most `MAX_SIDE`."""
    # Read its pixels.
    try:
        file = open(path, "rb")
    except OSError as error:
        raise InvalidFileError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        with file:
            _check_png(path, file)
            pixels = _pixels(file)
    except InvalidFileError:
        raise
    except (OSError, ValueError, SyntaxError) as error:
        raise InvalidFileError(f"{path}: not a readable PNG file: {error}") from error
    # Turn them into light, of at most so many pixels.
    light = _linear(pixels[..., :3]) * pixels[..., 3:]
    if not light.max() > 0.0:
        raise InvalidParameterError(f"{path}: the image holds no light: it is black or transparent everywhere")
    shrink = MAX_SIDE / max(light.shape[:2])
    if shrink < 1.0:
        size = [max(1, round(shrink * side)) for side in light.shape[:2]]
        light = np.maximum(_reduced(light, size), 0.0)
    return np.asarray(light / light.max(), np.float64)


def _check_png(path: str, file: BinaryIO) -> None:
    """Refuse a file that is no PNG, or too large an image, before any pixel of it is unpacked."""
    start = file.read(24)
    file.seek(0)
    if len(start) < 24 or not start.startswith(PNG_SIGNATURE):
        raise InvalidFileError(f"{path}: not a readable PNG file")
    width, height = struct.unpack(">II", start[16:])
    if not 0 < max(width, height) <= MAX_FILE_SIDE:
        raise InvalidFileError(f"{path}: has {width} x {height} px; at most {MAX_FILE_SIDE} x {MAX_FILE_SIDE} are read")
    _check_chunks(path, file)
    file.seek(0)


def _check_chunks(path: str, file: BinaryIO) -> None:
    """Refuse a PNG whose chunks are not what their checksums say: the library does not look at those of the pixels."""
    file.seek(len(PNG_SIGNATURE))
    kind = b""
    while kind != b"IEND":
        head = file.read(8)
        length, kind = struct.unpack(">I4s", head) if len(head) == 8 else (0, b"")
        content = file.read(length + 4)
        if len(content) < length + 4 or zlib.crc32(kind + content[:-4]) != int.from_bytes(content[-4:], "big"):
            raise InvalidFileError(f"{path}: not a readable PNG file: it is truncated or corrupt")


def _pixels(file: BinaryIO) -> DoubleArray:
    """Return the red, green, blue and alpha of a PNG in [0, 1], (h, w, 4)."""
    with Image.open(file, formats=["PNG"]) as image:
        if not image.mode.startswith("I"):
            return np.asarray(image.convert("RGBA"), np.float64) / 255.0
        grey = np.asarray(image, np.float64) / 65535.0  # 16 bits
    return np.stack([grey, grey, grey, np.ones_like(grey)], axis=-1)


def _reduced(light: DoubleArray, size: list[int]) -> DoubleArray:
    """Reduce an image (h, w, 3) to a size: a Gaussian takes out what it cannot show, then it is interpolated."""
    from scipy import ndimage  # takes a fifth of a second to import; a frame of a thin lens does not need it

    shrink = np.array(light.shape) / (*size, 3)
    smooth = ndimage.gaussian_filter(light, 0.5 * np.maximum(shrink - 1.0, 0.0), mode="mirror")
    reduced: DoubleArray = ndimage.zoom(smooth, 1.0 / shrink, order=1, mode="mirror", grid_mode=True)
    return reduced


def _linear(display: DoubleArray) -> DoubleArray:
    """Turn sRGB values in [0, 1] into linear light."""
    return np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)


def encode(light: DoubleArray) -> dict[str, Any]:
    """Turn linear light (h, w, 3) in [0, 1] into JSON values, at 16 bits."""
    data = np.rint(65535.0 * light).astype("<u2").tobytes()
    return {"shape": list(light.shape), "u16": base64.b64encode(zlib.compress(data, 9)).decode()}


def decode(stored: Mapping[str, Any]) -> DoubleArray:
    """Return the light (h, w, 3) that `encode` stored."""
    size = math.prod(stored["shape"]) * 2
    if not 0 < size <= 2 * MAX_SIDE * MAX_SIDE * 3:
        raise InvalidParameterError(
            f"the image of the PSF has the shape {stored['shape']}; its sides end at {MAX_SIDE}"
        )
    data = zlib.decompressobj().decompress(base64.b64decode(stored["u16"]), size)
    return np.frombuffer(data, "<u2").reshape(stored["shape"]) / 65535.0


def tracer(model: PsfModel, side: int) -> Tracer:
    """Return what traces a model with these settings; the image is upright on both sides of the focus."""
    light = decode(model.settings["image"])
    offset = float(model.settings["colour_offset"]) * np.array([1.0, 0.0, -1.0])
    # Half the image's diagonal, px, and room for the offsets and the last pixel's fading.
    half = 0.5 * float(np.hypot(*light.shape[:2])) + 0.5 * max(light.shape[:2]) * float(np.abs(offset).max()) + 1.0
    along = np.linspace(-half, half, SAMPLES_PER_PIXEL * int(np.ceil(2.0 * half)) + 1)[None, :]

    def trace(points: DoubleArray, box: DoubleArray, angle: float, angle_half_width: float) -> Segments:
        across = half * (2.0 * points[:, :1] - 1.0)
        x = along * np.cos(LINE_ANGLE) - across * np.sin(LINE_ANGLE)
        y = along * np.sin(LINE_ANGLE) + across * np.cos(LINE_ANGLE)
        scale = tent(points[:, 1:2], *box[0]) / (0.5 * max(light.shape[:2]))
        return polylines(scale * x, scale * y, _light_at(light, x, y, offset))

    return Tracer(
        N_DIMENSIONS,
        trace,
        lambda box: reach(box, light, offset),
        unchanged,
        segments_per_point=along.size,
        rays_per_pixel=RAYS_PER_PIXEL,
    )


def _light_at(light: DoubleArray, x: DoubleArray, y: DoubleArray, offset: DoubleArray) -> DoubleArray:
    """Look up an image at places (n, K) in its pixels from its centre, each channel moved by an offset; (n, K, 3)."""
    from scipy import ndimage

    height, width = light.shape[:2]
    radius = 0.5 * max(height, width)
    row = y + 0.5 * (height - 1)
    planes = [
        ndimage.map_coordinates(
            light[..., channel], [row, x - radius * move + 0.5 * (width - 1)], order=1, mode="grid-constant"
        )
        for channel, move in enumerate(offset)
    ]
    return np.stack(planes, axis=-1)


def reach(box: DoubleArray, light: DoubleArray, offset: DoubleArray) -> float:
    """Return the largest distance in x or y from the centre that light can have, px."""
    n_pixels = max(light.shape[:2])
    return float(box[0, 1] * ((n_pixels + 2.0) / n_pixels + np.abs(offset).max()))


def image_psf(model: PsfModel) -> Callable[[tuple[float, ...], float, int], DoubleArray]:
    """Return what makes the PSF of a CoC radius: ``(coordinate, direction, side) -> psf``, (h, w, 3), of unit sum.

    Between the image's pixels the light is linear, so that its integral over a pixel of the PSF is known, along each
    axis by itself.
    """
    light = decode(model.settings["image"])
    offset = float(model.settings["colour_offset"]) * np.array([1.0, 0.0, -1.0])
    radius = 0.5 * max(light.shape[:2])

    def psf(coordinate: tuple[float, ...], angle: float, side: int) -> DoubleArray:
        scale = coordinate[0] / radius
        half = math.ceil(reach(np.array([[0.0, coordinate[0]]]), light, offset) + 0.5)
        down = _areas(light.shape[0], half, scale, 0.0)
        planes = [
            down @ light[..., channel] @ _areas(light.shape[1], half, scale, radius * move).T
            for channel, move in enumerate(offset)
        ]
        drawn = np.stack(planes, axis=-1)
        return np.asarray(drawn * (drawn.shape[2] / drawn.sum()))

    return psf


def _areas(n_samples: int, half: int, scale: float, offset: float) -> DoubleArray:
    """Return how much of each sample's light falls into each pixel of the PSF, along one axis.

    Parameters
    ----------
    n_samples : int
        Of the image; a sample's light is a tent that ends at its neighbours.
    half : int
        The PSF has ``2 half + 1`` pixels.
    scale : float
        Pixels of the PSF between neighbouring samples.
    offset : float
        By how many samples the image is moved.

    Returns
    -------
    ndarray of shape (2 half + 1, n_samples), float64
    """
    edges = (np.arange(2 * half + 2) - half - 0.5) / max(scale, np.finfo(np.float64).tiny)
    place = np.arange(n_samples) - 0.5 * (n_samples - 1) + offset
    across = np.clip(edges[:, None] - place, -1.0, 1.0)
    # The integral of a tent up to a place.
    return np.diff(0.5 + across - 0.5 * across * np.abs(across), axis=0)

"""Results as files: OpenEXR with windows and attributes, or pictures for viewing, as the extension says."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenEXR

from spreadlets.arrays import FloatArray, PathLike
from spreadlets.errors import InvalidParameterError
from spreadlets.files.atomic import atomic_path
from spreadlets.files.attributes import FILE_ATTRIBUTES, WRITTEN_BY_LIBRARY, carry_attributes, chromaticities
from spreadlets.files.exr_file import library_messages
from spreadlets.files.exr_parts import part_header, raster_header
from spreadlets.scene.display import display_encode
from spreadlets.scene.frame import image_array
from spreadlets.scene.primaries import to_rec_709
from spreadlets.scene.raster import Raster, placed

HALF_MAX = float(np.finfo(np.float16).max)

OPENEXR = ".exr"
PICTURES: Mapping[str, Mapping[str, Any]] = {
    ".png": {"format": "PNG"},
    ".jpg": {"format": "JPEG", "quality": 95, "subsampling": 0},
    ".jpeg": {"format": "JPEG", "quality": 95, "subsampling": 0},
    ".tif": {"format": "TIFF", "compression": "tiff_adobe_deflate"},
    ".tiff": {"format": "TIFF", "compression": "tiff_adobe_deflate"},
}
"""Formats of 8 bits by their extensions, and how Pillow is told to write them."""

EXTENSIONS = (OPENEXR, *PICTURES)
"""What the name of an image may end with, in upper or lower case."""


def image_extension(path: PathLike) -> str:
    """Return the extension of an image to write, in lower case.

    Raises
    ------
    InvalidParameterError
        If no format has it.
    """
    extension = PurePath(os.fspath(path)).suffix.lower()
    if extension not in EXTENSIONS:
        raise InvalidParameterError(f"{path}: the name of an image ends with {', '.join(EXTENSIONS)}")
    return extension


def write_image(
    path: PathLike,
    radiance: npt.ArrayLike,
    *,
    half: bool = False,
    metadata: Mapping[str, str | int | float] | None = None,
    raster: Raster | None = None,
    channels: Mapping[str, npt.NDArray[Any]] | None = None,
) -> None:
    """Write an image; the file appears whole or not at all, and is what its extension says.

    Parameters
    ----------
    path : path
        Where to write; an existing file is replaced. ``.exr`` is OpenEXR; ``.png``, ``.jpg``, ``.jpeg``, ``.tif`` and
        ``.tiff`` are pictures for viewing: of the display window, 8-bit sRGB, dithered, over black, NaN as black; from
        the primaries that the raster's chromaticities name.
    radiance : array_like of shape (H, W, 3) or (H, W, 4)
        Linear values, stored as R, G, B and A.
    half : bool
        Store 16-bit floats (values beyond 65504 are clipped) instead of 32-bit ones.
    metadata : mapping, optional
        Header attributes: names to strings, integers or floats.
    raster : Raster, optional
        Where the pixels lie, such as `Frame.raster`: its windows, pixel aspect and attributes go into the file.
    channels : mapping of str to ndarray of shape (H, W), optional
        Further channels by their names: float16, float32 or uint32, stored as they are.

    Raises
    ------
    InvalidFrameError
        If `radiance` is no such array.
    InvalidParameterError
        If no format has the extension, the metadata has a reserved name or a value of another type, or a picture for
        viewing is to hold `half`, `metadata` or `channels`.
    InvalidFileError
        If the file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> sp.write_image("image.exr", np.ones((4, 6, 4)), half=True, metadata={"artist": "me"})
    >>> sp.read_image("image.exr").shape
    (4, 6, 4)
    >>> sp.write_image("image.jpg", np.full((4, 6, 3), 0.18))
    """
    image = image_array("radiance", radiance)
    raster = raster or Raster.of_shape((image.shape[0], image.shape[1]))
    extension = image_extension(path)
    if extension != OPENEXR:
        for name, value in (("half", half), ("metadata", metadata), ("channels", channels)):
            if value:
                raise InvalidParameterError(f"{path}: {name} is for OpenEXR; name it {OPENEXR}")
        shown = placed(image, raster.data, raster.display)[..., :3]
        own = chromaticities(raster.attributes)
        _write_picture(path, shown if own is None else to_rec_709(shown, own), PICTURES[extension])
        return
    header = {**_checked_metadata(metadata or {}), **part_header()}
    window = raster.written(image)
    stored = _stored(placed(image, raster.data, window), half)
    stored |= {name: placed(values, raster.data, window) for name, values in (channels or {}).items()}
    header |= raster_header(raster, window)
    with atomic_path(path, OPENEXR) as temporary, library_messages():
        OpenEXR.File(header, {name: np.ascontiguousarray(plane) for name, plane in stored.items()}).write(
            str(temporary)
        )
        carry_attributes(temporary, [raster.attributes])


def write_plane(path: PathLike, name: str, values: FloatArray, *, raster: Raster | None = None) -> None:
    """Write one channel of 32-bit floats as OpenEXR; the file appears whole or not at all.

    Parameters
    ----------
    path : path
        Where to write; an existing file is replaced.
    name : str
        Of the channel.
    values : ndarray of shape (H, W), float32
    raster : Raster, optional
        Where the pixels lie.

    Raises
    ------
    InvalidFileError
        If the file cannot be written.
    """
    raster = raster or Raster.of_shape((values.shape[0], values.shape[1]))
    header = {**part_header(), "dataWindow": _box(raster.data), "displayWindow": _box(raster.display)}
    header |= {"pixelAspectRatio": float(raster.pixel_aspect)}
    with atomic_path(path, OPENEXR) as temporary, library_messages():
        OpenEXR.File(header, {name: np.ascontiguousarray(values, np.float32)}).write(str(temporary))


def write_png(path: PathLike, radiance: npt.ArrayLike) -> None:
    """Write an image as an 8-bit sRGB PNG for viewing, whatever its name; the file appears whole or not at all.

    Parameters
    ----------
    path : path
        Where to write; an existing file is replaced.
    radiance : array_like of shape (H, W, 3) or (H, W, 4)
        Linear values; premultiplied colours are shown over black, NaN as black.

    Raises
    ------
    InvalidFrameError
        If `radiance` is no such array.
    InvalidFileError
        If the file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> sp.write_png("image.png", np.full((4, 6, 3), 0.18))
    """
    _write_picture(path, image_array("radiance", radiance), PICTURES[".png"])


def _write_picture(path: PathLike, image: FloatArray, settings: Mapping[str, Any]) -> None:
    from PIL import Image as Picture

    pixels = dithered(np.nan_to_num(display_encode(image[..., :3])))
    with atomic_path(path, ".picture") as temporary:
        Picture.fromarray(pixels).save(temporary, **settings)


def dithered(values: FloatArray) -> npt.NDArray[np.uint8]:
    """Return values in [0, 1] as 8-bit numbers whose mean is right: between two steps, either by chance.

    Notes
    -----
    The chance is the same in every run. Values of whole steps stay what they are.
    """
    chance = np.random.default_rng(0).random(values.shape, np.float32)
    steps = 255 * values.astype(np.float64)
    nearest = np.rint(steps)
    exact = np.abs(steps - nearest) < 1e-3
    return np.where(exact, nearest, np.floor(steps + chance)).clip(0, 255).astype(np.uint8)


def _stored(image: FloatArray, half: bool) -> dict[str, npt.NDArray[Any]]:
    """Return the channels of an image by their names."""
    planes = {name: image[..., index] for index, name in enumerate("RGBA"[: image.shape[2]])}
    if half:
        return {name: np.clip(plane, -HALF_MAX, HALF_MAX).astype(np.float16) for name, plane in planes.items()}
    return planes


def _checked_metadata(metadata: Mapping[str, str | int | float]) -> dict[str, str | int | float]:
    """Return the metadata, or raise InvalidParameterError if the header cannot hold it."""
    for name, value in metadata.items():
        if name in FILE_ATTRIBUTES | WRITTEN_BY_LIBRARY:
            raise InvalidParameterError(f"metadata {name!r} is reserved: it describes the file itself")
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise InvalidParameterError(f"metadata {name!r} is {value!r}; it must be a string, an integer or a float")
    return dict(metadata)

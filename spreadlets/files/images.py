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
from spreadlets.errors import InvalidParameterError, option
from spreadlets.files.atomic import atomic_path
from spreadlets.files.attributes import FILE_ATTRIBUTES, WRITTEN_BY_LIBRARY, carry_attributes, chromaticities
from spreadlets.files.exr_file import library_messages
from spreadlets.files.exr_parts import part_header, raster_header
from spreadlets.files.png_tiff import in_steps, png_bytes, tiff_bytes
from spreadlets.scene.display import display_encode
from spreadlets.scene.frame import shown_array
from spreadlets.scene.primaries import to_rec_709
from spreadlets.scene.raster import Raster, placed

HALF_MAX = float(np.finfo(np.float16).max)

OPENEXR = ".exr"
BIT_DEPTHS: Mapping[str, tuple[int, ...]] = {
    ".png": (8, 16),
    ".jpg": (8,),
    ".jpeg": (8,),
    ".tif": (8, 16),
    ".tiff": (8, 16),
}
"""Bits of a value in pictures for viewing, by their extensions, the usual number first."""

JPEG: Mapping[str, Any] = {"format": "JPEG", "quality": 95, "subsampling": 0}
"""How Pillow is told to write them."""

EXTENSIONS = (OPENEXR, *BIT_DEPTHS)
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


def check_bit_depth(path: PathLike, bit_depth: int | None) -> None:
    """Raise InvalidParameterError unless the format of a path, which is none to refuse, can have so many bits."""
    allowed = BIT_DEPTHS.get(image_extension(path), (32, 16))
    if bit_depth is not None and bit_depth not in allowed:
        listed = " or ".join(map(str, sorted(allowed)))
        raise InvalidParameterError(f"{path}: {option('bit_depth')} is {bit_depth}; this format has {listed}")


def write_image(
    path: PathLike,
    radiance: npt.ArrayLike,
    *,
    half: bool = False,
    bit_depth: int | None = None,
    metadata: Mapping[str, str | int | float] | None = None,
    raster: Raster | None = None,
    channels: Mapping[str, npt.NDArray[Any]] | None = None,
) -> None:
    """Write an image; the file appears whole or not at all, and is what its extension says.

    Parameters
    ----------
    path : path
        Where to write; an existing file is replaced. ``.exr`` is OpenEXR; ``.png``, ``.jpg``, ``.jpeg``, ``.tif`` and
        ``.tiff`` are pictures for viewing: of the display window, sRGB of 8 or 16 bits, dithered, over black, NaN as
        black; from the primaries that the raster's chromaticities name.
    radiance : array_like of shape (H, W, 3) or (H, W, 4)
        Linear values, stored as R, G, B and A; or a picture (H, W, 3) of 8- or 16-bit integers in sRGB encoding, as
        `photo` returns for such.
    half : bool
        Store 16-bit floats (values beyond 65504 are clipped) instead of 32-bit ones; as ``bit_depth=16`` does.
    bit_depth : int, optional
        Of each value: 32 or 16 in OpenEXR, 8 or 16 in PNG and TIFF; by default the first.
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
        If no format has the extension, or it has not the bit depth, the metadata has a reserved name or a value of
        another type, or a picture for viewing is to hold `half`, `metadata` or `channels`.
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
    # Find the file's kind.
    image = shown_array("radiance", radiance)
    raster = raster or Raster.of_shape((image.shape[0], image.shape[1]))
    check_bit_depth(path, bit_depth)
    if image_extension(path) != OPENEXR:
        # Display pictures: what is seen, in the primaries of the screen.
        for name, value in (("half", half), ("metadata", metadata), ("channels", channels)):
            if value:
                raise InvalidParameterError(f"{path}: {name} is for OpenEXR; name it {OPENEXR}")
        shown = placed(image, raster.data, raster.display)[..., :3]
        own = chromaticities(raster.attributes)
        _write_picture(path, shown if own is None else to_rec_709(shown, own), image_extension(path), bit_depth or 8)
        return
    # OpenEXR: windows, header and channels, then the attributes of the file that was read.
    header = {**_checked_metadata(metadata or {}), **part_header()}
    window = raster.written(image)
    stored = _stored(placed(image, raster.data, window), half or bit_depth == 16)
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
    header = part_header() | raster_header(raster, raster.data)
    with atomic_path(path, OPENEXR) as temporary, library_messages():
        OpenEXR.File(header, {name: np.ascontiguousarray(values, np.float32)}).write(str(temporary))


def write_png(path: PathLike, radiance: npt.ArrayLike) -> None:
    """Write an image as an 8-bit sRGB PNG for viewing, whatever its name; the file appears whole or not at all.

    Parameters
    ----------
    path : path
        Where to write; an existing file is replaced.
    radiance : array_like of shape (H, W, 3) or (H, W, 4)
        Linear values, or a picture, as for `write_image`; premultiplied colours are shown over black, NaN as black.

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
    _write_picture(path, shown_array("radiance", radiance), ".png", 8)


def _write_picture(path: PathLike, image: FloatArray, extension: str, bits: int) -> None:
    pixels = in_steps(np.nan_to_num(display_encode(image[..., :3])), bits)
    with atomic_path(path, ".picture") as temporary:
        if extension == ".png":
            temporary.write_bytes(png_bytes(pixels))
        elif extension in (".tif", ".tiff"):
            temporary.write_bytes(tiff_bytes(pixels))
        else:
            from PIL import Image as Picture

            Picture.fromarray(pixels).save(temporary, **JPEG)


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

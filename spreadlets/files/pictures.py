"""Photographs and maps that go with them: pictures as linear light, and planes of one value for each pixel."""

from __future__ import annotations

import io
import os
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import PurePath
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray, PathLike
from spreadlets.errors import InvalidFileError, MissingPackageError
from spreadlets.files.colour_spaces import to_linear
from spreadlets.files.exr_file import library_messages
from spreadlets.files.exr_frames import read_image
from spreadlets.packages import optional_package
from spreadlets.scene.display import display_decode

MOST_PIXELS = 1 << 28
"""Largest picture that is unpacked, 268 megapixels: more than any camera takes."""

EXIF, FOCAL_LENGTH, FOCAL_LENGTH_35MM, F_NUMBER = 0x8769, 0x920A, 0xA405, 0x829D
"""Tags of a photograph: the camera's, and in it those of the lens."""

PLANE_NAMES = ("Z", "depth.Z", "depth", "disparity", "Y", "A", "R", "V")
"""Channels of an OpenEXR file that may hold a plane, the likeliest first."""


PROFILED = {"GRAY": ("L", ("L", "LA")), "CMYK": ("CMYK", ("CMYK",))}
"""Colours of a profile other than RGB: the mode that it is applied to, and those of pictures that have it."""


OPAQUE = 255
"""Alpha of 8 bits that lets nothing through."""
MOST_TINT = 0.1
"""Difference between the colours of a pixel, of 1, up to which a plane is grey: JPEG changes grey by less than .02."""


class Picture(NamedTuple):
    """A photograph.

    Attributes
    ----------
    radiance : ndarray of shape (H, W, 3), float32
        Linear light in the primaries of sRGB, upright.
    focal_length_35mm : float or None
        Focal length for a film 36 mm wide, mm, if the file tells it.
    f_number : float or None
    """

    radiance: FloatArray
    focal_length_35mm: float | None = None
    f_number: float | None = None


def read_picture(path: PathLike, space: str | None = None) -> Picture:
    """Read a photograph: OpenEXR and NumPy as linear light, all else as its colour profile says, or else as sRGB.

    Parameters
    ----------
    path : path
        What Pillow reads (PNG, JPEG, TIFF, WebP, and HEIC with the package ``pillow_heif``), ``.exr`` or ``.npy``.
    space : str, optional
        The colour space that its values are in, see `spreadlets.files.colour_spaces`; a profile is then ignored.

    Returns
    -------
    Picture
        Turned upright as EXIF says.

    Raises
    ------
    InvalidFileError
        If the file cannot be read.
    InvalidParameterError
        If there is no such colour space.
    """
    extension = PurePath(os.fspath(path)).suffix.lower()
    found: Picture
    if extension == ".exr":
        found = Picture(np.ascontiguousarray(read_image(path)[..., :3]))
    elif extension == ".npy":
        found = Picture(_colours(path, _read_numpy(path), as_stored=space is not None))
    else:
        found = _opened(path, partial(_photograph, as_stored=space is not None))
    return found if space is None else found._replace(radiance=to_linear(found.radiance, space))


def read_plane(path: PathLike, *, in_metres: bool = False) -> FloatArray:
    """Read one value for each pixel: a depth, a disparity, or a mask.

    Parameters
    ----------
    path : path
        ``.npy``, OpenEXR, PFM, or a grey picture: PNG of 8 or 16 bits, TIFF of integers or floats. Integers of a
        picture are divided by their largest value; colours are averaged.
    in_metres : bool
        Whether the values are to have a unit: then pictures of integers are refused.

    Returns
    -------
    ndarray of shape (H, W), float32

    Raises
    ------
    InvalidFileError
        If the file cannot be read, or holds no plane.
    """
    extension = PurePath(os.fspath(path)).suffix.lower()
    readers: dict[str, Callable[[PathLike], npt.NDArray[Any]]] = {
        ".npy": _read_numpy,
        ".exr": _exr_plane,
        ".pfm": _read_pfm,
    }
    values = readers[extension](path) if extension in readers else _opened(path, partial(_grey, in_metres=in_metres))
    if values.ndim != 2 or not values.size:
        raise InvalidFileError(f"{path}: has the shape {values.shape}; needed is one value for each pixel, (H, W)")
    return np.ascontiguousarray(values, np.float32)


def _opened(path: PathLike, read: Callable[[PathLike, Any], Any]) -> Any:
    """Return what is read of a file that Pillow opens."""
    from PIL import Image

    if PurePath(os.fspath(path)).suffix.lower() in (".heic", ".heif", ".avif"):
        _register_heif(path)
    try:
        with Image.open(path) as image:
            if image.width * image.height > MOST_PIXELS:
                raise InvalidFileError(f"{path}: has {image.width} x {image.height} px; at most {MOST_PIXELS} are read")
            return read(path, image)
    except InvalidFileError:
        raise
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise InvalidFileError(f"{path}: cannot be read as a picture: {_reason(error)}") from error


def _reason(error: Exception) -> str:
    """Return why a file cannot be read, without its name."""
    return getattr(error, "strerror", None) or str(error)


def _register_heif(path: PathLike) -> None:
    try:
        optional_package("pillow_heif", "photo", f"{path}: HEIC").register_heif_opener()
    except MissingPackageError as error:
        raise InvalidFileError(str(error)) from error


def _photograph(path: PathLike, image: Any, *, as_stored: bool) -> Picture:
    """Return an open picture, upright: as linear light, or the values that are stored, as shares of the largest."""
    from PIL import ImageOps

    _warn_of_loss(path, image)
    focal_length, f_number = _lens(image)
    profile = image.info.get("icc_profile")
    image = ImageOps.exif_transpose(image)
    encoded: npt.NDArray[Any]
    if image.mode.startswith("I;16") or image.mode in ("I", "F"):
        grey = _unit(np.asarray(image))
        encoded = np.repeat(grey[..., None], 3, axis=2)
    else:
        encoded = np.asarray(image.convert("RGB") if as_stored else _in_srgb(path, image, profile))
    return Picture(_unit(encoded) if as_stored else display_decode(encoded), focal_length, f_number)


def _warn_of_loss(path: PathLike, image: Any) -> None:
    """Warn of what a picture holds that is not read of it."""
    if image.mode in ("RGB", "RGBA") and any(";16" in str(tile[-1]) for tile in image.tile):
        warnings.warn(f"{path}: of its 16 bits only 8 are read; OpenEXR and NPY are read in full", stacklevel=2)
    if image.has_transparency_data and image.convert("RGBA").getextrema()[3][0] < OPAQUE:
        warnings.warn(f"{path}: its alpha is left out: photographs are opaque", stacklevel=2)


def _in_srgb(path: PathLike, image: Any, profile: bytes | None) -> Any:
    """Return a picture whose colours are those of sRGB, from those of its profile."""
    if not profile:
        return image.convert("RGB")
    from PIL import ImageCms

    try:
        own = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        mode, modes = PROFILED.get(own.profile.xcolor_space.strip(), ("RGB", ()))
        image = image.convert(mode if image.mode in modes else "RGB")
        return ImageCms.profileToProfile(image, own, ImageCms.createProfile("sRGB"), outputMode="RGB")
    except (OSError, ImageCms.PyCMSError) as error:
        raise InvalidFileError(f"{path}: its colour profile cannot be used: {error}") from error


def _lens(image: Any) -> tuple[float | None, float | None]:
    """Return the focal length for a film 36 mm wide, and the f-number, of what EXIF says."""
    tags = image.getexif().get_ifd(EXIF)

    def number(tag: int) -> float | None:
        try:
            value = float(tags[tag])
        except (KeyError, TypeError, ValueError, ZeroDivisionError):
            return None
        return value if np.isfinite(value) and value > 0.0 else None

    return number(FOCAL_LENGTH_35MM), number(F_NUMBER)


def _grey(path: PathLike, image: Any, *, in_metres: bool) -> FloatArray:
    """Return an open picture as one value for each pixel, upright."""
    from PIL import ImageOps

    values = np.asarray(ImageOps.exif_transpose(image))
    if in_metres and values.dtype.kind != "f":
        raise InvalidFileError(f"{path}: its integers have no unit; give metres as floats: NPY, TIFF, PFM or OpenEXR")
    if image.mode in ("P", "1", "CMYK", "YCbCr", "LAB", "HSV"):
        values = np.asarray(image.convert("L"))
    if values.ndim == 3:
        # Alpha alone tells nothing of the depth.
        n_colours = values.shape[2] - (1 if image.mode in ("LA", "RGBA", "PA") else 0)
        colours = _unit(values)[..., :n_colours]
        if np.ptp(colours, axis=2).max(initial=0.0) > MOST_TINT:
            warnings.warn(f"{path}: is coloured, and read as grey; false colours do not tell the depth", stacklevel=2)
        return np.asarray(colours.mean(axis=2), np.float32)
    return _unit(values)


def _unit(values: npt.NDArray[Any]) -> FloatArray:
    """Return integers as shares of the largest that they can be; floats as they are."""
    if values.dtype.kind == "f":
        return values.astype(np.float32)
    most = 65535 if values.dtype.itemsize > 1 else 255
    return values.astype(np.float32) / np.float32(most)


def _read_numpy(path: PathLike) -> npt.NDArray[Any]:
    try:
        values = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise InvalidFileError(f"{path}: cannot be read as an array of NumPy: {_reason(error)}") from error
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiu":
        raise InvalidFileError(f"{path}: holds no array of numbers")
    return values


def _colours(path: PathLike, values: npt.NDArray[Any], *, as_stored: bool) -> FloatArray:
    """Return an array as linear light: integers are sRGB, floats are linear; or the values that are stored."""
    if values.ndim != 3 or values.shape[2] not in (3, 4):
        raise InvalidFileError(f"{path}: has the shape {values.shape}; a picture is (H, W, 3)")
    if values.dtype.kind != "f" and values.dtype not in (np.uint8, np.uint16):
        raise InvalidFileError(f"{path}: has dtype {values.dtype}; a picture is of uint8, uint16, or linear floats")
    colours = values[..., :3]
    return _unit(colours) if as_stored or values.dtype.kind == "f" else display_decode(_unit(colours))


def _exr_plane(path: PathLike) -> npt.NDArray[Any]:
    import OpenEXR

    try:
        with library_messages(), OpenEXR.File(os.fspath(path), separate_channels=True) as file:
            channels = {name: channel.pixels for name, channel in file.parts[0].channels.items()}
    except (OSError, RuntimeError, ValueError) as error:
        raise InvalidFileError(f"{path}: cannot be read as OpenEXR: {error}") from error
    for name in PLANE_NAMES:
        if name in channels:
            return np.asarray(channels[name])
    if len(channels) == 1:
        return np.asarray(next(iter(channels.values())))
    raise InvalidFileError(f"{path}: none of its channels is a plane: found are {', '.join(sorted(channels))}")


def _read_pfm(path: PathLike) -> npt.NDArray[Any]:
    """Read a portable float map of one channel, its rows from bottom to top."""
    try:
        with open(path, "rb") as file:
            kind, sizes, scale = (file.readline(80) for _ in range(3))
            width, height = map(int, sizes.split())
            order = "<f4" if float(scale) < 0.0 else ">f4"
            data = file.read()
        if kind.strip() != b"Pf" or not 0 < width * height <= MOST_PIXELS or len(data) < 4 * width * height:
            raise ValueError("it is no portable float map of one channel, or truncated")
        return np.frombuffer(data, order, width * height).reshape(height, width)[::-1].astype(np.float32)
    except (OSError, ValueError) as error:
        raise InvalidFileError(f"{path}: cannot be read: {_reason(error)}") from error

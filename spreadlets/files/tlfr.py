"""Sample buffers of *Temporal Light Field Reconstruction* (TLFR; Lehtinen et al. 2011), version 1.3, in and out.

A buffer is a pair of files, ``NAME`` and ``NAME.header``, or one file that starts with its header. From the README and
the sources of the authors' release:

- The header's lines are ``Version 1.3``, ``Width``, ``Height``, ``Samples per pixel``, ``Motion model:``, ``CoC
  coefficients (coc radius = C0/w+C1):``, ``Encoding = text`` or ``binary``, and the names of the columns.
- A sample is 16 floats: `COLUMNS`. Text has a sample per line, separated by commas (one may end the line); binary is
  the same as little-endian float32, without gaps. Samples are ordered by row, column, sample.
- x, y are in pixels, the centre of the first pixel being (.5, .5); w is camera-space depth, u and v are in [-1, 1],
  t in [0, 1] over the shutter, and r, g, b linear. z/w and alpha are unused (their writer stores blue as alpha).
- ``coc = C0/w + C1``, negative in front of focus, and a sample lies at ``xy = xy(lens centre) + coc * uv``.
- mv is the change of ``(x w, y w, w)`` from the shutter's opening to its closing: a point moves by
  ``(xy w)(t') = (xy w)(t) + (t' - t) mv_xy`` and ``w(t') = w(t) + (t' - t) mv_w``. The motion model is
  ``perspective`` or, in older files, ``affine``; their reader treats both alike.

Our reading, where the release says nothing: y points down; samples that are not in the order above are sorted into the
pixels that their x, y name, so that pixels may hold different numbers; the motion is the mean over the shutter, taken
at the lens's centre, and its halves are kept where w changes; alpha is 1.
"""

from __future__ import annotations

import os
import re
import warnings
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray, PathLike
from spreadlets.errors import InvalidFileError, InvalidFrameError, InvalidParameterError
from spreadlets.files.atomic import atomic_path
from spreadlets.files.exr_file import MAX_VALUES
from spreadlets.files.kinds import TLFR, file_kind, open_file
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.samples import SampleBuffer

HEADER_SUFFIX = ".header"
COLUMNS = ("x", "y", "z/w", "w", "u", "v", "t", "r", "g", "b", "a", "mv_x", "mv_y", "mv_w", "dwdx", "dwdy")
VERSION = "1.3"
MAX_HEADER_BYTES = 1 << 16
MAX_NUMBER_BYTES = 64
"""Characters that a number may take on average, with its separator; a longer text file is not what its header says."""
BLOCK_BYTES = 1 << 24

PLACE_TOLERANCE = 1e-3
"""px by which a sample may leave its pixel: text files round to six digits."""
TIME_TOLERANCE = 1e-4
COC_TOLERANCE = 1e-3
"""px by which CoC radii may differ from ``C0/w + C1``, and relative for large ones."""
FAR_W = np.float32(1e10)
"""Depth that stands for the background, whose products with x and y must stay finite."""


@dataclass(frozen=True)
class _Header:
    """What a header says, and at which byte of the file the samples start."""

    width: int
    height: int
    samples: int
    coc: tuple[float, float]
    binary: bool
    start: int = 0

    @property
    def n_samples(self) -> int:
        return self.width * self.height * self.samples


def is_tlfr(source: PathLike | BinaryIO) -> bool:
    """Tell whether a file is a TLFR buffer: whether there is a header beside it, or it starts with one."""
    path = source if isinstance(source, str | os.PathLike) else source.name
    return os.path.isfile(os.fspath(path) + HEADER_SUFFIX) or file_kind(source) == TLFR


def read_tlfr(file: BinaryIO, *, shutter: tuple[float, float] | None = None, repair: bool = False) -> SampleBuffer:
    """Read a TLFR sample buffer, text or binary.

    Parameters
    ----------
    file : binary file
        The samples; their header is the file ``NAME.header``, or stands at the start of this one.
    shutter : tuple of two floats, optional
        ``(open, close)`` in frames from the frame's time, as in the camera that will be used; by default that of
        `ThinLens`.
    repair : bool
        Drop invalid samples instead of raising, see `SampleBuffer`.

    Returns
    -------
    SampleBuffer
        With `coc_radius`, and with `motion_prev` and `motion_next` if some depth changes over the shutter.

    Raises
    ------
    InvalidFileError
        If a file is missing, malformed, of another version or size than the header says, or too large.
    InvalidFrameError
        If the values are invalid.
    InvalidParameterError
        If the shutter does not stay open.
    """
    # Read the table, and sort its samples into their pixels.
    opens, closes = _checked_shutter(shutter or ThinLens.shutter)
    header = _read_header(file)
    table = _read_binary(file, header) if header.binary else _read_text(file, header)
    samples, valid = _in_pixels(file.name, table, header)
    column = {name: samples[..., index] for index, name in enumerate(COLUMNS)}
    # Convert it to our labels.
    lens = samples[..., 4:6]
    with np.errstate(all="ignore"):  # bad values are found by the validation
        coc = header.coc[0] / column["w"] + header.coc[1]
        motion = _motion_over_shutter(samples, coc, closes - opens)
    rows, cols = np.mgrid[: header.height, : header.width].astype(np.float32)
    return SampleBuffer(
        samples[..., 7:10],
        column["w"],
        motion["motion"],
        lens_uv=lens,
        time=opens + column["t"] * (closes - opens),
        offset=np.stack([column["x"] - cols[..., None], column["y"] - rows[..., None]], axis=3) - np.float32(0.5),
        valid=valid,
        coc_radius=coc,
        motion_prev=motion.get("motion_prev"),
        motion_next=motion.get("motion_next"),
        repair=repair,
    )


def write_tlfr(
    path: PathLike,
    samples: SampleBuffer,
    *,
    camera: ThinLens | None = None,
    binary: bool = True,
) -> None:
    """Write a TLFR sample buffer: ``PATH`` and ``PATH.header``; each file appears whole or not at all.

    Parameters
    ----------
    path : path
        Where to write; existing files are replaced.
    samples : SampleBuffer
        Every pixel must hold the same number of samples. Alpha is stored, though readers ignore it; infinite depth is
        stored as 1e10.
    camera : ThinLens, optional
        For the shutter (by default that of `ThinLens`) and, if the buffer has no `coc_radius`, the CoC coefficients.
    binary : bool
        Encode as little-endian float32 instead of text.

    Raises
    ------
    InvalidFrameError
        If some samples are missing, their times lie outside the shutter, or their CoC radii are not those of one lens.
    InvalidParameterError
        If the buffer has no `coc_radius` and there is no camera.
    InvalidFileError
        If a file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> lens_uv = np.random.default_rng(0).uniform(-0.7, 0.7, (4, 6, 2, 2))
    >>> samples = sp.SampleBuffer(np.ones((4, 6, 2, 3)), np.ones((4, 6, 2)), 0 * lens_uv, lens_uv, np.zeros((4, 6, 2)))
    >>> camera = sp.ThinLens(focal_length_mm=80, sensor_width_mm=36, f_number=2, focus_distance_m=2)
    >>> sp.write_tlfr("samples", samples, camera=camera)
    >>> sp.read_samples("samples", camera=camera).n_samples
    2
    """
    # Check what the format cannot hold.
    if not samples.valid.all():
        missing = int(np.count_nonzero(~samples.valid))
        raise InvalidFrameError(f"{missing} samples are missing; TLFR needs the same number in every pixel")
    shutter = _checked_shutter(ThinLens.shutter if camera is None else camera.shutter)
    coefficients = _coc_coefficients(samples, camera)
    # Lay out the table and its header.
    table = _table(samples, shutter, coefficients).reshape(-1, len(COLUMNS))
    height, width = samples.shape
    header = (
        f"Version {VERSION}\nWidth {width}\nHeight {height}\nSamples per pixel {samples.n_samples}\n"
        f"Motion model: perspective\n"
        f"CoC coefficients (coc radius = C0/w+C1): {coefficients[0]:.9g},{coefficients[1]:.9g}\n"
        f"Encoding = {'binary' if binary else 'text'}\n{','.join(COLUMNS)}\n"
    )
    # Write both.
    with atomic_path(path, ".tlfr") as temporary:
        if binary:
            table.astype("<f4").tofile(temporary)
        else:
            np.savetxt(temporary, table, fmt="%.9g", delimiter=",")
    with atomic_path(os.fspath(path) + HEADER_SUFFIX, HEADER_SUFFIX) as temporary:
        temporary.write_text(header, encoding="ascii")


def _checked_shutter(shutter: tuple[float, float]) -> tuple[float, float]:
    if not shutter[1] > shutter[0]:
        raise InvalidParameterError(f"the shutter is {shutter}; TLFR counts time over it, so it must stay open")
    return shutter


# --- Reading -------------------------------------------------------------------------------------------------------


def _read_header(file: BinaryIO) -> _Header:
    """Return the parsed header; it is checked before any sample is read."""
    name, beside, start = file.name, file.name + HEADER_SUFFIX, 0
    if os.path.isfile(beside):
        with open_file(beside) as header_file:
            name, text = beside, _header_text(header_file)
    else:
        text = _header_text(file)
        columns = re.search(rf"^{re.escape(','.join(COLUMNS))}\r?\n", text, re.MULTILINE)
        if columns is None:
            raise InvalidFileError(
                f"{name}: its header must end with a line that names the columns {','.join(COLUMNS)}"
            )
        start = columns.end()
        text = text[:start]
    if len(text) > MAX_HEADER_BYTES:
        raise InvalidFileError(f"{name}: is larger than {MAX_HEADER_BYTES} bytes: this is not a TLFR header")
    # Parse its entries.
    version = _entry(name, text, r"Version\s+(\S+)", "Version")
    if version != VERSION:
        raise InvalidFileError(f"{name}: is of version {version}; only {VERSION} can be read")
    width, height, samples = (
        int(_entry(name, text, rf"{key}\s+(\d{{1,9}})", key)) for key in ("Width", "Height", "Samples per pixel")
    )
    pair = _entry(name, text, r"CoC coefficients[^:\n]*:\s*([^\n]+)", "CoC coefficients").split(",")
    encoding = re.search(r"^Encoding\s*=\s*(\S+)", text, re.MULTILINE | re.IGNORECASE)
    word = encoding.group(1).lower() if encoding else "text"
    if word not in ("text", "binary"):
        raise InvalidFileError(f"{name}: Encoding is {word!r}; allowed are text, binary")
    if text.rstrip().splitlines()[-1].replace(" ", "") != ",".join(COLUMNS):
        raise InvalidFileError(f"{name}: the last line must name the columns {','.join(COLUMNS)}")
    try:
        coc = float(pair[0]), float(pair[1])
    except (ValueError, IndexError):
        raise InvalidFileError(f"{name}: the CoC coefficients are {','.join(pair)!r}; two numbers are needed") from None
    # Check the size that it promises.
    header = _Header(width, height, samples, coc, word == "binary", start)
    if not 0 < header.n_samples * len(COLUMNS) <= MAX_VALUES:
        raise InvalidFileError(
            f"{name}: promises {header.n_samples} samples of {len(COLUMNS)} numbers; "
            f"1 to {MAX_VALUES // len(COLUMNS)} samples are read"
        )
    return header


def _header_text(file: BinaryIO) -> str:
    """Return what a header may be, and one character more, from a file's beginning."""
    file.seek(0)
    return file.read(MAX_HEADER_BYTES + 1).decode("latin-1")  # a byte a character: places are byte offsets


def _entry(name: str, text: str, pattern: str, key: str) -> str:
    """Return the value of one header line."""
    found = re.search(rf"^{pattern}\s*$", text, re.MULTILINE | re.IGNORECASE)
    if found is None:
        raise InvalidFileError(f"{name}: lacks a valid line {key!r}")
    return found.group(1)


def _read_binary(file: BinaryIO, header: _Header) -> FloatArray:
    """Return the samples of a binary file, (n, 16)."""
    expected = header.n_samples * len(COLUMNS) * 4
    size = _size(file) - header.start
    if size != expected:
        raise InvalidFileError(f"{file.name}: has {size} bytes; its header promises {expected}")
    file.seek(header.start)
    return np.frombuffer(file.read(expected), "<f4").astype(np.float32, copy=False).reshape(-1, len(COLUMNS))


def _read_text(file: BinaryIO, header: _Header) -> FloatArray:
    """Return the samples of a text file, (n, 16), parsed in blocks of lines."""
    count = header.n_samples * len(COLUMNS)
    size = _size(file) - header.start
    if not 2 * count - 1 <= size <= MAX_NUMBER_BYTES * count:
        raise InvalidFileError(f"{file.name}: has {size} bytes, which cannot be the {count} numbers of its header")
    table = np.empty(count, np.float32)
    done = 0
    file.seek(header.start)
    while block := file.read(BLOCK_BYTES):
        values = _numbers(file.name, block + file.readline(MAX_NUMBER_BYTES * len(COLUMNS)))
        if done + values.size > count:
            raise InvalidFileError(f"{file.name}: holds more than the {count} numbers that its header promises")
        table[done : done + values.size] = values
        done += values.size
    if done != count:
        raise InvalidFileError(f"{file.name}: holds {done} numbers; its header promises {count}")
    return table.reshape(-1, len(COLUMNS))


def _numbers(path: PathLike, text: bytes) -> FloatArray:
    """Return the numbers of some lines."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # how NumPy reports what it cannot parse
        try:
            return np.fromstring(text.replace(b",", b" ").decode("ascii"), np.float32, sep=" ")
        except (ValueError, DeprecationWarning):
            raise InvalidFileError(f"{path}: holds something that is not a number separated by commas") from None


def _size(file: BinaryIO) -> int:
    return os.fstat(file.fileno()).st_size


def _in_pixels(path: PathLike, table: FloatArray, header: _Header) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Return the samples by pixel, (H, W, S, 16), and which of them are there."""
    x, y = table[:, 0], table[:, 1]
    inside = (x >= 0) & (x <= header.width) & (y >= 0) & (y <= header.height)
    if not inside.all():
        index = int(np.argmin(inside))
        raise InvalidFileError(
            f"{path}: x or y is outside the image at {np.count_nonzero(~inside)} of {inside.size} samples, first at "
            f"sample {index}: ({x[index]:g}, {y[index]:g}); allowed: 0 to {header.width}, 0 to {header.height}"
        )
    shape = (header.height, header.width, header.samples, len(COLUMNS))
    ordered = table.reshape(shape)
    rows, cols = np.mgrid[: header.height, : header.width] + 0.5
    away = np.abs(ordered[..., 0] - cols[..., None]), np.abs(ordered[..., 1] - rows[..., None])
    if max(away[0].max(), away[1].max()) <= 0.5 + PLACE_TOLERANCE:
        return ordered, np.ones(shape[:3], np.bool_)
    return _sorted_into_pixels(path, table, header)


def _sorted_into_pixels(path: PathLike, table: FloatArray, header: _Header) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Return samples in any order by the pixel that holds them; their order within a pixel stays."""
    col = np.minimum(table[:, 0].astype(np.int64), header.width - 1)
    row = np.minimum(table[:, 1].astype(np.int64), header.height - 1)
    pixel = row * header.width + col
    counts = np.bincount(pixel, minlength=header.width * header.height)
    most = int(counts.max())
    if counts.size * most * len(COLUMNS) > MAX_VALUES:
        raise InvalidFileError(f"{path}: {most} samples lie in one pixel; that is too many to give all pixels room for")
    order = np.argsort(pixel, kind="stable")
    slot = np.arange(len(table)) - np.repeat(np.cumsum(counts) - counts, counts)
    samples = np.zeros((counts.size, most, len(COLUMNS)), np.float32)
    valid = np.zeros((counts.size, most), np.bool_)
    samples[pixel[order], slot] = table[order]
    valid[pixel[order], slot] = True
    shape = (header.height, header.width, most)
    return samples.reshape(*shape, len(COLUMNS)), valid.reshape(shape)


def _motion_over_shutter(samples: FloatArray, coc: FloatArray, duration: float) -> dict[str, FloatArray]:
    """Return the motion in px per frame, at the centre of the lens: over the shutter and, if w changes, its halves."""
    w, t = samples[..., 3].astype(np.float64), samples[..., 6].astype(np.float64)
    homogeneous = (samples[..., 0:2] - coc[..., None] * samples[..., 4:6]) * w[..., None]
    velocity, dw = samples[..., 11:13].astype(np.float64), samples[..., 13].astype(np.float64)

    def place(when: float) -> npt.NDArray[np.float64]:
        passed = when - t
        at = w + passed * dw
        return np.where(at > 0, 1 / at, np.nan)[..., None] * (homogeneous + passed[..., None] * velocity)

    opening, middle, closing = place(0.0), place(0.5), place(1.0)
    motion = {"motion": (closing - opening) / duration}
    if dw.any():
        motion |= {"motion_prev": (middle - opening) * 2 / duration, "motion_next": (closing - middle) * 2 / duration}
    return {name: values.astype(np.float32) for name, values in motion.items()}


# --- Writing -------------------------------------------------------------------------------------------------------


def _coc_coefficients(samples: SampleBuffer, camera: ThinLens | None) -> tuple[float, float]:
    """Return C0 and C1: from the buffer's own radii, or from the camera."""
    if samples.coc_radius is None:
        if camera is None:
            raise InvalidParameterError("the buffer has no coc_radius; the CoC coefficients need the camera")
        scale = camera.coc_scale(samples.raster.display.width)
        return -scale, scale / camera.focus_distance_m
    inverse = 1 / np.minimum(samples.depth, FAR_W).astype(np.float64).ravel()
    radius = samples.coc_radius.astype(np.float64).ravel()
    columns = np.stack([inverse, np.ones_like(inverse)], axis=1)
    c0, c1 = np.linalg.lstsq(columns, radius, rcond=None)[0]
    error = np.abs(columns @ (c0, c1) - radius)
    if (error > COC_TOLERANCE * np.maximum(1, np.abs(radius))).any():
        raise InvalidFrameError(f"coc_radius is up to {error.max():.3g} px off C0/w + C1; it must be of one lens")
    return float(c0), float(c1)


def _table(samples: SampleBuffer, shutter: tuple[float, float], coefficients: tuple[float, float]) -> FloatArray:
    """Return the 16 columns of every sample, (H, W, S, 16)."""
    # Scale time to 0 to 1 over the shutter.
    duration = shutter[1] - shutter[0]
    t = (samples.time.astype(np.float64) - shutter[0]) / duration
    if ((t < -TIME_TOLERANCE) | (t > 1 + TIME_TOLERANCE)).any():
        raise InvalidFrameError(
            f"time spans {samples.time.min():g} to {samples.time.max():g} frames; TLFR holds times in the shutter, "
            f"{shutter[0]:g} to {shutter[1]:g}"
        )
    t = np.clip(t, 0, 1)
    # Place the samples on the screen.
    rows, cols = np.mgrid[: samples.shape[0], : samples.shape[1]] + 0.5
    xy = samples.offset + np.stack([cols, rows], axis=2)[:, :, None]
    w = np.minimum(samples.depth, FAR_W).astype(np.float64)
    # Turn the path on the screen into a velocity in space: places are projected by 1 / w.
    dw = _depth_change(samples, w, t)
    centre = xy - (coefficients[0] / w + coefficients[1])[..., None] * samples.lens_uv
    ends = ((w - t * dw) * (w + (1 - t) * dw))[..., None]
    velocity = (duration * samples.motion * ends + (centre * (w * dw)[..., None])) / w[..., None]
    # Fill the columns.
    table = np.zeros((*samples.depth.shape, len(COLUMNS)), np.float32)
    table[..., 0:2], table[..., 3], table[..., 4:6], table[..., 6] = xy, w, samples.lens_uv, t
    table[..., 7:11], table[..., 11:13], table[..., 13] = samples.radiance, velocity, dw
    return table


def _depth_change(
    samples: SampleBuffer, w: npt.NDArray[np.float64], t: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Return the change of w over the shutter: a point's speeds in its two halves are as w at closing to w at opening.

    The ratio r = w(0)/w(1) with w(0) = w - t dw and w(1) = w + (1 - t) dw gives dw.
    """
    if samples.motion_prev is None or samples.motion_next is None:
        return np.zeros_like(w)
    before, after = samples.motion_prev.astype(np.float64), samples.motion_next.astype(np.float64)
    speed = (before**2).sum(axis=3)
    ratio = np.divide((before * after).sum(axis=3), speed, out=np.ones_like(speed), where=speed > 0)
    ratio = np.where(ratio > 0, ratio, 1.0)  # a path that turns back is no straight path in space
    return np.asarray(w * (1 - ratio) / (t + ratio * (1 - t)))

"""Pictures of 8 or 16 bits as PNG and TIFF, which Pillow writes with 8 only."""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np
import numpy.typing as npt

Pixels = npt.NDArray[Any]
"""Of uint8 or uint16."""

PNG_START = b"\x89PNG\r\n\x1a\n"
PNG_RGB = 2
"""Type of colour."""
PNG_SUB = 1
"""Filter of a row: each byte less that of the pixel before."""
PERCEPTUAL = 0
"""Rendering intent of a PNG's sRGB."""

TIFF_HEADER_BYTES = 8
TIFF_SHORT, TIFF_LONG = 3, 4
"""Types of a TIFF's fields."""
DEFLATE, RGB, DIFFERENCES = 8, 2, 2
"""Values of a TIFF's fields: compression, photometric interpretation, predictor."""


def png_bytes(pixels: Pixels) -> bytes:
    """Return an image (H, W, 3), encoded as sRGB, as a PNG of as many bits as its values have.

    Notes
    -----
    PNG specification, third edition: big-endian samples; a row is its filter's number and its filtered bytes.
    """
    height, width, channels = pixels.shape
    rows = np.ascontiguousarray(pixels.astype(pixels.dtype.newbyteorder(">"))).view(np.uint8).reshape(height, -1)
    step = channels * pixels.itemsize
    filtered = np.empty((height, 1 + rows.shape[1]), np.uint8)
    filtered[:, 0], filtered[:, 1 : 1 + step] = PNG_SUB, rows[:, :step]
    np.subtract(rows[:, step:], rows[:, :-step], out=filtered[:, 1 + step :])
    shape = struct.pack(">IIBBBBB", width, height, 8 * pixels.itemsize, PNG_RGB, 0, 0, 0)
    chunks = (
        (b"IHDR", shape),
        (b"sRGB", bytes([PERCEPTUAL])),
        (b"IDAT", zlib.compress(filtered.tobytes())),
        (b"IEND", b""),
    )
    return PNG_START + b"".join(map(_png_chunk, *zip(*chunks, strict=True)))


def _png_chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def tiff_bytes(pixels: Pixels) -> bytes:
    """Return an image (H, W, 3) as a TIFF of as many bits as its values have, in one deflated strip.

    Notes
    -----
    TIFF 6.0, little-endian; Adobe's deflate, after the differences of neighbours along a row.
    """
    height, width, channels = pixels.shape
    differences = pixels.astype(pixels.dtype.newbyteorder("<"))
    differences[:, 1:] -= pixels[:, :-1]
    strip = zlib.compress(differences.tobytes())
    strip += b"\0" * (len(strip) % 2)  # what follows begins at an even place
    bits_at = TIFF_HEADER_BYTES + len(strip)
    bits = struct.pack(f"<{channels}H", *[8 * pixels.itemsize] * channels)
    fields: list[tuple[int, int, int, int]] = [
        (256, TIFF_LONG, 1, width),
        (257, TIFF_LONG, 1, height),
        (258, TIFF_SHORT, channels, bits_at),
        (259, TIFF_SHORT, 1, DEFLATE),
        (262, TIFF_SHORT, 1, RGB),
        (273, TIFF_LONG, 1, TIFF_HEADER_BYTES),
        (277, TIFF_SHORT, 1, channels),
        (278, TIFF_LONG, 1, height),
        (279, TIFF_LONG, 1, len(strip)),
        (317, TIFF_SHORT, 1, DIFFERENCES),
    ]
    directory = struct.pack("<H", len(fields)) + b"".join(struct.pack("<HHII", *field) for field in fields) + bytes(4)
    return b"II*\0" + struct.pack("<I", bits_at + len(bits)) + strip + bits + directory


def in_steps(values: npt.NDArray[np.floating[Any]], bits: int) -> Pixels:
    """Return values in [0, 1] as numbers of so many bits whose mean is right: between two steps, either by chance.

    Notes
    -----
    The chance is the same in every run. Values of whole steps stay what they are.
    """
    chance = np.random.default_rng(0).random(values.shape, np.float32)
    most = (1 << bits) - 1
    steps = most * values.astype(np.float64)
    nearest = np.rint(steps)
    exact = np.abs(steps - nearest) < 1e-3 * most / 255  # what float32 tells apart
    return np.where(exact, nearest, np.floor(steps + chance)).clip(0, most).astype(np.uint8 if bits == 8 else np.uint16)

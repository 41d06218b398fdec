"""Mutated files through every reader: each must end in a value that the file says, or in one of our errors.

Files of each kind are written, then damaged: bits flipped, numbers replaced, pieces cut out, doubled, moved, truncated;
databases also by valid writes of bad values. They are read in processes of their own with bounds checks in all kernels
(NUMBA_BOUNDSCHECK) and limits of 32 MiB; what is read goes on into synthesis. Counted are

    read        a value came back, and it is what an independent reader finds in the same bytes
    refused     one of our errors
    wrong       a value that is not what the file says (of a database with checksums: any other than before)
    foreign     another exception
    crash, hang, memory (reading took more than twice the limit)

    python benchmarks/mutated_files.py [--files 20000] [--kind KIND] [--seed 0]

The table goes to benchmarks/results/mutated_files.txt.
"""

import argparse
import functools
import json
import os
import select
import struct
import subprocess
import sys
import tempfile
import time
import warnings
import zlib
from collections import Counter
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import h5py
import numpy as np
import OpenEXR
from PIL import Image

RESULTS = Path(__file__).parent / "results"

SHARES = {
    "database": 0.25,
    "database values": 0.125,
    "frame": 0.075,
    "tiles": 0.05,
    "parts": 0.05,
    "samples": 0.05,
    "deep": 0.125,
    "tlfr binary": 0.05,
    "tlfr text": 0.05,
    "lens": 0.0375,
    "camera": 0.0375,
    "png": 0.05,
    "jpeg": 0.025,
    "tiff": 0.025,
}
"""Part of all files that is of each kind."""

TILE = 8
"""Columns and rows of a tile."""
LIMIT_BYTES = 32 << 20
HANG_S = 120.0
BATCH = 1000
OUTCOMES = ("read", "refused", "wrong", "foreign", "memory", "crash", "hang")

INTEGERS = (0, 1, -1, 2, 255, 256, 65535, 65536, 2**31 - 1, -(2**31), 2**32 - 1, 2**40, 2**62, -(2**63))
WORDS = (
    "nan",
    "inf",
    "-inf",
    "1e999",
    "-1",
    "0",
    "9" * 400,
    "",
    "null",
    "true",
    "[" * 5000,
    '"x"',
    "1e-320",
    "stop",
    "\0",
)


Further = Callable[[], None]
"""What is done with what was read."""


# --- Damage --------------------------------------------------------------------------------------------------------


def damaged(content: bytes, rng: np.random.Generator, text: bool) -> bytes:
    """Return a file's bytes after one to four kinds of damage; half of it falls on the first kilobyte, the header."""
    data = bytearray(content)
    for _ in range(int(rng.integers(1, 5))):
        if not data:
            break
        span = min(len(data), 1024) if rng.random() < 0.5 else len(data)
        at = int(rng.integers(span))
        length = int(rng.integers(1, 64))
        kind = int(rng.integers(9 if text else 8))
        if kind == 0:
            data[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            data[at : at + length] = rng.integers(0, 256, length, np.uint8).tobytes()
        elif kind == 2:
            width = int(rng.choice([1, 2, 4, 8]))
            value = INTEGERS[int(rng.integers(len(INTEGERS)))] % (1 << (8 * width))
            data[at : at + width] = value.to_bytes(width, "little")
        elif kind == 3:
            width = int(rng.choice([1, 2, 4, 8]))
            value = int.from_bytes(data[at : at + width], "little") + int(rng.integers(-4, 5))
            data[at : at + width] = (value % (1 << (8 * width))).to_bytes(width, "little")
        elif kind == 4:
            del data[at : at + length]
        elif kind == 5:
            data[at:at] = data[at : at + length]
        elif kind == 6:
            other = int(rng.integers(len(data)))
            data[at : at + length], data[other : other + length] = data[other : other + length], data[at : at + length]
        elif kind == 7 and rng.random() < 0.3:
            del data[at:]
        elif kind == 8:
            words = bytes(data).split(b" ") if b"," not in data else bytes(data).split(b",")
            words[int(rng.integers(len(words)))] = WORDS[int(rng.integers(len(WORDS)))].encode()
            data = bytearray((b" " if b"," not in data else b",").join(words))
    return bytes(data)


def spoil_database(path: Path, rng: np.random.Generator) -> None:
    """Write bad values into a database by valid means, so that all checksums are right."""
    with h5py.File(path, "a") as file:
        name = str(rng.choice([each for each in file if file[each].dtype != np.uint8 or each == "direct"]))
        kind = int(rng.integers(9))
        if kind == 0:
            table = file[name][...]
            bad = np.array([np.nan, np.inf, 1e30, -5.0, 1e9, 0.0]) if table.dtype.kind == "f" else np.array(INTEGERS)
            with np.errstate(all="ignore"):
                table.flat[rng.integers(table.size, size=int(rng.integers(1, 9)))] = rng.choice(bad) % 2**31
            file[name][...] = table
        elif kind == 1:
            attribute = str(rng.choice(["shape", "maximum", "power", "floor", "direction_step_px", "version"]))
            value = np.array(file.attrs[attribute])
            value.flat[int(rng.integers(value.size))] = rng.choice([0, 1, 7, 1000, 10**6, 10**9, 2**31 - 1])
            file.attrs[attribute] = value
        elif kind == 2:
            shape, dtype = file[name].shape, file[name].dtype
            del file[name]
            big = tuple(int(side * rng.choice([0, 2, 10**3, 10**6])) for side in shape[:1]) + shape[1:]
            chunks = tuple(max(1, min(side, 4096)) for side in big)
            file.create_dataset(name, big, dtype, chunks=chunks, maxshape=(None, *shape[1:]), fletcher32=True)
        elif kind == 3:
            del file[name]
            file[name] = [h5py.ExternalLink("/etc/passwd", "/x"), h5py.SoftLink("/nowhere"), h5py.SoftLink("/value")][
                int(rng.integers(3))
            ]
        elif kind == 4:
            shape, dtype = file[name].shape, file[name].dtype
            del file[name]
            file.create_dataset(name, shape, dtype, external=[("/etc/hostname", 0, h5py.h5f.UNLIMITED)])
        elif kind == 5:
            shape, dtype = file[name].shape, file[name].dtype
            layout = h5py.VirtualLayout(shape, dtype)
            layout[...] = h5py.VirtualSource("/tmp/other.h5", "x", shape)
            del file[name]
            file.create_virtual_dataset(name, layout)
        elif kind == 6:
            del file[name]
            file.create_dataset(name, data=np.array(["text"], object), dtype=h5py.string_dtype())
        elif kind == 7:
            file.create_group("extra")["more"] = np.zeros(4)
        else:
            text = json.dumps({"seed": 0, "x": "y" * int(rng.choice([1, 10**5, 10**7]))}).encode()
            del file["provenance"]
            data = np.frombuffer(text, np.uint8)
            file.create_dataset(
                "provenance", data=data, compression="gzip", fletcher32=True, chunks=(min(len(data), 8192),)
            )


# --- Samples of every kind, and independent readers ------------------------------------------------------------------


def write_samples_of_every_kind(folder: Path) -> None:
    """Write one good file of every kind."""
    from spreadlets.files import deep, tlfr
    from spreadlets.files import exr_frames as exr
    from spreadlets.files import exr_samples as sample_files
    from spreadlets.precompute.build.build import build_database
    from spreadlets.precompute.models.prescription import shipped_lenses
    from spreadlets.scene.camera import ThinLens
    from spreadlets.scene.frame import Frame
    from spreadlets.scene.samples import SampleBuffer

    rng = np.random.default_rng(3)
    build_database("combined", folder / "database", samples=12, max_coc=5.0, max_motion=5.0, rays=20_000, jobs=1)
    (folder / "database values").write_bytes((folder / "database").read_bytes())
    shape = 16, 24
    radiance = rng.random((*shape, 4)).astype(np.float32)
    radiance[..., :3] *= radiance[..., 3:]
    depth = rng.uniform(1.0, 9.0, shape).astype(np.float32)
    motion = rng.normal(0.0, 2.0, (*shape, 2)).astype(np.float32)
    exr.write_frame(folder / "frame", Frame(radiance, depth, motion))
    half = Frame(0.5 * radiance, depth + np.float32(0.5), motion)
    exr.write_frame(folder / "parts", Frame.from_layers([half, Frame(radiance[..., :3], depth + np.float32(9))]))
    write_tiles(folder / "tiles", {**dict(zip("RGBA", radiance.transpose(2, 0, 1), strict=True)), "Z": depth})
    many = [np.stack([each, each], axis=2) for each in (radiance[..., :3], depth, motion)]
    samples = SampleBuffer(
        many[0],
        many[1],
        many[2],
        lens_uv=rng.uniform(-0.6, 0.6, (*shape, 2, 2)).astype(np.float32),
        time=rng.uniform(-0.25, 0.25, (*shape, 2)).astype(np.float32),
    )
    sample_files.write_samples(folder / "samples", samples)
    camera = ThinLens(50.0, 36.0, 2.0, 4.0)
    for name, binary in (("tlfr binary", True), ("tlfr text", False)):
        tlfr.write_tlfr(folder / name, samples, camera=camera, binary=binary)
        pair = (folder / (name + ".header")).read_bytes() + (folder / name).read_bytes()
        (folder / (name + ".split")).write_text(str(len((folder / (name + ".header")).read_bytes())))
        (folder / name).write_bytes(pair)
    counts = rng.integers(0, 4, shape)
    n = int(counts.sum())
    colour = np.full((n, 4), 0.25, np.float32)
    front = rng.uniform(1.0, 9.0, n).astype(np.float32)
    deep.write_deep(folder / "deep", deep.DeepImage(counts, colour, front, front, np.ones((n, 2), np.float32)))
    (folder / "lens").write_bytes(shipped_lenses()["double_gauss"].read_bytes())
    picture = Image.fromarray(rng.integers(0, 256, (20, 30, 4), np.uint8))
    picture.save(folder / "png", "PNG")
    for name in ("jpeg", "tiff"):
        picture.convert("RGB").save(folder / name, name.upper())
    text = {"focal_length_mm": 50.0, "sensor_width_mm": 36.0, "f_number": 2.0, "focus_distance_m": 4.0}
    (folder / "camera").write_text(json.dumps(text | {"shutter_open_close_frames": [-0.25, 0.25]}))


def write_tiles(path: Path, channels: dict[str, np.ndarray]) -> None:
    """Write a file of 8 x 8 tiles."""
    tiles = OpenEXR.TileDescription()
    tiles.xSize = tiles.ySize = TILE
    header = {"type": OpenEXR.tiledimage, "compression": OpenEXR.ZIP_COMPRESSION, "tiles": tiles}
    header |= {"framesPerSecond": Fraction(24, 1), "expTime": 0.01, "owner": "nobody", "worldToCamera": np.eye(4)}
    OpenEXR.File(header, {name: np.ascontiguousarray(plane) for name, plane in channels.items()}).write(str(path))


class Wrong(Exception):
    """What was read is not what the file says."""


def agree(name: str, found: np.ndarray, expected: np.ndarray) -> None:
    found, expected = np.asarray(found), np.asarray(expected)
    if found.shape != expected.shape or not np.array_equal(found, expected, equal_nan=found.dtype.kind == "f"):
        raise Wrong(f"{name} differs")


def read_database(path: Path, original: Path) -> Further:
    """Read all of a database; it must be as before, as everything in it has checksums."""
    from spreadlets.psf.database import open_database

    with open_database(path) as found:
        table = everything(found)
    for name, values in originals(original).items():
        agree(name, table[name], values)
    return lambda: synthesise_with(path)


@functools.cache
def originals(original: Path) -> dict[str, np.ndarray]:
    from spreadlets.psf.database import open_database

    with open_database(original) as database:
        return everything(database)


def read_database_as_stored(path: Path, original: Path) -> Further:
    """Read all of a database; it must be what plain HDF5 finds in the file."""
    from spreadlets.psf.database import open_database

    with open_database(path) as found:
        table = everything(found)
    with h5py.File(path) as file:
        for name in ("offset_rc", "value", "direction", "statistics"):
            agree(name, table[name], file[name][...])
        agree("maximum", table["maximum"], file.attrs["maximum"])
    return lambda: synthesise_with(path)


def everything(database) -> dict[str, np.ndarray]:
    places = [(cell, n) for cell in range(database.n_cells) for n in range(len(database.angles(cell)))]
    spreadlets = database.spreadlets(places)
    database.summary()
    return {
        "maximum": database.grid.maximum,
        "power": database.grid.power,
        "first": database.grid.first,
        "shape": np.array(database.grid.shape),
        "cell_start": database.cell_start,
        "point_start": database.point_start,
        "direction": database.angle,
        "direct": database.direct,
        "offset_rc": np.concatenate([each.offset_rc for each in spreadlets]),
        "value": np.concatenate([each.value for each in spreadlets]),
        "statistics": np.stack(list(database.statistics().values()), axis=1),
        "provenance": np.array(json.dumps(database.provenance, sort_keys=True)),
    }


def synthesise_with(database: Path) -> None:
    import spreadlets as sp

    rng = np.random.default_rng(0)
    frame = sp.Frame(
        rng.random((12, 16, 4)).astype(np.float32) ** 0.1,
        rng.uniform(1.0, 9.0, (12, 16)).astype(np.float32),
        rng.normal(0.0, 9.0, (12, 16, 2)).astype(np.float32),
    )
    image = sp.synthesize(frame, sp.ThinLens(50.0, 36.0, 0.5, 4.0), str(database), layers=1)
    if not np.isfinite(image).all():
        raise Wrong("the image is not finite")


def synthesise_of(frame, folder: Path) -> None:
    import spreadlets as sp

    sp.synthesize(frame, sp.ThinLens(50.0, 36.0, 2.0, 4.0), str(folder / "database"), layers=1)


def tiled_planes(path: Path) -> list[dict[str, np.ndarray]]:
    """Read zipped tiles of one part and one level without the library: its planes by name."""
    from spreadlets.files import exr_chunks

    with open(path, "rb") as file:
        file.seek(8)
        (header,) = exr_chunks._headers(file, exr_chunks.TILED)
        left, top, right, bottom = header.window
        width, height = right - left + 1, bottom - top + 1
        across, down = -(-width // TILE), -(-height // TILE)
        table = np.frombuffer(file.read(8 * across * down), "<i8").tolist()
        planes = {name: np.empty((height, width), dtype) for name, dtype in header.types.items()}
        for offset in table:
            file.seek(offset)
            x, y, _, _, size = np.frombuffer(file.read(20), "<i4")
            rows, cols = min(TILE, height - y * TILE), min(TILE, width - x * TILE)
            unpacked = int(rows * cols * sum(dtype.itemsize for dtype in header.types.values()))
            block = file.read(size)
            if size < unpacked:
                block = exr_chunks._reordered(zlib.decompress(block))
            at = 0
            for row in range(y * TILE, y * TILE + rows):
                for name, dtype in header.types.items():
                    planes[name][row, x * TILE : x * TILE + cols] = np.frombuffer(block, dtype, cols, at)
                    at += int(cols) * dtype.itemsize
    return [planes]


def flat_planes(path: Path) -> list[dict[str, np.ndarray]]:
    """Read flat zipped scanlines without the library: a list of parts, each with its planes by name."""
    from spreadlets.files import exr_chunks

    parts = []
    with open(path, "rb") as file:
        version = int(np.frombuffer(file.read(8), "<u4")[1])
        multi_part, headers = bool(version & exr_chunks.MULTI_PART), exr_chunks._headers(file, version)
        n_chunks = [(header.window[3] - header.window[1]) // 16 + 1 for header in headers]
        tables = [np.frombuffer(file.read(8 * n), "<i8").tolist() for n in n_chunks]
        for header, table in zip(headers, tables, strict=True):
            left, top, right, bottom = header.window
            width, lines = right - left + 1, {}
            for offset in table:
                file.seek(offset + 4 * multi_part)
                y, size = np.frombuffer(file.read(8), "<i4")
                rows = min(16, bottom - y + 1)
                unpacked = rows * width * sum(dtype.itemsize for dtype in header.types.values())
                block = file.read(size)
                if size < unpacked:
                    block = exr_chunks._reordered(zlib.decompress(block))
                at = 0
                for row in range(y, y + rows):
                    for name, dtype in header.types.items():
                        lines[name, row] = np.frombuffer(block, dtype, width, at)
                        at += width * dtype.itemsize
            parts.append(
                {name: np.stack([lines[name, row] for row in range(top, bottom + 1)]) for name in header.types}
            )
    return parts


def read_frame_file(path: Path, original: Path) -> Further:
    from spreadlets.files import exr_frames as exr
    from spreadlets.files.exr_file import ExrFile

    frame = exr.read_frame(path)
    with ExrFile(path) as file:
        compare_flat(path, original, file.parts)
    return lambda: synthesise_of(frame, original.parent)


def read_tiled_file(path: Path, original: Path) -> Further:
    from spreadlets.files import exr_frames as exr
    from spreadlets.files.exr_file import ExrFile

    frame = exr.read_frame(path)
    with ExrFile(path) as file:
        compare_flat(path, original, file.parts, tiled_planes)
    return lambda: synthesise_of(frame, original.parent)


def read_samples_file(path: Path, original: Path) -> None:
    from spreadlets.files.exr_file import ExrFile
    from spreadlets.files.exr_samples import read_samples

    read_samples(path)
    with ExrFile(path) as file:
        compare_flat(path, original, file.parts)


def compare_flat(path: Path, original: Path, parts: list, reader: Callable = flat_planes) -> None:
    """Compare with an independent reader; where that has lost the thread and the library found it, the original."""
    try:
        compare_planes(parts, reader(path))
    except (ValueError, EOFError, OSError, KeyError, IndexError, zlib.error, Wrong):
        compare_planes(parts, reader(original))


def compare_planes(parts: list, expected: list[dict[str, np.ndarray]]) -> None:
    if len(expected) != len(parts):
        raise Wrong("another number of parts")
    for part, planes in zip(parts, expected, strict=True):
        if set(part.planes) != set(planes):
            raise Wrong("other channels")
        for name, plane in planes.items():
            agree(name, part.planes[name].pixels, plane)


def read_deep_file(path: Path, original: Path) -> Further:
    """Read a deep image; compare with the library's own reader, with the original where that is stricter than zlib."""
    from spreadlets.files import exr_frames as exr
    from spreadlets.files.exr_file import ExrFile

    frame = exr.read_frame(path)
    expected = deep_channels(path) or deep_channels(original)
    with ExrFile(path) as file:
        for name, values in file.deep_part(0).channels.items():
            agree(name, values, expected[name])
    return lambda: synthesise_of(frame, original.parent)


def deep_channels(path: Path) -> dict[str, np.ndarray]:
    """Read the samples of each channel by the library; none if it refuses them."""
    from spreadlets.files.exr_file import library_messages

    with library_messages():
        parts = OpenEXR.File(str(path), separate_channels=True).parts
    channels = parts[0].channels if parts else {}
    found = {name: [p for p in each.pixels.ravel() if p is not None and len(p)] for name, each in channels.items()}
    return {name: np.concatenate([np.zeros(0), *each]).astype(np.float32) for name, each in found.items()}


def read_tlfr_file(path: Path, original: Path) -> None:
    """Read a buffer; its samples must be the numbers of the file, in whatever order of pixels."""
    from spreadlets.files.exr_samples import read_samples
    from spreadlets.scene.camera import ThinLens

    content = path.read_bytes()
    split = int(Path(f"{original}.split").read_text())
    name = path.with_name("buffer")
    name.with_name("buffer.header").write_bytes(content[:split])
    name.write_bytes(content[split:])
    found = read_samples(name, camera=ThinLens(50.0, 36.0, 2.0, 4.0))
    if b"binary" in content[:split].lower():
        table = np.frombuffer(content[split:], "<f4")
    else:
        table = np.array(content[split:].replace(b",", b" ").split(), np.float64).astype(np.float32)
    table = table.reshape(-1, 16)
    stored = np.concatenate([found.depth[..., None], found.radiance[..., :3]], axis=3)[found.valid]
    expected = table[:, [3, 7, 8, 9]]
    agree("samples", stored[np.lexsort(stored.T)], expected[np.lexsort(expected.T)])


def read_lens_file(path: Path, original: Path) -> None:
    """Read a prescription; its numbers must be those of the lines."""
    from spreadlets.precompute.models.prescription import paraxial, read_prescription

    lens = read_prescription(str(path))
    rows = [line.split("#")[0].split() for line in path.read_text().splitlines()]
    rows = [row for row in rows if row and row[0] != "title"][1:]
    agree("thickness", [each.thickness for each in lens.surfaces], [float(row[1]) for row in rows])
    agree("semi_diameter", [each.semi_diameter for each in lens.surfaces], [float(row[3]) for row in rows])
    paraxial(lens)


def read_camera_file(path: Path, original: Path) -> None:
    from spreadlets.files.cameras import read_camera

    camera, content = read_camera(path), json.loads(path.read_bytes())
    for key in ("focal_length_mm", "sensor_width_mm", "f_number"):
        agree(key, getattr(camera, key), float(content[key]))
    agree("shutter", camera.shutter, np.array(content["shutter_open_close_frames"], float))


def read_png_file(path: Path, original: Path) -> None:
    """Read the image of a stylized PSF; its light must be that of the pixels which plain zlib finds in the file."""
    from spreadlets.precompute.models.stylized import decode, read_settings

    found = decode(read_settings(image=str(path))["image"])
    try:
        agree("light", found, stored_light(png_pixels(path)))
    except (ValueError, KeyError, IndexError, struct.error, zlib.error, Wrong):
        agree("light", found, stored_light(png_pixels(original)))


def stored_light(pixels: np.ndarray) -> np.ndarray:
    """Return the light of 8-bit sRGB pixels (h, w, 4) as the product stores it."""
    from spreadlets.precompute.models.stylized import decode, encode

    values = pixels / 255.0
    colours = values[..., :3]
    linear = np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
    light = linear * values[..., 3:]
    return decode(encode(light / light.max()))


def png_pixels(path: Path) -> np.ndarray:
    """Read an 8-bit PNG with alpha, not interlaced, without a library: (h, w, 4)."""
    content, at, chunks = path.read_bytes(), 8, {b"IDAT": b""}
    while at < len(content):
        (length,) = struct.unpack_from(">I", content, at)
        kind, data = content[at + 4 : at + 8], content[at + 8 : at + 8 + length]
        chunks[kind] = chunks.get(kind, b"") + data
        at += length + 12
    width, height, *form = struct.unpack(">IIBBBBB", chunks[b"IHDR"])
    if form != [8, 6, 0, 0, 0]:
        raise ValueError("another form of PNG")
    rows = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), np.uint8).reshape(height, 1 + 4 * width)
    above = np.zeros((width, 4), int)
    pixels = []
    for row in rows:
        above = unfiltered(int(row[0]), row[1:].reshape(width, 4).astype(int), above)
        pixels.append(above)
    return np.array(pixels)


def unfiltered(kind: int, row: np.ndarray, above: np.ndarray) -> np.ndarray:
    """Undo one of PNG's five filters on a row of pixels."""
    result = np.zeros_like(row)
    left = corner = np.zeros(4, int)
    for x, up in enumerate(above):
        nearest = left + up - corner
        distance = np.abs(np.stack([nearest - left, nearest - up, nearest - corner]))
        paeth = np.choose(distance.argmin(axis=0), [left, up, corner])
        left = (row[x] + [0, left, up, (left + up) // 2, paeth][kind]) % 256
        result[x], corner = left, up
    return result


def read_other_picture(path: Path, original: Path) -> None:
    """Read what no reader takes: every one must refuse it."""
    from spreadlets.errors import SpreadletsError
    from spreadlets.files import exr_frames as exr
    from spreadlets.files.inspect import frame_info
    from spreadlets.precompute.models.stylized import read_settings

    readers = (exr.read_frame, exr.read_image, frame_info, lambda each: read_settings(image=str(each)))
    for reader in readers:
        try:
            reader(path)
        except SpreadletsError as error:
            refusal = error
        else:
            raise Wrong("a picture of another kind was read")
    raise refusal


READERS: dict[str, Callable[[Path, Path], Further | None]] = {
    "database": read_database,
    "database values": read_database_as_stored,
    "frame": read_frame_file,
    "tiles": read_tiled_file,
    "parts": read_frame_file,
    "samples": read_samples_file,
    "deep": read_deep_file,
    "tlfr binary": read_tlfr_file,
    "tlfr text": read_tlfr_file,
    "lens": read_lens_file,
    "camera": read_camera_file,
    "png": read_png_file,
    "jpeg": read_other_picture,
    "tiff": read_other_picture,
}


# --- The process that reads ------------------------------------------------------------------------------------------


def lower_limits() -> None:
    """Hold the readers to `LIMIT_BYTES`, so that what exceeds the limits is small enough to be tried by thousands."""
    import spreadlets.psf.database as database
    from spreadlets.files import deep, exr_file, tlfr
    from spreadlets.psf import database_file

    for module in (deep, exr_file, tlfr):
        module.MAX_VALUES = LIMIT_BYTES // 4
    for module in (database, database_file):
        module.MAX_POINTS = LIMIT_BYTES // 16
        module.MAX_SPREADLETS = LIMIT_BYTES // 64
        module.MAX_CELLS = LIMIT_BYTES // 1024


def memory_kib(key: str) -> int:
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) for line in status if line.startswith(key))


def outcome(kind: str, path: Path, original: Path) -> tuple[str, str, float]:
    """Read one file; return the outcome, its message, and the memory that it took, MiB."""
    from spreadlets.errors import SpreadletsError

    Path("/proc/self/clear_refs").write_text("5")  # forgets the highest memory use
    before = memory_kib("VmRSS")
    result, message, highest = "read", "", 0
    try:
        further = READERS[kind](path, original)
        highest = memory_kib("VmHWM")
        if further is not None:
            further()
    except SpreadletsError as error:
        result, message = "refused", type(error).__name__
    except Wrong as error:
        result, message = "wrong", str(error)
    except Exception as error:
        result, message = "foreign", f"{type(error).__name__}: {error}"
    taken = ((highest or memory_kib("VmHWM")) - before) / 1024
    if taken > 2 * LIMIT_BYTES / 2**20:
        result, message = "memory", f"{taken:.0f} MiB, {result}"
    return result, message, taken


def child(kind: str, folder: Path, first: int, count: int, seed: int) -> None:
    """Damage and read files, one JSON line each; the number of a file says all about its damage."""
    warnings.simplefilter("ignore")
    original = folder / kind
    good = original.read_bytes()
    text = kind in ("tlfr text", "lens", "camera")
    path = folder / f"mutated-{os.getpid()}"
    if READERS[kind] is not read_other_picture and (further := READERS[kind](original, original)):
        further()  # compiles
    lower_limits()
    for number in range(first, first + count):
        rng = np.random.default_rng((seed, list(SHARES).index(kind), number))
        if kind == "database values":
            path.write_bytes(good)
            spoil_database(path, rng)
        else:
            path.write_bytes(damaged(good, rng, text))
        print(json.dumps({"number": number}), flush=True)
        print(json.dumps({"outcome": outcome(kind, path, original)}), flush=True)
    path.unlink()


# --- The process that counts -----------------------------------------------------------------------------------------


def run_kind(kind: str, folder: Path, count: int, seed: int) -> tuple[Counter[str], float, list[str]]:
    """Read `count` files of a kind; return how they ended, the most memory that one took, and what went wrong."""
    counts: Counter[str] = Counter()
    most, notes, first = 0.0, [], 0
    while first < count:
        batch = min(BATCH, count - first)
        number, results, ended = watch(kind, folder, first, batch, seed)
        for index, (result, message, taken) in results:
            counts[result] += 1
            most = max(most, taken)
            if result not in ("read", "refused"):
                notes.append(f"{kind} {index}: {result}: {message}")
        first = first + batch if ended == "" else number + 1
        if ended:
            counts[ended] += 1
            notes.append(f"{kind} {number}: {ended}")
    return counts, most, notes


def watch(kind: str, folder: Path, first: int, count: int, seed: int) -> tuple[int, list, str]:
    """Run a reading process; return the last file's number, the outcomes, and "crash" or "hang" if it ended so."""
    command = [sys.executable, __file__, "--child", kind, "--folder", str(folder)]
    command += ["--first", str(first), "--files", str(count), "--seed", str(seed)]
    environment = os.environ | {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(folder / "cache")}
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, env=environment, cwd=folder, stderr=open(folder / "log", "a")
    )
    assert process.stdout is not None
    results, number, deadline = [], first - 1, time.monotonic() + 15 * HANG_S
    while True:
        if not select.select([process.stdout], [], [], max(deadline - time.monotonic(), 0.0))[0]:
            process.kill()
            process.wait()
            return number, results, "hang"
        line = process.stdout.readline()
        if not line:
            break
        deadline = time.monotonic() + HANG_S
        said = json.loads(line)
        number = said.get("number", number)
        if "outcome" in said:
            results.append((number, said["outcome"]))
    status = process.wait()
    if number < first and status:
        raise SystemExit(
            f"{kind}: the reading process failed before the first file:\n" + (folder / "log").read_text()[-2000:]
        )
    return number, results, "crash" if status else ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=20_000)
    parser.add_argument("--kind", choices=list(SHARES), help="only these")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--child", choices=list(SHARES), help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--first", type=int, default=0, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        child(arguments.child, arguments.folder, arguments.first, arguments.files, arguments.seed)
        return
    kinds = [arguments.kind] if arguments.kind else list(SHARES)
    header = f"{'kind':<20}{'files':>7}" + "".join(f"{name:>9}" for name in OUTCOMES) + f"{'most MiB':>10}"
    lines, all_notes = [header], []
    with tempfile.TemporaryDirectory() as name:
        write_samples_of_every_kind(Path(name))
        for kind in kinds:
            count = arguments.files if arguments.kind else round(arguments.files * SHARES[kind])
            counts, most, notes = run_kind(kind, Path(name), count, arguments.seed)
            row = "".join(f"{counts[each]:>9}" for each in OUTCOMES)
            lines.append(f"{kind:<20}{sum(counts.values()):>7}{row}{most:>10.1f}")
            print("\n".join([*lines[:: len(lines) - 1], *notes[:10]] if len(lines) > 1 else lines), flush=True)
            all_notes += notes
    if not arguments.kind:
        (RESULTS / "mutated_files.txt").write_text("\n".join([*lines, *all_notes[:40]]) + "\n")


if __name__ == "__main__":
    main()

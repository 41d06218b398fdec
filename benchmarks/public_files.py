"""Public OpenEXR files read, blurred and written, and whether windows, pixel aspect and attributes are the input's.

The files are those of the repository AcademySoftwareFoundation/openexr-images: Beachball (several parts and views,
elements that move out of the picture), DisplayWindow (every position of the two windows, pixels that are no squares),
Chromaticities, LuminanceChroma (chroma at every fourth pixel), v2 (deep images). Most hold no depth: then a plane at
4 m in a file beside is given. The data window of an element that is not opaque may grow by its blur; it must hold the
input's.

    python benchmarks/public_files.py --images ../openexr-images

The table goes to benchmarks/results/public_files.txt.
"""

import argparse
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
import OpenEXR

import spreadlets as sp
from spreadlets.errors import SpreadletsError
from spreadlets.files.exr_file import ExrFile
from spreadlets.files.exr_parts import window
from spreadlets.scene.raster import Raster, Window

RESULTS = Path(__file__).parent / "results"
FOLDERS = ("Beachball", "DisplayWindow", "Chromaticities", "LuminanceChroma", "v2")

PLANE_M = 4.0
NEAR, FAR = sp.ThinLens(50, 36, 2.8, 2.0), sp.ThinLens(100, 36, 0.1, 300.0)
"""For planes at 4 m and the ball; and for the trees, whose unit is no metre."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, required=True, help="a checkout of openexr-images")
    arguments = parser.parse_args()
    paths = [path for folder in FOLDERS for path in sorted((arguments.images / folder).rglob("*.exr"))]
    lines = [f"{'file':<34}{'data window':<28}{'written':<28}{'display':>8}{'aspect':>8}{'attributes':>11}  verdict"]
    with tempfile.TemporaryDirectory() as folder:
        for path in paths:
            lines.append(row(path, str(path.relative_to(arguments.images)), Path(folder)))
            print(lines[-1], flush=True)
    good = sum(line.endswith(("equal", "grown")) for line in lines)
    lines.append(f"{good} of {len(paths)} files carried")
    (RESULTS / "public_files.txt").write_text("\n".join(lines) + "\n")
    print(lines[-1])


def row(path: Path, name: str, folder: Path) -> str:
    """Return a line of the table."""
    begin = time.perf_counter()
    try:
        raster = blurred(path, folder)
    except SpreadletsError as error:
        return f"{name:<34}{str(error).removeprefix(f'{path}: ')[:80]}  refused"
    with ExrFile(folder / "out.exr") as result:
        header, attributes = result.headers[0], result.attributes[0]
    own, written = raster.stored or raster.data, window(header["dataWindow"])
    same = {
        "display": window(header["displayWindow"]) == raster.display,
        "aspect": float(header["pixelAspectRatio"]) == raster.pixel_aspect,
        "attributes": attributes == from_file(path, raster),
    }
    verdict = "equal" if own == written else "grown" if own.union(written) == written else "LOST"
    marks = "".join(
        f"{'same' if each else 'LOST':>{width}}" for each, width in zip(same.values(), (8, 8, 11), strict=True)
    )
    if not all(same.values()):
        verdict = "LOST"
    seconds = time.perf_counter() - begin
    return f"{name:<34}{shown(own):<28}{shown(written):<28}{marks}  {seconds:.1f} s {verdict}"


def blurred(path: Path, folder: Path) -> Raster:
    """Read, blur and write a file; return where the frame's pixels lay."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with ExrFile(path) as file:
            header = file.headers[0]
            channels = {channel.name for part in file.headers for channel in part["channels"]}
        if "Z" in channels:
            frame = sp.read_frame(path)
        else:
            frame = sp.read_frame(path, depth_file=plane(folder / "depth.exr", header))
        camera = FAR if np.min([layer.depth.min() for layer in frame.layers]) > 50 else NEAR
        sp.write_image(folder / "out.exr", sp.synthesize(frame, camera), raster=frame.raster)
    return frame.raster


def plane(path: Path, header: dict) -> Path:
    """Write a depth of one value in the windows of a file."""
    depth = np.full(window(header["dataWindow"]).shape, PLANE_M, np.float32)
    kept = {name: header[name] for name in ("dataWindow", "displayWindow", "pixelAspectRatio")}
    OpenEXR.File({"type": OpenEXR.scanlineimage, **kept}, {"Z": depth}).write(str(path))
    return path


def from_file(path: Path, raster: Raster) -> dict:
    """Return the attributes of the part of a file that has the frame's data window."""
    with ExrFile(path) as file:
        parts = list(zip(file.headers, file.attributes, strict=True))
    own = raster.stored or raster.data
    found = [attributes for header, attributes in parts if window(header["dataWindow"]) == own]
    return next((attributes for attributes in found if attributes == raster.attributes), found[0])


def shown(box: Window) -> str:
    """Return a window as OpenEXR's tools print it."""
    left, top, width, height = box
    return f"({left}, {top})-({left + width - 1}, {top + height - 1})"


if __name__ == "__main__":
    main()

"""Cut the small frames that the tests and the demonstration use out of rendered ones.

Reads coins and fence (camera, pinhole frame, depth layers, samples, references) from a folder, and writes their middle,
256 x 256 px, to tests/data and spreadlets/data. Values and channels stay as they are. A cut keeps its camera valid
when the sensor is cut with it: the focal length in px stays, and so does every circle of confusion; the middle keeps
the optical axis.

    python benchmarks/shipped_frames.py FOLDER
"""

import argparse
import json
from pathlib import Path

import numpy as np
import OpenEXR

SIDE = 256
ROOT = Path(__file__).resolve().parent.parent
TESTS, PACKAGE = ROOT / "tests" / "data", ROOT / "spreadlets" / "data"
"""What only the tests need, and what the demonstration needs too."""

WANTED = {
    TESTS: ("coins_pinhole", "coins_ref_dof", "coins_ref_dofmb", "fence_layer0", "fence_layer1", "fence_layer2"),
    PACKAGE: ("fence_samples", "fence_ref_dofmb"),
}
CAMERAS = {TESTS: "coins", PACKAGE: "fence"}
ABOUT_THE_WHOLE = ("layers", "layer_format", "spp", "ref_dofmb_halves_ssim", "render_time_s", "render")
"""Keys of a camera that tell of files of the whole frame."""


def middle(length: int) -> slice:
    """Return the middle pixels of a side."""
    return slice((length - SIDE) // 2, (length + SIDE) // 2)


def cut_image(source: Path, target: Path) -> None:
    """Write the middle of an image: its first part, so that of samples one for each pixel remains."""
    with OpenEXR.File(str(source), separate_channels=True) as file:
        part = file.parts[0]
        height, width = next(iter(part.channels.values())).pixels.shape
        place = middle(height), middle(width)
        channels = {name: np.ascontiguousarray(channel.pixels[place]) for name, channel in part.channels.items()}
        header = {key: part.header[key] for key in ("type", "compression", "name") if key in part.header}
        OpenEXR.File([OpenEXR.Part(header, channels)]).write(str(target))


def cut_camera(source: Path, target: Path) -> None:
    """Write the camera of the middle: a sensor as much smaller as the image."""
    camera = {name: value for name, value in json.loads(source.read_text()).items() if name not in ABOUT_THE_WHOLE}
    camera["sensor_width_mm"] *= SIDE / camera["width"]
    camera |= {"width": SIDE, "height": SIDE}
    target.write_text(json.dumps(camera, indent=1) + "\n")


def main() -> None:
    """Cut all of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="holds coins.json, coins_pinhole.exr, fence_samples.exr and so on")
    folder = parser.parse_args().folder
    for target, names in WANTED.items():
        for name in names:
            cut_image(folder / f"{name}.exr", target / f"{name}.exr")
    for target, name in CAMERAS.items():
        cut_camera(folder / f"{name}.json", target / f"{name}.json")


if __name__ == "__main__":
    main()

"""Photographs: error against a truth, beside what others do with a depth map; time and memory of 12 megapixels.

    python benchmarks/photo.py [--frames DIR] [--pictures DIR]

Two scenes are drawn, 768 x 512: a head with hair before a street at night, with the background out of focus; and
wires out of focus before a page. Foreground, its alpha and the background behind it are known, and so is the truth:
each plane blurred by the disc of its own radius, the nearer over the farther. Rendered frames are taken, too, where
there are such without motion, whose truth is what the renderer makes of its lens; light that 8 bits clip is lost.

What `photo` is given is the sharp picture in 8 bits, and inverse depth: "as predicted", as a network gives it, of
unknown scale and offset, a quarter of the size, its edges soft; or "exact". Others get the same depth, with its scale.
One blurs each pixel with the Gaussian of its depth (of equal variance). Another (OpenCV, left out without it) blurs
slices of depth with discs, and composites them, each with its own alpha. SSIM and PSNR as everywhere, of all and, of
what is drawn, within 24 px of the foreground's edge. Writes photo.txt to benchmarks/results.
"""

import argparse
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw
from scenes import Scene, parser, result_path, scenes
from scipy import ndimage, signal

import spreadlets as sp
from spreadlets import metrics
from spreadlets.scene.display import display_decode, display_encode

try:
    import cv2
except ImportError:
    cv2 = None

SIZE, FINER = (512, 768), 4
BLUR = 14.0
EDGE_PX = 24
SLICES = 16
PREDICTED, EXACT = "as predicted", "exact"
STRAY = (0.002, 0.998)
"""What lies beyond these shares of the depths is stray."""

MEGAPIXELS = """
import resource, time, numpy as np, spreadlets as sp
rng = np.random.default_rng(0)
rgb = np.kron(rng.integers(0, 256, (750, 1000, 3), np.uint8), np.ones((4, 4, 1), np.uint8))
depth = np.add.outer(np.linspace(0, 0.3, 750), np.zeros(1000)).astype(np.float32)
depth[200:600, 350:650] = 0.9
sp.photo(rgb[:256, :256], depth[100:356, 250:506], focus=(200, 200), blur=8)
begin, processor = time.perf_counter(), time.process_time()
image = sp.photo(rgb, depth, focus=(2000, 1600), blur=40)
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
print(time.perf_counter() - begin, time.process_time() - processor, peak)
"""


def drawn(draw_alpha) -> np.ndarray:
    """Return the coverage (H, W) of what a function draws, anti-aliased."""
    image = Image.new("L", (FINER * SIZE[1], FINER * SIZE[0]))
    draw_alpha(ImageDraw.Draw(image))
    return np.asarray(image.reduce(FINER), np.float32) / 255


def noise(rng: np.random.Generator, width: float) -> np.ndarray:
    values = ndimage.gaussian_filter(rng.standard_normal(SIZE), width)
    return (0.5 + 0.2 * values / values.std()).clip(0.02, 1).astype(np.float32)


def portrait(rng: np.random.Generator):
    """Draw a head with hair, sharp, before a street at night."""

    def head(draw: ImageDraw.ImageDraw) -> None:
        x, y = FINER * 384, FINER * 300
        draw.ellipse((x - 440, y - 560, x + 440, y + 560), fill=255)
        for angle in rng.uniform(-2.6, -0.5, 220):
            start = np.array([x + 430 * np.cos(angle), y + 550 * np.sin(angle)])
            bend, length = rng.normal(0, 0.3), rng.uniform(80, 340)
            ways = [
                start + length * t * np.array([np.cos(angle + bend * t), np.sin(angle + bend * t)])
                for t in np.linspace(0, 1, 8)
            ]
            draw.line([tuple(each) for each in ways], fill=255, width=int(rng.integers(3, 8)))

    alpha = drawn(head)
    near = np.stack([0.5 * noise(rng, 3), 0.3 * noise(rng, 3), 0.22 * noise(rng, 3)], axis=-1)
    far = 0.08 * noise(rng, 12)[..., None] * np.array([0.8, 0.9, 1.2], np.float32)
    for _ in range(60):
        row, col = rng.integers(0, SIZE[0]), rng.integers(0, SIZE[1])
        far[row : row + 3, col : col + 3] = rng.uniform(0.3, 1.0) * np.array(
            [1.0, rng.uniform(0.5, 1), rng.uniform(0.2, 0.8)]
        )
    return alpha, near, far.astype(np.float32), 0.0, BLUR


def wires(rng: np.random.Generator):
    """Draw a fence out of focus before something sharp."""

    def lines(draw: ImageDraw.ImageDraw) -> None:
        for offset in range(-4000, 6000, 420):
            draw.line((offset, 0, offset + 2100, 2100), fill=255, width=36)
            draw.line((offset, 2100, offset + 2100, 0), fill=255, width=36)

    near = np.stack([0.2 * noise(rng, 4)] * 3, axis=-1)
    far = np.stack([noise(rng, 1.5), noise(rng, 1.5), noise(rng, 1.5)], axis=-1) * 0.7
    return drawn(lines), near, far, BLUR, 0.0


def disc(radius: float) -> np.ndarray:
    """Return the PSF of a radius, anti-aliased."""
    if not radius:
        return np.ones((1, 1))
    half = int(np.ceil(radius)) + 1
    fine = (np.arange((2 * half + 1) * 8) + 0.5) / 8 - half - 0.5
    inside = (np.hypot(*np.meshgrid(fine, fine)) <= radius).astype(float)
    psf = inside.reshape(2 * half + 1, 8, 2 * half + 1, 8).mean(axis=(1, 3))
    return psf / psf.sum()


def blurred(values: np.ndarray, radius: float) -> np.ndarray:
    psf = disc(radius)
    padded = np.pad(values, [(len(psf), len(psf))] * 2 + [(0, 0)], mode="edge")
    found = np.stack([signal.fftconvolve(plane, psf, mode="same") for plane in np.moveaxis(padded, 2, 0)], axis=-1)
    return found[len(psf) : -len(psf), len(psf) : -len(psf)]


DRAWN = tuple(enumerate({"portrait": portrait, "wires": wires}.items()))


class Photograph(NamedTuple):
    """What is blurred, and what should come of it.

    Attributes
    ----------
    name : str
    codes : ndarray of shape (H, W, 3), uint8
    truth : ndarray of shape (H, W, 3), float32
        Linear light.
    inverse : ndarray of shape (H, W)
        Inverse depth.
    focus : tuple
        As for `photo`.
    sharp : float
        Inverse depth of what is sharp.
    blur : float
        Radius, px, at the far end or at the near end.
    edge : ndarray of shape (H, W), bool, or None
        What is near the foreground's edge.
    """

    name: str
    codes: np.ndarray
    truth: np.ndarray
    inverse: np.ndarray
    focus: tuple
    sharp: float
    blur: float
    edge: np.ndarray | None


def gaussian_by_depth(image: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Return each pixel of the image blurred with the Gaussian of its radius."""
    radius = np.abs(radius)
    levels = np.linspace(0, radius.max(), 15)
    stack = np.stack([ndimage.gaussian_filter(image, (each / 2, each / 2, 0)) if each else image for each in levels])
    place = radius / levels[-1] * (len(levels) - 1)
    low = np.minimum(place.astype(int), len(levels) - 2)
    rows, cols = np.indices(radius.shape)
    share = (place - low)[..., None]
    return (1 - share) * stack[low, rows, cols] + share * stack[low + 1, rows, cols]


def slices_by_depth(image: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Return slices of depth, each blurred with a disc by OpenCV, put over each other; negative radii are nearer."""
    borders = np.linspace(radius.min(), radius.max(), SLICES + 1)
    number = np.clip(np.digitize(radius, borders) - 1, 0, SLICES - 1)
    # Behind all is the picture, as blurred as what is farthest.
    found = cv2.filter2D(image.astype(np.float32), -1, disc(abs(radius).max()), borderType=cv2.BORDER_REPLICATE)
    for each in range(SLICES - 1, -1, -1):
        inside = (number == each).astype(np.float32)[..., None]
        psf = disc(abs(borders[each] + borders[each + 1]) / 2)
        sums = cv2.filter2D(np.concatenate([inside * image, inside], axis=-1), -1, psf, borderType=cv2.BORDER_REPLICATE)
        found = sums[..., :3] + (1 - sums[..., 3:]) * found
    return found


def drawn_photograph(name: str, scene, rng: np.random.Generator) -> Photograph:
    """Draw a scene, and its truth."""
    alpha, near, far, near_blur, far_blur = scene(rng)
    share = alpha[..., None]
    codes = np.rint(255 * display_encode(share * near + (1 - share) * far)).astype(np.uint8)
    front = blurred(np.concatenate([share * near, share], axis=-1), near_blur)
    truth = (front[..., :3] + (1 - front[..., 3:]) * blurred(far, far_blur)).astype(np.float32)
    # The subject is the head, or the page between the wires.
    inner = ndimage.distance_transform_edt(np.pad(alpha < 0.05, 1))[1:-1, 1:-1]
    y, x = np.unravel_index(np.argmax(inner), SIZE)
    focus = (330, 260, 440, 380) if far_blur else (x - 4, y - 4, x + 4, y + 4)
    edge = ndimage.binary_dilation((alpha > 0.02) & (alpha < 0.98), iterations=EDGE_PX)
    return Photograph(name, codes, truth, (alpha > 0.5).astype(np.float32), focus, float(far_blur > 0), BLUR, edge)


def rendered_photograph(scene: Scene) -> Photograph:
    """Take a frame without motion for a photograph."""
    layer, camera = scene.pinhole.layers[0], scene.camera
    codes = np.rint(255 * display_encode(layer.radiance[..., :3])).astype(np.uint8)
    inverse, sharp = 1.0 / layer.depth, 1.0 / camera.focus_distance_m
    y, x = np.unravel_index(np.argmin(np.abs(inverse - sharp)), inverse.shape)
    least, most = np.quantile(inverse, STRAY)
    blur = camera.coc_scale(layer.raster.display.width) * max(sharp - least, most - sharp)
    truth = sp.read_image(scene.path("_ref_dof.exr"))[..., :3]
    return Photograph(scene.name, codes, truth, inverse, (float(x), float(y)), sharp, float(blur), None)


def predicted(inverse: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return inverse depth as a network gives it: small, soft, from 2.1 to 9.4."""
    least, most = np.quantile(inverse, STRAY)
    soft = ndimage.gaussian_filter(np.clip((inverse - least) / (most - least), 0, 1), 2.5)
    small = np.asarray(Image.fromarray(soft).resize([side // 4 for side in soft.shape[::-1]], Image.Resampling.BOX))
    return (7.3 * small + 2.1 + 0.02 * rng.standard_normal(small.shape)).astype(np.float32)


def rows(each: Photograph, kind: str, rng: np.random.Generator, pictures: Path | None) -> list[str]:
    """Return rows of a table: a photograph blurred by all methods."""
    depth, known = each.inverse, each.inverse
    least, most = np.quantile(each.inverse, STRAY)
    if kind == PREDICTED:
        depth = predicted(each.inverse, rng)
        whole = np.asarray(Image.fromarray(depth).resize(known.shape[::-1], Image.Resampling.BILINEAR))
        known = least + (most - least) * np.clip((whole - 2.1) / 7.3, 0, 1)
    linear = display_decode(each.codes / 255.0)
    radius = each.blur * (each.sharp - known) / max(each.sharp - least, most - each.sharp)
    made = {
        "photo": display_decode(sp.photo(each.codes, depth, focus=each.focus, blur=each.blur) / 255.0),
        "Gaussian by depth": gaussian_by_depth(linear, radius),
        **({"slices (OpenCV)": slices_by_depth(linear, radius)} if cv2 else {}),
    }
    lines = []
    for method, image in made.items():
        image = image.astype(np.float32)
        found = metrics.compare(image, each.truth)
        line = f"{each.name:9} {kind:13} {method:18} {found['ssim']:7.4f} {found['psnr']:7.2f}"
        if each.edge is not None:
            error = (display_encode(image) - display_encode(each.truth))[each.edge]
            line += f" {-10 * np.log10((error**2).mean()):7.2f}"
        lines.append(line)
    if pictures:
        shown = np.concatenate([display_encode(image) for image in (each.truth, *made.values())], axis=1)
        path = pictures / f"photo_{each.name}_{kind.replace(' ', '_')}.png"
        Image.fromarray(np.rint(255 * shown).astype(np.uint8)).save(path)
    return lines


def main() -> None:
    asked: argparse.ArgumentParser = parser(__doc__)
    asked.add_argument("--pictures", type=Path, help="write truth, photo and the others side by side there")
    given = asked.parse_args()
    taken = [(drawn_photograph(name, scene, np.random.default_rng(n)), (PREDICTED,)) for n, (name, scene) in DRAWN]
    taken += [(rendered_photograph(scene), (EXACT, PREDICTED)) for scene in scenes(given.frames, "_ref_dof.exr")]
    lines = ["scene     depth         method                SSIM    PSNR  PSNR near edges"]
    for each, kinds in taken:
        for kind in kinds:
            lines += rows(each, kind, np.random.default_rng(0), given.pictures)
    found = subprocess.run([sys.executable, "-c", MEGAPIXELS], capture_output=True, text=True, check=True).stdout
    wall, processor, peak = map(float, found.split())
    lines.append(f"12 megapixels: {wall:.1f} s, {processor:.1f} s of processor time; peak {peak:.2f} GB of memory")
    result_path("photo.txt").write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main()

"""Rendering with Cycles: one image of a scene, with or without lens and shutter, as arrays."""

from __future__ import annotations

import math
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import bpy
import numpy as np
import OpenEXR
from blocks import FRAME, make_motion_even
from mathutils import Matrix, Vector
from shot import SENSOR_MM, Shot

POINT_FILTER = "BLACKMAN_HARRIS", 0.01
"""Type and width, px, of the filter that samples at one point of a pixel: the least width that Cycles takes. It makes a
box 1 px wide, whatever it is told."""
FILTER_WIDTH = {"BOX": 1.0, "BLACKMAN_HARRIS": 1.5}
BOUNCES = ("max", "diffuse", "glossy", "transmission", "volume")


@dataclass
class Image:
    """What a rendering gives: colour (H, W, 4), premultiplied; depth (H, W); vectors (H, W, 4) or None; seconds."""

    colour: np.ndarray
    depth: np.ndarray
    vectors: np.ndarray | None
    seconds: float


@dataclass
class Renderer:
    """A scene that is built, and how large it is rendered.

    Parameters
    ----------
    shot : Shot
    width : int
        Of the image, px.
    """

    shot: Shot
    width: int
    camera: bpy.types.Object = field(init=False)

    def __post_init__(self) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self._set_up_renderer()
        self._set_up_output()
        self.camera = self._add_camera()

    def _set_up_renderer(self) -> None:
        """Direct light only, so that little noise is left; nothing adaptive, nothing denoised."""
        scene = bpy.context.scene
        scene.render.engine = "CYCLES"
        scene.world = bpy.data.worlds.new("world")
        scene.world.use_nodes = True
        cycles = scene.cycles
        cycles.device = "CPU"
        cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_auto_tile = cycles.use_light_tree = False
        cycles.caustics_reflective = cycles.caustics_refractive = False
        for kind in BOUNCES:
            setattr(cycles, f"{kind}_bounces", 0)
        cycles.transparent_max_bounces = 4
        cycles.light_sampling_threshold = 0.0

    def _set_up_output(self) -> None:
        """Write all passes in full floats, in the colours of the scene."""
        scene = bpy.context.scene
        render = scene.render
        render.resolution_y, render.resolution_x = self.shot.shape(self.width)
        render.resolution_percentage = 100
        render.use_compositing = render.use_sequencer = render.use_file_extension = False
        image = render.image_settings
        image.media_type, image.file_format = "MULTI_LAYER_IMAGE", "OPEN_EXR_MULTILAYER"
        image.color_depth, image.exr_codec = "32", "ZIP"
        scene.view_settings.view_transform = "Raw"
        render.motion_blur_shutter, render.motion_blur_position = self.shot.shutter or 1.0, "CENTER"
        scene.view_layers[0].use_pass_z = True
        scene.frame_set(FRAME)

    def _add_camera(self) -> bpy.types.Object:
        """Add the camera of the shot."""
        data = bpy.data.cameras.new("camera")
        data.lens, data.sensor_width, data.sensor_fit = self.shot.focal_length_mm, SENSOR_MM, "HORIZONTAL"
        data.clip_start, data.clip_end = 0.01, 1000
        data.dof.aperture_fstop, data.dof.focus_distance = self.shot.f_number, self.shot.focus_distance_m
        item = bpy.data.objects.new("camera", data)
        bpy.context.scene.collection.objects.link(item)
        item.rotation_euler, item.location = (math.radians(90) + self.shot.pitch, 0, 0), self.shot.place
        bpy.context.scene.camera = item
        return item

    def render(
        self,
        samples: int,
        *,
        defocus: bool = False,
        motion_blur: bool = False,
        points: bool = False,
        layer: int | None = None,
        time_frames: float = 0.0,
        seed: int = 0,
    ) -> Image:
        """Render one image.

        Parameters
        ----------
        samples : int
            In each pixel.
        defocus, motion_blur : bool, optional
            Whether the lens and the shutter have an extent.
        points : bool, optional
            Sample at the pixel's centre alone, in place of the shot's filter.
        layer : int, optional
            Show only the objects of this layer, on nothing.
        time_frames : float, optional
            From the frame's time.
        seed : int, optional
        """
        scene = bpy.context.scene
        make_motion_even()
        cycles, shot = scene.cycles, self.shot
        cycles.samples, cycles.seed = samples, seed
        own = shot.pixel_filter, FILTER_WIDTH[shot.pixel_filter]
        cycles.pixel_filter_type, cycles.filter_width = POINT_FILTER if points else own
        self.camera.data.dof.use_dof, scene.render.use_motion_blur = defocus, motion_blur
        scene.view_layers[0].use_pass_vector = not motion_blur
        scene.render.film_transparent = layer is not None
        for item in (item for item in bpy.data.objects if item.type == "MESH"):
            item.visible_camera = layer is None or item["layer"] == layer
        whole = math.floor(time_frames)
        scene.frame_set(FRAME + whole, subframe=time_frames - whole)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "image.exr"
            scene.render.filepath = str(path)
            began = time.perf_counter()
            bpy.ops.render.render(write_still=True)
            return read_passes(path, time.perf_counter() - began)

    def look_through(self, u: float, v: float, offset: tuple[float, float]) -> None:
        """Move the camera to a point of the lens, and its sensor so that what is in focus stays where it is.

        Parameters
        ----------
        u, v : float
            Place on the unit disc; a point with a circle of confusion of radius c is seen c * (u, v) px to the right
            and below of where the middle of the lens sees it.
        offset : tuple of float
            The point of each pixel that is sampled, px from its centre.
        """
        radius = self.shot.aperture_m / 2
        right, up = radius * u, -radius * v
        data = self.camera.data
        turn = Matrix.Rotation(math.radians(90) + self.shot.pitch, 3, "X")
        self.camera.location = Vector(self.shot.place) + turn @ Vector((right, up, 0))
        # The sensor's shift is in widths of the image, which moves the other way.
        focus = self.shot.focal_length_px(self.width) / self.shot.focus_distance_m
        data.shift_x = (-right * focus + offset[0]) / self.width
        data.shift_y = (-up * focus - offset[1]) / self.width


def read_passes(path: Path, seconds: float = 0.0) -> Image:
    """Read the passes of a file as Blender 5 writes it, a part for each pass."""
    found: dict[str, dict[str, np.ndarray]] = {}
    with OpenEXR.File(str(path), separate_channels=True) as file:
        for part in file.parts:
            for name, channel in part.channels.items():
                kind, component = name.split(".")[-2:]
                found.setdefault(kind, {})[component] = channel.pixels.astype(np.float32)
    colour, depth = np.stack([found["Combined"][each] for each in "RGBA"], axis=-1), found["Depth"].popitem()[1]
    vectors = np.stack([found["Vector"][each] for each in "XYZW"], axis=-1) if "Vector" in found else None
    return Image(colour, depth, vectors, seconds)

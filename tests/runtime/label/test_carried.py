"""The camera's own move, against a scene whose rays are cast at many moments and places on the lens."""

import numpy as np
import pytest
from scipy import ndimage

import spreadlets as sp
from spreadlets.runtime.label.carried import carried

HEIGHT, WIDTH = 72, 96
SHUTTER = (-0.25, 0.25)
WALL_M, CARD_M = 6.0, 3.0
RNG = np.random.default_rng(7)
TEXTURES = [
    np.clip(4.0 * ndimage.gaussian_filter(RNG.random((512, 512, 3)), (3, 3, 0), mode="wrap") - 1.5, 0.02, 1.0)
    for _ in range(2)
]
TEXELS_PER_M = 60.0


def pose(x=0.0, y=0.0, z=0.0, turn=0.0, roll=0.0):
    """Return a camera at a place that is turned to the left and rolled, radians."""
    yaw = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    spin = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = yaw @ spin, (x, y, z)
    return matrix


def lens(*keys, f_number=0.8, **settings):
    return sp.ThinLens(40, 36, f_number, 4.0, shutter=SHUTTER, keys=tuple(keys), **settings)


def cast(camera, time, lens_uv=(0.0, 0.0), jitter=(0.0, 0.0)):
    """Return colour and planar depth of a wall and a card before it, seen through a place on the lens at a time."""
    focal_px = camera.value_at("focal_length_mm", time) / camera.sensor_width_mm * WIDTH
    x, y = np.meshgrid(
        np.arange(WIDTH) - 0.5 * (WIDTH - 1) + jitter[0], np.arange(HEIGHT) - 0.5 * (HEIGHT - 1) + jitter[1]
    )
    radius, focus = 0.5 * camera.aperture_diameter_m, camera.focus_distance_m
    # What lies in the plane of focus is seen in the same pixel through all of the lens.
    begin = np.array([lens_uv[0] * radius, lens_uv[1] * radius, 0.0])
    toward = np.stack([x / focal_px * focus, -y / focal_px * focus, np.full(x.shape, -focus)], axis=-1) - begin
    matrix = np.asarray(camera.pose_at(time))
    begin, toward = matrix[:3, :3] @ begin + matrix[:3, 3], toward @ matrix[:3, :3].T
    colour, depth = np.zeros((HEIGHT, WIDTH, 3)), np.full((HEIGHT, WIDTH), np.inf)
    for distance, texture, half in ((WALL_M, TEXTURES[0], np.inf), (CARD_M, TEXTURES[1], 0.5)):
        share = (-distance - begin[2]) / toward[..., 2]
        hit = begin + share[..., None] * toward
        inside = np.maximum(np.abs(hit[..., 0]), np.abs(hit[..., 1])) < half
        at = np.moveaxis(hit[..., :2] * TEXELS_PER_M, 2, 0)
        seen = np.stack([ndimage.map_coordinates(texture[..., c], at, order=1, mode="grid-wrap") for c in range(3)], -1)
        colour[inside], depth[inside] = seen[inside], (share * focus)[inside]
    return colour, depth


def pinhole(camera):
    """Return the frame of a pinhole at its time."""
    places = (np.arange(4) + 0.5) / 4 - 0.5
    colour = np.mean([cast(camera, 0.0, jitter=(dx, dy))[0] for dx in places for dy in places], axis=0)
    return sp.Frame(colour, cast(camera, 0.0)[1])


def truth(camera, n_rays=96):
    """Return the mean of many moments, each through its own place on the lens and in the pixel."""
    steps = np.arange(n_rays)
    # A lattice fills the five dimensions evenly (Roberts' generalised golden ratio).
    root = 1.1673039782614187
    u = (0.5 + steps[:, None] * root ** -np.arange(1.0, 5.0)) % 1.0
    total = np.zeros((HEIGHT, WIDTH, 3))
    for (a, b, dx, dy), step in zip(u, steps, strict=True):
        disc = np.sqrt(a) * np.array([np.cos(2 * np.pi * b), np.sin(2 * np.pi * b)])
        time = SHUTTER[0] + (step + 0.5) / n_rays * (SHUTTER[1] - SHUTTER[0])
        total += cast(camera, time, disc, (dx - 0.5, dy - 0.5))[0]
    return (total / n_rays).astype(np.float32)


def inner_ssim(image, expected):
    inner = slice(8, -8)
    return sp.metrics.compare(np.ascontiguousarray(image[inner, inner, :3]), expected[inner, inner])["ssim"]


MOVES = {
    "dolly": {"z": -1.2},
    "truck": {"x": 0.5},
    "pan and roll": {"turn": 0.25, "roll": 0.3},
    "all": {"x": 0.3, "y": -0.2, "z": -0.8, "turn": 0.1, "roll": 0.15},
}


def moving(name, **settings):
    """Return a camera that moves so much in a frame; at the frame's time it is where it would be without."""
    keys = [
        sp.LensKey(time, camera_to_world=pose(**{k: time * v for k, v in MOVES[name].items()})) for time in (-0.5, 0.5)
    ]
    return lens(*keys, **settings)


@pytest.mark.parametrize("name", MOVES)
def test_a_still_world_moves_as_the_camera_does(name):
    camera = moving(name)
    frame, expected = pinhole(camera), truth(camera)
    image, report = sp.synthesize(frame, camera, "combined", report=True)
    assert report.plan.motion_from == "camera"
    assert inner_ssim(image, expected) > 0.985
    assert inner_ssim(sp.synthesize(frame, camera.at(0.0), "combined"), expected) < 0.97


def flat(depth=3.0, **labels):
    return sp.Frame(np.full((HEIGHT, WIDTH, 3), 0.5), np.full((HEIGHT, WIDTH), depth), **labels)


def test_a_zoom_moves_pixels_away_from_the_middle():
    camera = lens(sp.LensKey(-0.25, focal_length_mm=38.0), sp.LensKey(0.25, focal_length_mm=42.0))
    (layer,) = carried(flat().layers, camera)
    assert layer.motion[0, 0] == pytest.approx([-0.2 * 47.5, -0.2 * 35.5], rel=1e-4)
    assert layer.motion_prev is None and layer.depth_prev is None


def test_keys_of_whole_frames_give_the_places_there():
    poses = {-1.0: pose(x=-0.1), 0.0: pose(), 1.0: pose(x=0.3)}
    (layer,) = carried(flat().layers, lens(*(sp.LensKey(t, camera_to_world=each) for t, each in poses.items())))
    px_per_m = 40 / 36 * WIDTH / 3.0
    assert layer.motion_prev[9, 9] == pytest.approx([-0.1 * px_per_m, 0.0], rel=1e-5)
    assert layer.motion_next[9, 9] == pytest.approx([-0.3 * px_per_m, 0.0], rel=1e-5)


def test_what_is_infinitely_far_turns_with_the_camera_and_does_not_come_nearer():
    (layer,) = carried(flat(np.inf).layers, moving("all"))
    turned = carried(
        flat(np.inf).layers,
        lens(*(sp.LensKey(t, camera_to_world=pose(turn=0.1 * t, roll=0.15 * t)) for t in (-0.5, 0.5))),
    )
    assert layer.motion == pytest.approx(turned[0].motion, abs=1e-4)
    assert layer.depth_prev is None


def test_vectors_stay_and_what_stands_still_changes_its_depth():
    camera = moving("dolly")
    (still,) = carried(flat().layers, camera)
    motion = still.motion.copy()
    motion[:, : WIDTH // 2] += 5.0
    (layer,) = carried(flat(motion=motion).layers, camera)
    assert np.array_equal(layer.motion, motion)
    assert np.all(layer.depth_next[:, : WIDTH // 2] == 3.0)
    # The parabola of 1 / depth through 3.6, 3 and 2.4 m, half a frame apart.
    assert layer.depth_next[:, WIDTH // 2 :] == pytest.approx(36 / 19, rel=1e-5)
    assert still.depth_prev == pytest.approx(4.0, rel=1e-5)


def test_nothing_is_carried_by_a_camera_without_keys():
    assert not lens(sp.LensKey(0.0, camera_to_world=pose(x=1.0))).moves_picture
    image, report = sp.synthesize(flat(), lens(), "combined", report=True)
    assert report.plan.motion_from == "none"
    _, report = sp.synthesize(flat(motion=np.ones((HEIGHT, WIDTH, 2))), moving("truck"), "combined", report=True)
    assert report.plan.motion_from == "vectors"

"""The renderer: the images of `synthesize`, from what it keeps; parts of the picture, and what stays sharp."""

import threading
from dataclasses import replace

import numpy as np
import pytest

import spreadlets as sp
from spreadlets.errors import InvalidFrameError, InvalidParameterError
from spreadlets.scene.raster import Raster, Window

CAMERA = sp.ThinLens(focal_length_mm=80, sensor_width_mm=36, f_number=1.2, focus_distance_m=2.0)
SHAPE = (96, 128)
NEAR, FAR = 2.0, 8.0


def texture():
    rng = np.random.default_rng(7)
    return rng.random((*SHAPE, 3)).astype(np.float32)


def square(rows=slice(30, 66), cols=slice(40, 88)):
    """A near square before a wall."""
    near = np.zeros(SHAPE, bool)
    near[rows, cols] = True
    return near


@pytest.fixture(scope="module")
def frame():
    return sp.Frame(texture(), np.where(square(), NEAR, FAR))


@pytest.fixture(scope="module")
def renderer(frame):
    with sp.Renderer(frame, "simplelens") as made:
        yield made


def test_its_images_are_those_of_synthesize_whatever_it_was_asked_before(frame, renderer):
    other = replace(CAMERA, focus_distance_m=5.0, f_number=2.0)
    renderer.render(other)
    np.testing.assert_array_equal(renderer.render(CAMERA), sp.synthesize(frame, CAMERA, "simplelens"))
    image, report = renderer.render(other, report=True)
    np.testing.assert_array_equal(image, sp.synthesize(frame, other, "simplelens"))
    assert report.plan.layers > 0


def test_what_is_kept_is_not_computed_again(frame, monkeypatch):
    from spreadlets.runtime.label import surfaces

    calls = []
    split = surfaces.split_surfaces
    monkeypatch.setattr(surfaces, "split_surfaces", lambda *given: calls.append(1) or split(*given))
    with sp.Renderer(frame, "simplelens") as fresh:
        for focus in (2.0, 3.0, 4.0):
            fresh.render(replace(CAMERA, focus_distance_m=focus))
    # The first picture, which may be the only one, keeps nothing.
    assert len(calls) == 2


def test_elements_are_drawn_by_the_plan_of_the_picture(frame, renderer, monkeypatch):
    from spreadlets.runtime import render
    from spreadlets.runtime.label import surfaces

    rows, columns = np.mgrid[: frame.shape[0], : frame.shape[1]]
    part = np.ones((*frame.shape, 4), np.float32)
    part[..., :3] = (0.5 + 0.4 * np.sin(rows / 9) * np.sin(columns / 7))[..., None]
    rest = np.float32([1, 1, 1, 2]) - part
    alone = [renderer.render(CAMERA, tolerance=0.0) for _ in range(2)][-1]
    calls = []
    plan_pixels = render.plan_pixels
    monkeypatch.setattr(render, "plan_pixels", lambda *given, **more: calls.append(1) or plan_pixels(*given, **more))
    monkeypatch.setattr(surfaces, "split_surfaces", lambda *given: calls.append(2) or [])
    elements = [frame.coloured(frame.radiance * share) for share in (part, rest)]
    (image, first, second), report = renderer.render_all(elements, CAMERA, tolerance=0.0)
    assert calls == [1]  # what the picture shows where is kept
    np.testing.assert_array_equal(image, alone)
    np.testing.assert_array_equal(first[..., 3], image[..., 3])
    error = np.abs(first + second - image)[..., :3]
    # At the pixels of two surfaces: measured 5e-4 and 0.0905.
    assert error.mean() < 1e-3 * image[..., :3].mean() and error.max() < 0.12
    assert report.plan.pixels_sparse + report.plan.pixels_dense <= 2 * frame.depth.size


def test_several_threads_may_ask_at_once(renderer):
    cameras = [replace(CAMERA, focus_distance_m=focus) for focus in (2.0, 3.0, 5.0, 8.0)]
    alone = [renderer.render(camera) for camera in cameras]
    found = [None] * len(cameras)

    def work(number):
        found[number] = renderer.render(cameras[number])

    threads = [threading.Thread(target=work, args=(number,)) for number in range(len(cameras))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for one, other in zip(alone, found, strict=True):
        np.testing.assert_array_equal(one, other)


def test_coc_is_signed_and_follows_the_controls(renderer):
    far_coc = CAMERA.coc_scale(SHAPE[1]) * (1 / NEAR - 1 / FAR)
    coc = renderer.coc(CAMERA)
    assert coc[40, 50] == 0.0 and coc[0, 0] == pytest.approx(far_coc)
    assert renderer.coc(CAMERA, far_strength=0.5)[0, 0] == pytest.approx(0.5 * far_coc)
    assert renderer.coc(CAMERA, focus_at=(0, 0))[40, 50] == pytest.approx(-far_coc)
    assert renderer.coc(CAMERA, region=(10, 20, 30, 40)).shape == (40, 30)


def test_depth_under_a_point_is_that_of_its_surface_even_at_an_edge(renderer):
    assert renderer.depth_at(0, 0) == FAR
    assert renderer.depth_at(40, 30) == NEAR  # the corner of the square: most pixels around are the wall's
    assert renderer.depth_at(39, 30) == FAR
    with pytest.raises(InvalidParameterError, match="128,0 lies outside the frame's 128 x 96 px"):
        renderer.depth_at(128, 0)
    for nowhere in (np.nan, np.inf):
        with pytest.raises(InvalidParameterError, match=f"the point 3,{nowhere} lies outside"):
            renderer.depth_at(3, nowhere)


def test_depth_of_layers_is_that_of_what_is_seen(frame):
    colours = np.zeros((*SHAPE, 4), np.float32)
    colours[square()] = (1, 1, 1, 0.8)
    with sp.Renderer([sp.Frame(colours, np.full(SHAPE, 1.0)), frame], "simplelens") as layered:
        assert layered.depth_at(60, 50) == 1.0
        assert layered.depth_at(0, 0) == FAR


def test_focus_at_a_point_is_focus_at_its_depth(renderer):
    at = renderer.render(CAMERA, focus_at=(0, 0))
    np.testing.assert_array_equal(at, renderer.render(replace(CAMERA, focus_distance_m=FAR)))
    assert renderer.camera(CAMERA, focus_at=(0, 0)).focus_distance_m == FAR


@pytest.mark.parametrize("region", [(30, 20, 50, 60), (0, 0, 128, 96), (100, 70, 28, 26)])
def test_a_region_equals_the_same_pixels_of_the_whole(renderer, region):
    x, y, width, height = region
    whole = renderer.render(CAMERA, focus_at=(60, 50))
    part = renderer.render(CAMERA, focus_at=(60, 50), region=region)
    np.testing.assert_allclose(part, whole[y : y + height, x : x + width], atol=1e-5)
    assert renderer.raster(region=region).data == region


def test_a_region_beyond_the_frame_is_refused(renderer):
    with pytest.raises(InvalidParameterError, match="region is 100,0,29,10: it must lie within the frame's 128 x 96"):
        renderer.render(CAMERA, region=(100, 0, 29, 10))


@pytest.mark.parametrize("share", [0.5, 0.4])
def test_a_proxy_is_the_picture_made_smaller(renderer, share):
    from spreadlets.scene.parts import means

    whole = renderer.render(CAMERA, near_strength=0.5, max_coc=4.0)
    proxy = renderer.render(CAMERA, near_strength=0.5, max_coc=4.0, proxy=share)
    assert proxy.shape[:2] == (round(share * SHAPE[0]), round(share * SHAPE[1]))
    # Of the wall's blur all is seen; single pixels of noise are the square's alone.
    wall = means((~square(slice(20, 76), slice(30, 98))).astype(np.float32), proxy.shape[:2]) == 1.0
    error = np.abs(proxy - means(whole, proxy.shape[:2]))[wall]
    assert error.mean() < 0.02
    assert renderer.raster(proxy=share).data.shape == proxy.shape[:2]


def test_the_largest_coc_is_in_pixels_of_the_whole_frame_for_a_proxy_too(renderer):
    bounded = renderer.render(CAMERA, max_coc=1.5, proxy=0.5)
    as_strength = renderer.render(CAMERA, far_strength=1.5 / float(renderer.coc(CAMERA)[0, 0]), proxy=0.5)
    np.testing.assert_allclose(bounded, as_strength, atol=1e-3)


def test_a_mask_stays_sharp_and_gives_no_light_away(frame, renderer):
    bright = texture()
    bright[square()] = 50.0
    mask = square().astype(np.float32)
    lamp = sp.Frame(bright, np.full(SHAPE, FAR))
    with sp.Renderer(lamp, "simplelens") as made:
        image = made.render(CAMERA, mask=mask)
        assert made.render(CAMERA)[28, 60, 0] > 2.0
    np.testing.assert_array_equal(image[square()], lamp.radiance[square()])
    assert image[~square()][:, :3].max() < 1.0
    np.testing.assert_allclose(image[..., 3], 1.0, atol=1e-4)
    around = square(slice(24, 72), slice(34, 94)) & ~square()
    assert image[around][:, 0].mean() == pytest.approx(0.5, abs=0.05)  # no dark or bright rim


def test_masks_that_do_not_fit_are_refused(frame, renderer):
    with pytest.raises(InvalidFrameError, match=r"mask has shape \(3, 4\), the frame \(96, 128\)"):
        renderer.render(CAMERA, mask=np.zeros((3, 4)))
    with pytest.raises(InvalidFrameError, match="mask holds 0 to 2"):
        renderer.render(CAMERA, mask=2.0 * square())
    with pytest.raises(InvalidFrameError, match="mask is not finite"):
        renderer.render(CAMERA, mask=np.full(SHAPE, np.nan))
    with sp.Renderer([frame, frame], "simplelens") as layered, pytest.raises(InvalidParameterError, match="one layer"):
        layered.render(CAMERA, mask=np.zeros(SHAPE))


def test_highlights_make_the_blur_of_a_lamp_brighter(frame):
    lamp = np.full((*SHAPE, 3), 0.1, np.float32)
    lamp[48, 64] = 10.0
    with sp.Renderer(sp.Frame(lamp, np.full(SHAPE, FAR)), "simplelens") as made:
        plain, bright = made.render(CAMERA), made.render(CAMERA, highlights=(3.0, 1.0))
    gained = (bright - plain)[..., 0].sum()
    assert gained == pytest.approx(2.0 * 9.0, rel=0.02)


def test_a_notebook_shows_the_last_picture(renderer):
    from io import BytesIO

    from PIL import Image

    renderer.render(CAMERA, proxy=0.5)
    assert Image.open(BytesIO(renderer._repr_png_())).size == (64, 48)


def test_samples_take_no_controls():
    shape = (8, 8, 2)
    samples = sp.SampleBuffer(
        radiance=np.ones((*shape, 3)),
        depth=np.full(shape, 4.0),
        motion=np.zeros((*shape, 2)),
        lens_uv=np.zeros((*shape, 2)),
        time=np.zeros(shape),
    )
    with pytest.raises(InvalidParameterError, match="near_strength is for frames"):
        sp.reconstruct(samples, CAMERA, near_strength=0.5)


def test_focus_at_a_point_overrides_a_pull_of_the_focus(renderer):
    pull = replace(CAMERA, keys=(sp.LensKey(0.0, focus_distance_m=3.0), sp.LensKey(1.0, f_number=2.0)))
    held = renderer.camera(pull, focus_at=(0, 0))
    assert held.at(0.0).focus_distance_m == held.at(1.0).focus_distance_m == FAR
    assert held.at(1.0).f_number == 2.0


def test_focus_at_a_point_leaves_the_cameras_move_as_it_is(renderer):
    aside = np.eye(4)
    aside[0, 3] = 0.3
    keys = (sp.LensKey(-0.25, camera_to_world=np.eye(4)), sp.LensKey(0.25, camera_to_world=aside))
    moving = replace(CAMERA, keys=keys)
    at, report = renderer.render(moving, focus_at=(0, 0), report=True)
    assert report.plan.motion_from == "camera"
    np.testing.assert_array_equal(at, renderer.render(replace(moving, focus_distance_m=FAR)))


def test_coc_of_a_lens_that_is_pulled_is_that_in_mid_exposure(renderer):
    pull = replace(CAMERA, keys=(sp.LensKey(-0.25, focus_distance_m=4.0), sp.LensKey(0.25, focus_distance_m=6.0)))
    np.testing.assert_array_equal(renderer.coc(pull), renderer.coc(replace(CAMERA, focus_distance_m=5.0)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"layers": 1.5}, "layers is 1.5: allowed are 1 to 64"),
        ({"layers": "2"}, "layers is '2': allowed are 1 to 64"),
        ({"region": (0.5, 0, 10, 5)}, "needed are x, y, width and height in whole px"),
    ],
)
def test_what_is_no_whole_number_is_refused(renderer, options, message):
    with pytest.raises(InvalidParameterError, match=message):
        renderer.render(CAMERA, **options)


def test_pairs_may_be_lists(renderer):
    np.testing.assert_array_equal(
        renderer.render(CAMERA, in_focus=[2.0, 4.0], highlights=[3.0, 0.5], region=[3, 4, 20, 10]),
        renderer.render(CAMERA, in_focus=(2.0, 4.0), highlights=(3.0, 0.5), region=(3, 4, 20, 10)),
    )


ZOOM = (sp.LensKey(-0.25, focal_length_mm=78.0), sp.LensKey(0.25, focal_length_mm=82.0))


@pytest.mark.parametrize("aspect", [1.0, 2.0])
def test_the_motion_under_a_point_is_what_is_drawn(frame, aspect):
    """That of the frame's vectors; in a frame without any, in its own pixels, that of the camera's zoom or move."""
    camera = replace(CAMERA, keys=ZOOM)
    raster = Raster(Window(-8, 4, 128, 96), Window(-16, 0, 160, 104), aspect)
    layer = replace(frame.layers[0], raster=raster)
    still = sp.Frame.of([layer])
    with sp.Renderer(still, "combined") as renderer:
        # A zoom of 4 in 80 mm within half a frame moves what is seen away from the middle at (63.5, 51.5).
        assert renderer.motion_at(camera, -8, 4) == pytest.approx((-71.5 / 10, -47.5 / 10), rel=2e-2)
        assert renderer.motion_at(CAMERA, -8, 4) == (0.0, 0.0)
        with pytest.raises(InvalidParameterError, match="the point 120,4 lies outside"):
            renderer.motion_at(camera, 120, 4)
    moving = sp.Frame.of([replace(layer, motion=np.full((*SHAPE, 2), 3.0, np.float32), has_motion=True)])
    with sp.Renderer(moving, "combined") as renderer:
        assert renderer.motion_at(camera, -8, 4) == (3.0, 3.0)

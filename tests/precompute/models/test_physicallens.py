import importlib.util
import math

import numba
import numpy as np
import optical_reference
import pytest

from spreadlets.errors import InvalidFileError, InvalidParameterError
from spreadlets.precompute.models import physicallens
from spreadlets.precompute.models.colour import LONGEST_NM, SHORTEST_NM, observer, rgb_response
from spreadlets.precompute.models.grids import model_settings
from spreadlets.precompute.models.physicallens import focused_lens, trace_bundle
from spreadlets.precompute.models.prescription import (
    LINE_C_NM,
    LINE_D_NM,
    LINE_F_NM,
    chief_scale,
    image_distance,
    paraxial,
    parse_prescription,
    read_prescription,
    refractive_index,
    shipped_lenses,
)
from spreadlets.precompute.models.registry import trace_psf
from spreadlets.psf.model import PsfGrid, get_model
from spreadlets.scene.camera import ThinLens

TOLERANCE = 1e-6
"""Relative difference to the independent library."""

TINY_MM = 1e-9
"""Absolute difference where the true value is zero."""

SINGLET = """title thick ball
radius thickness glass semi_diameter conic
stop 0 air 5 -
50 4 1.5/60 8 0
-50 40 air 8 0
"""

REFLECTING = """title dome
radius thickness glass semi_diameter conic
40 40 2.4/40 40 0
stop 5 2.4/40 0.5 -
inf 40 air 40 0
"""

MISSING = """title bead
radius thickness glass semi_diameter conic
stop 20 air 0.5 -
12 20 1.5/60 12 0
-12 10 air 12 0
"""

compiled = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="thousands of rays need the compiled kernels")


def reference_rows():
    for line in optical_reference.REFERENCE.read_text().splitlines()[1:]:
        name, *numbers = line.split()
        yield name, *map(float, numbers)


def traced(lens, pupil, pupil_radius, sensor, slope, wavelength):
    """Trace the reference's rays through a lens: x, y on the sensor, mm."""
    place = optical_reference.pupil_rays(pupil_radius)[None]
    slopes = np.broadcast_to(np.array([slope, 0.0]), place.shape)
    out, _ = physicallens._trace(lens, pupil, sensor, place, slopes, lens.indices(np.array([wavelength])))
    return out[0, :, 0], out[0, :, 1]


def assert_agrees(rows):
    rows = list(rows)
    assert len(rows) == 3 * 3 * 5
    for name, field, wavelength, pupil, pupil_radius, sensor, focal_length, chief, spot in rows:
        lens = read_prescription(name)
        close = {"rel": TOLERANCE, "abs": TINY_MM}
        at_d = paraxial(lens)
        assert at_d.pupil_distance == pytest.approx(pupil, **close)
        assert at_d.pupil_radius == pytest.approx(pupil_radius, **close)
        assert at_d.back_focus == pytest.approx(sensor, **close)
        assert paraxial(lens, wavelength).focal_length == pytest.approx(focal_length, **close)
        x, y = traced(lens, pupil, pupil_radius, sensor, math.tan(math.radians(field)), wavelength)
        assert x[0] == pytest.approx(chief, **close)
        assert optical_reference.spot_radius(x, y) == pytest.approx(spot, **close)


def test_ray_trace_agrees_with_the_recorded_figures_of_an_independent_library():
    assert_agrees(reference_rows())


@pytest.mark.skipif(importlib.util.find_spec("optiland") is None, reason="optiland is not installed")
def test_ray_trace_agrees_with_the_independent_library_itself():
    assert_agrees(
        row for name, field in optical_reference.LENSES.items() for row in optical_reference._rows(name, field)
    )


def test_lenses_that_ship_are_those_compared():
    assert set(shipped_lenses()) == set(optical_reference.LENSES)


@pytest.mark.parametrize(
    "terms, nd, abbe",
    [
        ((1.03961212, 0.231792344, 1.01046945, 0.00600069867, 0.0200179144, 103.560653), 1.51680, 64.17),
        ((1.52481889, 0.187085527, 1.42729015, 0.011254756, 0.0588995392, 129.141675), 1.67271, 32.25),
        ((1.670, 47.1), 1.670, 47.1),
    ],
)
def test_glasses_have_the_catalogue_index_and_abbe_number(terms, nd, abbe):
    f, d, c = refractive_index(terms, np.array([LINE_F_NM, LINE_D_NM, LINE_C_NM]))
    assert d == pytest.approx(nd, abs=1e-5)
    assert (d - 1) / (f - c) == pytest.approx(abbe, abs=0.01)


def test_thin_symmetric_lens_obeys_the_lensmaker():
    lens = parse_prescription(SINGLET, "ball")
    n, r, t = 1.5, 50.0, 4.0
    power = (n - 1) * (2 / r - (n - 1) * t / (n * r * r))
    found = paraxial(lens)
    assert found.focal_length == pytest.approx(1 / power)
    assert found.back_focus == pytest.approx((1 - (n - 1) * t / (n * r)) / power)
    assert (found.pupil_distance, found.pupil_radius) == (0.0, 5.0)
    # An object at twice the focal length before the first principal plane has its image at twice, behind the second.
    before = 2 / power + (n - 1) * t / (n * r) / power
    first_principal = (n - 1) * t / (n * r) / power
    assert image_distance(lens, 2 / power - first_principal) == pytest.approx(2 / power - first_principal)
    assert before > 2 / power


def test_a_full_ball_focuses_where_it_should():
    """Its surfaces are one sphere: f = n R / (2 (n - 1)) from its middle; rays start where the second one begins."""
    text = SINGLET.replace("50 4", "25 50").replace("-50 40", "-25 40").replace("stop 0 air 5", "stop 0 air 0.01")
    lens = parse_prescription(text, "ball")
    focus = 1.5 * 25.0 / (2 * 0.5) - 25.0
    x, y = traced(lens, 0.0, 0.01, focus, 0.0, LINE_D_NM)
    assert paraxial(lens).back_focus == pytest.approx(focus)
    assert np.hypot(x, y).max() < 1e-6


def test_paraboloid_has_no_spherical_aberration_but_the_sphere_has():
    """A plano-convex lens with a conic of -n^2 behind collimates rays of all heights into one point (Descartes)."""
    text = SINGLET.replace("\n50 4", "\ninf 4").replace("-50 40 air 8 0", "-50 40 air 8 {}")
    radii = []
    for conic in ("0", "-2.25"):
        lens = parse_prescription(text.format(conic), "plano")
        x, y = traced(lens, 0.0, 5.0, paraxial(lens).back_focus, 0.0, LINE_D_NM)
        radii.append(optical_reference.spot_radius(x, y))
    assert radii[1] < 1e-12 < 1e-3 < radii[0]


def test_observer_peaks_where_the_eye_does_and_even_light_is_white():
    wavelength = np.arange(400.0, 700.0)
    x, y, z = observer(wavelength).T
    assert [wavelength[curve.argmax()] for curve in (x, y, z)] == pytest.approx([599, 556, 446], abs=5)
    assert y.max() == pytest.approx(1.0, abs=0.02)
    step = (np.arange(3000) + 0.5) / 3000
    mean = rgb_response(SHORTEST_NM + (LONGEST_NM - SHORTEST_NM) * step).mean(axis=0)
    np.testing.assert_allclose(mean, 1.0, rtol=1e-5)


def camera(**changes):
    values = {"focal_length_mm": 50.0, "sensor_width_mm": 36.0, "f_number": 4.0, "focus_distance_m": 2.0}
    return ThinLens(**(values | changes))


def test_lens_is_scaled_stopped_down_and_focused():
    settings = model_settings("physicallens", {"lens": "double_gauss", "camera": camera(), "width": 720})
    focused = focused_lens(settings)
    first_order = paraxial(focused.lens)
    assert first_order.focal_length == pytest.approx(50.0)
    assert first_order.pupil_radius == pytest.approx(50.0 / 8)
    # Focused by the least spot, close to the paraxial image.
    assert focused.sensor_distance == pytest.approx(image_distance(focused.lens, 2000.0), abs=0.1)
    assert focused.chief_scale == pytest.approx(chief_scale(focused.lens, focused.sensor_distance), rel=1e-3)
    assert focused.coc_scale == pytest.approx(camera().coc_scale(720))


def test_corners_darken_by_the_cosine_and_by_vignetting():
    """A stop before a large lens is seen in full from everywhere; the rims of a double Gauss cut it."""
    shares = {}
    for lens in ("singlet", "double_gauss"):
        settings = model_settings("physicallens", {"lens": lens, "camera": camera(f_number=5.0)})
        focused = focused_lens(settings)
        tangent = np.linspace(0.0, settings["max_eccentricity_mm"], physicallens.N_HEIGHTS) / focused.chief_scale
        shares[lens] = np.array(settings["illumination"]) * (1.0 + tangent**2) ** 2
    np.testing.assert_allclose(shares["singlet"], 1.0, rtol=2e-3)
    assert shares["double_gauss"][0] == 1.0 and (np.diff(shares["double_gauss"]) < 2e-3).all()
    assert shares["double_gauss"][-1] < 0.9


def spread(focused, coc, side, height=0.0):
    """Return the largest distance in x of unblocked rays from their mean, px, in green."""
    place = np.linspace(-1, 1, 41)[None, :, None] * np.array([focused.pupil_radius, 0.0])
    inverse = np.array([focused.focus_per_m - side * coc / focused.coc_scale])
    bundle = trace_bundle(focused, place, np.array([550.0]), inverse, np.array([height]))
    x = bundle.x[bundle.clearance >= 0]
    return np.ptp(x) / 2


@pytest.mark.parametrize("side", [1, -1])
def test_circle_of_confusion_is_that_of_the_thin_lens(side):
    focused = focused_lens(model_settings("physicallens", {"lens": "double_gauss", "camera": camera(f_number=5.6)}))
    # The textbook's zf / (zf - f) and the aberrations are what remains.
    assert spread(focused, 20.0, side) == pytest.approx(20.0 / (1 - 0.05 / 2.0), rel=0.04)


def test_distortion_and_vignetting_grow_towards_the_corner():
    focused = focused_lens(model_settings("physicallens", {"lens": "double_gauss"}))
    heights = np.array([0.0, 10.0, 20.0])
    chief = trace_bundle(focused, np.zeros((3, 1, 2)), np.full(3, 550.0), np.full(3, focused.focus_per_m), heights)
    moved = np.abs(chief.x[:, 0])
    assert moved[0] == pytest.approx(0, abs=1e-9)
    assert moved[2] > 2 * moved[1] > 0.5
    open_share = [
        (
            trace_bundle(
                focused,
                np.stack([np.zeros(101), np.linspace(-1, 1, 101) * focused.pupil_radius], axis=-1)[None, :, ::-1],
                np.array([550.0]),
                np.array([focused.focus_per_m]),
                np.array([height]),
            ).clearance
            >= 0
        ).mean()
        for height in heights
    ]
    assert open_share[0] > open_share[1] > open_share[2] > 0


def lens_model(lens="double_gauss", width=256, **options):
    settings = model_settings("physicallens", {"lens": lens, "width": width, **options})
    return get_model("physicallens", max_coc=16.0, settings=settings)


def widths(psf):
    """Return the standard deviations of a PSF (H, W, C) along x and y, of its mean colour."""
    flat = psf.mean(axis=2)
    flat = flat / flat.sum()
    y, x = (np.arange(n) - n // 2 for n in flat.shape)
    mean_x, mean_y = flat.sum(axis=0) @ x, flat.sum(axis=1) @ y
    return np.sqrt(flat.sum(axis=0) @ (x - mean_x) ** 2), np.sqrt(flat.sum(axis=1) @ (y - mean_y) ** 2)


@compiled
def test_psf_is_round_on_the_axis_and_a_cats_eye_in_the_corner():
    model = lens_model()
    along, across = widths(trace_psf(model, [[10, 11], [0, 0.5]], rays=1_000_000))
    assert along == pytest.approx(across, rel=0.01)
    along, across = widths(trace_psf(model, [[10, 11], [17, 18]], rays=1_000_000))
    assert along < 0.7 * across


@compiled
def test_psf_is_turned_to_the_azimuth():
    model = lens_model()
    flat = trace_psf(model, [[10, 11], [17, 18]], rays=1_000_000)
    upright = trace_psf(model, [[10, 11], [17, 18]], rays=1_000_000, angle=math.pi / 2)
    assert widths(upright) == pytest.approx(widths(flat)[::-1], rel=0.01)
    np.testing.assert_allclose(flat, flat[::-1], atol=1e-3 * flat.max())


@compiled
def test_colours_fringe_the_singlet_oppositely_on_both_sides_of_focus():
    model = lens_model("singlet")
    rims = []
    for side in (1, -1):
        psf = trace_psf(model, [[10, 10.5], [0, 0.5]], side=side, rays=1_000_000)
        y, x = np.mgrid[-(psf.shape[0] // 2) : psf.shape[0] // 2 + 1, -(psf.shape[1] // 2) : psf.shape[1] // 2 + 1]
        rim = np.hypot(x, y) > 11.0
        rims.append(psf[rim].sum(axis=0))
    # Blue focuses nearer to the lens, so behind focus it spreads farther.
    assert rims[0][2] > 2 * rims[0][0] and rims[1][0] > 2 * rims[1][2]


@compiled
def test_psfs_are_white_of_unit_energy_and_without_noise():
    model = lens_model()
    first, second = (trace_psf(model, [[12, 13], [8, 9]], angle=0.4, seed=seed) for seed in (1, 2))
    np.testing.assert_allclose(first.sum(axis=(0, 1)), 1.0, atol=5e-3)
    assert first.min() >= 0
    shape = np.maximum(first.shape, second.shape)
    on = [np.pad(p, [((n - m) // 2,) * 2 for n, m in zip(shape, p.shape, strict=True)]) for p in (first, second)]
    assert np.abs(on[0] - on[1]).sum() / 3 < 0.02


@compiled
def test_stored_poses_give_every_azimuth_on_both_sides():
    grid = PsfGrid.of(lens_model())
    cell = int(grid.find([12.0, 16.0]))
    box = [[12.0, 12.0], [16.0, 16.0]]
    for angle in (0.2, 1.4, 2.9, -1.0, -2.5):
        for in_front in (False, True):
            number, transpose, flip_row, flip_col = grid.nearest_pose(cell, angle, in_front)
            stored = grid.angles(cell)[number]
            psf = trace_psf(grid.model, box, angle=stored, side=grid.side(cell, int(number)), rays=200_000)
            psf = psf.swapaxes(0, 1) if transpose else psf
            psf = psf[:: -1 if flip_row else 1, :: -1 if flip_col else 1]
            wanted = trace_psf(grid.model, box, angle=angle, side=-1 if in_front else 1, rays=200_000)
            shape = np.maximum(psf.shape, wanted.shape)
            on = [np.pad(p, [((n - m) // 2,) * 2 for n, m in zip(shape, p.shape, strict=True)]) for p in (psf, wanted)]
            assert np.abs(on[0] - on[1]).sum() / 3 < 0.1, (angle, in_front)


@pytest.mark.parametrize(
    "old, new, message",
    [
        ("radius thickness", "radius", "line 2: the columns are radius glass .*needed are radius thickness"),
        ("50 4 1.5/60 8 0", "50 4 1.5/60 8", "line 4: 4 columns; needed are 5"),
        ("\n50 4 1.5/60", "\nround 4 1.5/60", "line 4: radius is 'round'; it must be a number"),
        ("50 4 1.5/60", "0 4 1.5/60", "line 4: radius is 0"),
        ("50 4 1.5/60", "50 inf 1.5/60", "line 4: thickness"),
        ("1.5/60 8", "1.5/60 -8", "line 4: .*semi_diameter finite and > 0"),
        ("1.5/60", "1.5", "line 4: glass is '1.5'; allowed are air"),
        ("1.5/60", "0.5/60", "line 4: .*index must be 1 to 5"),
        ("1.5/60", "1,1,1,0.3,0.01,100", "line 4: .*visible range"),
        ("stop 0 air 5 -\n", "", "0 aperture stops"),
        ("stop 0 air 5 -\n", "stop 0 air 5 -\nstop 0 air 5 -\n", "2 aperture stops"),
        ("1.5/60", "air", "some glass"),
        ("-50 40 air", "-50 40 1.5/60", "glass up to the sensor"),
    ],
)
def test_malformed_prescription_is_refused_with_its_line(old, new, message):
    assert old in SINGLET
    with pytest.raises(InvalidFileError, match=f"ball.txt.*{message}"):
        parse_prescription(SINGLET.replace(old, new), "ball.txt")


def test_unknown_lens_lists_those_that_ship(tmp_path):
    with pytest.raises(InvalidFileError, match="'fisheye'.*double_gauss, doublet, singlet"):
        read_prescription("fisheye")
    (tmp_path / "binary").write_bytes(b"\xff\xfe")
    with pytest.raises(InvalidFileError, match="no lens prescription"):
        read_prescription(str(tmp_path / "binary"))


@pytest.mark.parametrize(
    "text, message",
    [
        (SINGLET.replace("\n50 4", "\n-50 4").replace("\n-50 40", "\n50 40"), "does not focus"),
        # A tube before the stop, through which no corner is seen.
        (
            SINGLET.replace("stop", "inf 30 air 0.5 0\nstop").replace("stop 0 air 5", "stop 9 air 0.5"),
            "surface 1.*its rim",
        ),
        # A rim like a pinhole: it leaves the ray along the axis alone.
        (SINGLET.replace("50 4 1.5/60 8", "50 4 1.5/60 0.01"), "on its axis: 33 of 33 rays end at surface 2 .its rim"),
        # Light for the corner enters a dome straight, and meets its flat side too obliquely to leave it.
        (REFLECTING, "surface 3 .it reflects them totally"),
        # Light for the corner passes beside a bead behind the stop.
        (MISSING, "surface 2 .they miss it"),
    ],
)
def test_lens_that_passes_no_light_is_refused(tmp_path, text, message):
    path = tmp_path / "lens.txt"
    path.write_text(text)
    with pytest.raises(InvalidParameterError, match=message):
        model_settings("physicallens", {"lens": str(path)})


def test_focus_within_the_focal_length_is_refused():
    with pytest.raises(InvalidParameterError, match="cannot focus at 30 mm"):
        image_distance(parse_prescription(SINGLET, "ball"), 30.0)


def events_of(text, height, n_rays=9):
    """Trace a few rays from infinity through a lens: what its surfaces did to them."""
    lens = parse_prescription(text, "lens")
    place = np.stack([np.linspace(-1, 1, n_rays) * height, np.zeros(n_rays)], axis=-1)[None]
    return physicallens._trace(lens, 0.0, 40.0, place, 0 * place, lens.indices(np.array([550.0])))


@pytest.mark.parametrize(
    "old, new, surface, event",
    [
        ("\n50 4 1.5/60 8", "\n3 4 1.5/60 8", 1, physicallens.MISSED),
        ("\n-50 40 air 8", "\n-5 40 air 8", 2, physicallens.REFLECTED),
        ("stop 0 air 5", "stop 0 air 1", 0, physicallens.BLOCKED),
    ],
)
def test_rays_that_fail_are_counted_with_their_surface(old, new, surface, event):
    assert old in SINGLET
    out, events = events_of(SINGLET.replace(old, new), 4.4)
    assert events[surface, event] > 0 and events.sum() == 9
    assert (out[0, [0, -1], 2] < 0).all() and out[0, 4, 2] > 0
    assert np.isfinite(out).all()


@compiled
def test_the_blur_of_the_pre_filter_adds_its_variance(monkeypatch):
    def variance(psf):
        weight = psf.sum(axis=2) / psf.sum()
        rows, cols = (axis - (weight * axis).sum() for axis in np.indices(weight.shape))
        return (weight * rows**2).sum(), (weight * cols**2).sum()

    model, box = lens_model(), [[10.0, 18.0], [8.0, 8.0]]
    blurred = variance(trace_psf(model, box, rays=1_000_000))
    monkeypatch.setattr(physicallens, "BLUR", 0.0)
    plain = variance(trace_psf(model, box, rays=1_000_000))
    sigma = 0.3 * 4.0
    assert np.subtract(blurred, plain) == pytest.approx([sigma**2] * 2, rel=0.02)


@compiled
def test_darkness_names_the_surface_and_what_it_does():
    settings = model_settings("physicallens", {"lens": "double_gauss"})
    model = get_model("physicallens", settings=settings)
    with pytest.raises(InvalidParameterError, match="no light through at an image height of 60.*rays end at surface"):
        trace_psf(model, [[1, 2], [60, 61]])


@pytest.mark.parametrize(
    "options, message",
    [
        ({"camera": camera(f_number=1.0)}, "f-number is 1; the lens .* opens to 2.03"),
        ({"width": 0}, "at least 1 px"),
    ],
)
def test_impossible_camera_is_refused(options, message):
    with pytest.raises(InvalidParameterError, match=message):
        model_settings("physicallens", options)


def test_a_prescription_too_large_or_no_file_at_all_is_refused(tmp_path):
    (tmp_path / "a.txt").write_bytes(b"\n" * (1 << 17))
    with pytest.raises(InvalidFileError, match="larger than 65536 bytes"):
        read_prescription(str(tmp_path / "a.txt"))
    with pytest.raises(InvalidFileError, match="no lens prescription"):
        read_prescription(str(tmp_path))

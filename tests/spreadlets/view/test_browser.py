"""The page in a real browser: what a user does, and what is to be seen then."""

import base64
import json
import re
import zipfile

import numpy as np
import pytest
from view_scene import DEPTHS, SHAPE

import spreadlets as sp

READY = "document.getElementById('status').textContent.startsWith('ready')"


@pytest.fixture(scope="module")
def tab(chromium):
    """Where all tests load the page: a process of its own for each would take longer than most of them."""
    opened = chromium.new_page()
    opened.set_default_timeout(60_000)
    yield opened
    opened.close()


@pytest.fixture
def page(tab, command):
    wrong = []
    listeners = {
        "pageerror": lambda error: wrong.append(error),
        "request": lambda request: wrong.append(request.url),
    }
    for event, listener in listeners.items():
        tab.on(event, listener)
    tab.set_viewport_size({"width": 960, "height": 600})
    tab.emulate_media(color_scheme="null")
    tab.goto(command)
    tab.wait_for_function(READY)
    yield tab
    tab.unroute_all()
    for event, listener in listeners.items():
        tab.remove_listener(event, listener)
    allowed = re.compile("data:|blob:|[a-z]+://127.0.0.1:")
    assert [each for each in wrong if not allowed.match(str(each))] == []


def click(page, x, y, **options):
    """Click on a pixel of the frame, and wait for the whole picture."""
    box = page.locator("#picture").bounding_box()
    scale = min(box["width"] / SHAPE[1], box["height"] / SHAPE[0])
    left = box["width"] / 2 - scale * SHAPE[1] / 2
    top = box["height"] / 2 - scale * SHAPE[0] / 2
    act(page, lambda: page.click("#picture", position={"x": left + scale * x, "y": top + scale * y}, **options))


def act(page, action):
    """Do something, and wait for the whole picture of the request that it is."""
    before = page.evaluate("asked")
    action()
    page.wait_for_function(
        f"asked > {before} && {READY} && document.getElementById('status').textContent.includes(asked)"
    )


def shown(page):
    """The picture's pixels, (H, W, 4)."""
    values = page.evaluate(
        """() => {
          const { width, height } = images.result;
          const pixels = images.result.getContext("2d").getImageData(0, 0, width, height).data;
          return btoa(Array.from(pixels, (each) => String.fromCharCode(each)).join(""));
        }"""
    )
    return np.frombuffer(base64.b64decode(values), np.uint8).reshape(*SHAPE, 4)


def set_range(page, name, value, *events):
    page.evaluate(
        "([name, value, events]) => { const input = document.getElementById(name); input.value = value;"
        " for (const each of events) input.dispatchEvent(new Event(each)); }",
        [name, value, events],
    )


def detail(picture, x, y):
    """How sharp noise is around a place."""
    return picture[y - 8 : y + 8, x - 8 : x + 8, :3].astype(float).std()


def test_a_click_focuses_on_each_object_and_the_picture_follows(page):
    objects = list(DEPTHS.items())[:3]
    for (x, y), depth in objects:
        click(page, x, y)
        assert float(page.input_value("#focus")) == pytest.approx(depth, rel=1e-4)
        picture = shown(page)
        others = [detail(picture, *place) for place, other in objects if other != depth and other != 4.0]
        # The third object moves: it stays blurred along its path.
        assert detail(picture, x, y) > 1.5 * max(others) or depth == 4.0
        assert f"--focus {depth:g}" in page.input_value("#command-line")


def test_shift_and_click_keeps_two_objects_in_focus(page):
    (first, near), (second, far) = list(DEPTHS.items())[:2]
    click(page, *first)
    alone = shown(page)
    click(page, *second, modifiers=["Shift"])
    both = shown(page)
    assert (float(page.input_value("#near")), float(page.input_value("#far"))) == (near, far)
    assert detail(both, *second) > 1.5 * detail(alone, *second)
    assert detail(both, *first) == pytest.approx(detail(alone, *first), rel=0.1)


def test_sixty_events_of_a_drag_end_with_the_picture_of_the_last(page):
    act(page, lambda: set_range(page, "f-number", 4, "input", "change"))
    expected = shown(page)
    act(page, lambda: set_range(page, "f-number", 1, "input", "change"))
    assert not np.array_equal(shown(page), expected)
    before = page.evaluate("asked")
    act(
        page,
        lambda: page.evaluate(
            """async () => {
              const input = document.getElementById("f-number");
              for (let k = 0; k < 60; k++) {
                input.value = 1 + (3 * (k + 1)) / 60;
                input.dispatchEvent(new Event("input"));
                await new Promise((done) => setTimeout(done, 4));
              }
              input.dispatchEvent(new Event("change"));
            }"""
        ),
    )
    assert page.evaluate("asked") == before + 61
    np.testing.assert_array_equal(shown(page), expected)


def test_a_drag_with_the_mouse_changes_the_f_number(page):
    box = page.locator("#f-number").bounding_box()
    page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + box["height"] / 2)

    def drag():
        page.mouse.down()
        for step in range(1, 8):
            page.mouse.move(box["x"] + (0.3 + 0.05 * step) * box["width"], box["y"] + box["height"] / 2)
        page.mouse.up()

    act(page, drag)
    assert float(page.input_value("#f-number")) > 3.0
    assert page.locator("label:has(#f-number) input[type=number]").input_value()


def test_the_wipe_shows_the_reference_on_its_side(page):
    def halves():
        return page.evaluate(
            """async () => {
              await new Promise((done) => setTimeout(done, 100));
              const canvas = document.getElementById("picture"), context = canvas.getContext("2d");
              const { left, top, scale } = placement();
              const at = (x) => [...context.getImageData(left + scale * x, top, 1, scale * hello.height).data];
              return [at(10), at(hello.width - 10)];
            }"""
        )

    before = halves()
    act(page, lambda: set_range(page, "wipe", 50, "input", "change"))
    page.select_option("#against", "pinhole")
    after = halves()
    assert after[0] != before[0] and after[1] == before[1]
    page.select_option("#against", "reference")
    page.wait_for_function("document.getElementById('metrics').textContent.includes('SSIM')")
    page.select_option("#against", "difference")
    assert np.array(halves()[0]).reshape(-1, 4)[:, :3].mean() < np.array(before[0]).reshape(-1, 4)[:, :3].mean()


def test_shortcuts_change_what_they_say(page):
    shortcuts = {"f_number": "[]", "focus": ",.", "exposure": "-+"}
    for name, (down, up) in shortcuts.items():
        values = [page.evaluate(f"settings.{name}")]
        for key in (down, up, up):
            act(page, lambda key=key: page.keyboard.press(key))
            values.append(page.evaluate(f"settings.{name}"))
        assert values[1] < values[0] and values[1] < values[2] < values[3]
    act(page, lambda: page.keyboard.press("o"))
    assert page.evaluate("settings.overlay") == "coc"


def test_overlay_exposure_and_layers_change_the_picture(page):
    pictures = [shown(page)]
    act(page, lambda: page.select_option("#overlay", "depth"))
    pictures.append(shown(page))
    act(page, lambda: page.select_option("#overlay", "none"))
    act(page, lambda: set_range(page, "exposure", 1, "input", "change"))
    pictures.append(shown(page))
    act(page, lambda: set_range(page, "exposure", 0, "input", "change"))
    act(page, lambda: set_range(page, "layers", 1, "change"))
    assert ", 1 layer," in page.text_content("#status")
    assert "--layers 1" in page.input_value("#command-line")
    for number, one in enumerate(pictures):
        for other in pictures[number + 1 :]:
            assert not np.array_equal(one, other)


def test_the_picture_is_saved_as_openexr(page, tmp_path):
    with page.expect_download() as download:
        page.click("#save")
    download.value.save_as(tmp_path / "saved.exr")
    assert sp.read_image(tmp_path / "saved.exr").shape == (*SHAPE, 4)


def test_focus_keys_are_saved_as_cameras(page, tmp_path):
    page.fill("#frame-number", "1")
    page.click("#add-key")
    click(page, 104, 30)
    page.fill("#frame-number", "5")
    page.click("#add-key")
    assert page.locator("#keys li").count() == 2
    with page.expect_download() as download:
        page.click("#save-keys")
    download.value.save_as(tmp_path / "cameras.zip")
    with zipfile.ZipFile(tmp_path / "cameras.zip") as archive:
        assert len(archive.namelist()) == 5
        assert json.loads(archive.read("camera.0005.json"))["focus_distance_m"] == pytest.approx(4.0)


def test_the_pointer_reads_a_pixel_and_the_wheel_zooms(page):
    box = page.locator("#picture").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.wait_for_function("document.getElementById('probe').textContent.includes('depth')")
    page.mouse.wheel(0, -400)
    page.wait_for_function("view.zoom > 0")
    page.keyboard.press("0")
    assert page.evaluate("view.zoom") == 0


def test_the_page_fits_and_can_be_read_in_any_size_and_scheme(page):
    for width, height, least in ((1280, 720, 13), (3840, 2160, 20)):
        page.set_viewport_size({"width": width, "height": height})
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            size, fits = page.evaluate(
                "[parseFloat(getComputedStyle(document.body).fontSize), document.body.scrollWidth <= innerWidth]"
            )
            assert fits and size >= least
            ground, text = page.evaluate(
                "[getComputedStyle(document.body).backgroundColor, getComputedStyle(document.body).color]"
                ".map((each) => Number(each.match(/\\d+/)[0]))"
            )
            assert abs(ground - text) > 150 and (ground > text) == (scheme == "light")


def test_the_picture_fits_and_stays_when_what_is_below_it_takes_more_lines(page):
    before = page.evaluate("canvas.clientHeight")
    page.evaluate("say('long '.repeat(200))")
    page.wait_for_function(f"canvas.clientHeight < {before} && canvas.height === canvas.clientHeight")
    page.evaluate("say('longer '.repeat(400)); pixelAt({ clientX: 9, clientY: 9 })")
    middle = "[...canvas.getContext('2d').getImageData(canvas.width / 2, canvas.height / 2, 1, 1).data]"
    assert sum(page.evaluate(middle)[:3]) > 0
    act(page, lambda: page.click("#reset"))


def test_pixels_that_are_no_squares_are_shown_as_they_are(page):
    page.evaluate("hello.aspect = 2")
    scale, across = page.evaluate("[placement().scale, placement().across]")
    width, height = page.evaluate("[canvas.width, canvas.height]")
    assert across == 2 * scale == pytest.approx(min(2 * height / SHAPE[0], width / SHAPE[1]))
    box = page.locator("#picture").bounding_box()
    middle = {
        "clientX": box["x"] + box["width"] / 2 + 10 * across,
        "clientY": box["y"] + box["height"] / 2 - 10 * scale,
    }
    found = page.evaluate("(event) => pixelAt(event)", middle)
    assert abs(found["x"] - SHAPE[1] / 2 - 10) <= 1 and abs(found["y"] - SHAPE[0] / 2 + 10) <= 1
    # What lies under the pointer stays there while it zooms.
    page.evaluate("view.zoom = 3; view.x = 5; view.y = 2")
    page.mouse.move(middle["clientX"], middle["clientY"])
    before = page.evaluate("(event) => pixelAt(event)", middle)
    page.mouse.wheel(0, -200)
    page.wait_for_function("view.zoom > 3")
    after = page.evaluate("(event) => pixelAt(event)", middle)
    assert abs(before["x"] - after["x"]) <= 1 and abs(before["y"] - after["y"]) <= 1


def test_focus_on_the_sky_leaves_the_slider_of_use(page):
    before = float(page.get_attribute("#focus", "max"))
    page.evaluate("handlers.focus({ focus: 1e9, keep: false })")
    assert page.evaluate("settings.focus") == 1e9 and float(page.get_attribute("#focus", "max")) == before
    act(page, lambda: page.click("#reset"))


def test_a_narrow_page_has_the_settings_below_the_picture(page):
    page.set_viewport_size({"width": 420, "height": 800})
    panel, picture = (page.locator(each).bounding_box() for each in ("aside", "main"))
    assert panel["y"] >= picture["y"] + picture["height"] and picture["width"] == panel["width"] == 420


def test_errors_name_settings_as_the_page_does(page):
    page.locator("label:has(#far)").locator("input").fill("5")
    page.locator("#far").press("Enter")
    page.wait_for_function("document.getElementById('status').textContent.startsWith('Sharp from and to is')")
    assert page.get_attribute("#status", "class") == "wrong"
    act(page, lambda: page.click("#reset"))


def test_what_is_left_out_stands_apart_from_the_number_of_layers(page):
    assert re.search(r"\), \d+ layers?(, left out: |$)", page.inner_text("#status"))


@pytest.mark.parametrize(
    "action",
    [
        lambda page: page.click("#save"),
        lambda page: page.click("#picture"),
        lambda page: set_range(page, "f-number", 3, "input", "change"),
    ],
)
def test_it_is_told_that_the_program_has_ended_whatever_is_done_then(page, action):
    page.evaluate("socket.close()")
    page.wait_for_function("document.getElementById('status').textContent.includes('has ended')")
    page.route("**/save.exr*", lambda route: route.abort())
    page.evaluate("say('')")
    action(page)
    page.wait_for_function("document.getElementById('status').textContent.includes('has ended')")


def test_a_wrong_token_shows_no_page(chromium, command):
    opened = chromium.new_page()
    assert opened.goto(command[:-3] + "xyz").status == 403
    opened.close()

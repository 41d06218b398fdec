"""The server: who may ask, what is answered, and that nothing of a page stays when it is closed."""

import json
import threading
import time
import urllib.error
import urllib.request
import zipfile
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from view_page import DEADLINE_S, ask, full, live, receive
from view_scene import CAMERA, DEPTHS, SHAPE
from websockets.exceptions import ConnectionClosed, InvalidStatus

import spreadlets as sp
from spreadlets.errors import InvalidParameterError
from spreadlets.view.server import Server
from spreadlets.view.session import Scene, Studio


def fetch(server, path="/", token=None, data=None, headers=None):
    address = f"http://127.0.0.1:{server.port}{path}?token={server.token if token is None else token}"
    request = urllib.request.Request(address, data, headers or {})
    with urllib.request.urlopen(request, timeout=DEADLINE_S) as answer:
        return answer.read(), answer.headers


def wait_until(condition):
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def test_the_page_and_its_parts_come_with_the_token_only(server):
    page, headers = fetch(server)
    assert b'id="picture"' in page and "default-src 'self'" in headers["Content-Security-Policy"]
    assert server.token.encode() in page
    for path in ("/", "/page.js", "/page.css", "/save.exr"):
        with pytest.raises(urllib.error.HTTPError, match="403"):
            fetch(server, path, token="wrong")


def test_the_page_names_no_other_host(server):
    for path in ("/", "/page.js", "/page.css"):
        text = fetch(server, path)[0].decode()
        assert (
            "http://" not in text and "https://" not in text and "//" not in text.replace("// ", "").replace("://", "")
        )


@pytest.mark.parametrize("headers", [{"Host": "evil.example"}, {"Origin": "http://evil.example"}, {"Origin": "null"}])
def test_other_hosts_and_origins_are_refused(server, headers):
    with pytest.raises(urllib.error.HTTPError, match="403"):
        fetch(server, headers=headers)


@pytest.mark.parametrize("wrong", [{"token": "wrong"}, {"token": ""}, {"origin": "http://evil.example"}])
def test_a_wrong_token_and_a_foreign_origin_get_no_connection(server, wrong):
    with pytest.raises((InvalidStatus, ConnectionClosed)), live(server, **wrong) as page:
        page.recv(timeout=DEADLINE_S)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[1, 2]",
        "null",
        "{}",
        '{"type": "render"}',
        '{"type": "render", "number": "1", "settings": {}}',
        '{"type": "render", "number": 1, "settings": {"f_number": 1e999}}',
        '{"type": "render", "number": 1, "settings": {"focus": 0.01}}',
        '{"type": "render", "number": 1, "settings": {"kernel": "../../etc/passwd"}}',
        '{"type": "focus", "x": 128, "y": 0}',
        '{"type": "focus", "x": NaN, "y": 0}',
        '{"type": "__init__"}',
        "[" * 5000,
        b"\x00\xff",
    ],
)
def test_damaged_messages_are_refused_and_the_page_goes_on(server, text):
    with live(server) as page:
        page.send(text)
        assert receive(page, "error")[0]["text"]
        ask(page, 5)
        full(page, 5)


def test_a_message_that_is_too_large_ends_the_connection(server):
    with live(server) as page:
        page.send("x" * (1 << 17))
        with pytest.raises(ConnectionClosed):
            while True:
                page.recv(timeout=DEADLINE_S)


def test_the_greeting_tells_of_the_frame_and_brings_its_pictures(server, frame):
    with live(server) as page:
        hello, _ = receive(page, "hello")
        assert (hello["width"], hello["height"], hello["names"]) == (128, 96, ["frame.exr"])
        assert hello["settings"]["focus"] == 2.0 and (hello["nearest"], hello["farthest"]) == (1.5, 9.0)
        _, pinhole = receive(page, "pinhole")
        shown = np.frombuffer(pinhole, np.uint8).reshape(96, 128, 4)
        expected = 255 * sp.Frame(frame.radiance[..., :3], frame.depth).radiance[..., :3]
        assert shown.shape == expected.shape[:2] + (4,) and np.ptp(shown[..., 0]) > 200
        receive(page, "reference")


def test_the_whole_picture_is_that_of_synthesize(server, frame):
    from spreadlets.view.picture import shown

    with live(server) as page:
        ask(page, 1, focus=4.0)
        message, data = full(page, 1)
    image = sp.synthesize(frame, sp.ThinLens(80, 36, 1.0, 4.0, CAMERA.shutter), "combined")
    assert data == shown(image, 0.0).tobytes()
    assert message["plan"]["left_out"] and message["time_s"]["total"] > 0
    assert message["command"].startswith("spreadlets synth frame.exr") and "--focus 4" in message["command"]


def test_of_many_events_the_last_is_shown(server, frame):
    with live(server) as page:
        for number in range(60):
            ask(page, number, dragging=True, f_number=1.0 + number / 20)
        ask(page, 60, f_number=3.0)
        message, data = full(page, 60)
        assert "--f-number 3 " in message["command"]
        ask(page, 61, f_number=3.0)
        assert full(page, 61)[1] == data


def test_a_drag_that_rests_becomes_the_whole_picture(server):
    with live(server) as page:
        ask(page, 1, dragging=True, f_number=2.0)
        assert not receive(page, "picture")[0]["full"]
        full(page, 1)


def test_exposure_shows_the_same_picture_brighter_without_rendering(server):
    with live(server) as page:
        ask(page, 1)
        first, dark = full(page, 1)
        ask(page, 2, exposure=1.0)
        second, bright = full(page, 2)
    assert second["time_s"] == first["time_s"]
    assert np.frombuffer(bright, np.uint8).mean() > np.frombuffer(dark, np.uint8).mean() + 10


@pytest.mark.parametrize("overlay", ["coc", "depth"])
def test_overlays_colour_what_they_show(server, overlay):
    with live(server) as page:
        ask(page, 1, overlay=overlay)
        picture = np.frombuffer(full(page, 1)[1], np.uint8).reshape(96, 128, 4).astype(int)
    near, sharp, far = picture[25:35, 15:30], picture[25:35, 60:70], picture[80:, :]
    if overlay == "coc":
        assert sharp[..., 1].mean() > sharp[..., 2].mean() + 50  # green
        assert near[..., 2].mean() > near[..., 0].mean() + 50  # blue
        assert far[..., 0].mean() > far[..., 2].mean() + 50  # red
    else:
        assert near[..., 0].mean() > far[..., 0].mean() + 100


def test_a_click_gives_the_depth_of_what_lies_there(server):
    with live(server) as page:
        for (x, y), depth in DEPTHS.items():
            page.send(json.dumps({"type": "focus", "x": x, "y": y}))
            assert receive(page, "focus")[0]["focus"] == depth


def test_a_probe_tells_what_is_known_of_a_pixel(server, frame):
    with live(server) as page:
        ask(page, 1)
        full(page, 1)
        page.send(json.dumps({"type": "probe", "x": 104, "y": 30, "settings": {"focus": 4.0}}))
        message, _ = receive(page, "probe")
    assert (message["depth"], message["coc"]) == (4.0, pytest.approx(0.0, abs=1e-5))
    assert message["motion"] == [6.0, 0.0] and len(message["colour"]) == 3


def test_errors_of_rendering_are_told_and_the_page_goes_on(server):
    with live(server) as page:
        ask(page, 1, blades=2)
        assert "Blades is 2" in receive(page, "error", lambda message: message.get("number") == 1)[0]["text"]
        ask(page, 2)
        full(page, 2)


def test_the_picture_is_compared_with_the_reference_if_that_is_asked_for(server):
    with live(server) as page:
        ask(page, 1, judging=True)
        message, _ = receive(page, "metrics")
        assert message["number"] == 1 and 0 < message["ssim"] < 1


def test_the_saved_file_is_the_last_whole_picture(server, tmp_path, frame):
    with pytest.raises(urllib.error.HTTPError, match="409"):
        fetch(server, "/save.exr")
    with live(server) as page:
        ask(page, 1, focus=9.0)
        full(page, 1)
    (tmp_path / "saved.exr").write_bytes(fetch(server, "/save.exr")[0])
    expected = sp.synthesize(frame, sp.ThinLens(80, 36, 1.0, 9.0), "combined")
    np.testing.assert_array_equal(sp.read_image(tmp_path / "saved.exr"), expected)


def test_keys_come_back_as_cameras(server):
    body = json.dumps({"keys": [[1, 2.0], [3, 4.0]], "settings": {"f_number": 4.0}}).encode()
    with zipfile.ZipFile(BytesIO(fetch(server, "/cameras.zip", data=body)[0])) as archive:
        assert archive.namelist() == ["camera.0001.json", "camera.0002.json", "camera.0003.json"]
        assert json.loads(archive.read("camera.0003.json"))["f_number"] == 4.0
    for bad in (b"{", b'{"keys": [], "settings": {}}', b'{"keys": [[1, 2]]}'):
        with pytest.raises(urllib.error.HTTPError, match="400"):
            fetch(server, "/cameras.zip", data=bad)


def test_an_image_may_be_the_psf_once_it_was_sent(server):
    from PIL import Image

    file = BytesIO()
    Image.fromarray(np.full((5, 5), 255, np.uint8)).save(file, "PNG")
    kernel = json.loads(fetch(server, "/kernel", data=file.getvalue())[0])["kernel"]
    settings = server._settings({"settings": {"kernel": kernel}})
    assert settings.model(moving=True) == sp.models.Stylized(image=server.studio.kernels[kernel])
    for bad in (b"no picture", b"", file.getvalue()[:40]):
        with pytest.raises(urllib.error.HTTPError, match="400") as refused:
            fetch(server, "/kernel", data=bad)
        assert refused.value.read().startswith(b"the image: ")


def test_closing_the_page_leaves_no_thread_even_amid_a_rendering(server):
    def threads():
        """All but the pool of kernels, which serves all and is begun by the first rendering."""
        return {each for each in threading.enumerate() if not each.name.startswith("spreadlets_")}

    before = threads()
    for number in range(3):
        with live(server) as page:
            ask(page, number, f_number=1.0 + number)
            wait_until(lambda: any(each.name == "spreadlets-view" for each in threads()))
    wait_until(lambda: threads() <= before)


def test_a_port_that_is_taken_is_an_error(server, studio):
    with pytest.raises(InvalidParameterError, match=f"port {server.port} cannot be used"):
        Server(studio, server.port)


def test_a_probe_tells_the_motion_that_a_camera_alone_makes(server, frame):
    layer = replace(frame.layers[0], motion=np.zeros((*SHAPE, 2), np.float32), has_motion=False)
    poses = np.eye(4), np.eye(4)
    poses[1][0, 3] = 0.1  # m to the right, in half a frame
    keys = [sp.LensKey(time, camera_to_world=pose) for time, pose in zip((0.0, 0.5), poses, strict=True)]
    server.studio = Studio(Scene(sp.Frame.of([layer]), replace(CAMERA, keys=tuple(keys)), "combined"))
    with live(server) as page:
        page.send(json.dumps({"type": "probe", "x": 64, "y": 30, "settings": {}}))
        message, _ = receive(page, "probe")
    assert message["motion"] == pytest.approx([-0.2 * 80 / 36 * SHAPE[1] / 2.0, 0.0], rel=1e-3)

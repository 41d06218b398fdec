"""The widget of notebooks: its side in Python, and its script in a browser."""

import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from view_scene import CAMERA, DEPTHS, make_frame

import spreadlets as sp

pytest.importorskip("anywidget")


@pytest.fixture
def look():
    """A widget, and the messages that it has sent."""
    made, sent = sp.widget(make_frame(), CAMERA), []
    made.send = lambda message, buffers=None: sent.append((message, buffers))
    yield made, sent
    made.close()


def wait_for(sent, found, seconds=60.0):
    end = time.monotonic() + seconds
    while not any(found(message) for message, _ in sent) and time.monotonic() < end:
        time.sleep(0.01)
    return [each for each in sent if found(each[0])][-1]


def whole(message):
    return message.get("full") is True


def test_a_change_gives_a_picture_and_the_camera_that_made_it(look):
    made, sent = look
    made._receive(made, {"settings": {"f_number": 4.0}}, [])
    message, (data,) = wait_for(sent, whole)
    assert (message["height"], message["width"], 4) == made.image.shape and len(data) == made.image.size
    assert made.camera.f_number == 4.0 and made.settings["f_number"] == 4.0
    assert np.array_equal(made.image, sp.synthesize(make_frame(), made.camera))


def test_a_click_focuses_and_what_is_not_allowed_is_told(look):
    made, sent = look
    for (x, y), depth in DEPTHS.items():
        made._receive(made, {"click": [x, y]}, [])
        assert made.camera.focus_distance_m == pytest.approx(depth)
    made._receive(made, {"settings": {"f_number": -1.0}}, [])
    assert "f_number is -1" in wait_for(sent, lambda message: message["type"] == "error")[0]["text"]
    assert made.camera.f_number == CAMERA.f_number


def test_a_click_on_the_sky_focuses_there_and_sliders_reach_what_the_camera_has():
    depth = np.full((24, 32), np.inf)
    depth[:12] = 2.0
    camera = replace(CAMERA, f_number=0.25, focus_distance_m=60.0)
    made = sp.widget(sp.Frame(np.ones((24, 32, 3)), depth), camera)
    sent = []
    made.send = lambda message, buffers=None: sent.append((message, buffers))
    assert made.ranges["f_number"] == (0.25, 32.0) and made.ranges["focus"] == (1.0, 60.0)
    made._receive(made, {"click": [5, 20]}, [])
    wait_for(sent, whole)
    assert made.camera.focus_distance_m == np.inf
    made.close()


def test_closing_leaves_no_thread():
    made = sp.widget(make_frame(), CAMERA)
    made.close()
    end = time.monotonic() + 20.0
    while made._worker.is_alive() and time.monotonic() < end:
        time.sleep(0.01)
    assert made._worker not in threading.enumerate()


SCRIPT = Path(sp.__file__).parent / "view" / "page" / "widget.js"
MODEL = """
async (script) => {
  const { default: widget } = await import(URL.createObjectURL(new Blob([script], { type: "text/javascript" })));
  const state = { shape: [2, 2], settings: { f_number: 2, focal_length: 50, focus: 3, shutter: 180, exposure: 0,
    blades: 0 }, ranges: { f_number: [0.5, 32], focal_length: [10, 300], focus: [1, 20], shutter: [0, 360],
    exposure: [-6, 6], blades: [0, 9] } };
  const heard = {}, sent = [];
  const model = { get: (name) => state[name], send: (message) => sent.push(message),
    on: (name, call) => { heard[name] = call; } };
  widget.render({ model, el: document.body });
  const drag = (value) => {
    const input = document.querySelectorAll("input")[0];
    input.value = value;
    input.dispatchEvent(new Event("input"));
  };
  for (const value of [1, 2, 3]) drag(value);
  const before = sent.length;
  const bytes = new Uint8Array([255, 0, 0, 255, 0, 0, 0, 255, 0, 0, 0, 255, 0, 255, 0, 255]);
  heard["msg:custom"]({ type: "picture", width: 2, height: 2, full: true, time_s: { total: 0.5 } },
    [new DataView(bytes.buffer)]);
  const canvas = document.querySelector("canvas");
  const drawn = [...canvas.getContext("2d").getImageData(0, 0, 2, 2).data];
  return { before, sent, drawn, expected: [...bytes], status: document.querySelector("output").textContent };
}
"""


def test_the_script_draws_what_comes_and_asks_for_the_newest_only(chromium):
    page = chromium.new_page()
    told = page.evaluate(MODEL, SCRIPT.read_text())
    page.close()
    assert told["drawn"] == told["expected"] and told["status"] == "ready: 0.50 s"
    assert told["before"] == 1 and len(told["sent"]) == 2
    assert told["sent"][1]["dragging"] and told["sent"][1]["settings"]["f_number"] == pytest.approx(8.0, rel=0.05)

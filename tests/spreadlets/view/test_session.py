"""What is rendered before a page asks, and what a drag leaves out."""

import numpy as np
import pytest
from view_page import ask, full, live, receive
from view_scene import CAMERA

from spreadlets.view import session
from spreadlets.view.session import Ahead, Settings, Superseded

BEGINS_WITH = Settings.of_camera(CAMERA)
OTHER = BEGINS_WITH.changed({"f_number": 3.0})


class Endless:
    """A studio whose pictures are never done."""

    def whole(self, settings, superseded):
        while not superseded():
            pass
        raise Superseded


def test_what_pages_begin_with_is_rendered_once_before_there_is_one(server, studio, monkeypatch):
    asked, whole = [], studio.whole
    monkeypatch.setattr(studio, "whole", lambda settings, *given: asked.append(settings) or whole(settings, *given))
    studio.begin()
    for _ in range(2):
        with live(server) as page:
            ask(page, 1)
            _, data = full(page, 1)
    assert asked == [BEGINS_WITH]
    assert np.frombuffer(data, np.uint8).std() > 10


def test_other_settings_stop_what_was_begun_with():
    ahead = Ahead(Endless(), BEGINS_WITH)
    ahead.start()
    assert ahead.take(OTHER, lambda: False) is None
    ahead.join(10)
    assert not ahead.is_alive()
    assert ahead.take(BEGINS_WITH, lambda: False) is None


def test_who_waits_for_what_was_begun_with_is_overtaken():
    ahead = Ahead(Endless(), BEGINS_WITH)
    ahead.start()
    with pytest.raises(Superseded):
        ahead.take(BEGINS_WITH, lambda: True)
    assert ahead.is_alive()
    ahead.drop()
    ahead.join(10)


def test_a_drag_stops_what_was_begun_with(server, studio):
    studio._ahead = Ahead(Endless(), BEGINS_WITH)
    studio.begin()
    with live(server) as page:
        ask(page, 1, dragging=True)
        full(page, 1)


def test_a_draft_says_what_it_leaves_out(server, monkeypatch):
    monkeypatch.setattr(session, "TOO_SLOW_S", np.inf)
    with live(server) as page:
        ask(page, 1, dragging=True, f_number=3.0, layers=1)
        in_one_layer = receive(page, "picture")[0]["plan"]["left_out"]
        assert {"what lies hidden", "several surfaces in a pixel but for lights", "depth layers"} <= {*in_one_layer}
        ask(page, 2, dragging=True, f_number=2.0)
        left_out = receive(page, "picture", lambda message: message["number"] == 2)[0]["plan"]["left_out"]
        assert [*left_out, "depth layers"] == in_one_layer

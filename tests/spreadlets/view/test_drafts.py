"""What is seen while something is dragged, beside the whole picture."""

import numpy as np
import pytest
from view_scene import CAMERA

import spreadlets as sp
from spreadlets.runtime.plan import divide
from spreadlets.scene.display import display_encode
from spreadlets.view.drafts import DRAFT, DRAFT_LAYERS, DraftRenderer, ladder

LIMITS = {1: (0.006, 0.07, 0.005), DRAFT_LAYERS: (0.0035, 0.015, 0.002)}
"""By how much drafts of so many layers differ on the display: in the mean, at 99 % of its values; and in brightness."""


def display(image):
    return np.clip(display_encode(image[..., :3]), 0.0, 1.0)


@pytest.mark.parametrize("n_layers", [1, DRAFT_LAYERS])
def test_a_draft_is_like_the_whole_picture(frame, n_layers):
    whole = sp.Renderer(frame, "combined").render(CAMERA)
    with DraftRenderer(frame, "combined") as drafts:
        draft = drafts.render(CAMERA, layers=n_layers, **DRAFT)
    assert np.array_equal(draft[..., 3], np.ones_like(draft[..., 3])), "there are holes"
    apart = np.abs(display(draft) - display(whole))
    assert apart.mean() < LIMITS[n_layers][0] and np.percentile(apart, 99) < LIMITS[n_layers][1]
    assert draft[..., :3].mean() == pytest.approx(whole[..., :3].mean(), rel=LIMITS[n_layers][2])


def test_a_draft_looks_for_nothing_hidden(frame, monkeypatch):
    asked, find_behind = [], divide.find_behind
    monkeypatch.setattr(divide, "find_behind", lambda *given: asked.append(given) or find_behind(*given))
    with DraftRenderer(frame, "combined") as drafts, sp.Renderer(frame, "combined") as renderer:
        drafts.render(CAMERA, layers=2, **DRAFT)
        assert not asked
        renderer.render(CAMERA, layers=2)
        assert len(asked) == 1


def test_drafts_become_smaller_before_they_lose_a_layer():
    assert ladder(1024) == [(1.0, 2), (0.75, 2), (0.625, 2), (0.5, 2), (0.5, 1)]
    assert ladder(300) == [(1.0, 2), (1.0, 1)]

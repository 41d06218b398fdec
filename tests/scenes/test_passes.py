"""How scenes are rendered, as far as that can be told without Blender."""

import ast
from pathlib import Path

PASSES = Path(__file__).resolve().parents[2] / "scenes" / "passes.py"


def test_points_are_not_sampled_through_a_box_which_cycles_always_makes_a_pixel_wide():
    found = {
        target.id: node.value
        for node in ast.parse(PASSES.read_text()).body
        if isinstance(node, ast.Assign)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    kind, width = ast.literal_eval(found["POINT_FILTER"])
    assert kind in ("GAUSSIAN", "BLACKMAN_HARRIS") and width <= 0.01

"""Writes the PyPlug, a group for Natron: the same knobs as the gizmo, and the nodes that write and read frames.

    python integrations/nuke/make_pyplug.py

What its buttons do is in ``SpreadletsExt.py``, which Natron's convention keeps apart from what is written.
"""

from pathlib import Path

from knobs import Knob, tabs

PYPLUG = Path(__file__).with_name("Spreadlets.py")
HEAD = '''\
# Natron PyPlug
# Written by integrations/nuke/make_pyplug.py from the options of spreadlets synth.
"""Depth of field and motion blur by spreadlets, as a group for Natron."""

import NatronEngine
from SpreadletsExt import *


def getPluginID():
    return "spreadlets.Spreadlets"


def getLabel():
    return "Spreadlets"


def getVersion():
    return 1


def getGrouping():
    return "Filter"


def getPluginDescription():
    return "Depth of field and motion blur by spreadlets. Input: colour, depth and motion vectors."


def text(group, page, name, label, tip="", value=""):
    """Add a knob for text."""
    knob = group.createStringParam(name, label)
    knob.setType(NatronEngine.StringParam.TypeEnum.eStringTypeDefault)
    knob.setDefaultValue(value)
    add(page, knob, tip)


def choice(group, page, name, label, tip, choices):
    """Add a knob for a choice."""
    knob = group.createChoiceParam(name, label)
    knob.setOptions([(each, "") for each in choices])
    knob.setDefaultValue(0)
    add(page, knob, tip)


def check(group, page, name, label, tip):
    """Add a check box."""
    add(page, group.createBooleanParam(name, label), tip)


def add(page, knob, tip):
    """Put a knob on a page; its values do not change from frame to frame."""
    knob.setHelp(tip)
    knob.setAnimationEnabled(False)
    knob.setEvaluateOnChange(False)
    page.addParam(knob)


def createInstance(app, group):
    """Make the group's knobs and nodes."""
    page = group.createPageParam("spreadlets", "Spreadlets")
    text(group, page, "program", "Command or Python", value="spreadlets")
    text(group, page, "folder", "Folder for frames", "Default: spreadlets, beside the project.")
    for name, label in (("blur_frame", "Blur frame"), ("blur_range", "Blur range")):
        page.addParam(group.createButtonParam(name, label))
    text(group, page, "more", "More options")
'''
TAIL = """\
    group.refreshUserParamsGUI()
    createInstanceExt(app, group)
"""


def lines(knob: Knob) -> str:
    """Return the statement that makes a knob."""
    given = f'group, page, "{knob.name}", "{knob.label}", {quoted(knob.help)}'
    if knob.is_flag:
        return f"    check({given})"
    return f"    choice({given}, {knob.choices!r})".replace("'", '"') if knob.choices else f"    text({given})"


def quoted(text: str) -> str:
    """Return a text as Python reads it, in double quotes."""
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def pyplug() -> str:
    """Return the text of the PyPlug."""
    body = []
    for name, heading, knobs in tabs():
        body.append(f'    page = group.createPageParam("{name}", "{heading}")')
        body += map(lines, knobs)
    return HEAD + "\n".join(body) + "\n" + TAIL


if __name__ == "__main__":
    PYPLUG.write_text(pyplug(), encoding="utf-8")

"""The PyPlug, without Natron: a stub has the calls of its documented interface by their names, and no others."""

import importlib
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from spreadlets.cli.render import synth

FOLDER = Path(__file__).resolve().parents[2] / "integrations" / "nuke"


class Knob:
    def __init__(self, name, kind, value):
        self.name, self.kind, self.value, self.options, self.history = name, kind, value, [], []
        if kind == "choice":
            self.getOption = lambda index: self.options[index][0]

    def getScriptName(self):
        return self.name

    def get(self):
        return self.value

    def set(self, value):
        self.value = value
        self.history.append(value)

    def setDefaultValue(self, value):
        self.value = value

    def setOptions(self, options):
        self.options = options

    def setHelp(self, text):
        self.help = text

    def setAnimationEnabled(self, on):
        assert on is False

    def setEvaluateOnChange(self, on):
        assert on is False

    def setType(self, kind):
        assert (self.kind, kind) == ("string", "plain")


class Page:
    def __init__(self):
        self.knobs = []

    def addParam(self, knob):
        self.knobs.append(knob)


class Node:
    """A node or a group: knobs, pages, and nodes within it."""

    def __init__(self, plugin="", knobs=()):
        self.plugin, self.name, self.inputs, self.nodes, self.pages = plugin, "", {}, {}, {}
        self.params = {name: Knob(name, "given", None) for name in knobs}
        self.onParamChanged, self.refreshed = Knob("onParamChanged", "given", ""), 0

    def _knob(self, name, kind, value):
        assert name.isidentifier() and name not in self.params
        return self.params.setdefault(name, Knob(name, kind, value))

    def createStringParam(self, name, label):
        return self._knob(name, "string", "")

    def createChoiceParam(self, name, label):
        return self._knob(name, "choice", 0)

    def createBooleanParam(self, name, label):
        return self._knob(name, "boolean", False)

    def createButtonParam(self, name, label):
        return self._knob(name, "button", None)

    def createPageParam(self, name, label):
        return self.pages.setdefault(name, Page())

    def refreshUserParamsGUI(self):
        self.refreshed += 1

    def getParam(self, name):
        return self.params.get(name)

    def getParams(self):
        return list(self.params.values())

    def getNode(self, name):
        return next(node for node in self.nodes if node.name == name)

    def setScriptName(self, name):
        self.name = name

    setLabel = setScriptName

    def connectInput(self, place, node):
        self.inputs[place] = node.name
        return True


class App:
    """A project of 24 frames that stands at the fifth; a render waits until the test says that it is done."""

    KNOBS = {"fr.inria.built-in.Write": ("filename", "processAllPlanes", "bitDepth", "afterRender")}
    KNOBS |= {"fr.inria.built-in.Read": ("filename",), "net.sf.openfx.switchPlugin": ("which",)}

    def __init__(self, folder):
        self.folder, self.renders = folder, []

    def createNode(self, plugin, version, group):
        node = Node(plugin, self.KNOBS.get(plugin, ()))
        group.nodes[node] = plugin
        return node

    def getProjectParam(self, name):
        assert name == "projectPath"
        return Knob(name, "string", self.folder)

    def timelineGetTime(self):
        return 5

    def timelineGetLeftBound(self):
        return 1

    def timelineGetRightBound(self):
        return 24

    def render(self, node, first, last):
        self.renders.append((node, first, last))


@pytest.fixture
def pyplug(monkeypatch):
    """Give the PyPlug as Natron imports it."""
    kinds = SimpleNamespace(TypeEnum=SimpleNamespace(eStringTypeDefault="plain"))
    monkeypatch.setitem(sys.modules, "NatronEngine", SimpleNamespace(StringParam=kinds))
    monkeypatch.syspath_prepend(FOLDER)
    monkeypatch.delenv("SPREADLETS_SERVER", raising=False)
    names = ("Spreadlets", "SpreadletsExt", "spreadlets_host", "make_pyplug", "knobs")
    yield importlib.import_module("Spreadlets")
    for name in names:
        sys.modules.pop(name, None)


@pytest.fixture
def made(pyplug, tmp_path):
    """Give the project and a group in it."""
    app, group = App(str(tmp_path)), Node()
    pyplug.createInstance(app, group)
    return app, group


@pytest.fixture
def called(monkeypatch):
    """Give the command lines that are run, which all succeed."""
    commands = []
    monkeypatch.setattr(
        subprocess, "run", lambda command, **_: commands.append(command) or SimpleNamespace(returncode=0, stderr="")
    )
    return commands


def press(pyplug, app, group, name):
    pyplug.changed(group.getParam(name), group, None, app, True)


def test_the_pyplug_is_written_from_the_table_of_options(pyplug):
    made = importlib.import_module("make_pyplug")
    text = made.PYPLUG.read_text(encoding="utf-8")
    assert text == made.pyplug(), "run integrations/nuke/make_pyplug.py"
    assert text.startswith("# Natron PyPlug\n")
    assert (pyplug.getPluginID(), pyplug.getLabel()) == ("spreadlets.Spreadlets", "Spreadlets")


def test_its_knobs_are_those_of_the_gizmo(made):
    _, group = made
    gizmo = (FOLDER / "Spreadlets.gizmo").read_text(encoding="utf-8")
    asked = [line.split()[2] for line in gizmo.splitlines() if line.startswith(" addUserKnob") and " o_" in line]
    knobs = [knob for page in group.pages.values() for knob in page.knobs]
    assert [knob.name for knob in knobs if knob.name.startswith("o_")] == asked and len(asked) > 50
    assert set(knobs) == set(group.getParams()) and group.refreshed == 1
    methods = next(parameter for parameter in synth.params if parameter.name == "method").type.choices
    assert group.getParam("o_method").options == [(name, "") for name in ("default", *methods)]
    assert group.getParam("o_no_motion").kind == "boolean" and "Focal length" in group.getParam("o_f_number").help


def test_its_nodes_write_and_read_and_show_the_input_at_first(made):
    _, group = made
    nodes = {node.name: (node.plugin, node.inputs) for node in group.nodes}
    assert nodes == {
        "Input1": ("fr.inria.built-in.Input", {}),
        "Pinhole": ("fr.inria.built-in.Write", {0: "Input1"}),
        "Blurred": ("fr.inria.built-in.Read", {}),
        "Shown": ("net.sf.openfx.switchPlugin", {0: "Input1", 1: "Blurred"}),
        "Output1": ("fr.inria.built-in.Output", {0: "Shown"}),
    }
    assert group.onParamChanged.get() == "Spreadlets.changed"
    assert group.getNode("Pinhole").getParam("afterRender").get() == "Spreadlets.rendered"


def test_a_button_writes_the_frames_and_the_command_follows(pyplug, made, called, tmp_path):
    app, group = made
    group.getParam("o_f_number").set(" 2.8")
    group.getParam("o_integrator").set(group.getParam("o_integrator").options.index(("exact", "")))
    group.getParam("o_no_motion").set(True)
    group.getParam("more").set("--max-coc '40'")
    press(pyplug, app, group, "o_f_number")
    assert app.renders == []
    press(pyplug, app, group, "blur_range")
    pinhole = group.getNode("Pinhole")
    sharp, blurred = (f"{tmp_path}/spreadlets/{name}.####.exr" for name in ("pinhole", "blurred"))
    assert app.renders == [(pinhole, 1, 24)] and called == [] and (tmp_path / "spreadlets").is_dir()
    given = {name: pinhole.getParam(name).get() for name in ("filename", "processAllPlanes", "bitDepth")}
    assert given == {"filename": sharp, "processAllPlanes": True, "bitDepth": "32f"}
    # Natron has written the last frame.
    pyplug.rendered(False, pinhole, app)
    options = ["--f-number", "2.8", "--integrator", "exact", "--no-motion", "--max-coc", "40"]
    frames = ["--frames", "1-24", "--overwrite", "--json"]
    assert called == [["spreadlets", "synth", sharp, "-o", blurred, *options, *frames]]
    parsed = synth.make_context("synth", called[0][2:]).params
    assert parsed["f_number"] == 2.8 and parsed["motion"] is False and parsed["only_frames"] == "1-24"
    assert group.getNode("Blurred").getParam("filename").history == ["", blurred]
    assert group.getNode("Shown").getParam("which").get() == 1


def test_the_current_frame_is_one_and_an_aborted_render_is_none(pyplug, made, called, tmp_path):
    app, group = made
    group.getParam("folder").set(str(tmp_path / "own"))
    press(pyplug, app, group, "blur_frame")
    pinhole = group.getNode("Pinhole")
    assert app.renders == [(pinhole, 5, 5)]
    pyplug.rendered(True, pinhole, app)
    pyplug.rendered(False, pinhole, app)
    assert called == [] and group.getNode("Shown").getParam("which").get() is None


def test_a_project_that_has_no_folder_and_a_command_that_fails_are_told(pyplug, made, monkeypatch, tmp_path):
    app, group = made
    failed = SimpleNamespace(returncode=2, stderr="warning: a\nerror: no camera\n")
    monkeypatch.setattr(subprocess, "run", lambda command, **_: failed)
    press(pyplug, app, group, "blur_frame")
    with pytest.raises(RuntimeError, match="^error: no camera$"):
        pyplug.rendered(False, group.getNode("Pinhole"), app)
    assert group.getNode("Shown").getParam("which").get() is None
    app.folder = ""
    with pytest.raises(RuntimeError, match="save the project"):
        press(pyplug, app, group, "blur_frame")

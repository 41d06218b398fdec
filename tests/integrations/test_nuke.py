"""The gizmo, without Nuke: its knobs are the command's options, and its buttons call the command as it is."""

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import click
import pytest

from spreadlets.cli.render import synth

FOLDER = Path(__file__).resolve().parents[2] / "integrations" / "nuke"


@pytest.fixture(autouse=True)
def folder_of_the_gizmo(monkeypatch):
    monkeypatch.syspath_prepend(FOLDER)
    yield
    sys.modules.pop("knobs", None)


def load(name):
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Knob:
    def __init__(self, value=""):
        self._value, self.executed = value, 0

    def value(self):
        return self._value

    evaluate = value

    def setValue(self, value):  # noqa: N802 (the name is Nuke's)
        self._value = value

    def execute(self):
        self.executed += 1


class Node(dict):
    """A node: its knobs by name, and those within it."""

    def __init__(self, knobs, nodes=()):
        super().__init__({name: Knob(value) for name, value in knobs.items()})
        self.nodes = dict(nodes)

    def knobs(self):
        return self

    def node(self, name):
        return self.nodes[name]


@pytest.fixture
def gizmo_node(tmp_path):
    read = Node(dict.fromkeys(("file", "first", "last", "origfirst", "origlast", "reload"), 0))
    nodes = {"Pinhole": Node({"file": ""}), "Blurred": read, "Shown": Node({"which": 0})}
    knobs = {"folder": str(tmp_path / "frames"), "program": "spreadlets", "more": "--max-coc '40'"}
    return Node(knobs | {"o_f_number": " 2.8", "o_focus": "", "o_method": "default", "o_no_motion": True}, nodes)


def test_the_gizmo_is_written_from_the_table_of_options():
    made = load("make_gizmo")
    assert made.GIZMO.read_text(encoding="utf-8") == made.gizmo(), "run integrations/nuke/make_gizmo.py"
    known = {option for parameter in synth.params for option in parameter.opts}
    knobs = [line.split()[2] for line in made.gizmo().splitlines() if line.startswith(" addUserKnob") and " o_" in line]
    assert len(knobs) > 50 and {"--" + name[2:].replace("_", "-") for name in knobs} <= known
    assert made.gizmo().count("{") - made.gizmo().count("\\{") == made.gizmo().count("}") - made.gizmo().count("\\}")


def test_the_buttons_write_call_and_read(gizmo_node, tmp_path, monkeypatch):
    executed, called = [], []
    monkeypatch.setitem(sys.modules, "nuke", SimpleNamespace(execute=lambda *arguments: executed.append(arguments)))
    monkeypatch.setattr(
        subprocess, "run", lambda command, **_: called.append(command) or SimpleNamespace(returncode=0, stderr="")
    )
    monkeypatch.delenv("SPREADLETS_SERVER", raising=False)
    load("spreadlets_host").blur(gizmo_node, 3, 7)
    sharp, blurred = (f"{tmp_path}/frames/{name}.%04d.exr" for name in ("pinhole", "blurred"))
    assert executed == [(gizmo_node.node("Pinhole"), 3, 7)]
    options = ["--f-number", "2.8", "--no-motion", "--max-coc", "40"]
    assert called == [
        ["spreadlets", "synth", sharp, "-o", blurred, *options, "--frames", "3-7", "--overwrite", "--json"]
    ]
    parsed = synth.make_context("synth", called[0][2:]).params
    assert parsed["f_number"] == 2.8 and parsed["motion"] is False and parsed["only_frames"] == "3-7"
    read = gizmo_node.node("Blurred")
    assert (read["file"].value(), read["first"].value(), read["last"].value()) == (blurred, 3, 7)
    assert read["reload"].executed == 1 and gizmo_node.node("Shown")["which"].value() == 1


def test_an_error_is_the_commands_last_line_and_a_server_is_used_if_there_is_one(gizmo_node, monkeypatch):
    host = load("spreadlets_host")
    monkeypatch.setitem(sys.modules, "nuke", SimpleNamespace(execute=lambda *arguments: None))
    failed = SimpleNamespace(returncode=2, stderr="warning: a\nerror: no camera\n")
    monkeypatch.setattr(subprocess, "run", lambda command, **_: failed)
    with pytest.raises(RuntimeError, match="^error: no camera$"):
        host.blur(gizmo_node, 1, 1)
    assert gizmo_node.node("Shown")["which"].value() == 0
    monkeypatch.setenv("SPREADLETS_SERVER", "http://127.0.0.1:1")
    assert host.command_line("/opt/python3", ["a"]) == [
        "/opt/python3",
        "-m",
        "spreadlets.cli.main",
        "send",
        "synth",
        "a",
    ]


def test_an_unknown_option_would_be_noticed():
    with pytest.raises(click.UsageError):
        synth.make_context("synth", ["a.exr", "-o", "b.exr", "--no-such-option"])

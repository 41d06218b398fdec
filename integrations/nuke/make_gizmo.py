"""Writes the gizmo: a group that writes the frame, calls the command, and reads the result.

    python integrations/nuke/make_gizmo.py

Its knobs are the options of ``spreadlets synth``, under the headings and with the help of the command line.
"""

from pathlib import Path

import click

from spreadlets.cli.render import synth

GIZMO = Path(__file__).with_name("Spreadlets.gizmo")
GROUPS = ("Camera", "Look", "Bokeh", "Method", "Effects", "Quality and speed", "Reading the frame")
"""Headings of options that become tabs; those that begin so."""
TEXT, CHOICE, CHECK, BUTTON, TAB = 1, 4, 6, 22, 20
"""Kinds of knobs, by Nuke's numbers."""
BLUR = "import nuke, spreadlets_host; spreadlets_host.blur(nuke.thisNode(), {})"
FRAME, RANGE = (
    "nuke.frame(), nuke.frame()",
    "int(nuke.root()['first_frame'].value()), int(nuke.root()['last_frame'].value())",
)
NODES = """\
 Input {
  inputs 0
  name Input1
 }
 Write {
  channels all
  file_type exr
  datatype "32 bit float"
  name Pinhole
 }
push 0
 Read {
  inputs 0
  file_type exr
  on_error checkerboard
  name Blurred
 }
push $cut_paste_input
"""


def knob(parameter: click.Parameter) -> list[str]:
    """Return the lines of an option's knob."""
    assert isinstance(parameter, click.Option)
    option = parameter.opts[-1].removeprefix("--")
    name, label = "o_" + option.replace("-", "_"), option.replace("-", " ")
    tip = quoted(parameter.help or "")
    if parameter.is_flag:
        return [f" addUserKnob {{{CHECK} {name} l {quoted(label)} t {tip} +STARTLINE}}"]
    if isinstance(parameter.type, click.Choice):
        choices = " ".join(["default", *parameter.type.choices])
        return [f" addUserKnob {{{CHOICE} {name} l {quoted(label)} t {tip} M {{{choices}}}}}"]
    return [f" addUserKnob {{{TEXT} {name} l {quoted(label)} t {tip}}}"]


def quoted(text: str) -> str:
    """Return a text as Tcl reads it."""
    escaped = "".join("\\" + letter if letter in '\\"[]{}$' else letter for letter in text)
    return f'"{escaped}"'


def gizmo() -> str:
    """Return the text of the gizmo."""
    lines = [
        "#! nuke",
        "# Written by integrations/nuke/make_gizmo.py from the options of spreadlets synth.",
        "Gizmo {",
        ' help "Depth of field and motion blur by spreadlets. Input: colour, depth.Z and motion vectors."',
        f" addUserKnob {{{TAB} spreadlets l Spreadlets}}",
        f" addUserKnob {{{TEXT} program l {quoted('Command or Python')}}}",
        " program spreadlets",
        f" addUserKnob {{2 folder l {quoted('Folder for frames')}}}",
        ' folder "\\[file dirname \\[value root.name]]/spreadlets"',
        f" addUserKnob {{{BUTTON} blur_frame l {quoted('Blur frame')} T {quoted(BLUR.format(FRAME))} +STARTLINE}}",
        f" addUserKnob {{{BUTTON} blur_range l {quoted('Blur range')} T {quoted(BLUR.format(RANGE))}}}",
        f" addUserKnob {{{TEXT} more l {quoted('More options')}}}",
    ]
    for group in synth.option_groups:
        heading = next((name for name in GROUPS if group.title.startswith(name)), None)
        if heading:
            lines.append(f" addUserKnob {{{TAB} {heading.split()[0].lower()} l {quoted(heading)}}}")
            lines += [line for parameter in group.options for line in knob(parameter)]
    lines += [" o_preset nuke", "}", NODES.rstrip()]
    lines += [
        " Switch {",
        "  inputs 2",
        "  which 0",
        "  name Shown",
        " }",
        " Output {",
        "  name Output1",
        " }",
        "end_group",
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    GIZMO.write_text(gizmo(), encoding="utf-8")

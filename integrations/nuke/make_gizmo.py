"""Writes the gizmo: a group that writes the frame, calls the command, and reads the result.

    python integrations/nuke/make_gizmo.py

Its knobs are the options of ``spreadlets synth``, under the headings and with the help of the command line.
"""

from pathlib import Path

from knobs import Knob, tabs

GIZMO = Path(__file__).with_name("Spreadlets.gizmo")
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


def line(knob: Knob) -> str:
    """Return the line of a knob."""
    label, tip = quoted(knob.label), quoted(knob.help)
    if knob.is_flag:
        return f" addUserKnob {{{CHECK} {knob.name} l {label} t {tip} +STARTLINE}}"
    if knob.choices:
        return f" addUserKnob {{{CHOICE} {knob.name} l {label} t {tip} M {{{' '.join(knob.choices)}}}}}"
    return f" addUserKnob {{{TEXT} {knob.name} l {label} t {tip}}}"


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
    for name, heading, knobs in tabs():
        lines.append(f" addUserKnob {{{TAB} {name} l {quoted(heading)}}}")
        lines += map(line, knobs)
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

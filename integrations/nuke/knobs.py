"""The options of ``spreadlets synth`` as knobs of a node, under the headings and with the help of the command line."""

from typing import NamedTuple

import click

from spreadlets.cli.render import synth

GROUPS = ("Camera", "Look", "Bokeh", "Method", "Effects", "Quality and speed", "Reading the frame")
"""Headings of options that become tabs; those that begin so."""


class Knob(NamedTuple):
    """One option: its name as a knob, its label and help, and what may be chosen; a check box is a flag."""

    name: str
    label: str
    help: str
    is_flag: bool
    choices: list[str]


def tabs() -> list[tuple[str, str, list[Knob]]]:
    """Return name, heading and knobs of each tab, in the order of the command's help."""
    found = []
    for group in synth.option_groups:
        heading = next((name for name in GROUPS if group.title.startswith(name)), None)
        if heading:
            found.append((heading.split()[0].lower(), heading, [knob(parameter) for parameter in group.options]))
    return found


def knob(parameter: click.Parameter) -> Knob:
    """Return an option's knob; a choice begins with what leaves it to the command."""
    assert isinstance(parameter, click.Option)
    option = parameter.opts[-1].removeprefix("--")
    choices = ["default", *parameter.type.choices] if isinstance(parameter.type, click.Choice) else []
    name, label = "o_" + option.replace("-", "_"), option.replace("-", " ")
    return Knob(name, label, parameter.help or "", parameter.is_flag, choices)

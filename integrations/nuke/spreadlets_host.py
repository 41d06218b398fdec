"""What the buttons of the nodes do: write the frames, let the command blur them, and show the results.

Lies beside the gizmo in a folder of NUKE_PATH, and beside the PyPlug in one of Natron's. With SPREADLETS_SERVER and
SPREADLETS_TOKEN in the environment, a warm process (``spreadlets serve``) does the work.
"""

import os
import shlex
import subprocess

OPTION = "o_"
"""How the names of knobs begin that are options of the command; the rest is the option's name."""
PROGRAM, EXTRA = "program", "more"
"""Knobs that are no options: the command or a Python, and options as they are typed."""
DEFAULT = "default"
"""What a choice says that is left to the command."""


def command_line(program, values):
    """Return the command for one of the nodes' programs: the command itself or a Python, cold or warm."""
    name = os.path.basename(program).lower()
    begin = [program, "-m", "spreadlets.cli.main"] if name.startswith("python") else [program]
    return [*begin, *(["send"] if "SPREADLETS_SERVER" in os.environ else []), "synth", *values]


def is_asked(name):
    """Tell whether a knob says something about the command, by its name."""
    return name.startswith(OPTION) or name in (PROGRAM, EXTRA)


def options_of(values):
    """Return the options that knobs ask for.

    Parameters
    ----------
    values : mapping of str to str or bool
        Values of knobs. Texts and choices that are not empty become an option with a value, and checked boxes one
        without; the text of `EXTRA` is added as it is typed.
    """
    options = []
    for name in sorted(name for name in values if name.startswith(OPTION)):
        value, option = values[name], "--" + name[len(OPTION) :].replace("_", "-")
        if isinstance(value, bool):
            options += [option] if value else []
        elif value.strip() not in ("", DEFAULT):
            options += [option, value.strip()]
    return options + shlex.split(values.get(EXTRA, ""))


def run(values, sharp, blurred, first, last):
    """Let the command blur the frames of a range; an error has the last line that it says.

    Parameters
    ----------
    values : mapping of str to str or bool
        Of the node's knobs: options, and the program.
    sharp, blurred : str
        Patterns of the files that are read and written.
    first, last : int
        The range.
    """
    frames = ["--frames", f"{first}-{last}", "--overwrite", "--json"]
    command = command_line(values[PROGRAM], [sharp, "-o", blurred, *options_of(values), *frames])
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError((done.stderr.strip() or "spreadlets failed").splitlines()[-1])


def files_in(folder, counter):
    """Return the patterns of sharp and blurred frames in a folder, which is made if need be."""
    os.makedirs(folder, exist_ok=True)
    return [os.path.join(folder, f"{name}.{counter}.exr").replace(os.sep, "/") for name in ("pinhole", "blurred")]


def blur(node, first, last):
    """Blur the frames of a range, and show them: a button of the gizmo in Nuke."""
    import nuke

    # Write the frames.
    sharp, blurred = files_in(node["folder"].evaluate(), "%04d")
    node.node("Pinhole")["file"].setValue(sharp)
    nuke.execute(node.node("Pinhole"), first, last)
    # Blur them.
    values = {name: knob.value() for name, knob in node.knobs().items() if is_asked(name)}
    run(values, sharp, blurred, first, last)
    # Read the results.
    read = node.node("Blurred")
    read["file"].setValue(blurred)
    for name, value in (("first", first), ("last", last), ("origfirst", first), ("origlast", last)):
        read[name].setValue(value)
    read["reload"].execute()
    node.node("Shown")["which"].setValue(1)

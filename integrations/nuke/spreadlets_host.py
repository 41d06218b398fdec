"""What the buttons of the gizmo do: write the frames, let the command blur them, and show the results.

Lies beside the gizmo in a folder of NUKE_PATH. With SPREADLETS_SERVER and SPREADLETS_TOKEN in the environment, a warm
process (``spreadlets serve``) does the work.
"""

import os
import shlex
import subprocess

OPTION = "o_"
"""How the names of knobs begin that are options of the command; the rest is the option's name."""
EXTRA = "more"
DEFAULT = "default"
"""What a choice says that is left to the command."""


def command_line(program, values):
    """Return the command for one of the gizmo's programs: the command itself or a Python, cold or warm."""
    name = os.path.basename(program).lower()
    begin = [program, "-m", "spreadlets.cli.main"] if name.startswith("python") else [program]
    return [*begin, *(["send"] if "SPREADLETS_SERVER" in os.environ else []), "synth", *values]


def options_of(knobs):
    """Return the options that knobs ask for.

    Parameters
    ----------
    knobs : mapping of str to knob
        Texts and choices that are not empty become an option with a value, and checked boxes one without.
    """
    options = []
    for name in sorted(knobs):
        if not name.startswith(OPTION):
            continue
        value, option = knobs[name].value(), "--" + name[len(OPTION) :].replace("_", "-")
        if isinstance(value, bool):
            options += [option] if value else []
        elif str(value).strip() not in ("", DEFAULT):
            options += [option, str(value).strip()]
    return options + shlex.split(knobs[EXTRA].value() if EXTRA in knobs else "")


def blur(node, first, last):
    """Blur the frames of a range, and show them."""
    import nuke

    folder = node["folder"].evaluate()
    os.makedirs(folder, exist_ok=True)
    sharp, blurred = (os.path.join(folder, name + ".%04d.exr") for name in ("pinhole", "blurred"))
    node.node("Pinhole")["file"].setValue(sharp.replace(os.sep, "/"))
    nuke.execute(node.node("Pinhole"), first, last)
    frames = ["--frames", f"{first}-{last}", "--overwrite", "--json"]
    command = command_line(node["program"].value(), [sharp, "-o", blurred, *options_of(node.knobs()), *frames])
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError((done.stderr.strip() or "spreadlets failed").splitlines()[-1])
    read = node.node("Blurred")
    read["file"].setValue(blurred.replace(os.sep, "/"))
    for name, value in (("first", first), ("last", last), ("origfirst", first), ("origlast", last)):
        read[name].setValue(value)
    read["reload"].execute()
    node.node("Shown")["which"].setValue(1)

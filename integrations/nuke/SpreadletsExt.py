"""What the PyPlug's nodes and buttons are: Natron's convention keeps what is written by hand in this file.

A render does not block Natron, so a button only begins it, and the results are made when the last frame is written.
Names of functions and arguments are those that Natron asks for.
"""

import os

import spreadlets_host

NODES = {
    "Input1": "fr.inria.built-in.Input",
    "Pinhole": "fr.inria.built-in.Write",
    "Blurred": "fr.inria.built-in.Read",
    "Shown": "net.sf.openfx.switchPlugin",
    "Output1": "fr.inria.built-in.Output",
}
"""The group's nodes, by Natron's names for their plug-ins."""
LINKS = (("Pinhole", 0, "Input1"), ("Shown", 0, "Input1"), ("Shown", 1, "Blurred"), ("Output1", 0, "Shown"))
MODULE = "Spreadlets"
"""Where Natron looks for callbacks: the PyPlug, which takes them from here."""

_waiting = {}
"""Groups with a range of frames, by the files that are being written for them."""


def createInstanceExt(app, group):
    """Make the group's nodes, and say what its buttons do."""
    nodes = {}
    for name, plugin in NODES.items():
        nodes[name] = app.createNode(plugin, -1, group)
        nodes[name].setScriptName(name)
        nodes[name].setLabel(name)
    for name, place, source in LINKS:
        nodes[name].connectInput(place, nodes[source])
    nodes["Pinhole"].getParam("afterRender").set(f"{MODULE}.rendered")
    group.onParamChanged.set(f"{MODULE}.changed")


def changed(thisParam, thisNode, thisGroup, app, userEdited):
    """Begin to blur if a button is pressed."""
    button = thisParam.getScriptName()
    if button == "blur_frame":
        begin(app, thisNode, app.timelineGetTime(), app.timelineGetTime())
    elif button == "blur_range":
        begin(app, thisNode, app.timelineGetLeftBound(), app.timelineGetRightBound())


def begin(app, group, first, last):
    """Let Natron write the frames of a range, with all their channels."""
    sharp, _ = spreadlets_host.files_in(folder_of(app, group), "####")
    pinhole = group.getNode("Pinhole")
    # The file's name chooses the encoder, which brings the other knobs.
    pinhole.getParam("filename").set(sharp)
    pinhole.getParam("processAllPlanes").set(True)
    pinhole.getParam("bitDepth").set("32f")
    _waiting[sharp] = group, first, last
    app.render(pinhole, first, last)


def rendered(aborted, thisNode, app):
    """Blur what has been written, and show it."""
    group, first, last = _waiting.pop(thisNode.getParam("filename").get(), (None, 0, 0))
    if group is None or aborted:
        return
    sharp, blurred = spreadlets_host.files_in(folder_of(app, group), "####")
    spreadlets_host.run(values_of(group), sharp, blurred, first, last)
    # A name that changes is read anew.
    for name in ("", blurred):
        group.getNode("Blurred").getParam("filename").set(name)
    group.getNode("Shown").getParam("which").set(1)


def folder_of(app, group):
    """Return where the frames of a group are: the folder that is named, or one beside the project."""
    named, project = group.getParam("folder").get(), app.getProjectParam("projectPath").get()
    if not named and not project:
        raise RuntimeError("save the project, or name a folder for frames")
    return named or os.path.join(project, "spreadlets")


def values_of(group):
    """Return the values of a group's knobs, choices by their names."""
    knobs = {knob.getScriptName(): knob for knob in group.getParams() if spreadlets_host.is_asked(knob.getScriptName())}
    return {
        name: knob.getOption(knob.get()) if hasattr(knob, "getOption") else knob.get() for name, knob in knobs.items()
    }

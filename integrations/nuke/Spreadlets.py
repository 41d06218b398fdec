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
    page = group.createPageParam("camera", "Camera")
    text(group, page, "o_camera", "camera", "JSON, OpenEXR with camera attributes, or USD[:/PRIM] (default: the frame's).")
    text(group, page, "o_focal_length", "focal length", "Focal length.")
    text(group, page, "o_sensor_width", "sensor width", "Sensor's width (default: 36).")
    choice(group, page, "o_sensor_fit", "sensor fit", "Side of the frame that the sensor spans; auto is the longer.", ["default", "horizontal", "vertical", "auto"])
    text(group, page, "o_f_number", "f number", "Focal length over aperture.")
    text(group, page, "o_focus", "focus", "Distance in focus, metres.")
    text(group, page, "o_shutter", "shutter", "180deg, or times in frames (default: 180deg).")
    text(group, page, "o_shutter_curve", "shutter curve", "How far the shutter is open over its time: 0,1,1,0.5 or trapezoid:RISE,FALL (default: fully).")
    page = group.createPageParam("look", "Look")
    text(group, page, "o_focus_at", "focus at", "Focus on what lies at this pixel.")
    text(group, page, "o_in_focus", "in focus", "Keep these depths sharp, metres.")
    text(group, page, "o_near_strength", "near strength", "Blur in front of the focus, times that.")
    text(group, page, "o_far_strength", "far strength", "Blur behind the focus, times that.")
    text(group, page, "o_max_coc", "max coc", "Largest radius of the blur.")
    text(group, page, "o_highlights", "highlights", "Multiply blurred light above the threshold.")
    text(group, page, "o_mask", "mask", "Keep sharp, and out of the blur, what is white.")
    text(group, page, "o_region", "region", "Make this part of the picture.")
    text(group, page, "o_proxy", "proxy", "Make a smaller picture, such as 0.5.")
    page = group.createPageParam("bokeh", "Bokeh")
    text(group, page, "o_blades", "blades", "Edges of the aperture (0: round).")
    text(group, page, "o_blade_curvature", "blade curvature", "... from 0 (straight edges) to 1 (round).")
    text(group, page, "o_rotation", "rotation", "... of the blades, degrees.")
    text(group, page, "o_cats_eye", "cats eye", "Distance of a second, clipping circle, radii.")
    text(group, page, "o_cats_eye_angle", "cats eye angle", "... its direction, degrees.")
    check(group, page, "o_cats_eye_radial", "cats eye radial", "... growing from the middle to the corners.")
    text(group, page, "o_squeeze", "squeeze", "Width over height of an anamorphic PSF.")
    text(group, page, "o_spherical_aberration", "spherical aberration", "Above 0: dark rim behind focus, bright in front.")
    text(group, page, "o_obstruction", "obstruction", "Radius of a central obstruction, radii.")
    text(group, page, "o_kernel", "kernel", "An image as the PSF; no motion.")
    page = group.createPageParam("method", "Method")
    choice(group, page, "o_method", "method", "dense and dense-rows draw PSFs in full, gather filters.", ["default", "spreadlets", "dense", "dense-rows", "gather"])
    text(group, page, "o_db", "db", "Database: a file or a shipped name.")
    check(group, page, "o_vignetting", "vignetting", "Darken the corners as the lens of a physicallens database does.")
    page = group.createPageParam("effects", "Effects")
    check(group, page, "o_no_defocus", "no defocus", "Leave depth of field out.")
    check(group, page, "o_no_motion", "no motion", "Leave motion blur out.")
    page = group.createPageParam("quality", "Quality and speed")
    choice(group, page, "o_integrator", "integrator", "Poisson solver (default: multigrid).", ["default", "multigrid", "pyramid", "pyramid-f5", "pyramid-f7", "exact"])
    text(group, page, "o_cycles", "cycles", "Cycles of the integrator multigrid.")
    text(group, page, "o_tolerance", "tolerance", "Display error to trade for speed; 0 draws every pixel by itself.")
    text(group, page, "o_layers", "layers", "Depth layers (default: the frame's own, else as many as it needs, at most 12).")
    text(group, page, "o_softness", "softness", "Transition between depth layers: 0 (hard, a frame's default) to 1 (soft, that of samples).")
    text(group, page, "o_firefly_clamp", "firefly clamp", "Dim pixels brighter than this times any other around them.")
    page = group.createPageParam("reading", "Reading the frame")
    choice(group, page, "o_preset", "preset", "The renderer that wrote it.", ["default", "blender", "arnold", "renderman", "vray", "redshift", "karma", "nuke", "unreal", "octane", "3dsmax"])
    text(group, page, "o_view", "view", "View of a stereo file (default: the hero view).")
    text(group, page, "o_colour_layer", "colour layer", "Colour layer; several are depth layers, nearest first.")
    text(group, page, "o_alpha_channel", "alpha channel", "Name of the alpha channel.")
    text(group, page, "o_depth_channel", "depth channel", "Name of the depth channel.")
    choice(group, page, "o_depth_convention", "depth convention", "planar, ray (distance along the ray), inverse (1/depth) or disparity.", ["default", "planar", "ray", "inverse", "disparity"])
    text(group, page, "o_depth_scale", "depth scale", "Metres per unit of depth; below 0 turns the sign.")
    text(group, page, "o_background_depth", "background depth", "Depth of background: a number, nan, <X or >X.")
    text(group, page, "o_baseline", "baseline", "Distance of the two cameras, metres, for disparity.")
    text(group, page, "o_motion_channels", "motion channels", "Names of the motion channels, separated by commas; none ignores them.")
    text(group, page, "o_motion_convention", "motion convention", "DIRECTION-UNIT[-up] with forward or backward, and px, ndc, uv, norm, norm8 or norm16; blender, nuke, nuke-forward, nuke-backward, curved-px, camera-velocity, camera-velocity-sum or ndc.")
    text(group, page, "o_max_displacement", "max displacement", "Motion in px at the end of a normalised range.")
    check(group, page, "o_unpremultiplied", "unpremultiplied", "The colours are not multiplied by alpha.")
    text(group, page, "o_depth", "depth", "File of the depth, if apart.")
    text(group, page, "o_motion", "motion", "File of the motion, if apart.")
    text(group, page, "o_alpha", "alpha", "File of the alpha, if apart.")
    text(group, page, "o_deep_layers", "deep layers", "Most layers of a deep image (8).")
    check(group, page, "o_repair", "repair", "Mend pixels with invalid values instead of refusing the frame.")
    group.refreshUserParamsGUI()
    createInstanceExt(app, group)

"""What the scenes are built of, for Blender's ``bpy``: materials, meshes, motion, lights.

The camera looks along +y, up is +z; lengths are in metres, velocities per frame. All light is direct.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import bmesh
import bpy
from mathutils import Matrix, Vector

Colour = tuple[float, float, float]

FRAME = 10
"""The frame that is rendered."""
KEYED = 2
"""Motion is keyed so many frames before and behind it."""
TEXTURE_SHIFT = (0.013, 0.017, 0.011)
"""So that no edge of a checkerboard lies in a face."""
TEXTURES = {
    "checker": "ShaderNodeTexChecker",
    "noise": "ShaderNodeTexNoise",
    "cells": "ShaderNodeTexVoronoi",
}

# --- Materials -------------------------------------------------------------------------------------------------------


def material(colour: Colour, *, metallic: float = 0.0, roughness: float = 0.5) -> bpy.types.Material:
    """Return a material of one colour."""
    made = bpy.data.materials.new("material")
    made.use_nodes = True
    surface = made.node_tree.nodes["Principled BSDF"]
    surface.inputs["Base Color"].default_value = (*colour, 1)
    surface.inputs["Metallic"].default_value = metallic
    surface.inputs["Roughness"].default_value = roughness
    return made


def textured(kind: str, colours: tuple[Colour, Colour], scale: float, **surface: float) -> bpy.types.Material:
    """Return a material of two colours in a pattern, one of `TEXTURES`."""
    made = material(colours[0], **surface)
    nodes, link = made.node_tree.nodes, made.node_tree.links.new
    place, shift, pattern = (nodes.new(each) for each in ("ShaderNodeTexCoord", "ShaderNodeMapping", TEXTURES[kind]))
    shift.inputs["Location"].default_value = TEXTURE_SHIFT
    pattern.inputs["Scale"].default_value = scale
    link(place.outputs["Object"], shift.inputs["Vector"])
    link(shift.outputs["Vector"], pattern.inputs["Vector"])
    if kind == "checker":
        for name, colour in zip(("Color1", "Color2"), colours, strict=True):
            pattern.inputs[name].default_value = (*colour, 1)
        found = pattern.outputs["Color"]
    else:
        if kind == "noise":
            pattern.inputs["Detail"].default_value = 4.0
        ramp = nodes.new("ShaderNodeValToRGB")
        for element, position, colour in zip(ramp.color_ramp.elements, (0.35, 0.65), colours, strict=True):
            element.position, element.color = position, (*colour, 1)
        link(pattern.outputs["Distance" if kind == "cells" else 0], ramp.inputs[0])
        found = ramp.outputs[0]
    link(found, made.node_tree.nodes["Principled BSDF"].inputs["Base Color"])
    return made


def glowing(colour: Colour, strength: float) -> bpy.types.Material:
    """Return a material that the camera sees shine; it lights nothing, which would be noise."""
    made = material((0.0, 0.0, 0.0))
    surface = made.node_tree.nodes["Principled BSDF"]
    surface.inputs["Specular IOR Level"].default_value = 0
    surface.inputs["Emission Color"].default_value = (*colour, 1)
    surface.inputs["Emission Strength"].default_value = strength
    made.cycles.emission_sampling = "NONE"
    return made


# --- Meshes ----------------------------------------------------------------------------------------------------------


def _scaled(mesh: bmesh.types.BMesh, size: Sequence[float]) -> bmesh.types.BMesh:
    """Scale a mesh along x, y and z, and return it."""
    bmesh.ops.scale(mesh, vec=size, verts=mesh.verts)
    return mesh


def sphere(radius: float, segments: int = 32) -> bmesh.types.BMesh:
    """Return a ball."""
    mesh = bmesh.new()
    bmesh.ops.create_uvsphere(mesh, u_segments=segments, v_segments=segments // 2, radius=radius)
    return mesh


def coin(radius: float, thickness: float) -> bmesh.types.BMesh:
    """Return a flat ellipsoid; its axis is z."""
    return _scaled(sphere(radius, 48), (1, 1, thickness / radius))


def box(x: float, y: float, z: float) -> bmesh.types.BMesh:
    """Return a box of these sides."""
    mesh = bmesh.new()
    bmesh.ops.create_cube(mesh, size=1.0)
    return _scaled(mesh, (x, y, z))


def head(size: float) -> bmesh.types.BMesh:
    """Return Blender's monkey."""
    mesh = bmesh.new()
    bmesh.ops.create_monkey(mesh)
    return _scaled(mesh, (size, size, size))


def plane(x: float, y: float) -> bmesh.types.BMesh:
    """Return a rectangle of these sides; its normal is z."""
    mesh = bmesh.new()
    bmesh.ops.create_grid(mesh, x_segments=1, y_segments=1, size=0.5)
    return _scaled(mesh, (x, y, 1))


def turned(mesh: bmesh.types.BMesh, angle: float, axis: str) -> bmesh.types.BMesh:
    """Turn a mesh about an axis, ``X``, ``Y`` or ``Z``, and return it."""
    bmesh.ops.rotate(mesh, matrix=Matrix.Rotation(angle, 3, axis), verts=mesh.verts)
    return mesh


def moved(mesh: bmesh.types.BMesh, by: Sequence[float]) -> bmesh.types.BMesh:
    """Move a mesh, and return it."""
    bmesh.ops.translate(mesh, vec=by, verts=mesh.verts)
    return mesh


def add(
    mesh: bmesh.types.BMesh,
    of: bpy.types.Material,
    place: Sequence[float] = (0, 0, 0),
    *,
    angles: Sequence[float] = (0, 0, 0),
    layer: int = 0,
    smooth: bool = False,
) -> bpy.types.Object:
    """Put a mesh into the scene; `layer` is its depth layer, 0 the nearest."""
    data = bpy.data.meshes.new("mesh")
    mesh.to_mesh(data)
    mesh.free()
    for face in data.polygons:
        face.use_smooth = smooth
    data.materials.append(of)
    item = bpy.data.objects.new("object", data)
    bpy.context.scene.collection.objects.link(item)
    item.location, item.rotation_euler, item["layer"] = place, angles, layer
    return item


# --- Motion ----------------------------------------------------------------------------------------------------------


def move(item: bpy.types.Object, velocity: Sequence[float]) -> None:
    """Move an object evenly; it is where it is now at `FRAME`."""
    place = Vector(item.location)
    for frames in (-KEYED, KEYED):
        item.location = place + Vector(velocity) * frames
        item.keyframe_insert("location", frame=FRAME + frames)
    item.location = place


def spin(item: bpy.types.Object, axis: Sequence[float], angle: float, velocity: float) -> None:
    """Turn an object evenly about its origin; it is turned by `angle` at `FRAME`."""
    item.rotation_mode = "AXIS_ANGLE"
    for frames in (-KEYED, KEYED):
        item.rotation_axis_angle = (angle + velocity * frames, *axis)
        item.keyframe_insert("rotation_axis_angle", frame=FRAME + frames)


def make_motion_even() -> None:
    """Interpolate all keys linearly: ``bpy`` makes them smooth, whatever its preference says."""
    for action in bpy.data.actions:
        for bag in (bag for layer in action.layers for strip in layer.strips for bag in strip.channelbags):
            for key in (key for curve in bag.fcurves for key in curve.keyframe_points):
                key.interpolation = "LINEAR"


# --- Lights ----------------------------------------------------------------------------------------------------------


def ambient(colour: Colour, strength: float) -> None:
    """Light the scene evenly from all sides; the camera sees it where nothing else is."""
    background = bpy.context.scene.world.node_tree.nodes["Background"]
    background.inputs[0].default_value, background.inputs[1].default_value = (*colour, 1), strength


def area_light(
    place: Sequence[float], target: Sequence[float], size: float, power: float, colour: Colour = (1, 1, 1)
) -> None:
    """Add a square light that the camera does not see."""
    light = bpy.data.lights.new("light", "AREA")
    light.size, light.energy, light.color = size, power, colour
    item = bpy.data.objects.new("light", light)
    bpy.context.scene.collection.objects.link(item)
    item.location = place
    item.rotation_euler = (Vector(target) - Vector(place)).to_track_quat("-Z", "Y").to_euler()
    item.visible_camera = False


def at(depth: float, x: float, y: float, focal_length_mm: float) -> tuple[float, float, float]:
    """Return the point at a depth seen at a place of the image: -1 is the left border, 1 the right one; y is up."""
    half_width = 18.0 / focal_length_mm * depth
    return x * half_width, depth, y * half_width


QUARTER = math.radians(90)
"""Turns a plane so that it faces the camera."""

"""A clockwork: gears that mesh and turn, in focus and out of it, set with polished studs that throw highlights."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

import bmesh
from blocks import QUARTER, add, ambient, area_light, box, material, moved, plane, sphere, spin, textured, turned
from mathutils import Matrix, Vector
from shot import Shot

SHOT = Shot(focal_length_mm=85, f_number=0.34, focus_distance_m=5.0, n_layers=3, light_samples=16)
MODULE_M = 0.05
"""Pitch diameter of a gear over its number of teeth: gears that mesh have it in common."""
ADDENDUM, DEDENDUM = 1.0, 1.25
"""Height of a tooth outside the pitch circle and depth inside it, in modules: the usual ones."""
TOOTH = ((-0.32, DEDENDUM), (-0.24, 0.0), (-0.12, -ADDENDUM), (0.12, -ADDENDUM), (0.24, 0.0), (0.32, DEDENDUM))
"""Outline of a tooth: angle in shares of the pitch of teeth, depth below the pitch circle in modules."""
N_SPOKES = 5


@dataclass(frozen=True)
class Gear:
    """A gear: number of teeth, place of its middle (metres), turning velocity (radians per frame), tilt of its axis."""

    teeth: int
    place: tuple[float, float, float]
    velocity: float
    tilt: float = 0.0
    layer: int = 1
    phase: float = 0.0

    @property
    def radius(self) -> float:
        """Of the pitch circle, metres."""
        return MODULE_M * self.teeth / 2


def meshing(with_: Gear, teeth: int, direction: float) -> Gear:
    """Return a gear that meshes with another, at an angle from its middle; its teeth fall into the other's gaps."""
    reach = with_.radius + MODULE_M * teeth / 2
    x, y, z = with_.place
    ratio = with_.teeth / teeth
    # Where both touch, a tooth of the one is to meet a gap, half a pitch on, of the other.
    phase = direction + math.pi + (direction - with_.phase) * ratio + math.pi / teeth
    place = x + reach * math.cos(direction), y, z + reach * math.sin(direction)
    return Gear(teeth, place, -with_.velocity * ratio, layer=with_.layer, phase=phase)


def _outline(teeth: int) -> list[tuple[float, float]]:
    """Return angle and radius of the corners of all teeth, in turn; the middle of the first tooth is at angle 0."""
    radius = MODULE_M * teeth / 2
    pitch = 2 * math.pi / teeth
    return [(pitch * (n + share), radius - MODULE_M * depth) for n in range(teeth) for share, depth in TOOTH]


def _wheel(teeth: int, thickness: float) -> bmesh.types.BMesh:
    """Return the toothed rim of a gear, its spokes and its hub; its axis is y."""
    mesh, outline = bmesh.new(), _outline(teeth)
    inner = outline[0][1] - 2.2 * MODULE_M
    rings = [
        [
            mesh.verts.new((radius * math.cos(angle), side * thickness / 2, radius * math.sin(angle)))
            for angle, radius in corners
        ]
        for side, corners in (
            (-1, outline),
            (1, outline),
            (1, [(a, inner) for a, _ in outline]),
            (-1, [(a, inner) for a, _ in outline]),
        )
    ]
    # The sides of the rim: out, back, in, front.
    for one, other in zip(rings, rings[1:] + rings[:1], strict=True):
        for k in range(len(outline)):
            mesh.faces.new((one[k - 1], one[k], other[k], other[k - 1]))
    for spoke in range(N_SPOKES):
        arm = turned(
            moved(box(inner, 0.6 * thickness, 1.2 * MODULE_M), (inner / 2, 0, 0)), 2 * math.pi * spoke / N_SPOKES, "Y"
        )
        _join(mesh, arm)
    bmesh.ops.create_cone(
        mesh,
        cap_ends=True,
        segments=40,
        radius1=2.2 * MODULE_M,
        radius2=1.8 * MODULE_M,
        depth=1.6 * thickness,
        matrix=Matrix.Rotation(QUARTER, 4, "X"),
    )
    bmesh.ops.recalc_face_normals(mesh, faces=mesh.faces)
    return mesh


def _studs(teeth: int, thickness: float) -> bmesh.types.BMesh:
    """Return polished balls along the rim and one on the hub, on the side of the camera."""
    radius = MODULE_M * (teeth / 2 - DEDENDUM - 1.1)
    count = max(teeth // 3, 4)
    mesh = moved(sphere(0.9 * MODULE_M, 24), (0, -0.8 * thickness, 0))
    for k in range(count):
        angle = 2 * math.pi * (k + 0.5) / count
        place = radius * math.cos(angle), -thickness / 2, radius * math.sin(angle)
        _join(mesh, moved(sphere(0.42 * MODULE_M, 20), place))
    return mesh


def _join(mesh: bmesh.types.BMesh, part: bmesh.types.BMesh) -> None:
    """Add all of a part to a mesh."""
    corner = {vertex: mesh.verts.new(vertex.co) for vertex in part.verts}
    for face in part.faces:
        mesh.faces.new([corner[vertex] for vertex in face.verts])
    part.free()


def _gears() -> list[Gear]:
    """Return the train in focus, gears near the camera, and gears far behind."""
    great = Gear(30, (-0.38, 5.0, 0.1), 0.2)
    small = meshing(great, 12, math.radians(-12))
    third = meshing(small, 20, math.radians(35))
    fourth = meshing(great, 16, math.radians(-75))
    train = [great, small, third, fourth, meshing(fourth, 10, math.radians(-10))]
    near = [
        Gear(14, (0.52, 3.3, -0.55), 0.25, tilt=0.35, layer=0),
        Gear(12, (-0.52, 2.9, 0.5), -0.35, tilt=-0.3, layer=0),
    ]
    chance = random.Random(11)
    far = []
    for k in range(9):
        depth = 7.0 + 0.9 * k
        place = ((chance.uniform(-0.85, 0.85)) * 0.21 * depth, depth, chance.uniform(-0.85, 0.85) * 0.21 * depth)
        teeth = chance.randint(18, 40)
        far.append(Gear(teeth, place, chance.choice((-1, 1)) * chance.uniform(0.12, 0.4), chance.uniform(-0.4, 0.4), 2))
    return train + near + far


def build() -> None:
    """Build the scene."""
    ambient((0.35, 0.4, 0.5), 0.3)
    metals = [
        textured("noise", ((0.95, 0.68, 0.3), (0.55, 0.33, 0.12)), 9.0, metallic=1, roughness=0.32),
        textured("noise", ((0.75, 0.76, 0.78), (0.42, 0.43, 0.46)), 9.0, metallic=1, roughness=0.3),
        textured("noise", ((0.8, 0.42, 0.28), (0.4, 0.18, 0.1)), 9.0, metallic=1, roughness=0.34),
    ]
    # Not smoother: highlights of a pixel, far out of focus, would leave any reference noisy.
    polished = material((0.95, 0.9, 0.8), metallic=1, roughness=0.45)
    for number, gear in enumerate(_gears()):
        thickness = 0.12 if gear.layer != 2 else 0.2
        axis = Vector((math.sin(gear.tilt), math.cos(gear.tilt), 0))
        for mesh, of, smooth in (
            (_wheel(gear.teeth, thickness), metals[number % len(metals)], False),
            (_studs(gear.teeth, thickness), polished, True),
        ):
            # Turned to its phase about its axis, then tilted; angles about y run from x to -z.
            item = add(
                turned(turned(mesh, -gear.phase, "Y"), -gear.tilt, "Z"), of, gear.place, layer=gear.layer, smooth=smooth
            )
            spin(item, axis, 0, -gear.velocity)
    wall = textured("cells", ((0.16, 0.1, 0.06), (0.03, 0.035, 0.05)), 1.4, roughness=0.6)
    add(plane(40, 40), wall, (0, 17, 0), angles=(QUARTER, 0, 0), layer=2)
    area_light((-4, 0, 5), (0, 5, 0), 1.6, 1100, (1, 0.93, 0.85))
    area_light((4, -1, 2), (0, 6, 0), 1.4, 700, (0.8, 0.88, 1))
    area_light((2, 5, 7), (0, 11, 0), 1.6, 600, (1, 0.85, 0.7))

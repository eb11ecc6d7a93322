"""The scene of a flight's pictures: painted ground, obstacles and quadrotors, as a model for MuJoCo's renderer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from covey.errors import ArgumentError
from covey.flight.obstacles import Box, Obstacle, Prism, Sphere
from covey.flight.parameters import VehicleParameters
from covey.runtime.drawing.palette import rgb
from covey.simulators.mujoco_model import convex_pieces

TEXTURE = 2048
"""Pixels of the longer side of the painted ground."""

SMALLEST = 0.028
"""A vehicle's radius is drawn at least as this share of the ground's diagonal, so that it can be seen."""

FOV = float(np.radians(40.0))
"""Vertical field of view, rad."""

FLOOR, GRID, GRID_MAJOR = (0.93, 0.94, 0.95), (0.86, 0.875, 0.89), (0.74, 0.76, 0.79)
HORIZON = (0.82, 0.88, 0.94)
CONCRETE, HAZARD = (0.62, 0.64, 0.68, 1.0), (0.85, 0.33, 0.10, 0.9)


@dataclass(frozen=True, eq=False)
class Stage:
    """What stands still in a picture, and what the vehicles look like.

    Parameters
    ----------
    vehicles : sequence of VehicleParameters
        n of them: their size and rotors.
    colours : sequence of str
        ``#rrggbb`` a vehicle.
    low_W, high_W : pair of float
        Corners of the ground to show, frame W, metres.
    obstacles : sequence of Obstacle
    object_radii : sequence of float
        One a moving object, metres.
    landmarks_W : array, shape (m, 2 or more) or None
        Drawn as squares on the ground, frame W, metres.
    cell_m : float
        Side of these squares.
    shadow_pixels, samples : int
        Resolution of the shadows, and samples a pixel: without a graphics card they take most of the time.
    """

    vehicles: Sequence[VehicleParameters]
    colours: Sequence[str]
    low_W: tuple[float, float]
    high_W: tuple[float, float]
    obstacles: Sequence[Obstacle] = ()
    object_radii: Sequence[float] = ()
    landmarks_W: NDArray[np.float64] | None = None
    cell_m: float = 0.5
    shadow_pixels: int = 4096
    samples: int = 4

    def __post_init__(self) -> None:
        if len(self.colours) != len(self.vehicles):
            raise ArgumentError(f"colours: expected one a vehicle, {len(self.vehicles)}, got {len(self.colours)}")
        if not (self.low_W[0] < self.high_W[0] and self.low_W[1] < self.high_W[1]):
            raise ArgumentError(f"low_W, high_W: expected low < high along both axes, got {self.low_W}, {self.high_W}")

    @property
    def size(self) -> tuple[float, float]:
        """Sides of the ground, metres."""
        return self.high_W[0] - self.low_W[0], self.high_W[1] - self.low_W[1]


def magnification(stage: Stage) -> list[float]:
    """How much larger than life each vehicle is drawn."""
    diagonal = float(np.hypot(*stage.size))
    return [max(1.0, SMALLEST * diagonal / vehicle.body_radius) for vehicle in stage.vehicles]


def scene_model(stage: Stage, width: int, height: int) -> Any:
    """Compile the scene for pictures of a size in pixels: nothing in it moves by itself.

    The vehicles, then the moving objects, are its mocap bodies; the geoms of obstacle k are called ``obstacle k.``, and
    the number of the piece; the texture ``ground`` is to be filled by
    `paint_ground`.
    """
    import mujoco

    geom, texture = mujoco.mjtGeom, mujoco.mjtTexture
    spec = mujoco.MjSpec()
    sides = np.array(stage.size)
    middle = (np.array(stage.low_W) + stage.high_W) / 2.0
    span, scale = float(np.hypot(*sides)), magnification(stage)
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = width, height
    visual.global_.fovy = np.degrees(FOV)
    visual.quality.shadowsize, visual.quality.offsamples = stage.shadow_pixels, stage.samples
    visual.headlight.ambient, visual.headlight.diffuse = [0.42] * 3, [0.25] * 3
    visual.headlight.specular = [0.05] * 3
    visual.rgba.haze = [*HORIZON, 1.0]
    visual.map.znear, visual.map.zfar, visual.map.shadowclip = 0.005, 20.0, 1.0
    visual.map.fogstart, visual.map.fogend, visual.map.haze = 3.0, 10.0, 0.35
    spec.stat.extent, spec.stat.center = span, [*middle, 0.0]

    gradient = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    sky: dict[str, Any] = {"rgb1": [0.55, 0.70, 0.88], "rgb2": HORIZON, "width": 256, "height": 1536}
    spec.add_texture(name="sky", type=texture.mjTEXTURE_SKYBOX, builtin=gradient, **sky)
    columns, rows = _pixels(stage)
    flat = mujoco.mjtBuiltin.mjBUILTIN_FLAT
    spec.add_texture(name="ground", type=texture.mjTEXTURE_2D, builtin=flat, rgb1=FLOOR, width=columns, height=rows)
    names = [""] * int(mujoco.mjtTextureRole.mjNTEXROLE)
    names[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = "ground"
    spec.add_material(name="ground", textures=names, texrepeat=[1.0, 1.0], specular=0.0, shininess=0.0)
    spec.add_material(name="hull", specular=0.4, shininess=0.4)
    world = spec.worldbody
    floor = {"type": geom.mjGEOM_PLANE, "contype": 0, "conaffinity": 0}
    world.add_geom(pos=[*middle, 0.0], size=[*(sides / 2.0), 1.0], material="ground", **floor)
    far = [*(0.94 * np.array(FLOOR)), 1.0]
    world.add_geom(pos=[*middle, -0.002 * span], size=[0.0, 0.0, 1.0], rgba=far, **floor)
    sun = {"pos": [middle[0] - 0.3 * span, middle[1] - 0.45 * span, 1.1 * span], "dir": [0.3, 0.45, -1.1]}
    spec.worldbody.add_light(
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, castshadow=True, diffuse=[0.55] * 3, specular=[0.2] * 3, **sun
    )
    for k, obstacle in enumerate(stage.obstacles):
        _add_obstacle(spec, k, obstacle)
    for i, vehicle in enumerate(stage.vehicles):
        _add_quadrotor(spec, i, vehicle, scale[i], stage.colours[i])
    for radius in stage.object_radii:
        body = world.add_body(mocap=True)
        body.add_geom(type=geom.mjGEOM_SPHERE, size=[radius, 0.0, 0.0], rgba=HAZARD, material="hull")
    return spec.compile()


def _add_obstacle(spec: Any, k: int, obstacle: Obstacle) -> None:
    import mujoco

    geom = mujoco.mjtGeom
    match obstacle:
        case Sphere(center, radius):
            ball = [radius, 0.0, 0.0]
            spec.worldbody.add_geom(
                name=f"obstacle {k}.0", type=geom.mjGEOM_SPHERE, pos=center, size=ball, rgba=CONCRETE
            )
        case Box(low, high):
            middle, half = np.add(low, high) / 2.0, np.subtract(high, low) / 2.0
            spec.worldbody.add_geom(name=f"obstacle {k}.0", type=geom.mjGEOM_BOX, pos=middle, size=half, rgba=CONCRETE)
        case Prism():
            for piece, corners in enumerate(convex_pieces(obstacle)):
                name = f"obstacle {k}.{piece}"
                spec.add_mesh(name=name, uservert=corners.ravel(), smoothnormal=False)
                spec.worldbody.add_geom(name=name, type=geom.mjGEOM_MESH, meshname=name, rgba=CONCRETE)


def _add_quadrotor(spec: Any, i: int, vehicle: VehicleParameters, scale: float, colour: str) -> None:
    """Add a body with arms, motors, rotor discs and a nose, in the vehicle's colour."""
    import mujoco

    geom = mujoco.mjtGeom
    paint, dark, white = [*rgb(colour), 1.0], [0.13, 0.14, 0.16, 1.0], [0.97, 0.97, 0.97, 1.0]
    disc = [*(0.45 * rgb(colour) + 0.55), 0.5]
    body = spec.worldbody.add_body(name=f"vehicle {i}", mocap=True)
    arms = np.asarray(vehicle.rotor_positions_B) * scale
    radius = scale * vehicle.body_radius
    arm = float(np.max(np.hypot(*arms.T)))
    rotor = radius - arm
    thick = 0.075 * radius
    hull: dict[str, Any] = {"material": "hull"}
    body.add_geom(type=geom.mjGEOM_ELLIPSOID, size=[0.36 * arm, 0.26 * arm, 1.6 * thick], rgba=paint, **hull)
    body.add_geom(
        type=geom.mjGEOM_BOX, pos=[0, 0, 1.3 * thick], size=[0.17 * arm, 0.13 * arm, 0.6 * thick], rgba=dark, **hull
    )
    nose = [0.34 * arm, 0.0, 0.2 * thick]
    body.add_geom(type=geom.mjGEOM_SPHERE, pos=nose, size=[0.09 * arm, 0.0, 0.0], rgba=white, **hull)
    for x, y in arms:
        body.add_geom(
            type=geom.mjGEOM_CAPSULE, fromto=[0, 0, 0, x, y, 0.0], size=[0.62 * thick, 0, 0], rgba=paint, **hull
        )
        body.add_geom(type=geom.mjGEOM_CYLINDER, pos=[x, y, thick], size=[0.9 * thick, thick, 0], rgba=dark, **hull)
        top = [x, y, 2.1 * thick]
        body.add_geom(type=geom.mjGEOM_CYLINDER, pos=top, size=[rotor, 0.08 * thick, 0.0], rgba=disc)
    for y in (-0.5 * arm, 0.5 * arm):
        skid = [-0.3 * arm, y, -2.4 * thick, 0.3 * arm, y, -2.4 * thick]
        body.add_geom(type=geom.mjGEOM_CAPSULE, fromto=skid, size=[0.3 * thick, 0.0, 0.0], rgba=dark, **hull)
        leg = [0.0, 0.3 * y, 0.0, 0.0, y, -2.4 * thick]
        body.add_geom(type=geom.mjGEOM_CAPSULE, fromto=leg, size=[0.25 * thick, 0.0, 0.0], rgba=dark, **hull)


def paint_ground(stage: Stage, colours: Sequence[str | None]) -> NDArray[np.uint8]:
    """Paint the ground: a grid of metres and the landmarks' squares in their owners' colours.

    Parameters
    ----------
    stage : Stage
    colours : sequence of str or None
        One a landmark, as in `SceneCamera.picture`.

    Returns
    -------
    array of uint8, shape (rows, columns, 3)
        Row 0 is the northern edge.
    """
    sides = np.array(stage.size)
    scale = TEXTURE / sides.max()
    columns, rows = _pixels(stage)
    pixels = np.empty((rows, columns, 3))
    pixels[:] = FLOOR
    spacing = 10.0 ** np.ceil(np.log10(sides.max() / 25.0))
    half = max(1, round(TEXTURE / 1600))
    for step, colour in ((spacing, GRID), (5.0 * spacing, GRID_MAJOR)):
        for axis in (0, 1):
            first = np.ceil(stage.low_W[axis] / step) * step
            for line in np.arange(first, stage.high_W[axis] + 1e-9, step):
                at = round((line - stage.low_W[axis]) * scale)
                band = slice(max(0, at - half), at + half)
                if axis == 0:
                    pixels[:, band] = colour
                else:
                    pixels[band] = colour
    if stage.landmarks_W is not None:
        gap = 0.46 * stage.cell_m
        for (x, y), colour_name in zip(stage.landmarks_W[:, :2] - stage.low_W, colours, strict=True):
            window = np.rint(np.array([y - gap, y + gap, x - gap, x + gap]) * scale).astype(int)
            y0, y1, x0, x1 = np.maximum(window, 0)
            tint = np.array(GRID_MAJOR) if colour_name is None else rgb(colour_name)
            pixels[y0:y1, x0:x1] = 0.35 * np.array(FLOOR) + 0.65 * tint
    return np.ascontiguousarray(np.rint(255.0 * pixels[::-1]).astype(np.uint8))


def _pixels(stage: Stage) -> tuple[int, int]:
    """Columns and rows of the painted ground."""
    sides = np.array(stage.size)
    columns, rows = np.maximum(np.rint(TEXTURE * sides / sides.max()), 1.0)
    return int(columns), int(rows)


__all__ = ["FOV", "Stage", "magnification", "paint_ground", "scene_model"]

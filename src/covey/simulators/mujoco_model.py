"""The world as MuJoCo sees it: one free rigid body a vehicle, its rotors as forces at sites, ground and obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from covey.errors import ArgumentError
from covey.flight.layout import GRAVITY
from covey.flight.obstacles import Box, Obstacle, Prism, Sphere
from covey.flight.parameters import VehicleParameters

GROUND = -1
"""Who owns the geometry of the ground; vehicles are 0 to n - 1, obstacles n and up."""


TOUCH = 1e-3
"""How near the ground a vehicle counts as standing on it, metres."""

GROUNDED: dict[str, Any] = {"contype": 2, "conaffinity": 2}
"""Geometry that meets the ground only; everything else is of type 1."""


class World(NamedTuple):
    """A compiled model and what its numbers belong to.

    Parameters
    ----------
    model : mujoco.MjModel
    owner : array of int32, shape (number of geoms,)
        `GROUND`, the vehicle i, or n + k for obstacle k.
    mocap : dict
        From the index of a spherical obstacle to its row in ``data.mocap_pos``.
    """

    model: Any
    owner: NDArray[np.int32]
    mocap: dict[int, int]


def build(vehicles: Sequence[VehicleParameters], obstacles: Sequence[Obstacle], physics_step: float) -> World:
    """Build and compile the world.

    Vehicle i is body i + 1, 7 numbers of ``qpos`` and 6 of ``qvel``; its rotors are the actuators 4i to 4i + 3, whose
    control is a thrust in newtons.

    Parameters
    ----------
    vehicles : sequence of VehicleParameters
        n of them.
    obstacles : sequence of Obstacle
        Spheres can be moved afterwards.
    physics_step : float
        Seconds.

    Returns
    -------
    World

    Raises
    ------
    ArgumentError
        If something is no obstacle.
    """
    import mujoco

    spec = mujoco.MjSpec()
    option = spec.option
    option.timestep = physics_step
    option.gravity = [0.0, 0.0, -GRAVITY]
    # Fourth order for free bodies, so that steps of 2.5 ms fly like an exact solution between two contacts.
    option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    disabled = mujoco.mjtDisableBit
    # A diverging world must be reported, never silently reset; the rest is not used here and costs time.
    option.disableflags = int(disabled.mjDSBL_AUTORESET | disabled.mjDSBL_SENSOR | disabled.mjDSBL_ISLAND)

    geom = mujoco.mjtGeom
    # Seen a millimetre above the ground, felt on the ground: a vehicle at rest is on the ground at every step.
    near = {"gap": TOUCH}
    spec.worldbody.add_geom(name="ground", type=geom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0], **GROUNDED, **near)
    owners = {"ground": GROUND}
    for i, vehicle in enumerate(vehicles):
        _add_vehicle(spec, i, vehicle)
        owners |= {f"vehicle {i}": i, f"feet {i}": i}
    spheres = []
    for k, obstacle in enumerate(obstacles):
        name = f"obstacle {k}"
        match obstacle:
            case Sphere(center, radius):
                body = spec.worldbody.add_body(name=name, pos=center, mocap=True)
                body.add_geom(name=name, type=geom.mjGEOM_SPHERE, size=[radius, 0.0, 0.0])
                owners[name] = len(vehicles) + k
                spheres.append(k)
            case Box(low, high):
                middle, half = np.add(low, high) / 2.0, np.subtract(high, low) / 2.0
                spec.worldbody.add_geom(name=name, type=geom.mjGEOM_BOX, pos=middle, size=half)
                owners[name] = len(vehicles) + k
            case Prism():
                for piece, corners in enumerate(convex_pieces(obstacle)):
                    part = f"{name}.{piece}"
                    spec.add_mesh(name=part, uservert=corners.ravel())
                    spec.worldbody.add_geom(name=part, type=geom.mjGEOM_MESH, meshname=part)
                    owners[part] = len(vehicles) + k
            case _:
                raise ArgumentError(f"obstacles: expected Sphere, Box or Prism, got {obstacle!r}")
    model = spec.compile()
    # Set here, as the compiler refuses moments of inertia that no body of positive density has: the Iris of RotorS.
    model.body_inertia[1 : len(vehicles) + 1] = [vehicle.inertia for vehicle in vehicles]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    owner = np.array([owners[model.geom(g).name] for g in range(model.ngeom)], dtype=np.int32)
    mocap = {k: int(model.body(f"obstacle {k}").mocapid[0]) for k in spheres}
    return World(model, owner, mocap)


def _add_vehicle(spec: Any, i: int, vehicle: VehicleParameters) -> None:
    import mujoco

    # The frame of the body is that of its centre of mass and principal axes, so qvel is (v_W, omega_B) as in a state.
    body = spec.worldbody.add_body(
        name=f"vehicle {i}",
        mass=vehicle.mass,
        inertia=[max(vehicle.inertia)] * 3,
        ipos=[0.0, 0.0, 0.0],
        iquat=[1.0, 0.0, 0.0, 0.0],
        explicitinertial=True,
    )
    body.add_freejoint()
    cylinder = {
        "type": mujoco.mjtGeom.mjGEOM_CYLINDER,
        "size": [vehicle.body_radius, vehicle.body_height / 2.0, 0.0],
    }
    body.add_geom(name=f"vehicle {i}", **cylinder)
    # A vehicle that stands on the ground is at z = 0, so what touches the ground begins there.
    body.add_geom(name=f"feet {i}", pos=[0.0, 0.0, vehicle.body_height / 2.0], **cylinder, **GROUNDED)
    for rotor in range(4):
        x, y = vehicle.rotor_positions_B[rotor]
        site = f"rotor {i}.{rotor}"
        body.add_site(name=site, pos=[x, y, 0.0])
        drag_torque = -vehicle.rotor_spins[rotor] * vehicle.moment_ratio
        gear = [0.0, 0.0, 1.0, 0.0, 0.0, drag_torque]
        spec.add_actuator(name=site, trntype=mujoco.mjtTrn.mjTRN_SITE, target=site, gear=gear)


def convex_pieces(prism: Prism) -> list[NDArray[np.float64]]:
    """Cut a prism into convex ones.

    Parameters
    ----------
    prism : Prism

    Returns
    -------
    list of arrays, shape (k, 3)
        The corners of each piece, frame W, metres; a single piece where the outline is convex.
    """
    import shapely

    outline = shapely.Polygon(prism.polygon)
    if outline.convex_hull.area - outline.area < 1e-9 * outline.area:
        outlines = [np.asarray(prism.polygon)]
    else:
        triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(outline))
        outlines = [shapely.get_coordinates(triangle)[:3] for triangle in triangles]
    return [
        np.vstack([np.column_stack([corners, np.full(len(corners), z)]) for z in (prism.z_min, prism.z_max)])
        for corners in outlines
    ]


__all__ = ["GROUND", "World", "build", "convex_pieces"]

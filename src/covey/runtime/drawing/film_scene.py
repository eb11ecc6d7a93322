"""The rendered scene beside a film's map: a camera that looks at a recorded flight."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from covey.flight.obstacles import Obstacle
from covey.flight.parameters import VehicleParameters
from covey.geometry import Pose2
from covey.mission import Mission
from covey.runtime.drawing.palette import colours
from covey.runtime.drawing.scene_camera import SceneCamera, frame_all, why_no_pictures
from covey.runtime.drawing.scene_model import Stage
from covey.vehicles.flight_log import FlightLog

WIDTH, HEIGHT = 620, 350
"""Pixels."""

EVERY = 0.8
"""Seconds of flight between two pictures: rendering without a graphics card takes a tenth of a second each."""

MARGIN = 0.5
"""Metres of ground around everything."""

TRAIL = 6.0
"""Seconds of flight that the trails show."""

Pixels = NDArray[np.uint8]


@contextlib.contextmanager
def film_scene(
    log: FlightLog,
    vehicles: Sequence[VehicleParameters],
    *,
    mission: Mission | None,
    snapshots: Sequence[tuple[float, NDArray[np.int64], Sequence[Pose2]]] = (),
    obstacles: Sequence[Obstacle] = (),
    appeared: Sequence[float] = (),
) -> Iterator[Callable[[float], Pixels | None] | None]:
    """Give the `scene` of `covey.runtime.drawing.film.write_film`, or None where nothing can be rendered.

    Parameters
    ----------
    log : FlightLog
    vehicles : sequence of VehicleParameters
        One each.
    mission : Mission or None
        For the landmarks on the ground.
    snapshots : sequence of (time, owner, poses)
        Who owned what from a time on.
    obstacles : sequence of Obstacle
    appeared : sequence of float
        When each of them appeared, seconds; without, all are there from the start.
    """
    if why_no_pictures() is not None:
        yield None
        return
    palette = colours(log.names)
    positions = log.state[:, :, :2].reshape(-1, 2)
    low, high = positions.min(axis=0), positions.max(axis=0)
    landmarks = None
    if mission is not None:
        landmarks = mission.landmarks.positions_W
        low = np.minimum(low, landmarks.min(axis=0))
        high = np.maximum(high, landmarks.max(axis=0))
    stage = Stage(
        vehicles,
        list(palette),
        (float(low[0]) - MARGIN, float(low[1]) - MARGIN),
        (float(high[0]) + MARGIN, float(high[1]) + MARGIN),
        obstacles=tuple(obstacles),
        object_radii=tuple(float(radius) for radius in log.object_radii),
        landmarks_W=landmarks,
        cell_m=0.5 if mission is None else mission.landmarks.cell_size or 0.5,
        shadow_pixels=1024,
        samples=0,
    )
    with SceneCamera(stage, width=WIDTH, height=HEIGHT) as camera:
        view = frame_all(stage, log.state[:, :, :3], aspect=WIDTH / HEIGHT)
        drawn = -np.inf

        def scene(now: float) -> Pixels | None:
            nonlocal drawn
            if now - drawn < EVERY:
                return None
            drawn = now
            row = min(int(np.searchsorted(log.time, now)), len(log.time) - 1)
            first = int(np.searchsorted(log.time, now - TRAIL))
            stride = max(1, (row - first) // 40)
            owner = next((owner for time, owner, _ in reversed(snapshots) if time <= now), None)
            ground = None if owner is None else [palette[k] if k >= 0 else None for k in owner]
            return camera.picture(
                log.state[row],
                view,
                objects_W=log.objects[row] if len(log.object_radii) else None,
                landmark_colours=ground,
                trails_W=log.state[first : row + 1 : stride, :, :3],
                hidden={k for k, since in enumerate(appeared) if since > now},
            )

        yield scene

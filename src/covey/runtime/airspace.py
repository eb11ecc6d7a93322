"""Where a vehicle may be at its altitude: the region without what stands in it, and without those who share it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from covey.errors import ArgumentError, InputError
from covey.flight.obstacles import Box, Obstacle, Prism, Sphere
from covey.geometry import Pose2, Region
from covey.geometry.region import INSET
from covey.mission import Mission
from covey.mission.flight import Separation
from covey.mission.flight_build import CLOSE, ROOM_HINT, START_HINT, bad_starts, crowded

if TYPE_CHECKING:
    import shapely

    from covey.runtime.team import Team


def room(region: Region, spacing: float, taken: Sequence[Pose2], *, own: Pose2) -> Region:
    """Return the part of a region that keeps clear of positions that are taken.

    Parameters
    ----------
    region : Region
    spacing : float
        Distance to keep, metres.
    taken : sequence of Pose2
    own : Pose2
        Where the agent is: if it has no room to move, its own position to a micrometre is all that is left.
    """
    if not taken:
        return region
    left = region.without_discs(np.array([pose.position_W for pose in taken]), spacing)
    if left is not None:
        return left
    reach = max(0.5 * CLOSE, 8.0 * INSET * max(1.0, abs(own.x), abs(own.y)))
    here = Region.box(own.x - reach, own.x + reach, own.y - reach, own.y + reach)
    return _without(region, [region.shape.difference(here.shape)], own) or here


def room_of(mission: Mission, poses: Sequence[Pose2], agent: int) -> Region:
    """Return where an agent of a mission may be, given the committed poses of all."""
    region, separation = mission.agents[agent].region, mission.separation
    if separation is None:
        return region
    taken = [poses[other] for other in separation.sharing(agent)]
    return room(region, separation.spacing, taken, own=poses[agent])


def check_processes(mission: Mission) -> None:
    """Check that a mission can be carried out by agents in processes of their own.

    Raises
    ------
    InputError
        If agents share a layer, since only a team in one process sees every place on offer.
    """
    where = mission.path or mission.name
    if mission.separation is not None:
        raise InputError(
            f"{where}: flight: expected a layer for each agent: those that share one need an "
            "airspace that all see, which agents in processes of their own do not have; raise ceiling_m or layers"
        )


def check_clear_starts(mission: Mission) -> None:
    """Check that agents that share a layer start clear of each other, also where poses were drawn from another seed.

    Raises
    ------
    InputError
        With the pairs that do not.
    """
    separation = mission.separation
    if separation is not None:
        close = separation.too_close([agent.pose for agent in mission.agents], separation.clear - CLOSE)
        if close:
            raise InputError(f"{mission.path or mission.name}: flight: {crowded(mission, close)}; {ROOM_HINT}")


def check_starts(mission: Mission) -> None:
    """Check that the vehicles of a mission can take off where their agents start.

    Raises
    ------
    InputError
        With every one that cannot.
    """
    found = [message for _, message in bad_starts(mission)]
    if found:
        shown = "; ".join(found[:10]) + (f"; and {len(found) - 10} more" if len(found) > 10 else "")
        raise InputError(f"{mission.path or mission.name}: agents: {shown}; {START_HINT}")


class Airspace:
    """The layers that the agents of a running team share: one place that knows which positions are taken.

    Parameters
    ----------
    team : Team
        Its mission says who shares a layer.

    Notes
    -----
    Taken are the committed position of each agent, and those that a trade on offer has for its two agents: reserved as
    long as its server waits for the answer, so that nobody moves there before it is committed or dropped.  This takes a
    team in one process: nothing happens between a look at the airspace and the commit.
    """

    def __init__(self, team: Team) -> None:
        self._team = team

    @property
    def separation(self) -> Separation | None:
        """Who shares a layer at this moment."""
        return self._team.mission.separation

    def room(self, agent: int, region: Region, *, beside: int | None = None) -> Region:
        """Return the part of a region where an agent may be committed now; a partner `beside` it is not looked at."""
        separation = self.separation
        if separation is None:
            return region
        return room(region, separation.spacing, self._taken(agent, beside), own=self._team.poses[agent])

    def clear(self, agent: int, other: int) -> float:
        """Return how far apart two agents must be whatever the direction, metres; 0 if they do not share a layer."""
        separation = self.separation
        return separation.clear if separation is not None and other in separation.sharing(agent) else 0.0

    def is_free(self, agent: int, pose: Pose2) -> bool:
        """Whether an agent may be committed at a pose now."""
        return self.room(agent, self._team.mission.agents[agent].region).contains(pose.x, pose.y)

    def _taken(self, agent: int, beside: int | None) -> list[Pose2]:
        assert self.separation is not None
        team = self._team
        others = [other for other in self.separation.sharing(agent) if other != beside]
        taken = [team.poses[other] for other in others]
        for node in team.nodes:
            offer = node.offer
            if offer is not None:
                if offer.sender.agent in others:
                    taken.append(offer.server_pose)
                if offer.trade.client in others:
                    taken.append(offer.client_pose)
        return list(dict.fromkeys(taken))


def clear_region(
    region: Region, obstacles: Iterable[Obstacle], altitude: float, clearance: float, *, near: Pose2
) -> Region | None:
    """Return the part of a region around a pose that keeps clear of obstacles at an altitude.

    Parameters
    ----------
    region : Region
    obstacles : iterable of Obstacle
    altitude : float
        Metres.
    clearance : float
        Distance to keep from each obstacle, metres.
    near : Pose2
        Where the vehicle is: of several parts, the one nearest to it is returned.

    Returns
    -------
    Region or None
        The region itself if nothing is in the way, None if nothing is left of it.
    """
    cuts = [shape for obstacle in obstacles if (shape := _cut(obstacle, altitude, clearance)) is not None]
    return _without(region, cuts, near)


def passable(region: Region, width: float, *, near: Pose2) -> Region:
    """Return the part of a region that a vehicle gets to through gaps of a width, metres, from where it is.

    Examples
    --------
    >>> hole = [[-0.1, -3.99], [0.1, -3.99], [0.1, 3.99], [-0.1, 3.99]]
    >>> west = passable(Region.polygon([[-4, -4], [4, -4], [4, 4], [-4, 4]], [hole]), 0.2, near=Pose2(-2, 0, 0))
    >>> west.contains(-3.99, -3.99), west.contains(3.0, 0.0)
    (True, False)
    """
    import shapely

    parts = shapely.get_parts(region.shape.buffer(-0.5 * width, join_style="mitre"))
    if len(parts) < 2:
        return region
    here = shapely.Point(near.x, near.y)
    mine = min(parts, key=lambda shape: shape.distance(here)).buffer(0.5 * width, join_style="mitre")
    return _without(region, [region.shape.difference(mine)], near) or region


def without_disc(region: Region, x: float, y: float, radius: float, *, near: Pose2) -> Region | None:
    """Return a region without a disc, metres: its part around `near`, or None if nothing is left."""
    import shapely

    return _without(region, [shapely.Point(x, y).buffer(radius, quad_segs=6)], near)


def cylinder(x: float, y: float, radius: float, height: float) -> Prism:
    """Return a cylinder that stands on the ground, metres, as a prism of 16 sides around it.

    Raises
    ------
    ArgumentError
        If it is smaller than 0.01 m, or larger than 1000 m.
    """
    for name, value in (("radius", radius), ("height", height)):
        if not 0.01 <= value <= 1000.0:
            raise ArgumentError(f"{name}: expected 0.01 m to 1000 m, got {value:g}")
    sides = 16
    reach = radius / math.cos(math.pi / sides)
    corners = [(x + reach * math.cos(turn), y + reach * math.sin(turn)) for turn in np.arange(sides) * math.tau / sides]
    return Prism(tuple(corners), 0.0, height)


def _cut(obstacle: Obstacle, altitude: float, clearance: float) -> shapely.Geometry | None:
    import shapely

    if isinstance(obstacle, Sphere):
        away = abs(altitude - float(obstacle.center_W[2]))
        reach = obstacle.radius + clearance
        if away >= reach:
            return None
        x, y, _ = obstacle.center_W
        return shapely.Point(x, y).buffer(math.sqrt(reach * reach - away * away), quad_segs=8)
    if isinstance(obstacle, Box):
        (x0, y0, z0), (x1, y1, z1) = obstacle.min_W, obstacle.max_W
        shape = shapely.box(x0, y0, x1, y1)
    else:
        z0, z1 = obstacle.z_min, obstacle.z_max
        shape = shapely.Polygon(obstacle.polygon)
    return shape.buffer(clearance, quad_segs=4) if z0 - clearance < altitude < z1 + clearance else None


def _without(region: Region, cuts: list[shapely.Geometry], near: Pose2) -> Region | None:
    import shapely

    if not cuts:
        return region
    rest = region.shape.difference(shapely.union_all(cuts))
    if rest.equals(region.shape):
        return region
    parts = [part for part in shapely.get_parts(rest) if part.geom_type == "Polygon" and part.area > 1e-6]
    if not parts:
        return None
    here = shapely.Point(near.x, near.y)
    part = min(parts, key=lambda shape: shape.distance(here))
    rings = [np.asarray(ring.coords)[:-1, :2] for ring in (part.exterior, *part.interiors)]
    return Region(rings[0], tuple(rings[1:]))

"""What a node asks the world to do, and what it reports for the log."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from covey.geometry import Pose2
from covey.protocol.messages import Heartbeat, Message, Reason, Sender, TradeId
from covey.protocol.records import RecordSlice


@dataclass(frozen=True, slots=True)
class Send:
    """Send a message to one agent."""

    to: int
    message: Message


@dataclass(frozen=True, slots=True)
class Publish:
    """Publish a heartbeat on the state topic."""

    heartbeat: Heartbeat


@dataclass(frozen=True, slots=True)
class GoTo:
    """Take the vehicle to this pose, then call `Node.waypoint_reached` or `Node.waypoint_unreachable`."""

    pose: Pose2


class Cause(enum.Enum):
    """Who found the better pose."""

    OPTIMIZER = "optimizer"
    PROOF = "proof"


@dataclass(frozen=True, slots=True)
class PoseOptimized:
    """An agent committed a better pose for its landmarks (Algorithm 3).

    Parameters
    ----------
    agent : int
    pose : Pose2
    before, after : float
        The agent's coverage score at the old and the new pose.
    cause : Cause
    """

    agent: int
    pose: Pose2
    before: float
    after: float
    cause: Cause


@dataclass(frozen=True, eq=False, slots=True)
class TradeCommitted:
    """Two agents traded; reported by the client at the commit point, once a trade.

    Parameters
    ----------
    trade : TradeId
    client, server : int
    client_pose, server_pose : Pose2
        The committed poses after the trade.
    client_landmarks, server_landmarks : array, shape (k,)
        Sorted landmarks after the trade.
    moved : int
        How many landmarks changed hands.
    before, after : float
        The joint coverage score of the two.
    """

    trade: TradeId
    client: int
    server: int
    client_pose: Pose2
    server_pose: Pose2
    client_landmarks: NDArray[np.int64]
    server_landmarks: NDArray[np.int64]
    moved: int
    before: float
    after: float


@dataclass(frozen=True, slots=True)
class WaypointAbandoned:
    """A waypoint could not be reached and the pose held was committed: the score may fall here, and only here.

    Parameters
    ----------
    agent : int
    abandoned, held : Pose2
    before, after : float
        The agent's coverage score at the pose it was sent to and at the one it holds.

    Notes
    -----
    Deviation: V8.
    """

    agent: int
    abandoned: Pose2
    held: Pose2
    before: float
    after: float


@dataclass(frozen=True, slots=True)
class OfferDeclined:
    """A client turned an offer down."""

    trade: TradeId
    client: int
    server: int
    reason: Reason


@dataclass(frozen=True, eq=False, slots=True)
class OfferStands:
    """A server made an offer, or the one that it had made is closed, whether or not it came to a trade.

    Parameters
    ----------
    trade : TradeId
    client, server : int
    give, want : array, shape (k,)
        Landmarks that would go to the client, and to the server; sorted.
    stands : bool
        Whether the offer stands from now on.
    """

    trade: TradeId
    client: int
    server: int
    give: NDArray[np.int64]
    want: NDArray[np.int64]
    stands: bool


@dataclass(frozen=True, slots=True)
class AgentBuried:
    """An agent declared another dead."""

    agent: int
    dead: int


@dataclass(frozen=True, slots=True)
class AgentReturned:
    """An agent heard from one that it had declared dead, or that is in a newer life than before.

    Parameters
    ----------
    agent : int
    returned : Sender
    """

    agent: int
    returned: Sender


@dataclass(frozen=True, eq=False, slots=True)
class LandmarksAdopted:
    """An agent took landmarks over that a dead agent or a life that is over had owned.

    Parameters
    ----------
    agent : int
    records : RecordSlice
        The new records, one generation above those before.
    """

    agent: int
    records: RecordSlice


@dataclass(frozen=True, eq=False, slots=True)
class LandmarksChanged:
    """An agent learned that landmarks were added, removed, or are worth something else: why its score changed.

    Parameters
    ----------
    agent : int
    landmarks : array, shape (k,)
        Which, sorted.
    before, after : float
        The agent's coverage score as it was and as it is now, at the same pose.
    """

    agent: int
    landmarks: NDArray[np.int64]
    before: float
    after: float


@dataclass(frozen=True, slots=True)
class AgentJoined:
    """An agent learned that another takes part from now on."""

    agent: int
    joined: int


@dataclass(frozen=True, slots=True)
class AgentLeft:
    """An agent learned that another takes part no more, or that itself does not."""

    agent: int
    left: int


Event: TypeAlias = (
    PoseOptimized
    | TradeCommitted
    | WaypointAbandoned
    | OfferDeclined
    | OfferStands
    | AgentBuried
    | AgentReturned
    | LandmarksAdopted
    | LandmarksChanged
    | AgentJoined
    | AgentLeft
)
"""Anything for the log."""

Output: TypeAlias = Send | Publish | GoTo | Event
"""Anything a node returns."""

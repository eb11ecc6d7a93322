"""What agents say to each other.

::

    client                      server
      REQUEST  ───────────────▶           my pose, my landmarks
               ◀───────────────  BUSY | NOTHING | OFFER
      COMMIT   ───────────────▶           (or ABORT)
               ◀───────────────  ACK
      HEARTBEAT, to whoever listens
      MAP, to an agent chosen at random
      CHANGE, from an operator to everybody

Every message may come late, twice or never: a receiver that sees one again does nothing new and answers the same.
Arrays in messages are read-only.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from covey.geometry import Pose2
from covey.protocol.catalogue import EMPTY, Catalogue
from covey.protocol.records import PoseRecord, RecordSlice


class Sender(NamedTuple):
    """One life of one agent; the incarnation rises at each start."""

    agent: int
    incarnation: int


class TradeId(NamedTuple):
    """Names a trade for ever: the client that opened it, in which life, and its how many-eth it was."""

    client: int
    incarnation: int
    number: int


@dataclass(frozen=True, eq=False, slots=True)
class Request:
    """REQUEST: the client asks whether a trade is worth it.

    Parameters
    ----------
    sender : Sender
    trade : TradeId
    pose : PoseRecord
        The client's committed pose.
    records : RecordSlice
        The records of all the client's landmarks.
    avoid : tuple of Pose2
        Poses that the client could not reach and must not be offered again.
    """

    sender: Sender
    trade: TradeId
    pose: PoseRecord
    records: RecordSlice
    avoid: tuple[Pose2, ...] = ()


@dataclass(frozen=True, slots=True)
class Busy:
    """BUSY: the server trades with another, is itself a client, or is on its way; ask again later."""

    sender: Sender
    trade: TradeId


@dataclass(frozen=True, slots=True)
class Nothing:
    """NOTHING: the two have nothing to trade; both drop each other from Q.

    Parameters
    ----------
    sender : Sender
    trade : TradeId
    pose : PoseRecord
        The server's committed pose, so that the client knows where it is.
    """

    sender: Sender
    trade: TradeId
    pose: PoseRecord


@dataclass(frozen=True, eq=False, slots=True)
class Offer:
    """OFFER: the server is locked, holds `give` in escrow and waits for the client to decide.

    Parameters
    ----------
    sender : Sender
    trade : TradeId
    pose : PoseRecord
        The server's committed pose.
    records : RecordSlice
        The records of all the server's landmarks.
    give, want : array, shape (k,)
        Sorted landmarks that would go to the client, and to the server.
    server_pose, client_pose : Pose2
        The poses that both would have; the committed ones where only landmarks move.
    """

    sender: Sender
    trade: TradeId
    pose: PoseRecord
    records: RecordSlice
    give: NDArray[np.int64]
    want: NDArray[np.int64]
    server_pose: Pose2
    client_pose: Pose2


@dataclass(frozen=True, eq=False, slots=True)
class Commit:
    """COMMIT: the trade has happened; these are the records that make it so.

    Parameters
    ----------
    sender : Sender
    trade : TradeId
    records : RecordSlice
        The new record of each landmark that moved.
    server_pose, client_pose : PoseRecord
        The new pose records of both.
    """

    sender: Sender
    trade: TradeId
    records: RecordSlice
    server_pose: PoseRecord
    client_pose: PoseRecord


class Reason(enum.Enum):
    """Why a client aborts."""

    STALE = "stale"
    """The trade is no longer open, or the records have changed; no failure."""
    NO_GAIN = "no gain"
    """The offer is not an improvement by the client's own reckoning; both drop each other from Q."""


@dataclass(frozen=True, slots=True)
class Abort:
    """ABORT: the trade has not happened and never will."""

    sender: Sender
    trade: TradeId
    reason: Reason


@dataclass(frozen=True, slots=True)
class Ack:
    """ACK: the server has merged the commit."""

    sender: Sender
    trade: TradeId


@dataclass(frozen=True, eq=False, slots=True)
class Heartbeat:
    """HEARTBEAT: what the world may know of an agent; the newest wins.

    Parameters
    ----------
    sender : Sender
    sequence : int
        Rises with each heartbeat of one life.
    quiescent : bool
        IDLE, at the waypoint, Q empty.
    epoch : int
        How often the agent's committed pose or landmarks have changed.
    pose : PoseRecord
    committed : mapping of server to int
        How many trades the agent has committed as client, with each server.
    served : mapping of client to int
        How many commits the agent has merged as server, from each client.
    digest : bytes
        What `map_digest` says of the agent's map, where the team survives crashes and the agent is quiescent.
    """

    sender: Sender
    sequence: int
    quiescent: bool
    epoch: int
    pose: PoseRecord
    committed: Mapping[int, int]
    served: Mapping[int, int]
    digest: bytes = b""


@dataclass(frozen=True, eq=False, slots=True)
class Map:
    """MAP: all that an agent knows, for another to merge (anti-entropy).

    Parameters
    ----------
    sender : Sender
    records : RecordSlice
        The records of all landmarks of which anything is known.
    poses : mapping of agent to PoseRecord
    catalogue : Catalogue
        What has changed since the mission began.
    """

    sender: Sender
    records: RecordSlice
    poses: Mapping[int, PoseRecord]
    catalogue: Catalogue = EMPTY


OPERATOR = -1
"""Who sends what no agent says."""


@dataclass(frozen=True, eq=False, slots=True)
class Change:
    """CHANGE: landmarks or agents are others from now on; who may say so is the transport's to decide.

    Parameters
    ----------
    sender : Sender
        Of the agent `OPERATOR`.
    catalogue : Catalogue
        What has changed since the mission began, or the newest part of it.
    """

    sender: Sender
    catalogue: Catalogue


Message: TypeAlias = Request | Busy | Nothing | Offer | Commit | Abort | Ack | Heartbeat | Map | Change
"""Any message."""

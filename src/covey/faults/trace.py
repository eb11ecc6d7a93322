"""Messages and events in words."""

from __future__ import annotations

from collections.abc import Iterable

from covey.protocol import (
    Abort,
    AgentBuried,
    AgentReturned,
    Commit,
    Event,
    Heartbeat,
    LandmarksAdopted,
    Map,
    Message,
    Nothing,
    Offer,
    OfferDeclined,
    PoseOptimized,
    PoseRecord,
    RecordSlice,
    Request,
    TradeCommitted,
    TradeId,
    WaypointAbandoned,
)


def describe(item: Message | Event) -> str:
    """Return a line that a human can read: who says what, about which trade, with which records.

    Examples
    --------
    >>> describe(AgentBuried(0, 2))
    'declares agent 2 dead'
    """
    match item:
        case TradeCommitted():
            return (
                f"commits trade {_trade(item.trade)} with agent {item.server}: has {item.client_landmarks.tolist()} "
                f"at pose {item.client_pose.x:.0f}, leaves {item.server_landmarks.tolist()} at {item.server_pose.x:.0f}"
            )
        case OfferDeclined():
            return f"declines the offer of trade {_trade(item.trade)}: {item.reason.value}"
        case PoseOptimized():
            return f"finds pose {item.pose.x:.0f} better ({item.cause.value}): {item.before:.3f} -> {item.after:.3f}"
        case WaypointAbandoned():
            return f"abandons pose {item.abandoned.x:.0f} for {item.held.x:.0f}: {item.before:.3f} -> {item.after:.3f}"
        case AgentBuried():
            return f"declares agent {item.dead} dead"
        case AgentReturned():
            return f"hears agent {item.returned.agent} again, life {item.returned.incarnation}"
        case LandmarksAdopted():
            return f"adopts {_records(item.records)}"
        case _:
            said = "".join(f", {part}" for part in _parts(item))
            return f"{type(item).__name__.upper()} of agent {item.sender.agent}, life {item.sender.incarnation}{said}"


def _parts(message: Message) -> Iterable[str]:
    if not isinstance(message, Heartbeat | Map):
        yield f"trade {_trade(message.trade)}"
    match message:
        case Request():
            yield _pose(message.pose)
            yield f"owns {_records(message.records)}"
        case Nothing():
            yield _pose(message.pose)
        case Offer():
            yield _pose(message.pose)
            yield f"gives {message.give.tolist()}, wants {message.want.tolist()}"
            yield f"poses {message.server_pose.x:.0f} and {message.client_pose.x:.0f}"
        case Commit():
            yield f"records {_records(message.records)}"
            yield f"server {_pose(message.server_pose)}"
            yield f"client {_pose(message.client_pose)}"
        case Abort():
            yield message.reason.value
        case Heartbeat():
            yield f"quiescent, map {message.digest.hex()}" if message.quiescent else "active"
            yield _pose(message.pose)
        case Map():
            yield f"records {_records(message.records)}"
            yield "; ".join(f"agent {agent} {_pose(pose)}" for agent, pose in message.poses.items())
        case _:
            pass


def _trade(trade: TradeId) -> str:
    return ".".join(map(str, trade))


def _pose(record: PoseRecord) -> str:
    return f"pose {record.pose.x:.0f} ({record.generation}.{record.version})"


def _records(records: RecordSlice) -> str:
    pairs = zip(records.indices.tolist(), records.values.tolist(), strict=True)
    return "{" + ", ".join(f"{k}: {g}.{v} of {owner}.{life}" for k, (g, v, owner, life) in pairs) + "}"

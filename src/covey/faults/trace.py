"""Messages and events in words."""

from __future__ import annotations

from collections.abc import Iterable

from covey.protocol import (
    Abort,
    AgentBuried,
    AgentJoined,
    AgentLeft,
    AgentReturned,
    Catalogue,
    Change,
    Commit,
    Event,
    Heartbeat,
    LandmarksAdopted,
    LandmarksChanged,
    Map,
    Message,
    Nothing,
    Offer,
    OfferDeclined,
    OfferStands,
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
        case OfferStands():
            what = "makes" if item.stands else "closes"
            return f"{what} the offer of trade {_trade(item.trade)}: {item.give.tolist()} for {item.want.tolist()}"
        case PoseOptimized():
            return f"finds pose {item.pose.x:.0f} better ({item.cause.value}): {item.before:.3f} -> {item.after:.3f}"
        case WaypointAbandoned():
            return f"abandons pose {item.abandoned.x:.0f} for {item.held.x:.0f}: {item.before:.3f} -> {item.after:.3f}"
        case AgentBuried():
            return f"declares agent {item.dead} dead"
        case AgentReturned():
            return f"hears agent {item.returned.agent} again, life {item.returned.incarnation}"
        case LandmarksChanged():
            return f"hears that landmarks {item.landmarks.tolist()} changed: {item.before:.3f} -> {item.after:.3f}"
        case AgentJoined():
            return f"hears that agent {item.joined} joins"
        case AgentLeft():
            return "leaves" if item.left == item.agent else f"hears that agent {item.left} leaves"
        case LandmarksAdopted():
            return f"adopts {_records(item.records)}"
        case _:
            said = "".join(f", {part}" for part in _parts(item))
            return f"{type(item).__name__.upper()} of agent {item.sender.agent}, life {item.sender.incarnation}{said}"


def _parts(message: Message) -> Iterable[str]:
    if not isinstance(message, Heartbeat | Map | Change):
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
            if message.catalogue:
                yield describe_catalogue(message.catalogue)
        case Change():
            yield describe_catalogue(message.catalogue)
        case _:
            pass


def describe_catalogue(catalogue: Catalogue) -> str:
    """Return what a catalogue says, in a line."""
    landmarks = [
        f"{k} ({record.version}) {f'weighs {record.weight:g}' if record.alive else 'removed'}"
        for k, record in catalogue.landmarks.items()
    ]
    agents = [
        f"agent {agent} ({record.version}) {'takes part' if record.present else 'has left'}"
        for agent, record in catalogue.agents.items()
    ]
    return ", ".join([*(f"landmark {text}" for text in landmarks), *agents])


def _trade(trade: TradeId) -> str:
    return ".".join(map(str, trade))


def _pose(record: PoseRecord) -> str:
    return f"pose {record.pose.x:.0f} ({record.generation}.{record.version})"


def _records(records: RecordSlice) -> str:
    pairs = zip(records.indices.tolist(), records.values.tolist(), strict=True)
    return "{" + ", ".join(f"{k}: {g}.{v} of {owner}.{life}" for k, (g, v, owner, life) in pairs) + "}"

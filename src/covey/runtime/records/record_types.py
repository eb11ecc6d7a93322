"""The messages of covey's own in a record: one type for each kind of update, with the fields of its dataclass.

A table of layouts gives the definitions in ROS 2's language as well as what writes and reads them.
"""

from __future__ import annotations

import enum
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from covey.runtime.records.cdr import CdrReader, CdrWriter
from covey.runtime.watching.feed import (
    POSE,
    BoundFound,
    ChangeKind,
    Ended,
    Health,
    Motion,
    Note,
    ObstacleAppeared,
    Run,
    Scene,
    SceneAgent,
    SceneObstacle,
    TeamChange,
    TeamState,
    Trading,
    Update,
    Weights,
)

PACKAGE = "covey_msgs"
RULE = "=" * 80


@dataclass(frozen=True, eq=False)
class Kind:
    """How a value is written: its type in ROS 2, and both ways."""

    ros: str
    write: Callable[[CdrWriter, Any], None]
    read: Callable[[CdrReader], Any]


Layout: TypeAlias = tuple[tuple[str, Kind], ...]


def _array(ros: str, dtype: type[np.generic], columns: int | None = None) -> Kind:
    def read(reader: CdrReader) -> Any:
        values = reader.sequence(dtype)
        return values if columns is None else values.reshape(-1, columns)

    return Kind(f"{ros}[]", lambda writer, value: writer.sequence(value, dtype), read)


def _floats(columns: int | None = None) -> Kind:
    return _array("float64", np.float64, columns)


def _named(cls: type[enum.Enum]) -> Kind:
    return Kind("string", lambda writer, value: writer.text(value.value), lambda reader: cls(reader.text()))


def _maybe_floats(columns: int | None = None) -> Kind:
    """Numbers, or None, which is written as none of them."""
    kind = _floats(columns)
    return Kind(
        kind.ros,
        lambda writer, value: kind.write(writer, np.empty(0) if value is None else np.asarray(value)),
        lambda reader: values if len(values := kind.read(reader)) else None,
    )


def _maybe_pair() -> Kind:
    kind = _maybe_floats()

    def read(reader: CdrReader) -> tuple[float, ...] | None:
        values = kind.read(reader)
        return None if values is None else tuple(values.tolist())

    return Kind(kind.ros, kind.write, read)


def _write_maybe_flag(writer: CdrWriter, value: bool | None) -> None:
    writer.number("<b", -1 if value is None else int(value))


def _read_maybe_flag(reader: CdrReader) -> bool | None:
    value = reader.number("<b")
    return None if value < 0 else bool(value)


def _write_record(writer: CdrWriter, layout: Layout, value: object) -> None:
    for name, kind in layout:
        kind.write(writer, getattr(value, name))


def _read_record(reader: CdrReader, cls: type, layout: Layout) -> Any:
    return cls(**{name: kind.read(reader) for name, kind in layout})


def _nested(cls: type, layout: Layout) -> Kind:
    def read(reader: CdrReader) -> Any:
        return _read_record(reader, cls, layout)

    return Kind(f"{PACKAGE}/{cls.__name__}", lambda writer, value: _write_record(writer, layout, value), read)


def _many(item: Kind) -> Kind:
    def write(writer: CdrWriter, values: Any) -> None:
        writer.number("<I", len(values))
        for value in values:
            item.write(writer, value)

    def read(reader: CdrReader) -> Any:
        return tuple(item.read(reader) for _ in range(reader.count()))

    return Kind(f"{item.ros}[]", write, read)


FLOAT = Kind("float64", lambda writer, value: writer.number("<d", value), lambda reader: reader.number("<d"))
INT = Kind("int32", lambda writer, value: writer.number("<i", value), lambda reader: int(reader.number("<i")))
LONG = Kind("int64", lambda writer, value: writer.number("<q", value), lambda reader: int(reader.number("<q")))
FLAG = Kind("bool", lambda writer, value: writer.number("<B", value), lambda reader: bool(reader.number("<B")))
MAYBE_FLAG = Kind("int8", _write_maybe_flag, _read_maybe_flag)
TEXT = Kind("string", lambda writer, value: writer.text(value), lambda reader: reader.text())
JSON = Kind("string", lambda writer, value: writer.text(json.dumps(value)), lambda reader: json.loads(reader.text()))
INDICES = _array("int32", np.int32)
CODES = _array("uint8", np.uint8)
AGENTS = Kind(
    INDICES.ros,
    lambda writer, value: INDICES.write(writer, np.array(value, dtype=np.int32)),
    lambda reader: tuple(INDICES.read(reader).tolist()),
)
FLOATS, POINTS, POSES = _floats(), _floats(3), _floats(POSE)

_RING = Kind(
    f"{PACKAGE}/Ring",
    lambda writer, value: writer.sequence(value, np.float64),
    lambda reader: reader.sequence(np.float64).reshape(-1, 2),
)
RINGS = _many(_RING)

_AGENT: Layout = (
    ("name", TEXT),
    ("colour", TEXT),
    ("region", RINGS),
    ("sensor", TEXT),
    ("optimal_distance", FLOAT),
)
_OBSTACLE: Layout = (("outline", _floats(2)), ("z_min", FLOAT), ("z_max", FLOAT), ("radius", FLOAT))
OBSTACLE = _nested(SceneObstacle, _OBSTACLE)

LAYOUTS: Mapping[type[Any], Layout] = {
    Scene: (
        ("run", _named(Run)),
        ("mission", TEXT),
        ("seed", LONG),
        ("sigma", FLOAT),
        ("trade", TEXT),
        ("agents", _many(_nested(SceneAgent, _AGENT))),
        ("positions_W", POINTS),
        ("weights", FLOATS),
        ("normals_W", _maybe_floats(3)),
        ("cell_size", FLOAT),
        ("region", RINGS),
        ("obstacles", _many(OBSTACLE)),
        ("body_radius", FLOAT),
        ("required_separation", FLOAT),
        ("origin_lonlat_deg", _maybe_pair()),
        ("source", JSON),
        ("software", JSON),
    ),
    TeamState: (
        ("time", FLOAT),
        ("owner", INDICES),
        ("poses", POSES),
        ("scores", FLOATS),
        ("weights", FLOATS),
        ("activity", CODES),
        ("trading", INDICES),
        ("trades", INT),
        ("bound", FLOAT),
    ),
    TeamChange: (
        ("time", FLOAT),
        ("kind", _named(ChangeKind)),
        ("agents", AGENTS),
        ("landmarks", INDICES),
        ("owner", INDICES),
        ("posed", AGENTS),
        ("poses", POSES),
        ("scored", AGENTS),
        ("scores", FLOATS),
        ("score", FLOAT),
        ("text", TEXT),
    ),
    Trading: (
        ("time", FLOAT),
        ("client", INT),
        ("server", INT),
        ("give", INDICES),
        ("want", INDICES),
        ("open", FLAG),
    ),
    Weights: (("time", FLOAT), ("landmarks", INDICES), ("weights", FLOATS)),
    Motion: (
        ("time", FLOAT),
        ("poses", POSES),
        ("velocities_W", POINTS),
        ("rates_B", POINTS),
        ("objects_W", POINTS),
        ("score_flown", FLOAT),
        ("separation", FLOAT),
    ),
    Health: (("time", FLOAT), ("activity", CODES), ("battery", FLOATS), ("link", FLOATS), ("heard", FLOATS)),
    Note: (("time", FLOAT), ("kind", TEXT), ("agents", AGENTS), ("text", TEXT)),
    ObstacleAppeared: (("time", FLOAT), ("obstacle", OBSTACLE)),
    BoundFound: (("time", FLOAT), ("bound", FLOAT)),
    Ended: (("time", FLOAT), ("status", TEXT), ("holds", MAYBE_FLAG), ("score", FLOAT)),
}
"""The fields of each type, in order."""

_PARTS: Mapping[str, Layout] = {
    "Ring": (("points", _floats(2)),),
    "SceneAgent": _AGENT,
    "SceneObstacle": _OBSTACLE,
}
"""Types that only occur inside of others."""


def type_name(cls: type[Any]) -> str:
    """Return the name of a type in ROS 2.

    Examples
    --------
    >>> type_name(TeamChange)
    'covey_msgs/msg/TeamChange'
    """
    return f"{PACKAGE}/msg/{cls.__name__}"


def definition(cls: type[Any]) -> str:
    """Return the definition of a type, those inside of it after it, as MCAP's ``ros2msg`` has it.

    Examples
    --------
    >>> print(definition(BoundFound))
    float64 time
    float64 bound
    """
    parts: dict[str, str] = {}

    def text(layout: Layout) -> str:
        for _, kind in layout:
            package, _, name = kind.ros.removesuffix("[]").partition("/")
            if package == PACKAGE and name not in parts:
                parts[name] = ""  # known from here on, so that it comes once
                parts[name] = text(_PARTS[name])
        return "\n".join(f"{kind.ros} {_field(name)}" for name, kind in layout)

    own = text(LAYOUTS[cls])
    return "\n".join([own, *(f"{RULE}\nMSG: {PACKAGE}/{name}\n{part}" for name, part in parts.items())])


def encode(item: Scene | Update) -> bytes:
    """Return an item as a message."""
    writer = CdrWriter()
    _write_record(writer, LAYOUTS[type(item)], item)
    return writer.data()


def decode(cls: type[Any], data: bytes) -> Scene | Update:
    """Return the item that a message of a type holds.

    Raises
    ------
    ValueError
        If it holds none.
    """
    item: Scene | Update = _read_record(CdrReader(data), cls, LAYOUTS[cls])
    return item


def _field(name: str) -> str:
    """Return a field's name as ROS 2 allows it: ``positions_W`` becomes ``positions_w``."""
    return name.lower()

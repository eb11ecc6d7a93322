"""Messages of ROS 2's standard types, as far as a record has them: their definitions, and how they are packed."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from covey.runtime.drawing.palette import rgb
from covey.runtime.records.cdr import HEADER, CdrWriter
from covey.runtime.records.record_types import RULE

ODOMETRY = "nav_msgs/msg/Odometry"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
MARKERS = "visualization_msgs/msg/MarkerArray"
FLOAT64 = "std_msgs/msg/Float64"
LOG = "rcl_interfaces/msg/Log"
BATTERY = "sensor_msgs/msg/BatteryState"

_FIELDS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/Float64": "float64 data",
    "std_msgs/ColorRGBA": "float32 r\nfloat32 g\nfloat32 b\nfloat32 a",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
    "nav_msgs/Odometry": (
        "std_msgs/Header header\nstring child_frame_id\n"
        "geometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist"
    ),
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "sensor_msgs/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data",
    "sensor_msgs/BatteryState": (
        "std_msgs/Header header\nfloat32 voltage\nfloat32 temperature\nfloat32 current\nfloat32 charge\n"
        "float32 capacity\nfloat32 design_capacity\nfloat32 percentage\nuint8 power_supply_status\n"
        "uint8 power_supply_health\nuint8 power_supply_technology\nbool present\nfloat32[] cell_voltage\n"
        "float32[] cell_temperature\nstring location\nstring serial_number"
    ),
    "visualization_msgs/UVCoordinate": "float32 u\nfloat32 v",
    "visualization_msgs/MeshFile": "string filename\nuint8[] data",
    "visualization_msgs/Marker": (
        "std_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\ngeometry_msgs/Pose pose\n"
        "geometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\nbuiltin_interfaces/Duration lifetime\n"
        "bool frame_locked\ngeometry_msgs/Point[] points\nstd_msgs/ColorRGBA[] colors\nstring texture_resource\n"
        "sensor_msgs/CompressedImage texture\nvisualization_msgs/UVCoordinate[] uv_coordinates\nstring text\n"
        "string mesh_resource\nvisualization_msgs/MeshFile mesh_file\nbool mesh_use_embedded_materials"
    ),
    "visualization_msgs/MarkerArray": "visualization_msgs/Marker[] markers",
    "rcl_interfaces/Log": (
        "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\nstring function\nuint32 line"
    ),
}
"""Fields of each type, ROS 2 Humble and later."""

ARROW, LINE_LIST, CUBE_LIST, TEXT_VIEW_FACING = 0, 5, 6, 9
"""Types of markers."""
ADD, DELETEALL = 0, 3
"""What to do with a marker."""

DISCHARGING, UNKNOWN_HEALTH, UNKNOWN_TECHNOLOGY = 2, 0, 0
"""What is said of batteries."""

INFO, WARN = 20, 30
"""Levels of a log line."""


def definition(name: str) -> str:
    """Return the definition of a type, those inside of it after it, as MCAP's ``ros2msg`` has it.

    Examples
    --------
    >>> definition("std_msgs/msg/Float64")
    'float64 data'
    """
    wanted, texts = [name.replace("/msg/", "/")], list[str]()
    for part in wanted:
        texts.append(_FIELDS[part])
        inner = [line.split()[0].split("[")[0] for line in _FIELDS[part].splitlines()]
        wanted += [kind for kind in inner if kind in _FIELDS and kind not in wanted]
    parts = zip(wanted[1:], texts[1:], strict=True)
    return "\n".join([texts[0], *(f"{RULE}\nMSG: {part}\n{text}" for part, text in parts)])


def stamp_of(nanoseconds: int) -> tuple[int, int]:
    """Return a time as ``sec`` and ``nanosec``."""
    return divmod(nanoseconds, 1_000_000_000)


def float64(value: float) -> bytes:
    """Return a ``std_msgs/Float64``."""
    return HEADER + struct.pack("<d", value)


def pose_stamped(nanoseconds: int, frame: str, pose: Sequence[float]) -> bytes:
    """Return a ``geometry_msgs/PoseStamped``; the pose is x, y, z, then quat_wxyz."""
    writer = CdrWriter()
    _header(writer, nanoseconds, frame)
    _pose(writer, pose)
    return writer.data()


def log_line(nanoseconds: int, level: int, name: str, text: str) -> bytes:
    """Return a ``rcl_interfaces/Log``."""
    writer = CdrWriter()
    _stamp(writer, nanoseconds)
    writer.number("<B", level)
    for part in (name, text, "", ""):
        writer.text(part)
    writer.number("<I", 0)
    return writer.data()


def battery_state(nanoseconds: int, frame: str, share: float) -> bytes:
    """Return a ``sensor_msgs/BatteryState`` of which nothing but the share that is left, from 0 to 1, is known."""
    writer = CdrWriter()
    _header(writer, nanoseconds, frame)
    writer.constant(_NO_NUMBERS)
    writer.number("<f", share)
    writer.constant(_NO_CELLS)
    return writer.data()


class OdometryMessage:
    """Packs the ``nav_msgs/Odometry`` of one vehicle again and again: only the numbers change.

    Parameters
    ----------
    frame, child_frame : str
        Frame W, and that of the vehicle.
    """

    def __init__(self, frame: str, child_frame: str) -> None:
        writer = CdrWriter()
        _header(writer, 0, frame)
        writer.text(child_frame)
        writer.align(8)
        self._pose_at = len(writer.data())
        writer.fixed(np.zeros(7 + 36 + 6 + 36), np.float64)
        self._buffer = bytearray(writer.data())
        self._twist_at = self._pose_at + 8 * (7 + 36)

    def pack(self, nanoseconds: int, pose: Sequence[float], twist_B: Sequence[float]) -> bytes:
        """Return the message; `twist_B` is velocity, m/s, and body rates, rad/s, both in the vehicle's frame."""
        buffer = self._buffer
        x, y, z, qw, qx, qy, qz = pose
        struct.pack_into("<iI", buffer, 4, *stamp_of(nanoseconds))
        struct.pack_into("<7d", buffer, self._pose_at, x, y, z, qx, qy, qz, qw)
        struct.pack_into("<6d", buffer, self._twist_at, *twist_B)
        return bytes(buffer)


class TransformsMessage:
    """Packs the ``tf2_msgs/TFMessage`` of all vehicles again and again.

    Parameters
    ----------
    frame : str
        Frame W.
    child_frames : sequence of str
        Those of the vehicles.
    """

    def __init__(self, frame: str, child_frames: Sequence[str]) -> None:
        writer = CdrWriter()
        writer.number("<I", len(child_frames))
        self._places: list[tuple[int, int]] = []
        for child in child_frames:
            writer.align(4)
            stamp_at = len(writer.data())
            _header(writer, 0, frame)
            writer.text(child)
            writer.align(8)
            self._places.append((stamp_at, len(writer.data())))
            writer.fixed(np.zeros(7), np.float64)
        self._buffer = bytearray(writer.data())

    def pack(self, nanoseconds: int, poses: Sequence[Sequence[float]]) -> bytes:
        """Return the message; a pose is x, y, z, then quat_wxyz."""
        stamp, buffer = stamp_of(nanoseconds), self._buffer
        for (stamp_at, at), (x, y, z, qw, qx, qy, qz) in zip(self._places, poses, strict=True):
            struct.pack_into("<iI", buffer, stamp_at, *stamp)
            struct.pack_into("<7d", buffer, at, x, y, z, qx, qy, qz, qw)
        return bytes(buffer)


@dataclass(frozen=True, eq=False)
class Marker:
    """A ``visualization_msgs/Marker``.

    Parameters
    ----------
    namespace : str
    number : int
    kind, action : int
    frame : str
    pose : sequence of float
        x, y, z, then quat_wxyz.
    scale : (float, float, float)
    colour : str
        ``#rrggbb``.
    opacity : float
    points : array, shape (k, 3)
    text : str
    frame_locked : bool
        It moves with its frame.
    """

    namespace: str
    number: int
    kind: int = CUBE_LIST
    action: int = ADD
    frame: str = ""
    pose: Sequence[float] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    colour: str = "#ffffff"
    opacity: float = 1.0
    points: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 3)))
    text: str = ""
    frame_locked: bool = False


def marker_array(nanoseconds: int, markers: Sequence[Marker]) -> bytes:
    """Return a ``visualization_msgs/MarkerArray``."""
    writer = CdrWriter()
    writer.number("<I", len(markers))
    for marker in markers:
        _marker(writer, nanoseconds, marker)
    return writer.data()


def _marker(writer: CdrWriter, nanoseconds: int, marker: Marker) -> None:
    _header(writer, nanoseconds, marker.frame)
    writer.text(marker.namespace)
    for number in (marker.number, marker.kind, marker.action):
        writer.number("<i", number)
    _pose(writer, marker.pose)
    writer.fixed(np.array(marker.scale), np.float64)
    writer.fixed(np.append(rgb(marker.colour), marker.opacity), np.float32)
    writer.fixed(np.zeros(2), np.int32)  # it stays for ever
    writer.number("<B", marker.frame_locked)
    writer.number("<I", len(marker.points))
    writer.fixed(marker.points, np.float64)
    writer.constant(_NO_TEXTURE)
    writer.text(marker.text)
    writer.constant(_NO_MESH)


def _no_texture() -> bytes:
    writer = CdrWriter()
    writer.number("<I", 0)  # colours
    writer.text("")  # texture_resource
    _header(writer, 0, "")
    writer.text("")
    writer.number("<I", 0)  # texture
    writer.number("<I", 0)  # uv_coordinates
    return writer.body()


def _no_mesh() -> bytes:
    writer = CdrWriter()
    writer.text("")  # mesh_resource
    writer.text("")
    writer.number("<I", 0)  # mesh_file
    writer.number("<B", 0)
    return writer.body()


def _no_cells() -> bytes:
    writer = CdrWriter()
    for number in (DISCHARGING, UNKNOWN_HEALTH, UNKNOWN_TECHNOLOGY, True):
        writer.number("<B", number)
    for _ in range(2):
        writer.number("<I", 0)
    for _ in range(2):
        writer.text("")  # where it is, serial number
    return writer.body()


def _stamp(writer: CdrWriter, nanoseconds: int) -> None:
    seconds, rest = stamp_of(nanoseconds)
    writer.number("<i", seconds)
    writer.number("<I", rest)


def _header(writer: CdrWriter, nanoseconds: int, frame: str) -> None:
    _stamp(writer, nanoseconds)
    writer.text(frame)


def _pose(writer: CdrWriter, pose: Sequence[float]) -> None:
    x, y, z, qw, qx, qy, qz = pose
    writer.fixed(np.array([x, y, z, qx, qy, qz, qw]), np.float64)


# What is not known or not there is the same in all messages.
_NO_TEXTURE, _NO_MESH = _no_texture(), _no_mesh()
_NO_NUMBERS, _NO_CELLS = struct.pack("<6f", *[math.nan] * 6), _no_cells()

"""Common Data Representation, little-endian: how ROS 2 messages are written as bytes."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import DTypeLike, NDArray

HEADER = b"\x00\x01\x00\x00"
"""Says that what follows is little-endian."""

_PADDING = (b"", b"\0", b"\0\0", b"\0\0\0", b"\0\0\0\0", b"\0\0\0\0\0", b"\0\0\0\0\0\0", b"\0\0\0\0\0\0\0")
_LENGTH = struct.Struct("<I")


class CdrWriter:
    """Puts values one after the other, each aligned to its size.

    Examples
    --------
    >>> writer = CdrWriter()
    >>> writer.text("ab")
    >>> writer.number("<d", 1.0)
    >>> len(writer.data())
    20
    """

    def __init__(self) -> None:
        self._buffer = bytearray()

    def data(self) -> bytes:
        """Return the message."""
        return HEADER + self._buffer

    def body(self) -> bytes:
        """Return what was written, without the header."""
        return bytes(self._buffer)

    def constant(self, body: bytes) -> None:
        """Write what another writer wrote whose numbers have four bytes at most."""
        self.align(4)
        self._buffer += body

    def align(self, size: int) -> None:
        """Fill up to a multiple of a size, bytes."""
        self._buffer += _PADDING[-len(self._buffer) % size]

    def number(self, kind: str, value: float) -> None:
        """Write one number; `kind` as for `struct`, little-endian."""
        self.align(struct.calcsize(kind))
        self._buffer += struct.pack(kind, value)

    def text(self, value: str) -> None:
        """Write a string."""
        encoded = value.encode("utf-8")
        self.number("<I", len(encoded) + 1)
        self._buffer += encoded
        self._buffer.append(0)

    def fixed(self, values: NDArray[np.generic], dtype: DTypeLike) -> None:
        """Write numbers without their count."""
        array = np.ascontiguousarray(values, dtype=np.dtype(dtype).newbyteorder("<"))
        if array.size:
            self.align(array.itemsize)
            self._buffer += array.tobytes()

    def sequence(self, values: NDArray[np.generic], dtype: DTypeLike) -> None:
        """Write numbers after their count."""
        self.number("<I", values.size)
        self.fixed(values, dtype)


class CdrReader:
    """Takes values out of a message again.

    Parameters
    ----------
    data : bytes

    Raises
    ------
    ValueError
        If the bytes are no little-endian message; every method raises it where the message ends too early.
    """

    def __init__(self, data: bytes) -> None:
        if data[:2] != HEADER[:2]:
            raise ValueError("expected little-endian CDR")
        self._data = data
        self._at = len(HEADER)

    def number(self, kind: str) -> float:
        """Read one number; `kind` as for `struct`."""
        size = struct.calcsize(kind)
        start = self._take(size, size)
        value: float = struct.unpack_from(kind, self._data, start)[0]
        return value

    def count(self) -> int:
        """Read the count of what follows."""
        start = self._take(4, 4)
        value: int = _LENGTH.unpack_from(self._data, start)[0]
        return value

    def text(self) -> str:
        """Read a string."""
        length = self.count()
        start = self._take(length, 1)
        return self._data[start : start + max(0, length - 1)].decode("utf-8")

    def sequence(self, dtype: DTypeLike) -> NDArray[np.generic]:
        """Read numbers after their count, shape (k,)."""
        kind, length = np.dtype(dtype).newbyteorder("<"), self.count()
        if length == 0:
            return np.empty(0, dtype=dtype)
        start = self._take(length * kind.itemsize, kind.itemsize)
        return np.frombuffer(self._data, kind, length, start).astype(dtype)

    def _take(self, size: int, alignment: int) -> int:
        start = self._at + -(self._at - len(HEADER)) % alignment
        if start + size > len(self._data):
            raise ValueError("the message ends too early")
        self._at = start + size
        return start

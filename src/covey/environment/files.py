"""Read the text files that a mission names, with one clear sentence when that fails."""

from __future__ import annotations

import difflib
from pathlib import Path

from covey.errors import InputError


def read_text(path: Path, *, limit: int) -> str:
    """Read a UTF-8 file of at most `limit` bytes.

    Parameters
    ----------
    path : Path
    limit : int
        Largest size accepted, bytes; nothing beyond it is read.

    Raises
    ------
    InputError
        If the file is missing, a directory, unreadable, empty, too large or not UTF-8.
    """
    try:
        with path.open("rb") as stream:
            raw = stream.read(limit + 1)
    except FileNotFoundError:
        raise InputError(f"expected a file, found nothing at {_shown(path)}{_similar(path)}") from None
    except IsADirectoryError:
        raise InputError(f"expected a file, {_shown(path)} is a directory") from None
    except NotADirectoryError:
        raise InputError(f"expected a file, {_shown(path)} leads through something that is no directory") from None
    except PermissionError:
        raise InputError(f"expected a readable file, {_shown(path)} may not be read by this user") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL character in the name
        raise InputError(f"cannot read {_shown(path)}: {getattr(error, 'strerror', None) or error}") from None
    if len(raw) > limit:
        raise InputError(f"expected at most {limit:,} bytes, {_shown(path)} has more")
    if not raw.strip():
        raise InputError(f"expected some content, {_shown(path)} is empty")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"expected UTF-8 text, got byte 0x{raw[error.start]:02x} at offset {error.start} of {_shown(path)}"
        ) from None


def _shown(path: Path) -> str:
    return repr(str(path))


def _similar(path: Path) -> str:
    try:
        names = [entry.name for entry in path.parent.iterdir()]
    except (OSError, ValueError):
        return ""
    close = difflib.get_close_matches(path.name, names, n=1)
    return f"; did you mean {close[0]!r}?" if close else ""

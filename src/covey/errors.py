"""Every error that covey raises on purpose.

::

    CoveyError                    anything covey reports; the command line exits with `exit_code`
    ├── ArgumentError             a function's argument has the wrong shape, type or range (also a ValueError)
    ├── InputError                a file the user gave cannot be used
    │   ├── MissionError          a mission file: carries every mistake found, with line and key
    │   ├── ResultError           a result directory: missing, incomplete or inconsistent
    │   └── RecordError           a record of a run: no MCAP file, not of covey, or too little of it is left
    ├── OutputError               the output cannot be written, or would overwrite something
    ├── NetworkError              the network cannot be joined
    ├── CodecError                bytes from the network are no message of this mission; says why
    └── SolverError               an optimiser could not do what it promises, or a simulation diverged

Exit codes of the command line: 0 success, 1 the deployment violates its certificate, 2 bad input, usage or output,
3 an optimiser or a simulation failed, 130 Ctrl-C.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass


class CoveyError(Exception):
    """Base of all errors that covey raises on purpose."""

    exit_code = 2


class ArgumentError(CoveyError, ValueError):
    """An argument has the wrong shape, type or range; the text names it, what was expected and what came."""


class InputError(CoveyError):
    """A file given by the user cannot be used."""


@dataclass(frozen=True)
class Mistake:
    """One mistake in an input file.

    Parameters
    ----------
    file : str
        The file as the user named it.
    line, column : int or None
        One-based place of the key or value, where known.
    key : str
        Dotted path of the key, for example ``agents[0].pose.x_m``; empty for the file as a whole.
    message : str
        What was expected and what came.
    hint : str
        The next step, for example the key that was probably meant; may be empty.
    """

    file: str
    line: int | None
    column: int | None
    key: str
    message: str
    hint: str = ""

    def __str__(self) -> str:
        place = self.file
        if self.line is not None:
            place += f":{self.line}"
            if self.column is not None:
                place += f":{self.column}"
        key = f"{self.key}: " if self.key else ""
        hint = f" ({self.hint})" if self.hint else ""
        return f"{place}: {key}{self.message}{hint}"


class MissionError(InputError):
    """A mission file is wrong; `mistakes` holds all that was found, in the order of the file."""

    def __init__(self, mistakes: tuple[Mistake, ...]) -> None:
        super().__init__("\n".join(str(mistake) for mistake in mistakes))
        self.mistakes = mistakes


class ResultError(InputError):
    """A result directory is missing, incomplete or contradicts itself."""


class RecordError(InputError):
    """A record of a run cannot be read: no MCAP file, not written by covey, or cut before it tells anything."""


class OutputError(CoveyError):
    """Output cannot be written, or would overwrite what is there."""


class NetworkError(CoveyError):
    """The network cannot be joined as configured."""


class Drop(enum.Enum):
    """Why something that arrived was dropped."""

    TOO_LONG = "too long"
    MALFORMED = "malformed"
    VERSION = "another version"
    MISSION = "another mission"
    IMPOSTOR = "impostor"
    """It came by another agent's key, or was addressed to another."""
    REPLAYED = "replayed"
    """It was here before, is too old to tell, or is of an earlier life of its sender."""
    OUTDATED = "outdated"
    """A newer state of the same agent is known."""
    FULL = "inbox full"


class CodecError(CoveyError):
    """Bytes from the network are no message of this mission; `cause` says why."""

    def __init__(self, cause: Drop, text: str) -> None:
        super().__init__(f"{cause.value}: {text}")
        self.cause = cause


class SolverError(CoveyError):
    """An optimiser could not do what it promises, or a simulation diverged."""

    exit_code = 3

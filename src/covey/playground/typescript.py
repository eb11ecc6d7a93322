"""The types of the messages for the page: ``python -m covey.playground.typescript > web/src/messages.ts``."""

from __future__ import annotations

import collections.abc
import dataclasses
import enum
import types
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from covey.playground import messages
from covey.runtime.watching import feed, steering

HEAD = """\
// Written by `make web` from covey/playground/messages.py and covey/runtime/watching/feed.py; do not edit.

/** An array as it comes: little-endian values in base64. */
export interface Encoded<D extends "f8" | "f4" | "i4" | "u1"> {
  dtype: D;
  shape: number[];
  data: string;
}
"""

DTYPES = {np.float64: "f8", np.float32: "f4", np.int32: "i4", np.uint8: "u1"}

MAY_BE_NULL = {"bound", "cell_size", "optimal_distance", "score_flown", "separation"}
"""The numbers that may be NaN or infinite."""


def source() -> str:
    """Return the text of ``messages.ts``."""
    kinds = get_args(messages.Message)
    parts = [HEAD, f"export const POSE = {feed.POSE};\nexport const NOBODY = {feed.NOBODY};\n"]
    parts += [_enum(feed.Run), _enum(feed.ChangeKind), _activity()]
    parts += [_interface(kind) for kind in (feed.SceneAgent, feed.SceneObstacle, messages.PastChange)]
    parts += [_interface(kind, tag=f'type: "{kind.__name__}"') for kind in kinds]
    updates = " | ".join(kind.__name__ for kind in get_args(feed.Update))
    parts.append(f"export type Update = {updates};\n")
    parts.append(f"export type Message = {' | '.join(kind.__name__ for kind in kinds)};\n")
    parts += [_interface(kind, tag=f'command: "{name}"') for name, kind in steering.COMMANDS.items()]
    commands = " | ".join(kind.__name__ for kind in steering.COMMANDS.values())
    parts.append(f"export type Command = {commands};\n")
    return "\n".join(parts)


def _enum(kind: type[enum.Enum]) -> str:
    values = " | ".join(f'"{item.value}"' for item in kind)
    return f"export type {kind.__name__} = {values};\n"


def _activity() -> str:
    items = ", ".join(f"{item.name}: {item.value}" for item in feed.Activity)
    return f"export const Activity = {{ {items} }} as const;\n"


def _interface(kind: type[Any], *, tag: str = "") -> str:
    hints = get_type_hints(kind)
    lines = [f"/** {(kind.__doc__ or '').strip().splitlines()[0]} */", f"export interface {kind.__name__} {{"]
    lines += [f"  {tag};"] if tag else []
    for field in dataclasses.fields(kind):
        null = " | null" if field.name in MAY_BE_NULL else ""
        lines.append(f"  {field.name}: {_type(hints[field.name])}{null};")
    return "\n".join([*lines, "}\n"])


def _type(hint: Any) -> str:
    origin, arguments = get_origin(hint), get_args(hint)
    if hint is type(None):
        return "null"
    if hint in (int, float, str, bool):
        return {int: "number", float: "number", str: "string", bool: "boolean"}[hint]
    if hint is object:
        return "unknown"
    if origin in (Union, types.UnionType):
        return " | ".join(dict.fromkeys(_type(argument) for argument in arguments))
    if origin is np.ndarray:
        return f'Encoded<"{_dtype(hint)}">'
    if origin is tuple:
        if len(arguments) == 2 and arguments[1] is Ellipsis:
            inner = _type(arguments[0])
            return f"({inner})[]" if "|" in inner else f"{inner}[]"
        return f"[{', '.join(_type(argument) for argument in arguments)}]"
    if origin is collections.abc.Mapping:
        return f"Record<string, {_type(arguments[1])}>"
    return str(hint.__name__)


def _dtype(hint: Any) -> str:
    (scalar,) = get_args(get_args(hint)[-1])
    return DTYPES[scalar]


if __name__ == "__main__":
    print(source(), end="")

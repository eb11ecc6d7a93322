"""YAML with the place of every entry: composed by ruamel.yaml, turned into plain data here.

The data is built here and not by ruamel's constructor, so that repeated keys, tags and aliases that unfold into
millions of values are mistakes with a place, and nothing but plain data can come out.
"""

from __future__ import annotations

from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode
from ruamel.yaml.reader import ReaderError
from ruamel.yaml.scanner import Scanner, ScannerError

from covey.environment.json_text import KeyPath, LineIndex, Places, key_text
from covey.errors import Mistake

MAX_CHARACTERS = 1_000_000
"""Length of a YAML text: reading takes some 10 s at this length, where JSON takes one."""

MAX_VALUES = 200_000
"""Values a text may hold, aliases unfolded; more landmarks belong in a CSV file."""

MAX_DEPTH = 32

_PREFIX = "tag:yaml.org,2002:"


class _TooMuch(Exception):
    """Unfolding stops here."""


class _ShallowScanner(Scanner):
    """Refuses deep nesting at once: ruamel.yaml looks at every open bracket again for each token."""

    def fetch_flow_collection_start(self, TokenClass: Any, to_push: str) -> None:
        if len(self.flow_context) >= MAX_DEPTH:
            raise ScannerError(
                None, None, f"lists or mappings nested more than {MAX_DEPTH} deep", self.reader.get_mark()
            )
        super().fetch_flow_collection_start(TokenClass, to_push)


def load_yaml(text: str, source: str) -> tuple[Any, Places, list[Mistake]]:
    """Parse YAML 1.2: the data, the place of each entry, and the mistakes of the text itself."""
    places = Places()
    if len(text) > MAX_CHARACTERS:
        message = f"expected at most {MAX_CHARACTERS:,} characters of YAML, got {len(text):,}"
        return None, places, [Mistake(source, None, None, "", message, "use JSON, or put landmarks into a CSV file")]
    try:
        yaml = YAML(typ="safe", pure=True)
        yaml.Scanner = _ShallowScanner
        yaml.composer.warn_double_anchors = False  # YAML allows an anchor to be set again
        root = yaml.compose(text)
    except MarkedYAMLError as error:
        return None, places, [_syntax(error, source)]
    except ReaderError as error:
        message = f"not valid YAML: character #x{error.character:04x} is not allowed"
        return None, places, [Mistake(source, *LineIndex(text)(error.position), "", message)]
    except RecursionError:
        return None, places, [Mistake(source, None, None, "", "expected a mission, got lists nested too deeply")]
    except (YAMLError, ArithmeticError, AssertionError, AttributeError, LookupError, TypeError, ValueError) as error:
        # ruamel.yaml gives up on some malformed directives, tags and escapes with errors of Python's own.
        reason = " ".join(str(error).split())[:200]
        return None, places, [Mistake(source, None, None, "", f"not valid YAML: {reason}")]
    if root is None:
        return None, places, [Mistake(source, None, None, "", "expected a mission, got only comments")]
    builder = _Builder(source, places)
    try:
        data = builder.build(root, (), 0)
    except _TooMuch as error:
        return None, places, [Mistake(source, None, None, "", str(error))]
    return data, places, builder.mistakes


def _syntax(error: MarkedYAMLError, source: str) -> Mistake:
    mark = error.problem_mark or error.context_mark
    line = column = None
    if mark is not None:
        line, column = mark.line + 1, mark.column + 1
    parts = [" ".join(part.split()) for part in (error.problem, error.context) if part]
    return Mistake(source, line, column, "", f"not valid YAML: {', '.join(parts) or 'unreadable'}"[:300])


class _Builder:
    def __init__(self, source: str, places: Places) -> None:
        self.mistakes: list[Mistake] = []
        self._source = source
        self._places = places
        self._values = 0

    def build(self, node: Node, path: KeyPath, depth: int) -> Any:
        self._values += 1
        if self._values > MAX_VALUES:
            raise _TooMuch(f"expected at most {MAX_VALUES:,} values (aliases unfolded); put landmarks into a CSV file")
        if depth > MAX_DEPTH:
            raise _TooMuch(f"expected at most {MAX_DEPTH} levels, got lists or mappings nested deeper")
        if not path or isinstance(path[-1], int):
            self._places.found[path] = _place(node)
        if isinstance(node, MappingNode):
            self._expect_tag(node, path, "map")
            return self._mapping(node, path, depth)
        if isinstance(node, SequenceNode):
            self._expect_tag(node, path, "seq")
            return [self.build(item, (*path, i), depth + 1) for i, item in enumerate(node.value)]
        return self._scalar(node, path)

    def _mapping(self, node: MappingNode, path: KeyPath, depth: int) -> dict[str, Any]:
        result: dict[str, Any] = {}
        for key_node, value_node in node.value:
            key = key_node.value
            if not isinstance(key_node, ScalarNode) or _kind(key_node) not in ("str", "merge", "timestamp"):
                shown = repr(key) if isinstance(key, str) else "a list or mapping"
                self._mistake(key_node, path, f"expected text as a key, got {shown}", "put it in quotes")
                key = key if isinstance(key, str) else "?"
            self._places.add((*path, key), _place(key_node))
            if key in result:
                self._mistake(key_node, (*path, key), f"expected each key once, {key!r} is here again")
                continue
            result[key] = self.build(value_node, (*path, key), depth + 1)
        return result

    def _scalar(self, node: Node, path: KeyPath) -> Any:
        kind, text = _kind(node), node.value
        if kind in ("str", "timestamp"):
            return text
        if kind == "null":
            return None
        if kind == "bool":
            return text.lower() == "true"
        try:
            if kind == "int":
                return _integer(text.replace("_", ""))
            if kind == "float":
                return _real(text.replace("_", "").lower())
        except ValueError:
            self._mistake(node, path, f"expected a number, cannot read {text[:40]!r}")
            return 0
        self._expect_tag(node, path, "str")
        return text

    def _expect_tag(self, node: Node, path: KeyPath, expected: str) -> None:
        if _kind(node) != expected:
            self._mistake(node, path, f"expected plain data, got the tag {_kind(node)[:60]!r}", "leave the tag out")

    def _mistake(self, node: Node, path: KeyPath, message: str, hint: str = "") -> None:
        self.mistakes.append(Mistake(self._source, *_place(node), key_text(path), message, hint))


def _kind(node: Node) -> str:
    return str(node.tag).removeprefix(_PREFIX)


def _place(node: Node) -> tuple[int, int]:
    return node.start_mark.line + 1, node.start_mark.column + 1


def _integer(text: str) -> int:
    digits = text.lstrip("+-").lower()
    base = {"0x": 16, "0o": 8, "0b": 2}.get(digits[:2], 10)
    if len(digits) > 1000:
        raise ValueError("too many digits")
    value = int(digits[2:] if base != 10 else digits, base)
    return -value if text.startswith("-") else value


def _real(text: str) -> float:
    return float(text.replace(".inf", "inf").replace(".nan", "nan"))

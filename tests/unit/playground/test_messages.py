"""What goes between server and page."""

import base64
import dataclasses
import json
import math
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from covey.errors import ArgumentError
from covey.playground import typescript
from covey.playground.messages import LONGEST, Asked, Greeting, decode, encode, plain_array
from covey.playground.sample import sample_feed
from covey.runtime.watching.feed import Ended, Motion, Update
from covey.runtime.watching.steering import COMMANDS, AddObstacle, Kill, Pause, SetSpeed


def test_the_types_of_the_page_are_those_of_the_messages() -> None:
    written = Path(typescript.__file__).parent / "web" / "src" / "messages.ts"
    assert written.read_text(encoding="utf-8") == typescript.source(), "run: make web"


def test_arrays_survive() -> None:
    motion = next(message for message in sample_feed(agents=3, landmarks=12) if isinstance(message, Motion))
    document = json.loads(encode(motion))
    assert document["type"] == "Motion"
    read = document["poses"]
    values = np.frombuffer(base64.b64decode(read["data"]), dtype="<" + read["dtype"]).reshape(read["shape"])
    np.testing.assert_array_equal(values, motion.poses)


@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.int32, np.uint8])
def test_arrays_are_little_endian_rows(dtype: type[Any]) -> None:
    array = np.arange(6, dtype=dtype).reshape(2, 3)
    big_columns = np.asfortranarray(array).astype(array.dtype.newbyteorder(">"))
    assert plain_array(big_columns) == plain_array(array)
    assert base64.b64decode(plain_array(array)["data"]) == array.astype(array.dtype.newbyteorder("<")).tobytes()


def test_every_update_of_the_feed_can_be_encoded() -> None:
    seen = set()
    for message in sample_feed(agents=4, landmarks=40, seconds=10.0):
        document = json.loads(encode(message), parse_constant=pytest.fail)
        assert document.keys() == {"type"} | {field.name for field in dataclasses.fields(message)}
        seen.add(document["type"])
    assert {kind.__name__ for kind in get_args(Update)} - seen == {"Weights", "ObstacleAppeared"}


def test_numbers_that_json_lacks_are_null() -> None:
    assert json.loads(encode(Ended(math.inf, "settled", None, math.nan))) == {
        "type": "Ended",
        "time": None,
        "status": "settled",
        "holds": None,
        "score": None,
    }


@pytest.mark.parametrize(
    ("text", "read"),
    [
        ('{"type": "hello", "token": ""}', Greeting("")),
        ('{"type": "command", "token": "t", "command": "pause"}', Asked("t", Pause(), "pause")),
        ('{"type": "command", "token": "t", "command": "speed", "speed": 2}', Asked("t", SetSpeed(2.0), "speed")),
        ('{"type": "command", "token": "t", "command": "kill", "agent": 3}', Asked("t", Kill(3), "kill")),
        (
            '{"command": "obstacle", "x": 1, "y": -2.5, "radius": 0.5, "height": 3, "token": "t", "type": "command"}',
            Asked("t", AddObstacle(1.0, -2.5, 0.5, 3.0), "obstacle"),
        ),
    ],
)
def test_frames_of_a_visitor_are_read(text: str, read: Greeting | Asked) -> None:
    assert decode(text) == read


@pytest.mark.parametrize(
    "text",
    [
        "",
        "null",
        "[]",
        "{",
        '{"type": "hello"}',
        '{"type": "hello", "token": 1}',
        '{"type": "hello", "token": "", "more": 1}',
        '{"type": "other", "token": ""}',
        '{"type": "command", "token": "t"}',
        '{"type": "command", "token": "t", "command": ["kill"]}',
        '{"type": "command", "token": "t", "command": "fly"}',
        '{"type": "command", "token": "t", "command": "kill"}',
        '{"type": "command", "token": "t", "command": "kill", "agent": "3"}',
        '{"type": "command", "token": "t", "command": "kill", "agent": 3.5}',
        '{"type": "command", "token": "t", "command": "kill", "agent": true}',
        '{"type": "command", "token": "t", "command": "kill", "agent": 3, "agents": 4}',
        '{"type": "command", "token": "t", "command": "speed", "speed": NaN}',
        '{"type": "command", "token": "t", "command": "speed", "speed": 1e999}',
        '{"type": "command", "token": "t", "command": "kill", "agent": 1' + 400 * "0" + "}",
        '{"type": "hello", "token": "' + LONGEST * "a" + '"}',
        "[" * 4000,
    ],
)
def test_malformed_frames_are_refused(text: str) -> None:
    with pytest.raises(ArgumentError):
        decode(text)


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.integers() | st.text(),
        lambda inner: st.lists(inner) | st.dictionaries(st.sampled_from(["type", "token", "command", "agent"]), inner),
    )
)
def test_whatever_comes_is_read_or_refused(document: object) -> None:
    try:
        read = decode(json.dumps(document))
    except ArgumentError:
        return
    assert isinstance(read, Greeting) or read.name in COMMANDS

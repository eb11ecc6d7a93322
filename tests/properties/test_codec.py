"""Laws of the codec: what goes in comes out, and no bytes whatever do anything but decode or raise `CodecError`."""

from __future__ import annotations

import struct
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.contents import AGENTS, CODEC, DIGEST, LANDMARKS, LARGEST, same_content, senders_and_contents

from covey.errors import CodecError, Drop
from covey.protocol import Sender
from covey.transports.codec import LAYOUTS, VERSION, Codec, Content, Envelope

numbers = st.integers(0, LARGEST)
HEADER = 52


def seal(data: bytes) -> bytes:
    """Give bytes a right checksum, so that what lies behind it is reached."""
    return data + struct.pack("<I", zlib.crc32(data))


def try_to_decode(data: bytes) -> Envelope | None:
    """Decode; the one error allowed is None."""
    try:
        return CODEC.decode(data)
    except CodecError:
        return None


@given(senders_and_contents(), numbers, numbers)
def test_what_goes_in_comes_out(spoken: tuple[Sender, Content], to: int, number: int) -> None:
    sender, content = spoken
    envelope = CODEC.decode(CODEC.encode(content, sender=sender, to=to, number=number))
    assert (envelope.sender, envelope.to, envelope.number) == (sender, to, number)
    assert same_content(envelope.content, content)


@given(senders_and_contents(), st.data())
def test_no_cut_is_taken(spoken: tuple[Sender, Content], data: st.DataObject) -> None:
    sender, content = spoken
    whole = CODEC.encode(content, sender=sender, number=1)
    length = data.draw(st.integers(0, len(whole) - 1))
    assert try_to_decode(whole[:length]) is None
    assert try_to_decode(seal(whole[: min(length, len(whole) - 5)])) is None


@given(senders_and_contents(), st.data())
def test_no_flipped_bit_is_taken(spoken: tuple[Sender, Content], data: st.DataObject) -> None:
    sender, content = spoken
    whole = bytearray(CODEC.encode(content, sender=sender, number=1))
    bit = data.draw(st.integers(0, 8 * len(whole) - 1))
    whole[bit // 8] ^= 1 << bit % 8
    assert try_to_decode(bytes(whole)) is None


@given(senders_and_contents(), st.data())
def test_flipped_bits_behind_a_right_checksum_do_no_harm(spoken: tuple[Sender, Content], data: st.DataObject) -> None:
    sender, content = spoken
    body = bytearray(CODEC.encode(content, sender=sender, number=1)[:-4])
    for bit in data.draw(st.lists(st.integers(0, 8 * len(body) - 1), min_size=1, max_size=8)):
        body[bit // 8] ^= 1 << bit % 8
    envelope = try_to_decode(seal(bytes(body)))
    if envelope is not None:
        again = CODEC.encode(envelope.content, sender=envelope.sender, to=envelope.to, number=envelope.number)
        assert same_content(CODEC.decode(again).content, envelope.content)


@given(st.binary(max_size=400))
def test_random_bytes_are_refused(data: bytes) -> None:
    assert try_to_decode(data) is None
    assert try_to_decode(seal(data)) is None


@given(st.sampled_from(sorted(LAYOUTS)), st.binary(max_size=400), st.integers(0, AGENTS - 1))
def test_random_bodies_do_no_harm(kind: int, body: bytes, agent: int) -> None:
    header = struct.pack("<2sBB16sQQQQ", b"cv", 1, kind, DIGEST, agent, 1, 0, 1)
    try_to_decode(seal(header + body))


@given(senders_and_contents(), st.binary(min_size=1, max_size=20))
def test_nothing_may_follow(spoken: tuple[Sender, Content], more: bytes) -> None:
    sender, content = spoken
    whole = CODEC.encode(content, sender=sender, number=1)
    assert try_to_decode(whole + more) is None
    assert try_to_decode(seal(whole[:-4] + more)) is None


@given(senders_and_contents(), st.integers(0, 255).filter(lambda version: version != VERSION))
def test_another_version_is_told(spoken: tuple[Sender, Content], version: int) -> None:
    whole = bytearray(CODEC.encode(spoken[1], sender=spoken[0], number=1)[:-4])
    whole[2] = version
    with pytest.raises(CodecError) as raised:
        CODEC.decode(seal(bytes(whole)))
    assert raised.value.cause is Drop.VERSION


@given(senders_and_contents(), st.binary(min_size=16, max_size=16).filter(lambda digest: digest != DIGEST))
def test_another_mission_is_told(spoken: tuple[Sender, Content], digest: bytes) -> None:
    stranger = Codec(digest, agents=AGENTS, landmarks=LANDMARKS)
    with pytest.raises(CodecError) as raised:
        CODEC.decode(stranger.encode(spoken[1], sender=spoken[0], number=1))
    assert raised.value.cause is Drop.MISSION

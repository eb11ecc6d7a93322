"""The lock's table: complete, sane, and the same as in the documentation."""

from __future__ import annotations

from pathlib import Path

import pytest

from covey.protocol import TRANSITIONS, Lock, ProtocolError, Trigger, next_state
from covey.protocol.state import diagram, table


def test_each_row_is_there_once_and_followed() -> None:
    assert len({(row.source, row.trigger) for row in TRANSITIONS}) == len(TRANSITIONS)
    assert all(next_state(row.source, row.trigger) is row.target for row in TRANSITIONS)
    assert {row.trigger for row in TRANSITIONS} == set(Trigger)


def test_every_state_is_entered_and_left() -> None:
    assert {row.source for row in TRANSITIONS} == {row.target for row in TRANSITIONS} == set(Lock)


def test_any_other_move_is_a_mistake() -> None:
    known = {(row.source, row.trigger) for row in TRANSITIONS}
    for lock in Lock:
        for trigger in Trigger:
            if (lock, trigger) not in known:
                with pytest.raises(ProtocolError, match=lock.value):
                    next_state(lock, trigger)


def leaving(lock: Lock) -> set[str]:
    """What leads out of a state: a message, or a trigger without one."""
    return {row.receives or row.trigger.value for row in TRANSITIONS if row.source is lock}


def test_a_server_never_gives_up_on_a_client_that_lives() -> None:
    assert leaving(Lock.SERVER_PREPARED) == {"COMMIT", "ABORT", Trigger.PARTNER_DEAD.value}


def test_a_client_gives_up_only_before_the_commit() -> None:
    assert leaving(Lock.CLIENT_DONE) == {"ACK", Trigger.PARTNER_DEAD.value}


def test_the_documentation_shows_this_table(root: Path) -> None:
    text = (root / "docs" / "protocol.md").read_text("utf-8")
    assert diagram() in text
    assert table() in text

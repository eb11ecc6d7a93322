"""When a link is taken not to lead both ways."""

from __future__ import annotations

import numpy as np
import pytest

from covey.protocol import Sender
from covey.transports.links import LONGEST_PAUSE, RENEW_PAUSE, Links

LEASE, SILENCE, BEAT = 2.0, 3.0, 0.25
RED, AGAIN = Sender(1, 1), Sender(1, 2)


class Life:
    """What is heard and seen of the others, over time; tokens stay until they are lost."""

    def __init__(self) -> None:
        self.links = Links(LEASE, SILENCE)
        self.now = 0.0

    def pass_by(
        self,
        seconds: float,
        *,
        heard: Sender | None = None,
        every: float = BEAT,
        there: Sender | None = None,
        lost: Sender | None = None,
    ) -> list[float]:
        """Let time pass; return when the session was renewed meanwhile."""
        renewed, due = [], self.now
        for _ in np.arange(0.0, seconds, BEAT):
            self.now += BEAT
            if there is not None:
                self.links.see(there, present=True)
            if lost is not None:
                self.links.see(lost, present=False)
            if heard is not None and self.now >= due:
                self.links.hear(heard, self.now)
                due = self.now + every
            if self.links.must_renew(self.now):
                renewed.append(self.now)
        return renewed


@pytest.fixture
def life() -> Life:
    return Life()


def test_the_token_of_the_newest_life_counts() -> None:
    links = Links(LEASE, SILENCE)
    links.see(AGAIN, present=True)
    links.see(RED, present=False)
    assert links.peers == {AGAIN}
    assert links.suspects == frozenset()
    links.see(AGAIN, present=False)
    assert links.peers == frozenset()
    assert links.suspects == {AGAIN}


@pytest.mark.parametrize("lost", [RED, None])
def test_who_is_heard_for_a_lease_without_a_token_is_a_reason(life: Life, lost: Sender | None) -> None:
    if lost is not None:
        assert life.pass_by(20.0, heard=RED, there=RED) == []
    begin = life.now
    assert life.pass_by(LEASE, heard=RED, lost=lost) == []
    assert life.pass_by(BEAT, heard=RED, lost=lost) == [begin + LEASE + BEAT]
    assert life.links.peers == life.links.suspects == frozenset(), "the new session begins with nothing"


def test_who_falls_silent_while_its_token_stays_is_a_reason(life: Life) -> None:
    assert life.pass_by(20.0, heard=RED, there=RED) == []
    assert life.pass_by(SILENCE + LEASE - BEAT, there=RED) == []
    assert life.pass_by(BEAT, there=RED) == [20.0 + SILENCE + LEASE]


def test_who_dies_or_was_never_heard_is_none(life: Life) -> None:
    assert life.pass_by(20.0, there=RED) == []
    assert life.pass_by(20.0, heard=RED, there=RED) == []
    assert life.pass_by(0.5 * LEASE, heard=RED, lost=RED) == [], "its last words"
    assert life.pass_by(100.0, lost=RED) == []


def test_a_token_that_comes_late_is_none(life: Life) -> None:
    assert life.pass_by(LEASE, heard=RED) == []
    assert life.pass_by(20.0, heard=RED, there=RED) == []


@pytest.mark.parametrize("every", [0.5 * LEASE, 0.9 * SILENCE])
def test_who_speaks_seldom_is_none(life: Life, every: float) -> None:
    assert life.pass_by(200.0, heard=RED, every=every, there=RED) == []
    assert len(life.pass_by(2.0 * SILENCE + LEASE, heard=RED, every=every, lost=RED)) == 1


def test_who_computes_for_less_than_it_may_be_silent_is_none(life: Life) -> None:
    for _ in range(10):
        assert life.pass_by(5.0, heard=RED, there=RED) == []
        assert life.pass_by(SILENCE, there=RED) == []


def test_a_new_life_begins_from_nothing(life: Life) -> None:
    assert life.pass_by(20.0, heard=RED, there=RED) == []
    assert life.pass_by(100.0, there=AGAIN) == [], "it has not begun to speak"
    assert life.pass_by(LEASE, heard=RED, there=AGAIN) == [], "what the old life said came late"
    assert life.pass_by(20.0, heard=AGAIN, there=AGAIN) == []
    assert len(life.pass_by(SILENCE + LEASE, there=AGAIN)) == 1


def test_a_token_of_an_older_life_is_not_the_token_of_who_is_heard(life: Life) -> None:
    assert len(life.pass_by(LEASE + BEAT, heard=AGAIN, there=RED)) == 1


def test_renewing_that_does_not_help_is_done_ever_more_rarely(life: Life) -> None:
    renewed = life.pass_by(4.0 * LONGEST_PAUSE * RENEW_PAUSE * LEASE, heard=RED)
    pauses = np.diff(renewed)
    assert len(pauses) > 5
    assert pauses[0] >= RENEW_PAUSE * LEASE
    assert pauses[1] >= 2.0 * RENEW_PAUSE * LEASE
    assert (np.diff(pauses) >= 0.0).all()
    assert pauses[-1] <= (LONGEST_PAUSE * RENEW_PAUSE + 1.0) * LEASE
    assert life.pass_by(1000.0, heard=RED, there=RED) == []
    first, second = life.pass_by(2.0 * RENEW_PAUSE * LEASE + 2.0 * LEASE, heard=RED, lost=RED)
    assert second - first < 3.0 * RENEW_PAUSE * LEASE, "it helped in between"


def test_what_failed_is_tried_again_a_lease_later(life: Life) -> None:
    assert len(life.pass_by(LEASE + BEAT, heard=RED)) == 1
    failed = life.now
    life.links.try_again(failed)
    assert life.pass_by(10.0 * LEASE) == [failed + LEASE], "and the second time it did not fail"

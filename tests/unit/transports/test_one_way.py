"""When a link is taken not to lead both ways."""

from __future__ import annotations

import numpy as np
import pytest

from covey.protocol import Sender
from covey.transports.one_way import RENEW_PAUSE, OneWayLinks

LEASE, BEAT = 2.0, 0.25
RED = Sender(1, 1)
PRESENT, LOST = {1: (1, True)}, {1: (1, False)}


class Life:
    """A link's two sides of the news, over time."""

    def __init__(self) -> None:
        self.links = OneWayLinks(LEASE)
        self.now = 0.0
        self.renewed: list[float] = []

    def pass_by(
        self, seconds: float, tokens: dict[int, tuple[int, bool]], *, heard: Sender | None = None
    ) -> list[float]:
        """Let time pass; return when the session was renewed meanwhile."""
        before = len(self.renewed)
        for _ in np.arange(0.0, seconds, BEAT):
            self.now += BEAT
            if heard is not None:
                self.links.hear(heard, self.now)
            if self.links.must_renew(tokens, self.now):
                self.renewed.append(self.now)
        return self.renewed[before:]


@pytest.fixture
def life() -> Life:
    return Life()


@pytest.mark.parametrize("tokens", [LOST, {}, {2: (1, True)}])
def test_who_is_heard_for_a_lease_without_a_token_is_a_reason(life: Life, tokens: dict[int, tuple[int, bool]]) -> None:
    assert life.pass_by(20.0, PRESENT, heard=RED) == []
    assert life.pass_by(LEASE, tokens, heard=RED) == []
    assert life.pass_by(BEAT, tokens, heard=RED) == [20.0 + LEASE + BEAT]


def test_who_falls_silent_while_its_token_stays_is_a_reason(life: Life) -> None:
    assert life.pass_by(20.0, PRESENT, heard=RED) == []
    assert life.pass_by(2.0 * LEASE - BEAT, PRESENT) == []
    assert life.pass_by(BEAT, PRESENT) == [20.0 + 2.0 * LEASE]


def test_who_dies_or_was_never_heard_is_none(life: Life) -> None:
    assert life.pass_by(20.0, PRESENT) == []
    assert life.pass_by(20.0, PRESENT, heard=RED) == []
    assert life.pass_by(0.5 * LEASE, LOST, heard=RED) == [], "its last words"
    assert life.pass_by(100.0, LOST) == []


def test_a_token_that_comes_late_or_a_word_in_time_is_none(life: Life) -> None:
    assert life.pass_by(LEASE, LOST, heard=RED) == []
    for _ in range(10):
        assert life.pass_by(1.5 * LEASE, PRESENT) == []
        assert life.pass_by(BEAT, PRESENT, heard=RED) == []


def test_a_new_life_begins_from_nothing(life: Life) -> None:
    again = {1: (2, True)}
    assert life.pass_by(20.0, PRESENT, heard=RED) == []
    assert life.pass_by(100.0, again) == [], "it has not begun to speak"
    assert life.pass_by(LEASE, again, heard=RED) == [], "what the old life said came late"
    assert life.pass_by(20.0, again, heard=Sender(1, 2)) == []
    assert len(life.pass_by(2.0 * LEASE, again)) == 1


def test_a_token_of_an_older_life_is_not_the_token_of_who_is_heard(life: Life) -> None:
    assert len(life.pass_by(LEASE + BEAT, PRESENT, heard=Sender(1, 2))) == 1


def test_a_session_that_is_no_better_is_renewed_at_long_intervals(life: Life) -> None:
    renewed = life.pass_by(40.0 * LEASE, LOST, heard=RED)
    assert len(renewed) > 3
    assert np.diff(renewed).min() >= RENEW_PAUSE * LEASE


def test_what_failed_is_tried_again_a_lease_later(life: Life) -> None:
    assert len(life.pass_by(LEASE + BEAT, LOST, heard=RED)) == 1
    failed = life.now
    life.links.try_again(failed)
    assert life.pass_by(10.0 * LEASE, LOST) == [failed + LEASE], "and the second time it did not fail"

"""When a link is taken to lead one way only."""

from __future__ import annotations

import numpy as np
import pytest

from covey.transports.one_way import RENEW_PAUSE, OneWayLinks

LEASE = 2.0


@pytest.fixture
def links() -> OneWayLinks:
    return OneWayLinks(LEASE)


def hear(links: OneWayLinks, begin: float, end: float, *, token: bool, agent: int = 1) -> None:
    """Let heartbeats come four times a second."""
    for now in np.arange(begin, end + 1e-9, 0.25):
        links.hear(agent, float(now), token=token)


def test_who_is_heard_for_a_lease_without_a_token_is_a_reason(links: OneWayLinks) -> None:
    hear(links, 0.0, LEASE - 0.25, token=False)
    assert not links.must_renew(LEASE - 0.25)
    links.hear(1, LEASE, token=False)
    assert links.must_renew(LEASE)
    assert not links.must_renew(LEASE), "the caller has renewed it"


def test_a_token_that_comes_late_is_none(links: OneWayLinks) -> None:
    hear(links, 0.0, LEASE - 0.25, token=False)
    links.hear(1, LEASE, token=True)
    hear(links, LEASE + 0.25, 2.0 * LEASE, token=False)
    assert not links.must_renew(2.0 * LEASE)


def test_the_last_words_of_the_dead_are_none(links: OneWayLinks) -> None:
    hear(links, 0.0, 0.5, token=False)
    assert not links.must_renew(100.0)
    links.hear(1, 100.0, token=False)
    assert not links.must_renew(100.0), "it was not heard in between"


def test_several_are_told_apart(links: OneWayLinks) -> None:
    for agent, now in enumerate(np.arange(0.0, 2.0 * LEASE, 0.25)):
        links.hear(agent, float(now), token=False)
    assert not links.must_renew(2.0 * LEASE)
    begin = 3.0 * LEASE
    hear(links, begin, begin + LEASE, token=True, agent=1)
    hear(links, begin, begin + LEASE, token=False, agent=2)
    assert links.must_renew(begin + LEASE)


def test_a_session_that_is_no_better_is_renewed_at_long_intervals(links: OneWayLinks) -> None:
    renewed = []
    for now in np.arange(0.0, 40.0 * LEASE, 0.25):
        links.hear(1, float(now), token=False)
        if links.must_renew(float(now)):
            renewed.append(float(now))
    assert renewed[0] == LEASE
    assert np.diff(renewed).min() >= RENEW_PAUSE * LEASE


def test_what_failed_is_tried_again_a_lease_later(links: OneWayLinks) -> None:
    hear(links, 0.0, LEASE, token=False)
    assert links.must_renew(LEASE)
    links.try_again(LEASE + 0.5)
    assert not links.must_renew(2.0 * LEASE)
    assert links.must_renew(2.0 * LEASE + 0.5)
    assert not links.must_renew(100.0 * LEASE), "this time it did not fail"

"""The mailbox between those who watch a run and the run."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import pytest

from covey.errors import ArgumentError
from covey.runtime.watching.feed import Scene, Update
from covey.runtime.watching.steering import (
    COMMANDS,
    WAITING,
    AddObstacle,
    Command,
    Kill,
    Pause,
    Resume,
    SetLoss,
    SetSpeed,
    Steering,
    Step,
)


class Clock:
    """A clock that runs only while somebody waits."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 100.0
        self.glances = 0
        self.at: dict[int, Callable[[], object]] = {}
        monkeypatch.setattr(time, "monotonic", lambda: self.now)
        monkeypatch.setattr(threading.Condition, "wait", self._wait)

    def _wait(self, timeout: float) -> bool:
        assert timeout > 0.0
        self.now += timeout
        return False

    def idle(self) -> None:
        self.glances += 1
        assert self.glances < 10_000
        self.at.get(self.glances, lambda: None)()


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


class Run:
    """A run of 1/8 s a step."""

    def __init__(self, clock: Clock, *, speed: float = 0.0) -> None:
        self.progress = 0.0
        self.clock = clock
        self.refused: list[str] = []
        self.steering = Steering(speed=speed)
        self.steering.measure(lambda: self.progress, 0.5)

    def go(self, steps: int) -> None:
        for _ in range(steps):
            self.progress += 0.125
            self.steering.hold(self.clock.idle)

    def ask(self, command: Command) -> None:
        self.steering.ask(command, self.refused.append)


def test_a_run_that_nobody_steers_never_waits(clock: Clock) -> None:
    Run(clock).go(100)
    assert (clock.now, clock.glances) == (100.0, 0)


def test_speed_is_progress_a_second(clock: Clock) -> None:
    run = Run(clock, speed=2.0)
    run.go(101)
    assert clock.now - 100.0 == pytest.approx(12.5 / 2.0, abs=0.06)
    run.ask(SetSpeed(0.5))
    begun = clock.now
    run.go(101)
    assert clock.now - begun == pytest.approx(12.5 / 0.5, abs=0.3)
    run.ask(SetSpeed(0.0))
    begun = clock.now
    run.go(100)
    assert clock.now == begun


def test_a_run_that_cannot_keep_up_does_not_hurry_afterwards(clock: Clock) -> None:
    run = Run(clock, speed=1.0)
    run.go(1)
    clock.now += 60.0
    run.go(1)
    begun = clock.now
    run.go(50)
    assert clock.now - begun == pytest.approx(6.25, abs=0.2)


def test_paused_until_resumed(clock: Clock) -> None:
    run = Run(clock)
    clock.at[20] = lambda: run.ask(Resume())
    run.ask(Pause())
    assert run.steering.pace.paused
    run.go(10)
    assert clock.glances == 20
    assert not run.steering.pace.paused


def test_a_step_lets_one_stride_pass(clock: Clock) -> None:
    run = Run(clock)
    seen: list[float] = []

    def step() -> None:
        seen.append(run.progress)
        run.ask(Step())

    clock.at |= {5: step, 10: step, 15: lambda: seen.append(run.progress), 16: lambda: run.ask(Resume())}
    run.ask(Pause())
    run.go(30)
    assert seen == [0.125, 0.625, 1.125]


def test_steps_asked_for_at_once_add_up(clock: Clock) -> None:
    run = Run(clock)
    seen: list[float] = []

    def steps() -> None:
        for _ in range(3):
            run.ask(Step())

    clock.at |= {1: steps, 5: lambda: seen.append(run.progress), 6: lambda: run.ask(Resume())}
    run.ask(Pause())
    run.go(30)
    assert seen == [1.625]


def test_what_is_to_be_done_ends_the_waiting(clock: Clock) -> None:
    run = Run(clock)
    run.steering.offer(Kill)
    clock.at[3] = lambda: run.ask(Kill(2))
    run.ask(Pause())
    run.go(1)
    (request,) = run.steering.take()
    assert request.command == Kill(2)
    assert run.steering.take() == []
    assert run.steering.pace.paused


def test_what_a_run_does_not_offer_is_refused(clock: Clock) -> None:
    run = Run(clock)
    run.steering.offer(SetLoss, AddObstacle)
    assert run.steering.commands == ("pause", "resume", "step", "speed", "obstacle", "loss")
    with pytest.raises(ArgumentError, match="does not carry it out"):
        run.ask(Kill(0))
    with pytest.raises(ArgumentError, match="speed: expected at least 0"):
        run.ask(SetSpeed(-1.0))
    for _ in range(WAITING):
        run.ask(SetLoss(0.1))
    with pytest.raises(ArgumentError, match="earlier ones"):
        run.ask(SetLoss(0.1))
    assert len(run.steering.take()) == WAITING


def test_ctrl_c_ends_the_waiting(clock: Clock) -> None:
    run = Run(clock)
    run.ask(Pause())

    def interrupt() -> None:
        raise KeyboardInterrupt

    clock.at[4] = interrupt
    with pytest.raises(KeyboardInterrupt):
        run.go(1)


def test_changes_are_counted_and_passed_on() -> None:
    from covey.playground.sample import sample_feed

    told: list[Scene | Update] = []
    steering = Steering()
    watch = steering.counting(told.append)
    feed = list(sample_feed(seconds=5.0))
    for item in feed:
        watch(item)
    assert told == feed
    assert {command.__name__ for command in COMMANDS.values()} >= {"Pause", "Kill"}


def test_commands_wake_a_run_in_another_thread() -> None:
    steering = Steering()
    steering.ask(Pause(), print)
    thread = threading.Thread(target=steering.hold, args=(lambda: None,))
    thread.start()
    steering.ask(Resume(), print)
    thread.join(20.0)
    assert not thread.is_alive()

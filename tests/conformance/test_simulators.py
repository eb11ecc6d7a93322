"""The conformance suite for simulators, over both of them; and simulators with one fault, which it must find."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from covey.flight.layout import OBSERVATION, QUAT, P, V
from covey.simulators.mujoco import MujocoSimulator
from covey.simulators.reference import ReferenceSimulator
from covey.testing.simulators import CHECKS, MakeSimulator, check_simulator


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("make", [ReferenceSimulator, MujocoSimulator])
def test_a_simulator_conforms(make: MakeSimulator, check: Callable[[MakeSimulator], None]) -> None:
    check(make)


class HandsOutItsState(ReferenceSimulator):
    @property
    def state(self) -> Any:
        return self._state


class LosesTime(ReferenceSimulator):
    def step(self, commands: Any, duration: float) -> None:
        super().step(commands, 0.01)


class TurnsTheOtherWay(ReferenceSimulator):
    def step(self, commands: Any, duration: float) -> None:
        commands = np.array(commands, dtype=np.float64)
        if commands.ndim == 2 and commands.shape[1] == 4:
            commands[:, 3] *= -1.0
        super().step(commands, duration)


class IsNed(ReferenceSimulator):
    """Thinks that y points right."""

    def step(self, commands: Any, duration: float) -> None:
        before = self._state[:, V + 1].copy()
        super().step(commands, duration)
        self._state[:, V + 1] = before - (self._state[:, V + 1] - before)


class KeepsItsMotors(ReferenceSimulator):
    def fail_motor(self, vehicle: int, rotor: int) -> None:
        super().fail_motor(vehicle, rotor)
        self._working[vehicle, rotor] = 0.9


class TellsTwice(ReferenceSimulator):
    @property
    def collisions(self) -> Any:
        return tuple(super().collisions) * 2


class ForgetsWhereItWas(ReferenceSimulator):
    def add_obstacle(self, obstacle: Any) -> int:
        self._state[:, V] = 0.0
        self._state[:, P] += 0.1
        return super().add_obstacle(obstacle)


class SeesNoSpheresMove(ReferenceSimulator):
    def move_obstacle(self, index: int, position_W: Any) -> None:
        super().move_obstacle(index, self._obstacles[index].center_W)  # type: ignore[union-attr]


class FeelsItsNoise(ReferenceSimulator):
    def observe(self) -> Any:
        seen = super().observe()
        self._state[:, :QUAT] = seen[:, :QUAT]
        return seen


class ObservesExactly(ReferenceSimulator):
    def observe(self) -> Any:
        return self._state[:, :OBSERVATION].copy()


class RollsDice(ReferenceSimulator):
    def step(self, commands: Any, duration: float) -> None:
        super().step(commands, duration)
        self._state[:, P] += 1e-9 * np.random.default_rng().standard_normal()


class KnowsOneVehicle(ReferenceSimulator):
    def __init__(self, vehicles: Any, *arguments: Any, **options: Any) -> None:
        super().__init__(vehicles, *arguments, **options)
        self._rows[:] = self._rows[0]


class BlowsUpwind(ReferenceSimulator):
    def _blow(self, duration: float) -> None:
        super()._blow(duration)
        self._air = -self._air


@pytest.mark.parametrize(
    "make",
    [
        HandsOutItsState,
        LosesTime,
        TurnsTheOtherWay,
        IsNed,
        KeepsItsMotors,
        TellsTwice,
        ForgetsWhereItWas,
        SeesNoSpheresMove,
        FeelsItsNoise,
        ObservesExactly,
        RollsDice,
        KnowsOneVehicle,
        BlowsUpwind,
    ],
)
def test_a_faulty_simulator_is_found(make: MakeSimulator) -> None:
    with pytest.raises(AssertionError):
        check_simulator(make)

"""What recording costs: CPU time of telling and writing beside that of the flight, and the size of the file.

What telling takes in a flight, and what the thread that writes takes, are measured in that flight, and compared with
all else that it takes: two flights differ by more than that.  Then ten minutes of sixteen vehicles whose motions are
random numbers, so that nothing of them can be compressed.
"""

from __future__ import annotations

import io
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from covey.mission import load_mission
from covey.runtime.agent import build_models
from covey.runtime.fly import fly
from covey.runtime.records.mcap_reader import Record
from covey.runtime.records.mcap_record import Recorder, RecordFile
from covey.runtime.watching.feed import POSE, Motion, Run, Scene, TeamState, Update
from covey.runtime.watching.telling import MOTION_EVERY, TeamTeller, describe, pose_rows

EXAMPLES = Path(__file__).parents[1] / "examples"
TEN_MINUTES = 600.0


class Stopwatch:
    """Adds up the CPU time that calls of methods take on their threads, those within one another once."""

    def __init__(self) -> None:
        self.spent_s = 0.0
        self._depth = threading.local()

    def watch(self, stack: ExitStack, kind: type, *names: str) -> None:
        """From now on measure these methods, until the stack is left."""
        for name in names:
            stack.enter_context(patch.object(kind, name, self._timed(getattr(kind, name))))

    def _timed(self, method: Callable[..., object]) -> Callable[..., object]:
        def timed(*arguments: Any, **options: Any) -> object:
            if getattr(self._depth, "inside", False):
                return method(*arguments, **options)
            self._depth.inside = True
            begun = time.thread_time()
            try:
                return method(*arguments, **options)
            finally:
                self.spent_s += time.thread_time() - begun
                self._depth.inside = False

        return timed


TOLD = ("begin", "changed", "acted", "motion", "note", "end", "state", "change", "tell", "count")
"""All by which a flight tells something."""


def flight(name: str, rounds: int) -> dict[str, Any]:
    """Fly a mission with a recorder; the median of some rounds counts."""
    mission = load_mission(EXAMPLES / f"{name}.yaml")
    duration = float(fly(mission).log.time[-1])
    found = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "record.mcap"
        for _ in range(rounds):
            telling, writing = Stopwatch(), Stopwatch()
            path.unlink(missing_ok=True)
            with ExitStack() as stack:
                telling.watch(stack, TeamTeller, *TOLD)
                writing.watch(stack, RecordFile, "write", "finish")
                begun = time.process_time()
                with Recorder(path) as recorder:
                    fly(mission, watch=recorder)
                cpu = time.process_time() - begun
            rest = cpu - telling.spent_s - writing.spent_s
            found.append((cpu, 100.0 * telling.spent_s / rest, 100.0 * writing.spent_s / rest))
        size = path.stat().st_size
        begun = time.perf_counter()
        with Record(path) as record:
            read = sum(1 for _ in record.items())
        reading = time.perf_counter() - begun
    cpu, told, written = (float(value) for value in np.median(found, axis=0))
    return {
        "mission": name,
        "vehicles": len(mission.agents),
        "flight_s": duration,
        "cpu_s": cpu,
        "cost_percent": told + written,
        "telling_percent": told,
        "writing_percent": written,
        "megabytes_in_ten_minutes": size * TEN_MINUTES / duration / 1e6,
        "items": read,
        "reading_s": reading,
    }


def ten_minutes() -> dict[str, Any]:
    """Write ten minutes of sixteen vehicles that never rest: positions and attitudes that compress as badly as any."""
    mission = load_mission(EXAMPLES / "sixteen-agents.yaml")
    n, m = len(mission.landmarks), len(mission.agents)
    scene = describe(mission, build_models(mission), run=Run.FLIGHT, software={}, body_radius=0.3)
    rng = np.random.default_rng(0)
    poses = pose_rows([agent.pose for agent in mission.agents], np.ones(m))
    nobody = np.empty(0, dtype=np.int32)
    owner, activity = np.zeros(n, dtype=np.int32), np.zeros(m, dtype=np.uint8)
    state = TeamState(0.0, owner, poses, np.zeros(m), scene.weights, activity, nobody, 0, np.nan)
    items: list[Scene | Update] = [scene, state]
    for index in range(round(TEN_MINUTES / MOTION_EVERY)):
        rows, values = rng.normal(size=(m, POSE)), rng.normal(size=(2, m, 3))
        score, apart = rng.random(2).tolist()
        items.append(Motion(index * MOTION_EVERY, rows, values[0], values[1], np.empty((0, 3)), score, apart))
    stream = io.BytesIO()
    cpu = write(items, stream)
    return {"cpu_s": cpu, "megabytes": len(stream.getvalue()) / 1e6}


def write(items: list[Scene | Update], stream: io.BytesIO | None = None) -> float:
    """Return the CPU time that writing items takes, seconds."""
    begun = time.process_time()
    file = RecordFile(stream or io.BytesIO())
    for item in items:
        file.write(item)
    file.finish()
    return time.process_time() - begun


def run(quick: bool) -> dict[str, Any]:
    """Measure."""
    found = flight("thesis-5.1", 2) if quick else flight("sixteen-agents", 3)
    return {"flight": found, "ten_minutes_of_sixteen": ten_minutes()}

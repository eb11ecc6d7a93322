"""What recording costs: CPU time of telling and writing beside that of the flight, and the size of the file.

A flight with a `Recorder` and one without a watcher take turns, and the least CPU time of each counts; it includes the
thread that writes.  What that thread alone takes is measured by writing the same items again.  Then ten minutes of
sixteen vehicles whose motions are random numbers, so that nothing of them can be compressed.
"""

from __future__ import annotations

import io
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from covey.mission import load_mission
from covey.runtime.agent import build_models
from covey.runtime.fly import fly
from covey.runtime.records.mcap_reader import Record
from covey.runtime.records.mcap_record import Recorder, RecordFile
from covey.runtime.watching.feed import POSE, Motion, Run, Scene, TeamState, Update
from covey.runtime.watching.telling import MOTION_EVERY, describe, pose_rows

EXAMPLES = Path(__file__).parents[1] / "examples"
TEN_MINUTES = 600.0


def flight(name: str, rounds: int) -> dict[str, Any]:
    """Fly a mission with and without a recorder."""
    mission = load_mission(EXAMPLES / f"{name}.yaml")
    items: list[Scene | Update] = []
    duration = fly(mission, watch=items.append).log.time[-1]
    plain, recorded = [], []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "record.mcap"
        for _ in range(rounds):
            begun = time.process_time()
            fly(mission)
            plain.append(time.process_time() - begun)
            path.unlink(missing_ok=True)
            begun = time.process_time()
            with Recorder(path) as recorder:
                fly(mission, watch=recorder)
            recorded.append(time.process_time() - begun)
        size = path.stat().st_size
        begun = time.perf_counter()
        with Record(path) as record:
            read = sum(1 for _ in record.items())
        reading = time.perf_counter() - begun
    writing = min(write(items) for _ in range(3))
    scale = TEN_MINUTES / duration
    return {
        "mission": name,
        "vehicles": len(mission.agents),
        "flight_s": float(duration),
        "cpu_s": min(plain),
        "cpu_recorded_s": min(recorded),
        "cost_percent": 100.0 * (min(recorded) / min(plain) - 1.0),
        "writing_percent": 100.0 * writing / min(plain),
        "megabytes_in_ten_minutes": size * scale / 1e6,
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

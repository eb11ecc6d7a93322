"""Proves an agent's pose beside its other work."""

from __future__ import annotations

import threading
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from covey.geometry import Pose2
from covey.mission import Mission
from covey.optimize import Exact, PoseProblem, PoseResult
from covey.protocol import coverage_score
from covey.runtime.agent import LEAST_GAIN, TeamPlanner
from covey.runtime.streams import Stream, generator


class Prover:
    """Looks for a pose that is better than an agent's by more than counts, or proves that there is none.

    Parameters
    ----------
    mission : Mission
    agent : int
    planner : TeamPlanner

    Notes
    -----
    One proof at a time, on a thread of its own; the compiled kernels leave the interpreter to others.
    """

    def __init__(self, mission: Mission, agent: int, planner: TeamPlanner) -> None:
        self.epoch: int | None = None
        """The epoch of the node whose pose is being proved, or has been; None after `result` or `cancel`."""
        self._mission = mission
        self._agent = agent
        self._planner = planner
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="proof")
        self._stop = threading.Event()
        self._future: Future[PoseResult | None] | None = None
        self._score = 0.0

    @property
    def busy(self) -> bool:
        """Whether a proof is going on."""
        return self._future is not None and not self._future.done()

    def begin(self, epoch: int, pose: Pose2, landmarks: NDArray[np.int64]) -> None:
        """Begin to prove a pose for these landmarks."""
        self.cancel()
        self.epoch = epoch
        self._score = coverage_score(self._planner, self._agent, pose, landmarks)
        self._stop = stop = threading.Event()
        planner = self._planner  # what it knows of landmarks and regions may change while the proof goes on
        region = planner.regions[self._agent]
        problem = PoseProblem(planner.models[self._agent], planner.landmarks.subset(landmarks), region)
        self._future = self._pool.submit(self._prove, problem, pose, stop)

    def result(self) -> tuple[int, Pose2 | None]:
        """Wait for the proof; return its epoch, and a pose that is better if there is one."""
        assert self._future is not None
        assert self.epoch is not None
        result, epoch = self._future.result(), self.epoch
        self._future, self.epoch = None, None
        better = result is not None and result.score > self._score + LEAST_GAIN * self._mission.coverage.sigma
        return epoch, result.pose if result is not None and better else None

    def cancel(self) -> None:
        """Give a proof up."""
        self._stop.set()
        self._future, self.epoch = None, None

    def close(self) -> None:
        """Give everything up, and let the thread end."""
        self.cancel()
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _prove(self, problem: PoseProblem, pose: Pose2, stop: threading.Event) -> PoseResult | None:
        if not len(problem.landmarks) or stop.is_set():
            return None  # every pose is as good (V11)
        region = problem.region
        return Exact(cancelled=stop.is_set).maximize(
            problem,
            start=pose if region.contains(pose.x, pose.y) else None,
            tolerance=0.5 * self._mission.coverage.sigma,
            rng=generator(self._mission.seed, Stream.PROOF, self._agent),
        )

"""What holds for every launch of real processes."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import numpy as np
from tests.unit.runtime.small import small

from covey.runtime.certify import certify
from covey.runtime.network.launch import Blow, LaunchReport
from covey.runtime.network.remote_agent import NETWORK_TIMES
from covey.runtime.result import Deployment, PlanStatus

LONGEST = 240.0
"""Seconds after which a launch is given up: much longer than it takes."""

LONG_ENOUGH = (Blow(0, 3.0, signal.SIGCONT),)
"""A signal that does nothing: until it has come, and some seconds more, the mission is not called over."""

UNOWNED = NETWORK_TIMES.dead_after + 2.0


def write_small(folder: Path) -> Path:
    """Write the file of a small mission."""
    file = folder / "small.json"
    file.write_text(json.dumps(small().source), "utf-8")
    return file


def check(deployment: Deployment, report: LaunchReport) -> None:
    """Check what holds for every launch that came to its end."""
    assert report.settled
    assert deployment.status is PlanStatus.SETTLED
    assert deployment.certificate is not None
    assert deployment.certificate.holds, deployment.certificate.violations
    assert certify(deployment).holds
    owned = np.concatenate([agent.landmarks for agent in deployment.agents])
    assert np.array_equal(np.sort(owned), np.arange(len(deployment.mission.landmarks)))
    said = [line for one in report.exits for line in one.stderr]
    assert not [line for line in said if "Traceback" in line or "Error" in line], said
    assert report.longest_unowned <= UNOWNED

"""Kernels are compiled by two processes the first time, and by none afterwards."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from covey.runtime import first_use


def test_the_process_beside_leaves_its_kernels_in_the_cache(tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-m", "covey.runtime.first_use"], env=environment, check=True)
    compiled = {path.name.partition("-")[0] for path in tmp_path.rglob("*.nbi")}
    assert {"ascent.climb_all", "branch_and_bound._branch"} <= compiled


@pytest.mark.parametrize(("there", "started"), [(True, 0), (False, 1)])
def test_it_is_started_only_where_nothing_was_ever_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, there: bool, started: int
) -> None:
    commands = []

    class Process:
        def __init__(self, command: list[str], **options: Any) -> None:
            commands.append(command)

        def terminate(self) -> None:
            commands.append(["end"])

        def wait(self) -> None:
            commands.append(["wait"])

    if there:
        (tmp_path / "a").mkdir()
        (tmp_path / "a" / "kernel.nbi").touch()
    monkeypatch.setattr("covey.compiled.cache_directory", lambda: str(tmp_path))
    monkeypatch.setattr("subprocess.Popen", Process)
    with first_use.compiling_beside():
        assert len(commands) == started
    assert commands[1:] == [["end"], ["wait"]] * started

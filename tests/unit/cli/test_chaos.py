"""``covey chaos``: what it prints, and how it ends."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time

import pytest

from covey.cli.main import main


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        main(["chaos", *arguments])
    printed = capsys.readouterr()
    return int(ended.value.code or 0), printed.out, printed.err


def test_a_protocol_that_holds(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(capsys, "--seeds", "20", "--seed-start", "40", "--quiet")
    assert (code, err) == (0, "")
    assert out.startswith("20 seeds, ")
    assert "violations: 0" in out
    assert "trades" in out


def test_a_mutant_that_is_caught_is_a_success(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "--seeds", "200", "--mutant", "no-adoption", "--jobs", "1", "--json")
    report = json.loads(out)
    assert code == 0
    assert report["violations"] >= 1
    first = report["first"]
    assert set(first) == {"seed", "invariant", "detail", "scenario", "trace"}
    assert first["invariant"] in first["trace"][-1]
    assert report["coverage"]["crashes"] > 0


def test_a_mutant_that_no_seed_shows_is_a_failure(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, "--seeds", "1", "--mutant", "server-gives-up")[0] == 1


def test_the_story_of_a_violation_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = run(capsys, "--seeds", "60", "--mutant", "commit-in-two-steps")
    assert "violates I2" in out
    assert "commits trade" in out
    assert "made small: Scenario(seed=" in out


@pytest.mark.parametrize("arguments", [("--seeds", "0"), ("--mutant", "perfect"), ("--seed-start", "-1"), ("extra",)])
def test_bad_usage(capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...]) -> None:
    assert run(capsys, *arguments)[0] == 2


def test_every_interleaving(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("covey.faults.SIZES", ((2, (1, 1)),))
    code, out, _ = run(capsys, "--explore", "quick")
    assert (code, out) == (0, "2 agents that open 1 + 1 trades: 1437 states, complete\n")
    code, out, _ = run(capsys, "--explore", "quick", "--json")
    assert code == 0
    assert json.loads(out)["explored"][0]["states"] == 1437
    code, out, _ = run(capsys, "--explore", "quick", "--mutant", "no-escrow")
    assert code == 0
    assert out.startswith("violates I2")


@pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX signals")
def test_ctrl_c_keeps_what_is_known() -> None:
    command = [sys.executable, "-m", "covey", "chaos", "--seeds", "1000000", "--json", "--jobs", "2"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        while "seeds" not in process.stderr.readline():
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=120)
    assert process.returncode == 130
    assert json.loads(out)["seeds"] > 0

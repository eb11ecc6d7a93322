from __future__ import annotations

import contextlib
import io
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

from covey.cli.main import main
from covey.cli.progress import ProgressLine
from covey.cli.summary import print_summary
from covey.coverage import TeamBound
from covey.coverage.certificate import Certificate
from covey.errors import CoveyError, SolverError
from covey.mission import Mission, OptimizerName, Trade
from covey.runtime.records import record
from covey.runtime.records.record import read_result, write_result
from covey.runtime.result import Deployment, PlanStatus, Progress
from covey.runtime.watching.feed import Watcher

MakeDeployment = Callable[..., Deployment]

MISSION = """
schema_version: 1
name: small
seed: 3
environment:
  landmarks: {grid: {x_m: [-2, 2], y_m: [-2, 2], spacing_m: 1}}
  region: {box: {x_m: [-2, 2], y_m: [-2, 2]}}
agents:
  - {name: a, pose: {x_m: 1, y_m: 0, yaw_deg: 0}}
"""


PROVED = Certificate(True, 0.01, 0.002, 0.0)


class Ended(NamedTuple):
    code: int
    out: str
    err: str


Run = Callable[..., Ended]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run the command in an empty directory that holds `mission.yaml`."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    (tmp_path / "mission.yaml").write_text(MISSION)

    def run_command(*arguments: str) -> Ended:
        with pytest.raises(SystemExit) as leaving:
            main(list(arguments))
        out, err = capsys.readouterr()
        assert "Traceback" not in err
        return Ended(int(leaving.value.code or 0), out, err)

    return run_command


@pytest.fixture
def asked(make_deployment: MakeDeployment, monkeypatch: pytest.MonkeyPatch) -> list[tuple[Mission, dict[str, Any]]]:
    """Stand in for planning; returns what it was asked for."""
    asked: list[tuple[Mission, dict[str, Any]]] = []

    def plan(
        mission: Mission, *, on_progress: Callable[[Progress], None], watch: Watcher, steering: None, **options: Any
    ) -> Deployment:
        assert callable(watch)
        assert steering is None
        asked.append((mission, options))
        on_progress(Progress("trading", 12.345, 1, 5))
        return make_deployment(seed=mission.seed, certificate=PROVED)

    monkeypatch.setitem(sys.modules, "covey.runtime.plan", SimpleNamespace(plan=plan))
    return asked


def test_plan_writes_and_says_where(run: Run, asked: list[tuple[Mission, dict[str, Any]]]) -> None:
    ended = run("plan", "mission.yaml")
    assert ended.code == 0
    assert "covey-out/small-3" in ended.out
    assert "8.40 (start)" in ended.out
    assert "trading: score 12.35, 1 trade, 5 messages" in ended.err
    assert read_result("covey-out/small-3").seed == 3
    assert run("plan", "mission.yaml").out.count("covey-out/small-3-2") == 1
    assert asked[0][1] == {"trade": None, "optimizer": None, "bound": False, "baseline": False}


def test_plan_passes_its_options_on(run: Run, asked: list[tuple[Mission, dict[str, Any]]]) -> None:
    options = ("--seed", "9", "--trade", "thesis", "--optimizer", "differential-evolution", "--bound", "--baseline")
    assert run("plan", "mission.yaml", "--out", "r", *options).code == 0
    mission, passed = asked[0]
    assert mission.seed == 9
    assert passed == {
        "trade": Trade.THESIS,
        "optimizer": OptimizerName.DIFFERENTIAL_EVOLUTION,
        "bound": True,
        "baseline": True,
    }


@pytest.mark.usefixtures("asked")
def test_json_is_the_file_and_nothing_else(run: Run) -> None:
    ended = run("plan", "mission.yaml", "--out", "r", "--json", "--quiet")
    assert ended.out == Path("r/result.json").read_text(encoding="utf-8")
    assert ended.err == ""
    assert run("plan", "mission.yaml", "--out", "q", "--quiet") == (0, "", "")


def test_a_taken_directory_is_refused_before_planning(
    run: Run, asked: list[tuple[Mission, dict[str, Any]]], tmp_path: Path
) -> None:
    (tmp_path / "r").mkdir()
    (tmp_path / "r" / "notes.txt").write_text("mine")
    ended = run("plan", "mission.yaml", "--out", "r")
    assert ended.code == 2
    assert "covey: r: is not empty" in ended.err
    assert asked == []
    assert run("plan", "mission.yaml", "--out", "r", "--force", "--quiet").code == 0
    assert run("plan", "mission.yaml", "--out", "r", "--force", "--quiet").code == 0
    assert (tmp_path / "r" / "notes.txt").read_text() == "mine"


def test_what_was_found_is_shown_though_it_cannot_be_written(
    run: Run, asked: list[tuple[Mission, dict[str, Any]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(deployment: Deployment) -> str:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(record, "agents_csv", full)
    ended = run("plan", "mission.yaml", "--out", "r")
    assert ended.code == 2
    assert "Score" in ended.out
    assert "covey: r: cannot be written: No space left on device" in ended.err
    assert not Path("r").exists()


def test_ctrl_c_keeps_what_is_known(run: Run, make_deployment: MakeDeployment, monkeypatch: pytest.MonkeyPatch) -> None:
    early = replace(make_deployment(evidence=False), status=PlanStatus.INTERRUPTED)
    monkeypatch.setitem(sys.modules, "covey.runtime.plan", SimpleNamespace(plan=lambda mission, **options: early))
    ended = run("plan", "mission.yaml", "--out", "r")
    assert ended.code == 130
    assert "interrupted; what was known by then is in r" in ended.err
    assert "none: interrupted" in ended.out
    assert read_result("r").status is PlanStatus.INTERRUPTED


def test_ctrl_c_after_settling_says_what_is_missing(
    run: Run, make_deployment: MakeDeployment, monkeypatch: pytest.MonkeyPatch
) -> None:
    def plan(mission: Mission, **options: Any) -> Deployment:
        signal.raise_signal(signal.SIGINT)
        return make_deployment(certificate=PROVED, bound=None, baseline=None)

    monkeypatch.setitem(sys.modules, "covey.runtime.plan", SimpleNamespace(plan=plan))
    ended = run("plan", "mission.yaml", "--out", "r", "--bound", "--baseline")
    assert ended.code == 130
    assert "holds for sigma = 0.01" in ended.out
    assert "planning had settled and is in r, without the bound and the baseline" in ended.err
    assert read_result("r").status is PlanStatus.SETTLED
    assert "without the baseline\n" in run("plan", "mission.yaml", "--out", "q", "--baseline", "--quiet").err


@pytest.mark.parametrize("options", [(), ("--quiet",), ("--quiet", "--json")], ids=str)
def test_a_plan_whose_certificate_does_not_hold(
    options: Sequence[str], run: Run, make_deployment: MakeDeployment, monkeypatch: pytest.MonkeyPatch
) -> None:
    stand_in = SimpleNamespace(plan=lambda mission, **options: make_deployment())
    monkeypatch.setitem(sys.modules, "covey.runtime.plan", stand_in)
    ended = run("plan", "mission.yaml", "--out", "r", *options)
    assert ended.code == 1
    assert ended.err == "covey: the certificate does not hold, violations: 1; they are in r\n"
    assert read_result("r").certificate == make_deployment().certificate
    assert bool(ended.out) is (options != ("--quiet",))


def test_exit_codes_are_told(run: Run) -> None:
    assert "its certificate does not hold" in run("plan", "--help").out


@pytest.mark.parametrize(
    ("error", "code"), [(CoveyError("told\nonce\x1b[31m"), 2), (SolverError("told\nonce\x1b[31m"), 3)], ids=repr
)
def test_errors_are_one_message(error: CoveyError, code: int, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def plan(mission: Mission, **options: Any) -> Deployment:
        raise error

    monkeypatch.setitem(sys.modules, "covey.runtime.plan", SimpleNamespace(plan=plan))
    assert run("plan", "mission.yaml", "--quiet") == (code, "", "covey: told\nonce?[31m\n")


@pytest.mark.parametrize(
    "arguments",
    [
        ["plan", "nothing.yaml"],
        ["plan", "."],
        ["plan", "bad.yaml"],
        ["plan", "mission.yaml", "--seed", "-1"],
        ["plan", "mission.yaml", "--seed", "x"],
        ["plan", "mission.yaml", "--trade", "barter"],
        ["plan", "mission.yaml", "--out", "mission.yaml"],
        ["plan", "mission.yaml", "--out", "mission.yaml/r"],
        ["plan"],
        ["certify", "nothing"],
        ["certify", "."],
        ["certify", "mission.yaml"],
        ["validate", "bad.yaml"],
        ["reproduce", "thesis-9"],
        ["reproduce", "thesis-5.1", "--seeds", "0"],
        ["heatmap", "--model", "lidar"],
        ["heatmap", "--out", "x.txt"],
        ["heatmap", "--optimal-distance-m", "-1"],
        ["heatmap", "--optimal-distance-m", "0"],
        ["heatmap", "--optimal-distance-m", "1e8"],
        ["heatmap", "--optimal-distance-m", "nan"],
        ["plan", ""],
        ["plan", "mission.yaml", "--out", ""],
        ["certify", ""],
        ["certify", os.devnull],
        ["validate", ""],
        ["validate", os.devnull],
        ["fly"],
        ["--no-such-option"],
    ],
    ids=" ".join,
)
def test_bad_input_ends_with_code_2_and_a_message(arguments: Sequence[str], run: Run, tmp_path: Path) -> None:
    (tmp_path / "bad.yaml").write_text(MISSION.replace("seed: 3", "seeed: x"))
    ended = run(*arguments)
    assert ended.code == 2
    assert ended.err or (arguments[0] == "validate" and ended.out)
    assert not Path("covey-out").exists()


def test_mistakes_are_listed_one_a_line(run: Run, tmp_path: Path) -> None:
    (tmp_path / "bad.yaml").write_text(MISSION.replace("seed: 3", "seed: x").replace("x_m: 1", "x_m: much"))
    lines = run("plan", "bad.yaml").err.splitlines()
    assert [line.startswith("bad.yaml:") for line in lines] == [True, True]


@pytest.mark.parametrize("holds", [True, False])
def test_certify(holds: bool, run: Run, make_deployment: MakeDeployment, monkeypatch: pytest.MonkeyPatch) -> None:
    deployment = make_deployment()
    write_result(deployment, "r")
    assert deployment.certificate is not None
    certificate = Certificate(True, 0.01, 0.002, 0.0, ()) if holds else deployment.certificate
    stand_in = SimpleNamespace(
        certify=lambda source, on_progress: certificate, bound_team=lambda source, on_progress: TeamBound(50.0, 0.16)
    )
    monkeypatch.setitem(sys.modules, "covey.runtime.certify", stand_in)
    ended = run("certify", "r", "--bound")
    assert ended.code == (0 if holds else 1)
    assert ("holds for sigma = 0.01" if holds else "VIOLATED") in ended.out
    assert ("landmark 3 is better seen" in ended.out) is not holds
    assert "no deployment of this team exceeds 50.00; gap 16.00 %" in ended.out
    printed = run("certify", "r", "--json")
    assert printed.code == (0 if holds else 1)
    assert json.loads(printed.out)["certificate"]["holds"] is holds
    assert json.loads(printed.out)["bound"] is None


def test_certify_leaves_out_a_bound_that_says_nothing(run: Run, make_deployment: MakeDeployment) -> None:
    deployment = make_deployment(agents=1, side=2)
    one = replace(deployment.agents[0], landmarks=deployment.agents[0].landmarks[1:])
    write_result(replace(deployment, agents=(one,)), "r")
    ended = run("certify", "r", "--bound")
    assert ended.code == 1
    proof, bound = ended.out.index("incomplete: landmark 0 has no owner"), ended.out.index("Bound     left out: ")
    assert proof < bound
    assert "gap" not in ended.out[bound:]
    printed = run("certify", "r", "--bound", "--json")
    assert printed.code == 1
    assert json.loads(printed.out)["bound"] is None
    assert "left out: " in printed.err


def test_certify_keeps_its_certificate_when_the_bound_fails(
    run: Run, make_deployment: MakeDeployment, monkeypatch: pytest.MonkeyPatch
) -> None:
    def bound_team(source: Deployment, on_progress: object) -> TeamBound:
        raise SolverError("no bound")

    write_result(make_deployment(), "r")
    stand_in = SimpleNamespace(certify=lambda source, on_progress: PROVED, bound_team=bound_team)
    monkeypatch.setitem(sys.modules, "covey.runtime.certify", stand_in)
    ended = run("certify", "r", "--bound")
    assert (ended.code, ended.err) == (3, "covey: no bound\n")
    assert "holds for sigma = 0.01" in ended.out


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_validate_and_certify_do_not_wait_for_a_pipe(run: Run, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.yaml")
    assert "pipe.yaml: expected a regular file" in run("validate", "mission.yaml", "pipe.yaml").out
    assert "covey: pipe.yaml: expected a regular file" in run("certify", "pipe.yaml").err
    assert "empty text" in run("certify", "").err


def test_heatmap(run: Run, tmp_path: Path) -> None:
    assert run("heatmap") == (0, "heatmap-anisotropic.png\n", "")
    assert (tmp_path / "heatmap-anisotropic.png").stat().st_size > 1000
    assert run("heatmap").code == 2
    assert run("heatmap", "--force").code == 0


def test_help_version_and_schema(run: Run) -> None:
    for command in ("plan", "certify", "validate", "schema", "reproduce", "heatmap", "chaos"):
        assert command in run("--help").out
        assert run(command, "--help").code == 0
    assert run("--version").out.startswith("covey 0.")
    assert json.loads(run("schema").out)["type"] == "object"


# ------------------------------------------------------------------------------------------------------ as a process


def covey(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "covey", *arguments], capture_output=True, text=True, **options)


@pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX signals")
@pytest.mark.parametrize("stage", ["optimizing", "trading", "proving", "bounding"])
def test_ctrl_c_in_the_middle_keeps_what_is_known(stage: str, tmp_path: Path) -> None:
    mission = Path(__file__).parents[3] / "examples" / "eight-agents.yaml"
    command = [sys.executable, "-c", REPORTING, "plan", str(mission), "--out", str(tmp_path / "r"), "--bound"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        while not (line := process.stderr.readline()).startswith(f"covey: {stage}"):
            assert line, f"it ended before {stage}"
        process.send_signal(signal.SIGINT)
        out, err = process.communicate()
    assert process.returncode == 130, err
    assert "Traceback" not in err
    settled = stage == "bounding"
    assert ("without the bound" if settled else "interrupted; what was known by then is in") in err
    assert "Score" in out
    deployment = read_result(tmp_path / "r")
    assert deployment.status is (PlanStatus.SETTLED if settled else PlanStatus.INTERRUPTED)
    assert (deployment.certificate is not None) is settled
    assert np.array_equal(np.sort(np.concatenate([agent.landmarks for agent in deployment.agents])), np.arange(400))
    assert sum(agent.score for agent in deployment.agents) == pytest.approx(deployment.score.final)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["r"]


REPORTING = """
import covey.runtime.plan
covey.runtime.plan.REPORT_EVERY = 0.0
from covey.cli.main import main
main()
"""
"""The command, reporting every step, so that no stage is over before it was reported."""


@pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX signals")
def test_ctrl_c_while_there_is_nothing_to_keep_ends_at_once(tmp_path: Path) -> None:
    mission = tmp_path / "mission.yaml"
    os.mkfifo(mission)
    command = [sys.executable, "-m", "covey", "plan", str(mission), "--out", str(tmp_path / "r")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        writer = -1
        while writer < 0 and process.poll() is None:
            with contextlib.suppress(OSError):  # until the command opens its mission, whose other end this is
                writer = os.open(mission, os.O_WRONLY | os.O_NONBLOCK)
        process.send_signal(signal.SIGINT)
        if writer >= 0:
            os.close(writer)
        _, err = process.communicate()
    assert process.returncode == 130, err
    assert err == ""
    assert not (tmp_path / "r").exists()


def test_a_broken_pipe_is_quiet() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as pipe:
        ended = subprocess.run(
            [sys.executable, "-m", "covey", "schema"], stdout=pipe, stderr=subprocess.PIPE, text=True, check=False
        )
    assert ended.stderr == ""
    assert ended.returncode == 141


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_output_that_cannot_be_stored_is_an_error() -> None:
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(
            [sys.executable, "-m", "covey", "--version"], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert ended.returncode == 2
    assert "No space left on device" in ended.stderr
    assert "Traceback" not in ended.stderr


def test_module_and_exit_code() -> None:
    assert covey("--version", check=False).stdout.startswith("covey 0.")
    assert covey("certify", "nothing", check=False).returncode == 2


# ---------------------------------------------------------------------------------------------------- in the terminal


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    "options", [{}, {"agents": 40, "side": 60}, {"spacing": None}, {"agents": 1, "side": 1}], ids=str
)
@pytest.mark.parametrize("colour", [False, True])
def test_summary(
    options: dict[str, Any], colour: bool, make_deployment: MakeDeployment, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("NO_COLOR", "FORCE_COLOR", "TERM"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("COLORTERM", "truecolor")
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", "70")
    deployment = make_deployment(**options)
    stream: io.StringIO = Terminal() if colour else io.StringIO()
    print_summary(deployment, None, stream=stream)
    text = stream.getvalue()
    assert ("\x1b[" in text) is colour
    assert f"{deployment.score.final:.2f} (end)" in text
    assert "x [m]" in text
    if options.get("side") != 1:
        assert ("▀" in text) is colour


def test_summary_in_ascii(make_deployment: MakeDeployment) -> None:
    raw = io.BytesIO()
    stream = io.TextIOWrapper(raw, encoding="ascii", errors="strict")
    print_summary(make_deployment(names=("north", "b", "c", "d\x1b[2J")), None, stream=stream)
    stream.flush()
    text = raw.getvalue().decode("ascii")
    assert "->" in text
    assert "\x1b" not in text


def test_progress_on_a_terminal_and_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm-256color")
    for stream in (io.StringIO(), Terminal()):
        with ProgressLine(stream=stream) as line:
            for step in range(100):
                line(Progress("trading", float(step), step, 2 * step, step / 100))
            line(Progress("proof", 99.0))
        assert "proof: score 99.00" in stream.getvalue()
        if not stream.isatty():
            assert stream.getvalue().count("trading") == 1
    quiet = io.StringIO()
    with ProgressLine(quiet=True, stream=quiet) as line:
        line(Progress("trading", 1.0))
    assert quiet.getvalue() == ""


def test_a_seed_that_is_none_is_told_in_our_words() -> None:
    ended = covey("plan", "mission.yaml", "--seed", "x")
    assert ended.returncode == 2
    assert "expected a whole number from 0" in ended.stderr
    assert "parse" not in ended.stderr

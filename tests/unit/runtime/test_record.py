from __future__ import annotations

import contextlib
import csv
import errno
import json
import math
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from covey.errors import OutputError, ResultError
from covey.runtime.drawing import figures
from covey.runtime.records import document, record
from covey.runtime.records.record import default_directory, read_result, result_text, write_result
from covey.runtime.result import AgentResult, Deployment, PlanStatus, Scores

MakeDeployment = Callable[..., Deployment]

TEXT = (Path(__file__).parent / "result-v1.json").read_text(encoding="utf-8")


@pytest.fixture
def fast_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write stand-ins instead of drawing."""

    def save(figure: object, file: Path, *, kind: str | None = None) -> None:
        file.write_bytes(b"figure")

    monkeypatch.setattr(figures, "deployment_figure", lambda deployment: None)
    monkeypatch.setattr(figures, "save_figure", save)


def names(directory: Path) -> list[str]:
    return sorted(path.name for path in directory.iterdir())


def test_all_files_are_written(make_deployment: MakeDeployment, tmp_path: Path) -> None:
    target = make_deployment().save(tmp_path / "a" / "result")
    assert names(target) == ["agents.csv", "deployment.pdf", "deployment.png", "result.json"]
    assert (target / "deployment.png").read_bytes().startswith(b"\x89PNG")
    assert (target / "deployment.pdf").read_bytes().startswith(b"%PDF")
    assert names(tmp_path / "a") == ["result"]


def test_keys_of_the_result(make_deployment: MakeDeployment) -> None:
    data = make_deployment().to_dict()
    keys = """
        schema_version mission seed sigma score score_history trades pose_optimizations agents landmarks certificate
        bound baseline timing_s software
    """
    assert set(keys.split()) <= set(data)
    assert set(data["score"]) == {"initial", "after_first_optimization", "after_first_trade", "final"}
    assert {"name", "pose", "score", "landmarks"} <= set(data["agents"][0])
    assert set(data["agents"][0]["pose"]) == {"x_m", "y_m", "yaw_deg"}
    assert {"positions_m", "weights"} <= set(data["landmarks"])
    assert {"holds", "sigma", "links", "worst_pose_gap", "worst_trade_gain", "violations"} == set(data["certificate"])
    assert {"team_upper_bound", "gap"} == set(data["bound"])
    assert {"greedy", "greedy_lloyd"} == set(data["baseline"])
    assert len(data["score_history"]) == len(data["score_events"])
    assert data["mission"]["document"]["environment"] == {"date": None, "list": [1, 2.5, "x"]}


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"geographic": True},
        {"spacing": None, "normals": True},
        {"own_region": True},
        {"agents": 16},
        {"evidence": False},
    ],
    ids=str,
)
def test_round_trip(
    options: dict[str, Any], make_deployment: MakeDeployment, tmp_path: Path, fast_figures: None
) -> None:
    deployment = make_deployment(**options)
    back = read_result(write_result(deployment, tmp_path / "r"))
    mission, read = deployment.mission, back.mission
    assert np.array_equal(read.landmarks.positions_W, mission.landmarks.positions_W)
    assert np.array_equal(read.landmarks.weights, mission.landmarks.weights)
    if mission.landmarks.normals_W is not None:
        assert read.landmarks.normals_W == pytest.approx(mission.landmarks.normals_W, abs=1e-15)
    assert read.landmarks.cell_size == mission.landmarks.cell_size
    assert read.georeference == mission.georeference
    assert (read.name, read.seed, read.coverage, read.sensor) == (
        mission.name,
        mission.seed,
        mission.coverage,
        mission.sensor,
    )
    for a, b in zip(read.agents, mission.agents, strict=True):
        assert (a.name, a.sensor, a.drawn) == (b.name, b.sensor, b.drawn)
        assert np.array_equal(a.region.exterior, b.region.exterior)
        assert (a.region is read.region) == (b.region is mission.region)
    for one, other in zip(back.agents, deployment.agents, strict=True):
        assert (one.name, one.score) == (other.name, other.score)
        assert np.array_equal(one.landmarks, other.landmarks)
        assert (one.pose.x, one.pose.y) == (other.pose.x, other.pose.y)
        assert abs(math.remainder(one.pose.yaw - other.pose.yaw, 2 * math.pi)) < 1e-12
    assert np.array_equal(back.owner, deployment.owner)
    for name in ("seed", "sigma", "trade", "optimizer", "status", "score", "history", "trades", "pose_optimizations"):
        assert getattr(back, name) == getattr(deployment, name)
    for name in ("certificate", "bound", "baseline", "timing_s", "software"):
        assert getattr(back, name) == getattr(deployment, name)
    assert read.path is not None
    assert mission.path is not None
    assert read.path.resolve() == mission.path.resolve()


@given(st.floats(-math.pi, math.pi, exclude_max=True))
def test_headings_survive_degrees(yaw: float) -> None:
    assert abs(math.remainder(math.radians(json.loads(json.dumps(math.degrees(yaw)))) - yaw, 2 * math.pi)) < 1e-12


def test_unknown_scores_are_null(make_deployment: MakeDeployment) -> None:
    deployment = make_deployment(
        score=Scores(1.0, math.nan, math.nan, 1.0), status=PlanStatus.INTERRUPTED, evidence=False
    )
    text = document.to_text(deployment.to_dict())
    assert json.loads(text)["score"] == {
        "initial": 1.0, "after_first_optimization": None, "after_first_trade": None, "final": 1.0,
    }  # fmt: skip
    assert math.isnan(document.from_text(text).score.after_first_trade)


def test_names_of_any_kind(make_deployment: MakeDeployment, tmp_path: Path) -> None:
    odd = ("$x^2$ ünï", 'a,"b"\n', "相机", "<b>&\x1b[31m")
    target = write_result(make_deployment(names=odd), tmp_path / "r")
    assert tuple(agent.name for agent in read_result(target).agents) == odd
    with (target / "agents.csv").open(encoding="utf-8", newline="") as stream:
        assert tuple(row["name"] for row in csv.DictReader(stream)) == odd


def test_a_users_model_is_found_from_the_result(
    make_deployment: MakeDeployment, tmp_path: Path, fast_figures: None
) -> None:
    deployment = make_deployment()
    model = tmp_path / "models" / "mine.py"
    agents = tuple(
        replace(agent, sensor=replace(agent.sensor, model=f"{model}:Mine")) for agent in deployment.mission.agents
    )
    target = write_result(replace(deployment, mission=replace(deployment.mission, agents=agents)), tmp_path / "r")
    assert json.loads((target / "result.json").read_text())["agents"][0]["sensor"]["model"] == "../models/mine.py:Mine"
    assert read_result(target).mission.agents[0].sensor.model == f"{model.resolve()}:Mine"


@pytest.mark.parametrize(("key", "value"), [("sigma", 0.02), ("sigma", 0.0), ("sigma", -0.01), ("seed", 8)])
def test_what_is_said_twice_is_the_same(key: str, value: float) -> None:
    data = json.loads(TEXT)
    data[key] = value
    with pytest.raises(ResultError, match=f"{key}: expected .*, got {value}"):
        document.from_text(json.dumps(data))


def test_a_tolerance_of_zero_is_none() -> None:
    data = json.loads(TEXT)
    data["sigma"] = data["mission"]["coverage"]["sigma"] = 0.0
    with pytest.raises(ResultError, match="above 0"):
        document.from_text(json.dumps(data))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_only_regular_files_are_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "result.json")
    for path in (tmp_path, tmp_path / "result.json", Path(os.devnull)):
        with pytest.raises(ResultError, match="regular file"):
            read_result(path)


def test_too_large_a_file_is_not_read(tmp_path: Path) -> None:
    with (tmp_path / "result.json").open("wb") as stream:
        stream.truncate(record.MAX_BYTES + 1)
    with pytest.raises(ResultError, match="at most 500,000,000 bytes"):
        read_result(tmp_path)


# ------------------------------------------------------------------------------------------------ what is there already


@pytest.mark.usefixtures("fast_figures")
def test_a_directory_with_something_in_it_is_refused(make_deployment: MakeDeployment, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match="not empty"):
        write_result(make_deployment(), tmp_path)
    assert names(tmp_path) == ["notes.txt"]


@pytest.mark.usefixtures("fast_figures")
def test_overwrite_replaces_only_what_covey_wrote(make_deployment: MakeDeployment, tmp_path: Path) -> None:
    write_result(make_deployment(geographic=True), tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match="not empty"):
        write_result(make_deployment(), tmp_path)
    write_result(make_deployment(seed=8), tmp_path, overwrite=True)
    assert names(tmp_path) == ["agents.csv", "deployment.pdf", "deployment.png", "notes.txt", "result.json"]
    assert read_result(tmp_path).seed == 8


@pytest.mark.parametrize("name", ["result.json", "agents.csv", "deployment.png"])
def test_overwrite_never_replaces_what_others_wrote(name: str, make_deployment: MakeDeployment, tmp_path: Path) -> None:
    (tmp_path / name).write_text("{}")
    with pytest.raises(OutputError, match="not written by covey"):
        write_result(make_deployment(), tmp_path, overwrite=True)
    assert (tmp_path / name).read_text() == "{}"


def test_a_file_is_no_directory(make_deployment: MakeDeployment, tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("mine")
    for target in (file, file / "below"):
        with pytest.raises(OutputError, match=r"expected a directory|cannot be"):
            write_result(make_deployment(), target)
    with pytest.raises(OutputError, match="cannot be"):
        write_result(make_deployment(), "a\0b")


def test_default_directories_are_numbered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert default_directory("my site", 7) == Path("covey-out/my-site-7")
    default_directory("my site", 7).mkdir(parents=True)
    assert default_directory("my site", 7) == Path("covey-out/my-site-7-2")
    for name in ("", "../..", "/", "a" * 500, "相机"):
        assert default_directory(name, 1).parent == Path("covey-out")
        default_directory(name, 1).mkdir(parents=True)


# ---------------------------------------------------------------------------------------------------- all or nothing


@pytest.mark.usefixtures("fast_figures")
@pytest.mark.parametrize("existing", [False, True])
@pytest.mark.parametrize("failure", [OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), KeyboardInterrupt()], ids=repr)
@pytest.mark.parametrize("step", [("record", "agents_csv"), ("figures", "save_figure"), ("record", "result_text")])
def test_a_failure_in_the_middle_leaves_things_as_they_were(
    step: tuple[str, str],
    failure: BaseException,
    existing: bool,
    make_deployment: MakeDeployment,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    target = tmp_path / "r"
    if existing:
        write_result(make_deployment(seed=1), target)
    before = {path.name: path.read_bytes() for path in target.iterdir()} if existing else None

    def fail(*_: object, **__: object) -> NoReturn:
        raise failure

    monkeypatch.setattr({"record": record, "figures": figures}[step[0]], step[1], fail)
    expected = OutputError if isinstance(failure, OSError) else KeyboardInterrupt
    with pytest.raises(expected):
        write_result(make_deployment(seed=2), target, overwrite=True)
    after = {path.name: path.read_bytes() for path in target.iterdir()} if target.exists() else None
    assert after == before
    assert names(tmp_path) == (["r"] if existing else [])


@pytest.mark.usefixtures("fast_figures")
def test_ctrl_c_while_files_are_moved_waits(
    make_deployment: MakeDeployment, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_result(make_deployment(seed=1, geographic=True), tmp_path)
    real, calls = Path.replace, []

    def interrupted(self: Path, target: Path) -> Path:
        calls.append(target.name)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return real(self, target)

    monkeypatch.setattr(Path, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_result(make_deployment(seed=2, geographic=True), tmp_path, overwrite=True)
    assert names(tmp_path) == ["agents.csv", "deployment.geojson", "deployment.pdf", "deployment.png", "result.json"]
    assert read_result(tmp_path).seed == 2
    assert calls[-1] == "result.json"


# -------------------------------------------------------------------------------------------------------- bad results


def test_missing_results(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "nothing", tmp_path / "nothing" / "result.json"):
        with pytest.raises(ResultError, match="no result here"):
            read_result(path)
    with pytest.raises(ResultError, match="cannot be read"):
        read_result("a\0b")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "expected JSON"),
        (b"\xff\xfe", "UTF-8"),
        (b"{", "expected JSON"),
        (b"[" * 100_000, "expected JSON"),
        (b"[]", "expected an object"),
        (b"{}", "schema_version"),
        (b'{"schema_version": 2}', "expected 1"),
        (b'{"schema_version": true}', "schema_version"),
        (b'{"schema_version": NaN}', "NaN"),
    ],
    ids=lambda value: repr(value)[:20],
)
def test_garbage(content: bytes, message: str, tmp_path: Path) -> None:
    (tmp_path / "result.json").write_bytes(content)
    with pytest.raises(ResultError, match=message):
        read_result(tmp_path)


@pytest.mark.parametrize(
    ("keys", "value", "message"),
    [
        (("agents", 1, "pose", "x_m"), "abc", r"agents\[1\].pose.x_m: expected a finite number, got 'abc'"),
        (("agents", 1, "pose", "x_m"), 10**400, r"agents\[1\].pose.x_m"),
        (("agents", 0, "landmarks", 2), 400, r"agents\[0\].landmarks\[2\]: expected the index of a landmark, 0 to 399"),
        (("agents", 0, "landmarks", 2), -1, "index of a landmark"),
        (("agents", 0, "landmarks", 2), 1.0, "index of a landmark"),
        (("agents", 1, "name"), "agent 1", "no other agent"),
        (("agents", 1, "name"), "\ud800", "expected text"),
        (("agents",), [], "at least one agent"),
        (("landmarks", "positions_m"), [], "at least one landmark"),
        (("landmarks", "positions_m", 3), [1, 2, 3], r"landmarks.positions_m\[3\]: expected a list of 2 numbers"),
        (("landmarks", "positions_m", 3, 0), None, r"landmarks.positions_m\[3\]"),
        (("landmarks", "weights"), [1.0], "400 numbers"),
        (("landmarks", "weights", 0), -1.0, "weights"),
        (("landmarks", "cell_size_m"), 0, "above 0"),
        (("mission", "region", "exterior_m"), [[0, 0], [1, 1], [0, 1], [1, 0]], "polygon"),
        (("trade",), "barter", "one of thesis, pairwise"),
        (("trade",), [], "one of thesis, pairwise"),
        (("sigma",), -1, "sigma"),
        (("score_history",), [1.0], "score_events"),
        (("mission", "coverage", "assignment"), {"agent 1": [1.5]}, "index of a landmark"),
    ],
    ids=lambda value: repr(value)[:30],
)
def test_wrong_values_are_named(
    keys: tuple[Any, ...], value: object, message: str, make_deployment: MakeDeployment, tmp_path: Path
) -> None:
    data = make_deployment().to_dict()
    place: Any = data
    for key in keys[:-1]:
        place = place[key]
    place[keys[-1]] = value
    (tmp_path / "result.json").write_text(json.dumps(data))
    with pytest.raises(ResultError, match=message):
        read_result(tmp_path)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


@given(st.data())
def test_fuzzed_documents_give_a_deployment_or_a_result_error(data: st.DataObject) -> None:
    document_ = json.loads(TEXT)
    for _ in range(data.draw(st.integers(1, 3))):
        place: Any = document_
        while True:
            keys = list(place) if isinstance(place, dict) else list(range(len(place)))
            if not keys:
                break
            key = data.draw(st.sampled_from(keys))
            if not isinstance(place[key], (dict, list)) or data.draw(st.booleans()):
                if data.draw(st.booleans()) and isinstance(place, dict):
                    del place[key]
                else:
                    place[key] = data.draw(JSON)
                break
            place = place[key]
    with contextlib.suppress(ResultError):
        assert isinstance(document.from_text(json.dumps(document_)), Deployment)


@given(st.binary(max_size=60), st.integers(0, 10_000))
def test_fuzzed_bytes_give_a_deployment_or_a_result_error(garbage: bytes, place: int) -> None:
    text = (TEXT[: place % len(TEXT)].encode() + garbage + TEXT[place % len(TEXT) + len(garbage) :].encode()).decode(
        errors="replace"
    )
    with contextlib.suppress(ResultError):
        assert isinstance(document.from_text(text), Deployment)


def test_the_format_stays_readable(tmp_path: Path) -> None:
    deployment = document.from_text(TEXT)
    assert isinstance(deployment.agents[0], AgentResult)
    assert deployment.flight is None, "the file is older than flight"
    assert json.loads(result_text(deployment, tmp_path)).keys() - {"flight"} == json.loads(TEXT).keys()

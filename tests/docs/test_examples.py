"""Every example plans to a proved deployment, the user's own camera model with every optimiser."""

from __future__ import annotations

from pathlib import Path

import pytest

import covey
from covey.mission import OptimizerName
from covey.sensing import build_model
from covey.testing import check_visibility_model

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.yaml")), ids=lambda path: path.stem)
def test_each_example_plans(path: Path) -> None:
    deployment = covey.plan(covey.load_mission(path))
    assert deployment.certificate is not None
    assert deployment.certificate.holds, deployment.certificate.violations
    assert deployment.score.final > deployment.score.initial


def test_own_model_keeps_its_promises() -> None:
    check_visibility_model(build_model("own_model.py:Spotlight", {"width_m": 0.5}, folder=EXAMPLES))


@pytest.mark.parametrize("optimizer", OptimizerName)
def test_own_model_works_in_every_optimizer(optimizer: OptimizerName, tmp_path: Path) -> None:
    mission = covey.load_mission(EXAMPLES / "own-model.yaml")
    deployment = covey.plan(mission, optimizer=optimizer, baseline=True)
    deployment.save(tmp_path / "result")
    assert covey.certify(tmp_path / "result").holds
    assert deployment.baseline is not None
    assert deployment.score.final >= deployment.baseline.greedy


def test_a_bound_for_an_own_model_is_refused_before_planning() -> None:
    reports: list[covey.Progress] = []
    with pytest.raises(covey.SolverError, match="built-in"):
        covey.plan(covey.load_mission(EXAMPLES / "own-model.yaml"), bound=True, on_progress=reports.append)
    assert reports == []


def test_a_deployment_shows_itself_in_a_notebook() -> None:
    deployment = covey.plan(covey.load_mission(EXAMPLES / "inspection.yaml"))
    assert deployment._repr_png_().startswith(b"\x89PNG")
    page = deployment._repr_html_()
    assert page.startswith('<img src="data:image/png;base64,')
    for agent in deployment.agents:
        assert f"<td>{agent.name}</td>" in page
    assert deployment.plot().get_xlabel() == "x [m]"

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from covey.environment import Landmarks
from covey.environment.lattice import find_lattice
from covey.geometry import Region
from covey.runtime.drawing import figures
from covey.runtime.drawing.palette import colours
from covey.runtime.result import Deployment
from covey.sensing.registry import build_model

MakeDeployment = Callable[..., Deployment]

HOLED = Region.polygon([[-4, -4], [5, -3], [4, 4], [-3, 3]], [[[0, 0], [1, 0], [1, 1], [0, 1.5]]])


def pixels(figure: Figure) -> NDArray[np.int64]:
    """The picture as 0xrrggbb, shape (rows, columns)."""
    buffer = io.BytesIO()
    figures.save_figure(figure, buffer, kind="png")
    image = np.asarray(Image.open(buffer).convert("RGB"), dtype=np.int64)
    packed: NDArray[np.int64] = image @ np.array([65536, 256, 1])
    return packed


def share(image: NDArray[np.int64], colour: str) -> float:
    return float(np.mean(image == int(colour[1:], 16)))


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"agents": 1},
        {"agents": 16, "geographic": True},
        {"agents": 64, "side": 60, "spacing": 0.2},
        {"agents": 6, "side": 12, "spacing": None, "normals": True, "region": HOLED},
        {"agents": 3, "side": 4, "region": Region.box(-30, 30, -1, 1), "evidence": False},
        {"own_region": True},
        {"names": ("$x^2$ 相机", "\\frac{1}", "a" * 90, "b\nc")},
    ],
    ids=lambda options: " ".join(options) or "plain",
)
def test_every_owner_is_seen(options: dict[str, Any], make_deployment: MakeDeployment) -> None:
    deployment = make_deployment(**options)
    image = pixels(figures.deployment_figure(deployment))
    assert image.shape[0] > 500
    assert image.shape[1] > 1000
    assert share(image, "#000000") > 1e-4  # pose marks
    for agent, colour in zip(deployment.agents, colours([agent.name for agent in deployment.agents]), strict=True):
        if len(agent.landmarks) > 4:
            assert share(image, colour) > 2e-5, agent.name


def test_cells_cover_their_share_of_the_map(make_deployment: MakeDeployment) -> None:
    deployment = make_deployment()
    image = pixels(figures.deployment_figure(deployment))
    shares = [share(image, colour) for colour in colours([agent.name for agent in deployment.agents])]
    counts = [len(agent.landmarks) for agent in deployment.agents]
    assert np.argsort(shares).tolist() == np.argsort(counts).tolist()


def test_image_and_single_cells_agree(make_deployment: MakeDeployment, monkeypatch: pytest.MonkeyPatch) -> None:
    deployment = make_deployment(side=30)
    single = pixels(figures.deployment_figure(deployment))
    monkeypatch.setattr("covey.runtime.drawing.map_drawing.MANY_CELLS", 10)
    image = pixels(figures.deployment_figure(deployment))
    # They differ by the lines between cells and the numbers alone.
    assert np.mean(single != image) < 0.3


def test_pdf_embeds_truetype_and_is_reproducible(make_deployment: MakeDeployment, tmp_path: Path) -> None:
    for name in ("a.pdf", "b.pdf"):
        figures.save_figure(figures.deployment_figure(make_deployment()), tmp_path / name)
    content = (tmp_path / "a.pdf").read_bytes()
    assert content == (tmp_path / "b.pdf").read_bytes()
    assert b"/CIDFontType2" in content
    assert b"/Type3" not in content


def test_figures_leave_matplotlib_as_it_was(make_deployment: MakeDeployment) -> None:
    before = dict(mpl.rcParams)
    deployment = make_deployment()
    assert deployment._repr_png_().startswith(b"\x89PNG")
    assert dict(mpl.rcParams) == before


def test_plot_on_axes_of_the_user(make_deployment: MakeDeployment) -> None:
    deployment = make_deployment()
    figure = Figure(figsize=(4, 4))
    ax = figure.add_subplot()
    assert deployment.plot(ax) is ax
    assert ax.get_xlabel() == "x [m]"
    whole = deployment.plot().figure
    assert isinstance(whole, Figure)
    assert len(whole.axes) == 3


def test_notebooks_show_names_as_text(make_deployment: MakeDeployment) -> None:
    shown = make_deployment(names=("<script>", "b", "c", "d"))._repr_html_()
    assert "&lt;script&gt;" in shown
    assert "<script>" not in shown
    assert 'src="data:image/png;base64,' in shown


def test_moments_of_the_score(make_deployment: MakeDeployment) -> None:
    deployment = make_deployment()
    chart = figures.deployment_figure(deployment).axes[1]
    labels = chart.get_legend_handles_labels()[1]
    assert f"after optimising once, {deployment.score.after_first_optimization:.2f}" in labels
    assert f"after one trade, {deployment.score.after_first_trade:.2f}" in labels
    bare = figures.deployment_figure(make_deployment(evidence=False, history=())).axes[1]
    assert len(bare.get_legend_handles_labels()[1]) == 1


@pytest.mark.parametrize("name", ["anisotropic", "isotropic", "oriented"])
def test_heat_maps(name: str) -> None:
    image = pixels(figures.heatmap_figure(build_model(name), pixels=101))
    assert len(np.unique(image)) > 100


def test_heat_map_is_light_where_landmarks_are_seen_best() -> None:
    figure = figures.heatmap_figure(build_model("anisotropic"), pixels=121)
    values = figure.axes[0].images[0].get_array()
    assert values is not None
    assert divmod(int(np.argmax(values)), 121) == (60, 80)  # one metre ahead, as (4.2) has it
    assert np.all(values[:, :60] == 0.0)


def test_lattices() -> None:
    grid = np.stack(np.meshgrid(np.arange(3.0), np.arange(2.0)), axis=-1).reshape(-1, 2)
    lattice = find_lattice(Landmarks(grid, cell_size=1.0))
    assert lattice is not None
    assert lattice.extent == (-0.5, 2.5, -0.5, 1.5)
    found = lattice.at(np.array([-0.4, 2.4, 2.6, 1.0]), np.array([-0.4, 1.4, 0.0, -0.6]))
    assert found.tolist() == [0, 5, -1, -1]
    assert find_lattice(Landmarks(grid)) is None
    assert find_lattice(Landmarks(grid * 1.1, cell_size=1.0)) is None
    assert find_lattice(Landmarks(np.array([[0.0, 0.0], [1e9, 1e9]]), cell_size=1.0)) is None
    assert find_lattice(Landmarks(np.zeros((2, 2)), cell_size=1.0)) is None

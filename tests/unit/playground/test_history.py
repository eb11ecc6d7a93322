"""What late visitors are told of the past."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from covey.playground.history import POINTS, HistoryKeeper
from covey.playground.messages import History
from covey.playground.paths import ALL_POINTS, FEWEST, PATH_POINTS, PathKeeper
from covey.playground.sample import sample_feed
from covey.runtime.watching.feed import (
    ChangeKind,
    Motion,
    Run,
    Scene,
    SceneAgent,
    TeamChange,
    Trading,
    Update,
)


def scene_of(agents: int, run: Run = Run.FLIGHT) -> Scene:
    scene = next(sample_feed(agents=agents, landmarks=20, seconds=1.0))
    assert isinstance(scene, Scene)
    return replace(scene, run=run)


def motion(time: float, positions: Sequence[Sequence[float]], score: float = np.nan) -> Motion:
    poses = np.zeros((len(positions), 7))
    poses[:, : len(positions[0])] = positions
    nothing = np.zeros((len(poses), 3))
    return Motion(time, poses, nothing, nothing, np.zeros((0, 3)), score, np.nan)


def change(time: float, agent: int, x: float) -> TeamChange:
    pose = np.array([[x, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
    none = np.zeros(0, dtype=np.int32)
    return TeamChange(
        time, ChangeKind.OPTIMIZATION, (agent,), none, none, (agent,), pose, (), np.zeros(0), 1.0, "it moves"
    )


def trading(time: float) -> Trading:
    none = np.zeros(0, dtype=np.int32)
    return Trading(time, 0, 1, none, none, open=True)


def told(*items: Scene | Update) -> History:
    keeper = HistoryKeeper()
    for item in items:
        keeper.add(item)
    return keeper.history()


def paths_of(history: History) -> list[NDArray[np.float64]]:
    """Rows of x of the time line and place, for each agent."""
    rows = np.column_stack([history.path_x, history.path_points])
    return np.split(rows, np.cumsum(history.path_counts)[:-1])


def test_paths_of_vehicles_are_where_they_were() -> None:
    history = told(
        scene_of(2),
        motion(0.0, [(0.0, 0.0, 1.0), (5.0, 5.0, 1.0)]),
        motion(0.1, [(0.5, 0.0, 1.0), (5.001, 5.0, 1.0)]),
        motion(0.2, [(1.0, 0.0, 2.0), (5.002, 5.0, 1.0)]),
    )
    first, second = paths_of(history)
    np.testing.assert_allclose(first, [(0.0, 0.0, 0.0, 1.0), (0.1, 0.5, 0.0, 1.0), (0.2, 1.0, 0.0, 2.0)])
    np.testing.assert_allclose(second, [(0.0, 5.0, 5.0, 1.0)])


def test_who_is_nowhere_has_no_path_yet() -> None:
    history = told(scene_of(2), motion(0.0, [(np.nan, 0.0), (1.0, 2.0)]), motion(1.0, [(3.0, 4.0), (1.0, 2.0)]))
    first, second = paths_of(history)
    np.testing.assert_allclose(first, [(1.0, 3.0, 4.0, 0.0)])
    np.testing.assert_allclose(second, [(0.0, 1.0, 2.0, 0.0)])


def test_without_vehicles_paths_go_through_the_committed_poses() -> None:
    history = told(scene_of(2), change(1.0, 0, 3.0), change(2.0, 1, 4.0), change(3.0, 0, 5.0))
    first, second = paths_of(history)
    np.testing.assert_allclose(first[:, :2], [(1.0, 3.0), (3.0, 5.0)])
    np.testing.assert_allclose(second[:, :2], [(2.0, 4.0)])


def test_with_vehicles_committed_poses_are_no_part_of_paths_also_after_a_new_scene() -> None:
    history = told(
        scene_of(1),
        motion(0.0, [(0.0, 0.0)]),
        change(0.5, 0, 9.0),
        scene_of(2),
        change(0.6, 0, 9.0),
        motion(1.0, [(1.0, 0.0), (7.0, 0.0)]),
    )
    first, second = paths_of(history)
    np.testing.assert_allclose(first[:, :2], [(0.0, 0.0), (1.0, 1.0)])
    np.testing.assert_allclose(second[:, :2], [(1.0, 7.0)])


def test_paths_of_a_plan_count_changes_and_offers() -> None:
    history = told(scene_of(2, Run.PLAN), trading(0.001), change(0.001, 0, 3.0), trading(0.002), change(0.002, 0, 5.0))
    np.testing.assert_allclose(paths_of(history)[0][:, :2], [(2.0, 3.0), (4.0, 5.0)])
    assert history.step == 4


def test_paths_stay_in_order_when_times_do_not() -> None:
    history = told(scene_of(1), *(motion(time, [(x, 0.0)]) for x, time in enumerate((0.0, 2.0, 1.0, 3.0))))
    assert history.path_x.tolist() == [0.0, 2.0, 2.0, 3.0]


@pytest.mark.parametrize("m", [1, 10, 100, 1000, 5000])
def test_paths_are_bounded_and_begin_at_the_beginning(m: int) -> None:
    keeper = PathKeeper()
    keeper.make_room(m)
    most = max(FEWEST, min(PATH_POINTS, ALL_POINTS // m))
    steps = 3 * most
    poses = np.zeros((m, 7))
    poses[:, 1] = np.arange(m)
    for step in range(steps):
        poses[:, 0] = 0.5 * step
        keeper.add(float(step), poses)
        counts = keeper.paths()[0]
        assert counts.max() <= most
    counts, x, points = keeper.paths()
    assert counts.sum() == len(x) == len(points)
    assert counts.min() >= most // 4
    starts = np.cumsum(counts) - counts
    np.testing.assert_array_equal(x[starts], 0.0)
    np.testing.assert_array_equal(points[starts, 1], np.arange(m))
    np.testing.assert_allclose(points[:, 0], 0.5 * x)
    # No gap is much wider than the others, up to the end.
    one = np.append(x[: counts[0]], steps)
    assert np.diff(one).max() <= 4.0 * steps / counts[0]


def test_a_long_path_keeps_its_shape() -> None:
    keeper = PathKeeper()
    keeper.make_room(1)
    angles = np.linspace(0.0, 2.0 * np.pi, 20_000)
    for angle in angles:
        keeper.add(angle, np.array([[10.0 * np.cos(angle), 10.0 * np.sin(angle), 0.0]]))
    _, x, points = keeper.paths()
    np.testing.assert_allclose(np.linalg.norm(points[:, :2], axis=1), 10.0, rtol=1e-5)
    assert np.diff(np.append(x, 2.0 * np.pi)).max() < 0.1


def test_only_who_has_a_full_path_is_thinned() -> None:
    keeper = PathKeeper()
    keeper.make_room(2)
    poses = np.zeros((2, 7))
    for step in range(PATH_POINTS + 1):
        poses[0, 0] = step
        poses[1, 0] = min(step, 20)
        keeper.add(float(step), poses)
    counts, x, _ = keeper.paths()
    assert counts.tolist() == [PATH_POINTS // 2 + 1, 21]
    np.testing.assert_array_equal(x[counts[0] :], np.arange(21))


def test_paths_and_curves_outlive_a_new_scene() -> None:
    keeper = HistoryKeeper()
    keeper.add(scene_of(60))
    keeper.add(change(0.0, 0, 0.0))
    for step in range(PATH_POINTS):
        keeper.add(motion(0.1 * step, [(step, 0.0, 0.0)] * 60, score=step))
    old = keeper.history()
    keeper.add(scene_of(600))
    new = keeper.history()
    most = ALL_POINTS // 600
    assert new.path_counts.shape == (600,)
    assert new.path_counts.max() <= most
    assert (new.path_counts[60:] == 0).all()
    for path, earlier in zip(paths_of(new), paths_of(old)[:60], strict=False):
        np.testing.assert_array_equal(path[0], earlier[0])
        assert path[-1, 0] > 0.8 * earlier[-1, 0]
    np.testing.assert_array_equal(new.scores_flown, old.scores_flown)
    assert new.scores.tolist() == old.scores.tolist() == [1.0]
    keeper.add(motion(100.0, [(1.0, 2.0, 3.0)] * 600))
    assert (keeper.history().path_counts[60:] == 1).all()


def test_a_scene_with_fewer_agents_is_another_mission() -> None:
    history = told(scene_of(3), motion(0.0, [(1.0, 0.0)] * 3), scene_of(2), motion(1.0, [(2.0, 0.0)] * 2))
    assert [path.tolist() for path in paths_of(history)] == [[[1.0, 2.0, 0.0, 0.0]]] * 2


def test_the_flown_score_is_kept_where_it_is_known() -> None:
    history = told(scene_of(1), *(motion(float(t), [(0.0, 0.0)], np.nan if t == 1 else 0.5 * t) for t in range(4)))
    assert history.times_flown.tolist() == [0.0, 2.0, 3.0]
    assert history.scores_flown.tolist() == [0.0, 1.0, 1.5]


def test_curves_are_bounded_and_end_with_the_newest() -> None:
    keeper = HistoryKeeper()
    keeper.add(scene_of(1))
    for step in range(5 * POINTS):
        keeper.add(motion(float(step), [(0.0, 0.0)], score=2.0 * step))
    history = keeper.history()
    assert len(history.times_flown) <= POINTS + 1
    assert history.times_flown[[0, -1]].tolist() == [0.0, 5.0 * POINTS - 1.0]
    np.testing.assert_array_equal(history.scores_flown, 2.0 * history.times_flown)


def test_nothing_told_is_an_empty_history() -> None:
    history = HistoryKeeper().history()
    assert history.times.shape == history.times_flown.shape == history.path_x.shape == (0,)
    assert history.path_points.shape == (0, 3)
    assert history.path_points.dtype == np.float32


def test_agents_that_join_are_added_at_the_end() -> None:
    scene = scene_of(1)
    joined = replace(scene, agents=(*scene.agents, SceneAgent("late", "#000000", scene.region, "isotropic", 2.0)))
    history = told(scene, change(1.0, 0, 3.0), joined, change(2.0, 1, 4.0), change(3.0, 0, 5.0))
    first, second = paths_of(history)
    np.testing.assert_allclose(first[:, :2], [(1.0, 3.0), (3.0, 5.0)])
    np.testing.assert_allclose(second[:, :2], [(2.0, 4.0)])

"""Records form a semilattice: merging is commutative, associative, idempotent, and only ever grows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as stnp
from numpy.typing import NDArray

from covey.errors import ArgumentError
from covey.geometry import Pose2
from covey.protocol import LandmarkRecords, PoseRecord, PoseRecords, RecordSlice

N = 5
maps = stnp.arrays(np.int64, (N, 4), elements=st.integers(0, 2))
coordinate = st.integers(0, 1).map(float)
pose_records = st.builds(
    PoseRecord, st.integers(0, 2), st.integers(0, 2), st.builds(Pose2, coordinate, coordinate, coordinate)
)


def merged(*values: NDArray[np.int64]) -> list[list[int]]:
    result = LandmarkRecords(values[0])
    for value in values[1:]:
        result.merge(LandmarkRecords(value).slice(np.arange(N)))
    rows: list[list[int]] = result.values.tolist()
    return rows


def merged_poses(*records: PoseRecord) -> PoseRecord:
    result = PoseRecords({0: records[0]})
    for record in records[1:]:
        result.merge(0, record)
    return result[0]


@given(maps, maps, maps)
def test_landmark_records_are_a_semilattice(a: NDArray[np.int64], b: NDArray[np.int64], c: NDArray[np.int64]) -> None:
    assert merged(a, b) == merged(b, a)
    assert merged(a, b, c) == merged(a, np.array(merged(b, c)))
    assert merged(a, a) == a.tolist()


@given(maps, maps)
def test_a_merge_is_the_lexicographic_maximum(a: NDArray[np.int64], b: NDArray[np.int64]) -> None:
    assert merged(a, b) == [max(x, y) for x, y in zip(a.tolist(), b.tolist(), strict=True)]
    newer = LandmarkRecords(a).merge(LandmarkRecords(b).slice(np.arange(N)))
    assert newer.tolist() == [y > x for x, y in zip(a.tolist(), b.tolist(), strict=True)]
    ahead = LandmarkRecords(a).is_ahead(LandmarkRecords(b).slice(np.arange(N)))
    assert ahead.tolist() == [x > y for x, y in zip(a.tolist(), b.tolist(), strict=True)]


@given(pose_records, pose_records, pose_records)
def test_pose_records_are_a_semilattice(a: PoseRecord, b: PoseRecord, c: PoseRecord) -> None:
    assert merged_poses(a, b) == merged_poses(b, a)
    assert merged_poses(a, b, c) == merged_poses(a, merged_poses(b, c))
    assert merged_poses(a, a) == a
    assert merged_poses(a, b).key() == max(a.key(), b.key())


def test_the_next_record_wins_over_the_one_it_follows() -> None:
    records = LandmarkRecords.initial(3, {0: np.array([0, 1, 2])})
    following = records.slice(np.array([1, 2])).next(owner=4, incarnation=9)
    assert records.merge(following).all()
    assert records.values.tolist() == [[1, 0, 0, 1], [1, 1, 4, 9], [1, 1, 4, 9]]
    assert records.owned_by(4, 9).tolist() == [1, 2]
    assert records.owned_by(4, 1).tolist() == []


def test_slices_select_and_join() -> None:
    records = LandmarkRecords.initial(4, {0: np.array([0, 2]), 1: np.array([1, 3])})
    joined = RecordSlice.join(records.slice(np.array([1, 3])), records.slice(np.array([0])))
    assert joined.indices.tolist() == [0, 1, 3]
    assert joined.values[:, 2].tolist() == [0, 1, 1]
    assert joined.select(np.array([1, 3])).values[:, 2].tolist() == [1, 1]


def test_arrays_in_messages_are_read_only() -> None:
    records = LandmarkRecords.initial(2, {0: np.array([0, 1])}).slice(np.array([0]))
    with pytest.raises(ValueError, match="read-only"):
        records.values[0, 0] = 7


@pytest.mark.parametrize(
    ("partition", "message"),
    [
        ({0: [0]}, "landmark 1 is there 0 times"),
        ({0: [0, 1], 1: [1]}, "landmark 1 is there 2 times"),
        ({0: [0, 1, 2]}, "expected landmarks in"),
        ({0: [-1, 0]}, "expected landmarks in"),
    ],
)
def test_what_is_no_partition_is_refused(partition: dict[int, list[int]], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        LandmarkRecords.initial(2, {agent: np.array(landmarks) for agent, landmarks in partition.items()})


def test_a_wrong_shape_is_refused() -> None:
    with pytest.raises(ArgumentError, match=r"expected shape \(n, 4\)"):
        LandmarkRecords(np.zeros((3, 3), dtype=np.int64))

"""From the `changes` section of a mission file to what an operator changes, or to every mistake in it."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from pydantic import ValidationError

from covey.environment import Landmarks
from covey.environment.json_text import KeyPath, Places
from covey.errors import MissionError
from covey.mission.changes import ChangeSpec
from covey.mission.document import Document
from covey.mission.report import Report, nearest
from covey.mission.schema import ChangeSection


def read_change(
    data: Mapping[str, Any],
    *,
    names: Sequence[str],
    gone: Collection[str],
    landmarks: Landmarks,
    removed: Collection[int],
    source: str,
) -> ChangeSpec:
    """Build a change of a mission that goes on.

    Parameters
    ----------
    data : mapping
        As an entry of `changes` in a mission file.
    names, gone : sequence of str, keyword-only
        Who takes part now, and who did earlier.
    landmarks : Landmarks, keyword-only
        All that there ever were.
    removed : collection of int, keyword-only
        Those that are to be seen no more.
    source : str, keyword-only
        What errors say that the change comes from.

    Raises
    ------
    MissionError
        With every mistake in it.
    """
    report = Report(source, Document(dict(data), Places, []))
    change = None
    try:
        section = ChangeSection.model_validate(data)
        change = ChangeBuilder(names, landmarks, report, gone=gone, removed=removed).build(section, ())
    except ValidationError as error:
        report.add_pydantic(error.errors(include_url=False))
    if change is None or report.mistakes:
        raise MissionError(tuple(report.in_order()))
    return change


KINDS = ("add", "remove", "reweight", "join", "leave")


class ChangeBuilder:
    """Builds one change after the other, with those before it in mind.

    Parameters
    ----------
    names : sequence of str
        The agents at the beginning.
    landmarks : Landmarks or None
        Those at the beginning, None if they could not be built.
    report : Report
    gone : collection of str
        Agents that took part earlier.
    removed : collection of int
        Landmarks that are to be seen no more.
    """

    def __init__(
        self,
        names: Sequence[str],
        landmarks: Landmarks | None,
        report: Report,
        *,
        gone: Collection[str] = (),
        removed: Collection[int] = (),
    ) -> None:
        self._present = list(names)
        self._ever = {*names, *gone}
        self._landmarks = landmarks
        self._count = 0 if landmarks is None else len(landmarks)
        self._removed = set(removed)
        self._report = report

    def build(self, section: ChangeSection, path: KeyPath) -> ChangeSpec | None:
        """Build a change, or note every mistake and return None."""
        given = [kind for kind in KINDS if getattr(section, kind) is not None]
        if len(given) != 1:
            found = f"got {', '.join(given)}" if given else "got none"
            self._report.add(path, f"expected exactly one of {', '.join(KINDS)}, {found}")
            return None
        if section.after_trades is not None and section.at_s is not None:
            self._report.add(path, "expected at most one of after_trades and at_s")
        added, join = self._added(section, path), section.join
        if section.remove is not None:
            self._check_landmarks(section.remove, (*path, "remove"))
            self._removed |= set(section.remove)
            if self._landmarks is not None and len(self._removed) >= self._count:
                self._report.add((*path, "remove"), "expected a landmark to be left")
        if section.reweight is not None:
            self._check_landmarks(section.reweight.landmarks, (*path, "reweight", "landmarks"))
        if join is not None:
            if join.name in self._ever:
                self._report.add((*path, "join", "name"), f"expected a new name, got {join.name[:60]!r}")
            if join.pose is None:
                self._report.add((*path, "join"), "expected a pose", "add pose:")
            self._ever.add(join.name)
            self._present.append(join.name)
        if section.leave is not None:
            self._leave(section.leave, (*path, "leave"))
        return ChangeSpec(
            add=added,
            remove=tuple(section.remove or ()),
            reweight=dict.fromkeys(section.reweight.landmarks, section.reweight.weight) if section.reweight else {},
            join=None if join is None else join.model_dump(exclude_none=True),
            leave=section.leave,
            after_trades=section.after_trades,
            at=section.at_s,
        )

    def _added(self, section: ChangeSection, path: KeyPath) -> Landmarks | None:
        if section.add is None:
            return None
        n, normal = len(section.add.points), section.add.normal_deg
        self._count += n
        needed = self._landmarks is not None and self._landmarks.normals_W is not None
        if needed != (normal is not None) and self._landmarks is not None:
            what = "a normal_deg, as the others have" if needed else "no normal_deg, the others have none"
            self._report.add((*path, "add"), f"expected {what}")
            return None
        angle = math.radians(normal or 0.0)
        normals = np.tile([math.cos(angle), math.sin(angle)], (n, 1)) if needed else None
        return Landmarks(np.array(section.add.points), np.full(n, section.add.weight), normals)

    def _check_landmarks(self, indices: Sequence[int], path: KeyPath) -> None:
        for i, k in enumerate(indices):
            if self._landmarks is not None and k >= self._count:
                self._report.add((*path, i), f"expected a landmark from 0 to {self._count - 1}, got {k}")
            elif k in self._removed:
                self._report.add((*path, i), f"expected a landmark that is to be seen, {k} is removed before")

    def _leave(self, name: str, path: KeyPath) -> None:
        if name not in self._present:
            near = nearest(name, self._present)
            hint = f"did you mean {near!r}?" if near else ""
            self._report.add(path, f"expected the name of an agent that takes part, got {name[:60]!r}", hint)
        elif len(self._present) == 1:
            self._report.add(path, "expected an agent to be left")
        else:
            self._present.remove(name)

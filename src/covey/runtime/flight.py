"""What flying a mission gives: the deployment, and everything over time."""

from __future__ import annotations

import base64
import html
import io
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from covey.flight.obstacles import Obstacle
from covey.geometry import Pose2
from covey.runtime.result import Deployment
from covey.vehicles.flight_log import FlightLog

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class Moment(NamedTuple):
    """The committed state of a team from a time on.

    Parameters
    ----------
    time : float
        Seconds since the flight began.
    owner : array, shape (n,)
        Index of each landmark's owner.
    poses : tuple of Pose2
        The committed poses.
    """

    time: float
    owner: NDArray[np.int64]
    poses: tuple[Pose2, ...]


@dataclass(frozen=True, eq=False)
class Flight:
    """A mission that was flown.

    Parameters
    ----------
    deployment : Deployment
        What the team settled on, with `Deployment.flight`.
    log : FlightLog
        Everything over time.
    obstacles : tuple of Obstacle
        Those of the mission, and those that appeared.
    appeared : tuple of float
        When each of them did, seconds; 0 for those of the mission.
    moments : tuple of Moment
        Who owned what, each time that it changed.

    Notes
    -----
    Notebooks show a flight by its figure.
    """

    deployment: Deployment
    log: FlightLog
    obstacles: tuple[Obstacle, ...]
    appeared: tuple[float, ...]
    moments: tuple[Moment, ...]

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the flight.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Where to draw the paths on the map alone; without it a figure is made that also shows score, events,
            separation, altitude and error over time.

        Returns
        -------
        matplotlib Axes
            The axes of the map; ``.figure.savefig(...)`` saves the whole figure.

        Raises
        ------
        ArgumentError
            If it ended before there was anything to draw.

        See Also
        --------
        covey.runtime.drawing.flight_figures : position, errors, V, speed and more over time.
        """
        from covey.runtime.drawing import flight_figures, flight_paths
        from covey.runtime.drawing.flight_drawing import check_log

        if ax is None:
            return flight_figures.flight_overview(self.log, self.deployment, obstacles=self.obstacles).axes[0]
        check_log(self.log)
        frame = flight_paths.plan_frame(self.log, self.deployment.mission, obstacles=self.obstacles)
        flight_paths.draw_plan(ax, self.log, self.deployment, frame, self.obstacles)
        return ax

    def save(self, directory: str | Path, *, overwrite: bool = False, film: bool = False) -> Path:
        """Write what `Deployment.save` writes, the log (``flight.npz``) and figures (``flight.png``, ``flight.pdf``).

        Parameters
        ----------
        directory : str or Path
            Where to; it is made if need be.
        overwrite : bool
            Replace an earlier result of covey there.  Other files in the directory stay as they are.
        film : bool
            Add a film when all else is there: ``flight.mp4``, or ``flight.gif`` without ffmpeg.

        Returns
        -------
        Path
            The directory.

        Raises
        ------
        OutputError
            If something is there already, or it cannot be written.  Nothing is left half-written.
        """
        from covey.runtime.records import sortie_record

        target = sortie_record.write_flight(self, directory, overwrite=overwrite)
        if film:
            sortie_record.film_flight(self, target)
        return target

    def _repr_png_(self) -> bytes | None:
        if len(self.log.time) < 2:  # it ended before there was anything to draw
            return None
        from covey.runtime.drawing import figures, flight_figures

        figure = flight_figures.flight_overview(self.log, self.deployment, obstacles=self.obstacles)
        buffer = io.BytesIO()
        figures.save_figure(figure, buffer, kind="png")
        return buffer.getvalue()

    def _repr_html_(self) -> str:
        picture, text = self._repr_png_(), html.escape(repr(self))
        if picture is None:
            return text
        image = base64.b64encode(picture).decode("ascii")
        return f'<img src="data:image/png;base64,{image}" style="max-width: 100%" alt="{text}">'

    def __repr__(self) -> str:
        deployment, count = self.deployment, len(self.deployment.agents)
        duration = self.log.time[-1] - self.log.time[0] if len(self.log.time) else 0.0
        return (
            f"Flight({deployment.mission.name!r}, {count} agent{'s' * (count != 1)}, {duration:.1f} s in "
            f"{self.log.simulator}, score {deployment.score.final:.2f}, {deployment.status.value})"
        )

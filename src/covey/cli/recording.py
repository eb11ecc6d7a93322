"""Every run is recorded: where the record is while it goes on, and where it ends up."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType

import typer

from covey.errors import OutputError
from covey.runtime.records.mcap_record import Recorder, partial_path
from covey.runtime.records.record import RECORD


class Recording:
    """Records a run beside its result directory; a context that completes the record, whatever happens.

    Parameters
    ----------
    target : Path
        The result directory.
    quiet : bool
        Say nothing.

    Attributes
    ----------
    recorder : Recorder
        The watcher to give to the run.
    """

    def __init__(self, target: Path, *, quiet: bool) -> None:
        self._target = target
        self._quiet = quiet
        self.recorder = Recorder(partial_path(target), on_open=self._say)

    def __enter__(self) -> Recording:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.recorder.close()
        if error is not None and self.recorder.path.exists():
            typer.echo(f"covey: the record up to here is in {self.recorder.path}", err=True)

    def keep(self) -> None:
        """Move the record into the result directory, which is there by now.

        Raises
        ------
        OutputError
            If the record could not be written, or not be moved; it is then where it was.
        """
        self.recorder.move(self._target / RECORD)

    def lost(self, failure: OutputError) -> OutputError:
        """Return the failure to write the result, with where the record is."""
        self.recorder.close()
        if not self.recorder.path.exists():
            return failure
        return OutputError(f"{failure}; the record of the run is in {self.recorder.path}")

    def _say(self, path: Path) -> None:
        if not self._quiet:
            typer.echo(f"covey: recording to {path}", err=True)

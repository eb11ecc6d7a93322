"""A film of a flight: the map from above with the vehicles on it, charts over time, and the scene if there is one.

With ffmpeg it is an mp4 (H.264), otherwise an animated gif.
"""

from __future__ import annotations

import contextlib
import importlib
import math
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from covey.errors import ArgumentError, OutputError
from covey.geometry import Pose2
from covey.runtime.drawing.film_frames import FilmFrames, Pixels, Scene
from covey.runtime.drawing.flight_drawing import check_log
from covey.runtime.records.output import staged
from covey.vehicles.flight_log import FlightLog

if TYPE_CHECKING:
    from covey.flight.obstacles import Obstacle
    from covey.mission import Mission

FPS = 25
"""Pictures a second of an mp4."""

GIF_FPS = 10
"""Pictures a second of a gif."""

DPI, GIF_DPI = 100, 62.5
"""1280 x 720 and 800 x 450 pixels."""

LONGEST = 26.0
"""Seconds that a film lasts at most when the speed is chosen here."""

SPEEDS = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0)

HOLD = 1.5
"""Seconds for which the last picture stays."""

ENCODERS_TIMEOUT = 20.0
"""Seconds that ffmpeg may take to list its encoders."""

Report = Callable[[float], None]


def write_film(
    log: FlightLog,
    path_stem: str | Path,
    *,
    mission: Mission | None,
    snapshots: Sequence[tuple[float, NDArray[np.int64], Sequence[Pose2]]] = (),
    speed: float | None = None,
    scene: Scene | None = None,
    obstacles: Sequence[Obstacle] = (),
    appeared: Sequence[float] = (),
    on_progress: Report | None = None,
) -> Path:
    """Make a film of a flight, whole or not at all.

    Parameters
    ----------
    log : FlightLog
    path_stem : str or Path
        The file without its suffix; ``.mp4`` is added if there is an ffmpeg that can write H.264, else ``.gif``.
    mission : Mission or None
        For its map; its agents are the vehicles of the log, in the same order.
    snapshots : sequence of (time, owner, poses)
        The committed state from a time on: the owner of each landmark, -1 for none, and the poses.
    speed : float, optional
        How much faster than the flight the film runs; by default such that it lasts 26 s at most.
    scene : callable, optional
        Gives a picture of the scene at a time in seconds, uint8 of shape (height, width, 3), or None to keep the last.
        It is shown some 620 pixels wide.
    obstacles : sequence of Obstacle
    appeared : sequence of float
        When each obstacle appeared, seconds: it is not shown before; without, all are there from the start.
    on_progress : callable, optional
        Is told how much is done, from 0 to 1.

    Returns
    -------
    Path
        The film.

    Raises
    ------
    ArgumentError
        If the log is empty, does not fit the mission, the speed is not positive, or `appeared` not of each obstacle.
    OutputError
        If there is such a file already, it cannot be written, or ffmpeg fails.
    """
    _check(log, mission, snapshots, speed)
    if len(appeared) not in (0, len(obstacles)):
        raise ArgumentError(f"appeared: expected one time an obstacle, {len(obstacles)}, got {len(appeared)}")
    speed = choose_speed(float(log.time[-1] - log.time[0])) if speed is None else float(speed)
    ffmpeg = find_ffmpeg()
    target = Path(f"{path_stem}.mp4" if ffmpeg else f"{path_stem}.gif")
    if os.path.lexists(target):
        raise OutputError(f"{target}: is there already; choose another name or remove it")
    times = film_times(log, speed, FPS if ffmpeg else GIF_FPS)
    frames = FilmFrames(
        log,
        times,
        mission=mission,
        moments=snapshots,
        obstacles=obstacles,
        appeared=appeared,
        dpi=DPI if ffmpeg else GIF_DPI,
        speed=speed,
        scene=scene,
    )
    encode_film(frames, target, ffmpeg, on_progress)
    return target


class Frames(Protocol):
    """The pictures of a film."""

    @property
    def times(self) -> NDArray[np.float64]:
        """The moment that each picture shows, seconds."""
        ...

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, pixels."""
        ...

    def picture(self, index: int) -> Pixels:
        """Draw a picture; one after the other is fastest."""
        ...

    def rewind(self) -> None:
        """Begin anew."""
        ...


def encode_film(frames: Frames, target: Path, ffmpeg: str | None, on_progress: Report | None) -> None:
    """Write pictures to a film, whole or not at all: an mp4 with an ffmpeg, a gif without one.

    Raises
    ------
    OutputError
        If it cannot be written, or ffmpeg fails.
    """
    with staged(target.parent, [target.name]) as folder:
        pictures = _told(frames, on_progress)
        if ffmpeg:
            _write_mp4(ffmpeg, pictures, frames.size, folder / target.name)
        else:
            _write_gif(frames, pictures, folder / target.name)


def choose_speed(duration: float) -> float:
    """Return how much faster than a flight of so many seconds its film is: a round number.

    Examples
    --------
    >>> choose_speed(20.0), choose_speed(75.0)
    (1.0, 3.0)
    """
    return next((speed for speed in SPEEDS if duration / speed <= LONGEST), math.ceil(duration / LONGEST))


def film_times(log: FlightLog, speed: float, fps: int) -> NDArray[np.float64]:
    """Return the moment of the flight that each picture shows, the last one the end; seconds."""
    count = max(2, math.ceil((log.time[-1] - log.time[0]) / speed * fps - 1e-6) + 1)
    times: NDArray[np.float64] = np.minimum(log.time[0] + np.arange(count) * speed / fps, log.time[-1])
    return times


def find_ffmpeg() -> str | None:
    """Return an ffmpeg that can write H.264: that of the system or of the package imageio-ffmpeg; None without one."""
    bundled = None
    with contextlib.suppress(ImportError, RuntimeError):
        bundled = importlib.import_module("imageio_ffmpeg").get_ffmpeg_exe()
    for program in (shutil.which("ffmpeg"), bundled):
        if program is None:
            continue
        with contextlib.suppress(OSError, subprocess.SubprocessError):
            command = [program, "-hide_banner", "-encoders"]
            listed = subprocess.run(
                command, stdin=subprocess.DEVNULL, capture_output=True, timeout=ENCODERS_TIMEOUT, check=True
            )
            if b"libx264" in listed.stdout:
                return str(program)
    return None


def _told(frames: Frames, on_progress: Report | None) -> Iterator[Pixels]:
    count = len(frames.times)
    for index in range(count):
        yield frames.picture(index)
        if on_progress is not None:
            on_progress((index + 1) / count)


def _write_mp4(program: str, pictures: Iterator[Pixels], size: tuple[int, int], path: Path) -> None:
    command = [program, "-hide_banner", "-loglevel", "error", "-y"]
    command += ["-f", "rawvideo", "-pix_fmt", "rgba", "-video_size", f"{size[0]}x{size[1]}", "-framerate", str(FPS)]
    command += ["-i", "pipe:0", "-an", "-vf", "scale=out_color_matrix=bt709:out_range=tv,format=yuv420p"]
    command += ["-c:v", "libx264", "-preset", "veryfast", "-crf", "20", "-colorspace", "bt709"]
    command += ["-color_primaries", "bt709", "-color_trc", "bt709", "-color_range", "tv"]
    command += ["-movflags", "+faststart", "-map_metadata", "-1", "-fflags", "+bitexact", "-f", "mp4", str(path)]
    # In a session of its own: a Ctrl-C is for us, and we end it.
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True
    ) as process:
        try:
            assert process.stdin is not None
            last = np.empty(0, dtype=np.uint8)
            with contextlib.suppress(BrokenPipeError):
                for pixels in pictures:
                    last = np.ascontiguousarray(pixels)
                    process.stdin.write(last.data)
                for _ in range(round(HOLD * FPS)):
                    process.stdin.write(last.data)
            _, errors = process.communicate()
        except BaseException:
            process.kill()
            raise
    if process.returncode != 0:
        reason = errors.decode(errors="replace").strip().splitlines()
        raise OutputError(f"{path.name}: ffmpeg failed: {reason[-1] if reason else process.returncode}")


def _write_gif(frames: Frames, pictures: Iterator[Pixels], path: Path) -> None:
    from PIL import Image

    samples = [frames.picture(index)[::2, ::2, :3] for index in (0, len(frames.times) // 2, len(frames.times) - 1)]
    palette = Image.fromarray(np.concatenate(samples)).quantize(255, method=Image.Quantize.MEDIANCUT)
    frames.rewind()

    def images() -> Iterator[Image.Image]:
        for pixels in pictures:
            image = Image.fromarray(np.ascontiguousarray(pixels[:, :, :3]))
            yield image.quantize(palette=palette, dither=Image.Dither.NONE)

    flow = images()
    first = next(flow)
    pause = 1000 // GIF_FPS
    durations = [pause] * (len(frames.times) - 1) + [round(1000 * HOLD)]
    with path.open("wb") as file:
        first.save(file, "GIF", save_all=True, append_images=flow, duration=durations, loop=0, optimize=False)


def _check(
    log: FlightLog,
    mission: Mission | None,
    snapshots: Sequence[tuple[float, NDArray[np.int64], Sequence[Pose2]]],
    speed: float | None,
) -> None:
    check_log(log)
    if not log.time[-1] > log.time[0]:
        raise ArgumentError(f"log: expected a flight of some duration, got {log.time[-1] - log.time[0]:g} s")
    if speed is not None and not (math.isfinite(speed) and speed > 0.0):
        raise ArgumentError(f"speed: expected a number above 0, got {speed}")
    if mission is None:
        return
    if len(mission.agents) != len(log.names):
        raise ArgumentError(f"mission: expected {len(log.names)} agents, as in the log, got {len(mission.agents)}")
    for _, owner, _ in snapshots:
        if np.shape(owner) != (len(mission.landmarks),):
            raise ArgumentError(
                f"snapshots: expected an owner for each of {len(mission.landmarks)} landmarks, got {np.shape(owner)}"
            )
        if np.max(owner, initial=-1) >= len(mission.agents) or np.min(owner, initial=-1) < -1:
            raise ArgumentError(f"snapshots: expected owners from -1 to {len(mission.agents) - 1}")

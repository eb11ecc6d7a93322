"""Pictures of a recorded flight in three dimensions, rendered without a screen by MuJoCo's renderer.

Needs ``mujoco`` and, on Linux, PyOpenGL with a library of EGL or OSMesa; `why_no_pictures` says what is missing.
"""

from __future__ import annotations

import functools
import importlib
import os
import sys
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from covey.errors import ArgumentError
from covey.flight.layout import OBSERVATION, QUAT, P
from covey.runtime.drawing.palette import rgb
from covey.runtime.drawing.scene_model import CONCRETE, FOV, Stage, paint_ground, scene_model

EDGE = 0.08
"""Share of the picture left free around what `frame_all` shows."""


@dataclass(frozen=True, slots=True)
class View:
    """Where the camera is: on a circle around a point, looking at it.

    Parameters
    ----------
    centre_W : three floats
        What is in the middle of the picture, frame W, metres.
    distance : float
        Metres.
    azimuth : float
        Direction of looking, rad: 0 along x, pi / 2 along y.
    elevation : float
        Angle of looking, rad; negative looks down.
    """

    centre_W: tuple[float, float, float]
    distance: float
    azimuth: float
    elevation: float


@functools.cache
def why_no_pictures() -> str | None:
    """Say what is missing for `SceneCamera`, or return None if it works here."""
    try:
        context = _context(16, 16)
    except _Unavailable as error:
        return str(error)
    context.free()
    return None


def frame_all(
    stage: Stage,
    p_W: NDArray[np.float64],
    *,
    azimuth: float = 0.85,
    elevation: float = -0.5,
    aspect: float = 16.0 / 9.0,
) -> View:
    """Choose the nearest view that shows the whole ground and all positions of a flight.

    Parameters
    ----------
    stage : Stage
    p_W : array, shape (..., 3)
        Positions to keep in the picture, frame W, metres.
    azimuth, elevation : float
        As in `View`, rad.
    aspect : float
        Width over height of the picture.
    """
    (x0, y0), (x1, y1) = stage.low_W, stage.high_W
    corners = np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x0, y1, 0.0], [x1, y1, 0.0]])
    places = np.asarray(p_W, dtype=np.float64).reshape(-1, 3)
    places = np.concatenate([corners, places[np.isfinite(places).all(axis=1)]])
    sa, ca, se, ce = np.sin(azimuth), np.cos(azimuth), np.sin(elevation), np.cos(elevation)
    forward, right, up = np.array([ce * ca, ce * sa, se]), np.array([sa, -ca, 0.0]), np.array([-se * ca, -se * sa, ce])
    middle = corners.mean(axis=0)
    depth = (places - middle) @ forward
    distance, centre = 0.0, middle
    for axis, slope in ((right, aspect * np.tan(FOV / 2.0)), (up, np.tan(FOV / 2.0))):
        # a point at offset a and depth c is in the picture of half-width slope (distance + c)
        offset, most = (places - middle) @ axis, slope * depth / (1.0 + EDGE)
        high, low = float((offset - most).max()), float((-offset - most).max())
        distance = max(distance, (1.0 + EDGE) * (high + low) / (2.0 * slope))
        centre = centre + axis * (high - low) / 2.0
    return View((float(centre[0]), float(centre[1]), float(centre[2])), distance, azimuth, elevation)


class SceneCamera:
    """Draws moments of a flight.

    Parameters
    ----------
    stage : Stage
    width, height : int
        Of a picture, pixels.

    Raises
    ------
    ArgumentError
        If there is nothing here to render with; `why_no_pictures` says so beforehand.

    Examples
    --------
    ::

        with SceneCamera(stage) as camera:
            picture = camera.picture(log.state[k], frame_all(stage, log.state[:, :, :3]))
    """

    def __init__(self, stage: Stage, *, width: int = 1280, height: int = 720) -> None:
        missing = why_no_pictures()
        if missing is not None:
            raise ArgumentError(f"scene camera: {missing}")
        import mujoco

        self.stage, self.width, self.height = stage, width, height
        self._model = scene_model(stage, width, height)
        self._data = mujoco.MjData(self._model)
        names = [self._model.geom(g).name for g in range(self._model.ngeom)]
        self._obstacles = [
            [g for g, name in enumerate(names) if name.startswith(f"obstacle {k}.")]
            for k in range(len(stage.obstacles))
        ]
        self._context = _context(width, height)
        self._context.make_current()
        self._gl = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._gl)
        self._scene = mujoco.MjvScene(self._model, maxgeom=20_000)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_HAZE] = 1
        self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        self._options, self._eye = mujoco.MjvOption(), mujoco.MjvCamera()
        self._shown: tuple[str | None, ...] | None = None
        self._paint(None)

    def picture(
        self,
        state: NDArray[np.float64],
        view: View,
        *,
        objects_W: NDArray[np.float64] | None = None,
        landmark_colours: Sequence[str | None] | None = None,
        trails_W: NDArray[np.float64] | None = None,
        hidden: Collection[int] = (),
    ) -> NDArray[np.uint8]:
        """Draw one moment.

        Parameters
        ----------
        state : array, shape (n, 13 or more)
            Columns as in `covey.flight.layout`.
        view : View
        objects_W : array, shape (number of objects, 3), optional
            Centres of the moving objects, frame W, metres.
        landmark_colours : sequence of str or None, optional
            ``#rrggbb`` of each landmark's square, None for one that nobody owns.
        trails_W : array, shape (k, n, 3), optional
            Where the vehicles were, oldest first, frame W, metres.
        hidden : collection of int, optional
            Which obstacles are not there.

        Returns
        -------
        array of uint8, shape (height, width, 3)

        Raises
        ------
        ArgumentError
            If an array's shape does not fit the stage.
        """
        import mujoco

        stage, n, m = self.stage, len(self.stage.vehicles), len(self.stage.object_radii)
        state = np.asarray(state, dtype=np.float64)
        if state.ndim != 2 or len(state) != n or state.shape[1] < OBSERVATION:
            raise ArgumentError(f"state: expected shape ({n}, {OBSERVATION} or more), got {state.shape}")
        objects = np.zeros((0, 3)) if objects_W is None else np.asarray(objects_W, dtype=np.float64)
        if objects.shape not in ((m, 3), (0, 3)):
            raise ArgumentError(f"objects_W: expected shape ({m}, 3), got {objects.shape}")
        if trails_W is not None and trails_W.shape[1:] != (n, 3):
            raise ArgumentError(f"trails_W: expected shape (k, {n}, 3), got {trails_W.shape}")
        self._context.make_current()
        self._paint(landmark_colours)
        self._data.mocap_pos[:n] = state[:, P : P + 3]
        self._data.mocap_quat[:n] = state[:, QUAT : QUAT + 4]
        if len(objects):
            self._data.mocap_pos[n:] = objects
        for k, pieces in enumerate(self._obstacles):
            self._model.geom_rgba[pieces, 3] = 0.0 if k in hidden else CONCRETE[3]
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        self._eye.lookat[:] = view.centre_W
        self._eye.distance, self._eye.azimuth = view.distance, np.degrees(view.azimuth)
        self._eye.elevation = np.degrees(view.elevation)
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(self._model, self._data, self._options, None, self._eye, everything, self._scene)
        width = 0.0016 * view.distance
        for i in range(n):
            colour = rgb(stage.colours[i])
            self._line(state[i, :3], np.array([*state[i, :2], 0.0]), 0.35 * width, (*colour, 0.45))
            if trails_W is not None:
                for k, (a, b) in enumerate(zip(trails_W[:-1, i], trails_W[1:, i], strict=True)):
                    self._line(a, b, width, (*colour, 0.1 + 0.8 * (k + 1) / len(trails_W)))
        pixels = np.empty((self.height, self.width, 3), dtype=np.uint8)
        rectangle = mujoco.MjrRect(0, 0, self.width, self.height)
        mujoco.mjr_render(rectangle, self._scene, self._gl)
        mujoco.mjr_readPixels(pixels, None, rectangle, self._gl)
        return np.ascontiguousarray(pixels[::-1])

    def close(self) -> None:
        """Free what the graphics library holds."""
        if self._gl is not None:
            self._context.make_current()
            self._gl.free()
            self._context.free()
            self._gl = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def _line(self, a: NDArray[np.float64], b: NDArray[np.float64], width: float, rgba: Sequence[float]) -> None:
        import mujoco

        if self._scene.ngeom >= self._scene.maxgeom or not np.isfinite([a, b]).all() or np.allclose(a, b):
            return
        geom = self._scene.geoms[self._scene.ngeom]
        kind = mujoco.mjtGeom.mjGEOM_CAPSULE
        mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), np.array(rgba, dtype=np.float32))
        mujoco.mjv_connector(geom, kind, width, a, b)
        geom.category = mujoco.mjtCatBit.mjCAT_DECOR
        self._scene.ngeom += 1

    def _paint(self, colours: Sequence[str | None] | None) -> None:
        """Paint the ground, if its colours have changed."""
        import mujoco

        landmarks = self.stage.landmarks_W
        m = 0 if landmarks is None else len(landmarks)
        wanted = tuple(colours) if colours is not None else (None,) * m
        if len(wanted) != m:
            raise ArgumentError(f"landmark_colours: expected one a landmark, {m}, got {len(wanted)}")
        if wanted == self._shown:
            return
        texture = self._model.texture("ground").id
        pixels = paint_ground(self.stage, wanted)
        begin = int(self._model.tex_adr[texture])
        self._model.tex_data[begin : begin + pixels.size] = pixels.ravel()
        mujoco.mjr_uploadTexture(self._model, self._gl, texture)
        self._shown = wanted


def pictures(
    stage: Stage,
    time: NDArray[np.float64],
    state: NDArray[np.float64],
    *,
    objects_W: NDArray[np.float64] | None = None,
    landmark_colours: Sequence[Sequence[str | None]] | None = None,
    fps: float = 25.0,
    speed: float = 1.0,
    trail_s: float = 4.0,
    turn: float = 0.0,
    width: int = 960,
    height: int = 540,
) -> Iterator[NDArray[np.uint8]]:
    """Draw a recorded flight, picture by picture.

    Parameters
    ----------
    stage : Stage
    time : array, shape (k,)
        Seconds, rising.
    state : array, shape (k, n, 13)
        Columns as in `covey.flight.layout`.
    objects_W : array, shape (k, number of objects, 3), optional
        Frame W, metres.
    landmark_colours : sequence of k sequences, optional
        For each moment, as in `SceneCamera.picture`.
    fps : float
        Pictures a second of film.
    speed : float
        Seconds of flight a second of film.
    trail_s : float
        Seconds of flight that the trails show.
    turn : float
        How fast the camera goes around, rad a second of film.
    width, height : int
        Pixels.

    Yields
    ------
    array of uint8, shape (height, width, 3)
    """
    time = np.asarray(time, dtype=np.float64)
    count = int((time[-1] - time[0]) / speed * fps) + 1
    with SceneCamera(stage, width=width, height=height) as camera:
        home = frame_all(stage, state[:, :, :3], aspect=width / height)
        for k in range(count):
            now = time[0] + k * speed / fps
            row = min(int(np.searchsorted(time, now)), len(time) - 1)
            first = int(np.searchsorted(time, now - trail_s))
            stride = max(1, (row - first) // 60)
            yield camera.picture(
                state[row],
                View(home.centre_W, home.distance, home.azimuth + turn * k / fps, home.elevation),
                objects_W=None if objects_W is None else objects_W[row],
                landmark_colours=None if landmark_colours is None else landmark_colours[row],
                trails_W=state[first : row + 1 : stride, :, :3],
            )


class _Unavailable(Exception):
    """There is nothing to render with; the text says what is missing."""


def _context(width: int, height: int) -> Any:
    """Open an offscreen context: what MUJOCO_GL asks for, else the first that works."""
    wanted = os.environ.get("MUJOCO_GL", "").lower()
    if wanted in ("disable", "disabled", "off", "false", "0"):
        raise _Unavailable(f"rendering is switched off by MUJOCO_GL={wanted}")
    default = {"linux": ("egl", "osmesa"), "darwin": ("cgl",)}.get(sys.platform, ("glfw",))
    platforms = (wanted,) if wanted in ("egl", "osmesa", "glfw", "cgl") else default
    unset = "MUJOCO_GL" not in os.environ
    failures = []
    for platform in platforms:
        if unset:
            os.environ["MUJOCO_GL"] = platform
        try:
            return importlib.import_module(f"mujoco.{platform}").GLContext(width, height)
        except _refusals() as error:
            failures.append(f"{platform}: {type(error).__name__}: {error}")
        finally:
            if unset:
                del os.environ["MUJOCO_GL"]
    reasons = "; ".join(failures)
    raise _Unavailable(
        "expected mujoco-core, PyOpenGL and a library of EGL or OSMesa (Debian: libegl1, libgl1-mesa-dri), "
        f"got {reasons}"
    )


def _refusals() -> tuple[type[Exception], ...]:
    """What is raised where a package or library is missing or a driver refuses."""
    errors = (ImportError, AttributeError, OSError, RuntimeError, TypeError)
    try:
        return (*errors, importlib.import_module("OpenGL.error").Error)
    except ImportError:
        return errors


__all__ = ["SceneCamera", "Stage", "View", "frame_all", "pictures", "why_no_pictures"]

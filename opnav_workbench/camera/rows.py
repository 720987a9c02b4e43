"""Lines that are not exposed together: rolling shutters, line scanners, and how the camera turns meanwhile.

Flow   camera file -> `RowTiming`; attitudes around the middle of the picture -> `row_sweep` -> `RowSweep`, which a `Camera`
       carries for one picture: its directions are in the camera's frame at mid-picture, its lines at their own times
Times  s from the middle of the middle line's exposure, which is the time of the picture

Rolling shutter   a direction v falls on the line l that it has when l is exposed: ``line(R(t_l) v) = l``
Line scan         every line of the picture is the same line d of the detector: ``line(R(t_l) v) = d``

with R(t) the camera's turn since mid-picture, ``camera(t) from camera(0)``. Both are solved by Newton's method.

What kernels tell wrongly of a camera is how it is mounted: it flies the path that they have, turned by a rotation E that
stays the same in the camera's frame. With E the turns themselves become ``E R(t) E^T`` (`RowSweep.standing`): a camera that
is twisted against its path is drawn along the same strip of the sky, not along one turned with it.

Reference: Geyer, Meingast & Sastry 2005, "Geometric models of rolling-shutter cameras"; Gupta & Hartley 1997, IEEE TPAMI
19, 963 (linear pushbroom cameras).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np
import scipy
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.errors import CameraError
from opnav_workbench.geometry.rotations import rotation_from_vector, unit, vector_from_rotation

__all__ = ["RowSweep", "RowTiming", "row_sweep"]

Mapping: TypeAlias = Callable[[FloatArray], FloatArray]

STEPS = 30  # of Newton's method, which takes 3 or 4
SOLVED_LINES = 1e-9
STEP_LINES = 0.5  # of the differences that give the rate of a turn
STARTS = 65  # lines from which the search begins again where the middle one does not see a direction
FEWEST, MOST = 9, 4097  # attitudes; the most for a shaking CK
TOLERANCE_PX = 0.005  # between the attitudes and what is drawn through them


@dataclass(frozen=True, slots=True)
class RowTiming:
    """When the lines of a picture are exposed.

    Attributes
    ----------
    line_time_s
        From a line to the next one; negative where the last line comes first.
    detector_line
        Of a line scanner: the line of the detector that all lines of the picture come from; None: a rolling shutter.
    tdi_lines
        Of a scanner with time delay and integration: lines through which the charge follows the scan. An exposure then
        lasts as many line times, and smears by one.
    """

    line_time_s: float
    detector_line: float | None = None
    tdi_lines: int = 1

    def __post_init__(self) -> None:
        if not (np.isfinite(self.line_time_s) and self.line_time_s != 0.0):
            raise CameraError(
                f"line_time_s is {self.line_time_s}; give the time from a line to the next one, s."
            )
        if self.tdi_lines < 1 or (self.tdi_lines > 1 and self.detector_line is None):
            raise CameraError(
                f"tdi_lines is {self.tdi_lines}; give how many lines of a line scanner (detector_line) a charge passes."
            )

    def span_s(self, n_line: int) -> float:
        """Time from the first line that is exposed to the last."""
        return abs(self.line_time_s) * (n_line - 1)

    @property
    def scans(self) -> bool:
        """Whether a scan makes the picture, not a frame."""
        return self.detector_line is not None


@dataclass(frozen=True, slots=True, eq=False)
class RowSweep:
    """How a camera turns while the lines of one picture are exposed; arrays are read-only.

    Attributes
    ----------
    line_time_s, detector_line
        As of `RowTiming`.
    middle_line
        Whose time is that of the picture.
    time_s : (k,) array
        Ascending, from `middle_line`'s.
    turn_rad : (k, 3) array
        Rotation vectors of ``camera(t) from camera(0)``, camera frame; before and after them the turn goes on evenly.
    camera_from_j2000 : (3, 3) array
        Attitude at mid-picture for which they are.
    follows
        The body whose motion is in the turn besides the camera's (`opnav_workbench.scene.following`); empty: none's.
    spread : (k, 3, 3) array or None
        At `time_s`, how that body's limb lies about its center otherwise than at mid-picture: it takes directions of
        mid-picture, camera frame, to others, before the turn.
    """

    line_time_s: float
    middle_line: float
    detector_line: float | None
    time_s: FloatArray
    turn_rad: FloatArray
    camera_from_j2000: FloatArray
    follows: str = ""
    spread: FloatArray | None = None
    _spline: "scipy.interpolate.CubicSpline" = field(init=False, repr=False)

    def __post_init__(self) -> None:
        known = self.turn_rad
        if self.spread is not None:
            known = np.column_stack([known, self.spread.reshape(len(known), -1)])
        object.__setattr__(self, "_spline", scipy.interpolate.CubicSpline(self.time_s, known))
        freeze_arrays(self)

    def standing(self, camera_from_j2000: FloatArray) -> "RowSweep":
        """Return how a camera turns that stands otherwise at mid-picture (3, 3), and flies the same path."""
        if np.array_equal(camera_from_j2000, self.camera_from_j2000):
            return self
        turned = camera_from_j2000 @ self.camera_from_j2000.T
        return replace(
            self,
            turn_rad=self.turn_rad @ turned.T,
            camera_from_j2000=np.array(camera_from_j2000),
            spread=None if self.spread is None else turned @ self.spread @ turned.T,
        )

    def times_s(self, line: ArrayLike) -> FloatArray:
        """Return the times (...,), s from that of the picture, at which lines (...,) are exposed."""
        return np.asarray((np.asarray(line, dtype=np.float64) - self.middle_line) * self.line_time_s)

    def turns(self, line: FloatArray) -> FloatArray:
        """Return ``camera(line's time) from camera(0)``, (..., 3, 3), at lines (...,); with `spread`, no rotation alone."""
        time = self.times_s(line)
        known = np.clip(time, self.time_s[0], self.time_s[-1])
        beyond = np.nan_to_num(time - known)[..., None]
        vector = self._spline(known) + self._spline(known, 1) * beyond
        turns = rotation_from_vector(np.nan_to_num(vector[..., :3]).reshape(-1, 3)).reshape(
            *np.shape(time), 3, 3
        )
        if self.spread is None:
            return turns
        return np.asarray(turns @ vector[..., 3:].reshape(*np.shape(time), 3, 3))

    def _back(self, line: FloatArray) -> FloatArray:
        """Return ``camera(0) from camera(line's time)``."""
        turns = self.turns(line)
        return np.asarray(
            np.swapaxes(turns, -1, -2) if self.spread is None else np.linalg.inv(turns), np.float64
        )

    def _rates(self, line: FloatArray) -> FloatArray:
        """Change of `turns` from a line to the next one."""
        return (self.turns(line + STEP_LINES) - self.turns(line - STEP_LINES)) / (2.0 * STEP_LINES)

    def project(self, vectors: FloatArray, project: Mapping, jacobian: Mapping) -> FloatArray:
        """Return (pixel, line) (..., 2) of directions (..., 3) at mid-picture, by the mapping of the camera at rest."""
        given = vectors.reshape(-1, 3)
        places = self._solved(given, np.full(len(given), self.middle_line), project, jacobian)
        lost = np.flatnonzero(np.isnan(places[:, 0]) & np.isfinite(given).all(axis=1))
        if len(lost):
            start = self._nearest_lines(given[lost], project)
            places[lost] = self._solved(given[lost], start, project, jacobian)
        return places.reshape(*vectors.shape[:-1], 2)

    def _nearest_lines(self, vectors: FloatArray, project: Mapping) -> FloatArray:
        """Of many lines the one when a direction is nearest to where that line is exposed; nan where none sees it."""
        if not np.any(self.line_time_s):
            return np.full(len(vectors), np.nan)
        lines = self.middle_line + np.linspace(self.time_s[0], self.time_s[-1], STARTS) / self.line_time_s
        seen = project(np.einsum("kij,nj->nki", self.turns(lines), vectors))[..., 1]
        off = np.abs(seen - (lines if self.detector_line is None else self.detector_line))
        best = np.argmin(np.where(np.isnan(off), np.inf, off), axis=1)
        return np.where(np.isnan(off).all(axis=1), np.nan, lines[best])

    def _solved(
        self, vectors: FloatArray, start: FloatArray, project: Mapping, jacobian: Mapping
    ) -> FloatArray:
        line, places = start.copy(), np.full((len(vectors), 2), np.nan)
        open_ = np.flatnonzero(np.isfinite(start))
        for _ in range(STEPS):
            if not len(open_):
                break
            at, along = self._at_line(vectors[open_], line[open_], project, jacobian)
            slope = along[:, 1] - (0.0 if self.detector_line is not None else 1.0)
            goal = line[open_] if self.detector_line is None else self.detector_line
            with np.errstate(divide="ignore", invalid="ignore"):
                step = -(at[:, 1] - goal) / slope
            line[open_] += step
            done = np.abs(step) < SOLVED_LINES
            places[open_[done]] = np.column_stack([at[done, 0], line[open_[done]]])
            open_ = open_[~done & np.isfinite(step)]
        return places

    def _at_line(
        self, vectors: FloatArray, line: FloatArray, project: Mapping, jacobian: Mapping
    ) -> tuple[FloatArray, FloatArray]:
        """Where directions fall on the detector at a line's time, and how fast they move, px a line."""
        there = np.einsum("...ij,...j->...i", self.turns(line), vectors)
        moving = np.einsum("...ij,...j->...i", self._rates(line), vectors)
        return project(there), np.einsum("...ij,...j->...i", jacobian(there), moving)

    def project_jacobian(self, vectors: FloatArray, places: FloatArray, jacobian: Mapping) -> FloatArray:
        """Return d(pixel, line)/d(direction at mid-picture) (..., 2, 3), at directions and where they fall."""
        turns = self.turns(places[..., 1])
        at_rest = jacobian(np.einsum("...ij,...j->...i", turns, vectors))
        moving = np.einsum("...ij,...j->...i", self._rates(places[..., 1]), vectors)
        along = np.einsum("...ij,...j->...i", at_rest, moving)
        still = at_rest @ turns
        line = still[..., 1, :] / ((1.0 if self.detector_line is None else 0.0) - along[..., 1])[..., None]
        return np.stack([still[..., 0, :] + along[..., :1] * line, line], axis=-2)

    def on_detector(self, points: FloatArray) -> FloatArray:
        """Return where on the detector points (..., 2) of the picture were exposed."""
        if self.detector_line is None:
            return points
        return np.stack([points[..., 0], np.full(points.shape[:-1], self.detector_line)], axis=-1)

    def unproject(self, points: FloatArray, unproject: Mapping) -> FloatArray:
        """Return directions (..., 3) at mid-picture of points (..., 2)."""
        seen = np.einsum("...ij,...j->...i", self._back(points[..., 1]), unproject(self.on_detector(points)))
        return np.asarray(seen if self.spread is None else unit(seen))

    def unproject_jacobian(self, points: FloatArray, unproject: Mapping, jacobian: Mapping) -> FloatArray:
        """Return d(direction at mid-picture)/d(pixel, line) (..., 3, 2)."""
        line, there = points[..., 1], self.on_detector(points)
        back, seen = self._back(line), unproject(there)
        slope = back @ jacobian(there)
        if self.spread is None:
            turning = np.einsum("...ji,...j->...i", self._rates(line), seen)
        else:
            turning = -np.einsum("...ij,...jk,...kl,...l->...i", back, self._rates(line), back, seen)
        at_rest = slope[..., 1] if self.detector_line is None else 0.0
        along = np.stack([slope[..., 0], at_rest + turning], axis=-1)
        if self.spread is None:
            return along
        ray = np.einsum("...ij,...j->...i", back, seen)
        length = np.linalg.norm(ray, axis=-1)[..., None, None]
        one = ray[..., None] / length
        return np.asarray((along - one @ (np.swapaxes(one, -1, -2) @ along)) / length)


def row_sweep(
    timing: RowTiming, n_line: int, pixel_rad: float, attitude_at: Callable[[float], FloatArray]
) -> RowSweep:
    """Return how a camera turns during a picture, with as many attitudes as its motion asks for.

    Parameters
    ----------
    pixel_rad
        Angle of a pixel.
    attitude_at
        ``camera_from_j2000`` (3, 3) at times in s from the middle of the picture.

    Raises
    ------
    CameraError
        The picture is a line scan, and the camera does not move.
    """
    half_s = 0.5 * max(timing.span_s(n_line), abs(timing.line_time_s))
    middle = attitude_at(0.0)

    def turn(time_s: float) -> FloatArray:
        return vector_from_rotation(attitude_at(time_s) @ middle.T)

    times = np.linspace(-half_s, half_s, FEWEST)
    turns = np.array([turn(t) for t in times])
    while len(times) < MOST:
        between = 0.5 * (times[1:] + times[:-1])
        there = np.array([turn(t) for t in between])
        off = np.linalg.norm(scipy.interpolate.CubicSpline(times, turns)(between) - there, axis=1).max()
        order = np.argsort(np.concatenate([times, between]), kind="stable")
        times, turns = np.concatenate([times, between])[order], np.concatenate([turns, there])[order]
        if off < TOLERANCE_PX * pixel_rad:
            break
    if timing.scans and np.linalg.norm(np.ptp(turns, axis=0)) < pixel_rad:
        raise CameraError(
            "a line scan is made by the camera's motion, and the camera does not move during the picture; give the CK "
            "of the scan (--kernels)."
        )
    return RowSweep(timing.line_time_s, 0.5 * (n_line - 1), timing.detector_line, times, turns, middle)

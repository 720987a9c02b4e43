"""The camera: from a direction in the instrument's SPICE frame to (pixel, line), and back.

Flow   direction -> focal axes (a, b, c) -> X = f a/c, Y = f b/c (mm) -> distortion -> center + K (x, y)
Axes   rows of ``focal_from_camera``: unit vectors, in the camera's SPICE frame, of increasing pixel, of
       increasing line and of the boresight toward the sky. They are data: LORRI looks along -Z, MVIC along
       -X, OCAMS along +Z, and a determinant of -1 (detector read out mirrored) changes nothing else.
Units  mm on the focal plane, px on the detector, rad on the sky

`sky_jacobian` goes from a place on the detector on to right ascension and declination.

Source: W. Owen, "Methods of optical navigation", AAS 11-215 (2011).
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, fields, replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray, readonly
from opnav_workbench.camera.camera_file import camera_fields
from opnav_workbench.camera.distortion import Distortion, NoDistortion, inverse_2x2, reach_mm
from opnav_workbench.camera.origins import Origin
from opnav_workbench.camera.priors import AttitudeSigma
from opnav_workbench.camera.reseau import Reseau
from opnav_workbench.camera.response import CameraResponse
from opnav_workbench.camera.rows import RowSweep, RowTiming
from opnav_workbench.camera.saving import write_camera_yaml
from opnav_workbench.errors import CameraError
from opnav_workbench.geometry import radec_from_unit, tangent_basis
from opnav_workbench.geometry.rotations import checked_rotation, unit
from opnav_workbench.lazy_names import module_on_demand

if TYPE_CHECKING:
    from opnav_workbench.camera import cahvor, instrument_kernel
else:  # cameras come from files, as a rule
    cahvor = module_on_demand("opnav_workbench.camera.cahvor")
    instrument_kernel = module_on_demand("opnav_workbench.camera.instrument_kernel")

__all__ = ["Camera", "sky_jacobian"]


# ---- The camera: from a direction in the instrument's SPICE frame to (pixel, line), and back.


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Camera(CameraResponse):
    """A frame camera in one readout mode. Every array is read-only.

    Attributes
    ----------
    name, psf, gain_e_per_dn, zero_point_mag ...
        What it makes of light: see `opnav_workbench.camera.response.CameraResponse`.
    frame
        The instrument's SPICE frame, in which directions are given.
    instrument_id
        NAIF id of the instrument.
    n_pixel, n_line
        Detector size, horizontal and vertical.
    center_pixel_line : (2,) array
        Where the boresight falls, px (0-based, integer = pixel center).
    pixel_from_mm : (2, 2) array
        [[Kx, Kxy], [Kyx, Ky]], px/mm.
    focal_from_camera : (3, 3) array
        Rows: increasing pixel, increasing line, boresight; unit vectors in the camera's SPICE frame.
    distortion
        Acts on mm, between gnomonic projection and `pixel_from_mm`.
    attitude_sigma
        One-sigma errors of the a priori attitude.
    rows
        When its lines are exposed, of a rolling shutter or a line scanner; None: all together.
    reseau
        Marks on a vidicon's faceplate, of a camera whose raw pictures tell their own distortion (`fit_reseau`).
    sweep
        How it turns meanwhile, in one picture: directions are then in its frame at mid-picture. None: it rests, as in a
        camera file.
    source
        Where the values come from.
    confirmed_by
        Which pictures or labels have shown that the camera is right; empty: none is known to have.
    origins
        Which fields were known, derived or guessed, where a program made the camera (`from_ik`); `guesses` are the last.

    Raises
    ------
    CameraError
        A value no camera can have; the message names the field.

    Examples
    --------
    >>> from opnav_workbench.resources import kernels_meta_dir
    >>> camera = Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml")
    >>> camera.project([[0.0, 0.0, 1.0], [0.001, 0.0, 1.0], [0.0, 0.0, -1.0]])
    array([[511.5, 511.5],
           [611.5, 511.5],
           [  nan,   nan]])
    >>> camera.unproject([[611.5, 511.5]]).round(6)
    array([[0.001, 0.   , 1.   ]])
    """

    frame: str
    instrument_id: int
    n_pixel: int
    n_line: int
    focal_length_mm: float
    center_pixel_line: FloatArray
    pixel_from_mm: FloatArray
    focal_from_camera: FloatArray
    distortion: Distortion = field(default_factory=NoDistortion)
    attitude_sigma: AttitudeSigma = field(default_factory=AttitudeSigma)
    rows: RowTiming | None = None
    sweep: RowSweep | None = None
    reseau: Reseau | None = None
    source: str = ""
    confirmed_by: str = ""
    origins: tuple[Origin, ...] = ()
    _reach_mm: float = field(
        init=False, repr=False, default=np.inf
    )  # ideal radius up to which distortion holds

    def __post_init__(self) -> None:
        CameraResponse.__post_init__(self)  # super() does not find its class in one with slots
        self._set_array("center_pixel_line", (2,))
        self._set_array("pixel_from_mm", (2, 2))
        self._set_array("focal_from_camera", (3, 3))
        self._check_values()
        object.__setattr__(self, "_reach_mm", reach_mm(self.distortion, self.focal_length_mm))
        # A fisheye's corners may lie beyond its circle: they see nothing, and nothing folds over.
        if not (np.isinf(self._reach_mm) or np.isfinite(self.unproject(self._corners())).all()):
            raise CameraError(
                f"{self.name}: distortion folds over inside the detector; check its coefficients and units, "
                "or give the part of the detector that is read (n_pixel, n_line, center_pixel_line)."
            )

    def _set_array(self, name: str, shape: tuple[int, ...]) -> None:
        try:
            array = readonly(np.array(getattr(self, name), dtype=np.float64), shape, name)
        except (TypeError, ValueError) as error:
            raise CameraError(f"{self.name}: {error}.") from error
        if not np.isfinite(array).all():
            raise CameraError(f"{self.name}: {name} holds a value that is not finite: {array.tolist()}.")
        object.__setattr__(self, name, array)

    def _check_values(self) -> None:
        for name in ("n_pixel", "n_line", "focal_length_mm"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise CameraError(f"{self.name}: {name} is {getattr(self, name)}; give a positive number.")
        if np.linalg.det(self.pixel_from_mm) == 0.0:
            raise CameraError(
                f"{self.name}: pixel_from_mm {self.pixel_from_mm.tolist()} is singular; give px/mm."
            )
        axes = self.focal_from_camera
        try:
            checked_rotation(axes * (np.sign(np.linalg.det(axes)) or 1.0))
        except ValueError as error:
            raise CameraError(
                f"{self.name}: focal_from_camera needs orthogonal unit rows (pixel, line, boresight): {error}"
            ) from error

    def varied(self, **changes: Any) -> Self:
        """Return the camera with other values of some fields, not checked: for differences about one that was.

        `dataclasses.replace` makes a camera that is checked, which costs as much as projecting a thousand stars.
        """
        other = copy(self)
        for name, value in changes.items():
            known = readonly(np.array(value)) if isinstance(value, np.ndarray) else value
            object.__setattr__(other, name, known)
        object.__setattr__(other, "_reach_mm", reach_mm(other.distortion, other.focal_length_mm))
        return other

    @classmethod
    def from_yaml(cls, path: str | PathLike[str]) -> Self:
        """Read a camera file; see `opnav_workbench.camera.camera_file` for its schema.

        Raises
        ------
        CameraError
            The file cannot be read or breaks the schema; the message names file and field.
        """
        return cls(**camera_fields(path))

    def to_yaml(self, path: str | PathLike[str], heading: str = "") -> None:
        """Write a camera file that `from_yaml` reads as this camera; what was guessed stands in it.

        Parameters
        ----------
        heading
            Comment on top, of one or more lines.

        Raises
        ------
        CameraError
            The point spread function is one that stands in a file of its own.
        """
        values = {item.name: getattr(self, item.name) for item in fields(self) if item.init}
        write_camera_yaml(values, Path(path), heading)

    @property
    def guesses(self) -> tuple[Origin, ...]:
        """What nobody has stated of this camera and was guessed; a picture must show whether it is right."""
        return tuple(origin for origin in self.origins if origin.how == "guessed")

    @classmethod
    def from_ik(cls, values: Mapping[str, Sequence[Any]], instrument_id: int, **overrides: Any) -> Self:
        """Build a camera from the ``INS<id>_*`` variables of a SPICE instrument kernel, and of an ISIS addendum to it.

        Nothing is guessed silently: `origins` says of every field whether it was known, derived or guessed.

        Parameters
        ----------
        values
            Pool variables, with or without the ``INS<id>_`` prefix; those of the instrument's frames (``FRAME_*``,
            ``TKFRAME_*``) where an addendum gives the camera a frame of its own.
        instrument_id
            NAIF id, such as -98301.
        **overrides
            Fields of `Camera` that replace, or add to, what the kernel gives; `pixel_direction` and
            `line_direction`, vectors (3,) in the instrument frame, replace the detector axes.

        Raises
        ------
        CameraError
            The variables do not determine a camera; the message says which are missing.
        """
        return cls(**instrument_kernel.camera_fields_from_ik(values, instrument_id, **overrides))

    @classmethod
    def from_cahvor(
        cls,
        a: ArrayLike,
        h: ArrayLike,
        v: ArrayLike,
        o: ArrayLike | None = None,
        r: Sequence[float] = (0.0, 0.0, 0.0),
        *,
        linearity: float = 1.0,
        focal_length_mm: float = 1.0,
        **fields: Any,
    ) -> Self:
        """Build a camera from the vectors of a CAHV, CAHVOR or CAHVORE model; its place C matters for near things only.

        Parameters
        ----------
        a, h, v : (3,) array_like
            In the frame in which directions will be given.
        o : (3,) array_like, optional
            Axis of the distortion; without, there is none (CAHV).
        r
            R of the model: r0, r1, r2.
        linearity
            Of CAHVORE: 1 perspective (as CAHVOR), 0 fisheye, between as the file's parameter says.
        focal_length_mm
            Any will do: pixels per mm follow from it.
        **fields
            The others of `Camera`: name, frame, instrument_id, n_pixel, n_line at least.

        Raises
        ------
        CameraError
            The vectors make no camera.
        """
        return cls(**cahvor.camera_fields_from_cahvor(a, h, v, o, r, linearity, focal_length_mm) | fields)

    @property
    def scans(self) -> bool:
        """Whether its own motion makes the lines of its pictures: a line scanner."""
        return self.rows is not None and self.rows.scans

    @property
    def boresight(self) -> FloatArray:
        """Unit vector (3,) toward the sky at `center_pixel_line`, camera frame."""
        return np.asarray(self.focal_from_camera[2])

    @property
    def pixel_scale_rad(self) -> float:
        """Angle of one pixel at the boresight without distortion, rad (geometric mean of both axes)."""
        return float(1.0 / (self.focal_length_mm * np.sqrt(abs(np.linalg.det(self.pixel_from_mm)))))

    @property
    def a_priori_sigma_rad(self) -> FloatArray:
        """One-sigma errors (3,) of the a priori attitude about the pixel, line and boresight axes, rad."""
        cross = self.attitude_sigma.cross_px * self.pixel_scale_rad
        return np.array([cross, cross, np.radians(self.attitude_sigma.twist_deg)])

    @property
    def a_priori_covariance_rad2(self) -> FloatArray:
        """Covariance (3, 3) of the a priori attitude: small rotation vector about the camera frame's axes, rad^2."""
        axes = self.focal_from_camera
        return np.asarray(axes.T @ np.diag(self.a_priori_sigma_rad) ** 2 @ axes)

    @property
    def half_diagonal_rad(self) -> float:
        """Angle from the boresight to the farthest detector corner, rad; a right angle where a corner sees no sky."""
        cosine = np.nan_to_num(self.unproject(self._corners()) @ self.boresight, nan=0.0)
        return float(np.arccos(np.clip(cosine, -1.0, 1.0)).max())

    def on_detector(self, pixel_line: ArrayLike, margin_px: float = 0.0) -> BoolArray:
        """Tell for points (..., 2) px whether they fall on a pixel, or `margin_px` near one (nan: no)."""
        points = np.asarray(pixel_line, dtype=np.float64)
        edge = 0.5 + margin_px
        size = np.array([self.n_pixel, self.n_line])
        return np.asarray(((points >= -edge) & (points <= size - 1.0 + edge)).all(axis=-1))

    def project(self, directions: ArrayLike) -> FloatArray:
        """Return where directions fall on the detector plane.

        Parameters
        ----------
        directions : (..., 3) array_like
            Vectors of any length, camera frame.

        Returns
        -------
        (..., 2) array
            (pixel, line); nan for directions at or behind the image plane, or so far from the boresight that
            the distortion model does not hold.
        """
        vectors = np.asarray(directions, dtype=np.float64)
        if self.sweep is None:
            return self._project_at_rest(vectors)
        return self.sweep.project(vectors, self._project_at_rest, self._jacobian_at_rest)

    def project_jacobian(self, directions: ArrayLike) -> FloatArray:
        """Return d(pixel, line)/d(direction), (..., 2, 3), at vectors (..., 3) of any length.

        Elements are nan where `project` is.
        """
        vectors = np.asarray(directions, dtype=np.float64)
        if self.sweep is None:
            return self._jacobian_at_rest(vectors)
        return self.sweep.project_jacobian(vectors, self.project(vectors), self._jacobian_at_rest)

    def _project_at_rest(self, vectors: FloatArray) -> FloatArray:
        ideal = self._gnomonic(vectors)
        return np.asarray(self.center_pixel_line + self.distortion.distort(ideal) @ self.pixel_from_mm.T)

    def _jacobian_at_rest(self, vectors: FloatArray) -> FloatArray:
        ideal = self._gnomonic(vectors)
        depth = np.where(np.isnan(ideal[..., 0]), np.nan, vectors @ self.boresight)
        slope = np.zeros((*ideal.shape[:-1], 2, 3))
        slope[..., 0, 0] = slope[..., 1, 1] = self.focal_length_mm
        slope[..., 2] = -ideal
        gnomonic = slope / depth[..., None, None]
        return np.asarray(
            self.pixel_from_mm @ self.distortion.jacobian(ideal) @ gnomonic @ self.focal_from_camera
        )

    def standing(self, camera_from_j2000: ArrayLike) -> "Camera":
        """Return the camera as it stands at an attitude (3, 3); another one only where its lines have their own times.

        Its mapping then depends on the attitude: it flies the path that the kernels tell, however it is mounted. Directions
        that were turned by an attitude are for the camera standing at it.
        """
        if self.sweep is None:
            return self
        sweep = self.sweep.standing(np.asarray(camera_from_j2000, dtype=np.float64))
        return self if sweep is self.sweep else replace(self, sweep=sweep)

    def attitude_jacobian(self, in_camera: ArrayLike) -> FloatArray:
        """Return d(pixel, line)/d(small rotation of the camera), (..., 2, 3) px/rad.

        Parameters
        ----------
        in_camera : (..., 3) array_like
            Directions v of any length, camera frame.

        Returns
        -------
        (..., 2, 3) array
            With respect to the rotation vector eps about the camera frame's axes that takes v to v + eps x v: the error of
            an attitude, ``true = rotation_from_vector(eps) @ camera_from_j2000``, as in `PointingSolution.covariance_rad2`.
            Where lines have their own times, all of them are turned alike: the path turns with the camera (`standing`).
        """
        vectors = np.asarray(in_camera, dtype=np.float64)
        x, y, z = np.moveaxis(vectors, -1, 0)
        zero = np.zeros_like(x)
        turned = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=-1).reshape(*x.shape, 3, 3)
        if self.sweep is None:
            return np.asarray(self._jacobian_at_rest(vectors) @ turned)
        places = self.project(vectors)
        jacobian = self.sweep.project_jacobian(vectors, places, self._jacobian_at_rest)
        # A turn of the camera as it stands at the line's own time, told at mid-picture.
        turns = self.sweep.turns(places[..., 1])
        return np.asarray(jacobian @ turned @ np.swapaxes(turns, -1, -2))

    def unproject(self, pixel_line: ArrayLike) -> FloatArray:
        """Return the unit vectors (..., 3), camera frame, that points (..., 2) of (pixel, line) look along.

        Points outside the reach of the distortion model become nan.
        """
        points = np.asarray(pixel_line, dtype=np.float64)
        if self.sweep is None:
            return self._unproject_at_rest(points)
        return self.sweep.unproject(points, self._unproject_at_rest)

    def unproject_jacobian(self, pixel_line: ArrayLike) -> FloatArray:
        """Return d(unit vector)/d(pixel, line), (..., 3, 2), at points (..., 2); nan as in `unproject`."""
        points = np.asarray(pixel_line, dtype=np.float64)
        if self.sweep is None:
            return self._rays_jacobian_at_rest(points)
        return self.sweep.unproject_jacobian(points, self._unproject_at_rest, self._rays_jacobian_at_rest)

    def _unproject_at_rest(self, pixel_line: FloatArray) -> FloatArray:
        return unit(self._rays(self._ideal(pixel_line)) @ self.focal_from_camera)

    def _rays_jacobian_at_rest(self, pixel_line: FloatArray) -> FloatArray:
        ideal = self._ideal(pixel_line)
        rays = self._rays(ideal)
        length = np.linalg.norm(rays, axis=-1)[..., None, None]
        along = rays[..., None] / length
        tangent = (np.eye(3) - along @ np.swapaxes(along, -1, -2))[..., :2] / (length * self.focal_length_mm)
        undistorted = inverse_2x2(self.distortion.jacobian(ideal)) @ np.linalg.inv(self.pixel_from_mm)
        return np.asarray(self.focal_from_camera.T @ tangent @ undistorted)

    def _gnomonic(self, vectors: FloatArray) -> FloatArray:
        """Ideal focal-plane coordinates (..., 2) mm; nan where the camera cannot see."""
        a_b_c = vectors @ self.focal_from_camera.T
        depth = np.where(a_b_c[..., 2] > 0.0, a_b_c[..., 2], np.nan)
        with np.errstate(over="ignore"):
            return self._in_reach(self.focal_length_mm * a_b_c[..., :2] / depth[..., None])

    def _ideal(self, pixel_line: ArrayLike) -> FloatArray:
        offset = np.asarray(pixel_line, dtype=np.float64) - self.center_pixel_line
        return self._in_reach(self.distortion.undistort(offset @ np.linalg.inv(self.pixel_from_mm).T))

    def _in_reach(self, ideal_mm: FloatArray) -> FloatArray:
        radius = np.hypot(ideal_mm[..., 0], ideal_mm[..., 1])
        return np.where((radius <= self._reach_mm)[..., None], ideal_mm, np.nan)

    def _rays(self, ideal_mm: FloatArray) -> FloatArray:
        ones = np.ones((*ideal_mm.shape[:-1], 1))
        return np.concatenate([ideal_mm / self.focal_length_mm, ones], axis=-1)

    def _corners(self) -> FloatArray:
        right, bottom = self.n_pixel - 0.5, self.n_line - 0.5
        corners = np.array([[-0.5, -0.5], [right, -0.5], [-0.5, bottom], [right, bottom]])
        if self.rows is not None and self.rows.detector_line is not None and self.sweep is None:
            corners[:, 1] = self.rows.detector_line  # all that a scanner has of the sky until it moves
        return corners


# ---- From a place on the detector to the sky around it.


def sky_jacobian(camera: Camera, camera_from_j2000: ArrayLike, pixel_line: ArrayLike) -> FloatArray:
    """Return d(RA cos Dec, Dec)/d(pixel, line) at a place (2,), a (2, 2) array in rad/px.

    Examples
    --------
    >>> from opnav_workbench.camera import Camera
    >>> from opnav_workbench.resources import kernels_meta_dir
    >>> camera = Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/lorri_1x1.yaml")
    >>> slope = sky_jacobian(camera, np.eye(3), [511.5, 511.5])
    >>> print(round(float(np.sqrt(abs(np.linalg.det(slope)))) * 1e6, 2))
    4.96
    """
    rotation, place = np.asarray(camera_from_j2000, float), np.asarray(pixel_line, float)
    direction = rotation.T @ camera.unproject(place)
    east_north = np.stack(tangent_basis(*radec_from_unit(direction)))
    return np.asarray(east_north @ rotation.T @ camera.unproject_jacobian(place))

"""What goes into text kernels: pool variables for clocks, frames, cameras and bodies, from numbers or from a scenario.

Every function returns a mapping for `write_text_kernel`; mappings of several things merge with ``|``, except names:
`name_assignments` takes all of them at once. Distortion goes into the keywords that `Camera.from_ik` reads: ``OOC_*``
(Owen and O'Connell) as in nh_lorri_v201.ti, ``OPENCV_OD_*`` as in orex_ocams_addendum_v10.ti.

Source: NAIF Required Readings on SCLK, Frames, PCK and NAIF IDs; IK keywords as camera kernels have them.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.errors import KernelError
from opnav_workbench.geometry.rotations import checked_rotation
from opnav_workbench.kernels.coverage import CK_FRAME, FIXED_OFFSET_FRAME, PCK_FRAME
from opnav_workbench.kernels.making.scenario import Scenario
from opnav_workbench.kernels.making.scenario_parts import (
    CLOCK_COUNTS,
    Body,
    Instrument,
    OwenTerms,
    Spacecraft,
)
from opnav_workbench.kernels.time import et_from_tdb_datetime, et_from_utc_datetime

__all__ = [
    "body_frame_assignments",
    "bus_frame_assignments",
    "camera_frame_assignments",
    "clock_values",
    "frame_values",
    "instrument_assignments",
    "instrument_values",
    "name_assignments",
    "pck_assignments",
    "pck_values",
    "sclk_assignments",
]


# ---- What goes into text kernels: pool variables for clocks, frames, cameras and bodies, from plain numbers.

TIME_SYSTEMS = {"TDB": 1, "TDT": 2}
CLOCK_DELIMITERS = {".": 1, ":": 2}
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
PCK_TERMS = 3  # constant, linear, quadratic


def sclk_assignments(
    clock_id: int,
    correlation: Iterable[tuple[int, float, float]],
    *,
    subcounts: int = 65536,
    counts: int = CLOCK_COUNTS,
    partitions: Sequence[tuple[int, int]] = (),
    time_system: Literal["TDB", "TDT"] = "TDB",
    delimiter: Literal[":", "."] = ":",
) -> dict[str, Any]:
    """Return the variables of a two-field spacecraft clock (type 1), read ``seconds:subcounts``.

    Parameters
    ----------
    clock_id
        Negative, as a rule the spacecraft's NAIF id.
    correlation : iterable of (tick, time_s, seconds_per_count)
        Ticks since the first partition's start; time in s past J2000 of `time_system`; rate from there on.
        ``[(0, et, 1.0)]`` is a simulated clock that reads zero at `et` and keeps perfect time.
    subcounts
        Ticks per count (second).
    counts
        Counts after which the counter starts again.
    partitions : sequence of (first tick, last tick)
        None: one partition over the whole counter.
    time_system
        TDB makes the clock linear in et.
    delimiter
        Between counts and subcounts, in readings that SPICE writes; it reads both.

    Raises
    ------
    KernelError
        `clock_id` is not negative, or the correlation is empty or not increasing.

    Examples
    --------
    >>> clock = sclk_assignments(-999, [(0, 489758468.0, 1.0)])
    >>> clock["SCLK01_MODULI_999"], clock["SCLK01_COEFFICIENTS_999"]
    ((4294967296, 65536), (0, 489758468.0, 1.0))
    """
    rows = [(int(tick), float(time), float(rate)) for tick, time, rate in correlation]
    if clock_id >= 0:
        raise KernelError(f"clock id {clock_id} is not negative; SPICE takes the spacecraft's id, as -98.")
    if not rows or any(b[0] <= a[0] or b[1] <= a[1] for a, b in pairwise(rows)):
        raise KernelError(
            f"clock {clock_id}: the correlation needs a row at least, with ticks and times increasing."
        )
    spans = partitions or [(0, counts * subcounts - 1)]
    values = {
        "SCLK_DATA_TYPE": (1,),
        "SCLK01_TIME_SYSTEM": (TIME_SYSTEMS[time_system],),
        "SCLK01_N_FIELDS": (2,),
        "SCLK01_MODULI": (counts, subcounts),
        "SCLK01_OFFSETS": (0, 0),
        "SCLK01_OUTPUT_DELIM": (CLOCK_DELIMITERS[delimiter],),
        "SCLK_PARTITION_START": tuple(first for first, _ in spans),
        "SCLK_PARTITION_END": tuple(last for _, last in spans),
        "SCLK01_COEFFICIENTS": tuple(value for row in rows for value in row),
    }
    return {f"{name}_{-clock_id}": value for name, value in values.items()}


def name_assignments(names: Iterable[tuple[str, int]]) -> dict[str, Any]:
    """Return the variables that tell SPICE the names of bodies and instruments.

    The last name of an id is the one SPICE prints.

    Examples
    --------
    >>> name_assignments([("NH", -98)])
    {'NAIF_BODY_NAME': ('NH',), 'NAIF_BODY_CODE': (-98,)}
    """
    pairs = tuple(names)
    return {"NAIF_BODY_NAME": tuple(n for n, _ in pairs), "NAIF_BODY_CODE": tuple(i for _, i in pairs)}


def _frame(name: str, frame_id: int, frame_class: int, class_id: int, center_id: int) -> dict[str, Any]:
    return {
        f"FRAME_{name}": frame_id,
        f"FRAME_{frame_id}_NAME": name,
        f"FRAME_{frame_id}_CLASS": frame_class,
        f"FRAME_{frame_id}_CLASS_ID": class_id,
        f"FRAME_{frame_id}_CENTER": center_id,
    }


def bus_frame_assignments(name: str, frame_id: int, spacecraft_id: int, clock_id: int) -> dict[str, Any]:
    """Return the variables of a spacecraft's own frame, which a CK of structure `frame_id` orients.

    Examples
    --------
    >>> bus_frame_assignments("NH_SPACECRAFT", -98000, -98, -98)["FRAME_-98000_CLASS"]
    3
    """
    links = {f"CK_{frame_id}_SCLK": clock_id, f"CK_{frame_id}_SPK": spacecraft_id}
    return _frame(name, frame_id, CK_FRAME, frame_id, spacecraft_id) | links


def camera_frame_assignments(
    name: str, frame_id: int, spacecraft_id: int, relative_to: str, matrix: ArrayLike
) -> dict[str, Any]:
    """Return the variables of a frame mounted on another.

    Parameters
    ----------
    matrix : (3, 3) array_like
        ``v_camera = matrix @ v_relative``: its rows are the camera's axes in the frame `relative_to`.

    Raises
    ------
    KernelError
        `matrix` is not a rotation.

    Examples
    --------
    >>> camera_frame_assignments("NAVCAM", -999100, -999, "BUS", np.eye(3))["TKFRAME_-999100_RELATIVE"]
    'BUS'
    """
    try:
        rows = checked_rotation(matrix, f"mounting matrix of {name}")
    except ValueError as error:
        raise KernelError(f"{error}.") from error
    mounting = {
        f"TKFRAME_{frame_id}_RELATIVE": relative_to,
        f"TKFRAME_{frame_id}_SPEC": "MATRIX",
        # SPICE wants the matrix from this frame to the other, by columns: that is ours by rows.
        f"TKFRAME_{frame_id}_MATRIX": tuple(rows.ravel().tolist()),
    }
    return _frame(name, frame_id, FIXED_OFFSET_FRAME, frame_id, spacecraft_id) | mounting


def body_frame_assignments(name: str, frame_id: int, body_id: int) -> dict[str, Any]:
    """Return the variables of a body-fixed frame whose rotation the PCK gives.

    Examples
    --------
    >>> body_frame_assignments("IAU_ROCK", 1999001, 1999)["OBJECT_1999_FRAME"]
    'IAU_ROCK'
    """
    return _frame(name, frame_id, PCK_FRAME, body_id, body_id) | {f"OBJECT_{body_id}_FRAME": name}


def instrument_assignments(
    instrument_id: int,
    frame: str,
    *,
    focal_length_mm: float,
    pixel_size_um: float,
    n_pixel: int,
    n_line: int,
    center_pixel_line: tuple[float, float] | None = None,
    focal_from_camera: ArrayLike = IDENTITY,
    fov_half_angles_deg: tuple[float, float] | None = None,
    keywords: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the IK variables of a camera with a rectangular field.

    Parameters
    ----------
    instrument_id, frame : int, str
        NAIF id and SPICE frame of the camera.
    focal_length_mm, pixel_size_um, n_pixel, n_line
        Optics and detector; pixels are square.
    center_pixel_line : (2,) tuple, optional
        Where the boresight falls, 0-based; the middle of the detector if not given.
    focal_from_camera : (3, 3) array_like
        Rows: increasing pixel, increasing line and boresight, unit vectors in the camera frame.
    fov_half_angles_deg : (2,) tuple, optional
        Along pixel and line; those of the detector if not given.
    keywords
        More variables, named without ``INS<id>_``: the distortion model, binning, filters.

    Examples
    --------
    >>> ik = instrument_assignments(
    ...     -999100, "NAVCAM", focal_length_mm=100.0, pixel_size_um=10.0, n_pixel=1000, n_line=1000
    ... )
    >>> ik["INS-999100_IFOV"], round(ik["INS-999100_FOV_REF_ANGLE"], 4)
    (100.0, 2.8624)
    """
    pixel_axis, line_axis, boresight = np.asarray(focal_from_camera, float).tolist()
    half = fov_half_angles_deg or tuple(
        math.degrees(math.atan(n / 2 * pixel_size_um * 1e-3 / focal_length_mm)) for n in (n_pixel, n_line)
    )
    values = {
        "FOV_FRAME": frame,
        "FOV_SHAPE": "RECTANGLE",
        "BORESIGHT": tuple(boresight),
        "FOV_CLASS_SPEC": "ANGLES",
        "FOV_REF_VECTOR": tuple(pixel_axis),
        "FOV_REF_ANGLE": half[0],
        "FOV_CROSS_ANGLE": half[1],
        "FOV_ANGLE_UNITS": "DEGREES",
        "FOCAL_LENGTH": focal_length_mm,
        "FOCAL_LENGTH_UNITS": "mm",
        "IFOV": pixel_size_um / focal_length_mm * 1e3,  # microradians, as in flight kernels
        "PIXEL_SIZE": pixel_size_um,
        "PIXEL_SAMPLES": n_pixel,
        "PIXEL_LINES": n_line,
        "CCD_CENTER": center_pixel_line or ((n_pixel - 1) / 2, (n_line - 1) / 2),
        "REFERENCE_VECTOR": tuple(pixel_axis),
        # Which way pixel and line count no standard keyword tells; these are OSIRIS-REx's.
        "SPOC_FITS_NAXIS1": tuple(pixel_axis),
        "SPOC_FITS_NAXIS2": tuple(line_axis),
    }
    return {f"INS{instrument_id}_{name}": value for name, value in (values | dict(keywords or {})).items()}


def pck_assignments(
    body_id: int,
    *,
    radii_km: Sequence[float] = (),
    gm_km3_s2: float | None = None,
    pole_ra_deg: Sequence[float] = (),
    pole_dec_deg: Sequence[float] = (),
    prime_meridian_deg: Sequence[float] = (),
) -> dict[str, Any]:
    """Return a body's size, mass and rotation; what is not given is left out.

    Parameters
    ----------
    pole_ra_deg, pole_dec_deg
        Value at J2000, rate per Julian century, second-order term; what is missing is zero.
    prime_meridian_deg
        The same, with rates per day.

    Examples
    --------
    >>> pck_assignments(901, radii_km=(606.0, 606.0, 606.0), gm_km3_s2=105.88)
    {'BODY901_RADII': (606.0, 606.0, 606.0), 'BODY901_GM': 105.88}
    """
    values: dict[str, Any] = {"RADII": tuple(radii_km), "GM": gm_km3_s2}
    rotation = {"POLE_RA": pole_ra_deg, "POLE_DEC": pole_dec_deg, "PM": prime_meridian_deg}
    for name, terms in rotation.items():
        if len(terms):
            values[name] = (*terms, *([0.0] * PCK_TERMS))[:PCK_TERMS]
    return {f"BODY{body_id}_{name}": v for name, v in values.items() if v is not None and v != ()}


# ---- Distortion as instrument kernels carry it, in the keywords that `Camera.from_ik` reads.


def distortion_keywords(camera: Instrument) -> dict[str, Any]:
    """Return the IK variables of a camera's distortion, without ``INS<id>_``; none where there is none."""
    model = camera.distortion
    if model is None:
        return {}
    pixels_per_mm = 1e3 / camera.pixel_size_um
    if isinstance(model, OwenTerms):
        return {
            "OOC_FOCAL_LENGTH": camera.focal_length_mm,
            "OOC_KMAT": (pixels_per_mm, 0.0, 0.0, pixels_per_mm),
            "OOC_EM": (model.e2_per_mm2, model.e5_per_mm, model.e6_per_mm),
            "OOC_CCD_CENTER": camera.center,
        }
    focal_px = pixels_per_mm * camera.focal_length_mm
    return {
        "OPENCV_OD_K": (model.k1, model.k2, model.k3, model.k4, model.k5, model.k6),
        "OPENCV_OD_P": (model.p1, model.p2),
        "OPENCV_OD_F": (focal_px, focal_px),
        "OPENCV_OD_C": tuple(c + 1.0 for c in camera.center),  # counted from 1
        "OPENCV_OD_A": 0.0,  # of the focal length, per degree Celsius
    }


# ---- The text kernels of a scenario: clock, frames, cameras and bodies as pool variables.


def clock_values(scenario: Scenario) -> dict[str, Any]:
    """Return the SCLK variables; needs an active `KernelSet` with an LSK where the clock has a start."""
    clock = scenario.clock
    correlation = [(tick, et_from_tdb_datetime(time), rate) for tick, time, rate in clock.correlation]
    if clock.start is not None:
        correlation = [(0, et_from_utc_datetime(clock.start), 1.0)]
    return sclk_assignments(
        clock.id,
        correlation,
        subcounts=clock.subcounts,
        counts=clock.counts,
        partitions=clock.partitions,
        time_system=clock.time_system,
        delimiter=clock.delimiter,
    )


def frame_values(scenario: Scenario) -> dict[str, Any]:
    """Return the FK variables: names, the bus frame, mounted frames and body-fixed ones."""
    craft, clock_id = scenario.spacecraft, scenario.clock.id
    things: tuple[Spacecraft | Body, ...] = (craft, *scenario.bodies)
    named = [(name, thing.id) for thing in things for name in (*thing.aliases, thing.name)]
    values = name_assignments(named) | bus_frame_assignments(
        craft.frame.name, craft.frame.id, craft.id, clock_id
    )
    for frame in scenario.frames:
        values |= camera_frame_assignments(frame.name, frame.id, craft.id, frame.relative_to, frame.matrix)
    for body in scenario.bodies:
        if body.frame is not None:
            values |= body_frame_assignments(body.frame.name, body.frame.id, body.id)
    return values


def instrument_values(scenario: Scenario) -> dict[str, Any]:
    """Return the IK variables of all cameras."""
    values = name_assignments((i.name, i.id) for i in scenario.instruments)
    for camera in scenario.instruments:
        values |= instrument_assignments(
            camera.id,
            camera.frame,
            focal_length_mm=camera.focal_length_mm,
            pixel_size_um=camera.pixel_size_um,
            n_pixel=camera.n_pixel,
            n_line=camera.n_line,
            center_pixel_line=camera.center_pixel_line,
            focal_from_camera=camera.focal_from_camera,
            fov_half_angles_deg=camera.fov_half_angles_deg,
            keywords=distortion_keywords(camera) | dict(camera.keywords),
        )
    return values


def pck_values(scenario: Scenario) -> dict[str, Any]:
    """Return the PCK variables of all bodies."""
    values: dict[str, Any] = {}
    for body in scenario.bodies:
        values |= pck_assignments(
            body.id,
            radii_km=body.radii_km or (),
            gm_km3_s2=body.gm_km3_s2,
            pole_ra_deg=body.pole_ra_deg,
            pole_dec_deg=body.pole_dec_deg,
            prime_meridian_deg=body.prime_meridian_deg,
        )
    return values

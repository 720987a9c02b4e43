"""Inputs of a session from the world outside the picture: kernels, image header, catalog, target lists."""

from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies import TargetState
from opnav_workbench.catalog import Catalog, StarTable, open_catalog, read_star_list
from opnav_workbench.errors import ImageError, KernelError, SessionError
from opnav_workbench.geometry import radec_from_unit
from opnav_workbench.scene import (
    Observer,
    body_target,
    observer_from_header,
    observer_from_kernels,
    star_target_at,
)
from opnav_workbench.session.context import Context, faintest_magnitude
from opnav_workbench.session.state import Inputs
from opnav_workbench.spice import KernelSet, camera_attitude, et_from_sclk, et_from_utc
from opnav_workbench.spice.dsk import shape_file_of

__all__ = ["ATTITUDE_SOURCES", "InputSource", "gather", "gather_target", "gather_wide"]

WIDE_STARS = 1000  # of a wide search: dozens on the detector of any camera, and a session file of a megabyte
FAINT_MARGIN_MAG = 1.0  # colors, and the zero point's own error
MAX_CONE_RAD = np.pi
ATTITUDE_SOURCES = ("auto", "kernels", "header")


@dataclass(frozen=True, slots=True)
class InputSource:
    """Where inputs come from.

    Attributes
    ----------
    catalog : str
        Catalog spec.
    target_stars : Path or None
        Star list for stars that are targets.
    attitude : {"auto", "kernels", "header"}
    """

    catalog: str = "bundled"
    target_stars: Path | None = None
    attitude: str = "auto"

    def __post_init__(self) -> None:
        if self.attitude not in ATTITUDE_SOURCES:
            raise SessionError(
                f"unknown attitude source {self.attitude!r}; choose one of {', '.join(ATTITUDE_SOURCES)}."
            )


def gather(context: Context, source: InputSource, catalog: Catalog | None = None) -> Inputs:
    """Collect time, observer, a priori attitude and the catalog stars around the field."""
    et = _et(context)
    attitude, origin = _attitude(context, source.attitude, et)
    inputs = Inputs(
        et=et,
        utc=context.frame.utc or "",
        observer=_observer(context, et),
        a_priori_camera_from_j2000=attitude,
        attitude_source=origin,
        stars=StarTable.empty(),
        targets=MappingProxyType({}),
    )
    return replace(inputs, stars=_stars(context, catalog or open_catalog(source.catalog), inputs))


def gather_target(context: Context, source: InputSource, inputs: Inputs, name: str) -> Inputs:
    """Add one target to the inputs: a star of the target list, else a SPICE body."""
    target = _star_target(context, source, inputs, name)
    shape = None
    if target is None:
        target, shape = _spice_target(context, inputs, name), shape_file_of(name)
    return replace(
        inputs,
        targets=MappingProxyType({**inputs.targets, name: target}),
        shapes=inputs.shapes if shape is None else MappingProxyType({**inputs.shapes, name: shape}),
    )


def gather_wide(
    context: Context, source: InputSource, inputs: Inputs, catalog: Catalog | None = None
) -> Inputs:
    """Add the brightest stars as far around the a priori field as the widest search of the settings goes."""
    reach_px = max((shift for shift, _ in context.settings.wide_searches), default=0.0)
    radius = context.camera.half_diagonal_rad + reach_px * context.camera.pixel_scale_rad
    limit = min(context.settings.mag_limit, faintest_magnitude(context) + FAINT_MARGIN_MAG)
    stars = _cone(context, catalog or open_catalog(source.catalog), inputs, radius, limit)
    brightest = np.sort(np.argsort(stars.mag, kind="stable")[:WIDE_STARS])
    return replace(inputs, wide_stars=stars.take(brightest))


def _cone(
    context: Context, catalog: Catalog, inputs: Inputs, radius_rad: float, mag_limit: float
) -> StarTable:
    direction = inputs.a_priori_camera_from_j2000.T @ context.camera.boresight
    ra, dec = (float(a) for a in radec_from_unit(direction))
    return catalog.cone(ra, dec, min(radius_rad, MAX_CONE_RAD), mag_limit=mag_limit, et_s=inputs.et)


def _et(context: Context) -> float:
    """Mid-exposure time from the header's ET, UTC or clock reading, in this order."""
    frame = context.frame
    if frame.et is not None:
        return frame.et
    if KernelSet.active() is not None and frame.utc is not None:
        return et_from_utc(frame.utc)
    if KernelSet.active() is not None and frame.sclk is not None:
        return et_from_sclk(context.mission.clock_id, frame.sclk)
    raise ImageError(
        f"{frame.path.name}: the header gives no time but a clock reading ({frame.sclk}); "
        "give kernels with an LSK and the SCLK of this spacecraft (--kernels)."
    )


def _observer(context: Context, et: float) -> Observer:
    kernels = KernelSet.active()
    spacecraft = context.mission.spacecraft_id
    if kernels is not None and any(c.body == spacecraft for c in kernels.coverage("SPK")):
        return observer_from_kernels(spacecraft, et)
    return observer_from_header(context.frame, et)


def _attitude(context: Context, wanted: str, et: float) -> tuple[FloatArray, str]:
    kernels, frame_name = KernelSet.active(), context.camera.frame
    with_ck = kernels is not None and kernels.has_attitude(frame_name)
    if wanted == "kernels" or (wanted == "auto" and with_ck):
        return camera_attitude(frame_name, et), "kernels"
    geometry = context.frame.header_geometry
    if geometry is None or geometry.camera_from_j2000 is None:
        raise ImageError(
            f"{context.frame.path.name}: the header gives no attitude; "
            f"give kernels with a CK for {frame_name} (--kernels)."
        )
    return np.asarray(geometry.camera_from_j2000), "header"


def _stars(context: Context, catalog: Catalog, inputs: Inputs) -> StarTable:
    """Catalog stars in a cone that holds the detector, the search margin and the twist error's reach."""
    camera, settings = context.camera, context.settings
    margin = settings.max_shift_px * camera.pixel_scale_rad
    reach = camera.half_diagonal_rad * (1.0 + np.radians(settings.max_twist_deg)) + margin
    return _cone(context, catalog, inputs, reach, settings.mag_limit)


def _star_target(context: Context, source: InputSource, inputs: Inputs, name: str) -> TargetState | None:
    path = source.target_stars or context.mission.target_stars
    if path is None:
        return None
    stars = read_star_list(path)
    names = {str(star).casefold(): row for row, star in enumerate(stars.id)}
    row = names.get(name.casefold())
    if row is None:
        return None
    return star_target_at(name, stars, row, inputs.et, inputs.observer)


def _spice_target(context: Context, inputs: Inputs, name: str) -> TargetState:
    if KernelSet.active() is None:
        raise KernelError(
            f"target {name}: it is not in the target star list, and no kernels are loaded; give kernels that "
            "cover the body (--kernels) or a star list (--target-stars)."
        )
    if name != name.strip().upper():  # SPICE would take it, and the picture have one body under two names
        raise KernelError(f"target {name!r}: write the body's name in capitals, {name.strip().upper()}.")
    return context.mission.with_magnitude(body_target(name, context.mission.spacecraft_id, inputs.et))

"""How a target looks: the model of its surface and light that mission file and kernels give."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from opnav_workbench.bodies import TargetState
from opnav_workbench.errors import CameraError, MissionError, OpNavError
from opnav_workbench.mission import AlbedoMapFile, Surface
from opnav_workbench.photometry import SUN_B_V
from opnav_workbench.render import AlbedoMap, BodyModel, ScatteringLaw, ShapeModel, law_from_mapping
from opnav_workbench.session.context import Context
from opnav_workbench.session.state import Inputs

__all__ = ["body_model", "drawn", "knows_law", "knows_surface"]

PLAIN = Surface()


def body_model(context: Context, inputs: Inputs, name: str) -> BodyModel:
    """Return how a target looks.

    A body of unknown orientation, of which no map or shape is known, is drawn as a sphere of the same volume.

    Raises
    ------
    OpNavError
        It cannot be drawn: no size, no Sun, a map or shape whose file is not there.
    """
    target = inputs.targets[name]
    surface = context.mission.target_surfaces.get(name, PLAIN)
    photometry = context.mission.target_photometry.get(name)
    albedo: float | AlbedoMap = 1.0 if photometry is None else photometry.geometric_albedo or 1.0
    if surface.albedo_map is not None:
        albedo = _map(surface.albedo_map)
    shape = _shape_of(inputs, name, surface)
    law = _law(context, name, surface)
    flux = _flux_e(context, target, SUN_B_V if photometry is None else photometry.b_v)
    try:
        return BodyModel(target, law, albedo, shape, flux)
    except MissionError:
        round_already = target.radii_km is None or np.ptp(target.radii_km) == 0.0
        if shape is not None or isinstance(albedo, AlbedoMap) or round_already:
            raise
    sphere = replace(target, radii_km=np.full(3, np.cbrt(np.prod(np.asarray(target.radii_km)))))
    return BodyModel(sphere, law, albedo, flux_e=flux)


def knows_surface(context: Context, name: str) -> bool:
    """Tell whether the albedo pattern of a body is known, so that its whole disk counts."""
    return context.mission.target_surfaces.get(name, PLAIN).albedo_map is not None


def knows_law(context: Context, name: str) -> bool:
    """Tell whether the mission states how a body's surface scatters light."""
    surface, photometry = (
        context.mission.target_surfaces.get(name),
        context.mission.target_photometry.get(name),
    )
    return bool((surface and surface.law) or (photometry and photometry.law))


def _law(context: Context, name: str, surface: Surface) -> ScatteringLaw:
    """Return the mission's scattering law; else the one of its phase function; else Lambert's."""
    photometry = context.mission.target_photometry.get(name)
    given: dict[str, Any] | None = surface.law
    try:
        return law_from_mapping(given or (photometry and photometry.law) or "lambert")
    except MissionError as error:
        raise MissionError(f"{context.mission.path}: target_surfaces: {name}: {error}") from error


def _shape_of(inputs: Inputs, name: str, surface: Surface) -> ShapeModel | None:
    if name in inputs.shapes:
        return _shape(inputs.shapes[name], "km")
    return None if surface.shape is None else _shape(surface.shape, surface.shape_unit)


@lru_cache(maxsize=8)
def _shape(path: Path, unit: str) -> ShapeModel:
    return ShapeModel.from_file(path, unit)


@lru_cache(maxsize=8)
def _map(file: AlbedoMapFile) -> AlbedoMap:
    return AlbedoMap.from_file(file.file, **file.model_dump(exclude={"file"}))


def _flux_e(context: Context, target: TargetState, b_v: float) -> float | None:
    """Return the electrons of a body of known magnitude; None where camera or magnitude are not known."""
    if target.magnitude is None:
        return None
    in_band = target.magnitude + float(context.camera.color.offset(b_v))
    try:
        return float(context.camera.electrons(in_band, context.frame.exposure_s))
    except CameraError:
        return None


def drawn(context: Context, inputs: Inputs, name: str) -> BodyModel | None:
    """Return how a target looks, None where it cannot be drawn."""
    try:
        return body_model(context, inputs, name)
    except OpNavError:
        return None

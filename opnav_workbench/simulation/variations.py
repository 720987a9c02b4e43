"""A scenario with a few things changed, for trade studies and sliders: exposure, noise, surface, ephemeris."""

from typing import Any, Literal

from opnav_workbench.errors import MissionError
from opnav_workbench.simulation.effects import DetectorEffects
from opnav_workbench.simulation.scenario import PictureScenario
from opnav_workbench.yaml_file import check_model

__all__ = ["varied"]


def varied(
    scenario: PictureScenario,
    *,
    exposure_s: float | None = None,
    noise: bool = True,
    law: str | None = None,
    albedo: Literal["uniform", "mottled"] | None = None,
    offset_body: str | None = None,
    toward_sun_km: float = 0.0,
) -> PictureScenario:
    """Return a scenario that differs from `scenario` in what is given; what is None stays.

    Parameters
    ----------
    scenario : PictureScenario
    exposure_s : float, optional
        Of every picture.
    noise : bool
        False: an ideal detector, electrons over gain.
    law : str, optional
        Scattering law of every body, with its default parameters.
    albedo : {"uniform", "mottled"}, optional
        Surface of every body.
    offset_body : str, optional
        Body or barycenter that is moved; its other offsets stay.
    toward_sun_km : float
        By how much, toward the Sun.

    Raises
    ------
    MissionError
        The scenario would break its schema (an exposure that is not positive, an unknown law).
    """
    content = scenario.model_dump()
    for picture in content["pictures"]:
        picture["exposure_s"] = picture["exposure_s"] if exposure_s is None else exposure_s
    content["bodies"] = [body | _surface(law, albedo) for body in content["bodies"]]
    if not noise:
        content["detector"] = DetectorEffects.none()
    if offset_body is not None and toward_sun_km != 0.0:
        moved = {"name": offset_body, "toward_sun_km": toward_sun_km}
        content["perturbations"]["bodies"] = (*content["perturbations"]["bodies"], moved)
    changed = check_model(content, PictureScenario, "picture scenario", MissionError)
    return changed.at_path(scenario.path)


def _surface(law: str | None, albedo: str | None) -> dict[str, Any]:
    update: dict[str, Any] = {} if law is None else {"law": law}
    if albedo is not None:
        update["albedo"] = 0.5 if albedo == "uniform" else albedo
    return update

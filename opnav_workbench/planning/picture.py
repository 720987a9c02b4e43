"""One planned picture: everything that is expected of it, and the verdict."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.errors import CameraError, OpNavError
from opnav_workbench.geometry import pointing_angles
from opnav_workbench.planning.attitude import PointingPlan, plan_pointing
from opnav_workbench.planning.bodies import TargetPlan, plan_target
from opnav_workbench.planning.company import Visitor, visitors
from opnav_workbench.planning.depth import catalog_depth_mag
from opnav_workbench.planning.desk import Desk, reason_of
from opnav_workbench.planning.exposure import BestExposure, best_exposure
from opnav_workbench.planning.light import ExpectedLight, expected_light
from opnav_workbench.planning.sequence_parts import PlannedPicture
from opnav_workbench.planning.stars import StarPlan, limiting_magnitude, plan_stars
from opnav_workbench.planning.verdict import Verdict, judge_picture

__all__ = ["PicturePlan", "Prospect", "plan_picture"]


@dataclass(frozen=True, slots=True, eq=False)
class Prospect:
    """What a picture is expected to be, where it can be told.

    Attributes
    ----------
    camera : Camera
    et : float
    camera_from_j2000 : (3, 3) array
    ra_deg, dec_deg, twist_deg : float
        Of the boresight.
    elongation_deg : float
        Angle between boresight and Sun.
    stray_light_dn : float
        Scattered sunlight in this exposure as the sequence states it.
    stars : StarPlan
    limit_mag : float
        Of a star at the limiting SNR, in the camera's band.
    catalog_mag : float
        How deep the catalog goes around the field, in its own band; nan where it has no stars.
    pointing : PointingPlan or None
        None where no star determines it.
    targets : tuple of TargetPlan
    visitors : tuple of Visitor
        Other bodies in the field.
    image_dn : (n_line, n_pixel) array
        The expected picture, without noise.
    best : BestExposure or None
        None where it was not asked for.
    """

    camera: Camera
    et: float
    camera_from_j2000: FloatArray
    ra_deg: float
    dec_deg: float
    twist_deg: float
    elongation_deg: float
    stray_light_dn: float
    stars: StarPlan
    limit_mag: float
    catalog_mag: float
    pointing: PointingPlan | None
    targets: tuple[TargetPlan, ...]
    visitors: tuple[Visitor, ...]
    image_dn: FloatArray
    best: BestExposure | None

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def target(self, name: str) -> TargetPlan | None:
        """Return what is expected of a target; None where it is none of this picture."""
        return next((t for t in self.targets if t.name.upper() == name.upper()), None)


@dataclass(frozen=True, slots=True, eq=False)
class PicturePlan:
    """A planned picture with its verdict.

    Attributes
    ----------
    picture : PlannedPicture
    pointing_words : str
        How the pointing is planned.
    verdict : Verdict
    prospect : Prospect or None
        None where nothing can be told; the verdict says why.
    """

    picture: PlannedPicture
    pointing_words: str
    verdict: Verdict
    prospect: Prospect | None

    @property
    def name(self) -> str:
        """Of the picture."""
        return self.picture.name

    @property
    def utc(self) -> str:
        """Mid-exposure."""
        return "" if self.picture.utc is None else self.picture.utc.isoformat()


def plan_picture(
    desk: Desk, picture: PlannedPicture, *, others: Sequence[str] = (), exposures: bool = True
) -> PicturePlan:
    """Predict one picture and judge it.

    What cannot be predicted (no kernel coverage, a camera without throughput) is a bad verdict with its reason.

    Parameters
    ----------
    desk : Desk
    picture : PlannedPicture
    others : sequence of str
        Bodies that may enter the field.
    exposures : bool
        Search the best exposure too.
    """
    words = desk.pointing(picture).words
    try:
        prospect = _prospect(desk, picture, others, exposures)
    except (OpNavError, ValueError) as error:
        return PicturePlan(picture, words, Verdict("bad", (reason_of(error),)), None)
    sequence, camera = desk.sequence, prospect.camera
    verdict = judge_picture(
        camera,
        sequence.limits,
        sequence.sun,
        prospect.elongation_deg,
        prospect.stars,
        prospect.pointing,
        prospect.targets,
        camera.saturation_dn,
    )
    return PicturePlan(picture, words, verdict, prospect)


def _prospect(desk: Desk, picture: PlannedPicture, others: Sequence[str], exposures: bool) -> Prospect:
    camera = desk.camera(picture)
    _check_exposure(camera, picture.exposure_s)
    inputs = desk.inputs(picture)
    light = expected_light(inputs)
    attitude = inputs.path.middle
    stars = plan_stars(light, desk.sequence.limits.star_snr)
    pointing = plan_pointing(stars, camera, attitude)
    wanted = [name.upper() for name in desk.targets(picture)]
    index = {body.target.name.upper(): i for i, body in enumerate(inputs.bodies)}
    targets = tuple(plan_target(light, index[name], pointing) for name in wanted)
    ra, dec, twist = pointing_angles(attitude, camera.focal_from_camera)
    boresight = attitude.T @ camera.boresight
    elongation = desk.elongation_deg(boresight, inputs.et)
    return Prospect(
        camera=camera,
        et=inputs.et,
        camera_from_j2000=attitude,
        ra_deg=float(np.degrees(ra)) % 360.0,
        dec_deg=float(np.degrees(dec)),
        twist_deg=float(np.degrees(twist)) % 360.0,
        elongation_deg=elongation,
        stray_light_dn=desk.stray_light_dn_s(elongation) * inputs.exposure_s,
        stars=stars,
        limit_mag=limiting_magnitude(light, desk.sequence.limits.star_snr),
        catalog_mag=catalog_depth_mag(desk.workshop.catalog, boresight, desk.sequence.magnitude_limit),
        pointing=pointing,
        targets=targets,
        visitors=visitors(
            desk, others, wanted, desk.drawn(picture), camera, attitude, inputs.observer, inputs.et
        ),
        image_dn=light.picture.image_dn,
        best=_best(desk, light, stars, targets, index) if exposures else None,
    )


def _best(
    desk: Desk, light: ExpectedLight, stars: StarPlan, targets: tuple[TargetPlan, ...], index: dict[str, int]
) -> BestExposure:
    """Return the best exposure for the brightest target in the field, or for the stars alone."""
    seen = [t for t in targets if t.snr > 0.0 and t.prediction.on_detector]
    target = max(seen, key=lambda t: t.flux_dn, default=None)
    number = None if target is None else index[target.name.upper()]
    return best_exposure(light, stars, number, target, desk.sequence.limits.star_snr)


def _check_exposure(camera: Camera, exposure_s: float) -> None:
    limits = camera.exposure_limits
    if limits is not None and not limits.min_s <= exposure_s <= limits.max_s:
        raise CameraError(
            f"exposure of {exposure_s:g} s; {camera.name} takes {limits.min_s:g} to {limits.max_s:g} s"
        )

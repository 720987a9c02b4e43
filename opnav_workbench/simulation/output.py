"""A simulated picture on disk: the mission's own FITS file, the truth beside it, and previews for people.

A preview is a PNG that any program shows, line 0 at the top: ``linear`` shows bodies as a person would see them,
``log`` brings up the stars and the noise, as in the paper's Figure 2.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from astropy.stats import mad_std
from astropy.visualization import LogStretch
from numpy.typing import NDArray
from PIL import Image

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.errors import MissionError
from opnav_workbench.files import atomic_path
from opnav_workbench.mission import Mission
from opnav_workbench.render import RenderedBody
from opnav_workbench.simulation.cautions import cautions
from opnav_workbench.simulation.flight_fits import write_flight_fits
from opnav_workbench.simulation.flight_header import FlightRecord, utc_text
from opnav_workbench.simulation.picture import SimulatedPicture
from opnav_workbench.simulation.truth import BodyTruth, Truth, body_rows, star_rows, truth_table, write_truth

__all__ = ["BodyReport", "PictureReport", "stretched", "truth_of", "write_picture", "write_preview"]


# ---- Preview pictures: what was simulated, as a PNG that any program shows, line 0 at the top.

Stretch = Literal["linear", "log"]
LOG_LOW_SIGMAS = -2.0  # the noise is seen as dark grain
LOG_STRENGTH = 1000.0  # astropy's own default
LEAST_RANGE_SIGMAS = {"linear": 20.0, "log": 300.0}  # an empty picture's noise must not look like stars
PNG_COMPRESSION = (
    1  # noise hardly packs: the usual level takes three times as long for a file an eighth smaller
)


def stretched(image_dn: FloatArray, stretch: Stretch = "linear") -> NDArray[np.uint8]:
    """Return gray levels (n_line, n_pixel) of a picture.

    Examples
    --------
    >>> stretched(np.eye(3)).tolist()[0]
    [255, 0, 0]
    """
    if stretch not in get_args(Stretch):
        raise MissionError(f"unknown stretch {stretch!r}; use {' or '.join(get_args(Stretch))}.")
    level, noise = float(np.median(image_dn)), float(mad_std(image_dn))
    low = level + LOG_LOW_SIGMAS * noise if stretch == "log" else level
    least = max(np.spacing(abs(low)), np.finfo(np.float32).tiny)  # of one pixel, or all alike
    high = max(float(image_dn.max()), level + LEAST_RANGE_SIGMAS[stretch] * noise, low + least)
    share = np.clip((image_dn - low) / (high - low), 0.0, 1.0)
    if stretch == "log":
        share = LogStretch(LOG_STRENGTH)(share)
    return np.asarray(np.rint(255.0 * share), dtype=np.uint8)


def write_preview(path: Path, image_dn: FloatArray, stretch: Stretch) -> None:
    """Write a preview, whole or not at all.

    Raises
    ------
    SessionError
        The folder cannot be written.
    """
    picture = Image.fromarray(stretched(image_dn, stretch))
    with atomic_path(path) as temporary:
        picture.save(temporary, format="PNG", compress_level=PNG_COMPRESSION)


# ---- A simulated picture on disk: the mission's own FITS file, the truth beside it, and a preview for people.


@dataclass(frozen=True, slots=True, eq=False)
class BodyReport:
    """What came out of one body.

    Attributes
    ----------
    name, regime
        SPICE name; drawn as "point", "small" or "disk".
    center_px : (2,) array
        True center of figure.
    diameter_px, snr, occulted_fraction
        `snr` is that of all its light against photon and read noise.
    """

    name: str
    regime: str
    center_px: FloatArray
    diameter_px: float
    snr: float
    occulted_fraction: float

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True)
class PictureReport:
    """What came out of one picture.

    Attributes
    ----------
    stars_drawn
        On the detector and not behind a body.
    brightest_mag
        Of these.
    files
        The picture first.
    cautions
        What a person should know of the picture before it is used (`opnav_workbench.simulation.cautions`).
    """

    name: str
    utc: str
    camera: str
    exposure_s: float
    stars_drawn: int
    brightest_mag: float | None
    bodies: tuple[BodyReport, ...]
    files: tuple[Path, ...]
    cautions: tuple[str, ...] = ()


def write_picture(
    picture: SimulatedPicture,
    mission: Mission,
    out: Path,
    stretches: Sequence[Stretch] = ("log",),
    settings: Mapping[str, Any] | None = None,
) -> PictureReport:
    """Write a picture, its truth and its previews; the picture last, so that where it stands the others do.

    Parameters
    ----------
    out
        Folder; gets ``NAME.fit``, ``NAME.truth.*`` and ``NAME_<stretch>.png``.
    stretches : sequence of {"linear", "log"}
    settings
        What made the picture, for the truth file.

    Raises
    ------
    SessionError
        A file cannot be written.
    """
    inputs = picture.inputs
    path = out / f"{inputs.name}.fit"
    truth = truth_of(picture, mission, path, settings)
    files = [*write_truth(truth)]
    for stretch in stretches:
        preview = out / f"{inputs.name}_{stretch}.png"
        write_preview(preview, picture.image_dn, stretch)
        files.append(preview)
    write_flight_fits(path, picture.exposure, flight_record(picture, mission))
    return _picture_report(picture, truth, (path, *files))


def truth_of(
    picture: SimulatedPicture, mission: Mission, path: Path, settings: Mapping[str, Any] | None = None
) -> Truth:
    """Return the truth of a picture that stands, or will stand, at `path`."""
    inputs = picture.inputs
    stars = star_rows(
        picture.stars.id,
        picture.stars.mag,
        picture.star_flux_e,
        picture.star_trails,
        picture.stars.on_detector,
        picture.star_occulted,
    )
    moved = picture.body_trails
    bodies = [
        _body_truth(picture, body, mean, float(length))
        for body, mean, length in zip(picture.rendering.bodies, moved.mean_px, moved.length_px, strict=True)
    ]
    return Truth(
        picture=path,
        mission=mission.name,
        camera=inputs.camera.name,
        utc=utc_text(inputs.et),
        et=inputs.et,
        exposure_s=inputs.exposure_s,
        camera_from_j2000=picture.camera_from_j2000,
        predicted_camera_from_j2000=inputs.predicted_camera_from_j2000,
        objects=truth_table(stars, body_rows(bodies)),
        seed=inputs.seed,
        settings=settings or {},
        exposure=picture.exposure.summary(),
        cosmic_rays=picture.exposure.cosmic_rays,
        noiseless_electrons=picture.noiseless_electrons,
    )


def _body_truth(
    picture: SimulatedPicture, body: RenderedBody, moved_px: FloatArray, smear_px: float
) -> BodyTruth:
    inputs = picture.inputs
    model = next(m for m in inputs.bodies if m.target.name == body.name)
    magnitude = model.target.magnitude
    return BodyTruth(
        name=body.name,
        center_px=body.center_px,
        light_px=body.light_px + moved_px,
        flux_e=body.flux_e,
        mag=float("nan") if magnitude is None else magnitude,
        diameter_px=body.diameter_px,
        on_detector=bool(inputs.camera.on_detector(body.center_px)),
        occulted_fraction=body.occulted_fraction,
        smear_px=smear_px,
    )


def flight_record(picture: SimulatedPicture, mission: Mission, camera: Camera | None = None) -> FlightRecord:
    """Return what a picture's header is made of: the prediction, and the camera; None: the one that took it."""
    inputs = picture.inputs
    return FlightRecord(
        mission=mission,
        camera=camera or inputs.camera,
        et=inputs.et,
        exposure_s=inputs.exposure_s,
        camera_from_j2000=inputs.predicted_camera_from_j2000,
        identity=inputs.header,
        target=inputs.bodies[0].target.name if inputs.bodies else None,
    )


def _picture_report(picture: SimulatedPicture, truth: Truth, files: tuple[Path, ...]) -> PictureReport:
    drawn = picture.star_drawn
    return PictureReport(
        name=picture.inputs.name,
        utc=truth.utc,
        camera=truth.camera,
        exposure_s=truth.exposure_s,
        stars_drawn=int(drawn.sum()),
        brightest_mag=float(np.min(picture.stars.mag[drawn])) if drawn.any() else None,
        bodies=tuple(_body_report(picture, body) for body in picture.rendering.bodies),
        files=files,
        cautions=cautions(picture),
    )


def _body_report(picture: SimulatedPicture, body: RenderedBody) -> BodyReport:
    values = picture.exposure.values
    read_e = values.read_noise_dn * values.gain_e_per_dn
    blur = 4.0 * np.pi * float(np.prod(picture.inputs.psf.sigma_px))  # pixels that a point's light counts in
    pixels = 0.25 * np.pi * np.nan_to_num(body.diameter_px) ** 2 + blur
    return BodyReport(
        name=body.name,
        regime=body.regime,
        center_px=body.center_px,
        diameter_px=body.diameter_px,
        snr=float(body.flux_e / np.sqrt(body.flux_e + pixels * read_e**2)) if body.flux_e > 0.0 else 0.0,
        occulted_fraction=body.occulted_fraction,
    )

"""Star pictures for a calibration: pictures solved one after the other, then their stars as arrays."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.calibration import (
    MIN_STARS,
    PsfPicture,
    StarPictures,
    TeachingPicture,
    learn_effective_psf,
    stack_psf,
)
from opnav_workbench.camera import Camera
from opnav_workbench.errors import CameraError, OpNavError
from opnav_workbench.processing.automatic import open_picture, solve_stars
from opnav_workbench.processing.model import OpenedProcessing
from opnav_workbench.psf import EffectivePsf
from opnav_workbench.session import ImageSession
from opnav_workbench.stars import Detections, ExpectedPlaces, StarFlag, detect

__all__ = [
    "SolvedPictures",
    "effective_psf_of",
    "isolation_px",
    "psf_pictures",
    "sessions_alike",
    "sessions_kept",
    "solve_star_pictures",
    "star_pictures",
    "teaching_pictures",
]

PictureProgress = Callable[[str, str], None]

NEIGHBOR_PART = 0.05  # a neighbor of less light than this does not show in a stack of many stars
SAME_STAR_PX = 1.0  # of a detection and a fit: they err by parts of a pixel, and crowded stars are left out
# A neighbor nearer than this (sigmas of the PSF, pixels) spoils a star
ISOLATION_SIGMAS, ISOLATION_PX = 8.0, 5.0
STACK_SNR, TEACHING_SNR = 50.0, 15.0  # fainter stars say little in a stack, and of light within a pixel
UNFIT_FLAGS = StarFlag.SATURATED | StarFlag.COSMIC_RAY | StarFlag.EDGE | StarFlag.BAD_PIXELS


@dataclass(frozen=True, slots=True)
class SolvedPictures:
    """Pictures of one camera with their pointing solved, and those that failed.

    Attributes
    ----------
    failed : tuple of (str, str)
        File name and reason.
    """

    sessions: tuple[ImageSession, ...]
    failed: tuple[tuple[str, str], ...]


def solve_star_pictures(
    images: Sequence[Path],
    opened: OpenedProcessing,
    say: PictureProgress = lambda _name, _words: None,
    least_stars: int = MIN_STARS,
) -> SolvedPictures:
    """Solve the pointing of pictures of one camera.

    Parameters
    ----------
    opened
        Targets are not searched.
    say : callable
        Called with a picture's name and a few words.
    least_stars
        A picture with fewer identified stars counts as failed.

    Raises
    ------
    CameraError
        Pictures of several cameras (or readout modes), or none that could be solved.
    """
    sessions: list[ImageSession] = []
    failed: list[tuple[str, str]] = []
    for image in images:
        say(image.name, "finding stars")
        try:
            session = open_picture(image, opened)
            session.predict()
            solve_stars(session, opened)
        except OpNavError as error:
            failed.append((image.name, str(error)))
            continue
        used = int(session.state.mask("used").sum())
        if session.state.pointing is None or used < least_stars:
            failed.append((image.name, "; ".join(session.state.messages) or f"{used} stars found"))
        else:
            sessions.append(session)
    _check_cameras(sessions, failed)
    return SolvedPictures(tuple(sessions), tuple(failed))


def _check_cameras(sessions: Sequence[ImageSession], failed: Sequence[tuple[str, str]]) -> None:
    if not sessions:
        why = "; ".join(f"{name}: {reason}" for name, reason in failed[:2])
        raise CameraError(f"no picture could be solved ({why}); process them one by one to see why.")
    cameras = sorted({session.context.camera.name for session in sessions})
    if len(cameras) > 1:
        raise CameraError(f"the pictures are of {', '.join(cameras)}; calibrate one camera at a time.")


def star_pictures(sessions: Sequence[ImageSession]) -> StarPictures:
    """Return the used stars of solved pictures, with the covariances of center and catalog together."""
    parts = []
    for number, session in enumerate(sessions):
        state = session.state
        assert state.a_priori is not None
        assert state.centers is not None
        used = state.mask("used")
        covariance = state.centers.covariance_px2[used] + state.a_priori.covariance_px2[used]
        picture = np.full(int(used.sum()), number)
        parts.append((picture, state.centers.pixel_line[used], covariance, state.a_priori.directions[used]))
    picture, observed, covariance, directions = (np.concatenate(part) for part in zip(*parts, strict=True))
    return StarPictures(
        names=tuple(session.context.picture.name for session in sessions),
        picture_index=picture,
        observed_px=observed,
        covariance_px2=covariance,
        directions=directions,
        attitudes=np.stack([session.camera_from_j2000 for session in sessions]),
        a_priori=np.stack([session.inputs.a_priori_camera_from_j2000 for session in sessions]),
    )


def psf_pictures(
    sessions: Sequence[ImageSession], min_snr: float, isolation_px: float
) -> tuple[PsfPicture, ...]:
    """Return pictures with their bright stars that have no neighbor within `isolation_px`.

    Stars need not be in the catalog: every detection counts.
    """
    pictures = []
    for session in sessions:
        context = session.context
        found = detect(
            context.signal_dn,
            context.noise_dn,
            context.bad,
            context.camera.psf.sigma_px,
            saturated=context.picture.saturated,
        )
        pictures.append(
            PsfPicture(
                name=context.picture.name,
                signal_dn=context.signal_dn,
                noise_dn=context.noise_dn,
                bad=context.bad | context.picture.saturated,
                pixel_line=found.pixel_line[_bright_and_isolated(found, min_snr, isolation_px)],
                noise_model=context.noise_model,
            )
        )
    return tuple(pictures)


def isolation_px(camera: Camera) -> float:
    """Return how far the neighbors of a star must be that tells the PSF, px."""
    return max(ISOLATION_PX, ISOLATION_SIGMAS * camera.psf.sigma_px)


def sessions_alike(sessions: Sequence[ImageSession]) -> list[ImageSession]:
    """Return the solved pictures whose stars have the shape of most: others are smeared, or out of focus."""
    context = sessions[0].context
    pictures = psf_pictures(sessions, STACK_SNR, isolation_px(context.camera))
    try:
        used = stack_psf(pictures, context.camera_psf).used_pictures
    except CameraError:  # too few bright stars to tell
        return list(sessions)
    return sessions_kept(sessions, used)


def sessions_kept(sessions: Sequence[ImageSession], kept: BoolArray) -> list[ImageSession]:
    """Return those of the sessions that a stack has kept (m,)."""
    return [session for session, used in zip(sessions, kept, strict=True) if bool(used)]


def effective_psf_of(sessions: Sequence[ImageSession], isolation_px: float) -> EffectivePsf:
    """Return what the stars of solved pictures of a camera say of its PSF, beside what the camera file knows.

    Raises
    ------
    CameraError
        As `learn_effective_psf`.
    """
    context = sessions[0].context
    pictures = teaching_pictures(sessions, TEACHING_SNR, isolation_px)
    return learn_effective_psf(pictures, context.camera_psf, context.camera.effective_psf)


def _bright_and_isolated(found: Detections, min_snr: float, isolation_px: float) -> BoolArray:
    clean = (found.snr >= min_snr) & ((found.flags & int(UNFIT_FLAGS)) == 0)
    near = np.hypot(*(found.pixel_line[:, None] - found.pixel_line[None]).transpose(2, 0, 1)) < isolation_px
    np.fill_diagonal(near, val=False)
    crowded = (near & (found.flux_dn[None] > NEIGHBOR_PART * found.flux_dn[:, None])).any(axis=1)
    return np.asarray(clean & ~crowded)


def teaching_pictures(
    sessions: Sequence[ImageSession], min_snr: float, isolation_px: float
) -> tuple[TeachingPicture, ...]:
    """Return solved pictures with their bright stars, as `psf_pictures`, and where the catalog has those that it knows."""
    pictures = []
    for session, picture in zip(sessions, psf_pictures(sessions, min_snr, isolation_px), strict=True):
        context = session.context
        pictures.append(
            TeachingPicture(
                sha256=context.picture.sha256,
                signal_dn=context.signal_dn,
                noise_dn=context.noise_dn,
                bad=context.not_stars,
                saturated=context.picture.saturated,
                pixel_line=picture.pixel_line,
                places=_places(session, picture.pixel_line),
                noise_model=context.noise_model,
            )
        )
    return tuple(pictures)


def _places(session: ImageSession, pixel_line: FloatArray) -> ExpectedPlaces:
    """Return where the catalog has the stars that were seen at (n, 2): not known of those that are not in use."""
    stars, centers = session.state.a_priori, session.state.centers
    assert stars is not None
    assert centers is not None
    used = session.state.mask("used")
    place, sigma = np.array(pixel_line), np.full(len(pixel_line), np.inf)
    if not used.any() or not len(place):
        return ExpectedPlaces(place, sigma)
    apart = np.hypot(*(pixel_line[:, None] - centers.pixel_line[used][None]).transpose(2, 0, 1))
    nearest = apart.argmin(axis=1)
    known = apart.min(axis=1) < SAME_STAR_PX
    predicted = stars.places(session.context.camera, session.camera_from_j2000)[used]
    scatter = np.sqrt(0.5 * np.trace(stars.covariance_px2[used], axis1=1, axis2=2))
    place[known], sigma[known] = predicted[nearest[known]], scatter[nearest[known]]
    return ExpectedPlaces(place, sigma)

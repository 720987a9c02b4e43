"""What other programs read: the marks as a DS9 region file, and the picture with its solved WCS as FITS."""

from pathlib import Path

import numpy as np
from astropy.io import fits
from astropy.wcs import WCS, Sip

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera.distortion import sip_powers, sip_terms
from opnav_workbench.errors import SessionError
from opnav_workbench.files import atomic_path, write_text
from opnav_workbench.geometry import geometric_direction, radec_from_unit
from opnav_workbench.session import ImageSession
from opnav_workbench.workbench.overlays import (
    BodyMarks,
    body_marks,
    expected_directions,
    star_marks,
)

__all__ = ["solved_wcs", "write_fits_with_wcs", "write_regions"]

ONE_BASED = 1.0  # DS9 and FITS count pixels from 1
STAR_PX = 4.0  # radius of a star's circle
REGION_HEAD = ("# Region file format: DS9 version 4.1", "global dashlist=8 3 width=1", "image")
GRID_POINTS = 20  # along each side, that the WCS is fitted to
SIP_DEGREE = 4
MOST_MISFIT_PX = (
    0.01  # of the fitted WCS from the camera model; beyond it the file would say what is not true
)


def write_regions(session: ImageSession, path: Path) -> Path:
    """Write stars and bodies as a DS9 region file, in pixels of the image: observed where measured, else expected."""
    stars = star_marks(session)
    lines = [*REGION_HEAD]
    for kind, color in (("used", "cyan"), ("rejected", "red")):
        columns = getattr(stars, kind)
        rows = zip(columns["pixel"], columns["line"], columns["id"], strict=True)
        lines += [f"{_circle(p, line, STAR_PX)} # color={color} text={{{star}}}" for p, line, star in rows]
    for p, line in zip(stars.missing["pixel"], stars.missing["line"], strict=True):
        lines.append(f"{_circle(p, line, STAR_PX)} # color=magenta dash=1")
    for mark in body_marks(session):
        lines += _body_regions(mark)
    write_text(path, "\n".join(lines) + "\n")
    return path


def _body_regions(mark: BodyMarks) -> list[str]:
    pixel, line = mark.center_px + ONE_BASED
    limb = mark.limb_px if len(mark.limb_px) else mark.predicted_limb_px
    regions = [f"point({pixel:.3f},{line:.3f}) # point=cross color=yellow text={{{mark.name}}}"]
    if len(limb):
        corners = ",".join(f"{value:.3f}" for value in (limb[:-1] + ONE_BASED).ravel())
        regions.append(f"polygon({corners}) # color=yellow" + ("" if mark.observed else " dash=1"))
    return regions


def _circle(pixel: float, line: float, radius: float) -> str:
    return f"circle({pixel + ONE_BASED:.3f},{line + ONE_BASED:.3f},{radius:g})"


def solved_wcs(session: ImageSession) -> WCS:
    """Return the picture's WCS (TAN with SIP) with the best attitude known, J2000, stellar aberration removed.

    Raises
    ------
    SessionError
        The camera's distortion is more than such a WCS can say.

    Notes
    -----
    The convention is that of Shupe et al. (2005), ADASS XIV, ASP 347, 491.
    """
    size = np.array([session.context.camera.n_pixel, session.context.camera.n_line])
    middle = np.rint(0.5 * (size - 1.0))
    axes = [np.linspace(0.0, n - 1.0, GRID_POINTS) for n in size]
    places = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    here = _sky(session, middle[None])[0]
    plane = _tangent_plane_deg(_sky(session, places), here)
    there = np.isfinite(plane).all(axis=1)
    offset = np.asarray(places[there] - middle, dtype=np.float64)
    plane, half = plane[there], 0.5 * float(size.max())
    straight, bent = _polynomial(offset, plane, half)
    ra, dec = radec_from_unit(here)
    wcs = WCS(naxis=2)
    wcs.wcs.ctype, wcs.wcs.cunit = ["RA---TAN-SIP", "DEC--TAN-SIP"], ["deg", "deg"]
    wcs.wcs.crpix, wcs.wcs.crval, wcs.wcs.cd = middle + ONE_BASED, np.degrees([ra, dec]), straight
    forward = np.linalg.solve(straight, bent.reshape(2, -1)).reshape(bent.shape)
    linear = np.asarray(np.linalg.solve(straight, plane.T).T, dtype=np.float64)
    wcs.sip = Sip(*forward, *_polynomial(linear, offset - linear, half, least=0)[1], wcs.wcs.crpix)
    misfit = _misfit_px(wcs, session, places[there])
    if misfit > MOST_MISFIT_PX:
        raise SessionError(f"no WCS follows this camera to better than {misfit:.2g} px: use result.json.")
    return wcs


def _sky(session: ImageSession, places: FloatArray) -> FloatArray:
    """Directions (n, 3) of places, J2000, stellar aberration removed."""
    return geometric_direction(expected_directions(session, places), session.inputs.observer.velocity_km_s)


def _tangent_plane_deg(directions: FloatArray, here: FloatArray) -> FloatArray:
    """Place (n, 2) east and north of `here` in the plane that touches the sky there, deg."""
    east = np.cross([0.0, 0.0, 1.0], here)
    east /= np.linalg.norm(east)
    axes = np.stack([east, np.cross(here, east)], axis=1)
    return np.asarray(np.degrees(directions @ axes / (directions @ here)[:, None]))


def _polynomial(
    places: FloatArray, values: FloatArray, scale: float, least: int = 1
) -> tuple[FloatArray, FloatArray]:
    """Fit values (n, 2) by powers of places: the matrix (2, 2) of the first, and coefficients (2, d+1, d+1) of the others.

    With `least` 0 the first powers count among the others, as a SIP's inverse has them.
    """
    fitted = np.linalg.lstsq(sip_terms(places / scale, SIP_DEGREE), values, rcond=None)[0]
    table = np.zeros((2, SIP_DEGREE + 1, SIP_DEGREE + 1))
    for (p, q), pair in zip(sip_powers(SIP_DEGREE), fitted, strict=True):
        table[:, p, q] = pair / scale ** (p + q)
    straight = np.stack([table[:, 1, 0], table[:, 0, 1]], axis=1)
    if least:
        table[:, 0, 0] = table[:, 1, 0] = table[:, 0, 1] = 0.0
    return straight, table


def _misfit_px(wcs: WCS, session: ImageSession, places: FloatArray) -> float:
    ra, dec = np.degrees(radec_from_unit(_sky(session, places)))
    back = np.stack(wcs.all_world2pix(ra, dec, 0), axis=1)
    return float(np.hypot(*(back - places).T).max())


def write_fits_with_wcs(session: ImageSession, path: Path) -> Path:
    """Write the picture (DN, as it was read) with its solved WCS.

    Raises
    ------
    SessionError
        No field was found, so that there is nothing to say; or see `solved_wcs`.
    """
    state, picture = session.state, session.context.picture
    if state.pointing is None and state.star_field is None:
        raise SessionError(
            "no pointing is solved and no field found: F, then P; the a priori WCS would mislead."
        )
    header = solved_wcs(session).to_header(relax=True)
    header["DATE-OBS"], header["EXPTIME"] = session.inputs.utc, picture.exposure_s
    header["INSTRUME"], header["BUNIT"] = session.context.camera.name, "DN"
    how = "solved from stars" if state.pointing is not None else "of the field found, not solved"
    header["HISTORY"] = f"WCS: attitude {how}; J2000, stellar aberration removed"
    with atomic_path(path) as temporary:
        fits.PrimaryHDU(picture.image_dn.astype(np.float32), header).writeto(temporary, overwrite=True)
    return path

"""A stack's products: the center as an observable, and the files, ready for archive and export as those of any picture.

The observable holds for the mean epoch, against the place predicted for it.  Files are FITS, and ``result.json`` with
``observables.ecsv``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from astropy.io import fits

from opnav_workbench.arrays import FloatArray, symmetric
from opnav_workbench.bodies import BodyCenter
from opnav_workbench.campaign.stacking.combining import Stacked
from opnav_workbench.campaign.stacking.pictures import StackPicture
from opnav_workbench.errors import CenterfindingError, counted
from opnav_workbench.files import atomic_path, make_folder, sha256_of
from opnav_workbench.format_versions import stamped
from opnav_workbench.geometry.times import text_from_et
from opnav_workbench.observables import Observable, Origin, observe
from opnav_workbench.session.result import body_results, kernel_entries
from opnav_workbench.session.storage import RESULT_FILE, TABLE_FILE, write_data, write_table, write_together
from opnav_workbench.version import __version__

__all__ = ["StackProducts", "stack_attitude_covariance", "stack_observable", "write_stack"]


# ---- A stack's center as an observable: at the mean epoch, against the place predicted for it.


def stack_observable(
    stacked: Stacked, center: BodyCenter, *, image: str, utc: str, reference_body: str
) -> Observable:
    """Return the observable of a stack that follows its target.

    Parameters
    ----------
    center
        As `find_in_stack` gives it.
    image, utc, reference_body
        Name of the stack, its epoch in UTC, and the body that the partials refer to.

    Raises
    ------
    CenterfindingError
        A stack without a target.
    """
    if stacked.target is None:
        raise CenterfindingError(
            "a stack without a target makes no observable; stack on the target's motion."
        )
    return observe(
        stacked.target,
        center,
        stacked.grid.camera,
        stacked.grid.camera_from_j2000,
        stack_attitude_covariance(stacked.pictures, stacked.weights),
        observer_velocity_km_s=stacked.grid.observer_velocity_km_s,
        a_priori_px=stacked.predicted_px,
        diameter_px=np.nan,
        image=image,
        et=stacked.et,
        utc=utc,
        reference_body=reference_body,
        pointing_doubt=_pointing_doubt(stacked.pictures),
    )


def _pointing_doubt(pictures: Sequence[StackPicture]) -> str:
    doubtful = [picture for picture in pictures if picture.pointing_doubt]
    if not doubtful:
        return ""
    first = f"{doubtful[0].name}: {doubtful[0].pointing_doubt}"
    return first if len(doubtful) == 1 else f"{first}; and {counted(len(doubtful) - 1, 'more picture')}"


def stack_attitude_covariance(pictures: Sequence[StackPicture], weights: FloatArray) -> FloatArray:
    """Return the covariance (3, 3) of the stack's attitude: errors of centers average out, the catalog's do not."""
    own = [picture.attitude_covariance_rad2 - picture.catalog_covariance_rad2 for picture in pictures]
    common = [picture.catalog_covariance_rad2 for picture in pictures]
    averaged = np.einsum("n,nij->ij", weights**2, np.array(own))
    return symmetric(averaged + np.einsum("n,nij->ij", weights, np.array(common)))


# ---- A stack on disk.

UTC_DECIMALS = 3


@dataclass(frozen=True, slots=True)
class StackProducts:
    """What was written.

    Attributes
    ----------
    folder, picture
        The picture is a FITS file: stack, noise, and pictures in each pixel.
    result
        Content of ``result.json``.
    observable
        None for a stack that follows the stars.
    """

    folder: Path
    picture: Path
    result: Mapping[str, Any]
    observable: Observable | None


def write_stack(
    stacked: Stacked,
    center: BodyCenter | None,
    out: str | Path,
    *,
    mission: str,
    reference_body: str,
    left_out: Sequence[tuple[str, str]] = (),
) -> StackProducts:
    """Write a stack into a folder of its own in `out`.

    Parameters
    ----------
    center
        Of the target, as `find_in_stack` gives it.
    left_out : sequence of (str, str)
        Runs that could not be stacked, and why.

    Raises
    ------
    SessionError
        A file cannot be written.
    """
    name = _name(stacked, center)
    folder = make_folder(Path(out) / name)
    picture = folder / f"{name}.fits"
    _write_fits(stacked, picture)
    utc = text_from_et(stacked.et, UTC_DECIMALS)
    observable = None
    if center is not None and stacked.target is not None:
        observable = stack_observable(
            stacked, center, image=picture.name, utc=utc, reference_body=reference_body
        )
    observables = () if observable is None else (observable,)
    bodies = body_results(observables, (center,)) if center and observables else []
    result = _result(stacked, observable or center, picture, utc, mission, left_out) | {"bodies": bodies}
    write_together(
        {
            folder / RESULT_FILE: partial(write_data, result),
            folder / TABLE_FILE: partial(write_table, observables, Origin.of_result(result)),
        }
    )
    return StackProducts(folder, picture, result, observable)


def _name(stacked: Stacked, center: BodyCenter | None) -> str:
    what = "stars" if center is None else "".join(c if c.isalnum() else "_" for c in center.name).lower()
    return f"stack_{what}_{Path(stacked.pictures[0].name).stem}_{len(stacked.pictures)}"


def _result(
    stacked: Stacked,
    judged: Observable | BodyCenter | None,
    picture: Path,
    utc: str,
    mission: str,
    left_out: Sequence[tuple[str, str]],
) -> dict[str, Any]:
    messages = [*stacked.messages, *(f"{Path(run).name} left out: {reason}" for run, reason in left_out)]
    if judged is not None and judged.status != "ok":
        messages += [f"{judged.name}: {message}" for message in judged.messages]
    found = {
        "image": picture.name,
        "sha256": sha256_of(picture),
        "utc": utc,
        "et": stacked.et,
        "exposure_s": float(sum(one.exposure_s for one in stacked.pictures)),
        "mission": mission,
        "camera": stacked.grid.camera.name,
        "status": "ok" if judged is None or judged.status == "ok" else "partial",
        "messages": messages,
        "pointing": None,
        "stars": [],
        "stack": _stack_facts(stacked),
        "provenance": {
            "version": __version__,
            "kernels": kernel_entries(),
        },
    }
    return stamped("result", found)


def _stack_facts(stacked: Stacked) -> dict[str, Any]:
    values = zip(stacked.pictures, stacked.weights, stacked.response, stacked.hits, strict=True)
    return {
        "follow": stacked.grid.follow,
        "star_field_subtracted": stacked.subtractions is not None,
        "frames": [
            {"image": f.name, "et": f.et, "weight": w, "response": r, "pixels_masked": h}
            for f, w, r, h in values
        ],
        "noise_correlation": stacked.noise_correlation(),
    }


def _write_fits(stacked: Stacked, path: Path) -> None:
    head = fits.Header()
    head["STACKN"] = (len(stacked.pictures), "pictures")
    head["FOLLOW"] = (stacked.grid.follow, "co-registered on")
    head["ET"] = (stacked.et, "weighted mean epoch, TDB s past J2000")
    head["CAMERA"] = stacked.grid.camera.name
    head["FIRSTPIX"] = (int(stacked.grid.first[0]), "of the grid in the reference camera, 0-based")
    head["FIRSTLIN"] = (int(stacked.grid.first[1]), "of the grid in the reference camera, 0-based")
    head["BUNIT"] = ("DN", "of the longest exposure")
    for picture in stacked.pictures:
        head.add_history(picture.name)
    parts = [
        fits.PrimaryHDU(stacked.image_dn, head),
        fits.ImageHDU(stacked.noise_dn, name="NOISE"),
        fits.ImageHDU(stacked.count.astype(np.int16), name="COUNT"),
    ]
    with atomic_path(path) as temporary:
        fits.HDUList(parts).writeto(temporary, overwrite=True)

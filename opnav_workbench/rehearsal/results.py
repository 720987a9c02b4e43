"""What a team made of a rehearsal's pictures: the result of each, and the one observable of each body that counts."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import SessionError
from opnav_workbench.files import read_json, sha256_of
from opnav_workbench.observables import Observable, read_ecsv
from opnav_workbench.paths import is_folder

__all__ = [
    "SURFACE_FROM_PX",
    "PictureResult",
    "chosen_observables",
    "noise_covariances_px2",
    "picture_results",
    "star_turns_rad",
]

RESULT_FILE, TABLE_FILE = "result.json", "observables.ecsv"
RESULT_STATUSES = ("ok", "partial", "failed")
NOT_REPORTED = "missing"
SURFACE_FROM_PX = 3.0  # a body wider than this shows its surface


@dataclass(frozen=True, slots=True, eq=False)
class PictureResult:
    """What a team says of one picture.

    Attributes
    ----------
    name
        Of the picture and of its folder.
    status : {"ok", "partial", "failed", "missing"}
        That of ``result.json``; "missing": there is none.
    result
        The content of ``result.json``; empty where there is none.
    observables
        Of every body and method.
    sha256
        Of the files that count, by name.
    """

    name: str
    status: str
    messages: tuple[str, ...] = ()
    result: Mapping[str, Any] = field(default_factory=dict)
    observables: tuple[Observable, ...] = ()
    sha256: Mapping[str, str] = field(default_factory=dict)

    @property
    def solved(self) -> bool:
        """Whether it claims a pointing from stars."""
        return self.status in ("ok", "partial") and bool(self.result.get("pointing"))

    @property
    def sure(self) -> bool:
        """Whether the star field is recognised beyond doubt."""
        identification = self.result.get("identification") or {}
        return self.solved and bool(identification.get("sure", True))


def picture_results(names: Iterable[str], results: str | Path) -> tuple[PictureResult, ...]:
    """Read what a team made of each picture: ``RESULTS/<picture>/{result.json, observables.ecsv}``.

    Parameters
    ----------
    names
        Of the pictures.
    results
        The folder that ``opnav ort solve`` (or ``opnav process``, or an analyst) wrote.

    Raises
    ------
    SessionError
        The folder is not there, or a file in it is damaged.
    """
    folder = Path(results)
    if not is_folder(folder):
        raise SessionError(f"no folder of results {folder}; give the one that opnav ort solve wrote.")
    return tuple(_read(name, folder / name) for name in names)


def _read(name: str, folder: Path) -> PictureResult:
    path, table = folder / RESULT_FILE, folder / TABLE_FILE
    if not path.is_file():
        return PictureResult(name, NOT_REPORTED, ("no result.json",))
    result = read_json(path, "process the picture again.")
    status = str(result.get("status"))
    if status not in RESULT_STATUSES:
        raise SessionError(
            f"{path}: status {status!r}; expected one of {', '.join(RESULT_STATUSES)}. Process the picture again."
        )
    observables = read_ecsv(table) if table.is_file() and status != "failed" else ()
    hashes = {p.name: sha256_of(p) for p in (path, table) if p.is_file()}
    messages = tuple(str(words) for words in result.get("messages") or ())
    return PictureResult(name, status, messages, result, observables, hashes)


def chosen_observables(
    pictures: Sequence[PictureResult], disk_sigma_px: float = 0.0
) -> tuple[tuple[Observable, ...], tuple[str, ...]]:
    """Return one observable a body and picture, and in words what is left out.

    Of several methods the last that is sure of the body counts: who looks once more means to do better. Pictures without a
    pointing, or whose star field is not recognised beyond doubt, give none.

    Parameters
    ----------
    disk_sigma_px
        Added (in squares) to the sigmas of disks.
    """
    chosen: list[Observable] = []
    left_out: list[str] = []
    for picture in pictures:
        if not picture.sure:
            left_out.append(f"{picture.name}: {_why_not(picture)}")
            continue
        for name in dict.fromkeys(o.name for o in picture.observables):
            usable = [o for o in picture.observables if o.name == name and _usable(o)]
            if usable:
                chosen.append(_weighted(usable[-1], disk_sigma_px))
            else:
                status = next(o.status for o in reversed(picture.observables) if o.name == name)
                left_out.append(f"{name} in {picture.name}: {status.replace('_', ' ')}")
    return tuple(chosen), tuple(left_out)


def noise_covariances_px2(
    pictures: Sequence[PictureResult], observables: Sequence[Observable]
) -> tuple[FloatArray | None, ...]:
    """Return the covariances (2, 2) px^2 of the noise alone in the centers of observables; None where nobody told."""
    told = {
        (str(picture.result.get("image")), str(body.get("name")), str(body.get("method"))): body.get(
            "noise_covariance_px2"
        )
        for picture in pictures
        for body in picture.result.get("bodies") or ()
    }
    found = [told.get((o.image, o.name, o.method)) for o in observables]
    return tuple(None if noise is None else np.array(noise, dtype=np.float64) for noise in found)


def star_turns_rad(pictures: Sequence[PictureResult]) -> dict[str, dict[str, FloatArray]]:
    """Return how far a sigma of each star's catalog errors turns the attitude of each image, (3, 2) rad by image and star.

    Results of programs that do not tell it have none.
    """
    return {
        str(picture.result.get("image")): {
            str(star["id"]): np.array(turn, dtype=np.float64)
            for star in picture.result.get("stars") or ()
            if (turn := star.get("turn_by_catalog_rad")) is not None
        }
        for picture in pictures
    }


def _weighted(observable: Observable, disk_sigma_px: float) -> Observable:
    if not observable.diameter_px > SURFACE_FROM_PX:
        return observable
    added = disk_sigma_px**2 * np.eye(2)
    return replace(
        observable,
        covariance_px2=observable.covariance_px2 + added,
        total_covariance_px2=observable.total_covariance_px2 + added,
    )


def _usable(observable: Observable) -> bool:
    return observable.status == "ok" and observable.observed_px is not None


def _why_not(picture: PictureResult) -> str:
    if picture.solved:
        return "its star field is not recognised beyond doubt"
    reason = picture.messages[0] if picture.messages else "no pointing"
    return f"{picture.status}: {reason}"

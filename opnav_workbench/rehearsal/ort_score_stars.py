"""The stars of a picture against its truth: found, missed, false."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.simulation import Truth

__all__ = ["MISSED_SNR", "StarScore", "score_stars"]

MISSED_SNR = 10.0  # a lone star as bright as this is found always
FALSE_SIGMAS, FALSE_PX = 5.0, 1.0  # a used star farther from its true place than both is something else


@dataclass(frozen=True, slots=True)
class StarScore:
    """The stars of a picture.

    Attributes
    ----------
    found : int
        Used for the pointing, at their true place.
    missed : tuple of str
        Reported as not detected, though bright, on the detector and not hidden.
    false : tuple of str
        Used, though there is no such star there.
    set_aside : int
        Measured but not used: rejected, blended, saturated.
    rms_sigmas : float
        Of the found stars' errors in their own sigmas; nan without.
    """

    found: int = 0
    missed: tuple[str, ...] = ()
    false: tuple[str, ...] = ()
    set_aside: int = 0
    rms_sigmas: float = float("nan")

    @property
    def good(self) -> bool:
        """Whether no star is false, and at most one in ten is missed."""
        return not self.false and self.found > 0 and len(self.missed) <= 0.1 * self.found


def score_stars(result: Mapping[str, Any], truth: Truth) -> StarScore:
    """Hold the stars of a ``result.json`` against the truth's table."""
    rows = result.get("stars") or ()
    objects = truth.objects[truth.objects["kind"] == "star"]
    index = {str(name): i for i, name in enumerate(objects["id"])}
    place = np.column_stack([objects["pixel"].value, objects["line"].value])
    flux = np.asarray(objects["flux"].value, float)
    shown = np.asarray(objects["on_detector"], bool) & ~np.asarray(objects["occulted"], bool)
    used = [row for row in rows if row["status"] == "used" and row["observed"] is not None]
    errors = {row["id"]: _sigmas(row, place[index[row["id"]]]) for row in used if row["id"] in index}
    false = [row["id"] for row in used if row["id"] not in errors or _is_false(row, place, index)]
    per_electron = [row["snr"] / flux[index[row["id"]]] for row in used if row["id"] in index and row["snr"]]
    faint = float(np.median(per_electron)) if per_electron else 0.0
    missed = [
        row["id"]
        for row in rows
        if row["status"] == "not_detected"
        and row["id"] in index
        and shown[index[row["id"]]]
        and faint * flux[index[row["id"]]] >= MISSED_SNR
    ]
    good = np.array([e for name, e in errors.items() if name not in false]).reshape(-1, 2)
    return StarScore(
        found=len(good),
        missed=tuple(missed),
        false=tuple(false),
        set_aside=sum(row["status"] in ("rejected", "blended", "saturated") for row in rows),
        rms_sigmas=float(np.sqrt(np.mean(good**2))) if len(good) else float("nan"),
    )


def _sigmas(row: Mapping[str, Any], true: FloatArray) -> FloatArray:
    return np.asarray((np.asarray(row["observed"], float) - true) / np.asarray(row["sigma_px"], float))


def _is_false(row: Mapping[str, Any], place: FloatArray, index: Mapping[str, int]) -> bool:
    true = place[index[row["id"]]]
    off = float(np.hypot(*(np.asarray(row["observed"], float) - true)))
    return off > FALSE_PX and float(np.abs(_sigmas(row, true)).max()) > FALSE_SIGMAS

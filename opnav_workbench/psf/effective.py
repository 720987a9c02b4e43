"""The effective PSF of a camera as many pictures taught it, kept with its covariance between pictures.

What the stars of a picture say of the correction to the Gaussian (`correction.PsfEvidence`) adds up over pictures; how far
the PSF of one picture may lie from that of the others (focus, smear, temperature) is learned from how they differ.

References: Anderson & King (2000), doi:10.1086/316632; MacKay (1992), doi:10.1162/neco.1992.4.3.415.
"""

import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any, Self

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.errors import CameraError
from opnav_workbench.files import atomic_path
from opnav_workbench.format_versions import FORMAT_KEY, PRESENT_VERSION, as_of_today
from opnav_workbench.psf.correction import (
    PRIOR_AMPLITUDES,
    PsfEvidence,
    layout_of_modes,
    mode_layers,
)

__all__ = ["EffectivePsf"]

KIND = "effective_psf"
ADVICE = "make one with opnav calibrate psf"
ARRAYS = ("log_scale", "ellipticity", "matrix", "right", "scatter", "pictures", "n_stars", "layout")
# How far the modes of one picture may lie from the mean of all, as parts of how far they may lie from a Gaussian.
SCATTERS = (0.0, 0.01, 0.02, 0.03, 0.05, 0.08, 0.12, 0.2, 0.3)
FIRST_SCATTER = 0.05  # of a few pictures, which cannot tell
FEW_PICTURES = 4
NO_INFORMATION = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class EffectivePsf:
    """What the stars of many pictures of a camera say of its PSF.

    Attributes
    ----------
    log_scale, ellipticity
        Of the Gaussian that is corrected: ln(sigma/px), and (e1, e2) as an array (2,).
    evidence
        Of the mean of the pictures' corrections.
    scatter
        One sigma of the modes of one picture about that mean, in sigmas of their prior.
    pictures
        SHA-256 of each picture that taught it: none counts twice.
    n_stars
        In all of them.
    """

    log_scale: float
    ellipticity: FloatArray
    evidence: PsfEvidence
    scatter: float
    pictures: tuple[str, ...]
    n_stars: int

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def sigma_px(self) -> float:
        """Scale of the Gaussian."""
        return float(np.exp(self.log_scale))

    def for_a_picture(self) -> PsfEvidence:
        """Return what is known of the PSF of one more picture: that of the mean, weakened by the scatter."""
        return _weakened(self.evidence, self.scatter)

    @classmethod
    def of_pictures(
        cls, log_scale: float, ellipticity: FloatArray, taught: Mapping[str, tuple[PsfEvidence, int]]
    ) -> Self:
        """Return what pictures say, each with its evidence and the number of its stars, by SHA-256."""
        own = [evidence for evidence, _ in taught.values()]
        scatter = _likeliest_scatter(own)
        return cls(
            log_scale,
            ellipticity,
            PsfEvidence.total([_weakened(evidence, scatter) for evidence in own]),
            scatter,
            tuple(taught),
            sum(n for _, n in taught.values()),
        )

    def with_pictures(self, taught: Mapping[str, tuple[PsfEvidence, int]]) -> Self:
        """Return it with more pictures; one that it has already is left out, and the scatter stays."""
        new = {sha256: found for sha256, found in taught.items() if sha256 not in self.pictures}
        own = [_weakened(evidence, self.scatter) for evidence, _ in new.values()]
        return replace(
            self,
            evidence=PsfEvidence.total([self.evidence, *own]),
            pictures=(*self.pictures, *new),
            n_stars=self.n_stars + sum(n for _, n in new.values()),
        )

    def save(self, path: str | PathLike[str]) -> None:
        """Write it as an npz file, whole or not at all."""
        head: dict[str, Any] = {FORMAT_KEY: np.array(PRESENT_VERSION[KIND]), "kind": np.array(KIND)}
        content: dict[str, Any] = {
            "log_scale": self.log_scale, "ellipticity": self.ellipticity, "matrix": self.evidence.matrix,
            "right": self.evidence.right, "scatter": self.scatter, "pictures": np.array(self.pictures, np.str_),
            "n_stars": self.n_stars, "layout": layout_of_modes(),
        }  # fmt: skip
        with atomic_path(path) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(stream, allow_pickle=False, **head, **content)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Self:
        """Read what `save` wrote.

        Raises
        ------
        CameraError
            The file is missing, damaged, of another kind or of modes that this version does not have.
        """
        content = _content(Path(path))
        layout, count = layout_of_modes(), len(mode_layers())
        matrix, right = (np.asarray(content[name], float) for name in ("matrix", "right"))
        if content["layout"].shape != layout.shape or not np.allclose(content["layout"], layout):
            raise CameraError(f"effective PSF {path} is of other modes than this version's; {ADVICE}.")
        numbers = np.concatenate([matrix.ravel(), right, content["ellipticity"], [content["log_scale"]]])
        if matrix.shape != (count, count) or right.shape != (count,) or not np.isfinite(numbers).all():
            raise CameraError(f"effective PSF {path} is damaged; {ADVICE}.")
        return cls(
            float(content["log_scale"]), np.asarray(content["ellipticity"], float), PsfEvidence(matrix, right),
            float(content["scatter"]), tuple(content["pictures"].tolist()), int(content["n_stars"]),
        )  # fmt: skip


def _content(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as stream:
            if not zipfile.is_zipfile(stream):  # of which numpy would say that it may be a pickle
                raise CameraError(f"effective PSF {path} cannot be read (it is no npz file); {ADVICE}.")
            stream.seek(0)
            with np.load(stream, allow_pickle=False) as archive:
                content = {name: archive[name] for name in archive.files}
    except OSError as error:
        raise CameraError(
            f"effective PSF {path} cannot be read: {error.strerror or error}; {ADVICE}."
        ) from error
    except (ValueError, EOFError, KeyError, zipfile.BadZipFile) as error:
        raise CameraError(f"effective PSF {path} cannot be read ({error}); {ADVICE}.") from error
    missing = [name for name in ("kind", *ARRAYS) if name not in content]
    if missing or str(content["kind"]) != KIND:
        raise CameraError(f"{path} holds no effective PSF (without {', '.join(missing) or KIND}); {ADVICE}.")
    version = content.get(FORMAT_KEY)
    stated = {} if version is None else {FORMAT_KEY: version.tolist()}
    as_of_today(KIND, stated, f"effective PSF {path}", CameraError)
    return content


def _whitened(evidence: PsfEvidence) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Information (k,) along the directions (k, k) of modes in units of their prior, and the vector (k,) along them."""
    sigma = np.asarray(PRIOR_AMPLITUDES)[mode_layers()]
    value, vector = np.linalg.eigh(sigma[:, None] * evidence.matrix * sigma)
    return np.maximum(value, 0.0), vector, vector.T @ (sigma * evidence.right)


def _weakened(evidence: PsfEvidence, scatter: float) -> PsfEvidence:
    """Return what evidence says of modes that scatter about those it is of: (A^-1 + Q)^-1, the same mean."""
    if scatter == 0.0:
        return evidence
    value, vector, right = _whitened(evidence)
    part = 1.0 / (1.0 + scatter**2 * value)
    sigma = np.asarray(PRIOR_AMPLITUDES)[mode_layers()]
    back = vector / sigma[:, None]
    return PsfEvidence((back * (part * value)) @ back.T, back @ (part * right))


def _likeliest_scatter(own: Sequence[PsfEvidence]) -> float:
    """Return the scatter under which the pictures' evidence is likeliest, their mean free within its prior."""
    if len(own) < FEW_PICTURES:
        return FIRST_SCATTER
    parts = [_whitened(evidence) for evidence in own]
    told = [_log_likelihood(parts, scatter) for scatter in SCATTERS]
    return SCATTERS[int(np.argmax(told))]


def _log_likelihood(parts: Sequence[tuple[FloatArray, FloatArray, FloatArray]], scatter: float) -> float:
    matrix, total, told = np.eye(len(mode_layers())), np.zeros(len(mode_layers())), 0.0
    for value, vector, right in parts:
        weaker = 1.0 + scatter**2 * value
        matrix += (vector * (value / weaker)) @ vector.T
        total += vector @ (right / weaker)
        known = value > NO_INFORMATION * value.max()
        told -= 0.5 * float(np.sum(np.log(weaker)))
        told -= 0.5 * float(np.sum(right[known] ** 2 / (value * weaker)[known]))
    _, log_determinant = np.linalg.slogdet(matrix)
    return told + 0.5 * float(total @ np.linalg.solve(matrix, total)) - 0.5 * float(log_determinant)

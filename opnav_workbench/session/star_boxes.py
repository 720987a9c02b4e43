"""Star boxes: what a person looks at to confirm a star, with the numbers that belong to it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.session.context import Context
from opnav_workbench.session.inputs import Inputs
from opnav_workbench.session.pointing import best_attitude
from opnav_workbench.session.state import SessionState, check_star_ids, has_center, predicted_stars
from opnav_workbench.stars import default_box_px, describe_flags

__all__ = ["StarBox", "StarRows", "star_boxes", "star_rows"]


@dataclass(frozen=True, slots=True, eq=False)
class StarBox:
    """One star and the pixels around it; arrays are [line, pixel].

    Attributes
    ----------
    first_px : (int, int)
        Pixel and line of the first pixel of the box on the detector.
    data_dn : (size, size) array
        Background removed; nan where bad, saturated or off the detector.
    model_dn, residual_dn : (size, size) arrays
        Star as fitted, and data minus it; nan where no star was fitted.
    observed_px : (2,) array or None
        Fitted center (pixel, line).
    predicted_px : (2,) array
        Where the star is expected with the best known pointing.
    sigma_px : (2,) array or None
    snr
        nan where nothing was fitted.
    verdict
        ``accepted`` or ``rejected`` by the analyst, else empty.
    flags
        What is known against the center, in words.
    method
        Centerfinder; empty where nothing was fitted.
    """

    id: str
    mag: float
    first_px: tuple[int, int]
    data_dn: FloatArray
    model_dn: FloatArray
    residual_dn: FloatArray
    observed_px: FloatArray | None
    predicted_px: FloatArray
    sigma_px: FloatArray | None
    snr: float
    status: str
    reason: str
    verdict: str
    flags: str
    method: str

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def place_px(self) -> FloatArray:
        """Where the star is seen (2,), expected where it is not."""
        return self.predicted_px if self.observed_px is None else self.observed_px


@dataclass(frozen=True, slots=True, eq=False)
class StarRows:
    """The stars expected or seen on the detector, without their pixels: what orders and tables need, quick for thousands.

    Attributes
    ----------
    row : (n,) array
        Rows of `SessionState.a_priori`.
    mag, snr : (n,) arrays
        snr: nan where nothing was fitted.
    predicted_px, observed_px : (n, 2) arrays
        Where the stars are expected with the best known pointing; the fitted centers, nan where nothing was fitted.
    ids, status, verdict : tuple of str
        As in `StarBox`.
    """

    row: NDArray[np.intp]
    ids: tuple[str, ...]
    mag: FloatArray
    predicted_px: FloatArray
    observed_px: FloatArray
    snr: FloatArray
    status: tuple[str, ...]
    verdict: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def off_px(self) -> FloatArray:
        """Observed minus predicted (n, 2)."""
        return np.asarray(self.observed_px - self.predicted_px)

    @property
    def place_px(self) -> FloatArray:
        """Where each star is seen (n, 2), expected where it is not."""
        return np.where(np.isnan(self.observed_px), self.predicted_px, self.observed_px)

    def taken(self, order: NDArray[np.intp]) -> "StarRows":
        """Return some of them, or all in another order."""
        names = (
            tuple(map(words.__getitem__, order.tolist())) for words in (self.ids, self.status, self.verdict)
        )
        ids, status, verdict = names
        arrays = (self.mag[order], self.predicted_px[order], self.observed_px[order], self.snr[order])
        return StarRows(self.row[order], ids, *arrays, status, verdict)


def star_rows(context: Context, inputs: Inputs, state: SessionState) -> StarRows:
    """Return the stars expected or seen on the detector, in the order of `state.a_priori`.

    Raises
    ------
    SessionError
        No stars are predicted yet.
    """
    stars = predicted_stars(state)
    predicted = stars.places(context.camera, best_attitude(inputs, state, with_identified=True))
    seen: BoolArray = np.asarray(has_center(state))
    row = _shown(context, state, predicted)
    observed, snr = np.full_like(predicted, np.nan), np.full(len(stars), np.nan)
    if state.centers is not None:
        observed[seen], snr = state.centers.pixel_line[seen], np.asarray(state.centers.snr, float)
    ids = tuple(stars.id[row].tolist())
    return StarRows(
        row,
        ids,
        stars.mag[row],
        predicted[row],
        observed[row],
        snr[row],
        tuple(state.status[one].status for one in row.tolist()),
        tuple(state.decisions.get(star, ("", ""))[0] for star in ids),
    )


def _shown(context: Context, state: SessionState, predicted_px: FloatArray) -> NDArray[np.intp]:
    """Return the rows of the stars expected or seen on the detector."""
    return np.flatnonzero(context.camera.on_detector(predicted_px) | has_center(state))


def star_boxes(
    context: Context, inputs: Inputs, state: SessionState, ids: Sequence[str] | None = None
) -> tuple[StarBox, ...]:
    """Return the boxes of stars; see `ImageSession.star_boxes`."""
    stars = predicted_stars(state)
    predicted = stars.places(context.camera, best_attitude(inputs, state, with_identified=True))
    known = stars.id.tolist()
    if ids is None:
        rows = _shown(context, state, predicted).tolist()
    else:
        check_star_ids(stars, ids)
        place = {star: row for row, star in enumerate(known)}
        rows = [place[star] for star in ids]
    images = None if state.centers is None else state.centers.images
    pictured = np.zeros(len(stars), dtype=bool)
    if images is not None:
        pictured[rows] = np.isfinite(images.data_dn[rows]).any(axis=(1, 2))
    sigma_px = None if state.centers is None else state.centers.sigma_px
    measured: BoolArray = np.asarray(has_center(state))
    size = default_box_px((state.psf or context.camera_psf).sigma_px)
    return tuple(
        _box(
            context,
            state,
            predicted,
            sigma_px if measured[row] else None,
            row,
            None if pictured[row] else size,
        )
        for row in rows
    )


def _box(
    context: Context,
    state: SessionState,
    predicted: FloatArray,
    sigma_px: FloatArray | None,
    row: int,
    size: int | None,
) -> StarBox:
    """Return a star's box: of a measured one with the sigmas of all; with a size cut from the picture, as no fit kept it."""
    assert state.a_priori is not None
    star, centers = str(state.a_priori.id[row]), state.centers
    images = None if centers is None else centers.images
    if images is not None and size is None:
        first, data, model = images.first[row], images.data_dn[row], images.model_dn[row]
    else:
        assert size is not None
        first, data = _cut(context, predicted[row], size)
        model = np.full_like(data, np.nan)
    status = state.status[row]
    return StarBox(
        id=star,
        mag=float(state.a_priori.mag[row]),
        first_px=(int(first[0]), int(first[1])),
        data_dn=data,
        model_dn=model,
        residual_dn=data - model,
        observed_px=centers.pixel_line[row] if centers is not None and sigma_px is not None else None,
        predicted_px=predicted[row],
        sigma_px=None if sigma_px is None else sigma_px[row],
        snr=float("nan") if centers is None else float(centers.snr[row]),
        status=status.status,
        reason=status.reason,
        verdict=state.decisions.get(star, ("", ""))[0],
        flags="" if centers is None or sigma_px is None else describe_flags(int(centers.flags[row])),
        method="" if centers is None else state.star_methods.get(star, centers.method),
    )


def _cut(context: Context, place: FloatArray, size: int) -> tuple[FloatArray, FloatArray]:
    """Return first pixel and line of the box about a place, and its data; nan off the detector and in bad pixels."""
    data = np.full((size, size), np.nan)
    if not np.isfinite(place).all():
        return np.zeros(2), data
    first = np.rint(place).astype(int) - size // 2
    n_line, n_pixel = context.signal_dn.shape
    pixel, line = first
    p0, l0, p1, l1 = max(pixel, 0), max(line, 0), min(pixel + size, n_pixel), min(line + size, n_line)
    if p0 < p1 and l0 < l1:
        there = np.s_[l0:l1, p0:p1]
        unusable = context.bad[there] | context.picture.saturated[there]
        data[l0 - line : l1 - line, p0 - pixel : p1 - pixel] = np.where(
            unusable, np.nan, context.signal_dn[there]
        )
    return first, data

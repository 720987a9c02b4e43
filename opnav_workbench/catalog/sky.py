"""Where on the sky the stars of a catalog stand: candidates for a cone without looking at every star."""

import numpy as np

from opnav_workbench.arrays import FloatArray, IntArray

__all__ = ["SkyIndex", "ra_spans", "sort_keys"]

BAND_RAD = np.pi / 360.0  # declination bands of half a degree: a narrow camera's cone touches two or three
GUARD_RAD = 1e-9  # widens the search beyond rounding of the sort keys; the caller's exact test decides
LAST_BAND = np.ceil(np.pi / BAND_RAD) - 1.0
TURN_RAD = 2.0 * np.pi
BELOW_ONE = np.nextafter(1.0, 0.0)


class SkyIndex:
    """Stars sorted by declination band and, within a band, by right ascension.

    Parameters
    ----------
    ra_rad, dec_rad : (n,) ndarray
        Positions; any right ascension, declination within +-pi/2.
    keys : (n,) ndarray, optional
        Their `sort_keys` where the stars stand in that order already, memory-mapped or not; the positions are not
        looked at then.

    Examples
    --------
    >>> index = SkyIndex(np.array([0.1, 6.2, 3.0]), np.array([0.0, 0.0, 0.0]))
    >>> [int(row) for row in np.sort(index.candidates(0.0, 0.0, 0.2))]
    [0, 1]
    """

    __slots__ = ("_keys", "_order")

    def __init__(self, ra_rad: FloatArray, dec_rad: FloatArray, *, keys: FloatArray | None = None) -> None:
        self._order: IntArray | None = None
        if keys is None:
            keys = sort_keys(ra_rad, dec_rad)
            if np.any(keys[1:] < keys[:-1]):
                self._order = np.argsort(keys, kind="stable")
                keys = keys[self._order]
        self._keys = keys

    def candidates(self, ra_rad: float, dec_rad: float, radius_rad: float) -> IntArray:
        """Return rows that contain every star within `radius_rad` of a direction, and a few beyond it."""
        reach = radius_rad + GUARD_RAD
        first, last = (int(_band(np.asarray(edge))) for edge in (dec_rad - reach, dec_rad + reach))
        spans = ra_spans(ra_rad, dec_rad, reach)
        if spans == [(0.0, 1.0)]:
            return self._rows([(float(first), float(last + 1))])
        return self._rows([(band + a, band + b) for band in range(first, last + 1) for a, b in spans])

    def _rows(self, key_ranges: list[tuple[float, float]]) -> IntArray:
        starts = np.searchsorted(self._keys, [low for low, _ in key_ranges], side="left")
        stops = np.searchsorted(self._keys, [high for _, high in key_ranges], side="right")
        places = np.concatenate([np.arange(a, b) for a, b in zip(starts, stops, strict=True)])
        # Ranges that meet at a key may both hold the star that stands on it.
        places = np.unique(places)
        return places if self._order is None else self._order[places]


def ra_spans(ra_rad: float, dec_rad: float, radius_rad: float) -> list[tuple[float, float]]:
    """Return the ranges of right ascension, in turns of 0 to 1, that a cone meets: one, or two across RA 0.

    Examples
    --------
    >>> [(round(a, 3), round(b, 3)) for a, b in ra_spans(0.0, 0.0, 0.02 * np.pi)]
    [(0.0, 0.01), (0.99, 1.0)]
    >>> ra_spans(1.0, 1.5, 0.1)
    [(0.0, 1.0)]
    """
    if abs(dec_rad) + radius_rad >= 0.5 * np.pi:  # the cone holds a pole, so it meets every right ascension
        return [(0.0, 1.0)]
    half = (np.arcsin(np.sin(radius_rad) / np.cos(dec_rad)) + GUARD_RAD) / TURN_RAD
    center = (ra_rad / TURN_RAD) % 1.0
    low, high = float(center - half), float(center + half)
    if high - low >= 1.0:
        return [(0.0, 1.0)]
    spans = [(max(low, 0.0), min(high, 1.0))]
    spans += [(low + 1.0, 1.0)] if low < 0.0 else []
    spans += [(0.0, high - 1.0)] if high > 1.0 else []
    return spans


def sort_keys(ra_rad: FloatArray, dec_rad: FloatArray) -> FloatArray:
    """Return band number plus fraction of a turn in right ascension (n,): the order of a `SkyIndex`."""
    turns = np.minimum((ra_rad / TURN_RAD) % 1.0, BELOW_ONE)
    return np.asarray(_band(dec_rad) + turns)


def _band(dec_rad: FloatArray) -> FloatArray:
    bands = np.floor((np.clip(dec_rad, -0.5 * np.pi, 0.5 * np.pi) + 0.5 * np.pi) / BAND_RAD)
    return np.asarray(np.minimum(bands, LAST_BAND))

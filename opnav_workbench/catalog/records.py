"""Stars as records of fixed size, sorted by their place on the sky: what the cache files hold, memory-mapped.

A record is what `StarTable` says of a star, in small types, and takes 108 bytes; the columns are in rad and rad/yr.
Names are made from a number only when a star is asked for.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.catalog.sky import SkyIndex
from opnav_workbench.catalog.store import Candidates
from opnav_workbench.catalog.table import StarTable

__all__ = ["STAR", "RecordStore", "Records", "star_records"]

STAR = np.dtype(
    [
        ("number", "<i8"),  # turned into the name by the catalog
        ("ra_rad", "<f8"),
        ("dec_rad", "<f8"),
        ("epoch_jyear", "<f8"),
        ("mag", "<f8"),
        ("pmra_rad_yr", "<f4"),
        ("pmdec_rad_yr", "<f4"),
        ("parallax_rad", "<f4"),
        ("sigma", "<f4", (5,)),
        ("position_motion", "<f4", (2,)),
        ("v_mag", "<f4"),
        ("v_sigma", "<f4"),
        ("b_v", "<f4"),
        ("b_v_sigma", "<f4"),
        ("hip", "<i4"),
        ("flags", "<u2"),
        ("band", "u1"),  # place in the list of bands
        ("motion_known", "?"),
    ]
)
Records = NDArray[np.void]
ALIKE = [name for name in STAR.names or () if name not in ("number", "band")]


def star_records(n: int, **columns: Any) -> Records:
    """Return n records with these columns, the others zero.

    Examples
    --------
    >>> star_records(2, ra_rad=[0.1, 0.2])["ra_rad"].tolist()
    [0.1, 0.2]
    """
    records = np.zeros(n, dtype=STAR)
    for name, values in columns.items():
        records[name] = values
    return records


class RecordStore:
    """Records in the order of their sort keys, in memory or memory-mapped.

    Parameters
    ----------
    records : (n,) ndarray of `STAR`
        Sorted by `keys`.
    keys : (n,) ndarray
        Their `sky.sort_keys`.
    bands : sequence of str
        What the column ``band`` counts in.
    names : callable
        Turns records (k,) into their names (k,).
    limits : mapping
        ``brightest_mag`` and ``faintest_mag``.
    """

    __slots__ = ("_bands", "_index", "_limits", "_names", "_records")

    def __init__(
        self,
        records: Records,
        keys: FloatArray,
        bands: Sequence[str],
        names: Callable[[Records], Sequence[str]],
        limits: Mapping[str, float],
    ) -> None:
        self._records, self._names, self._limits = records, names, dict(limits)
        self._bands = np.array(list(bands), dtype=np.str_)
        self._index = SkyIndex(records["ra_rad"], records["dec_rad"], keys=keys)

    def near(self, ra_rad: float, dec_rad: float, radius_rad: float) -> Candidates:
        """Return the stars of the index ranges that the cone meets."""
        rows = self._index.candidates(ra_rad, dec_rad, radius_rad)
        part = self._records[rows]
        return Candidates(rows, part["ra_rad"], part["dec_rad"], part)

    def mag(self, found: Candidates) -> FloatArray:
        """Return the magnitudes."""
        return _records(found)["mag"]

    def flags(self, found: Candidates) -> IntArray:
        """Return the flags."""
        return _records(found)["flags"].astype(np.int64)

    def build(self, found: Candidates) -> StarTable:
        """Return the stars of these records."""
        part = _records(found)
        return StarTable(
            id=np.array(self._names(part), dtype=np.str_),
            band=self._bands[part["band"]],
            rv_km_s=np.full(len(part), np.nan),
            **{name: part[name] for name in ALIKE},
        )

    def summary(self) -> Mapping[str, Any]:
        """Return the number of stars and the limits of their magnitudes."""
        return {"n_stars": len(self._records), **self._limits}


def _records(found: Candidates) -> Records:
    assert found.records is not None  # candidates of this store have their records
    return found.records

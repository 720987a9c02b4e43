"""A table of catalog stars: what a catalog says of them, with sigmas, in radians and Julian years.

Frame  J2000 (ICRS), position at each star's own epoch, motion in RA with the factor cos(dec)
Units  rad, rad/yr, km/s, magnitudes
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.errors import CatalogError
from opnav_workbench.geometry import propagate, propagate_covariance

if TYPE_CHECKING:
    from astropy.table import QTable

__all__ = ["EPOCHS_JYEAR", "DeferredStars", "StarTable"]

EPOCHS_JYEAR = (1000.0, 3000.0)  # of stars that files of others may tell; what lies beyond is no year
N_PARAMETERS = 5  # RA cos(dec), dec, parallax, motion in RA cos(dec), motion in dec
_KINDS: dict[str, Any] = {
    "id": np.str_,
    "band": np.str_,
    "motion_known": np.bool_,
    "flags": np.int64,
    "hip": np.int64,
}  # every other column is float64
_WIDTHS = {"sigma": N_PARAMETERS, "position_motion": 2}  # columns of more than one number a star
_ABSENT = {"flags": 0, "hip": 0, "position_motion": 0.0}  # an optional column left out; nan for every other
_LEFT_OUT = np.empty(0)  # stands for an optional column that was not given


def _left_out() -> Any:
    return _LEFT_OUT


@dataclass(frozen=True, slots=True, eq=False)
class StarTable:
    """Catalog stars, one row a star; every column is read-only and has the same length n.

    Parameters
    ----------
    id : (n,) str
        The catalog's name of the star, such as ``HIP 70890`` or ``row:17``.
    ra_rad, dec_rad : (n,) float
        Position at `epoch_jyear`, J2000 (ICRS).
    pmra_rad_yr, pmdec_rad_yr : (n,) float
        Proper motion, rad per Julian year, with cos(dec) in RA; where `motion_known` is False the
        mean motion of such stars, or 0.
    parallax_rad : (n,) float
        Parallax; 0 where unknown, and then its sigma is that of a star of this magnitude.
    rv_km_s : (n,) float
        Radial velocity, positive when receding; nan where unknown.
    mag : (n,) float
        Magnitude in `band`.
    band : (n,) str
        Passband of `mag`, such as ``G``, ``Hp``, ``VT``.
    epoch_jyear : (n,) float
        Julian epoch of position and motion, such as 2016.0.
    sigma : (n, 5) float
        1 sigma of (RA cos(dec), dec, parallax, motion in RA cos(dec), motion in dec), rad and rad/yr.
    motion_known : (n,) bool
        False where the catalog gives no motion and `sigma` holds what such a star may do.
    v_mag, v_sigma : (n,) float, optional
        Johnson V and its 1 sigma, measured or transformed from the catalog's bands (see `catalog.johnson`);
        nan where unknown, as where left out.
    b_v, b_v_sigma : (n,) float, optional
        Johnson B-V and its 1 sigma, likewise.
    flags : (n,) int, optional
        `StarQuality` flags; 0 where left out.
    position_motion : (n, 2) float, optional
        Covariance of RA cos(dec) with its motion, and of dec with its own, rad^2/yr; 0 where left out. Not 0 where
        a catalog states its sigmas at a mean epoch of observation and its positions at J2000.
    hip : (n,) int, optional
        Hipparcos number, 0 where there is none.

    Raises
    ------
    CatalogError
        A column differs in length from the others, or `sigma` is not (n, 5), or `position_motion` not (n, 2).

    Examples
    --------
    >>> table = StarTable.empty()
    >>> len(table), table.covariance.shape
    (0, (0, 5, 5))
    """

    id: NDArray[np.str_]
    ra_rad: FloatArray
    dec_rad: FloatArray
    pmra_rad_yr: FloatArray
    pmdec_rad_yr: FloatArray
    parallax_rad: FloatArray
    rv_km_s: FloatArray
    mag: FloatArray
    band: NDArray[np.str_]
    epoch_jyear: FloatArray
    sigma: FloatArray
    motion_known: BoolArray
    v_mag: FloatArray = field(default_factory=_left_out)
    v_sigma: FloatArray = field(default_factory=_left_out)
    b_v: FloatArray = field(default_factory=_left_out)
    b_v_sigma: FloatArray = field(default_factory=_left_out)
    flags: IntArray = field(default_factory=_left_out)
    position_motion: FloatArray = field(default_factory=_left_out)
    hip: IntArray = field(default_factory=_left_out)

    def __post_init__(self) -> None:
        n = np.size(self.ra_rad)
        for name in (f.name for f in fields(self)):
            given, kind = getattr(self, name), _KINDS.get(name, np.float64)
            wanted = (n, _WIDTHS[name]) if name in _WIDTHS else (n,)
            if given is _LEFT_OUT:
                given = np.full(wanted, _ABSENT.get(name, np.nan), dtype=kind)
            column: NDArray[Any] = np.asarray(given, dtype=kind)
            if column.size == 0 and n == 0:
                column = column.reshape(wanted)  # no star at all: JSON has forgotten the width
            if column.shape != wanted:
                raise CatalogError(
                    f"star column {name} has shape {column.shape}, expected {wanted}; "
                    "give every column one value a star."
                )
            object.__setattr__(self, name, column)
        freeze_arrays(self)

    def __len__(self) -> int:
        return int(self.ra_rad.size)

    @property
    def covariance(self) -> FloatArray:
        """Covariance (n, 5, 5) of the parameters of `sigma`, rad and rad/yr.

        Of the correlations only those of a position with its own motion are carried.
        """
        matrix = np.zeros((len(self), N_PARAMETERS, N_PARAMETERS))
        matrix[:, range(N_PARAMETERS), range(N_PARAMETERS)] = self.sigma**2
        matrix[:, (0, 1), (3, 4)] = matrix[:, (3, 4), (0, 1)] = self.position_motion
        matrix.setflags(write=False)
        return matrix

    def take(self, rows: ArrayLike | slice) -> Self:
        """Return the rows chosen by an index array (in its order), a boolean mask (n,) or a slice."""
        chosen = rows if isinstance(rows, slice) else np.asarray(rows)
        if isinstance(chosen, np.ndarray) and chosen.size == 0 and chosen.dtype != np.bool_:
            chosen = chosen.astype(np.int64)  # an empty list becomes float64 and could not index
        return type(self)(**{f.name: getattr(self, f.name)[chosen] for f in fields(self)})

    @classmethod
    def concatenate(cls, tables: Sequence["StarTable"]) -> Self:
        """Return the rows of all `tables` one after the other."""
        parts = list(tables) or [cls.empty()]
        return cls(**{f.name: np.concatenate([getattr(t, f.name) for t in parts]) for f in fields(cls)})

    @classmethod
    def empty(cls) -> Self:
        """Return a table without stars."""
        return cls(**{f.name: np.empty(0, dtype=_KINDS.get(f.name, np.float64)) for f in fields(cls)})

    def directions(self, et_s: float, observer_position_km: FloatArray | None = None) -> FloatArray:
        """Return unit vectors (n, 3), J2000, at `et_s` from a barycentric position (km; none: the barycenter).

        Space motion and parallax are applied, stellar aberration is not; see `opnav_workbench.geometry.propagate`.
        """
        return propagate(
            self.ra_rad,
            self.dec_rad,
            self.pmra_rad_yr,
            self.pmdec_rad_yr,
            self.parallax_rad,
            self.rv_km_s,
            self.epoch_jyear,
            et_s,
            observer_position_km,
        )

    def sky_covariance(self, et_s: float, observer_position_km: FloatArray | None = None) -> FloatArray:
        """Return covariances (n, 2, 2) of `directions` toward east and north, rad^2."""
        return propagate_covariance(
            self.covariance,
            self.epoch_jyear,
            et_s,
            self.ra_rad,
            self.dec_rad,
            observer_position_km,
            pmra_rad_yr=self.pmra_rad_yr,
            pmdec_rad_yr=self.pmdec_rad_yr,
            parallax_rad=self.parallax_rad,
            rv_km_s=self.rv_km_s,
        )

    def to_qtable(self) -> "QTable":
        """Return the stars as an astropy QTable for people: degrees, mas, mas/yr, with descriptions."""
        from astropy import units as u  # noqa: PLC0415
        from astropy.table import QTable  # noqa: PLC0415 (a fifth of a short command; few need a table)

        mas, motion = u.mas, u.mas / u.yr

        table = QTable(meta={"frame": "ICRS (J2000)"})
        table["id"] = np.array(self.id)
        for name, values, given, shown, description in (
            ("ra", self.ra_rad, u.rad, u.deg, "right ascension at epoch"),
            ("dec", self.dec_rad, u.rad, u.deg, "declination at epoch"),
            ("pmra", self.pmra_rad_yr, u.rad / u.yr, motion, "proper motion in RA times cos(dec)"),
            ("pmdec", self.pmdec_rad_yr, u.rad / u.yr, motion, "proper motion in dec"),
            ("parallax", self.parallax_rad, u.rad, mas, "parallax"),
            ("rv", self.rv_km_s, u.km / u.s, u.km / u.s, "radial velocity, nan where unknown"),
            ("mag", self.mag, u.mag, u.mag, "magnitude in band"),
            ("epoch", self.epoch_jyear, u.yr, u.yr, "Julian epoch of position and motion"),
            ("sigma_ra", self.sigma[:, 0], u.rad, mas, "1 sigma of RA times cos(dec)"),
            ("sigma_dec", self.sigma[:, 1], u.rad, mas, "1 sigma of dec"),
            ("sigma_parallax", self.sigma[:, 2], u.rad, mas, "1 sigma of parallax"),
            ("sigma_pmra", self.sigma[:, 3], u.rad / u.yr, motion, "1 sigma of pmra"),
            ("sigma_pmdec", self.sigma[:, 4], u.rad / u.yr, motion, "1 sigma of pmdec"),
            ("v_mag", self.v_mag, u.mag, u.mag, "Johnson V, nan where unknown"),
            ("sigma_v_mag", self.v_sigma, u.mag, u.mag, "1 sigma of v_mag"),
            ("b_v", self.b_v, u.mag, u.mag, "Johnson B-V, nan where unknown"),
            ("sigma_b_v", self.b_v_sigma, u.mag, u.mag, "1 sigma of b_v"),
        ):
            table[name] = (values * given).to(shown)
            table[name].info.description = description
        table["band"] = np.array(self.band)
        table["motion_known"] = np.array(self.motion_known)
        table["flags"] = np.array(self.flags)
        table["flags"].info.description = "StarQuality flags"
        table["hip"] = np.array(self.hip)
        table["hip"].info.description = "Hipparcos number, 0 where there is none"
        return table


class DeferredStars(StarTable):
    """Stars whose columns are built when one is asked for: of 100,000 stars that is most of the cost.

    Made by `of`; made as a `StarTable` is (by `dataclasses.replace`, `take`), it is one.
    """

    __slots__ = ("_build", "_columns", "_count")

    _build: Callable[[], StarTable]
    _columns: Mapping[str, Callable[[], FloatArray]]
    _count: int

    @classmethod
    def of(
        cls,
        count: int,
        build: Callable[[], StarTable],
        columns: Mapping[str, Callable[[], FloatArray]] = MappingProxyType({}),
    ) -> "DeferredStars":
        """Return stars that are there, their columns not yet.

        Parameters
        ----------
        count
            Number of stars.
        build
            Returns the whole table.
        columns
            What returns single columns of it, cheaper than the table.
        """
        stars = object.__new__(cls)
        assign = object.__setattr__  # by itself: a loop takes longer than all the rest
        assign(stars, "_count", count)
        assign(stars, "_build", build)
        assign(stars, "_columns", columns)
        return stars

    def __getattr__(self, name: str) -> Any:
        # Python comes here only while the slot is empty.
        if name not in StarTable.__slots__:
            raise AttributeError(f"{type(self).__name__} has no {name!r}")
        if name in self._columns:
            column = self._columns[name]()
            column.setflags(write=False)
            object.__setattr__(self, name, column)
            return column
        whole = self._build()
        for column_name in StarTable.__slots__:
            object.__setattr__(self, column_name, getattr(whole, column_name))
        return getattr(self, name)

    def __len__(self) -> int:
        return self._count if hasattr(self, "_count") else super().__len__()

    def __reduce__(self) -> tuple[Any, ...]:
        return StarTable, tuple(getattr(self, f.name) for f in fields(StarTable))

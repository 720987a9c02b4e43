"""How bright a target is, how that falls with the phase angle, and how far its light lies from its center of figure.

All of it follows from disk-integrated scattering; it serves bodies too small to show a disk. The magnitude of a body is
``H + 5 log10(r D) - 2.5 log10 phi(alpha)``, with r and D its distances from Sun and observer in au and phi a phase function
(1 at full phase) or a straight line in magnitudes. Lambert and Lommel-Seeliger are closed forms for a sphere of uniform
albedo (Russell 1916, ApJ 43, 173; van Diggelen 1959); H,G is the empirical law of asteroids.

`Photometry` is what a mission file says of it: the absolute magnitude is given, or follows from a magnitude measured at a
known geometry (from Earth) or from albedo and size; a phase law takes it to the spacecraft's geometry.
"""

from collections.abc import Callable
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, PositiveFloat, model_validator

from opnav_workbench.arrays import FloatArray
from opnav_workbench.constants import AU_KM
from opnav_workbench.geometry import angle_between
from opnav_workbench.photometry import SUN_V_MAG
from opnav_workbench.targets.target_state import TargetState
from opnav_workbench.yaml_file import StrictModel

__all__ = [
    "EarthApparent",
    "Photometry",
    "absolute_magnitude",
    "center_of_light_radii",
    "diameter_km",
    "disk_magnitude",
    "distance_magnitude",
    "hg_magnitude",
    "hg_phase_function",
    "lambert_phase_function",
    "linear_phase_magnitude",
    "lommel_seeliger_phase_function",
]


# ---- How the light of a whole body falls with the phase angle: 1 at full phase.

# Bowell et al. (1989), Asteroids II, 524: phi_i = W phi_small + (1 - W) phi_large.
HG_A, HG_B, HG_C = (3.332, 1.862), (0.631, 1.218), (0.986, 0.238)


def lambert_phase_function(phase_rad: ArrayLike) -> FloatArray:
    """Return the light of a Lambert sphere over that at full phase.

    Examples
    --------
    >>> lambert_phase_function(np.radians([0.0, 90.0, 180.0])).round(6) + 0.0
    array([1.     , 0.31831, 0.     ])
    """
    a = np.asarray(phase_rad, dtype=np.float64)
    return np.asarray((np.sin(a) + (np.pi - a) * np.cos(a)) / np.pi)


def lommel_seeliger_phase_function(phase_rad: ArrayLike) -> FloatArray:
    """Return the light of a Lommel-Seeliger sphere over that at full phase, for phases below pi.

    Examples
    --------
    >>> lommel_seeliger_phase_function(np.radians([0.0, 90.0])).round(6)
    array([1.      , 0.376775])
    """
    half = np.maximum(0.5 * np.asarray(phase_rad, dtype=np.float64), 1e-12)  # the product is 0 at 0
    return np.asarray(1.0 - np.sin(half) * np.tan(half) * np.log(1.0 / np.tan(0.5 * half)))


def hg_phase_function(phase_rad: ArrayLike, g: float) -> FloatArray:
    """Return the light of a body with slope parameter G over that at full phase; valid to about 120 deg.

    Examples
    --------
    >>> (-2.5 * np.log10(hg_phase_function(np.radians([0.0, 10.0, 20.0]), 0.15))).round(3) + 0.0
    array([0.   , 0.658, 1.   ])
    """
    a = np.asarray(phase_rad, dtype=np.float64)
    half_tan, sine = np.tan(0.5 * a), np.sin(a)
    weight = np.exp(-90.56 * half_tan**2)
    phi = []
    for big_a, big_b, big_c in zip(HG_A, HG_B, HG_C, strict=True):
        small = 1.0 - big_c * sine / (0.119 + 1.341 * sine - 0.754 * sine**2)
        large = np.exp(-big_a * half_tan**big_b)
        phi.append(weight * small + (1.0 - weight) * large)
    return np.asarray((1.0 - g) * phi[0] + g * phi[1])


# ---- How bright a body is, and how far its light lies from its center of figure.

DIAMETER_KM = (
    1329.0  # of a body of albedo 1 and H = 0: by convention, for a Sun of V = -26.76 (Harris & Lagerros 2002)
)


def distance_magnitude(sun_km: float, range_km: float) -> float:
    """Return ``5 log10(r D)``: what the distances from Sun and observer add to an absolute magnitude.

    Examples
    --------
    >>> round(distance_magnitude(2.0 * AU_KM, 0.5 * AU_KM), 6)
    0.0
    """
    return float(5.0 * np.log10(sun_km / AU_KM * (range_km / AU_KM)))


def linear_phase_magnitude(
    absolute_mag: float, slope_mag_deg: float, sun_km: float, range_km: float, phase_rad: float
) -> float:
    """Apparent magnitude with a linear phase law, ``H + 5 log10(r D) + beta alpha``.

    Parameters
    ----------
    absolute_mag
        H: magnitude at 1 au from Sun and observer, phase 0.
    slope_mag_deg
        beta, mag/deg.
    sun_km, range_km
        Distances body - Sun and body - spacecraft.
    phase_rad
        Sun - body - spacecraft angle.

    Examples
    --------
    Pluto from New Horizons in April 2015:

    >>> round(linear_phase_magnitude(-0.55, 0.0294, 32.8 * AU_KM, 0.77 * AU_KM, 0.26), 2)
    6.9
    """
    return float(absolute_mag + distance_magnitude(sun_km, range_km) + slope_mag_deg * np.degrees(phase_rad))


def hg_magnitude(absolute_mag: float, g: float, sun_km: float, range_km: float, phase_rad: float) -> float:
    """Apparent magnitude in the H,G system of asteroids (Bowell et al. 1989).

    Parameters
    ----------
    absolute_mag, g
        H, mag, and slope parameter G.
    sun_km, range_km
        Distances body - Sun and body - spacecraft.
    phase_rad
        Sun - body - spacecraft angle, up to about 120 deg.

    Examples
    --------
    Bennu from OSIRIS-REx on 2018-08-17 (H 20.61, G -0.08), 2.2 million km away:

    >>> round(hg_magnitude(20.61, -0.08, 1.19 * AU_KM, 2.2e6, np.radians(43.0)), 1)
    14.1
    """
    fading = float(hg_phase_function(phase_rad, g))
    return absolute_mag + distance_magnitude(sun_km, range_km) - 2.5 * float(np.log10(fading))


def absolute_magnitude(geometric_albedo: float, diameter: float) -> float:
    """Return H of a body of a geometric albedo and a diameter in km.

    Examples
    --------
    >>> round(absolute_magnitude(0.52, 2376.6), 2), round(absolute_magnitude(0.044, 0.49), 2)
    (-0.55, 20.56)
    """
    return float(5.0 * np.log10(DIAMETER_KM / (diameter * np.sqrt(geometric_albedo))))


def diameter_km(absolute_mag: float, geometric_albedo: float) -> float:
    """Return the diameter of a body, ``1329 km / sqrt(p) 10^(-H/5)``.

    Examples
    --------
    >>> round(diameter_km(20.56, 0.044), 2)
    0.49
    """
    return float(DIAMETER_KM / np.sqrt(geometric_albedo) * 10.0 ** (-0.2 * absolute_mag))


def disk_magnitude(
    geometric_albedo: float,
    radius_km: float,
    sun_km: float,
    range_km: float,
    phase_rad: float,
    phase_function: Callable[[ArrayLike], FloatArray] = lambert_phase_function,
) -> float:
    """Return the V magnitude of a sphere from its albedo and size: the Sun's, reflected.

    The sphere's disk sends back ``p phi(alpha) (R / D)^2 / r^2`` of the sunlight at 1 au.

    Parameters
    ----------
    geometric_albedo
        Brightness at zero phase over that of a white Lambert disk of its size; 2/3 for a white Lambert sphere.
    radius_km
        Of a sphere; of an ellipsoid that of a disk of the area seen.
    sun_km, range_km
        Distances body - Sun and body - spacecraft.
    phase_rad
        Sun - body - spacecraft angle.
    phase_function
        `lambert_phase_function` or `lommel_seeliger_phase_function`.

    Examples
    --------
    The full Moon (p 0.12):

    >>> round(disk_magnitude(0.12, 1737.4, AU_KM, 384400.0, 0.0), 1)
    -12.7
    """
    share = geometric_albedo * phase_function(phase_rad) * (radius_km / range_km * AU_KM / sun_km) ** 2
    with np.errstate(divide="ignore"):
        return float(SUN_V_MAG - 2.5 * np.log10(share))  # infinite where nothing is lit


def center_of_light_radii(phase_rad: float) -> tuple[float, float]:
    """Shift of a sphere's center of light from its center toward the Sun, in radii of the sphere, projected.

    Closed forms for Lambert and Lommel-Seeliger scattering; real surfaces lie between them.

    Parameters
    ----------
    phase_rad
        0 to pi.

    Returns
    -------
    shift, sigma : float
        Mean of the two laws, and half their difference as what is not known of the surface.

    Examples
    --------
    >>> [round(x, 4) for x in center_of_light_radii(np.radians(15.0))]
    [0.0938, 0.0047]
    """
    a = float(np.clip(phase_rad, 1e-9, np.pi - 1e-9))
    disk = np.sin(a) + (np.pi - a) * np.cos(a)
    lambert = 3.0 * np.pi / 16.0 * np.sin(a) * (1.0 + np.cos(a)) / disk
    dark = 1.0 - np.sin(a / 2.0) * np.tan(a / 2.0) * np.log(1.0 / np.tan(a / 4.0))
    lommel_seeliger = 2.0 / (3.0 * np.pi) * np.tan(a / 2.0) * disk / dark
    return float(0.5 * (lambert + lommel_seeliger)), float(0.5 * abs(lambert - lommel_seeliger))


# ---- What a mission file knows of a target's brightness, and its magnitude at the spacecraft.

PHASE_FUNCTIONS = {"lambert": lambert_phase_function, "lommel_seeliger": lommel_seeliger_phase_function}


class EarthApparent(StrictModel):
    """A V magnitude measured from Earth (or anywhere), and where the body was then."""

    mag: float
    sun_au: PositiveFloat
    range_au: PositiveFloat
    phase_deg: Annotated[float, Field(ge=0.0, lt=180.0)] = 0.0


class Photometry(StrictModel):
    """Brightness of a target.

    One of `absolute_mag`, `earth_apparent` and `geometric_albedo` says how bright it is, and at most one of
    `slope_mag_deg`, `g` and `law` how that changes with the phase angle (not at all by default, for an albedo as a
    Lambert sphere).

    Attributes
    ----------
    absolute_mag
        V at 1 au from Sun and observer and phase 0 as the phase law extrapolates it: H.
    earth_apparent
        A measured magnitude.
    diameter_km : float or None
        With an albedo; that of the body's radii where it is not given.
    slope_mag_deg
        Linear phase law.
    g
        Slope parameter of the H,G system.
    law : "lambert" or "lommel_seeliger" or None
        Phase function of a sphere.
    b_v
        Color, from which a camera's magnitude follows; the Sun's by default.

    Examples
    --------
    >>> pluto = Photometry(
    ...     earth_apparent={"mag": 14.2, "sun_au": 32.8, "range_au": 31.9, "phase_deg": 0.9}, slope_mag_deg=0.0294
    ... )
    >>> round(pluto.magnitude(32.9 * AU_KM, 6.3e6, np.radians(15.0)), 2)
    0.22
    """

    absolute_mag: float | None = None
    earth_apparent: EarthApparent | None = None
    geometric_albedo: Annotated[float, Field(gt=0.0)] | None = None
    diameter_km: PositiveFloat | None = None
    slope_mag_deg: float | None = None
    g: float | None = None
    law: Literal["lambert", "lommel_seeliger"] | None = None
    b_v: float = 0.65

    @model_validator(mode="after")
    def _one_of_each(self) -> "Photometry":
        given = [
            name
            for name in ("absolute_mag", "earth_apparent", "geometric_albedo")
            if getattr(self, name) is not None
        ]
        if len(given) != 1:
            raise ValueError("give one of absolute_mag, earth_apparent and geometric_albedo")
        laws = [name for name in ("slope_mag_deg", "g", "law") if getattr(self, name) is not None]
        if len(laws) > 1:
            raise ValueError(f"give one of {' and '.join(laws)}")
        if self.diameter_km is not None and self.geometric_albedo is None:
            raise ValueError("diameter_km goes with geometric_albedo")
        return self

    def magnitude(
        self, sun_km: float, range_km: float, phase_rad: float, radius_km: float | None = None
    ) -> float | None:
        """Return V at a distance from the Sun and from the observer and at a phase angle.

        None where only the albedo is known and neither `diameter_km` nor `radius_km` is; infinite for a body that
        shows no lit surface.
        """
        absolute = self._absolute(radius_km)
        if absolute is None:
            return None
        return absolute + distance_magnitude(sun_km, range_km) + self._fading(phase_rad)

    def of(self, target: TargetState) -> float | None:
        """Return V of a target as it is seen; None where it, or where the Sun is, is not known."""
        if target.sun_position_km is None:
            return None
        radius = None if target.radii_km is None else float(np.cbrt(np.prod(target.radii_km)))
        phase = float(angle_between(target.sun_position_km, -target.position_km))
        mag = self.magnitude(
            float(np.linalg.norm(target.sun_position_km)), target.range_km, phase, radius or None
        )
        return mag if mag is not None and np.isfinite(mag) else None

    def _absolute(self, radius_km: float | None) -> float | None:
        if self.absolute_mag is not None:
            return self.absolute_mag
        if self.earth_apparent is not None:
            seen = self.earth_apparent
            distance = distance_magnitude(seen.sun_au * AU_KM, seen.range_au * AU_KM)
            return seen.mag - distance - self._fading(float(np.radians(seen.phase_deg)))
        radius = radius_km if self.diameter_km is None else 0.5 * self.diameter_km
        if radius is None or self.geometric_albedo is None:
            return None
        return disk_magnitude(self.geometric_albedo, radius, AU_KM, AU_KM, 0.0)

    def _fading(self, phase_rad: float) -> float:
        """Magnitudes that the phase angle takes away."""
        if self.g is not None:
            light = hg_phase_function(phase_rad, self.g)
        elif self.law is not None or (self.geometric_albedo is not None and self.slope_mag_deg is None):
            light = PHASE_FUNCTIONS[self.law or "lambert"](phase_rad)
        else:
            return (self.slope_mag_deg or 0.0) * float(np.degrees(phase_rad))
        with np.errstate(divide="ignore"):
            return float(-2.5 * np.log10(np.maximum(light, 0.0)))

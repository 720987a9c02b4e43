"""Targets against SPICE, and Proxima Centauri against what a parallax means."""

import numpy as np
import pytest
import spiceypy

from opnav_workbench.catalog import read_star_list
from opnav_workbench.errors import KernelError
from opnav_workbench.kernels import KernelSet
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.scene import Observer, body_target, star_target_at, states

AU_KM, YEAR_S = 149597870.7, 31557600.0
PARSEC_KM = AU_KM * 648000.0 / np.pi
MAS = np.pi / 648000.0e3
ET_2020 = 640822081.5  # 2020-04-22, when New Horizons took Proxima Centauri from 47 au
SPACECRAFT = -98


@pytest.fixture(scope="module")
def stars():
    return read_star_list(kernels_meta_dir() / "new_horizons/stars.yaml")


def seen_from(stars, place_km, et=ET_2020):
    return star_target_at("Proxima Cen", stars, 0, et, Observer(np.asarray(place_km), np.zeros(3), "kernels"))


def abeam_of(direction):
    across = np.cross(direction, [0.2, 0.9, -0.3])
    return across / np.linalg.norm(across)


def test_proxima_is_at_its_distance_and_place(stars):
    proxima = seen_from(stars, np.zeros(3))
    assert proxima.is_star
    assert proxima.name == "Proxima Cen"
    assert proxima.magnitude == 8.98
    assert proxima.range_km / PARSEC_KM == pytest.approx(1.3020, abs=1e-4)  # 1 / 0.7680665 arcsec
    _, ra, dec = spiceypy.recrad(proxima.direction)
    years = ET_2020 / YEAR_S - 16.0
    east_mas = (np.degrees(ra) - 217.39232147200883) * 3.6e6 * np.cos(dec)
    assert east_mas == pytest.approx(-3781.741 * years, abs=2.0)  # second order in the motion: 1 mas
    assert (np.degrees(dec) + 62.67607511676666) * 3.6e6 == pytest.approx(769.465 * years, abs=2.0)


def test_parallax_at_47_au_is_36_arcsec_away_from_the_observer(stars):
    here = seen_from(stars, np.zeros(3)).direction
    across = abeam_of(here)
    moved = seen_from(stars, 47.1 * AU_KM * across).direction - here
    # The star comes nearer by 7e-5 in four years: 3 mas of 36 arcsec. The Roemer delay vanishes abeam.
    assert moved @ across / MAS == pytest.approx(-47.1 * 768.0665, abs=5.0)
    assert moved @ np.cross(here, across) / MAS == pytest.approx(0.0, abs=0.1)


def test_covariance_is_position_motion_and_parallax_in_kilometres(stars):
    here = seen_from(stars, np.zeros(3)).direction
    across = abeam_of(here)
    proxima = seen_from(stars, 47.1 * AU_KM * across)
    years = ET_2020 / YEAR_S - 16.0
    other = 0.05**2 + (0.06 * years) ** 2  # mas^2: position and motion
    along = other + (47.1 * 0.05) ** 2  # and the parallax at 47 au
    km = proxima.range_km * MAS
    sideways = np.cross(proxima.direction, across)
    covariance = proxima.covariance_km2
    # The observed direction is 1.8e-4 rad from the catalog's; products of sigmas change by that.
    assert across @ covariance @ across / km**2 == pytest.approx(along, rel=1e-3)
    assert sideways @ covariance @ sideways / km**2 == pytest.approx(other, rel=1e-3)
    assert across @ covariance @ sideways / km**2 == pytest.approx(0.0, abs=1e-3 * along)
    depth = proxima.direction @ covariance @ proxima.direction / km**2
    assert depth == pytest.approx(0.0, abs=1e-9)  # a camera does not see it


def test_rows_are_told_apart(stars):
    origin = Observer(np.zeros(3), np.zeros(3), "kernels")
    wolf = star_target_at("Wolf 359", stars, 1, ET_2020, origin)
    assert wolf.range_km / PARSEC_KM == pytest.approx(1000.0 / 415.1794, abs=1e-4)
    assert np.degrees(np.arcsin(wolf.direction[2])) == pytest.approx(7.0, abs=0.01)


def test_body_target_is_what_spice_says():
    with KernelSet("new_horizons/pluto_approach"):
        et = spiceypy.str2et("2015-07-09T04:29:00")
        pluto = body_target("PLUTO", SPACECRAFT, et)
        position, light_time = spiceypy.spkpos("PLUTO", et, "J2000", "CN", str(SPACECRAFT))
        attitude = spiceypy.pxform("J2000", "IAU_PLUTO", et - light_time)
        sun, _ = spiceypy.spkpos("SUN", et - light_time, "J2000", "CN", "PLUTO")
        phase = spiceypy.phaseq(et, "PLUTO", "SUN", str(SPACECRAFT), "CN")
    assert pluto.position_km == pytest.approx(position, abs=1e-3)
    assert pluto.body_from_j2000 == pytest.approx(attitude, abs=1e-10)
    assert pluto.sun_position_km == pytest.approx(sun, abs=1e-3)
    assert spiceypy.vsep(pluto.sun_position_km.copy(), -pluto.position_km) == pytest.approx(phase, abs=1e-13)
    assert pluto.radii_km.tolist() == [1188.3] * 3
    assert not pluto.is_star
    assert pluto.covariance_km2 is None


def test_sun_where_it_is_if_its_light_left_before_the_kernels_begin():
    """The Sun's light takes 4.5 h to Pluto: at the start of the ephemerides the geometric Sun stands in."""
    with KernelSet("new_horizons/pluto_approach") as kernels:
        windows = {c.body: c.intervals_et for c in kernels.coverage("SPK")}
        start = max(windows[b][0, 0] for b in (10, 9, 999, -98)) + 1800.0
        pluto = body_target("PLUTO", SPACECRAFT, start)
        emitted = start - pluto.range_km / 299792.458
        sun, _ = spiceypy.spkpos("SUN", emitted, "J2000", "NONE", "PLUTO")
        reaches_back = kernels.covers_state("SUN", "PLUTO", emitted, "CN")
    assert np.linalg.norm(pluto.sun_position_km - sun) < (500.0 if reaches_back else 1e-3)  # 4.5 h at 15 m/s


def test_what_kernels_do_not_know_is_left_out_alone(monkeypatch):
    def unknown(*_):
        raise KernelError("no orientation")

    with KernelSet("new_horizons/pluto_approach"):
        et = spiceypy.str2et("2015-07-09T04:29:00")
        monkeypatch.setattr(states, "body_attitude", unknown)
        no_pole = body_target("PLUTO", SPACECRAFT, et)
        monkeypatch.setattr(states, "body_radii_km", unknown)
        point = body_target("PLUTO", SPACECRAFT, et)
        with pytest.raises(KernelError, match="PLUTO"):
            body_target("PLUTO", SPACECRAFT, et + 3.2e8)
    assert no_pole.body_from_j2000 is None
    assert no_pole.radii_km.tolist() == [1188.3] * 3
    assert point.radii_km is None
    assert point.sun_position_km is not None

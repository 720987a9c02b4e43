"""Predicted places against SPICE, a hand-written space motion and a hand-written LORRI."""

from collections.abc import Iterator
from dataclasses import fields, replace

import numpy as np
import pytest
import spiceypy

from opnav_workbench.camera import Camera
from opnav_workbench.catalog import StarTable
from opnav_workbench.kernels import KernelSet
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.scene import Observer, body_target, observer_from_kernels, predict_body, predict_stars
from opnav_workbench.targets import TargetState, star_target

AU_KM, YEAR_S, C_KM_S = 149597870.7, 31557600.0, 299792.458
ARCSEC = np.pi / 648000.0
MAS = 1e-3 * ARCSEC
SPACECRAFT = -98
# nh_lorri_v201.ti, INS-98301_OOC_*
FOCAL_MM, K_PX_MM, CENTER_PX = 2618.4775964615382691, 76.9408555820574094, 511.5
E2, E5, E6 = 2.7172539725122498e-05, -1.9034392552127415e-05, -2.8806647687927984e-05
SAME_PX = 1e-6  # rounding of 50 au in double precision is 1e-9 px; a wrong term is 1e-4 px at least


@pytest.fixture(scope="module")
def lorri() -> Camera:
    return Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/lorri_1x1.yaml")


@pytest.fixture(scope="module")
def kernels() -> Iterator[KernelSet]:
    with KernelSet("new_horizons/pluto_approach") as loaded:
        yield loaded


def lorri_px(directions: np.ndarray) -> np.ndarray:
    """Owen's projection as the comments of the instrument kernel give it; LORRI looks along -Z."""
    x, y = FOCAL_MM * directions[..., :2].T / -directions[..., 2]
    moved = E2 * (x * x + y * y) + E5 * y + E6 * x
    return np.stack([CENTER_PX + K_PX_MM * (x + x * moved), CENTER_PX + K_PX_MM * (y + y * moved)], axis=-1)


def looking_at(direction: np.ndarray) -> np.ndarray:
    """LORRI's attitude with -Z toward a direction and +Y near north."""
    return np.array(spiceypy.twovec(-direction, 3, [0.1, 0.2, 1.0], 2))


def star_table(ra: np.ndarray, dec: np.ndarray, **columns: object) -> StarTable:
    """Build a table of stars at rest and far away at 2016.0 unless told otherwise."""
    n = len(ra)
    base = {
        "id": np.array([f"s{i}" for i in range(n)]),
        "ra_rad": ra,
        "dec_rad": dec,
        **{name: np.zeros(n) for name in ("pmra_rad_yr", "pmdec_rad_yr", "parallax_rad")},
        "rv_km_s": np.full(n, np.nan),
        "mag": np.linspace(8.0, 12.0, n),
        "band": np.full(n, "G"),
        "epoch_jyear": np.full(n, 2016.0),
        "sigma": np.zeros((n, 5)),
        "motion_known": np.ones(n, bool),
    }
    return StarTable(**{**base, **columns})


def field_of_stars(seed: int, n: int = 60) -> tuple[StarTable, np.ndarray]:
    """Nearby, fast stars over LORRI's field, and the field's center."""
    rng = np.random.default_rng(seed)
    ra0, dec0 = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(-1.2, 1.2)
    ra = (ra0 + rng.uniform(-0.0022, 0.0022, n) / np.cos(dec0)) % (2.0 * np.pi)
    dec = dec0 + rng.uniform(-0.0022, 0.0022, n)
    stars = star_table(
        ra,
        dec,
        pmra_rad_yr=rng.normal(0.0, 2000.0, n) * MAS,
        pmdec_rad_yr=rng.normal(0.0, 2000.0, n) * MAS,
        parallax_rad=rng.uniform(10.0, 770.0, n) * MAS,
        rv_km_s=rng.normal(0.0, 60.0, n),
        epoch_jyear=rng.choice([1991.25, 2016.0], n),
        sigma=rng.uniform(0.05, 20.0, (n, 5)) * MAS,
    )
    return stars, np.array(spiceypy.latrec(1.0, ra0, dec0))


def at_rest() -> Observer:
    return Observer(np.zeros(3), np.zeros(3), "kernels")


def far_out(rng: np.random.Generator) -> Observer:
    place, course = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    return Observer(47.1 * AU_KM * place, 14.5 * course, "kernels")


def by_hand(stars: StarTable, et: float, observer: Observer) -> np.ndarray:
    """Each star flown through space in km, seen from the spacecraft, aberrated by CSPICE."""
    seen = []
    for i in range(len(stars)):
        ra, dec = stars.ra_rad[i], stars.dec_rad[i]
        toward = np.array(spiceypy.latrec(1.0, ra, dec))
        east, north = np.array([-np.sin(ra), np.cos(ra), 0.0]), np.cross(toward, [-np.sin(ra), np.cos(ra), 0])
        distance = AU_KM / stars.parallax_rad[i]
        motion = distance / YEAR_S * (stars.pmra_rad_yr[i] * east + stars.pmdec_rad_yr[i] * north)
        motion += stars.rv_km_s[i] * toward
        since = et + observer.position_km @ toward / C_KM_S - (stars.epoch_jyear[i] - 2000.0) * YEAR_S
        sight = distance * toward + motion * since - observer.position_km
        seen.append(spiceypy.stelab(sight / np.linalg.norm(sight), observer.velocity_km_s.copy()))
    return np.array(seen)


@pytest.mark.parametrize("seed", range(4))
def test_stars_agree_with_spice_and_hand_written_steps(lorri, seed):
    stars, center = field_of_stars(seed)
    rng = np.random.default_rng([seed, 7])
    observer, et = far_out(rng), rng.uniform(2.0e8, 7.0e8)
    attitude = looking_at(center)
    predicted = predict_stars(stars, et, observer, lorri, attitude, margin_px=150.0)
    assert len(predicted) > 40
    rows = [int(name[1:]) for name in predicted.id]
    truth = by_hand(stars, et, observer)[rows]
    assert predicted.pixel_line == pytest.approx(lorri_px(truth @ attitude.T), abs=SAME_PX)
    assert predicted.directions == pytest.approx(truth, abs=1e-14)
    assert predicted.mag.tolist() == stars.mag[rows].tolist()


def shift_px(lorri, stars, et, observer) -> np.ndarray:
    """How far effects move the one star from where it stands for a resting observer at its epoch, px."""
    attitude = looking_at(np.array(spiceypy.latrec(1.0, stars.ra_rad[0], stars.dec_rad[0])))
    moved = predict_stars(stars, et, observer, lorri, attitude, margin_px=500.0)
    toward_sky = attitude.T @ np.array(
        [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]
    )  # sky vectors of +pixel and +line
    return moved.pixel_line[0] - CENTER_PX, toward_sky


EPOCH_ET = 16.0 * YEAR_S  # 2016.0


def test_aberration_abeam_is_ten_arcsec_toward_the_velocity(lorri):
    stars = star_table(np.array([1.0]), np.array([-0.4]))
    toward = np.array(spiceypy.latrec(1.0, 1.0, -0.4))
    abeam = np.cross(toward, [0.3, -0.5, 0.8])
    abeam /= np.linalg.norm(abeam)
    shift, axes = shift_px(lorri, stars, EPOCH_ET, Observer(np.zeros(3), 14.5 * abeam, "kernels"))
    theory = FOCAL_MM * K_PX_MM * 14.5 / C_KM_S  # beta px per rad: 9.744 px
    assert theory == pytest.approx(9.74, abs=0.01)
    # Ten pixels off the boresight Owen's distortion adds 5e-5 px.
    assert shift == pytest.approx(theory * abeam @ axes, abs=2e-4)


def test_parallax_moves_a_near_star_away_from_the_observer(lorri):
    stars = star_table(np.array([1.0]), np.array([-0.4]), parallax_rad=np.array([768.0 * MAS]))
    toward = np.array(spiceypy.latrec(1.0, 1.0, -0.4))
    abeam = np.cross(toward, [0.3, -0.5, 0.8])
    abeam /= np.linalg.norm(abeam)
    shift, axes = shift_px(lorri, stars, EPOCH_ET, Observer(47.0 * AU_KM * abeam, np.zeros(3), "kernels"))
    theory = FOCAL_MM * K_PX_MM * 47.0 * 768.0 * MAS  # 35.3 px
    assert theory > 35.0
    assert shift == pytest.approx(-theory * abeam @ axes, abs=2e-3)  # distortion at 35 px: 6e-4 px


def test_proper_motion_runs_east_and_north(lorri):
    ra, dec = 1.0, -0.4
    motion = {"pmra_rad_yr": np.array([-3781.0 * MAS]), "pmdec_rad_yr": np.array([769.0 * MAS])}
    stars = star_table(np.array([ra]), np.array([dec]), **motion)
    shift, axes = shift_px(lorri, stars, EPOCH_ET + 4.3 * YEAR_S, at_rest())
    east = np.array([-np.sin(ra), np.cos(ra), 0.0])
    north = np.array([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)])
    theory = FOCAL_MM * K_PX_MM * 4.3 * (-3781.0 * east + 769.0 * north) * MAS
    assert np.linalg.norm(theory) == pytest.approx(16.2, abs=0.1)
    assert shift == pytest.approx(theory @ axes, abs=5e-4)  # distortion at 16 px: 1e-4 px


def perturbed(stars: StarTable, parameter: int, steps: np.ndarray) -> StarTable:
    """Move one of the five parameters of every star."""
    names = ("ra_rad", "dec_rad", "parallax_rad", "pmra_rad_yr", "pmdec_rad_yr")
    columns = {f.name: np.array(getattr(stars, f.name)) for f in fields(StarTable)}
    steps = steps / np.cos(stars.dec_rad) if parameter == 0 else steps
    columns[names[parameter]] = columns[names[parameter]] + steps
    return StarTable(**columns)


def test_catalog_covariance_is_the_spread_of_the_places(lorri):
    stars, center = field_of_stars(11, 20)
    observer, et, attitude = far_out(np.random.default_rng(3)), 6.4e8, looking_at(center)

    def places(table):
        return predict_stars(table, et, observer, lorri, attitude, margin_px=1000.0).pixel_line

    predicted = predict_stars(stars, et, observer, lorri, attitude, margin_px=1000.0)
    assert len(predicted) == len(stars)
    covariance = np.zeros((len(stars), 2, 2))
    for parameter in range(5):
        sigma = stars.sigma[:, parameter]
        column = (
            places(perturbed(stars, parameter, sigma)) - places(perturbed(stars, parameter, -sigma))
        ) / 2
        covariance += column[:, :, None] * column[:, None, :]
    scale = np.trace(covariance, axis1=1, axis2=2)[:, None, None]
    # What is left out: aberration turns and stretches directions by v/c = 5e-5.
    assert predicted.covariance_px2 / scale == pytest.approx(covariance / scale, abs=2e-4)
    assert np.sqrt(scale).min() > 0.01  # px; the comparison is one of real numbers


def test_margin_keeps_stars_beside_the_detector(lorri):
    places = np.array(
        [[1023.4, 500.0], [1023.6, 500.0], [1025.4, 500.0], [1025.6, 500.0], [-2.4, -2.4], [0, 0]]
    )
    attitude = looking_at(np.array(spiceypy.latrec(1.0, 4.0, 0.3)))
    sky = lorri.unproject(places) @ attitude
    _, ra, dec = np.array([spiceypy.recrad(v) for v in sky]).T
    stars = star_table(ra, dec)
    seen = predict_stars(stars, EPOCH_ET, at_rest(), lorri, attitude, margin_px=2.0)
    assert seen.id.tolist() == ["s0", "s1", "s2", "s4", "s5"]
    assert seen.on_detector.tolist() == [True, False, False, False, True]
    assert predict_stars(stars, EPOCH_ET, at_rest(), lorri, attitude).id.tolist() == ["s0", "s5"]
    behind = predict_stars(stars, EPOCH_ET, at_rest(), lorri, np.diag([1.0, -1.0, -1.0]) @ attitude, 1e6)
    assert len(behind) == 0


def test_take_keeps_columns_together(lorri):
    stars, center = field_of_stars(2, 10)
    predicted = predict_stars(stars, EPOCH_ET, at_rest(), lorri, looking_at(center), 500.0)
    part = predicted.take(np.array([3, 1]))
    assert part.id.tolist() == [predicted.id[3], predicted.id[1]]
    assert (part.covariance_px2 == predicted.covariance_px2[[3, 1]]).all()
    assert (part.pixel_line == predicted.pixel_line[[3, 1]]).all()


# Pluto's diameters in LORRI 1x1 on a straight line through the published closest approach, 13 695 km from Pluto.
EPOCHS = [("2015-07-09T04:29:00", 75.8), ("2015-07-12T08:46:57", 189.1)]


@pytest.mark.parametrize(("utc", "straight_line_px"), EPOCHS)
def test_pluto_stands_where_spice_says_and_has_its_size(kernels, lorri, utc, straight_line_px):
    et = spiceypy.str2et(utc)
    attitude = np.array(spiceypy.pxform("J2000", "NH_LORRI_1X1", et))
    observer = observer_from_kernels(SPACECRAFT, et)
    predicted = predict_body(body_target("PLUTO", SPACECRAFT, et), observer, lorri, attitude)

    apparent, _ = spiceypy.spkpos("PLUTO", et, "J2000", "CN+S", str(SPACECRAFT))
    geometric, _ = spiceypy.spkpos("PLUTO", et, "J2000", "CN", str(SPACECRAFT))
    range_km = np.linalg.norm(geometric)
    assert predicted.pixel_line == pytest.approx(lorri_px(attitude @ apparent), abs=SAME_PX)
    assert predicted.direction == pytest.approx(apparent / np.linalg.norm(apparent), abs=1e-13)
    assert predicted.range_km == pytest.approx(range_km, abs=1e-3)  # light time converges to 1e-3 km
    assert predicted.on_detector
    assert predicted.diameter_px == pytest.approx(straight_line_px, abs=0.3)
    # The tangent cone; distortion where Pluto stands, off the center with Charon, stretches it by up to 7e-4.
    cone = 2.0 * FOCAL_MM * K_PX_MM * np.tan(np.arcsin(1188.3 / range_km))
    assert predicted.diameter_px == pytest.approx(cone, rel=1e-3)
    phase = spiceypy.phaseq(et, "PLUTO", "SUN", str(SPACECRAFT), "LT")
    assert predicted.phase_rad == pytest.approx(phase, abs=1e-5)
    assert np.degrees(predicted.phase_rad) == pytest.approx(15.0, abs=1.0)


def test_limb_surrounds_the_center_at_the_tangent_angle(kernels, lorri):
    et = spiceypy.str2et(EPOCHS[1][0])
    attitude = np.array(spiceypy.pxform("J2000", "NH_LORRI_1X1", et))
    target = body_target("PLUTO", SPACECRAFT, et)
    predicted = predict_body(target, observer_from_kernels(SPACECRAFT, et), lorri, attitude)
    assert predicted.limb_px.shape == (180, 2)
    rays = lorri.unproject(predicted.limb_px) @ attitude
    away = np.arccos(rays @ predicted.direction)
    # Aberration changes the angles by v/c = 5e-5 of themselves.
    assert away == pytest.approx(np.full(180, np.arcsin(1188.3 / target.range_km)), rel=1e-4)
    around = np.unwrap(np.arctan2(*(predicted.limb_px - predicted.pixel_line).T))
    assert abs(around[-1] - around[0]) == pytest.approx(2.0 * np.pi * 179 / 180, abs=1e-2)


def test_a_body_behind_the_camera_has_no_place(kernels, lorri):
    et = spiceypy.str2et(EPOCHS[0][0])
    away = np.diag([1.0, -1.0, -1.0]) @ spiceypy.pxform("J2000", "NH_LORRI_1X1", et)
    target = body_target("PLUTO", SPACECRAFT, et)
    predicted = predict_body(target, observer_from_kernels(SPACECRAFT, et), lorri, away)
    assert np.isnan(predicted.pixel_line).all()
    assert np.isnan(predicted.diameter_px)
    assert not predicted.on_detector
    assert predicted.range_km == target.range_km  # what needs no camera is still there
    assert np.degrees(predicted.phase_rad) == pytest.approx(15.0, abs=1.0)


def test_bodies_without_size_or_sun_say_so(lorri):
    attitude = looking_at(np.array([0.0, 1.0, 0.0]))
    rock = TargetState("ROCK", [0.0, 1e6, 0.0])
    predicted = predict_body(rock, at_rest(), lorri, attitude)
    assert predicted.pixel_line == pytest.approx([CENTER_PX, CENTER_PX], abs=SAME_PX)
    assert np.isnan(predicted.diameter_px)
    assert np.isnan(predicted.phase_rad)
    assert predicted.limb_px.shape == (0, 2)
    assert predict_body(star_target("S", [0, 1, 0], 1e-6), at_rest(), lorri, attitude).diameter_px == 0.0


def test_size_without_orientation_is_a_disk(lorri):
    attitude = looking_at(np.array([0.0, 1.0, 0.0]))
    ball = TargetState("BALL", [0.0, 1e6, 0.0], radii_km=[100.0, 100.0, 100.0])
    turned = replace(ball, body_from_j2000=np.array(spiceypy.rotate(1.1, 2)))
    sizes = [predict_body(b, at_rest(), lorri, attitude).diameter_px for b in (ball, turned)]
    assert sizes == pytest.approx([2e-4 * FOCAL_MM * K_PX_MM] * 2, abs=0.02)  # 40.3 px; the 180-gon: 4e-3 px

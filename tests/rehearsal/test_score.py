"""Truth beside solution: signs, units and sigmas, with errors made by hand."""

from pathlib import Path

import numpy as np
import pytest
import spiceypy

from opnav_workbench.mission import load_mission
from opnav_workbench.rehearsal import compare
from opnav_workbench.simulation.truth import BodyTruth, Truth, body_rows

PX = 12.997e-3 / 2618.4775964615382691  # rad, LORRI 1x1
PREDICTED = np.array(spiceypy.eul2m(0.3, 1.2, -2.0, 3, 1, 3))


@pytest.fixture(scope="module")
def lorri():
    return load_mission("new_horizons").camera_for(
        {"MISSION": "New Horizons", "INSTRU": "lor", "SFORMAT": "1X1"}
    )


def turned(attitude, about_x, about_y, about_z):
    """Turn what the camera sees by small angles (rad) about its own axes."""
    vector = np.array([about_x, about_y, about_z])
    return np.array(spiceypy.axisar(vector, np.linalg.norm(vector))) @ attitude


def moved(attitude, pixel, line, twist_deg=0.0):
    """Move the sky at the boresight by px. LORRI looks along -Z: a turn about +Y moves -Z toward -X."""
    return turned(attitude, line * PX, -pixel * PX, np.radians(twist_deg))


def result_of(attitude, covariance=None, bodies=()):
    quaternion = spiceypy.m2q(np.array(attitude)).tolist()
    covariance = np.diag([1e-12] * 3) if covariance is None else covariance
    pointing = {"quaternion_camera_from_j2000": quaternion, "covariance_rad2": covariance.tolist()}
    return {"pointing": pointing, "bodies": list(bodies)}


def truth_of(attitude, **bodies):
    rows = [
        BodyTruth(n, np.array(c), np.array(c), 1.0, 1.0, 0.0, on_detector=True) for n, c in bodies.items()
    ]
    return Truth(
        picture=Path("p.fit"),
        mission="new_horizons",
        camera="LORRI 1x1",
        utc="2015-04-09T12:00:00.000",
        et=0.0,
        exposure_s=1.0,
        camera_from_j2000=attitude,
        predicted_camera_from_j2000=PREDICTED,
        objects=body_rows(rows),
    )


def test_attitude_errors_are_solved_minus_true(lorri):
    true, solved = moved(PREDICTED, 12.0, -7.0), moved(PREDICTED, 15.0, -8.5)
    pixel, line, twist = compare(truth_of(true), result_of(solved), lorri)
    assert [row.name for row in (pixel, line, twist)] == ["Δpixel", "Δline", "Δtwist"]
    assert [row.unit for row in (pixel, line, twist)] == ["px", "px", "deg"]
    # Distortion at 15 px from the center is 1e-4 px.
    assert [pixel.truth, pixel.solved, pixel.error] == pytest.approx([12.0, 15.0, 3.0], abs=1e-3)
    assert [line.truth, line.solved, line.error] == pytest.approx([-7.0, -8.5, -1.5], abs=1e-3)
    assert twist.error == pytest.approx(0.0, abs=0.01)


def test_twist_error_is_solved_minus_true(lorri):
    def position_angle(attitude):
        """East of north of increasing line, at the boresight, from its definition."""
        _, ra, dec = spiceypy.recrad(-attitude[2])
        north = [-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)]
        east = [-np.sin(ra), np.cos(ra), 0.0]
        return np.degrees(np.arctan2(attitude[1] @ east, attitude[1] @ north))

    true, solved = moved(PREDICTED, 0.0, 0.0, 0.10), moved(PREDICTED, 0.0, 0.0, 0.25)
    twist = compare(truth_of(true), result_of(solved), lorri)[2]
    assert abs(position_angle(solved) - position_angle(true)) == pytest.approx(0.15, abs=1e-9)
    assert twist.error == pytest.approx(position_angle(solved) - position_angle(true), abs=1e-9)
    assert twist.truth == pytest.approx(position_angle(true) - position_angle(PREDICTED), abs=1e-9)


def test_sigmas_are_the_spread_of_the_shifts(lorri):
    sigma_rad = np.array([0.5 * PX, 2.0 * PX, np.radians(0.05)])  # about X, Y, Z: line, pixel, twist
    rng = np.random.default_rng(1)
    covariance = np.diag(sigma_rad**2)
    rows = [
        compare(truth_of(PREDICTED), result_of(turned(PREDICTED, *draw), covariance), lorri)
        for draw in rng.normal(0.0, sigma_rad, (800, 3))
    ]
    errors = np.array([[row.error for row in three] for three in rows])
    stated = [row.sigma for row in rows[0]]
    assert stated == pytest.approx([2.0, 0.5, 0.05], rel=1e-6)  # 76.94085... px/mm is 1/12.997 um to 3e-7
    assert errors.std(axis=0) == pytest.approx(stated, rel=0.1)  # 800 draws: 2.5 %
    assert np.array([[row.sigmas for row in three] for three in rows]).std(axis=0) == pytest.approx(
        1.0, rel=0.1
    )


def test_bodies_are_observed_minus_true(lorri):
    covariance = [[0.04, 0.01], [0.01, 0.25]]
    bodies = (
        {"name": "PLUTO", "observed": [100.5, 199.0], "covariance_px2": covariance},
        {"name": "CHARON", "observed": None, "covariance_px2": covariance},
        {"name": "NIX", "observed": [1.0, 2.0], "covariance_px2": covariance},
    )
    truth = truth_of(PREDICTED, PLUTO=[100.0, 200.0], CHARON=[5.0, 6.0])
    result = {"pointing": None, "bodies": bodies}
    rows = compare(truth, result, lorri)  # no pointing, nothing of CHARON, no truth of NIX
    assert [(row.name, row.unit) for row in rows] == [("PLUTO pixel", "px"), ("PLUTO line", "px")]
    assert [row.error for row in rows] == pytest.approx([0.5, -1.0], abs=1e-12)
    assert [row.sigma for row in rows] == pytest.approx([0.2, 0.5], abs=1e-12)
    assert [row.sigmas for row in rows] == pytest.approx([2.5, -2.0], abs=1e-12)
    assert len(compare(truth, result_of(PREDICTED, bodies=bodies), lorri)) == 5

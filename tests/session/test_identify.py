"""Identification of the field with a wrong a priori pointing, without kernels, and of a field that is another one."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

from opnav_workbench.errors import SessionError
from opnav_workbench.geometry import quaternion_from_matrix, rotation_from_vector
from opnav_workbench.mission import load_mission
from opnav_workbench.rehearsal import DEMO_PICTURES, compare
from opnav_workbench.session import ImageSession
from opnav_workbench.simulation.truth import Truth

MISSION = load_mission("new_horizons")
# The solved move against the applied one: noise of the true pointing (0.1 px) and distortion across 55 px.
MOVE_PX = 0.4
GATE_SIGMAS = 4.0  # one angle in 15 000 by chance; seeds are fixed


def _camera(number: int):
    return MISSION.camera_for(DEMO_PICTURES[number].header)


def _pointed_off(
    truth: Truth, number: int, shift_px: tuple[float, float], twist_deg: float, to: Path
) -> Path:
    """Copy a picture, its header attitude off the true one so that the field lies `shift_px` from its prediction."""
    camera = _camera(number)
    # Seen in the focal plane: a turn about pixel moves the sky along lines, one about line along pixels.
    turn = np.array([-shift_px[1], shift_px[0], 0.0]) * camera.pixel_scale_rad
    turn[2] = np.radians(twist_deg)
    wrong = rotation_from_vector(camera.focal_from_camera.T @ turn) @ truth.camera_from_j2000
    path = Path(shutil.copy(truth.picture, to / "off.fit"))
    with fits.open(path, mode="update") as hdus:
        for key, value in zip(MISSION.keywords["quaternion"], quaternion_from_matrix(wrong.T), strict=True):
            hdus[0].header[key] = float(value)
    return path


@pytest.mark.slow(keep=["shift_px1-lorri", "shift_px2-lorri", "shift_px3-lorri"])
@pytest.mark.parametrize("number", [0, 1], ids=["lorri", "mvic"])
@pytest.mark.parametrize("shift_px", [(55.0, 0.0), (-55.0, 0.0), (0.0, 55.0), (0.0, -55.0), (-39.0, 39.0)])
def test_field_far_off_its_prediction(demo_truths, tmp_path, number, shift_px):
    truth = demo_truths[number]
    session = ImageSession.open(_pointed_off(truth, number, shift_px, 0.0, tmp_path), MISSION)
    session.predict()
    session.find_stars()
    session.repoint()
    result = json.loads(session.to_json())
    pointing = result["pointing"]
    assert result["provenance"]["attitude_source"] == "header"
    assert result["provenance"]["kernels"] == []
    np.testing.assert_allclose([pointing["delta_pixel"], pointing["delta_line"]], shift_px, atol=MOVE_PX)
    assert pointing["n_stars"] == (4, 15)[number]
    rows = compare(truth, result, _camera(number))
    assert len(rows) == 3
    assert all(abs(row.sigmas) < GATE_SIGMAS for row in rows), rows


@pytest.mark.slow
@pytest.mark.parametrize("twist_deg", [-0.3, 0.3])
def test_field_shifted_and_twisted(demo_truths, tmp_path, twist_deg):
    """0.3 deg is 13 px at the ends of the strip; LORRI frames have shown 0.2 deg."""
    session = ImageSession.open(_pointed_off(demo_truths[1], 1, (20.0, -10.0), twist_deg, tmp_path), MISSION)
    session.predict()
    session.find_stars()
    session.repoint()
    rows = compare(demo_truths[1], json.loads(session.to_json()), _camera(1))
    assert all(abs(row.sigmas) < GATE_SIGMAS for row in rows), rows
    # The solved twist undoes the applied one to 0.01 deg (sigma of the strip's twist: a thousandth).
    assert abs(np.degrees(session.state.pointing.delta_twist_rad)) == pytest.approx(0.3, abs=0.01)


@pytest.mark.slow(keep=["0", "1", "2", "3"])
@pytest.mark.parametrize("seed", range(12))
def test_another_field_is_never_identified(demo_truths, tmp_path, seed):
    """Random stars around the field, as many and as bright as there are: no pointing, and a message why."""
    picture = demo_truths[seed % 2].picture
    session = ImageSession.open(picture, MISSION)
    real = session.inputs.stars
    random = np.random.default_rng(seed)
    np.savez(
        tmp_path / "random.npz",
        ra_deg=np.degrees(random.uniform(real.ra_rad.min(), real.ra_rad.max(), len(real))),
        dec_deg=np.degrees(random.uniform(real.dec_rad.min(), real.dec_rad.max(), len(real))),
        mag=random.permutation(real.mag),
    )
    session = ImageSession.open(picture, MISSION, catalog=f"npz:{tmp_path / 'random.npz'}")
    assert session.predict().on_detector.sum() >= 2
    session.find_stars()
    assert session.state.centers is None
    with pytest.raises(SessionError, match="not identified"):
        session.repoint()
    result = json.loads(session.to_json())
    assert (result["status"], result["pointing"]) == ("failed", None)
    assert any("not identified" in message for message in result["messages"])
    assert all(star["observed"] is None for star in result["stars"])

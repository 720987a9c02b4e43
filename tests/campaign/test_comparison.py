"""Two archives beside each other: what moved is told in sigmas, and why it may have."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from opnav_workbench.campaign import Campaign, compare
from opnav_workbench.cli import app
from opnav_workbench.errors import SessionError
from opnav_workbench.geometry.rotations import (
    matrix_from_quaternion,
    quaternion_from_matrix,
    rotation_from_vector,
)

TURNED_RAD = np.array([3e-6, -2e-6, 5e-5])  # about the camera's axes


def other_kernels(result, session):
    """What a night with another trajectory and another attitude gives of picture 1, 2, ...; picture 2 is lost to it."""
    pointing = result["pointing"]
    turned = rotation_from_vector(TURNED_RAD) @ matrix_from_quaternion(
        pointing["quaternion_camera_from_j2000"]
    )
    pointing["quaternion_camera_from_j2000"] = quaternion_from_matrix(turned).tolist()
    result["provenance"]["kernels"][1]["sha256"] = "f" * 64
    for body in result["bodies"]:
        body["residual_px"][0] += 0.5
        if result["image"] == "pic_002.fit":
            body |= {"status": "not_detected", "residual_px": None, "observed": None}
    if result["image"] == "pic_002.fit":
        result["status"] = "partial"


@pytest.fixture
def nights(tmp_path, make_run):
    """Two archives: pictures 0 to 3, and 1 to 4 with other kernels."""
    for name, numbers, edit in (("one", range(4), lambda *_: None), ("two", range(1, 5), other_kernels)):
        for number in numbers:
            make_run(tmp_path / name / f"p{number}", number, edit=edit)
        with Campaign(tmp_path / name / "campaign.sqlite") as campaign:
            campaign.ingest(tmp_path / name)
    return tmp_path / "one", tmp_path / "two"


def test_what_moved_is_found(nights):
    with Campaign(nights[0]) as one, Campaign(nights[1]) as two:
        found = compare(one, two)
        (body,) = two.query("bodies", image="pic_001.fit", body="PLUTO")
        pointing = two.solutions()[f"{1:064x}"]["covariance"]
    assert (found.pictures, found.only_first, found.only_second) == (3, ("pic_000.fit",), ("pic_004.fit",))
    assert found.statuses == (("pic_002.fit", "ok", "partial"),)
    assert {change[0::2] for change in found.bodies} == {("pic_002.fit", "ok")}
    assert [what for what, *_ in found.made_with] == ["kernel latest_leapseconds.tls"]
    turns = found.of("pointing")
    assert len(turns) == 3
    np.testing.assert_allclose(turns[0].moved, TURNED_RAD, atol=1e-12)
    expected = np.sqrt(TURNED_RAD @ np.linalg.solve(np.array(pointing), TURNED_RAD))
    assert turns[0].sigmas == pytest.approx(expected, rel=1e-6)
    pluto = found.of(f"PLUTO, {body['method']}")
    assert [d.image for d in pluto] == ["pic_001.fit", "pic_003.fit"]
    np.testing.assert_allclose(pluto[0].moved, [0.5, 0.0], atol=1e-12)
    assert pluto[0].sigma[0] == pytest.approx(body["covariance_oc_pixel_pixel"] ** 0.5)
    assert list(found.table(above=1e9)["image"]) == []


def test_other_options_are_told(tmp_path, make_run):
    def other_options(result, *_):
        result["provenance"]["settings"]["max_stars"] = 6
        result["pointing"]["model"] = "image_plane"

    for name, edit in (("one", lambda *_: None), ("two", other_options)):
        make_run(tmp_path / name / "p1", 1, edit=edit)
        with Campaign(tmp_path / name / "campaign.sqlite") as campaign:
            campaign.ingest(tmp_path / name)
    with Campaign(tmp_path / "one") as one, Campaign(tmp_path / "two") as two:
        made_with = {what: now for what, _, now in compare(one, two).made_with}
    assert made_with == {"setting max_stars": "6", "pointing model": "image_plane"}


def test_nothing_in_common_is_said(tmp_path, nights, make_run):
    make_run(tmp_path / "three" / "p9", 9)
    with Campaign(tmp_path / "three") as three, Campaign(nights[0]) as one:
        three.ingest(tmp_path / "three")
        with pytest.raises(SessionError, match="no picture in common"):
            compare(one, three)


@pytest.mark.slow
def test_command_tells_and_draws(nights, tmp_path):
    words = ["campaign", "compare", *map(str, nights), "--plot", str(tmp_path / "moved.png")]
    answer = CliRunner().invoke(app, words, env={"COLUMNS": "160"})
    assert answer.exit_code == 0, answer.output
    assert "3 pictures in both, 1 only in the first, 1 only in the second" in answer.output
    assert "kernel latest_leapseconds.tls: 678e32bdb5a7, now ffffffffffff" in answer.output
    assert "pointing: 3 solved in both" in answer.output
    assert (tmp_path / "moved.png").stat().st_size > 10_000
    answer = CliRunner().invoke(app, [*words[:4], "--format", "json", "--above", "0"])
    rows = json.loads(answer.output)["differences"]
    assert {(row["axis"], row["unit"]) for row in rows if row["what"] == "pointing"} == {
        (a, "rad") for a in "xyz"
    }

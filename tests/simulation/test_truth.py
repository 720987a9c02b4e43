"""Truth files: everything comes back, and nothing else does."""

import json
from pathlib import Path

import numpy as np
import pytest
from astropy.table import QTable

from opnav_workbench.errors import SessionError
from opnav_workbench.geometry import matrix_from_quaternion, rotation_from_vector
from opnav_workbench.simulation.charge import CosmicRayHits
from opnav_workbench.simulation.picture import trails
from opnav_workbench.simulation.truth import (
    BodyTruth,
    Truth,
    body_rows,
    read_truth,
    star_rows,
    truth_paths,
    truth_table,
    write_truth,
)

PLUTO = BodyTruth("PLUTO", np.array([10.5, 20.25]), np.array([10.6, 20.2]), 5e5, 6.9, 1.4, True, 0.1, 0.02)
CHARON = BodyTruth("CHARON", np.array([300.0, 2.0]), np.array([np.nan, np.nan]), 0.0, np.nan, 0.7, False, 0.9)


@pytest.fixture
def truth(tmp_path):
    places = np.random.default_rng(1).uniform(0.0, 250.0, (6, 5, 2))
    stars = star_rows(
        [f"TYC {i}" for i in range(6)],
        np.linspace(6.0, 12.0, 6),
        np.geomspace(1e5, 1e2, 6),
        trails(places),
        np.arange(6) < 4,
        np.arange(6) == 2,
    )
    return Truth(
        picture=tmp_path / "lorri_4x4.fit",
        mission="new_horizons",
        camera="LORRI 4x4",
        utc="2015-04-09T12:00:00.000",
        et=481852867.18565,
        exposure_s=0.1,
        camera_from_j2000=rotation_from_vector([0.3, -1.0, 0.2]),
        predicted_camera_from_j2000=rotation_from_vector([0.3, -1.001, 0.2]),
        objects=truth_table(stars, body_rows([PLUTO, CHARON])),
        seed=20150409,
        settings={"detector": {"shot_noise": True}, "psf": {"sigma_px": float("nan")}},
        exposure={"saturated_pixels": 3},
        cosmic_rays=CosmicRayHits(np.ones((2, 2)), np.full((2, 2), 4.5), np.array([800.0, 1200.0])),
        noiseless_electrons=np.random.default_rng(2).uniform(0.0, 1e5, (16, 20)),
    )


def test_everything_comes_back(truth):
    files = write_truth(truth)
    assert [f.name for f in files] == [f"lorri_4x4.truth.{x}" for x in ("json", "ecsv", "fits")]
    for path in (truth.picture, *files):
        again = read_truth(path)
        assert again.picture == truth.picture
        for name in ("mission", "camera", "utc", "et", "exposure_s", "seed"):
            assert getattr(again, name) == getattr(truth, name), name
        assert np.array_equal(again.camera_from_j2000, truth.camera_from_j2000)
        assert np.array_equal(again.predicted_camera_from_j2000, truth.predicted_camera_from_j2000)
        assert again.noiseless_electrons == pytest.approx(truth.noiseless_electrons, rel=1e-7)
        assert np.array_equal(again.cosmic_rays.end_px, truth.cosmic_rays.end_px)
        assert np.array_equal(again.cosmic_rays.electrons, truth.cosmic_rays.electrons)
        assert again.settings["psf"]["sigma_px"] is None
        assert again.objects.colnames == truth.objects.colnames
        for name in truth.objects.colnames:
            assert again.objects[name].info.description == truth.objects[name].info.description
            if name in ("kind", "id"):
                assert list(again.objects[name]) == list(truth.objects[name])
            else:
                got, put = (np.asarray(t[name], dtype=float) for t in (again.objects, truth.objects))
                assert np.array_equal(got, put, equal_nan=True), name
    assert len(list(truth.picture.parent.iterdir())) == 3


def test_what_a_comparison_asks_for(truth):
    write_truth(truth)
    again = read_truth(truth.picture)
    assert sorted(again.bodies) == ["CHARON", "PLUTO"]
    assert again.bodies["PLUTO"].tolist() == [10.5, 20.25]
    assert again.n_stars == 4
    plain = json.loads(truth.picture.with_name("lorri_4x4.truth.json").read_text())
    assert plain["bodies"]["PLUTO"] == [10.5, 20.25]
    assert plain["stars_on_detector"] == 4
    assert plain["picture"] == "lorri_4x4.fit"
    assert np.array(plain["camera_from_j2000"]) == pytest.approx(truth.camera_from_j2000, abs=0.0)
    attitude = matrix_from_quaternion(plain["quaternion_camera_from_j2000"])
    assert attitude == pytest.approx(truth.camera_from_j2000, abs=1e-15)


def test_the_table_says_what_its_columns_are(truth):
    table = truth.objects
    assert isinstance(table, QTable)
    assert all(table[name].info.description for name in table.colnames)
    assert str(table["pixel"].unit) == "pix"
    assert str(table["flux"].unit) == "electron"
    assert list(table["kind"]) == ["body"] * 2 + ["star"] * 6
    assert table["occulted"].tolist() == [False, True, False, False, True, False, False, False]


@pytest.mark.parametrize("bodies", [[], [PLUTO]])
def test_pictures_without_stars_or_bodies(truth, bodies):
    none = star_rows([], [], [], trails(np.empty((0, 2))), [], [])
    empty = Truth(
        **{
            name: getattr(truth, name)
            for name in ("picture", "mission", "camera", "utc", "et", "exposure_s", "camera_from_j2000")
        },
        predicted_camera_from_j2000=truth.camera_from_j2000,
        objects=truth_table(none, body_rows(bodies)),
    )
    write_truth(empty)
    again = read_truth(empty.picture)
    assert again.n_stars == 0
    assert list(again.bodies) == [b.name for b in bodies]
    assert again.noiseless_electrons is None
    assert len(again.cosmic_rays) == 0


def test_missing_and_damaged_files_are_named(truth, tmp_path):
    with pytest.raises(SessionError, match=r"truth of nothing\.fit cannot be read"):
        read_truth(tmp_path / "nothing.fit")
    write_truth(truth)
    description, table, _ = truth_paths(truth.picture)
    table.unlink()
    with pytest.raises(SessionError, match=r"lorri_4x4\.truth\.ecsv"):
        read_truth(truth.picture)
    description.write_text("{")
    with pytest.raises(SessionError, match="JSONDecodeError"):
        read_truth(truth.picture)


def test_names_of_truth_files():
    expected = tuple(Path(f"x/a.b.truth.{e}") for e in ("json", "ecsv", "fits"))
    assert truth_paths("x/a.b.fit") == expected
    assert truth_paths("x/a.b.truth.ecsv") == expected

"""Scenarios made into files: names, bytes, processes, interruptions and full disks."""

import errno
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from astropy.io import fits
from PIL import Image

from opnav_workbench.errors import MissionError, SessionError
from opnav_workbench.image import KeywordMap, read_image
from opnav_workbench.kernels import KernelSet, et_from_utc
from opnav_workbench.kernels.making.make import make_kernels
from opnav_workbench.mission import load_mission
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.scene import body_target
from opnav_workbench.simulation import load_picture_scenario, read_truth, simulate, varied
from opnav_workbench.simulation import output as output_module
from opnav_workbench.simulation.batch import chosen_pictures
from opnav_workbench.simulation.opened_scenario import picture_seed

KERNELS = "new_horizons/pluto_opnav"
LORRI_4X4 = {"name": "lorri", "utc": "2015-04-09T12:00:00", "camera": "lorri_4x4", "exposure_s": 0.1}
SERIES = {
    "name": "series",
    "start": "2015-04-09T12:10:00",
    "stop": "2015-04-09T12:12:00",
    "step_s": 60.0,
    "camera": "lorri_4x4",
    "exposure_s": 0.2,
}


def scenario(**values):
    given = {
        "mission": "new_horizons",
        "kernels": KERNELS,
        "seed": 3,
        "bodies": [{"name": "PLUTO"}, {"name": "CHARON"}],
        "pictures": [LORRI_4X4, SERIES],
    }
    return load_picture_scenario(given | values)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("made")
    finished = []
    reports = simulate(scenario(), out, done=lambda report: finished.append(report.name))
    return out, reports, finished


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def test_every_picture_has_its_files(made):
    out, reports, finished = made
    names = ["lorri", "series_0001", "series_0002", "series_0003"]
    assert [report.name for report in reports] == finished == names
    for name in names:
        for ending in (".fit", ".truth.json", ".truth.ecsv", ".truth.fits", "_log.png"):
            assert (out / f"{name}{ending}").stat().st_size > 100
    assert len(list(out.iterdir())) == 5 * len(names)  # and no temporary ones


def test_flight_readers_take_the_picture_for_their_own(made):
    out, reports, _ = made
    mission = load_mission("new_horizons")
    frame = read_image(out / "lorri.fit", KeywordMap(**mission.keywords))
    truth = read_truth(out / "lorri.fit")
    camera = mission.camera_for(frame.header)
    assert camera.name == "LORRI 4x4" == reports[0].camera
    assert frame.exposure_s == 0.1
    assert frame.utc == truth.utc == "2015-04-09T12:00:00.000"
    predicted = truth.predicted_camera_from_j2000
    assert frame.header_geometry.camera_from_j2000 == pytest.approx(predicted, abs=1e-12)
    assert np.abs(truth.camera_from_j2000 - predicted).max() > 1e-5  # there is something to find


def test_the_truth_holds_what_made_the_picture(made):
    out, reports, _ = made
    values = json.loads((out / "lorri.truth.json").read_text())
    assert values["seed"] == picture_seed(3, "lorri")
    assert values["settings"]["seed"] == 3
    assert values["settings"]["picture"]["camera"] == "lorri_4x4"
    assert sorted(values["bodies"]) == ["CHARON", "PLUTO"]
    truth = read_truth(out / "lorri.fit")
    assert truth.noiseless_electrons.shape == (256, 256)
    assert truth.n_stars >= reports[0].stars_drawn > 0
    assert {body.name: body.regime for body in reports[0].bodies}.keys() == {"PLUTO", "CHARON"}
    assert all(body.snr > 50.0 for body in reports[0].bodies)


@pytest.mark.slow
def test_two_processes_write_the_same_bytes(made, tmp_path):
    out, _, _ = made
    reports = simulate(scenario(), tmp_path, jobs=2)
    assert [report.name for report in reports] == [report.name for report in made[1]]
    assert contents(tmp_path) == contents(out)


def test_a_picture_alone_is_the_same_as_among_others(made, tmp_path):
    (report,) = simulate(scenario(), tmp_path, only=["series_0002"])
    assert report.name == "series_0002"
    assert {name: made[0].joinpath(name).read_bytes() for name in contents(tmp_path)} == contents(tmp_path)


def test_another_seed_is_another_picture(made, tmp_path):
    simulate(scenario(seed=4), tmp_path, only=["lorri"])
    assert (tmp_path / "lorri.fit").read_bytes() != (made[0] / "lorri.fit").read_bytes()


def test_a_raw_picture_has_bias_and_dark_columns_and_is_read_like_one(made, tmp_path):
    raw = scenario(pictures=[LORRI_4X4 | {"level": "raw"}])
    (report,) = simulate(raw, tmp_path)
    with fits.open(report.files[0]) as hdus:
        assert hdus[0].data.shape == (256, 257)  # one dark column in 4x4
        assert hdus[0].data.dtype.kind in "ui"
    mission = load_mission("new_horizons")
    frame = read_image(report.files[0], KeywordMap(**mission.keywords))
    assert frame.image_dn.shape == (256, 256)
    assert np.median(frame.image_dn) == pytest.approx(538.0, abs=2.0)  # the header's bias
    calibrated = read_image(made[0] / "lorri.fit", KeywordMap(**mission.keywords))
    difference = frame.image_dn - calibrated.image_dn  # the same noise, less bias and smear
    assert np.std(difference) < 2.0


def test_only_takes_names_of_pictures_and_series():
    assert [p.name for p in chosen_pictures(scenario(), ["series"])] == [
        "series_0001",
        "series_0002",
        "series_0003",
    ]
    with pytest.raises(MissionError, match=r"no picture named two .*lorri, series"):
        chosen_pictures(scenario(), ["two"])


@pytest.mark.slow
def test_kernels_of_the_caller_serve_a_scenario_without(made, tmp_path):
    alone = scenario(kernels=None)
    with pytest.raises(MissionError, match="kernels: the scenario names no kernels"):
        simulate(alone, tmp_path)
    with KernelSet(KERNELS):
        simulate(alone, tmp_path, only=["lorri", "series_0001"], jobs=2)
    for name in ("lorri.fit", "series_0001.fit"):
        assert (tmp_path / name).read_bytes() == (made[0] / name).read_bytes()


# -- what goes wrong -----------------------------------------------------------------------------------------------


def test_ctrl_c_keeps_what_is_finished(tmp_path):
    def stop(report):
        if report.name == "series_0001":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(scenario(), tmp_path, done=stop)
    assert {path.stem for path in tmp_path.glob("*.fit")} == {"lorri", "series_0001"}
    assert read_truth(tmp_path / "series_0001.fit").n_stars > 0


def test_a_full_disk_is_one_clear_error(tmp_path, monkeypatch):
    real = output_module.write_flight_fits

    def full(path, *arguments):
        if Path(path).stem == "series_0002":
            raise SessionError(
                f"cannot write {path}: No space left on device. Free some space."
            ) from OSError(errno.ENOSPC, "No space left on device")
        return real(path, *arguments)

    monkeypatch.setattr(output_module, "write_flight_fits", full)
    with pytest.raises(SessionError, match="No space left"):
        simulate(scenario(), tmp_path)
    assert {path.stem for path in tmp_path.glob("*.fit")} == {"lorri", "series_0001"}


def test_a_folder_that_cannot_be_written_is_refused_from_processes_too(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(SessionError, match="cannot write into"):
        simulate(scenario(), tmp_path / "file" / "out", jobs=2)


WRONG = [
    ({"bodies": [{"name": "NEMESIS"}]}, r"bodies\.0\.name: .*NEMESIS"),
    ({"pictures": [LORRI_4X4 | {"targets": ["NEMESIS"]}]}, r"pictures\.0\.targets: .*NEMESIS"),
    (
        {"pictures": [LORRI_4X4 | {"camera": "ralph"}]},
        r"camera: unknown camera 'ralph'; new_horizons has lorri_1x1",
    ),
    ({"pictures": [LORRI_4X4 | {"utc": "2016-04-09T12:00:00"}]}, r"pictures\.0\.utc: .*2015"),
    ({"pictures": [LORRI_4X4 | {"exposure_s": 70.0}]}, r"exposure_s: 70 s; LORRI 4x4 takes 0 to 64\.967 s"),
    (
        {"bodies": [{"name": "PLUTO", "albedo": {"map": "file", "file": "none.png"}}]},
        r"bodies\.0\.albedo: .*none",
    ),
    ({"perturbations": {"bodies": [{"name": "NEMESIS"}]}}, r"perturbations\.bodies\.0\.name: .*NEMESIS"),
    ({"kernels": "new_horizons/pluto"}, r"kernels: .*did you mean new_horizons/pluto"),
    ({"catalog": "sao"}, r"catalog: .*use bundled"),
    ({"mission": "voyager"}, "mission: .*unknown mission"),
    (
        {"pictures": [LORRI_4X4], "bodies": [{"name": "SUN", "brightness": "mission"}]},
        "photometry of PLUTO, CHARON",
    ),
]


@pytest.mark.parametrize(("change", "message"), WRONG, ids=[m for _, m in WRONG])
def test_wrong_scenarios_are_refused_before_anything_is_written(change, message, tmp_path):
    with pytest.raises(MissionError, match=message) as caught:
        simulate(scenario(**change), tmp_path / "out")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_a_camera_without_zero_point_names_the_line_of_the_picture(tmp_path):
    """The mission's files are copied, and its camera forgets its photometry."""
    here = load_mission("new_horizons").path.parent
    shutil.copytree(here / "cameras", tmp_path / "cameras")
    shutil.copy(here / "mission.yaml", tmp_path)
    shutil.copy(here / "stars.yaml", tmp_path)
    camera = yaml.safe_load((tmp_path / "cameras/lorri_4x4.yaml").read_text())
    (tmp_path / "cameras/lorri_4x4.yaml").write_text(yaml.safe_dump(camera | {"photometry": {}}))
    content = scenario().model_dump(mode="json", exclude_none=True) | {"mission": "mission.yaml"}
    file = tmp_path / "scenario.yaml"
    file.write_text(yaml.safe_dump(content | {"pictures": [LORRI_4X4]}))
    line = file.read_text().splitlines().index("- camera: lorri_4x4") + 1
    with pytest.raises(
        MissionError, match=rf"line {line}: pictures\.0\.camera: .*zero_point_mag.*bandpass"
    ) as caught:
        simulate(load_picture_scenario(file), tmp_path / "out")
    assert "aperture" in str(caught.value)


def test_a_map_of_the_wrong_size_names_the_line_of_the_body(tmp_path):
    Image.fromarray(np.zeros((30, 50), np.uint8)).save(tmp_path / "map.png")
    file = tmp_path / "scenario.yaml"
    bodies = "- name: CHARON\n- name: PLUTO\n  albedo:\n    map: file\n    file: map.png\n"
    pictures = yaml.safe_dump([LORRI_4X4])
    file.write_text(f"mission: new_horizons\nkernels: {KERNELS}\nbodies:\n{bodies}pictures:\n{pictures}")
    with pytest.raises(MissionError, match=r"line 6: bodies\.1\.albedo: .*50 x 30.*twice as wide as high"):
        simulate(load_picture_scenario(file), tmp_path / "out")


def test_an_albedo_map_in_a_file_is_drawn(made, tmp_path):
    """A body that is bright on one half only has its light off its center."""
    half = np.zeros((64, 128), np.uint8)
    half[:, :64] = 200
    Image.fromarray(half).save(tmp_path / "map.png")
    file = tmp_path / "scenario.yaml"
    body = "{name: PLUTO, albedo: {map: file, file: map.png}}"
    pictures = yaml.safe_dump([LORRI_4X4])
    file.write_text(
        f"mission: new_horizons\nkernels: {KERNELS}\nseed: 3\nbodies: [{body}]\npictures:\n{pictures}"
    )
    simulate(load_picture_scenario(file), tmp_path / "out")
    mapped, even = (read_truth(folder / "lorri.fit") for folder in (tmp_path / "out", made[0]))
    assert mapped.bodies["PLUTO"] == pytest.approx(even.bodies["PLUTO"], abs=1e-9)
    light = [
        t.objects["mean_pixel", "mean_line"][list(t.objects["id"]).index("PLUTO")] for t in (mapped, even)
    ]
    moved = np.hypot(*[float((light[0][c] - light[1][c]).value) for c in ("mean_pixel", "mean_line")])
    assert 0.02 < moved < 0.6  # px, of a radius of 0.6


# -- motion --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_trails_are_those_of_the_attitude_as_flown(tmp_path):
    """The header's kernels hold still; those as flown shake by 3 px along the line axis."""
    content = yaml.safe_load((kernels_meta_dir() / f"{KERNELS}.yaml").read_text())
    content["pointing"]["actual"] = {
        "jitter": [{"axis": "line", "frequency_hz": 2.0, "amplitude_px": 3.0}],
        "jitter_windows": [{"start": "2015-04-09T11:59:55", "end": "2015-04-09T12:00:05"}],
    }
    (tmp_path / "flown.yaml").write_text(yaml.safe_dump(content))
    for table in (kernels_meta_dir() / "new_horizons").glob("*.csv"):
        shutil.copy(table, tmp_path)
    make_kernels(tmp_path / "flown.yaml", tmp_path / "kernels", actual=True)
    actual = next((tmp_path / "kernels").glob("*_actual.tm"))
    attitude = {"actual": {"source": "kernels", "kernels": str(actual)}, "motion": {"from_kernels": True}}
    picture = LORRI_4X4 | {"camera": "lorri_1x1", "exposure_s": 1.0}
    simulate(scenario(attitude=attitude, pictures=[picture]), tmp_path / "out")
    objects = read_truth(tmp_path / "out" / "lorri.fit").objects
    # Two whole swings of 12 px each, and a tenth of a pixel of the plan's own motion.
    assert objects["smear"].value == pytest.approx(np.full(len(objects), 24.0), abs=0.8)


def test_a_body_that_the_camera_cannot_see_leaves_the_picture_alone(tmp_path):
    with KernelSet(
        KERNELS
    ):  # beside Pluto, which passes by at 57 px a second, far from where the camera looks
        pluto_km = body_target("PLUTO", -98, et_from_utc(LORRI_4X4["utc"])).position_km
    beside = {"spacecraft": {"position_km": (pluto_km + np.array([5e4, 0.0, 0.0])).tolist()}}
    given = {"bodies": [{"name": "PLUTO"}], "pictures": [LORRI_4X4 | {"exposure_s": 1.0}]}
    reports = simulate(scenario(perturbations=beside, **given), tmp_path)
    assert np.isnan(reports[0].bodies[0].center_px).all()


def test_a_body_without_spin_is_a_sphere_when_asked(tmp_path):
    nix = {"name": "NIX", "brightness": "albedo"}
    later = {
        "kernels": "new_horizons/pluto_approach",
        "pictures": [LORRI_4X4 | {"utc": "2015-06-02T12:00:00"}],
    }
    with pytest.raises(MissionError, match="radius_km"):
        simulate(scenario(bodies=[nix], **later), tmp_path)
    reports = simulate(scenario(bodies=[nix | {"radius_km": 20.0}], **later), tmp_path)
    assert 0.0 < reports[0].bodies[0].diameter_px < 0.1


# -- variations ----------------------------------------------------------------------------------------------------


def test_a_variation_changes_what_is_asked_and_nothing_else():
    base = scenario()
    same = varied(base)
    assert same.model_dump() == base.model_dump()
    other = varied(
        base,
        exposure_s=0.5,
        noise=False,
        law="minnaert",
        albedo="mottled",
        offset_body="PLUTO",
        toward_sun_km=50.0,
    )
    assert [p.exposure_s for p in other.pictures] == [0.5, 0.5]
    assert not other.detector.shot_noise
    assert other.detector.read_noise is None
    assert {body.law.law for body in other.bodies} == {"minnaert"}
    assert {body.albedo.map for body in other.bodies} == {"mottled"}
    assert other.perturbations.bodies[0].toward_sun_km == 50.0
    assert other.seed == base.seed
    with pytest.raises(MissionError, match="exposure_s"):
        varied(base, exposure_s=-1.0)

"""``opnav body solve``: from simulated pictures to a PCK that SPICE loads, and words for what was not observed."""

import json

import numpy as np
import pytest
import spiceypy
import yaml
from typer.testing import CliRunner

from opnav_workbench.cli import app
from opnav_workbench.contracts.layouts import BodyFile
from opnav_workbench.mission import MissionFile, load_mission
from opnav_workbench.render import AlbedoMap

WIDE = {"COLUMNS": "160", "NO_COLOR": "1", "TERM": "dumb"}
TIMES = ("2015-07-11T02:00:00", "2015-07-12T02:00:00")
KERNELS = "new_horizons/pluto_approach"


def invoke(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments], env=WIDE)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    folder = tmp_path_factory.mktemp("approach")
    scenario = {
        "mission": "new_horizons",
        "kernels": KERNELS,
        "bodies": [{"name": "PLUTO", "law": {"law": "lunar_lambert"}, "albedo": 0.5}],
        "pictures": [
            {"name": f"p{k}", "utc": time, "camera": "lorri_4x4", "exposure_s": 0.02}
            for k, time in enumerate(TIMES)
        ],
    }
    (folder / "scenario.yaml").write_text(yaml.safe_dump(scenario))
    answer = invoke("simulate", folder / "scenario.yaml", "--out", folder)
    assert answer.exit_code == 0, answer.output
    return sorted(folder.glob("p?.fit"))


@pytest.mark.slow
def test_a_body_is_solved_from_files_and_written_as_pck(pictures, tmp_path):
    out = tmp_path / "pluto"
    answer = invoke(
        "body", "solve", "PLUTO", *pictures, "-m", "new_horizons", "--kernels", KERNELS, "--passes", 1,
        "--position-sigma", 1000, "--velocity-sigma", 1e-5, "--size-sigma", 0.03, "--axes-sigma", 0.01, "--out", out,
    )  # fmt: skip
    assert answer.exit_code == 0, answer.output
    assert "radius a, km" in answer.output
    assert "the spin rate is not observed" in answer.output
    answer = invoke("check", out / "PLUTO.json")
    assert answer.exit_code == 0, answer.output
    assert "body of a sequence, sound" in answer.output
    content = json.loads((out / "PLUTO.json").read_text())
    assert not BodyFile.model_validate_json(json.dumps(content)).model_extra, (
        "describe it in contracts.layouts"
    )
    radii, sigma = np.array(content["radii_km"]), np.array(content["radii_sigma_km"])
    assert np.all(np.abs(radii - 1188.3) < 3.0 * sigma)
    assert np.all(sigma < 0.02 * 1188.3)
    try:
        spiceypy.furnsh(str(out / "PLUTO.tpc"))
        assert np.allclose(spiceypy.bodvcd(999, "RADII", 3)[1], radii, rtol=1e-12)
    finally:
        spiceypy.kclear()
    lines = yaml.safe_load((out / "PLUTO.yaml").read_text())
    told, albedo = (
        content["albedo_map"],
        AlbedoMap.from_file(lines["target_surfaces"]["PLUTO"]["albedo_map"]["file"]),
    )
    assert albedo.values.shape == (told["lines"], 2 * told["lines"])
    assert 0.1 < told["seen_share"] < 1.0
    assert told["absolute"], "LORRI's response is known"
    assert np.std(albedo.values) < 0.03 * np.mean(
        albedo.values
    )  # drawn without a pattern, as bright as the mission says
    assert [one["image"] for one in told["gains"]] == ["p0.fit", "p1.fit"]
    surface = MissionFile.model_fields["target_surfaces"]
    assert surface is not None
    assert 0.0 < lines["target_surfaces"]["PLUTO"]["size_sigma"] < 0.03
    assert load_mission("new_horizons") is not None


def test_wrong_use_costs_one_line(tmp_path):
    answer = invoke("body", "solve", "PLUTO", tmp_path / "none.fit", "-m", "new_horizons")
    assert answer.exit_code != 0
    assert "give kernels" in str(answer.exception)
    answer = invoke(
        "body", "solve", "PLUTO", tmp_path / "none.fit", "-m", "new_horizons", "--kernels", KERNELS
    )
    assert "none of 1 pictures can be used" in str(answer.exception)
    assert "none.fit" in str(answer.exception)
    assert "Traceback" not in answer.output

"""Files that the program writes and the package brings are sound; each fault of a mutated one is a line with its field."""

import datetime as dt
import json
import re
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from opnav_workbench.cli import app
from opnav_workbench.contracts import KINDS, check_file, schema_of
from opnav_workbench.contracts.kinds import kind_of_content
from opnav_workbench.errors import SessionError
from opnav_workbench.files import json_text
from opnav_workbench.processing.pictures import failed_result
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.yaml_file import read_content

READY = sorted(p for p in kernels_meta_dir().rglob("*.yaml") if p.parent.name != "headers")


def plain(value):
    """A YAML file's content as JSON would hold it."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value.isoformat() if isinstance(value, dt.date) else value


def refusals(kind, content):
    return [error.message for error in jsonschema.Draft202012Validator(schema_of(kind)).iter_errors(content)]


@pytest.fixture(scope="session")
def result() -> dict:
    """A result as the program writes it, from numbers of our own."""
    rotation = [[3e-14, 0.0, 0.0], [0.0, 2e-14, 0.0], [0.0, 0.0, 9e-12]]
    pointing = {
        "ra_deg": 270.5, "dec_deg": -14.6, "twist_deg": 240.2, "quaternion_camera_from_j2000": [0.8, 0.6, 0.0, 0.0],
        "covariance_rad2": rotation, "delta_pixel": 1.0, "delta_line": 2.0, "delta_twist_deg": 0.1,
        "iterations": [{"delta_pixel": 1.0, "delta_line": 2.0, "delta_twist_deg": 0.1}], "rms_px": 0.02, "n_stars": 4,
        "model": "euler", "excess_sigma_px": 0.0, "chi2_reduced": 1.1, "twist_solved": True,
    }  # fmt: skip
    star = {
        "id": "HIP 1", "mag": 8.0, "a_priori": [1.0, 2.0], "predicted": [3.0, 4.0], "observed": [3.5, 4.25],
        "sigma_px": [0.1, 0.1], "residual_px": [0.5, 0.25], "snr": 50.0, "status": "used", "reason": "", "method": "psf_fit",
    }  # fmt: skip
    covariance = [[0.01, 0.002], [0.002, 0.02]]
    numbers = (
        "diameter_px measured_diameter_px diameter_sigma_px range_km measured_range_km range_sigma_km brightness_scale "
        "ra_deg dec_deg apparent_ra_deg apparent_dec_deg snr chi2_reduced"
    )
    body = dict.fromkeys(numbers.split(), 1.5) | {
        "name": "PLUTO", "method": "disk", "a_priori": [1.0, 2.0], "predicted": [3.0, 4.0], "observed": [3.5, 4.25],
        "residual_px": [0.5, 0.25], "covariance_px2": covariance, "noise_covariance_px2": covariance,
        "covariance_with_pointing_px2": covariance, "joint_covariance_px2": {"CHARON": covariance},
        "partials_px_per_km": [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], "residual_arcsec": [0.1, 0.2], "second_reading": None,
        "scans_used": None, "flags": "", "status": "ok", "messages": [],
    }  # fmt: skip
    return {
        "format_version": 1, "image": "a.fit", "sha256": "a" * 64, "utc": "2015-07-12T18:46:55.939",
        "et": 489998884.123, "exposure_s": 0.1, "mission": "new_horizons", "camera": "LORRI 1x1", "status": "ok",
        "messages": [], "identification": None, "pointing": pointing, "stars": [star], "bodies": [body],
        "provenance": {"version": "0.1.0", "kernels": [{"file": "a.bsp", "sha256": "b" * 64}], "catalog": "bundled"},
    }  # fmt: skip


def checked(tmp_path, name, content, kind=None):
    path = tmp_path / name
    path.write_text(content if isinstance(content, str) else json_text(content), encoding="utf-8")
    return check_file(path, kind).faults


# ---- Sound files


@pytest.mark.slow(
    keep=[
        "new_horizons/mission.yaml",
        "osiris_rex/cameras/mapcam.yaml",
        "osiris_rex/sequences/bennu_approach.yaml",
    ]
)
@pytest.mark.parametrize("path", READY, ids=lambda p: str(p.relative_to(kernels_meta_dir())))
def test_ready_files_are_what_their_schemas_say(path):
    content = plain(read_content(path, "file", SessionError))
    kind = kind_of_content(content, yaml=True)
    expected = {
        "cameras": "camera",
        "pictures": "pictures",
        "sequences": "sequence",
        "rehearsals": "rehearsal",
    }
    by_name = {"mission.yaml": "mission", "manifest.yaml": "manifest", "stars.yaml": "stars"}
    assert kind.name == expected.get(path.parent.name, by_name.get(path.name, "scenario"))
    assert refusals(kind, content) == []


@pytest.mark.slow
def test_ready_files_are_sound():
    assert {path: check_file(path).faults for path in READY} == dict.fromkeys(READY, ())


@pytest.mark.slow
def test_files_of_a_processed_picture_are_sound(demo_truths, tmp_path):
    """What the program really writes: nothing in it that its layout does not name."""
    how = ["-m", "new_horizons", "--kernels", "new_horizons/pluto_opnav", "--out", str(tmp_path)]
    run = CliRunner().invoke(app, ["process", str(demo_truths[0].picture), *how])
    assert run.exit_code in (0, 3), run.output
    folder = tmp_path / demo_truths[0].picture.stem
    for name in ("result", "session"):
        content = json.loads((folder / f"{name}.json").read_text())
        assert refusals(KINDS[name], content) == []
        assert unnamed(KINDS[name].model, content) == [], "describe it in contracts.layouts"
    answer = CliRunner().invoke(
        app, ["check", *map(str, folder.glob("*.json")), str(folder / "observables.ecsv")]
    )
    assert answer.exit_code == 0, answer.output
    assert answer.output.count("sound") == 3


def unnamed(model, content) -> list[str]:
    """Names in a file that its layout does not know, at any depth."""
    extra = []

    def walk(item, at):
        extra.extend(f"{at}{key}" for key in getattr(item, "__pydantic_extra__", None) or {})
        for name in getattr(type(item), "model_fields", {}):
            value = getattr(item, name)
            for i, part in enumerate(value if isinstance(value, list) else [value]):
                walk(part, f"{at}{name}.{i}.")

    walk(model.model_validate_json(json.dumps(content)), "")
    return extra


def test_failed_picture_is_a_result(tmp_path):
    (tmp_path / "a.fit").write_bytes(b"no picture")
    content = failed_result(tmp_path / "a.fit", "new_horizons", "no picture")
    assert checked(tmp_path, "result.json", content) == ()
    assert refusals(KINDS["result"], content) == []


# ---- Mutated files


def test_sound_result(result, tmp_path):
    assert checked(tmp_path, "result.json", result) == ()
    assert refusals(KINDS["result"], result) == []


MUTATIONS = {
    ("status",): ("fine", "status: "),
    ("sha256",): ("abc", "sha256: "),
    ("et",): ("today", "et: "),
    ("format_version",): (2, "format_version: 2 is newer"),
    ("pointing", "dec_deg"): (95.0, "pointing.dec_deg: "),
    ("pointing", "n_stars"): (3.5, "pointing.n_stars: "),
    ("pointing", "iterations", 0, "delta_line"): ("2", "pointing.iterations.0.delta_line: "),
    ("stars", 0, "observed"): ([1.0], "stars.0.observed: "),
    ("stars", 0, "status"): ("seen", "stars.0.status: "),
    ("bodies", 0, "partials_px_per_km"): ([[1.0, 2.0, 3.0]], "bodies.0.partials_px_per_km: "),
    ("provenance", "kernels", 0, "sha256"): ("", "provenance.kernels.0.sha256: "),
}


def changed(content, place, value):
    copy = json.loads(json_text(content))
    part = copy
    for key in place[:-1]:
        part = part[key]
    if value is ...:
        del part[place[-1]]
    else:
        part[place[-1]] = value
    return copy


@pytest.mark.parametrize("place", MUTATIONS, ids=lambda p: ".".join(map(str, p)))
def test_mutated_result_is_refused_by_schema_and_check(result, tmp_path, place):
    value, words = MUTATIONS[place]
    content = changed(result, place, value)
    (fault,) = checked(tmp_path, "result.json", content)
    assert fault.startswith(words)
    assert refusals(KINDS["result"], content)


@pytest.mark.parametrize(
    "place", [("image",), ("bodies",), ("pointing", "covariance_rad2"), ("bodies", 0, "observed")]
)
def test_missing_field_of_a_result(result, tmp_path, place):
    content = changed(result, place, ...)
    (fault,) = checked(tmp_path, "result.json", content)
    assert str(place[-1]) in fault
    assert refusals(KINDS["result"], content)


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        (("bodies", 0, "residual_px"), [0.5, 0.35], r"^bodies\.0: residual is not observed minus predicted"),
        (
            ("bodies", 0, "covariance_px2"),
            [[1.0, 2.0], [2.0, 1.0]],
            r"^bodies\.0\.covariance_px2: .*negative variance",
        ),
        (
            ("bodies", 0, "covariance_px2"),
            [[1.0, 0.1], [0.2, 1.0]],
            r"^bodies\.0\.covariance_px2: .*symmetric",
        ),
        (("pointing", "quaternion_camera_from_j2000"), [1.0, 1.0, 0.0, 0.0], r"length 1"),
    ],
)
def test_values_that_contradict_each_other(result, tmp_path, place, value, words):
    """What a schema cannot say."""
    (fault,) = checked(tmp_path, "result.json", changed(result, place, value))
    assert re.search(words, fault)


@pytest.fixture
def body():
    sigma = np.full(20, 1e-3)
    sigma[3:6] = 1e-9
    covariance = np.diag(sigma**2).tolist()
    three, small = [0.28, 0.27, 0.25], [2.8e-4, 2.7e-4, 2.5e-4]
    return {
        "format_version": 1, "version": "0.1.0", "body": "BENNU", "body_id": 2101955, "epoch_et": 6e8, "radii_km": three,
        "radii_sigma_km": small, "a_priori_radii_km": three, "pole_ra_deg": 85.0, "pole_dec_deg": -60.0,
        "pole_sigma_deg": [0.1, 0.1], "prime_meridian_deg": [140.0, 2011.2], "phase_sigma_deg": 0.1, "spin_rate_rad_s": 4e-4,
        "spin_sigma_rad_s": 1e-9, "center_of_figure_km": [0.0, 0.0, 0.0], "center_of_figure_sigma_km": small,
        "state_correction": [0.1] * 6, "covariance": covariance, "a_priori_covariance": covariance,
        "images": [{"image": "a", "attitude_correction_rad": [0.0, 0.0, 0.0],
                    "attitude_covariance_rad2": np.diag([1e-12] * 3).tolist()}],
        "residuals": [{"image": "a", "kind": "outline", "residual_px": [0.1] * 5, "sigmas": 0.4, "used": True,
                       "reason": ""}],
        "excess_px": 0.0, "chi2": 4.0, "degrees_of_freedom": 5, "converged": True, "observability": [], "messages": [],
        "left_out": [],
    }  # fmt: skip


def test_sound_body(body, tmp_path):
    assert checked(tmp_path, "BENNU.json", body) == ()
    assert refusals(KINDS["body"], body) == []


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        (("pole_dec_deg",), 95.0, r"^pole_dec_deg: "),
        (("radii_km",), [0.28, 0.27], r"^radii_km: "),
        (("radii_sigma_km", 1), 3e-4, r"radii_sigma_km is not that of the covariance"),
        (("covariance", 4, 4), -1e-18, r"^covariance: .*negative variance"),
        # Of velocities, whose variances are far below those of positions.
        (("covariance", 4, 5), 5e-18, r"^covariance: .*symmetric"),
        (("images", 0, "attitude_correction_rad"), None, r"^images\.0\.attitude_correction_rad: "),
        (("left_out",), [{"image": "b"}], r"^left_out\.0\.reason: "),
    ],
)
def test_faults_of_a_body(body, tmp_path, place, value, words):
    (fault,) = checked(tmp_path, "BENNU.json", changed(body, place, value))
    assert re.search(words, fault)


def test_every_fault_has_a_line(result, tmp_path):
    content = changed(changed(result, ("et",), "x"), ("stars", 0, "snr"), "x")
    assert len(checked(tmp_path, "result.json", content)) == 2


def test_fields_may_be_added(result, tmp_path):
    """The promise of format_version: a reader passes over what it does not know."""
    content = changed(result, ("bodies", 0, "albedo"), 0.5)
    assert checked(tmp_path, "result.json", content) == ()
    assert refusals(KINDS["result"], content) == []


NIGHT = "mission: new_horizons\nimages: [a.fit]\ntargets: PLUTO:limb_scan,CHARON\n"


@pytest.mark.parametrize(
    ("text", "faults"),
    [
        (NIGHT, []),
        ("format_version: 1\n" + NIGHT, []),
        ("format_version: 2\n" + NIGHT, [r"^line 1: format_version: 2 is newer"]),
        ("format_version: new\n" + NIGHT, [r"^line 1: format_version: 'new' is no version"]),
        (NIGHT + "retrys: 2\n", [r"^line 4: retrys: unknown field, did you mean retries\?"]),
        (NIGHT + "retries: 20\ntime_limit_s: -1\n", [r"^line 5: time_limit_s: ", r"^line 4: retries: "]),
        (NIGHT + "mission: x\n", [r"^line 4: mission is given twice"]),
        (
            "images: [a.fit]\nmethod: best\n",
            [r"mission: this field is required", r"^line 2: method: unknown"],
        ),
    ],
)
def test_night_files(tmp_path, text, faults):
    found = checked(tmp_path, "night.yaml", text, kind="night")
    assert len(found) == len(faults)
    assert all(any(re.search(words, fault) for fault in found) for words in faults), found


def test_what_a_file_names_must_be_there(tmp_path):
    mission = (kernels_meta_dir() / "generic" / "mission.yaml").read_text()
    (fault,) = checked(tmp_path, "mission.yaml", mission)
    assert re.search(r"cameras/\w+\.yaml cannot be read", fault)


@pytest.mark.slow(keep=["night"])
@pytest.mark.parametrize("name", [k.name for k in KINDS.values() if k.is_yaml])
def test_schema_and_check_refuse_a_misspelt_field(tmp_path, name):
    assert refusals(KINDS[name], {"misspelt": 1})
    assert any("misspelt" in fault for fault in checked(tmp_path, "x.yaml", "misspelt: 1\n", kind=name))


# ---- The command


def test_command_says_each_fault_in_a_line(result, tmp_path):
    (tmp_path / "result.json").write_text(json_text(changed(result, ("status",), "fine")))
    (tmp_path / "night.yaml").write_text(yaml.safe_dump({"mission": "new_horizons", "images": ["a"], "x": 1}))
    (tmp_path / "letter.txt").write_text("hello")
    (tmp_path / "other.json").write_text("{}")
    names = ["result.json", "night.yaml", "letter.txt", "other.json", "none.json"]
    answer = CliRunner().invoke(app, ["check", *(str(tmp_path / name) for name in names)])
    assert answer.exit_code == 2
    lines = answer.output.splitlines()
    assert len(lines) == 5
    assert all(any(name in line for line in lines) for name in names)


@pytest.mark.slow
def test_command_writes_the_schemas(tmp_path):
    assert CliRunner().invoke(app, ["check", "--schemas", str(tmp_path / "s")]).exit_code == 0
    written = {
        path.name.split(".")[0]: json.loads(path.read_text()) for path in Path(tmp_path / "s").iterdir()
    }
    assert set(written) == set(KINDS)
    for schema in written.values():
        jsonschema.Draft202012Validator.check_schema(schema)
        assert "format_version" in schema["properties"]


def test_every_field_is_described():
    """Of the files that the program writes, in the schema itself."""
    for name in ("result", "session", "status", "observables", "body"):
        schema = schema_of(KINDS[name])
        for part in [schema, *schema.get("$defs", {}).values()]:
            silent = [f for f, s in part.get("properties", {}).items() if not s.get("description")]
            assert not silent, (name, part.get("title"), silent)


def test_what_a_later_version_added_is_passed_over(result, tmp_path):
    """A new threshold ended the check in a traceback; contradictions had no place in the layout."""
    content = result | {"provenance": result["provenance"] | {"settings": {"max_stars": 9, "new_limit": 1.0}}}
    assert checked(tmp_path, "result.json", content) == ()
    content["provenance"] |= {"contradictions": [1]}
    assert "contradictions.0: " in checked(tmp_path, "result.json", content)[0]
    content["provenance"] |= {"contradictions": ["ET and UTC differ"]}
    content["readout"] = {"binning": [2, 2], "first": [0, 8], "size": None}
    assert checked(tmp_path, "result.json", content) == ()
    assert unnamed(KINDS["result"].model, content) == ["provenance.0.settings.0.new_limit"]
    assert refusals(KINDS["result"], content) == []

"""A rehearsal's package: whole or not at all, blind, the same for the same seed, and opened by its key alone."""

import json
import shutil
import stat
import struct
from pathlib import Path

import numpy as np
import pytest
import yaml
from astropy.io import fits
from cryptography.fernet import Fernet

from opnav_workbench.errors import MissionError, SessionError
from opnav_workbench.kernels import KernelSet, body_gm_km3_s2, camera_attitude, state
from opnav_workbench.mission import load_mission
from opnav_workbench.rehearsal import making
from opnav_workbench.rehearsal.making import new_rehearsal
from opnav_workbench.rehearsal.package import open_rehearsal
from opnav_workbench.rehearsal.sealed_truth import reveal
from opnav_workbench.resources import kernels_meta_dir

SEED = 727364153
SMALL = {  # 4x4 pictures are sixteen times smaller
    "title": "Test",
    "description": "Two pictures of the approach.",
    "mission": "new_horizons",
    "kernels": "new_horizons/pluto_approach",
    "targets": ["PLUTO", "CHARON"],
    "b_plane": "PLUTO BARYCENTER",
    "parameters": {"target_position": 5000.0, "spacecraft_position": 500.0, "spacecraft_velocity": 1e-4},
    "perturbations": {
        "target_barycenter": {"body": "PLUTO BARYCENTER", "any_direction_km": {"normal": 3000.0}},
        "spacecraft_ephemeris": {"velocity_km_s": [{"normal": 3e-5}] * 3},
        "b_plane_target": {"b_dot_t_km": {"normal": 200.0}, "b_dot_r_km": {"normal": 200.0}},
        "time_of_flight_s": {"normal": 20.0},
        "attitude": {"shift_px": {"uniform": [45.0, 60.0]}, "twist_deg": {"normal": 0.2}},
        "albedo": {"bodies": ["PLUTO"]},
        "camera": {"focal_length": {"normal": 1e-3}, "corner_px": {"normal": 0.5}},
        "lost_images": {"missing": 1, "truncated": 1, "spare": ["late"]},
        "data_gaps": {"pictures": 1, "lines": 2, "blocks": 1},
        "cosmic_ray_storm": {"pictures": 1, "rate_per_cm2_s": {"uniform": [400.0, 900.0]}},
    },
    "pictures": [
        {
            "name": "early",
            "start": "2015-07-01T00:00:00",
            "step_s": 86400.0,
            "count": 2,
            "camera": "lorri_4x4",
            "exposure_s": 0.1,
        },
        {
            "name": "late",
            "utc": "2015-07-09T04:29:00",
            "camera": "lorri_4x4",
            "exposure_s": 0.1,
            "pointing": {"offset_px": [10.0, -20.0], "twist_deg": 30.0},
        },
    ],
}

ONE = SMALL | {"pictures": SMALL["pictures"][1:], "perturbations": {}}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return a package with everything perturbed."""
    return new_rehearsal(SMALL, tmp_path_factory.mktemp("ort") / "case", seed=SEED)


@pytest.fixture
def copied(made, tmp_path):
    """Return a copy of its folder, key beside it, that a test may spoil."""
    shutil.copytree(made.folder, tmp_path / "case")
    shutil.copy(made.key_path, tmp_path / "case.key")
    return tmp_path / "case"


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


@pytest.mark.slow
def test_the_folder_holds_what_a_team_gets(made):
    names = {path.relative_to(made.folder).as_posix() for path in _files(made.folder)}
    lost = next(p for p in made.pictures if not p.received)
    assert {"ort.yaml", "briefing.md", "briefing.html", "truth.sealed", "kernels/pluto_approach.tm"} <= names
    assert {n for n in names if n.startswith("pictures/")} == {
        f"pictures/{p.name}.fit" for p in made.received
    }
    assert [p.name for p in made.pictures] == ["early_1", "early_2", "late"]
    assert not lost.path.exists()
    assert lost.name != "late"
    assert made.mission == "new_horizons"
    assert made.targets == ("PLUTO", "CHARON")
    assert made.parameters["target_position"] == 5000.0
    assert made.epoch_utc == "2015-07-09T04:29:00.000"
    assert made.b_plane.body == "PLUTO BARYCENTER"
    assert stat.S_IMODE(made.key_path.stat().st_mode) == 0o600


def test_reopening_gives_the_same_package(made):
    again = open_rehearsal(made.folder)
    assert again == made


def test_predicted_kernels_work_from_anywhere(copied, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    package = open_rehearsal("case")
    with KernelSet(package.metakernel) as kernels:
        assert all(path.is_relative_to(copied) for path in kernels.paths)
        assert state("PLUTO", 489688140.0, -98).position_km.any()
        assert body_gm_km3_s2(package.b_plane.body) == package.b_plane.gm_km3_s2 == 975.5  # DE440
        assert body_gm_km3_s2("NEW HORIZONS") == 0.0


def test_same_seed_same_bytes(made, tmp_path):
    again = new_rehearsal(SMALL, tmp_path / "again", seed=SEED)
    for path in _files(made.folder):
        if path.name not in ("truth.sealed", "ort.yaml"):
            assert path.read_bytes() == (again.folder / path.relative_to(made.folder)).read_bytes(), path.name
    first, second = reveal(made), reveal(again)
    assert {k: v.tolist() for k, v in first.parameters.items()} == {
        k: v.tolist() for k, v in second.parameters.items()
    }
    assert first.words == second.words
    assert made.key_path.read_bytes() != again.key_path.read_bytes()
    assert made.commitment != again.commitment, (
        "without random digits in it, truths could be guessed and tried"
    )


@pytest.mark.slow
def test_two_processes_make_the_same_pictures(made, tmp_path):
    again = new_rehearsal(SMALL, tmp_path / "again", seed=SEED, jobs=2)
    assert {p: s for p, s in again.sha256.items() if "pictures" in p} == {
        p: s for p, s in made.sha256.items() if "pictures" in p
    }


def test_other_seed_other_case(made, tmp_path):
    other = new_rehearsal(SMALL, tmp_path / "other", seed=SEED + 1, pictures=1)
    moved = reveal(other).parameters["target_position"] - reveal(made).parameters["target_position"]
    assert np.linalg.norm(moved) > 1.0


@pytest.mark.slow
def test_no_seed_is_a_secret_one(tmp_path):
    seeds = {reveal(new_rehearsal(ONE, tmp_path / name)).seed for name in "ab"}
    assert len(seeds) == 2
    assert all(0 <= seed < 2**62 for seed in seeds)


# -- no leaks ------------------------------------------------------------------------------------------------------


def _spellings(value: float):
    """Return a number as files could hold it, with digits enough not to be there by chance."""
    yield from (f"{value:.{digits}f}".encode() for digits in (3, 6) if abs(value) > 10.0)
    yield from (repr(value).encode(), f"{value:.6e}".encode(), f"{value:.6E}".encode())
    for order in "<>":
        yield struct.pack(f"{order}d", value)
        if abs(np.float32(value)) > 1e-30:
            yield struct.pack(f"{order}f", value)


def test_no_file_holds_perturbation_seed_or_true_attitude(made):
    truth = reveal(made)
    secrets = [float(x) for vector in truth.parameters.values() for x in vector if x]
    secrets += [
        *truth.relative_state_km[:3],
        *(v[k] for v in truth.b_plane.values() for k in ("true", "shift")),
    ]
    secrets += list(truth.camera_errors.values())
    for picture in truth.pictures.values():
        secrets += [*picture.camera_from_j2000.ravel(), *(x for c in picture.bodies.values() for x in c)]
    secrets += [float(x) for error in truth.attitude_errors.values() for x in error]
    patterns = {spelled for value in secrets for spelled in _spellings(float(value))}
    patterns |= {str(SEED).encode(), struct.pack("<q", SEED), struct.pack(">q", SEED)}
    assert len(secrets) > 60
    for path in _files(made.folder):
        content = path.read_bytes()
        # Four bytes may stand by chance in letters that differ from one run to the next.
        shortest = 8 if path.name in ("truth.sealed", "ort.yaml") else 4
        found = [spelled for spelled in patterns if len(spelled) >= shortest and spelled in content]
        assert not found, f"{path.name} holds {found}"


def test_the_search_for_leaks_finds_what_is_known(made):
    header = fits.getheader(made.pictures[-1].path)
    content = made.pictures[-1].path.read_bytes()
    assert any(spelled in content for spelled in _spellings(float(header["SPCQX"])))


def test_headers_hold_the_prediction(made):
    picture, truth = made.pictures[-1], reveal(made)
    header = fits.getheader(picture.path)
    with KernelSet(made.metakernel):
        seen = state("PLUTO", header["SPCSCET"], -98, correction="LT")
    target = [header[f"SPCTSC{axis}"] for axis in "XYZ"]
    np.testing.assert_allclose(target, -seen.position_km, rtol=0, atol=1e-3)  # km
    predicted = truth.pictures["late"].predicted_camera_from_j2000
    boresight = predicted.T @ [0.0, 0.0, -1.0]
    np.testing.assert_allclose(boresight[2], np.sin(np.radians(header["SPCBRDEC"])), rtol=0, atol=1e-9)
    # World coordinates are those of the calibrated camera: LORRI 4x4, 52 um over 2618 mm.
    scale = np.sqrt(abs(header["CD1_1"] * header["CD2_2"] - header["CD1_2"] * header["CD2_1"]))
    calibrated = np.degrees(0.051988 / 2618.4775964615383)
    assert abs(truth.camera_errors["focal length, relative"]) > 1e-4
    assert abs(scale / calibrated - 1.0) < 2e-5


def test_commanded_pointing_is_in_ck_and_header(made):
    header = fits.getheader(made.pictures[-1].path)
    with KernelSet(made.metakernel):
        attitude = camera_attitude("NH_LORRI", header["SPCSCET"])
    truth = reveal(made).pictures["late"]
    np.testing.assert_allclose(attitude, truth.predicted_camera_from_j2000, rtol=0, atol=1e-9)


def test_times_of_files_tell_nothing(made):
    assert len({path.stat().st_mtime_ns for path in _files(made.folder) if path.name != "ort.yaml"}) == 1
    assert len({path.stat().st_mtime_ns for path in _files(made.folder)}) == 1


@pytest.mark.slow
def test_length_of_the_sealed_truth_tells_nothing(made, tmp_path):
    scenario = SMALL | {"perturbations": {}}
    calm = new_rehearsal(scenario, tmp_path / "calm", seed=SEED)
    assert calm.sealed.stat().st_size == made.sealed.stat().st_size


# -- the seal ------------------------------------------------------------------------------------------------------


def test_the_truth_opens_with_the_key_alone(made, tmp_path):
    moved = tmp_path / "director.key"
    shutil.copy(made.key_path, moved)
    assert reveal(made, moved).seed == SEED
    with pytest.raises(SessionError, match=r"no key .*nowhere\.key .*stays sealed"):
        reveal(made, tmp_path / "nowhere.key")


@pytest.mark.parametrize("content", [b"", b"not a key", b"x" * 44, b"\xff\xfe"])
def test_what_is_no_key_opens_nothing(made, tmp_path, content):
    (tmp_path / "bad.key").write_bytes(content)
    with pytest.raises(SessionError, match=r"bad\.key does not open"):
        reveal(made, tmp_path / "bad.key")


def test_the_key_of_another_rehearsal_opens_nothing(made, tmp_path):
    other = new_rehearsal(ONE, tmp_path / "other", seed=1)
    with pytest.raises(SessionError, match="key of another rehearsal"):
        reveal(made, other.key_path)


def test_another_truth_in_its_place_is_refused(copied, tmp_path):
    other = new_rehearsal(ONE, tmp_path / "other", seed=1)
    shutil.copy(other.sealed, copied / "truth.sealed")
    with pytest.raises(SessionError, match=r"truth\.sealed \(altered\)"):
        open_rehearsal(copied)
    told = yaml.safe_load((copied / "ort.yaml").read_text())
    told["sealed_truth"]["sha256"] = yaml.safe_load((other.folder / "ort.yaml").read_text())["sealed_truth"][
        "sha256"
    ]
    (copied / "ort.yaml").write_text(yaml.safe_dump(told))
    with pytest.raises(SessionError, match=r"is not the truth that ort\.yaml was made with"):
        reveal(open_rehearsal(copied), other.key_path)


def test_an_altered_description_is_noticed_at_the_reveal(copied):
    told = yaml.safe_load((copied / "ort.yaml").read_text())
    told["parameters"]["target_position"] = 9000.0
    (copied / "ort.yaml").write_text(yaml.safe_dump(told))
    package = open_rehearsal(copied)
    with pytest.raises(SessionError, match=r"ort\.yaml is not the one .* altered"):
        reveal(package)


def test_plain_text_is_json(made):
    plain = Fernet(made.key_path.read_bytes().strip()).decrypt(made.sealed.read_bytes())
    values = json.loads(plain)
    assert values["seed"] == SEED
    assert set(values["pictures"]) == {"early_1", "early_2", "late"}


# -- whole or not at all -------------------------------------------------------------------------------------------


def test_altered_and_missing_files_are_named(copied):
    (copied / "briefing.md").write_text("Nothing to do.\n")
    (copied / "kernels" / "pluto_approach.tf").unlink()
    with pytest.raises(
        SessionError, match=r"briefing\.md \(altered\), kernels/pluto_approach\.tf \(missing\)"
    ):
        open_rehearsal(copied)


def test_results_beside_the_package_do_no_harm(copied):
    (copied / "notes.txt").write_text("ours")
    assert open_rehearsal(copied).name == "rehearsal"


@pytest.mark.parametrize("folder", ["", "nothing"])
def test_what_is_no_package(tmp_path, folder):
    with pytest.raises(SessionError, match="is no rehearsal package"):
        open_rehearsal(tmp_path / folder)


@pytest.mark.parametrize("name", ["case", "case.key"])
def test_nothing_is_overwritten(tmp_path, name):
    (tmp_path / name).write_text("mine")
    with pytest.raises(SessionError, match=rf"{name} is there already"):
        new_rehearsal(SMALL, tmp_path / "case", seed=1)
    assert (tmp_path / name).read_text() == "mine"
    assert _names(tmp_path) == [name]


@pytest.mark.slow(keep=["KeyboardInterrupt-make_pictures", "error1-make_pictures", "error1-write_briefing"])
@pytest.mark.parametrize("step", ["make_pictures", "write_briefing", "write_key", "write_content"])
@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError(28, "No space left on device")])
def test_a_failure_leaves_nothing(tmp_path, monkeypatch, step, error):
    def fail(*_args, **_options):
        raise error

    if step != "make_pictures":
        monkeypatch.setattr(making, "make_pictures", lambda *_: {})
        monkeypatch.setattr(making, "remove_missing", lambda *_: None)
        monkeypatch.setattr(making, "truncate_pictures", lambda *_: None)
        monkeypatch.setattr(making, "sealed_values", lambda *_: {})
    monkeypatch.setattr(making, step, fail)
    with pytest.raises((SessionError, KeyboardInterrupt)):
        new_rehearsal(SMALL, tmp_path / "case", seed=1)
    assert _names(tmp_path) == []


def test_a_failed_move_takes_the_key_along(tmp_path, monkeypatch):

    def fail(*_args):
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(Path, "rename", fail)
    with pytest.raises(SessionError, match=r"cannot make the rehearsal .*case: Read-only file system"):
        new_rehearsal(ONE, tmp_path / "case", seed=1)
    assert _names(tmp_path) == []


def test_progress_counts_the_pictures(tmp_path):
    seen = []
    new_rehearsal(SMALL, tmp_path / "case", seed=1, pictures=2, progress=lambda *words: seen.append(words))
    assert seen == [(0, 2, "kernels"), (1, 2, "early_1"), (2, 2, "late")]


@pytest.mark.parametrize(
    ("options", "words"),
    [({"seed": -1}, "seed -1"), ({"jobs": 0}, "0 jobs"), ({"pictures": 0}, "0 pictures")],
)
def test_bad_options(tmp_path, options, words):
    with pytest.raises(MissionError, match=words):
        new_rehearsal(SMALL, tmp_path / "case", **options)
    assert _names(tmp_path) == []


def test_a_mission_file_of_one_s_own_comes_along(tmp_path):
    shutil.copytree(kernels_meta_dir() / "new_horizons", tmp_path / "ours")
    scenario = ONE | {"mission": str(tmp_path / "ours" / "mission.yaml")}
    package = new_rehearsal(scenario, tmp_path / "case", seed=1)
    shutil.rmtree(tmp_path / "ours")
    shutil.move(package.folder, tmp_path / "elsewhere")
    moved = open_rehearsal(tmp_path / "elsewhere")
    assert load_mission(moved.mission).camera_named("lorri_4x4").n_pixel == 256
    assert reveal(moved, package.key_path).seed == 1

"""Saving and resuming: nothing is lost, nothing is half written, and bad files get one clear line."""

import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest

from opnav_workbench.catalog import open_catalog
from opnav_workbench.errors import SessionError
from opnav_workbench.files import json_text
from opnav_workbench.session import ImageSession, Settings
from opnav_workbench.session.autosave import STATE_FILE

FILES = ("observables.ecsv", "result.json", "session.json")


def _without_kernels(session: ImageSession) -> str:
    result = session.result()
    del result["provenance"]["kernels"]
    return json_text(result)


@pytest.fixture(scope="module")
def folder(finished, tmp_path_factory):
    return finished.save(tmp_path_factory.mktemp("saved"))


def _spoil(folder: Path, tmp_path: Path, **changes: object) -> Path:
    """A copy of the session file with some values changed."""
    data = json.loads((folder / "session.json").read_text()) | changes
    (tmp_path / "session.json").write_text(json.dumps(data))
    return tmp_path


def _one_line(caught: pytest.ExceptionInfo[SessionError]) -> str:
    text = str(caught.value)
    assert "\n" not in text
    return text


# -- resuming ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_resume_without_kernels_is_bit_identical(finished, folder):
    """The bodies were found one after the other: the replay must not know the second while finding the first."""
    resumed = ImageSession.resume(folder)
    assert _without_kernels(resumed) == _without_kernels(finished)
    assert resumed.journal == finished.journal


@pytest.mark.slow
def test_resume_is_bit_identical_with_the_headers_attitude(resolved_truths, approach, tmp_path):
    """The header's quaternion gives a transposed matrix; matrix products round by the layout in memory."""
    session = ImageSession.open(resolved_truths[0].picture, "new_horizons", attitude="header")
    session.predict()
    session.find_stars()
    session.repoint()
    session.find_body("PLUTO", "least_squares")
    session.save(tmp_path)
    assert _without_kernels(ImageSession.resume(tmp_path)) == _without_kernels(session)


@pytest.mark.slow
def test_undo_works_after_resume(finished, folder):
    resumed = ImageSession.resume(folder)
    for name in ("observables", "find_body", "find_body", "repoint"):
        assert resumed.undo().step == name
    assert resumed.state.pointing is None
    assert resumed.state.targets == ()
    resumed.repoint()
    resumed.find_body("PLUTO")  # known from the saved inputs, without kernels
    resumed.find_body("CHARON")
    resumed.observables()
    assert _without_kernels(resumed) == _without_kernels(finished)


@pytest.mark.slow
def test_resume_with_undone_steps_and_decisions(done, tmp_path):
    star = str(done.state.a_priori.id[done.state.mask("used")][0])
    done.reject_stars([star], reason="straylight")
    done.repoint(model="image_plane")
    done.undo()
    done.repoint()
    done.save(tmp_path)
    resumed = ImageSession.resume(tmp_path)
    assert _without_kernels(resumed) == _without_kernels(done)
    assert resumed.journal == done.journal
    assert resumed.undo().step == "repoint"
    assert resumed.undo().reason == "straylight"


@pytest.mark.slow
def test_resuming_twice_writes_the_same_files(folder, tmp_path):
    ImageSession.resume(folder).save(tmp_path)
    first = json.loads((folder / "session.json").read_text())
    assert json.loads((tmp_path / "session.json").read_text()) == first
    assert (tmp_path / "observables.ecsv").read_bytes() == (folder / "observables.ecsv").read_bytes()


@pytest.mark.slow
def test_a_field_without_stars_resumes(truth, kernels, tmp_path):
    np.savez(tmp_path / "far.npz", ra_deg=[10.0], dec_deg=[80.0], mag=[5.0])
    session = ImageSession.open(truth.picture, "new_horizons", catalog=f"npz:{tmp_path / 'far.npz'}")
    session.predict()
    session.find_stars()
    session.save(tmp_path)
    assert _without_kernels(ImageSession.resume(tmp_path)) == _without_kernels(session)


def test_what_bundled_was_on_this_machine_is_told_and_kept(truth, kernels, tmp_path):
    np.savez(tmp_path / "deeper.npz", ra_deg=[270.0], dec_deg=[-14.0], mag=[9.0])
    here = open_catalog(f"bundled+npz:{tmp_path / 'deeper.npz'}")
    session = ImageSession.open(truth.picture, "new_horizons", opened_catalog=here)
    provenance = session.result()["provenance"]
    assert (provenance["catalog"], provenance["catalog_found"]) == ("bundled", here.name)
    session.save(tmp_path / "kept")
    again = ImageSession.resume(tmp_path / "kept").result()["provenance"]
    assert again["catalog_found"] == here.name
    assert "deeper.npz" in here.name


def test_settings_are_kept(truth, kernels, tmp_path):
    settings = Settings(max_shift_px=40.0, min_snr=8.0)
    ImageSession.open(truth.picture, "new_horizons", settings=settings).save(tmp_path)
    assert ImageSession.resume(tmp_path).context.settings == settings


@pytest.mark.slow
def test_the_picture_may_have_moved(finished, folder, truth, tmp_path):
    moved = tmp_path / "elsewhere.fit"
    moved.write_bytes(truth.picture.read_bytes())
    resumed = ImageSession.resume(folder, image=moved)
    assert resumed.state.pointing.rms_px == finished.state.pointing.rms_px


def test_session_file_is_json_of_plain_values(folder):
    """No pickle: the file says in text what it holds, and names the mission, not where it was installed."""
    data = json.loads((folder / "session.json").read_text())
    assert data["mission"] == "new_horizons"
    assert data["journal"][0]["step"] == "predict"
    there = {path.name for path in folder.iterdir()} - {STATE_FILE}  # which is kept where steps took long
    assert sorted(there) == list(FILES)


# -- what cannot be resumed ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_another_picture_is_refused(folder, demo_truths):
    with pytest.raises(SessionError, match="SHA-256 differs") as caught:
        ImageSession.resume(folder, image=_same_camera_other_noise(folder, demo_truths))
    _one_line(caught)


def _same_camera_other_noise(folder, demo_truths):
    from astropy.io import fits

    other = demo_truths[1].picture.with_name("other.fit")
    with fits.open(demo_truths[1].picture) as hdus:
        hdus[0].data[0, 0] += 1.0
        hdus.writeto(other, overwrite=True)
    return other


def test_a_catalog_row_too_few(folder, tmp_path):
    inputs = json.loads((folder / "session.json").read_text())["inputs"]
    inputs["stars"]["mag"].pop()
    with pytest.raises(SessionError, match=r"damaged.*mag") as caught:
        ImageSession.resume(_spoil(folder, tmp_path, inputs=inputs))
    _one_line(caught)


def test_missing_picture(folder, tmp_path):
    with pytest.raises(SessionError, match=r"resume\(folder, image=PATH\)") as caught:
        ImageSession.resume(folder, image=tmp_path / "gone.fit")
    assert "gone.fit" in _one_line(caught)


def test_missing_folder(tmp_path):
    with pytest.raises(SessionError, match=r"nowhere.*save\(\)") as caught:
        ImageSession.resume(tmp_path / "nowhere")
    _one_line(caught)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
def test_truncated_file(folder, tmp_path, share):
    content = (folder / "session.json").read_bytes()
    (tmp_path / "session.json").write_bytes(content[: int(share * len(content))])
    with pytest.raises(SessionError, match=r"session\.json") as caught:
        ImageSession.resume(tmp_path)
    _one_line(caught)


@pytest.mark.parametrize("content", [b"[1, 2]", b"null", b"\xff\xfe\x00", b"\x80\x04\x95pickle"])
def test_not_a_session(tmp_path, content):
    (tmp_path / "session.json").write_bytes(content)
    with pytest.raises(SessionError, match=r"session\.json") as caught:
        ImageSession.resume(tmp_path)
    _one_line(caught)


@pytest.mark.parametrize("version", [2, None, "1", -1, True])
def test_another_format_version(folder, tmp_path, version):
    with pytest.raises(SessionError, match=r"session\.json: format_version: ") as caught:
        ImageSession.resume(_spoil(folder, tmp_path, format_version=version))
    _one_line(caught)


@pytest.mark.slow(keep=["2", "None", "1_1"])
@pytest.mark.parametrize("schema", [1, 2, None, "1"])
def test_session_written_before_files_said_their_version(folder, tmp_path, schema):
    """Version 0 had ``schema: 1`` in place of ``format_version``."""
    old = json.loads((_spoil(folder, tmp_path, schema=schema) / "session.json").read_text())
    del old["format_version"]
    (tmp_path / "session.json").write_text(json.dumps(old))
    if schema == 1:
        assert len(ImageSession.resume(tmp_path).journal) == len(old["journal"])
    else:
        with pytest.raises(SessionError, match="format_version is missing"):
            ImageSession.resume(tmp_path)


DAMAGED = {
    "inputs": {"inputs": {}},
    "inputs a list": {"inputs": [1]},
    "settings": {"settings": {"min_snr": 5.0, "max_snr": 6.0}},
    "settings a list": {"settings": [1]},
    "journal entry": {"journal": [{"stop": "predict"}]},
    "journal a number": {"journal": 3},
    "unknown step": {"journal": [{"step": "render"}]},
    "step without parameters": {"journal": [{"step": "predict"}, {"step": "find_stars"}]},
    "parameters no mapping": {"journal": [{"step": "predict", "parameters": 3}]},
    "undo of nothing": {"journal": [{"step": "undo", "parameters": {}}]},
    "body unknown": {
        "journal": [
            {"step": "find_body", "parameters": {"name": "X", "method": "unresolved", "search_radius_px": 3}}
        ]
    },
}


@pytest.mark.parametrize("case", DAMAGED)
def test_damaged_content(folder, tmp_path, case):
    with pytest.raises(SessionError) as caught:
        ImageSession.resume(_spoil(folder, tmp_path, **DAMAGED[case]))
    _one_line(caught)


# -- a disk that is full -------------------------------------------------------------------------------------------


def _full(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.slow(keep=["os-fsync"])
@pytest.mark.parametrize(("where", "what"), [(os, "fsync"), (Path, "replace")])
def test_full_disk_leaves_older_files_unchanged(done, tmp_path, monkeypatch, where, what):
    done.save(tmp_path)
    before = _contents(tmp_path)
    done.note("later")
    with monkeypatch.context() as patch:
        patch.setattr(where, what, _full)
        with pytest.raises(SessionError, match="No space left on device") as caught:
            done.save(tmp_path)
    _one_line(caught)
    assert _contents(tmp_path) == before
    done.save(tmp_path)
    assert _contents(tmp_path) != before
    assert sorted(_contents(tmp_path)) == list(FILES)


@pytest.mark.slow
def test_disk_full_at_the_last_file_keeps_the_first_ones_too(done, tmp_path, monkeypatch):
    """result.json is written before session.json, but must not be newer than it."""
    done.save(tmp_path)
    before = _contents(tmp_path)
    done.note("later")
    calls = []

    def second_fails(descriptor: int) -> None:
        calls.append(descriptor)
        if len(calls) == 2:
            _full()

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", second_fails)
        with pytest.raises(SessionError, match=r"session\.json"):
            done.save(tmp_path)
    assert len(calls) == 2
    assert _contents(tmp_path) == before


def test_folder_that_is_a_file(finished, tmp_path):
    (tmp_path / "run").write_text("in the way")
    with pytest.raises(SessionError, match="run") as caught:
        finished.save(tmp_path / "run")
    _one_line(caught)


def test_an_analysts_session_is_put_away_before_another_takes_its_place(finished, tmp_path):
    finished.save(tmp_path)
    mine = json.loads((tmp_path / "session.json").read_text()) | {"session": "an analyst's"}
    mine["journal"].append(
        {"step": "note", "parameters": {"text": "look here"}, "reason": "", "outcome": "note 1"}
    )
    (tmp_path / "session.json").write_text(json.dumps(mine))
    (tmp_path / "journal.jsonl").write_text("what followed\n")
    finished.save(tmp_path)
    kept = finished.put_away
    assert json.loads((kept / "session.json").read_text()) == mine
    assert (kept / "journal.jsonl").read_text() == "what followed\n"
    finished.save(tmp_path)  # its own, or one in which nobody said anything
    assert finished.put_away is None
    assert [path.name for path in (tmp_path / ".attic").iterdir()] == [kept.name]

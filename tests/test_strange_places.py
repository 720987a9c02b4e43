"""Names and places that others give: too long, no text, links in a circle, pipes, devices, folders: one line, no hang."""

import os
import sys
from functools import partial
from pathlib import Path

import pytest

from opnav_workbench.camera import Camera
from opnav_workbench.catalog import open_catalog
from opnav_workbench.catalog.user_files import read_star_list
from opnav_workbench.contracts import check_file
from opnav_workbench.errors import KernelError, OpNavError, SessionError, plain_line
from opnav_workbench.files import json_value, read_json
from opnav_workbench.image import KeywordMap, read_image
from opnav_workbench.kernels import KernelSet, et_from_utc
from opnav_workbench.kernels.dsk_files import is_dsk
from opnav_workbench.kernels.making.scenario import load_scenario
from opnav_workbench.kernels.manifest import load_manifest
from opnav_workbench.kernels.shape_files import read_shape
from opnav_workbench.mission import load_mission
from opnav_workbench.observables import read_csv, read_ecsv, read_tdm, read_with_origins
from opnav_workbench.planning.sequence import load_sequence
from opnav_workbench.processing import process
from opnav_workbench.rehearsal import DEMO_KERNELS
from opnav_workbench.rehearsal.scenario import load_ort_scenario
from opnav_workbench.session import ImageSession
from opnav_workbench.session.decisions import load_decisions
from opnav_workbench.simulation import load_picture_scenario

sys.path.insert(0, str(Path(__file__).parent))

from hostile import LONGEST_LINE, SECONDS, within


def cone(kind, path):
    open_catalog(f"{kind}:{path}").cone(0.0, 0.0, 1.0, 9.0)


def opened(path):
    with KernelSet(path):
        pass


READERS = {
    "mission": load_mission, "kernels": opened, "stars": read_star_list, "camera": Camera.from_yaml, "shape": read_shape,
    "scenario": load_scenario, "sequence": load_sequence, "rehearsal": load_ort_scenario, "decisions": load_decisions,
    "pictures": load_picture_scenario, "check": check_file, "ecsv": read_ecsv, "csv": read_csv, "tdm": read_tdm,
    "observables": read_with_origins, "json": partial(read_json, advice="x"), "manifest": load_manifest,
    "picture": partial(read_image, keywords=KeywordMap()), "session": ImageSession.resume,
    **{kind: partial(cone, kind) for kind in ("npz", "tycho2", "ucac2", "ucac4", "hip2", "astrometry-net")},
}  # fmt: skip
PLACES = (
    "a" * 300, "a" * 300 + ".yaml", "a" * 5000, "loop", "loop/x.yaml", "loop.yaml", "pipe", "pipe.yaml", "pipe.fit",
    "folder", "folder/x/y.yaml", "nul\x00x", "x\udc80.yaml", "/dev/zero", "/dev/full", "/proc/self/mem", "", ".",
)  # fmt: skip


@pytest.fixture
def strange(tmp_path, monkeypatch):
    for name in ("loop", "loop.yaml"):
        (tmp_path / name).symlink_to(name)
    for name in ("pipe", "pipe.yaml", "pipe.fit"):
        os.mkfifo(tmp_path / name)
    (tmp_path / "folder").mkdir()
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("reader", READERS)
def test_readers_refuse_strange_places(reader, strange):
    for place in PLACES:
        with within(SECONDS), pytest.raises(OpNavError) as refused:
            READERS[reader](place)
        assert str(refused.value).isprintable(), place


def test_a_picture_in_a_strange_place_costs_one_line(strange):
    (outcome,) = process("a" * 300 + ".fit", mission="new_horizons", attitude="header")
    assert outcome.result["status"] == "failed"
    assert "unforeseen" not in outcome.error


def test_a_pipe_is_no_dsk(strange):
    with within(SECONDS):
        assert not is_dsk("pipe")


def test_kernels_are_written_under_names_that_spice_can_be_told(tmp_path):
    from opnav_workbench.kernels.writing import new_das

    path = tmp_path / "k\udc8d.bds"
    with pytest.raises(KernelError, match="no UTF-8"), new_das(path, lambda *_: 0, lambda _: None, ""):
        pass
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("text", ["[" * 100_000, "9" * 41, '{"a": ' + "1" * 5000 + "}", "{"])
def test_json_that_is_too_much(text):
    with pytest.raises(ValueError, match=r"too deep|digits|Expecting"):
        json_value(text)
    assert json_value('{"a": [NaN, 1e400, 1e300, 12]}') == {"a": [None, None, 1e300, 12]}


def test_json_of_a_device_is_refused(tmp_path):
    with pytest.raises(SessionError, match="pipe or device"):
        read_json("/dev/zero", "give another.")


def test_spice_is_asked_in_text():
    with KernelSet(DEMO_KERNELS), pytest.raises(KernelError, match=r"no UTF-8, which SPICE cannot be told"):
        et_from_utc("2015-05-28T12:\udca20:00")


def test_lines_are_bounded_with_what_is_escaped_in_them():
    """A UTC of 900 NULs came as 3,900 characters."""
    assert len(plain_line("\x00" * 3000)) <= LONGEST_LINE
    assert plain_line("\x00" * 3000).isprintable()
    assert len(str(OpNavError("a\x00" * 900))) <= LONGEST_LINE

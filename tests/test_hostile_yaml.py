"""YAML that would explode, recurse or trip its reader: one line of the caller's own error, at once."""

import os
import time

import pytest

from opnav_workbench.camera import Camera
from opnav_workbench.catalog.user_files import read_star_list
from opnav_workbench.errors import CameraError, MissionError, OpNavError
from opnav_workbench.headless.night_spec import load_night
from opnav_workbench.kernels.making.scenario import load_scenario
from opnav_workbench.kernels.manifest import load_manifest
from opnav_workbench.mission import load_mission
from opnav_workbench.planning.sequence import load_sequence
from opnav_workbench.rehearsal.scenario import load_ort_scenario
from opnav_workbench.session.decisions import load_decisions
from opnav_workbench.simulation import load_picture_scenario
from opnav_workbench.yaml_file import StrictModel, Utc, read_model
from opnav_workbench.yaml_nodes import compose, plain_value

LAUGHS = "a0: &a0 [x,x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"a{i}: &a{i} [{','.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 12)
)
MERGES = "a0: &a0 {x: 1}\n" + "".join(
    f"a{i}: &a{i} {{<<: [{','.join([f'*a{i - 1}'] * 10)}]}}\n" for i in range(1, 12)
)
HOSTILE = {
    "an alias within itself": ("a: &a [*a]", "holds itself"),
    "a merge within itself": ("a: &a {<<: *a}", "holds itself"),
    "deep brackets": ("a: " + "[" * 100_000, "nested deeper than"),
    "deep blocks": ("- " * 50_000 + "1", "nested deeper than"),
    "a billion laughs": (LAUGHS, "more than 400000 values"),
    "a billion merges": (MERGES, "more than 400000 values"),
    "a number without digits": ('a: !!int ""', "'' is no int"),
    "a number that is none": ("a: !!float x", "'x' is no float"),
    "a flag that is none": ("a: !!bool x", "'x' is no bool"),
    "4,300 digits and more": ("a: " + "9" * 5000, "a number of 5000 characters"),
    "base 60": ("a: " + "1:" * 3000 + "1", "a number of 6001 characters"),
    "base 16": ("a: 0x" + "f" * 5000, "a number of 5002 characters"),
    "binary": ('a: !!binary "="', "is not read here"),
    "a time by tag": ('a: !!timestamp "x"', "is not read here"),
    "a sequence that is none": ("!!seq x", "is not YAML"),
    "a key that is a list": ("[1]: 2", "unhashable key"),
    "nul": ('a: "\\0"', "NUL"),
}


class Note(StrictModel):
    when: Utc
    name: str = ""


@pytest.mark.parametrize("case", HOSTILE)
def test_one_line_at_once(tmp_path, case):
    text, words = HOSTILE[case]
    path = tmp_path / "note.yaml"
    path.write_text(text)
    began = time.process_time()
    with pytest.raises(MissionError, match=words) as caught:
        read_model(path, Note, "note", MissionError)
    assert time.process_time() - began < 2.0
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600


READERS = {
    "mission": load_mission, "camera": Camera.from_yaml, "kernel scenario": load_scenario, "manifest": load_manifest,
    "picture scenario": load_picture_scenario, "sequence": load_sequence, "rehearsal": load_ort_scenario,
    "night": load_night, "decisions": load_decisions, "star list": read_star_list,
}  # fmt: skip


@pytest.mark.parametrize("reader", READERS)
def test_every_reader_of_yaml_ends_in_one_line_at_once(tmp_path, reader):
    """Seven commands ended in a traceback or hung."""
    path = tmp_path / "hostile.yaml"
    for case, (text, _) in HOSTILE.items():
        path.write_text(text)
        began = time.process_time()
        with pytest.raises(OpNavError) as caught:
            READERS[reader](path)
        assert time.process_time() - began < 2.0, case
        assert str(path) in str(caught.value), case
        assert str(caught.value).isprintable(), case


@pytest.mark.parametrize("day", ["2015-02-30", "2015-13-01T00:00:00", "0000-01-01", "2015-07-14T25:00:00"])
def test_a_day_that_no_calendar_has(tmp_path, day):
    path = tmp_path / "note.yaml"
    path.write_text(f"name: a\nwhen: {day}\n")
    with pytest.raises(MissionError, match=r"line 2: when: .*valid datetime"):
        read_model(path, Note, "note", MissionError)


def test_a_name_that_looks_like_a_day_is_a_name(tmp_path):
    path = tmp_path / "note.yaml"
    path.write_text("when: 2015-07-14T11:49:57\nname: 2015-07-14\n")
    note = read_model(path, Note, "note", MissionError)
    assert (note.name, note.when.isoformat()) == ("2015-07-14", "2015-07-14T11:49:57")


def test_good_aliases_and_merges_are_read():
    text = "- &a {x: 1, y: [1, 2]}\n- {<<: *a, x: 2}\n- *a\n"
    assert plain_value(compose(text)) == [
        {"x": 1, "y": [1, 2]},
        {"x": 2, "y": [1, 2]},
        {"x": 1, "y": [1, 2]},
    ]


def test_an_endless_or_blocking_file_is_not_read(tmp_path):
    huge = tmp_path / "huge.yaml"
    with huge.open("wb") as stream:
        stream.truncate(1 << 33)
    with pytest.raises(CameraError, match="more than 4194304"):
        read_model(huge, Note, "note", CameraError)
    pipe = tmp_path / "pipe.yaml"
    os.mkfifo(pipe)
    with pytest.raises(CameraError, match="pipe or device"):
        read_model(pipe, Note, "note", CameraError)


def test_messages_are_one_bounded_line():
    said = str(OpNavError("a\n\x1b[31mb\udcff" + "c" * 10**6))
    assert said.startswith("a\\n\\x1b[31mb\\xff")
    assert said.isprintable()
    assert len(said) < 2100

"""Recorded decisions: read from YAML with clear errors, and made in the sessions they are meant for."""

import json

import pytest

from opnav_workbench.errors import SessionError
from opnav_workbench.session import ImageSession
from opnav_workbench.session.decisions import Decisions, load_decisions


def _file(tmp_path, text):
    path = tmp_path / "decisions.yaml"
    path.write_text(text)
    return path


@pytest.fixture
def session(demo_truths):
    """The LORRI picture with its four stars found, from the header alone."""
    session = ImageSession.open(demo_truths[0].picture, "new_horizons")
    session.predict()
    session.find_stars()
    return session


def _used(session):
    return [s["id"] for s in json.loads(session.to_json())["stars"] if s["status"] == "used"]


def test_decisions_by_file_name_and_for_every_picture(session, tmp_path):
    first, second, third, _ = _used(session)
    decisions = load_decisions(
        _file(
            tmp_path,
            f"""
images:
  "*":
    reject:
      - {{star: "{first}", reason: variable}}
      - {{star: "{second}"}}
      - {{star: HIP 0, reason: in another field}}
  lorri_4x4.fit:
    reject:
      - {{star: "{third}", reason: cosmic ray}}
    accept:
      - {{star: "{second}", reason: fine here}}
  other.fit:
    reject:
      - {{star: HIP 1, reason: not here}}
""",
        )
    )
    decisions.apply(session)
    stars = {s["id"]: (s["status"], s["reason"]) for s in json.loads(session.to_json())["stars"]}
    assert stars[first] == ("rejected", "by the analyst: variable")
    assert stars[third] == ("rejected", "by the analyst: cosmic ray")
    # The picture's own decision comes after the one for every picture.
    assert stars[second] == ("used", "fine here")
    assert set(session.state.decisions) == {first, second, third}


def test_a_star_that_the_named_picture_does_not_have_is_an_error(session, tmp_path):
    path = _file(tmp_path, "images: {lorri_4x4.fit: {reject: [{star: HIP 0, reason: typo}]}}")
    with pytest.raises(SessionError, match="no star HIP 0"):
        load_decisions(path).apply(session)


def test_decisions_before_predict_pass_over_every_picture(demo_truths, tmp_path):
    session = ImageSession.open(demo_truths[0].picture, "new_horizons")
    load_decisions(_file(tmp_path, 'images: {"*": {reject: [{star: HIP 0}]}}')).apply(session)
    assert session.journal == ()


@pytest.mark.parametrize("text", ["", "images: {}", "# nothing yet\n"])
def test_an_empty_file_decides_nothing(tmp_path, text):
    assert load_decisions(_file(tmp_path, text)) == Decisions()


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("pictures: {}", "pictures"),
        ("images: {a.fit: {rejected: []}}", r"images\.a\.fit\.rejected"),
        ("images: {a.fit: {reject: [{reason: x}]}}", r"images\.a\.fit\.reject\.0\.star"),
        ("images: {a.fit: {reject: [{star: [1]}]}}", r"images\.a\.fit\.reject\.0\.star"),
        ("images: {a.fit: {accept: [{star: x, why: y}]}}", r"images\.a\.fit\.accept\.0\.why"),
        ("images: {a.fit: null}", r"images\.a\.fit"),
        ("[1, 2]", "the file"),
        ("just text", "the file"),
    ],
)
def test_a_broken_layout_names_the_place(tmp_path, text, named):
    with pytest.raises(SessionError, match=rf"decisions\.yaml: line 1: {named}: ") as caught:
        load_decisions(_file(tmp_path, text))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [b"images: {a: [", b"\xff\xfe\x00\x01", b"a: b: c"])
def test_what_is_not_yaml(tmp_path, content):
    path = tmp_path / "decisions.yaml"
    path.write_bytes(content)
    with pytest.raises(SessionError, match=r"decisions file .* (cannot be read|is not YAML)") as caught:
        load_decisions(path)
    assert "\n" not in str(caught.value)


def test_yaml_cannot_make_objects(tmp_path):
    path = _file(tmp_path, "images: !!python/object/apply:os.getcwd []")
    with pytest.raises(SessionError, match="is not YAML"):
        load_decisions(path)


def test_missing_file(tmp_path):
    with pytest.raises(SessionError, match=r"none\.yaml"):
        load_decisions(tmp_path / "none.yaml")

"""Errors of description files name the line, the field and what is allowed."""

from typing import Annotated, Literal

import pytest
from pydantic import BaseModel, Field

from opnav_workbench.errors import MissionError
from opnav_workbench.yaml_file import check_model, read_model


class Circle(BaseModel, extra="forbid"):
    kind: Literal["circle"]
    radius: float


class Box(BaseModel, extra="forbid"):
    kind: Literal["box"]
    width: float
    height: float


class Drawing(BaseModel, extra="forbid"):
    name: str
    shapes: tuple[Annotated[Circle | Box, Field(discriminator="kind")], ...] = ()
    boxes: dict[str, Box] = {}


def read(tmp_path, text):
    path = tmp_path / "drawing.yaml"
    path.write_text(text, encoding="utf-8")
    return read_model(path, Drawing, "drawing", MissionError)


def test_a_good_file_is_read(tmp_path):
    drawing = read(tmp_path, "name: a\nshapes:\n- {kind: circle, radius: 2}\n")
    assert drawing.shapes[0] == Circle(kind="circle", radius=2.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("shapes: []\n", r"line 1: name: this field is required"),
        ("name: a\n\nshape: []\n", r"line 3: shape: unknown field, did you mean shapes\?"),
        (
            "name: a\nshapes:\n- kind: circle\n  radius: 1\n- kind: box\n  width: 1\n  depth: 1\n  height: 2\n",
            r"line 7: shapes\.1\.depth: unknown field, .*width",
        ),
        (
            "name: a\nshapes:\n- kind: circle\n  size: 1\n",
            r"line 3: shapes\.0\.radius: this field is required",
        ),
        (
            "name: a\nshapes:\n- kind: circle\n  zzz: 1\n",
            r"line 4: shapes\.0\.zzz: .*allowed are kind, radius$",
        ),
        ("name: a\nshapes:\n- kind: star\n", r"line 3: shapes\.0: .*'circle', 'box'"),
        ("name: a\nshapes:\n\n- {kind: circle,\n   radius: big}\n", r"line 5: shapes\.0\.radius: .*number"),
        ("name: a\nboxes:\n  b: {kind: box, width: 1}\n", r"line 3: boxes\.b\.height: this field"),
        ("name: a\nname: b\n", r"line 2: name is given twice"),
        ("name: a\nshapes:\n- {kind: circle, radius: 1, radius: 2}\n", r"line 3: radius is given twice"),
        ("- 1\n", r"line 1: the file: fields with values are expected"),
        ("name: [\n", r"is not YAML"),
        ("name: !!python/name:os.getcwd\n", r"is not YAML"),
    ],
)
def test_errors_name_line_and_field(tmp_path, text, message):
    with pytest.raises(MissionError, match=message) as caught:
        read(tmp_path, text)
    assert "\n" not in str(caught.value)
    assert "drawing.yaml" in str(caught.value)


def test_many_errors_are_cut_short():
    with pytest.raises(MissionError, match=r"; and 2 more$"):
        check_model(dict.fromkeys("abcd", 1), Drawing, "drawing", MissionError)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(MissionError, match=r"cannot be read: .*give the path"):
        read_model(tmp_path / "none.yaml", Drawing, "drawing", MissionError)

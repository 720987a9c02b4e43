"""The keyword map: what it refuses, and what counts as absent."""

import pytest

from opnav_workbench.errors import MissionError
from opnav_workbench.image import Header, KeywordMap


@pytest.mark.parametrize(
    ("fields", "named"),
    [
        ({"quaternion": ["A", "B", "C"]}, "quaternion"),
        ({"quaternion": "ABCD"}, "quaternion"),
        ({"sun_position": ["X"]}, "sun_position"),
        ({"quaternion_sense": "sideways"}, "camera_to_j2000"),
        ({"time_reference": "later"}, "middle, start, end"),
        ({"time_offset_s": float("inf")}, "time_offset_s"),
        ({"quality_table": "mine"}, "new_horizons_lorri"),
        ({"exposure_scale": 0.0}, "exposure_scale"),
        ({"exposure_scale": float("nan")}, "exposure_scale"),
    ],
)
def test_impossible_fields_are_named(fields, named):
    with pytest.raises(MissionError, match=named):
        KeywordMap(**fields)


def test_lists_and_mappings_are_frozen():
    required = {"INSTRU": "lor"}
    keywords = KeywordMap(quaternion=["A", "B", "C", "D"], required=required)
    required["INSTRU"] = "mvi"
    assert keywords.quaternion == ("A", "B", "C", "D")
    assert keywords.required["INSTRU"] == "lor"
    with pytest.raises(TypeError):
        keywords.required["INSTRU"] = "mvi"


@pytest.mark.parametrize(
    "value", [-1e32, -1.0e32 * (1.0 + 1e-12), -999.0, -999, "N/A", "  ", "unk", "UNKNOWN "]
)
def test_missing_values_are_absent(value):
    assert KeywordMap(target="T").value(Header({"T": value}), "target") is None


@pytest.mark.parametrize("value", [0, -998.9, "PLUTO", True, False])
def test_other_values_are_kept(value):
    assert KeywordMap(target="T").value(Header({"T": value}), "target") == value


def test_signs_pieces_and_units_of_vectors():
    keywords = KeywordMap(sun_position=["-V[1]", "V[2]", "V[3]"], twist="-T", boresight=["R", "D"])
    header = Header(
        {"V": "1000, 2000.5, N/A", "V <UNIT>": "M", "T": 0.5, "T <UNIT>": "rad", "R": "x", "D": 3}
    )
    assert keywords.numbers(header, "sun_position") == [-1.0, 2.0005, None]
    assert keywords.numbers(header, "twist") == [pytest.approx(-28.6479, abs=1e-4)]
    assert keywords.numbers(header, "boresight") == [None, 3.0]
    assert keywords.numbers(Header({"V": "1000"}), "sun_position") == [-1000.0, None, None]
    assert keywords.words("sun_position") == ("V[1]", "V[2]", "V[3]")


def test_absent_keyword_and_unnamed_field():
    assert KeywordMap(target="T").value(Header({}), "target") is None
    assert KeywordMap().value(Header({"T": 1}), "target") is None

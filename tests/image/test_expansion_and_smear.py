"""Values squeezed on board, and columns smeared in readout."""

import numpy as np
import pytest

from opnav_workbench.errors import ImageError
from opnav_workbench.image import KeywordMap, column_level
from opnav_workbench.image.header import Header
from opnav_workbench.image.planes import expanded
from opnav_workbench.mission import load_mission

KEYWORDS = KeywordMap(expansion_keyword="HOW", expansion={"TABLE": [0.0, 1.0, 4.0, 9.0]})


def test_table_turns_stored_values_into_dn():
    stored = np.array([[0.0, 3.0], [np.nan, 2.0]])
    image, remarks = expanded("a.img", stored, Header({"HOW": "TABLE"}), KEYWORDS)
    np.testing.assert_array_equal(image, [[0.0, 9.0], [np.nan, 4.0]])
    assert "expanded from 4 steps to 9 DN" in remarks[0]


@pytest.mark.parametrize("header", [{}, {"HOW": "NONE"}, {"HOW": "12BIT"}])
def test_other_pictures_stay_as_they_are(header):
    stored = np.array([[700.5, 3.0]])
    image, remarks = expanded("a.img", stored, Header(header), KEYWORDS)
    assert image is stored
    assert remarks == ()


@pytest.mark.parametrize("value", [4.0, -1.0, 2.5])
def test_values_that_the_table_does_not_have(value):
    with pytest.raises(ImageError, match=r"a\.img: HOW is TABLE, whose table has values 0 to 3"):
        expanded("a.img", np.array([[value, 0.0]]), Header({"HOW": "TABLE"}), KEYWORDS)


def test_the_cassini_table_is_a_smooth_root():
    """Steps grow with the value, as the photon noise does: 12 bits in 8, from the calibration report."""
    table = np.array(load_mission("cassini").keywords["expansion"]["TABLE"], float)
    assert (len(table), table[0], table[-1]) == (256, 1.0, 4095.0)
    steps = np.diff(table)
    assert steps.min() > 0.0
    assert np.all(np.abs(np.diff(steps)) <= 2.0)
    np.testing.assert_allclose(np.gradient(np.sqrt(table + 60.0))[30:-1], 0.22, atol=0.03)


def test_smear_is_taken_from_the_lines_without_the_body():
    rng = np.random.default_rng(1)
    smear = 50.0 + 100.0 * np.exp(-((np.arange(60) - 30.0) ** 2) / 50.0)
    picture = smear + rng.normal(0.0, 1.0, (200, 60))
    body = np.zeros((200, 60), bool)
    body[80:130, 20:40] = True
    picture[body] += 2000.0
    np.testing.assert_allclose(column_level(picture, body)[0], smear, atol=0.5)
    np.testing.assert_allclose(column_level(picture)[0], smear, atol=1.0)  # the median alone nearly does it
    with pytest.raises(ImageError, match="no column"):
        column_level(picture, True)

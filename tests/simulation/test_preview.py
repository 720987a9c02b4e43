"""Preview pictures: what the stretches bring out, and that files are whole."""

import numpy as np
import pytest
from PIL import Image

from opnav_workbench.errors import MissionError, SessionError
from opnav_workbench.simulation.output import stretched, write_preview


@pytest.fixture(scope="module")
def picture():
    image = np.random.default_rng(1).normal(10.0, 2.0, (60, 80))
    image[20:30, 30:40] = 4000.0  # a body
    image[50, 10] = 60.0  # a star of 25 sigma
    return image


def test_linear_shows_the_body_and_log_the_star_too(picture):
    linear, log = stretched(picture, "linear"), stretched(picture, "log")
    assert linear.shape == picture.shape
    assert linear[25, 35] == log[25, 35] == 255
    assert linear[50, 10] < 5
    assert log[50, 10] > 80
    assert np.median(linear) == 0
    assert 0 < np.median(log) < 60


def test_line_zero_is_at_the_top(picture, tmp_path):
    path = tmp_path / "a.png"
    write_preview(path, picture, "linear")
    with Image.open(path) as shown:
        pixels = np.asarray(shown)
    assert np.array_equal(pixels, stretched(picture, "linear"))
    assert pixels[25, 35] == 255


@pytest.mark.parametrize("stretch", ["linear", "log"])
def test_an_empty_picture_is_dark_noise(stretch):
    noise = stretched(np.random.default_rng(2).normal(0.0, 1.0, (50, 50)), stretch)
    assert np.mean(noise > 128) < 0.001
    assert stretched(np.zeros((5, 5)), stretch).max() == 0 or stretch == "log"


def test_wrong_stretches_and_folders_are_refused(picture, tmp_path):
    with pytest.raises(MissionError, match="linear or log"):
        stretched(picture, "sqrt")
    (tmp_path / "file").write_text("")
    with pytest.raises(SessionError, match="cannot write"):
        write_preview(tmp_path / "file" / "a.png", picture, "log")

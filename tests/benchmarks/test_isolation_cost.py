"""What isolation costs a whole run, in processor time of all its processes (``isolation.py`` prints the table)."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from isolation import KINDS, copies, cost, write_pictures

PICTURES = 10
MOST = 1.4  # of a run that solves ten; a process a picture would make it 2.5
MOST_PLAIN = 1.1  # what is never tried costs nothing; this is how well times of a second repeat


@pytest.mark.slow
def test_a_run_of_compressed_pictures(demo_truths, tmp_path):
    copies(demo_truths[0].picture, tmp_path, PICTURES)
    isolated, bare = cost("solve", tmp_path, PICTURES, rounds=2)
    assert 1.0 < isolated / bare < MOST


@pytest.mark.slow
def test_a_run_of_plain_pictures(tmp_path):
    write_pictures(tmp_path)
    isolated, bare = cost("read", tmp_path / KINDS[0], PICTURES)
    assert isolated / bare < MOST_PLAIN

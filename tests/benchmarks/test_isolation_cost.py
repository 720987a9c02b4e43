"""What isolation costs a whole run, in processor time of all its processes (``isolation.py`` prints the table)."""

import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from isolation import END, RUNS, START, copies, cost, write_pictures

PICTURES = 10
# Of a run that solves ten it is 1.1, with a process a picture 2.5: a ratio as far from one as from the other.
MOST = 1.65
CHILDREN = "import os; print(os.times().children_user + os.times().children_system)"


@pytest.mark.slow
def test_a_run_of_compressed_pictures(demo_truths, tmp_path):
    copies(demo_truths[0].picture, tmp_path, PICTURES)
    isolated, bare = cost("solve", tmp_path, PICTURES)
    assert 1.0 < isolated / bare < MOST


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "tried"), [("plain.fit", False), ("squeezed.fits", True)])
def test_what_is_proven_harmless_starts_no_process(tmp_path, kind, tried):
    write_pictures(tmp_path)
    run = subprocess.run(
        [sys.executable, "-c", START + RUNS["read"] + END + CHILDREN, "yes", tmp_path / kind, "2"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert (float(run.stdout) > 0.0) == tried

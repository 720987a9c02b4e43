"""A storm over a night in small; ``night_storm.py`` by itself is the whole: 300 pictures, 500 kills and stops."""

import subprocess
import sys
from pathlib import Path

import pytest

from opnav_workbench.headless.warm_server import can_fork

STORM = Path(__file__).parent / "night_storm.py"


@pytest.mark.slow
@pytest.mark.skipif(not can_fork(), reason="processes are copied on Linux only")
def test_nothing_is_lost_in_a_storm():
    size = ["--pictures", "6", "--events", "5", "--desks", "2", "--seed", "3"]
    run = subprocess.run(
        [sys.executable, STORM, *size], capture_output=True, text=True, timeout=300, check=False
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert "nothing lost, nothing else changed" in run.stdout
    assert "decisions saved" in run.stdout

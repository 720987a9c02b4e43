"""A real night, its own notebook and workers, with mutants of a good picture: each is named, the good one is as ever.

More, from another seed: ``pytest tests/headless/test_hostile_night.py --all --fuzz 60 --fuzz-seed 7``.
"""

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from opnav_workbench.cli import app
from opnav_workbench.rehearsal import DEMO_KERNELS

sys.path.insert(0, str(Path(__file__).parents[1]))

from hostile import mutant

BORESIGHT = (0.0, 0.0, -1.0)  # of LORRI
FARTHEST_RAD = 6e-4  # of a right pointing from the truth; a false one is far


@pytest.mark.slow
def test_a_night_of_hostile_pictures(fuzz, demo_truths, tmp_path):
    truth, rng = demo_truths[0], fuzz.random("night")
    good, folder = truth.picture.read_bytes(), tmp_path / "incoming"
    folder.mkdir()
    (folder / "good.fit").write_bytes(good)
    names = [f"{number:03d}.fit" for number in range(fuzz.count(3))]
    for name in names:
        (folder / name).write_bytes(mutant(good, rng, text=False))
    odd = os.fsencode(folder) + b"/no\xff\x1btext.fit"
    Path(os.fsdecode(odd)).write_bytes(good[:5000])
    options = ("--mission", "new_horizons", "--kernels", DEMO_KERNELS, "--targets", "none")
    words = ["nightly", str(folder), *options, "--out", str(tmp_path / "night"), "--jobs", "2"]
    answer = CliRunner().invoke(app, words, env={"COLUMNS": "160"})
    assert answer.exit_code == 3, answer.output
    assert "Traceback" not in answer.output
    assert "unforeseen" not in answer.output
    rows = json.loads((tmp_path / "night/summary.json").read_text())["images"]
    assert len(rows) == len(names) + 2
    assert {row["name"]: row["status"] for row in rows}["good"] == "ok"
    seen = truth.camera_from_j2000.T @ BORESIGHT
    for path in sorted((tmp_path / "night").glob("*/result.json")):
        result = json.loads(path.read_text())
        assert all(message.isprintable() for message in result["messages"])
        assert result["status"] != "failed" or result["messages"]
        if result["status"] == "ok":
            ra, dec = np.radians([result["pointing"]["ra_deg"], result["pointing"]["dec_deg"]])
            found = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
            assert np.arccos(np.clip(found @ seen, -1.0, 1.0)) < FARTHEST_RAD

"""The exam of the rehearsal in orbit: are its sigmas true? Run by hand; a seed takes half a minute of processor time.

    python tests/rehearsal/orbit_sigma_exam.py --seeds 1-50 --pairs 3 --out exam
    python tests/rehearsal/orbit_sigma_exam.py --seeds 1-50 --pairs 3 --out exam --again

Each seed has another surface, map, orbit, rotation and set of attitudes (tests/rehearsal/orbit_small.py); all are solved
blind and held against their truth. Asked: error over sigma of every quantity 0.8 to 1.2 over 50 seeds. What a folder has
already is kept, so that it can be stopped at any time; ``--again`` solves the pictures anew.
"""

import argparse
import json
import shutil
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "landmarks"))

from orbit_small import small_scenario
from sun_table import SunTable

from opnav_workbench.geometry import matrix_from_quaternion, unit
from opnav_workbench.headless.rehearsal_run import process_package
from opnav_workbench.kernels import KernelSet, et_from_utc
from opnav_workbench.landmarks import Maplets
from opnav_workbench.landmarks.prediction import landmark_partials
from opnav_workbench.mission import load_mission
from opnav_workbench.rehearsal import new_rehearsal, open_rehearsal, reveal, score_rehearsal
from opnav_workbench.rehearsal.orbit.scoring import true_landmarks
from opnav_workbench.rehearsal.orbit.solution import solve_orbit_rehearsal
from opnav_workbench.scene import body_target


def made(seed, pairs, folder):
    """The package of a seed."""
    package = folder / f"ort_{seed}"
    if not (package / "ort.yaml").is_file():
        shutil.rmtree(folder / f"mission_{seed}", ignore_errors=True)
        new_rehearsal(small_scenario(folder / f"mission_{seed}", pairs), package, seed=seed)
    return open_rehearsal(package)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", nargs="+", default=["1"], help="numbers, and ranges such as 1-50")
    parser.add_argument("--pairs", type=int, default=3)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--again", action="store_true")
    given = parser.parse_args()
    print(given)


if __name__ == "__main__":
    main()

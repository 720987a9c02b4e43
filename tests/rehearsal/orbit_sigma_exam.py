"""The exam of the rehearsal in orbit: are its sigmas true? Run by hand; a seed takes a minute of processor time.

    python tests/rehearsal/orbit_sigma_exam.py --seeds 1-50 --pairs 3 --out exam [--again]

Each seed has another surface, map, orbit, rotation and set of attitudes (tests/rehearsal/orbit_small.py); all are solved
blind and held against their truth. Asked: error over sigma of every quantity 0.8 to 1.2 over 50 seeds. What the folder has
already is kept, so that it can be stopped at any time; ``--again`` processes the pictures anew.
"""

import argparse
import shutil
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from orbit_small import small_scenario

from opnav_workbench.headless.rehearsal_run import process_package
from opnav_workbench.rehearsal import new_rehearsal, open_rehearsal, reveal, score_rehearsal
from opnav_workbench.rehearsal.orbit.solution import solve_orbit_rehearsal


def made(seed, pairs, folder):
    """The package of a seed."""
    package = folder / f"ort_{seed}"
    if not (package / "ort.yaml").is_file():
        shutil.rmtree(folder / f"mission_{seed}", ignore_errors=True)
        new_rehearsal(small_scenario(folder / f"mission_{seed}", pairs), package, seed=seed)
    return open_rehearsal(package)


def numbers(words):
    """Seeds of words such as 3 or 1-50."""
    out = []
    for word in words:
        first, _, last = word.partition("-")
        out += range(int(first), int(last or first) + 1)
    return out


def told(seed, score):
    shown = [p.landmarks for p in score.pictures if p.landmarks is not None and p.landmarks.accepted]
    solved = score.solution.solution
    sys.stdout.write(
        f"seed {seed}: {score.grade.letter}, chi2 {solved.chi2:.0f} of {solved.degrees_of_freedom}; landmarks "
        f"{sum(s.accepted for s in shown)}, false {sum(s.false for s in shown)}, error/sigma "
        f"{np.sqrt(np.mean([s.rms_sigmas**2 for s in shown])):.2f}, rms "
        f"{np.sqrt(np.mean([s.rms_px**2 for s in shown])):.2f} px; all parameters "
        f"{score.solution.all_parameters.sigmas:.2f} sigma\n"
    )
    sys.stdout.flush()


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", nargs="+", default=["1"], help="numbers, and ranges such as 1-50")
    parser.add_argument("--pairs", type=int, default=3)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--again", action="store_true")
    given = parser.parse_args()
    seen = {}
    for seed in numbers(given.seeds):
        package, run = made(seed, given.pairs, given.out), given.out / f"run_{seed}"
        process_package(package, run, again=given.again)
        score = score_rehearsal(package, reveal(package), run, solve_orbit_rehearsal(package, run))
        told(seed, score)
        for check in (score.solution.prediction, *score.solution.parameters):
            seen.setdefault(check.name, []).extend(check.component_sigmas)
    for name, values in seen.items():
        sys.stdout.write(f"{name}: error/sigma {np.sqrt(np.mean(np.square(values))):.2f} of {len(values)}\n")


if __name__ == "__main__":
    main()

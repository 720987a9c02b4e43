"""The exam of the rehearsal in orbit: are its sigmas true? Run by hand; a seed takes half a minute of processor time.

    python tests/rehearsal/orbit_sigma_exam.py --seeds 1 2 3 --pairs 3

Each seed has another surface, map, orbit, rotation and set of attitudes (tests/rehearsal/orbit_small.py); all are solved
blind and held against their truth. Asked: error over sigma of every quantity 0.8 to 1.2 over 50 seeds.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from orbit_small import small_scenario

from opnav_workbench.headless.rehearsal_run import process_package
from opnav_workbench.rehearsal import new_rehearsal, reveal, score_rehearsal
from opnav_workbench.rehearsal.orbit.solution import solve_orbit_rehearsal


def errors(seed, pairs):
    """The score of a seed."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        package = new_rehearsal(small_scenario(folder / "mission", pairs), folder / "ort", seed=seed)
        process_package(package, folder / "run")
        solution = solve_orbit_rehearsal(package, folder / "run")
        return score_rehearsal(package, reveal(package), folder / "run", solution)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--pairs", type=int, default=3)
    given = parser.parse_args()
    seen = {}
    for seed in given.seeds:
        score = errors(seed, given.pairs)
        checks = (score.solution.prediction, *score.solution.parameters)
        for check in checks:
            seen.setdefault(check.name, []).extend(check.component_sigmas)
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
    for name, values in seen.items():
        sys.stdout.write(f"{name}: error/sigma {np.sqrt(np.mean(np.square(values))):.2f} of {len(values)}\n")


if __name__ == "__main__":
    main()

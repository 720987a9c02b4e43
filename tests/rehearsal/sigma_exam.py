"""Rehearsals of many seeds, blind, and their errors over sigmas: whether the covariances are such that they can be used.

    python tests/rehearsal/sigma_exam.py --scenario new_horizons/pluto_final_approach --seeds 50 --out exam

What is there already is kept (pictures, their results) and only estimated again, so that it can be stopped at any time.
About half a minute of processor time a seed. ``--mottled`` gives Pluto and Charon surfaces of reflectance 0.25 to 0.75 that
nobody told the team of. ``--laws`` gives them laws that are off by what the fits hold a stated one to be good to: with the
very law that the mission states, a truth stands in the middle of what is allowed for, and errors are smaller than sigmas.
``--figures`` does the same with sizes and axes: nobody tells the team how well they are known, so that each is off by one of
the scales that the fits hold to be as likely, but for the largest: occultations tell a body of this size to 2 %. Stars are
off their catalog in any case.

Beside the flyby's errors stand those of the pictures' attitudes and centers: a flyby whose ratio is not 1 has it from one of
them, or from how they were put together. In brackets stands where the ratio of so many seeds lies in 95 of 100 exams whose
sigmas are true. Attitudes of a seed share their stars, and centers their surface: theirs is wider than independent numbers'.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from opnav_workbench.headless.rehearsal_run import process_package
from opnav_workbench.rehearsal import open_rehearsal, reveal, score_rehearsal, solve_rehearsal
from opnav_workbench.rehearsal.making import new_rehearsal
from opnav_workbench.rehearsal.scenario import load_ort_scenario
from opnav_workbench.rehearsal.solution import predicted_flyby
from opnav_workbench.render.body import FigureUncertainty

MOTTLED = {"bodies": ["PLUTO", "CHARON"], "dark": 0.25, "bright": 0.75}


LAW_SIGMA = 0.3  # of Lommel-Seeliger's share, as `opnav_workbench.bodies.disk.problem` believes of a law that is stated


def with_laws(scenario, seed: int):
    """The scenario of a seed whose bodies scatter otherwise than the mission says."""
    values, random = scenario.model_dump(mode="json", exclude_none=True), np.random.default_rng([41, seed])
    for body in values["bodies"]:
        share = float(np.clip(body["law"]["lunar_weight"] + LAW_SIGMA * random.normal(), 0.0, 1.0))
        body["law"] = {"law": "lunar_lambert", "lunar_weight": share}
    return type(scenario).model_validate(values)


RADII_KM = {"PLUTO": 1188.3, "CHARON": 606.0}  # as the kernels have them


def with_figures(scenario, seed: int):
    """The scenario of a seed whose bodies are no spheres of the radii in the kernels."""
    values, random = scenario.model_dump(mode="json", exclude_none=True), np.random.default_rng([42, seed])
    belief = FigureUncertainty()
    for body in values["bodies"]:
        size = random.choice(belief.size_scales[1:]) * random.normal()
        axes = random.choice(belief.axes_scales[1:]) * random.normal(size=3)
        body["radii_km"] = (RADII_KM[body["name"]] * np.exp(size + axes - axes.mean())).tolist()
    return type(scenario).model_validate(values)


def errors_of(scenario, seed: int, out: Path):
    """Errors and sigmas of B.T, B.R, arrival and the worst known direction; errors over sigmas along the axes of
    the covariance, of attitudes and of centers."""
    folder = out / f"package_{seed}"
    if not (folder / "ort.yaml").is_file():
        new_rehearsal(scenario, folder, seed=seed, jobs=1)
    package = open_rehearsal(folder)
    process_package(package, out / f"run_{seed}")
    solution, truth, flyby = (
        solve_rehearsal(package, out / f"run_{seed}"),
        reveal(package),
        predicted_flyby(package),
    )
    true = flyby.corrected(np.asarray(truth.relative_state_km) - flyby.state)
    parameters = np.concatenate([np.atleast_1d(truth.parameters[name]) for name in solution.parameters])
    off = solution.correction - parameters
    values, vectors = np.linalg.eigh(solution.covariance)
    error = np.append(solution.b_plane_after - true, off @ vectors[:, -1])
    sigma = np.append(solution.b_plane_sigma, np.sqrt(values[-1]))
    axes = off @ vectors / np.sqrt(values)
    pictures = score_rehearsal(package, truth, out / f"run_{seed}", solution).pictures
    attitudes = [p.pointing.component_sigmas for p in pictures if p.pointing is not None]
    centers = [c.check.component_sigmas for p in pictures for c in p.centers if c.check is not None]
    return error, sigma, axes, np.concatenate(attitudes), np.concatenate(centers)


def told(name: str, ratios) -> str:
    """Return the rms of errors over sigmas (n,), and where it lies if the sigmas are true."""
    low, high = np.sqrt(chi2.ppf([0.025, 0.975], len(ratios)) / len(ratios))
    return f"{name} {np.sqrt(np.mean(np.square(ratios))):.2f} ({low:.2f} to {high:.2f})"


NAMES = ("B.T", "B.R", "arrival", "worst known direction")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="new_horizons/pluto_final_approach")
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--mottled", action="store_true")
    parser.add_argument("--laws", action="store_true")
    parser.add_argument("--figures", action="store_true")
    parser.add_argument("--first", type=int, default=1, help="seed")
    asked = parser.parse_args()
    scenario = load_ort_scenario(asked.scenario)
    if asked.mottled:
        values = scenario.model_dump(mode="json", exclude_none=True)
        values["perturbations"]["albedo"] = MOTTLED
        scenario = type(scenario).model_validate(values)
    rows = []
    for seed in range(asked.first, asked.first + asked.seeds):
        drawn = with_laws(scenario, seed) if asked.laws else scenario
        drawn = with_figures(drawn, seed) if asked.figures else drawn
        error, sigma, *ratios = errors_of(drawn, seed, asked.out)
        rows.append((error / sigma, sigma, *ratios))
        shown = "  ".join(f"{e:+9.2f} ({e / s:+.2f})" for e, s in zip(error, sigma, strict=True))
        sys.stdout.write(f"seed {seed:3d}  B.T, B.R km, arrival s, worst km: {shown}\n")
        sys.stdout.flush()
    over, sigmas, *of_all = zip(*rows, strict=True)
    lines = [told(name, ratios) for name, ratios in zip(NAMES, np.transpose(over), strict=True)]
    lines += [
        told(name, np.concatenate(r))
        for name, r in zip(("axes", "attitudes", "centers"), of_all, strict=True)
    ]
    sys.stdout.write(
        f"{len(rows)} seeds, error over sigma: {', '.join(lines)}; mean sigmas {np.mean(sigmas, 0).round(2)}\n"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())

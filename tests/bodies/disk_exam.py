"""Centers of disks held beside the truth: ``python tests/bodies/disk_exam.py --trials 200 --seed 1 --method auto --jobs 2``.

Draws pictures over size, phase, contrast, law, figure, PSF and displacement (`draw`), disturbs them if asked
(`disk_disturbances`), finds the body in each by one method (`run_method`) and prints tables. ``--out FILE.jsonl`` keeps a
record a line as trials end, and goes on where it was left; ``--only INDEX`` repeats one trial by itself, with everything
that the method said of it; ``--tables FILE.jsonl`` prints the tables of a file again.
"""

import argparse
import json
import sys
import time
import traceback
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np
from disk_bound import bound_px2, has_bound
from disk_disturbances import DISTURBANCES, disturbed
from disk_surfaces import BLOB_SIZES, FIELDS, LAWS, MAPS
from disk_truth import TrialSetup, data_folder, make_trial

import opnav_workbench.bodies as bodies

CONTRASTS = (1.0, 3.0, 9.0)
SIZE_EDGES_PX = (1.0, 3.0, 5.0, 15.0, 40.0, 120.0, 300.0, 800.0, 2000.0)
PHASE_EDGES_DEG = (0.0, 40.0, 90.0, 130.0)
FIGURES = ("right", "size", "axes")
GRIDS = {
    "tiny": (1.0, 9.0), "small": (5.0, 150.0), "full": (5.0, 800.0), "odd": (3.0, 2000.0), "overexposed": (5.0, 800.0),
    "rough": (30.0, 400.0),
}  # fmt: skip
MAX_PHASE_DEG = {name: 150.0 if name == "odd" else 130.0 for name in GRIDS}
RELIEF = (0.003, 0.01, 0.03)  # of the radius, rms, of a rough one
HELD = (0.05, 0.8)  # of the peak, by an overexposed detector
TRIAXIAL = (1.12, 1.0, 0.88)
PSFS, PSF_SHARES = ("known", "known_wings", "width", "wings"), (0.4, 0.15, 0.25, 0.2)
CUT_SHARE = 0.1  # of the trials have their center anywhere in the frame
# Where the issue asks for a center: that limb SNR, and enough of the limb in the frame
FAIR_SNR, FAIR_LIMB = 20.0, 0.3
FALSE_SIGMAS, FALSE_PX = 5.0, 0.1
# Steps of the R2 sequence: even in size and phase at any number
GOLDEN = 0.7548776662466927, 0.5698402909980532


# ---- What is drawn.


def draw(seed, index, grid="full"):
    """Return the setup of a trial; classes follow from the index, so that any number of trials covers all of them."""
    rng = np.random.default_rng([seed, index, 17])
    start = np.random.default_rng([seed, 18]).random(2)
    u = (start + (index + 1) * np.array(GOLDEN)) % 1.0
    low, high = GRIDS[grid]
    diameter = float(low * (high / low) ** u[0])
    contrast = CONTRASTS[index % 3]
    law = (
        "lambert" if (index // 3) % 2 == 0 else str(rng.choice([name for name in LAWS if name != "lambert"]))
    )
    figure = FIGURES[(index // 6) % 3]
    pattern, error = _figure(figure, rng)
    displaced = rng.random() < 0.5
    setup = TrialSetup(
        seed=int(rng.integers(2**31)),
        diameter_px=diameter,
        phase_deg=float(MAX_PHASE_DEG[grid] * u[1]),
        family=_family(contrast, rng),
        contrast=contrast,
        law=law,
        axes=TRIAXIAL if rng.random() < 0.3 and figure != "axes" else (1.0, 1.0, 1.0),
        figure_error=error,
        figure_pattern=pattern,
        displacement_px=float(rng.uniform(5.0, 200.0) if displaced else rng.uniform(0.0, 5.0)),
        psf=str(rng.choice(PSFS, p=PSF_SHARES)),
        peak_dn=float(np.exp(rng.uniform(np.log(150.0), np.log(3000.0)))),
        place_px=tuple(rng.uniform(0.0, 1023.0, 2)) if rng.random() < CUT_SHARE else None,
    )
    if grid == "overexposed":
        return replace(setup, saturation_dn=setup.peak_dn * float(np.exp(rng.uniform(*np.log(HELD)))))
    if grid == "rough":
        return replace(setup, topography=RELIEF[(index // 3) % len(RELIEF)])
    return setup if grid != "odd" else _with_oddities(setup, rng)


def _with_oddities(setup, rng):
    """Return a setup with some of: saturated parts, cosmic rays, a rough limb, a center outside the frame."""
    odd = {}
    if rng.random() < 0.4:
        odd["saturation_dn"] = setup.peak_dn * float(rng.uniform(0.3, 1.0))
    if rng.random() < 0.4:
        odd["cosmic_rays"] = int(rng.integers(20, 400))
    if rng.random() < 0.4:
        odd["topography"] = float(rng.uniform(0.002, 0.01))
    if rng.random() < 0.3:
        beyond = min(0.4 * setup.diameter_px, 250.0)  # LORRI's distortion is not known much farther out
        odd["place_px"] = tuple(rng.uniform(-beyond, 1023.0 + beyond, 2))
    return replace(setup, **odd)


def _figure(figure, rng):
    """Pattern and size of what the navigator does not know of the figure: every axis is wrong by 10 % at most."""
    if figure == "right":
        return (0.0, 0.0, 0.0), 0.0
    error = float(rng.uniform(0.02, 0.10))
    if figure == "size":
        return (float(rng.choice([-1.0, 1.0])),) * 3, error
    pattern = rng.uniform(-1.0, 1.0, 3)
    return tuple(float(p) for p in pattern / np.abs(pattern).max()), error


def _family(contrast, rng):
    if contrast == 1.0:
        return "uniform"
    kinds = ["blobs", "field", "craters"] + ["map"] * (data_folder() is not None)
    kind = rng.choice(
        kinds, p=np.array([3.0, 3.0, 1.0, 2.0][: len(kinds)]) / sum([3.0, 3.0, 1.0, 2.0][: len(kinds)])
    )
    choices = {"blobs": BLOB_SIZES, "field": FIELDS, "map": [str(i) for i in range(len(MAPS))]}
    return str(kind) if kind == "craters" else f"{kind}_{rng.choice(choices[kind])}"


# ---- What is asked.


def run_method(picture, name, method):
    """Return the center that a method finds; "auto" is the package's choice, told no more than the picture."""
    if method == "auto":
        if hasattr(bodies, "find_auto"):
            return bodies.find_auto(picture, name)
        method = bodies.choose_method(picture.diameter_px(name))
    finder = {"unresolved": "find_unresolved_body"}.get(method, f"find_{method}")
    return getattr(bodies, finder)(picture, name)


def examine(index, exam_seed, grid, method, find=run_method, bound=False, disturbance=None):
    """Return the record of one trial: its setup, what was found, how far that is from the truth, and from the bound."""
    setup = draw(exam_seed, index, grid)
    start = time.process_time()
    trial = make_trial(setup)
    picture = trial.picture if disturbance is None else disturbed(trial, disturbance)
    drawn = time.process_time()
    record = {"index": index, "exam_seed": exam_seed, "grid": grid, "method": method}
    record |= {"disturbance": disturbance, **asdict(setup)}
    record |= {
        "truth_px": trial.truth_px.tolist(),
        "limb_snr": trial.limb_snr,
        "limb_share": trial.limb_share,
    }
    try:
        center = find(picture, trial.name, method)
        record |= _said(center, trial.truth_px)
    except Exception as error:
        record |= {"status": "raised", "messages": [repr(error), traceback.format_exc(limit=-3)]}
    record |= {"cpu_s": time.process_time() - drawn, "drawing_s": drawn - start}
    if bound and has_bound(setup) and "error_px" in record:
        error = np.array(record["error_px"])
        record["chi2_bound"] = float(error @ np.linalg.solve(bound_px2(trial), error))
    return record


def _said(center, truth_px):
    said = {"status": center.status, "used": center.method, "messages": list(center.messages)}
    said["flags"] = int(center.flags)
    if center.pixel_line is None:
        return said
    error = center.pixel_line - truth_px
    said |= {"error_px": error.tolist(), "covariance_px2": np.asarray(center.covariance_px2).tolist()}
    try:
        said["chi2"] = float(error @ np.linalg.solve(center.covariance_px2, error))
    except np.linalg.LinAlgError:
        said["chi2"] = np.inf
    return said


def run(trials, seed, method, grid="full", jobs=1, find=run_method, bound=False, disturbance=None, kept=None):
    """Return the records of trials 0 to `trials` - 1, or of those listed.

    In `kept`, a file of lines, each is as soon as it is there, and those that are there already are not run again.
    """
    numbers = range(trials) if isinstance(trials, int) else trials
    exam = {"exam_seed": seed, "grid": grid, "method": method, "disturbance": disturbance}
    one = partial(examine, **exam, find=find, bound=bound)
    if kept is None:
        return list(_each(one, numbers, jobs))
    records = {record["index"]: record for record in read_records(kept)} if kept.exists() else {}
    if any(record.get(key) != value for record in records.values() for key, value in exam.items()):
        raise SystemExit(f"{kept} holds another exam: name another file")
    with kept.open("a", encoding="utf-8") as file:
        for record in _each(one, [number for number in numbers if number not in records], jobs):
            file.write(json.dumps(record) + "\n")
            file.flush()
            records[record["index"]] = record
    return [records[number] for number in numbers]


def _each(one, numbers, jobs):
    """Give the records of trials as they end, in their order."""
    if jobs == 1:
        yield from map(one, numbers)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(one, numbers, chunksize=4)


def read_records(path):
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


# ---- What comes of it.


def fair(record):
    """Whether a center is asked for: a limb bright enough, and enough of it in the frame."""
    return record["limb_snr"] > FAIR_SNR and record["limb_share"] > FAIR_LIMB


def is_ok(record):
    return record["status"] == "ok"


def error_px(record):
    return float(np.hypot(*record["error_px"])) if "error_px" in record else np.nan


def is_false(record):
    """Whether an ``ok`` lies beyond 5 sigma (of its direction) and 0.1 px."""
    return is_ok(record) and not (record["chi2"] <= FALSE_SIGMAS**2 or error_px(record) <= FALSE_PX)


def error_over_sigma(records, key="chi2"):
    """Rms of the error over its sigma (or the bound: ``chi2_bound``), an axis; nan for none."""
    chi2 = [r[key] for r in records if key in r]
    return float(np.sqrt(0.5 * np.mean(chi2))) if chi2 else np.nan


def summary(records):
    """Return the figures of a cell; errors and their ratio to sigma are those of the ``ok``."""
    asked, ok = [r for r in records if fair(r)], [r for r in records if is_ok(r)]
    errors = np.array([error_px(r) for r in ok])
    return {
        "trials": len(records),
        "asked": len(asked),
        "ok_share": np.mean([is_ok(r) for r in asked]) if asked else np.nan,
        "ratio": error_over_sigma(ok),
        "bound": error_over_sigma(ok, "chi2_bound"),
        "median_px": np.median(errors) if len(errors) else np.nan,
        "max_px": errors.max() if len(errors) else np.nan,
        "false": sum(is_false(r) for r in records),
        "median_ratio": np.median([np.sqrt(r["chi2"]) for r in ok]) / 1.1774 if ok else np.nan,
        "cpu_s": np.mean([r["cpu_s"] for r in records]) if records else np.nan,
    }


def _bin(value, edges, unit):
    number = int(np.clip(np.searchsorted(edges, value, "right") - 1, 0, len(edges) - 2))
    return f"{edges[number]:3.0f}-{edges[number + 1]:<3.0f} {unit}"


KEYS = {
    "size": lambda r: _bin(r["diameter_px"], SIZE_EDGES_PX, "px"),
    "phase": lambda r: _bin(r["phase_deg"], PHASE_EDGES_DEG, "deg"),
    "contrast": lambda r: f"{r['contrast']:.0f}:1",
    "law": lambda r: "right" if r["law"] == "lambert" else "wrong",
    "law name": lambda r: r["law"],
    "figure": lambda r: (
        "right" if r["figure_error"] == 0.0 else "size" if len(set(r["figure_pattern"])) == 1 else "axes"
    ),
    "psf": lambda r: r["psf"],
    "family": lambda r: r["family"],
    "displaced": lambda r: "> 5 px" if r["displacement_px"] > 5.0 else "< 5 px",
    "oddities": lambda r: (
        "saturated " * (r["saturation_dn"] < np.inf)
        + "hit " * (r["cosmic_rays"] > 0)
        + "rough" * (r["topography"] > 0)
    ),
    "relief": lambda r: f"{100.0 * r['topography']:.1f} %",
    "place": lambda r: "anywhere" if r["place_px"] else "inside",
    "status": lambda r: r["status"],
}
TABLES = (
    (),
    ("size", "contrast", "phase"),
    ("size",),
    ("phase",),
    ("contrast",),
    ("law", "contrast"),
    ("figure",),
    ("psf",),
    ("displaced",),
    ("place",),
    ("law name",),
    ("family",),
    ("oddities",),
    ("relief",),
)
HEAD = f"{'':36s}   n asked   ok%  err/sig  (median)  err/bound  median px    max px  false  cpu s"


def table(records, keys):
    """Return the lines of a table by some keys."""
    names = {r["index"]: tuple(KEYS[k](r) for k in keys) for r in records}
    lines = [f"by {', '.join(keys) or 'nothing: all trials'}", HEAD]
    for cell in sorted(set(names.values())):
        s = summary([r for r in records if names[r["index"]] == cell])
        lines.append(
            f"{'  '.join(cell):36s} {s['trials']:4d} {s['asked']:4d} {100.0 * s['ok_share']:6.1f} {s['ratio']:8.2f} "
            f"{s['median_ratio']:8.2f} {s['bound']:10.2f} {s['median_px']:10.3f} {s['max_px']:9.3f} "
            f"{s['false']:6d} {s['cpu_s']:6.2f}"
        )
    return lines


def report(records, worst=15):
    """Print all tables, what became of the trials, and the worst of them by index."""
    for keys in TABLES:
        _print(*table(records, keys), "")
    asked = [r for r in records if fair(r)]
    states = sorted({r["status"] for r in asked})
    _print("asked: " + ", ".join(f"{s} {sum(r['status'] == s for r in asked)}" for s in states))
    _print(f"drawing {np.mean([r['drawing_s'] for r in records]):.2f} s a picture", "")
    bad = sorted((r for r in records if is_ok(r)), key=lambda r: -r["chi2"])
    _print("ok, but farthest beyond its sigma:", *(_line(r) for r in bad[:worst]), "")
    _print("asked, but not ok:", *(_line(r) for r in asked if not is_ok(r)))


def _line(r):
    said = "; ".join(r["messages"])[:90]
    return (
        f"{r['index']:5d} {r['diameter_px']:6.1f} px {r['phase_deg']:5.1f} deg {r['family']:12s} {r['contrast']:.0f}:1 "
        f"{r['law']:15s} fig {100 * r['figure_error']:4.1f} % disp {r['displacement_px']:5.1f} psf {r['psf']:11s} "
        f"snr {r['limb_snr']:5.1f} limb {r['limb_share']:4.2f} | {r['status']:12s} {error_px(r):8.3f} px "
        f"{np.sqrt(r.get('chi2', np.nan)):7.1f} sigma {said}"
    )


def _print(*lines):
    sys.stdout.write("\n".join(lines) + "\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--method", default="auto")
    parser.add_argument("--grid", choices=sorted(GRIDS), default="full")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--bound", action="store_true", help="compute the bound too, some 10 s a field")
    parser.add_argument("--disturbed", choices=DISTURBANCES, metavar="HOW", help=", ".join(DISTURBANCES))
    parser.add_argument("--only", type=int, nargs="+", metavar="INDEX")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--tables", type=Path)
    a = parser.parse_args()
    if a.tables:
        report(read_records(a.tables))
        return
    records = run(
        a.only or a.trials,
        a.seed,
        a.method,
        a.grid,
        a.jobs,
        bound=a.bound,
        disturbance=a.disturbed,
        kept=a.out,
    )
    if a.only:
        _print(*(json.dumps(r, indent=1) for r in records))
    else:
        report(records)


if __name__ == "__main__":
    main()

"""Exam of the PSF that a night teaches itself: run by hand, not by pytest.

    python tests/headless/psf_night_exam.py STARS.npz FOLDER [pictures] [seed]

LORRI 4x4 pictures of the Milky Way are simulated with a Moffat PSF, which no fit has; STARS.npz (ra_deg, dec_deg, mag) is
their catalog. They are processed with every picture alone, and as a night that learned; told are the errors of the stars'
centers against the truth, and over their own sigmas, by signal-to-noise ratio. A common shift of a picture's stars is the
PSF's own center, a convention, and taken out.
"""

import json
import shutil
import sys
from pathlib import Path

import numpy as np

KERNELS = "new_horizons/pluto_opnav"
CLASSES = ((8.0, 20.0), (20.0, 60.0), (60.0, 1000.0))


def true_mission(folder, fwhm_px=0.85, beta=3.0):
    """Write a copy of the mission whose camera has another PSF."""
    from opnav_workbench.mission import load_mission

    home = load_mission("new_horizons").path.parent
    shutil.copytree(home, folder / "truth_mission", dirs_exist_ok=True)
    camera = folder / "truth_mission" / "cameras" / "lorri_4x4.yaml"
    model = f"psf:\n  model: {{model: moffat, fwhm_px: {fwhm_px}, beta: {beta}}}\n"
    camera.write_text((home / "cameras" / "lorri_4x4.yaml").read_text().replace("psf:\n", model, 1))
    return folder / "truth_mission" / "mission.yaml"


def simulated(catalog, folder, count=24, seed=1, exposure_s=1.0):
    """Simulate the pictures of a night; return their folder."""
    from opnav_workbench.simulation import PictureScenario, simulate

    header = {"MISSION": "New Horizons", "INSTRU": "lor", "SFORMAT": "4X4"}
    pictures = [
        {"name": f"p{i:02d}", "utc": f"2015-04-09T11:{31 + i:02d}:00", "header": header,
         "exposure_s": exposure_s}
        for i in range(count)
    ]  # fmt: skip
    scenario = {
        "mission": str(true_mission(folder)), "kernels": KERNELS, "catalog": catalog, "seed": seed,
        "bodies": [], "pictures": pictures,
    }  # fmt: skip
    simulate(PictureScenario.model_validate(scenario), folder / "pictures")
    return folder / "pictures"


def processed(catalog, pictures, mission, out):
    """Process the pictures with a mission file; return error, sigma (n, 2) and SNR (n,) of stars, and the pictures' own."""
    from opnav_workbench import process
    from opnav_workbench.simulation import read_truth

    rows = []
    for path in sorted(pictures.glob("*.fit")):
        (outcome,) = process(
            path,
            mission=str(mission),
            kernels=KERNELS,
            catalog=catalog,
            targets="none",
            out=out,
            figure=False,
        )
        objects = read_truth(path).objects
        places = np.column_stack([objects["pixel"].value, objects["line"].value])
        true = dict(zip(map(str, objects["id"]), places, strict=True))
        stars = [s for s in outcome.result.get("stars", []) if s["status"] == "used" and s["id"] in true]
        if len(stars) < 3:
            continue
        error = np.array([np.array(s["observed"]) - true[s["id"]] for s in stars])
        sigma = np.array([s["sigma_px"] for s in stars])
        center = np.sum(error / sigma**2, axis=0) / np.sum(sigma**-2.0, axis=0)
        snr = np.array([s["snr"] for s in stars])
        rows.append((error - center, sigma, snr, np.full(len(stars), len(stars))))
    return [np.concatenate(part) for part in zip(*rows, strict=True)]


def told(error, sigma, snr, count):
    said = []
    for low, high in CLASSES:
        chosen = (snr >= low) & (snr < high)
        if chosen.any():
            rms = np.sqrt(np.mean(error[chosen] ** 2))
            ratio = np.sqrt(np.mean((error[chosen] / sigma[chosen]) ** 2))
            said.append(f"SNR {low:.0f}-{high:.0f}: {chosen.sum()} stars, {rms:.4f} px, {ratio:.2f} sigma")
    return "; ".join(said)


def main(stars, folder, pictures=24, seed=1):
    from opnav_workbench.headless.night_psf import learn_night_psf, with_kept_psf
    from opnav_workbench.headless.night_spec import NightSpec

    folder, catalog = Path(folder), f"npz:{stars}"
    made = simulated(catalog, folder, int(pictures), int(seed))
    spec = NightSpec(images=(str(made / "*.fit"),), mission="new_horizons", kernels=KERNELS, catalog=catalog)
    for one in learn_night_psf(spec, folder / "night"):
        sys.stdout.write(one.words + "\n")
    mission = with_kept_psf(spec, folder / "night").mission
    for words, used in (("alone", "new_horizons"), ("the night's", mission)):
        found = processed(catalog, made, used, folder / words.split("'")[0].replace(" ", "_"))
        sys.stdout.write(f"{words:12s} {told(*found)}\n")
    (folder / "done.json").write_text(json.dumps({"mission": mission}))


if __name__ == "__main__":
    main(*sys.argv[1:])

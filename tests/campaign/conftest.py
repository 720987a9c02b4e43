"""Run folders for the archive (one real run of a demo picture, and variations of it), and skies for stacks."""

import json
import shutil
from dataclasses import dataclass, replace

import numpy as np
import pytest

from opnav_workbench.campaign.stacking import StackPicture
from opnav_workbench.geometry import apparent_direction, rotation_from_vector, unit
from opnav_workbench.kernels import KernelSet
from opnav_workbench.mission import load_mission
from opnav_workbench.processing import Processing, process_image
from opnav_workbench.psf import GaussianPsf, add_sources
from opnav_workbench.rehearsal import DEMO_CATALOG, DEMO_KERNELS, DEMO_MISSION, DEMO_TARGETS
from opnav_workbench.targets import TargetState


@pytest.fixture(scope="session")
def real_run(demo_truths, made_once):
    """The demo's LORRI picture, processed: Pluto and Charon, four stars."""
    policy = Processing(mission=DEMO_MISSION, catalog=DEMO_CATALOG, targets=DEMO_TARGETS).opened()

    def make(folder):
        with KernelSet(DEMO_KERNELS):
            outcome = process_image(demo_truths[0].picture, policy, folder, figure=False)
        assert outcome.result["status"] == "ok", outcome.result["messages"]
        return outcome.folder

    return made_once("real_run", make)


@pytest.fixture(scope="session")
def make_run(real_run):
    """Return a function that writes picture `number` of a campaign as a run folder.

    Each picture has its own name, SHA-256, time (an hour apart) and, drawn from its number, pointing error and O-C.
    `edit` may change result and session before they are written; `minute` is when the run was made.
    """
    result_text = (real_run / "result.json").read_text()
    session_text = (real_run / "session.json").read_text()
    table_text = (real_run / "observables.ecsv").read_text()

    def make(folder, number, *, edit=lambda result, session: None, minute=0):
        rng = np.random.default_rng(number)
        name, sha = f"pic_{number:03d}.fit", f"{number:064x}"
        result, session = json.loads(result_text), json.loads(session_text)
        utc = f"2015-04-{9 + number // 24:02d}T{number % 24:02d}:00:00.000"
        result |= {"image": name, "sha256": sha, "utc": utc, "et": 481809667.0 + 3600.0 * number}
        result["pointing"]["delta_pixel"], result["pointing"]["delta_line"] = rng.normal(0.0, 5.0, 2).tolist()
        for body in result["bodies"]:
            sigma = np.sqrt(np.diag(body["covariance_with_pointing_px2"]))
            body["residual_px"] = (sigma * rng.normal(size=2)).tolist()
        session |= {"sha256": sha, "image": f"/pictures/{name}"}
        for step, item in enumerate(session["journal"]):
            item["time_utc"] = f"2026-01-01T{minute // 60:02d}:{minute % 60:02d}:{step:02d}.000+00:00"
        edit(result, session)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "result.json").write_text(json.dumps(result))
        (folder / "session.json").write_text(json.dumps(session))
        (folder / "observables.ecsv").write_text(
            table_text.replace("lorri_4x4.fit", name).replace("2015-04-09T12:00:00.000", utc)
        )
        return folder

    return make


@pytest.fixture
def make_failure():
    """Return a function that writes the run of a picture that could not be read."""

    def make(folder, name="pic_000.fit", reason="no FITS file", sha=None):
        if folder.exists():
            shutil.rmtree(folder)
        folder.mkdir(parents=True)
        result = {"image": name, "mission": "new_horizons", "status": "failed", "messages": [reason]}
        (folder / "result.json").write_text(json.dumps(result | ({} if sha is None else {"sha256": sha})))
        return folder

    return make


@dataclass
class Sky:
    """Simulated pictures of one field with a moving target, and where everything truly is."""

    pictures: list  # StackPicture, without noise and light
    light: list  # noiseless pictures
    target: object  # function of a Stacked: true place of the target, reference camera


@pytest.fixture(scope="session")
def make_sky():
    """Return a function that makes a sky: LORRI's optics on a small detector, repointed and turned from picture to picture.

    The target moves `motion_px` a picture against the stars, and is everywhere `offset_px` off its ephemeris.
    """
    lorri = load_mission("new_horizons").camera_named("lorri_4x4")
    velocity = np.array([3.0, -12.0, 5.0])

    def make(n=5, flux=0.0, *, seed=0, size=36, stars=0, motion_px=0.7, offset_px=(0.0, 0.0), noise=2.0,
             exposures=None, sigma=0.6, star_flux=300.0, twist=0.03):  # fmt: skip
        rng = np.random.default_rng(seed)
        camera = replace(lorri, n_pixel=size, n_line=size, center_pixel_line=np.full(2, 0.5 * (size - 1)))
        middle = rotation_from_vector(rng.normal(size=3))
        look, scale = middle.T @ camera.boresight, camera.pixel_scale_rad
        across = middle.T[:, :2].T  # two directions in the sky
        exposures = exposures or [10.0] * n
        scatter = rng.uniform(-1.0, 1.0, (stars, 2)) * scale * size * 0.8
        star_directions = unit(look + scatter @ across)
        star_fluxes = star_flux * 10.0 ** rng.uniform(-1.5, 0.3, stars)
        pictures, light = [], []
        for i, exposure in enumerate(exposures):
            turn = np.array([*rng.uniform(-2.0, 2.0, 2) * scale, rng.normal(0.0, twist)])
            along = motion_px * (i - 0.5 * (n - 1)) * scale
            state = TargetState("FAINT", 1e8 * unit(look + along * across[0] + 0.4 * along * across[1]))
            picture = StackPicture(
                f"sky_{i}.fit", 600.0 * i, exposure, np.zeros((size, size)), np.full((size, size), noise),
                np.zeros((size, size), dtype=bool), camera, rotation_from_vector(turn) @ middle, velocity,
                GaussianPsf(sigma, sigma), target=state,
            )  # fmt: skip
            response = exposure / max(exposures)
            seen = unit(
                apparent_direction(state.direction, velocity) + scale * np.asarray(offset_px) @ across
            )
            directions = np.concatenate([seen[None], apparent_direction(star_directions, velocity)])
            places = camera.project(directions @ picture.camera_from_j2000.T)
            fluxes = response * np.concatenate([[flux], star_fluxes])
            near = camera.on_detector(places, margin_px=6.0)
            image = np.zeros((size, size))
            add_sources(image, picture.psf, places[near], fluxes[near])
            pictures.append(picture)
            light.append(image)

        def truth(stacked):
            expected = apparent_direction(stacked.target.direction, velocity)
            seen = unit(expected + scale * np.asarray(offset_px) @ across)
            return camera.project((stacked.grid.camera_from_j2000 @ seen)[None])[0]

        return Sky(pictures, light, truth)

    return make


@pytest.fixture(scope="session")
def exposed():
    """Return a function that gives a sky's pictures their light and noise."""

    def expose(sky, rng):
        pairs = zip(sky.pictures, sky.light, strict=True)
        return [f.replace(signal_dn=light + rng.normal(size=light.shape) * f.noise_dn) for f, light in pairs]

    return expose

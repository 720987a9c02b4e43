"""An analyst who never touches the mouse: a rehearsal, a lost frame, the cursor by keys; two pages; a page at 200 %."""

import json

import numpy as np
import pytest
from astropy.io import fits
from typer.testing import CliRunner

from opnav_workbench.cli.lab import LabParameters
from opnav_workbench.cli.ort import ort
from opnav_workbench.geometry import quaternion_from_matrix, radec_from_unit, rotation_from_vector
from opnav_workbench.kernels import KernelSet, camera_attitude, et_from_utc
from opnav_workbench.mission import load_mission
from opnav_workbench.processing import Processing
from opnav_workbench.rehearsal import compare, open_rehearsal, reveal
from opnav_workbench.simulation import load_picture_scenario, read_truth, simulate

pytestmark = pytest.mark.slow

PER_PICTURE = (
    10  # keys: find, accept the rest, repoint, bodies, find, next, find, export, next picture, stars
)
SIGMAS = 5.0
KERNELS = "new_horizons/pluto_approach"
SATURATED = {
    "description": "Pluto, overexposed and mottled", "mission": "new_horizons", "kernels": KERNELS, "magnitude_limit": 12.0,
    "seed": 7,
    "bodies": [{"name": "PLUTO", "albedo": {"map": "mottled", "dark": 0.3, "bright": 0.6, "seed": 4}}],
    "attitude": {"actual": {"source": "error", "shift_px": [80.0, -50.0], "twist_deg": 0.2}},
    "pictures": [{"name": "saturated", "utc": "2015-07-12T08:46:57", "camera": "lorri_1x1", "exposure_s": 1.0,
                  "header": {"TARGET": "PLUTO"}}],
}  # fmt: skip


@pytest.fixture(scope="module")
def rehearsal(tmp_path_factory):
    """The stress rehearsal: wrong pointings, mottled disks, cosmic rays, gaps, a file that was cut; its truth is sealed."""
    folder = tmp_path_factory.mktemp("stress") / "package"
    asked = [
        "new",
        "new_horizons/pluto_stress",
        "--out",
        str(folder),
        "--seed",
        "3",
        "-j1",
    ]
    made = CliRunner().invoke(ort, asked)
    assert made.exit_code == 0, made.output
    return open_rehearsal(folder)


# It is open, or the page says that it cannot be: "opening" is neither yet.
ARRIVED = """name => { const said = document.querySelector('.ow-window .ow-status')?.textContent ?? '';
  return said.includes(`${name}: `) || said.includes(`${name} cannot be opened`); }"""


def test_the_stress_rehearsal_by_keyboard_alone(rehearsal, open_bench, tmp_path, record_property):
    """New pictures, wrong pointing, mottled and saturated disks; each key is an action."""
    simulate(load_picture_scenario(SATURATED), tmp_path)
    pictures = [str(picture.path) for picture in rehearsal.received]
    how = Processing(
        mission="new_horizons",
        kernels=str(rehearsal.metakernel),
        catalog=rehearsal.catalog,
        targets=rehearsal.targets,
    )
    bench = open_bench("stress", LabParameters((*pictures, str(tmp_path / "saturated.fit")), how))
    names = [picture.name for picture in rehearsal.received]
    solved, cut = {}, []
    for name in (*names, "saturated"):
        bench.page.wait_for_function(ARRIVED, arg=f"{name}.fit")
        if "cannot be opened" in bench.page.inner_text(".ow-window .ow-status"):
            cut.append(name)
            bench.press("PageDown")
            continue
        work_through(bench)
        solved[name] = json.loads((bench.folder / name / "result.json").read_text())
        assert solved[name]["pointing"]["n_stars"] >= 3
        bench.press("PageDown", "1")
    record_property("actions", bench.actions)
    assert bench.actions <= PER_PICTURE * (len(names) + 1)
    bench.check_errors()
    assert len(cut) <= 1  # the file that the downlink cut short
    truths = reveal(rehearsal).pictures | {"saturated": read_truth(tmp_path / "saturated.truth.json")}
    checked = [one for name in solved for one in right_as_it_says(solved[name], truths[name])]
    assert len(solved) >= 5  # of six one never came, one was cut, and one is ours
    assert (
        len(checked) >= 3 * len(solved) + 2 * 2
    )  # three angles a picture; of those that are whole, both bodies
    (saturated,) = (body for body in solved["saturated"]["bodies"] if body["name"] == "PLUTO")
    assert "saturated pixels were left out" in saturated["flags"]
    assert saturated["status"] in ("ok", "uncertain")


def right_as_it_says(result, truth):
    """Compare what a result is sure of with the truth, and return it."""
    camera = load_mission("new_horizons").camera_named("lorri_1x1")
    sure = {body["name"] for body in result["bodies"] if body["status"] == "ok"}
    rows = [
        one
        for one in compare(truth, result, camera)
        if one.name.split()[0] in sure or one.name.startswith("Δ")
    ]
    assert all(abs(one.sigmas) < SIGMAS for one in rows), rows
    return rows


BODY = ".ow-window .ow-panel .bodies button[aria-pressed=true]"


def work_through(bench):
    """What a picture needs: its stars, the pointing, both bodies, the files."""
    bench.press("f")
    bench.said("stars found")
    bench.press("A", "p")
    bench.said("pointing: ")
    bench.press("3")
    for key in ("", "n"):
        before = bench.page.inner_text(BODY)
        if key:
            bench.press(key)
            bench.page.wait_for_function(
                "([s, b]) => document.querySelector(s)?.innerText !== b", arg=[BODY, before]
            )
        bench.press("f")
        body = bench.page.inner_text(BODY).split()[-1]
        bench.said(f"{body}, ")
    bench.press("e")
    bench.said("files written")


# -- lost in space ------------------------------------------------------------------------------------------------

PATCH_DEG, STARS = 2.0, 3000  # twenty stars in a picture
LOST_UTC = "2015-07-02T07:00:00"


@pytest.fixture(scope="module")
def lost(tmp_path_factory):
    """A star field whose header tells an attitude 3 deg and a quarter turn off: (picture, truth, catalog spec)."""
    folder = tmp_path_factory.mktemp("lost")
    camera = load_mission("new_horizons").camera_named("lorri_4x4")
    with KernelSet(KERNELS):
        ra, dec = radec_from_unit(camera_attitude("NH_LORRI", et_from_utc(LOST_UTC)).T @ camera.boresight)
    rng = np.random.default_rng(4)
    off = np.radians(rng.uniform(-PATCH_DEG, PATCH_DEG, (STARS, 2)))
    stars = {
        "ra_deg": np.degrees(ra + off[:, 0] / np.cos(dec)) % 360.0,
        "dec_deg": np.degrees(dec + off[:, 1]),
    }
    np.savez(folder / "patch.npz", mag=rng.uniform(7.0, 10.5, STARS), epoch_jyear=2015.5, **stars)
    catalog = f"npz:{folder / 'patch.npz'}"
    picture = {"name": "lost", "utc": LOST_UTC, "camera": "lorri_4x4", "exposure_s": 0.1}
    scenario = {
        "mission": "new_horizons", "kernels": KERNELS, "catalog": catalog, "magnitude_limit": 12.0, "seed": 5,
        "attitude": {"actual": "none"}, "pictures": [picture],
    }  # fmt: skip
    simulate(load_picture_scenario(scenario), folder)
    turn = rotation_from_vector(camera.focal_from_camera.T @ np.radians([2.0, -2.2, 90.0]))
    truth = read_truth(folder / "lost.truth.json")
    told = quaternion_from_matrix(turn @ truth.camera_from_j2000)
    with fits.open(folder / "lost.fit", mode="update") as hdus:
        for key, value in zip(load_mission("new_horizons").keywords["quaternion"], told, strict=True):
            hdus[0].header[key] = float(value)
    return folder / "lost.fit", truth, catalog


def test_one_key_finds_a_lost_frame(lost, open_bench):
    """Marks lie beside their stars, then on them; the pointing is that of the truth.

    The notebook of the test before stands beside this one, with a workbench of its own: this one has the window.
    """
    picture, truth, catalog = lost
    bench = open_bench(
        "lost", LabParameters((str(picture),), Processing(mission="new_horizons", catalog=catalog))
    )
    bench.said("lost.fit: ")
    bench.press("2", "L")
    bench.said("field moved")
    bench.said("header is wrong")
    bench.press("p")
    bench.said("pointing: ")
    bench.press("e")
    bench.said("files written")
    result = json.loads((bench.folder / "lost" / "result.json").read_text())
    camera = load_mission("new_horizons").camera_named("lorri_4x4")
    rows = [one for one in compare(truth, result, camera) if one.name in ("Δpixel", "Δline")]
    assert result["pointing"]["n_stars"] >= 10
    assert max(abs(one.error) for one in rows) < 0.2
    seen = bench.page.evaluate(
        """() => { const doc = Bokeh.documents.find((one) => one.get_model_by_name('opnav-state')?.title === 'lost');
        const data = (name) => doc.get_model_by_name('opnav-picture').renderers.filter(
          (r) => r.name === name && r.visible).map((r) => [...r.data_source.data.pixel ?? []]);
        return [data('overlay:predicted'), data('overlay:observed')]; }"""
    )
    predicted, used = (max(groups, key=len) for groups in seen)
    assert all(min(abs(x - at) for at in predicted) < 1.0 for x in used)
    bench.check_errors()

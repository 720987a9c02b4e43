"""Stacks of run folders: simulated LORRI pictures of a faint moon, real ones of Proxima Centauri, and the command."""

import json

import numpy as np
import pytest
from astropy.io import fits
from matplotlib.image import imread
from typer.testing import CliRunner

from opnav_workbench.campaign import Campaign
from opnav_workbench.campaign.stacking import fit_point, pictures_of_runs, stack_pictures
from opnav_workbench.campaign.stacking.grid import resample
from opnav_workbench.cli.campaign import campaign_app
from opnav_workbench.errors import KernelError, SessionError
from opnav_workbench.kernels import KernelSet
from opnav_workbench.observables import read_ecsv
from opnav_workbench.processing import Processing, process_image
from opnav_workbench.simulation import PictureScenario, read_truth, simulate

WIDE = {"COLUMNS": "160", "NO_COLOR": "1", "TERM": "dumb"}
KERNELS, COUNT = "new_horizons/pluto_opnav", 6


def invoke(*arguments):
    return CliRunner().invoke(campaign_app, [str(a) for a in arguments], env=WIDE)


@pytest.fixture(scope="module")
def faint_charon(tmp_path_factory):
    """LORRI 4x4 pictures of Charon at magnitude 14, three minutes apart, each with a pointing error of its own."""
    folder = tmp_path_factory.mktemp("faint")
    camera = {"MISSION": "New Horizons", "INSTRU": "lor", "SFORMAT": "4X4"}
    pictures = [
        {"name": f"c{i}", "utc": f"2015-04-09T11:{32 + 3 * i}:00", "header": camera, "exposure_s": 0.1}
        for i in range(COUNT)
    ]
    scenario = PictureScenario.model_validate(
        {
            "mission": "new_horizons",
            "kernels": KERNELS,
            "catalog": "bundled",
            "seed": 7,
            "psf_sigma_px": (0.6, 0.6),
            "bodies": [{"name": "CHARON", "brightness": {"source": "magnitude", "magnitude": 14.0}}],
            "pictures": pictures,
        }
    )
    simulate(scenario, folder / "pictures")
    policy = Processing(mission="new_horizons", catalog="bundled", targets=()).opened()
    with KernelSet(KERNELS):
        for i in range(COUNT):
            outcome = process_image(folder / "pictures" / f"c{i}.fit", policy, folder / "run")
            assert outcome.result["pointing"] is not None, outcome.error
    return folder


@pytest.mark.slow
def test_a_faint_moon_in_simulated_pictures(faint_charon, tmp_path):
    """No picture shows it (SNR 4 each); the stack does, within its sigmas of the truth, and goes into the archive."""
    answer = invoke("stack", faint_charon / "run", "-t", "CHARON", "--kernels", KERNELS, "-o", tmp_path)
    assert answer.exit_code == 0, answer.output
    assert "6 pictures, c0.fit to c5.fit" in answer.output
    assert "CHARON: ok, SNR" in answer.output
    folder = tmp_path / "stack_charon_c0_6"
    result = json.loads((folder / "result.json").read_text())
    (body,) = result["bodies"]
    assert (body["method"], body["status"], result["status"]) == ("stack", "ok", "ok")
    assert 6.0 < body["snr"] < 13.0
    # O-C of the stack is the mean of the true offsets from prediction: none was simulated.
    sigma = np.sqrt(np.diag(body["covariance_with_pointing_px2"]))
    assert np.abs(np.array(body["residual_px"]) / sigma).max() < 4.0
    assert np.all(sigma < 0.2)
    truths = [read_truth(faint_charon / "pictures" / f"c{i}.fit") for i in range(COUNT)]
    assert min(t.et for t in truths) < result["et"] < max(t.et for t in truths)
    assert result["stack"]["follow"] == "target"
    assert sum(picture["weight"] for picture in result["stack"]["frames"]) == pytest.approx(1.0)
    assert 0.0 < result["stack"]["noise_correlation"] < 0.5
    (observable,) = read_ecsv(folder / "observables.ecsv")
    assert observable.name == "CHARON"
    assert np.isfinite(observable.partials_px_per_km).all()
    with fits.open(folder / "stack_charon_c0_6.fits") as file:
        assert [hdu.data.shape for hdu in file] == [(64, 64)] * 3
        assert file[0].header["STACKN"] == 6
        middle = np.s_[16:48, 16:48]
        noise = file["NOISE"].data[middle]
        assert np.nanstd(file[0].data[middle]) < 1.6 * np.nanmedian(noise)
    assert imread(folder / "stack_charon_c0_6.png").shape[1] > 1000
    with Campaign(tmp_path / "c.sqlite") as campaign:
        report = campaign.ingest([faint_charon / "run", tmp_path])
        assert report.count("new") == COUNT + 1, report
        assert list(campaign.bodies(method="stack")["body"]) == ["CHARON"]
        assert len(campaign.observables(method="stack")) == 1
        assert len(campaign.pointings()) == COUNT


@pytest.mark.slow
def test_a_stack_on_the_stars(faint_charon, tmp_path):
    answer = invoke("stack", *(faint_charon / "run" / f"c{i}" for i in (0, 2, 4)), "-o", tmp_path)
    assert answer.exit_code == 0, answer.output
    result = json.loads((tmp_path / "stack_stars_c0_3" / "result.json").read_text())
    assert (result["status"], result["bodies"], result["stack"]["follow"]) == ("ok", [], "stars")
    with fits.open(tmp_path / "stack_stars_c0_3" / "stack_stars_c0_3.fits") as file:
        assert file[0].data.shape == (256, 256)
        assert file["COUNT"].data.max() == 3


@pytest.mark.slow
def test_runs_that_cannot_be_stacked_are_named(faint_charon, make_run, tmp_path):
    make_run(tmp_path / "gone", 1)  # its picture is nowhere
    answer = invoke(
        "stack", faint_charon / "run" / "c0", faint_charon / "run" / "c1", tmp_path / "gone", "-o", tmp_path
    )
    assert answer.exit_code == 0, answer.output
    assert "left out" in answer.output
    assert "pic_001.fit is not there" in answer.output
    result = json.loads((tmp_path / "stack_stars_c0_2" / "result.json").read_text())
    assert any("gone left out" in message for message in result["messages"])
    assert any("none is masked" in message for message in result["messages"])
    with pytest.raises(SessionError, match="no run can be stacked"):
        pictures_of_runs([tmp_path / "gone"], None)
    failed = invoke("stack", faint_charon / "run", "-t", "NIX", "-o", tmp_path)
    assert isinstance(failed.exception, SessionError | KernelError)


@pytest.mark.slow
@pytest.mark.realdata
def test_real_pictures_fall_on_each_other(data_dir, tmp_path):
    """Three LORRI pictures of Proxima Centauri, pixels apart: stars agree to 0.1 px, noise falls as it should."""
    pictures = sorted((data_dir / "images" / "lorri_interstellar").glob("lor_04498559*.fits"))
    policy = Processing(
        mission="new_horizons", catalog=f"npz:{data_dir / 'stars' / 'tycho2.npz'}", targets=()
    ).opened()
    runs = [process_image(picture, policy, tmp_path).folder for picture in pictures]
    taken = pictures_of_runs(runs, None)
    assert [picture.name for picture in taken.pictures] == [picture.name for picture in pictures]
    stacked = stack_pictures(taken.pictures, "stars")
    stars = [_centers(run) for run in runs]
    common = sorted(set.intersection(*(set(of) for of in stars)))
    assert len(common) >= 6
    here = np.array(
        [
            [stacked.grid.from_picture(of[star][None], picture)[0] for star in common]
            for of, picture in zip(stars, stacked.pictures, strict=True)
        ]
    )
    mean = here.mean(axis=0)
    apart = here - mean
    assert np.abs(apart.mean(axis=1)).max() < 0.05  # picture against picture
    assert np.sqrt(np.mean(apart**2)) < 0.1  # star by star
    fits_there = np.array([fit_point(stacked, place).pixel_line for place in mean])
    assert np.sqrt(np.mean((fits_there - mean) ** 2)) < 0.1
    measured = [_sky_noise(resample(stacked.grid, picture, 1.0)[0]) for picture in stacked.pictures]
    assert _sky_noise(stacked.image_dn) < 1.15 * np.mean(measured) / np.sqrt(3.0)


def _centers(run):
    """Centers of the stars in use, well inside, by their ids."""
    stars = json.loads((run / "result.json").read_text())["stars"]
    used = {star["id"]: np.array(star["observed"]) for star in stars if star["status"] == "used"}
    return {name: place for name, place in used.items() if np.abs(place - 127.5).max() < 115.0}


def _sky_noise(image):
    """Robust scatter of the faintest half of the pixels: a stack shows fainter stars than its pictures."""
    values = image[np.isfinite(image)]
    low, middle = np.percentile(values, [15.87, 50.0])
    return middle - low

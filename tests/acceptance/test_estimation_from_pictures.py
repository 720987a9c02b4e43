"""From pictures to the flyby: a sequence simulated 4500 km off, processed blind, exported, estimated in the B-plane.

Nothing but files and public calls between the simulated pictures and the answer. Surfaces are as the navigator models them:
what an unknown albedo does is tested with Figures 13 and 14.
"""

import numpy as np
import pytest

import opnav_workbench as opnav
from opnav_workbench.estimation import b_plane, estimate, map_to_b_plane
from opnav_workbench.kernels import et_from_utc, state
from opnav_workbench.observables import joint_covariance_px2, read_ecsv, read_tdm, tdm_table, write_tdm
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.simulation import load_picture_scenario, simulate

pytestmark = pytest.mark.slow

SCENARIO = kernels_meta_dir() / "new_horizons/pictures/pluto_barycenter.yaml"
TIMES = ("2015-07-02T12:00:00", "2015-07-07T04:00:00", "2015-07-12T08:46:57")
OFFSET_KM, GM = 4500.0, 975.5


@pytest.fixture(scope="module")
def kernels():
    with opnav.KernelSet("new_horizons/pluto_approach"):
        yield


@pytest.fixture(scope="module")
def folders(tmp_path_factory, kernels):
    """Three processed pictures; Pluto and Charon together while both are in the field, with Pluto's size in the last."""
    folder = tmp_path_factory.mktemp("approach")
    head = SCENARIO.read_text().split("pictures:")[0]
    lines = [line for line in head.splitlines() if "albedo:" not in line]
    pictures = [
        f"- {{name: p{k}, utc: {utc}, camera: lorri_1x1, exposure_s: 0.1, header: {{TARGET: PLUTO}}}}"
        for k, utc in enumerate(TIMES)
    ]
    (folder / "scenario.yaml").write_text("\n".join([*lines, "pictures:", *pictures]))
    simulate(load_picture_scenario(str(folder / "scenario.yaml")), folder, jobs=1)
    for k in range(len(TIMES)):
        session = opnav.ImageSession.open(folder / f"p{k}.fit", mission="new_horizons")
        session.predict()
        session.find_stars()
        session.repoint()
        if k < 2:
            session.find_bodies(["PLUTO", "CHARON"])
        else:
            session.find_body("PLUTO", method="ellipse", solve_range=True)
        session.observables()
        session.save(folder / f"run/p{k}")
    return folder / "run"


@pytest.fixture(scope="module")
def observables(folders):
    return [o for table in sorted(folders.glob("*/observables.ecsv")) for o in read_ecsv(table)]


def test_observables_are_those_of_the_pictures(observables):
    assert [(o.name, o.status) for o in observables] == [
        ("PLUTO", "ok"),
        ("CHARON", "ok"),
        ("PLUTO", "ok"),
        ("CHARON", "ok"),
        ("PLUTO", "ok"),
    ]
    assert all(np.hypot(*o.residual_px) > 10.0 for o in observables)
    assert np.isfinite(observables[4].measured_range_km)
    covariance = joint_covariance_px2(observables)
    sigma = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sigma, sigma)
    # Two bodies of one picture share its pointing; the pictures share nothing.
    assert np.abs(correlation[:2, 2:4]).max() > 0.3
    assert not covariance[:4, 4:].any()


def test_estimation_recovers_the_offset(observables):
    """4500 km within 3.5 sigma of each component, with a chi-squared that fits; size and parallax see the depth."""
    epoch = et_from_utc(TIMES[-1])
    sun = state("SUN", epoch, "PLUTO BARYCENTER").position_km
    offset = OFFSET_KM * sun / np.linalg.norm(sun)
    result = estimate(observables, a_priori={"target_position": 2e4}, epoch_et=epoch)
    assert result.converged
    assert np.abs((result.correction - offset) / result.sigma).max() < 3.5
    assert result.chi2_before > 1e5
    assert result.degrees_of_freedom == 11
    assert 1e-3 < result.probability < 0.999
    assert all(r.used for r in result.residuals)
    craft = state("NEW HORIZONS", epoch, "PLUTO BARYCENTER")
    solution = map_to_b_plane(result, craft.position_km, craft.velocity_km_s, GM)
    true = b_plane(craft.position_km - offset, craft.velocity_km_s, GM).in_axes_of(solution.a_priori)
    assert np.abs((solution.values_after - true) / solution.sigma).max() < 3.5
    assert np.hypot(*solution.shift[:2]) == pytest.approx(1165.0, abs=3.0)
    assert solution.shift[2] == pytest.approx(-315.0, abs=15.0)


def test_message_holds_what_the_sky_shows(observables, folders, tmp_path):
    write_tdm(observables, tmp_path / "approach.tdm")
    table = tdm_table(read_tdm(tmp_path / "approach.tdm"))
    assert sorted(table["target"]) == ["CHARON", "CHARON", "PLUTO", "PLUTO", "PLUTO"]
    assert np.isfinite(table["range"]).sum() == 1

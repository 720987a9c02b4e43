"""Points and disks no larger than a star, far off their prediction: found if it is they, nothing else is."""

import json

import numpy as np
import pytest

from opnav_workbench.kernels import KernelSet
from opnav_workbench.processing import Processing, process_image
from opnav_workbench.simulation import load_picture_scenario, read_truth, simulate


@pytest.fixture
def bennu(tmp_path):
    """Simulate Figure 3 with Bennu displaced by an offset (km, J2000) and process it with the predicted kernels."""

    def seen(offset_km, **changes):
        content = load_picture_scenario("osiris_rex/bennu_approach").model_dump()
        content["pictures"] = [content["pictures"][0] | changes]
        content["perturbations"]["bodies"] = [{"name": "BENNU", "offset_km": offset_km}]
        (report,) = simulate(load_picture_scenario(content), tmp_path / "pictures")
        policy = Processing(mission="osiris_rex", targets=("BENNU",)).opened()
        with KernelSet("osiris_rex/bennu_approach"):
            outcome = process_image(report.files[0], policy, tmp_path / "run")
        result = json.loads((outcome.folder / "result.json").read_text())
        return result["bodies"], read_truth(report.files[0]).bodies.get("BENNU")

    return seen


@pytest.mark.slow
def test_a_point_ten_pixels_off_is_found(bennu):
    (body,), true_px = bennu((0.0, 0.0, 80.0))
    assert np.hypot(*np.subtract(true_px, body["predicted"])) > 9.0
    assert body["status"] == "ok"
    assert np.hypot(*np.subtract(true_px, body["observed"])) < 0.05


@pytest.mark.slow
def test_nothing_else_is_taken_for_it(bennu):
    (body,), _ = bennu((0.0, 0.0, 2e4))
    assert body["status"] == "not_detected"
    assert body["observed"] is None


@pytest.mark.slow
def test_a_disk_as_small_as_a_star_is_found_fifty_pixels_off(bennu):
    """Ten stars of the field are about as wide and bright: the pointing tells which lights they are."""
    days_before = {"utc": "2018-10-14T00:00:00", "exposure_s": 0.2}
    (body,), true_px = bennu((0.0, 0.0, 15.0), **days_before)
    assert np.hypot(*np.subtract(true_px, body["predicted"])) > 40.0
    assert (body["method"], body["status"]) == ("disk", "ok")
    assert np.hypot(*np.subtract(true_px, body["observed"])) < 0.1

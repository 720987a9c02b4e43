"""The demo as a user runs it, and every notebook executed by papermill."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest
from astropy.table import QTable
from typer.testing import CliRunner

from opnav_workbench.cli import app

sys.path.insert(0, str(Path(__file__).parent))
from warm_notebooks import execute

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"


def run_demo(folder):
    answer = CliRunner().invoke(app, ["demo", "--out", str(folder)], env={"COLUMNS": "160"})
    assert answer.exit_code == 0, answer.output
    return answer.output


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """The demo's folder, and what it printed."""
    folder = tmp_path_factory.mktemp("demo")
    return folder, run_demo(folder)


def test_demo_agrees_with_its_truth(demo):
    folder, printed = demo
    assert "Every solved quantity is within 3" in printed
    for picture in ("lorri_4x4", "mvic_framing"):
        result = json.loads((folder / picture / "result.json").read_text())
        assert result["status"] == "ok"
        assert {body["name"] for body in result["bodies"]} == {"PLUTO", "CHARON"}
        assert (folder / picture / "summary.png").stat().st_size > 10_000


@pytest.mark.slow
def test_demo_is_bit_identical_when_repeated(demo, tmp_path):
    run_demo(tmp_path)
    for picture in ("lorri_4x4", "mvic_framing"):
        once, again = (folder / picture / "result.json" for folder in (demo[0], tmp_path))
        assert once.read_bytes() == again.read_bytes()


@pytest.mark.slow
def test_demo_statistics_over_seeds(tmp_path):
    """Errors over predicted sigmas of many demos: standard deviation near one, no outlier.

    Of a disk as small as Pluto's (1 px) no picture tells what its hemispheres differ by: the sigma has it, the demo's even
    surface has not.
    """
    import numpy as np

    from opnav_workbench.kernels import KernelSet
    from opnav_workbench.mission import load_mission
    from opnav_workbench.processing import Processing, process_image
    from opnav_workbench.rehearsal import (
        DEMO_CATALOG,
        DEMO_KERNELS,
        DEMO_MISSION,
        DEMO_PICTURES,
        DEMO_TARGETS,
        compare,
        simulate_picture,
    )

    mission = load_mission(DEMO_MISSION)
    request = DEMO_PICTURES[1]
    camera = mission.camera_for(request.header)
    errors = []
    with KernelSet(DEMO_KERNELS):
        how = Processing(mission=DEMO_MISSION, catalog=DEMO_CATALOG, targets=DEMO_TARGETS).opened()
        for seed in range(1, 11):
            truth = simulate_picture(request.reseeded(seed), mission, DEMO_CATALOG, tmp_path / str(seed))
            outcome = process_image(truth.picture, how, None)  # no files: a third of the time is their figure
            assert outcome.result["status"] == "ok", outcome.result["messages"]
            rows = compare(truth, outcome.result, camera)
            errors.append([row.sigmas for row in rows])
    scatter, of_disk = np.array(errors), np.array([row.name.startswith("PLUTO") for row in rows])
    # 10 trials of 5 quantities: the standard deviation of a unit normal is known to 10 % from 50 values; 3 of these.
    assert (scatter.shape, of_disk.sum()) == ((10, 7), 2)
    assert 0.7 < scatter[:, ~of_disk].std() < 1.3
    assert scatter[:, of_disk].std() < 1.3
    assert np.abs(scatter).max() < 4.5


ALL_NOTEBOOKS = sorted(p.name for p in NOTEBOOKS.glob("*.ipynb"))
# Those with a test file of their own: they need a picture or decisions, or are judged by their numbers.
WITH_TESTS_OF_THEIR_OWN = {"interstellar_navigation.ipynb", "process_image.ipynb", "workbench.ipynb"}

IN_A_KERNEL = "first_picture.ipynb"  # a kernel of Jupyter's own, as users start it

# Every cell runs as well on less than the parameters ask for as committed.
LESS = {
    "campaign.ipynb": {"pictures": 5},
    "ort_rehearsal.ipynb": {"pictures": 2},
    "picture_planning.ipynb": {"trials": 1},
    "stars_and_pointing.ipynb": {"trials": 100},
}


@pytest.mark.parametrize("notebook", ALL_NOTEBOOKS)
def test_notebook_has_parameters_and_no_outputs(notebook):
    source = json.loads((NOTEBOOKS / notebook).read_text())
    assert all(not cell.get("outputs") for cell in source["cells"])
    assert any("parameters" in cell["metadata"].get("tags", ()) for cell in source["cells"])


@pytest.mark.slow
@pytest.mark.parametrize("notebook", sorted(set(ALL_NOTEBOOKS) - WITH_TESTS_OF_THEIR_OWN))
def test_notebook_runs_headless(notebook, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    parameters = {"out": str(tmp_path / "run")} | LESS.get(notebook, {})
    if notebook == IN_A_KERNEL:
        import papermill

        papermill.execute_notebook(
            NOTEBOOKS / notebook,
            tmp_path / "out.ipynb",
            parameters=parameters,
            progress_bar=False,
            request_save_on_cell_execute=False,
        )
    else:
        execute(NOTEBOOKS / notebook, tmp_path / "out.ipynb", parameters)
    assert list((tmp_path / "run").rglob("result.json"))
    if notebook == "target_centers.ipynb":
        check_table_3(tmp_path / "run/table3.ecsv")


def check_table_3(path: Path) -> None:
    """The paper's key result on an unknown surface: limb scans within 0.12 and 0.03 arcsec, the full disk far off."""
    rows = {row["method"]: row for row in QTable.read(path, format="ascii.ecsv")}
    off = {
        m: [row[f"{axis} error"].to_value("arcsec") for axis in ("RA cos Dec", "Dec")]
        for m, row in rows.items()
    }
    assert set(off) == {
        "full-disk cross-correlation",
        "full-disk least squares",
        "limb scan, automatic",
        "ellipse",
    }
    scan = off["limb scan, automatic"]
    assert abs(scan[0]) < 0.12
    assert abs(scan[1]) < 0.03
    assert math.hypot(*off["full-disk cross-correlation"]) > 4.0 * math.hypot(*scan)


@pytest.mark.slow
def test_program_runs_as_a_process(tmp_path):
    """`python -m opnav_workbench` is the same program, started from any folder."""
    environment = {**os.environ, "COLUMNS": "120"}
    answer = subprocess.run(
        [sys.executable, "-m", "opnav_workbench", "doctor"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert answer.returncode == 0, answer.stdout + answer.stderr
    assert "Everything needed is here" in answer.stdout

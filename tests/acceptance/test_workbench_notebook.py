"""notebooks/workbench.ipynb headless: the gate holds without decisions, and recorded decisions go through it."""

import json
import shutil
import sys
from pathlib import Path

import pytest

from opnav_workbench.kernels import KernelSet
from opnav_workbench.rehearsal import (
    DEMO_KERNELS,
    DEMO_MISSION,
)
from opnav_workbench.session import ImageSession

sys.path.insert(0, str(Path(__file__).parent))
from warm_notebooks import execute

NOTEBOOK = Path(__file__).parents[2] / "notebooks" / "workbench.ipynb"
MAX_BYTES = 100_000


def run(tmp_path, **parameters):
    out = tmp_path / "out.ipynb"
    import papermill

    papermill.execute_notebook(
        NOTEBOOK,
        out,
        {"mode": "headless"} | parameters,
        cwd=tmp_path,
        progress_bar=False,
        request_save_on_cell_execute=False,
        kernel_name="python3",
    )
    return out


def test_committed_without_outputs():
    book = json.loads(NOTEBOOK.read_text())
    assert not any(cell.get("outputs") for cell in book["cells"])
    assert "widgets" not in book["metadata"]


@pytest.mark.slow
def test_undecided_stars_stop_the_notebook_in_one_line(tmp_path):
    with pytest.raises(AssertionError, match=r"SelectionPending: lorri_4x4\.fit: 4 stars wait to be"):
        execute(NOTEBOOK, tmp_path / "out.ipynb", {"mode": "headless"}, tmp_path)
    assert not (tmp_path / "workbench_run" / "lorri_4x4" / "result.json").exists()


@pytest.mark.slow
def test_recorded_decisions_go_through(demo_truths, tmp_path):
    """An analyst's session, written down, repeated headless: the same result, and a small notebook without widgets."""
    with KernelSet(DEMO_KERNELS):
        picture = Path(shutil.copy(demo_truths[0].picture, tmp_path))
        session = ImageSession.open(picture, DEMO_MISSION)
        session.predict()
        session.add_target("PLUTO")
        session.find_stars()
        stars = [box.id for box in session.star_boxes() if box.status == "used"]
        session.accept_stars(stars[:-1])
        session.reject_stars(stars[-1:], "blend")
        session.repoint()
        session.find_body("PLUTO")
        session.observables()
        session.write_decisions(tmp_path / "decisions.yaml", who="a test")
    out = run(
        tmp_path,
        images=str(picture),
        kernels=DEMO_KERNELS,
        targets="PLUTO",
        decisions=str(tmp_path / "decisions.yaml"),
    )
    result = json.loads((tmp_path / "workbench_run" / "lorri_4x4" / "result.json").read_text())
    assert result["pointing"] == json.loads(session.to_json())["pointing"]
    assert [s["status"] for s in result["stars"] if s["id"] == stars[-1]] == ["rejected"]
    assert out.stat().st_size < MAX_BYTES
    assert "widgets" not in json.loads(out.read_text())["metadata"]


@pytest.mark.slow
def test_a_misspelt_parameter_is_told(tmp_path):
    with pytest.raises(AssertionError, match=r"SessionError.*decision"):
        execute(NOTEBOOK, tmp_path / "out.ipynb", {"mode": "headless", "decision": "x.yaml"}, tmp_path)

"""``opnav nightly`` with its own notebook: faults named, results those of ``opnav process``, flight frames too."""

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from opnav_workbench.campaign import Campaign
from opnav_workbench.cli import app
from opnav_workbench.rehearsal import DEMO_KERNELS


def run(*words) -> tuple[int, str]:
    answer = CliRunner().invoke(app, [str(word) for word in words], env={"COLUMNS": "160"})
    assert answer.exception is None or isinstance(answer.exception, SystemExit), answer.exception
    return answer.exit_code, answer.output


def outputs(folder: Path) -> list[list[dict]]:
    """What the cells of an executed notebook say, but for the folder that they name."""
    text = re.sub(r"id=..table\d+", "", (folder / "notebook.ipynb").read_text())  # a place in memory
    cells = json.loads(text)["cells"]
    said = [cell["outputs"] for cell in cells if cell["cell_type"] == "code"]
    return [[output for output in cell if output.get("name") != "stdout"] for cell in said]


@pytest.mark.slow
def test_a_night_gives_what_process_gives_and_names_what_fails(demo_truths, tmp_path):
    good = demo_truths[0].picture
    folder = tmp_path / "incoming"
    folder.mkdir()
    (folder / good.name).write_bytes(good.read_bytes())
    (folder / "corrupt.fit").write_bytes(good.read_bytes()[:100_000])
    options = ("--mission", "new_horizons", "--kernels", DEMO_KERNELS)
    status, said = run("nightly", folder, *options, "--out", tmp_path / "night", "--jobs", "2")
    assert status == 3
    assert "failed: corrupt: corrupt.fit: truncated" in said
    assert "1 ok, 0 partial, 1 failed" in said
    assert run("process", folder / good.name, *options, "--out", tmp_path / "process")[0] == 0
    assert run("nightly", folder / good.name, *options, "--out", tmp_path / "cold", "--cold")[0] == 0
    night, process, cold = (tmp_path / kind / good.stem for kind in ("night", "process", "cold"))
    for name in ("result.json", "observables.ecsv", "summary.png"):
        assert (night / name).read_bytes() == (process / name).read_bytes() == (cold / name).read_bytes()
    assert outputs(night) == outputs(cold)
    assert {"notebook.ipynb", "session.json"} <= {p.name for p in night.iterdir()}
    assert (tmp_path / "night" / "corrupt" / "notebook.html").is_file()
    summary = json.loads((tmp_path / "night" / "summary.json").read_text())
    rows = {row["name"]: row for row in summary["images"]}
    assert rows[good.stem]["pointing"]["n_stars"] == 4
    assert {body["name"] for body in rows[good.stem]["bodies"]} == {"PLUTO", "CHARON"}
    with Campaign(tmp_path / "night") as campaign:
        assert {entry.image: entry.status for entry in campaign.entries()} == {
            good.name: "ok",
            "corrupt.fit": "failed",
        }
    # The same command again has nothing to do, and nothing fails in it.
    status, said = run("nightly", folder, *options, "--out", tmp_path / "night")
    assert (status, "0 of 2 pictures to process (2 done before)" in said) == (0, True)


@pytest.mark.slow
@pytest.mark.realdata
def test_flight_frames_of_two_fields_in_one_night(data_dir, tmp_path):
    """What all six frames of these fields show is checked of `opnav process`, whose results a night's are."""
    frames = data_dir / "images" / "lorri_interstellar"
    catalog = f"npz:{data_dir / 'stars' / 'tycho2.npz'}"
    chosen = [str(frames / f"lor_{met}_0x633_pwcs2.fits") for met in ("0449855930", "0449933827")]
    night = {"images": chosen, "mission": "new_horizons", "catalog": catalog}
    (tmp_path / "night.yaml").write_text(json.dumps(night))  # JSON is YAML
    status, said = run("nightly", tmp_path / "night.yaml", "--out", tmp_path / "night", "--jobs", "2")
    assert status == 0, said
    summary = json.loads((tmp_path / "night" / "summary.json").read_text())
    proxima = [row for row in summary["images"] if "04498559" in row["name"]]
    wolf = [row for row in summary["images"] if "04499338" in row["name"]]
    assert [row["pointing"]["n_stars"] for row in proxima] == [9]
    assert all(row["pointing"]["rms_px"] < 0.1 for row in proxima)
    assert [row["status"] for row in wolf] == ["partial"]  # one star alone leaves the twist open
    queue = json.loads((tmp_path / "night" / "queue.json").read_text())
    assert {Path(item["image"]).stem for item in queue["images"]} == {row["name"] for row in wolf}

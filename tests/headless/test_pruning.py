"""A night's folder made smaller: what can be made again goes by age, and nothing that is anybody's."""

import fcntl
import json
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from opnav_workbench.cli import app
from opnav_workbench.headless.night_pages import forget_missing_files
from opnav_workbench.headless.night_summary import write_night_summary
from opnav_workbench.headless.pruning import Retention, prune, superfluous

sys.path.insert(0, str(Path(__file__).parent))
from stub_night import Analyst, StubPool, night, result_of, states

FILES = ("notebook.ipynb", "notebook.log", "summary.png")
KEPT = {"result.json", "session.json", "journal.jsonl", "night.json"}


def with_files(job, folder):
    for name in FILES:
        (folder / name).write_text(name)
    result_of(job, folder, "partial" if job.name == "doubtful" else "ok")


@pytest.fixture
def out(tmp_path):
    """A night of ten days ago: one picture as it was, one doubtful, one an analyst's, one open, one with a changed file."""
    images, out = tmp_path / "in", tmp_path / "out"
    images.mkdir()
    for name in ("plain", "doubtful", "decided", "opened", "edited"):
        (images / f"{name}.fit").write_text(name)
    write_night_summary(night(images, out, StubPool(with_files)))
    analyst = Analyst(out / "decided")
    analyst.decide("cosmic ray")
    analyst.leave()
    (out / "edited" / "notebook.ipynb").write_text("somebody's words")
    aside = out / ".attic" / "plain" / "20260101T000000Z-abc"
    aside.mkdir(parents=True)
    (aside / "notes.txt").write_text("of a person")
    old = time.time() - 10 * 86400
    for path in (*out.glob("*/night.json"), aside):
        os.utime(path, (old, old))
    return out


def left(out: Path) -> dict[str, set[str]]:
    return {
        folder.name: {p.name for p in folder.iterdir()} & set(FILES)
        for folder in out.iterdir()
        if folder.is_dir()
    }


def test_what_can_be_made_again_goes_and_nothing_else(out):
    visitor = Analyst(out / "opened")
    assert prune(out, Retention(notebooks=11.0, figures=11.0)) == ()
    told = superfluous(out, Retention(notebooks=9.0))
    assert {(item.path.parent.name, item.path.name) for item in told} == {
        ("plain", "notebook.ipynb"),
        ("plain", "notebook.log"),
        ("edited", "notebook.log"),
    }
    assert left(out)["plain"] == set(FILES)  # it was only told
    assert prune(out, Retention(notebooks=9.0)) == told
    visitor.leave()
    assert left(out)["plain"] == {"summary.png"}
    assert left(out)["edited"] == {"notebook.ipynb", "summary.png"}
    assert all(left(out)[name] == set(FILES) for name in ("doubtful", "decided", "opened"))
    assert {p.name for p in (out / "plain").iterdir()} >= KEPT
    assert (out / ".attic" / "plain").exists()
    assert len(prune(out, Retention(attic=9.0))) == 1
    assert not (out / ".attic" / "plain").exists()
    # What was made smaller is done all the same.
    assert states(out.parent / "in", out)["plain"] == "done"


def test_the_pages_link_to_nothing_that_has_gone(out):
    stale = json.loads((out / "summary.json").read_text())
    page = out / "summary.html"
    assert "plain/notebook.ipynb" in page.read_text()
    gone = prune(out, Retention(notebooks=9.0, figures=9.0))
    assert {"notebook", "figure"} == {item.kind for item in gone}
    for link in re.findall(r'(?:href|src)="([^"#:]+)"', page.read_text()):
        assert (out / link).exists(), link
    assert "edited/notebook.ipynb" in page.read_text()
    now = {
        row.pop("name"): row.pop("files") for row in json.loads((out / "summary.json").read_text())["images"]
    }
    assert now["plain"] == ["result.json"]
    assert "notebook.ipynb" in now["doubtful"]
    # One of another version is the next night's to write; a damaged one is no reason to stop.
    (out / "summary.json").write_text(json.dumps(stale | {"version": "0.0"}))
    assert not forget_missing_files(out)
    (out / "summary.json").write_text('{"images": [1]}')
    assert not forget_missing_files(out)


def test_command_tells_first(out):
    answer = CliRunner().invoke(app, ["campaign", "prune", str(out), "--notebooks", "9", "--attic", "9"])
    assert answer.exit_code == 0, answer.output
    assert "--delete does it" in answer.output
    assert "20260101T000000Z-abc" in answer.output.replace("\n", "")
    assert left(out)["plain"] == set(FILES)
    answer = CliRunner().invoke(app, ["campaign", "prune", str(out)])
    assert "nothing to prune" in str(answer.exception)


RECIPES = Path(__file__).parents[2] / ".docs" / "howto" / "operations.md"
BLOCK = re.compile(r"^```text\n# file: (\S+)\n(.*?)^```", re.DOTALL | re.MULTILINE)


def recipe(name: str) -> str:
    return dict(BLOCK.findall(RECIPES.read_text()))[name]


@pytest.mark.slow
def test_recipe_for_cron_runs(tmp_path):
    """With a stand-in for the program that notes how it is called; what it is asked to prune is asked of the real one."""
    script = tmp_path / "run_night.sh"
    script.write_text(recipe(script.name))
    programs = tmp_path / "bin"
    programs.mkdir()
    (programs / "opnav").write_text(
        '#!/bin/sh\necho "opnav $*" >> calls\n[ "$1" = nightly ] && exit "${NIGHT:-0}"\nexit 0\n'
    )
    (programs / "opnav").chmod(0o755)
    environment = os.environ | {"PATH": f"{programs}:{os.environ['PATH']}"}

    def run(**more):
        return subprocess.run(
            ["sh", str(script)], env=environment | more, capture_output=True, text=True, check=False
        )

    assert run().returncode == 0
    failed = run(NIGHT="3")
    assert (failed.returncode, "night/summary.html" in failed.stderr) == (3, True)
    calls = (tmp_path / "calls").read_text().splitlines()
    assert calls[0] == "opnav nightly night.yaml --out night"
    words = calls[1].split()[1:]
    (tmp_path / "night").mkdir()
    assert CliRunner().invoke(app, [*words[:2], str(tmp_path / "night"), *words[3:]]).exit_code == 0
    with (tmp_path / ".run_night.lock").open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        assert "a night is running" in run().stdout
    assert len((tmp_path / "calls").read_text().splitlines()) == 4


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not here")
def test_recipe_for_systemd_is_understood(tmp_path):
    for name in ("opnav-night.service", "opnav-night.timer"):
        (tmp_path / name).write_text(recipe(name))
    words = ["systemd-analyze", "verify", "--man=no", *map(str, sorted(tmp_path.iterdir()))]
    said = subprocess.run(words, capture_output=True, text=True, check=False).stderr
    assert not [line for line in said.splitlines() if "opnav-night" in line], said


@pytest.mark.slow
def test_recipe_for_slurm_ends_its_night_when_it_is_told(tmp_path):
    """Run by sh as Slurm's shell would run it, up to the signal before its time is over."""
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "opnav").write_text(
        '#!/bin/sh\ntrap "echo ended >> calls; exit 143" TERM\necho "$*" >> calls\nwhile :; do sleep 0.1; done\n'
    )
    (tmp_path / "bin" / "opnav").chmod(0o755)
    (tmp_path / "night.sbatch").write_text(recipe("night.sbatch"))
    slurm = {"SLURM_SUBMIT_DIR": str(tmp_path), "SLURM_CPUS_PER_TASK": "4"}
    environment = os.environ | slurm | {"PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}"}
    job = subprocess.Popen(["sh", str(tmp_path / "night.sbatch")], env=environment)
    calls, deadline = tmp_path / "calls", time.monotonic() + 30
    while not calls.exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    job.terminate()
    job.wait(30)
    assert calls.read_text().splitlines() == ["nightly night.yaml --out night --jobs 4", "ended"]

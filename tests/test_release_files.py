"""What stands in hidden folders for forges and packagers says the same as the package."""

import json
import re
import tomllib
from pathlib import Path

import pytest
import yaml

from opnav_workbench.cli.program import COMMANDS
from opnav_workbench.version import __version__

ROOT = Path(__file__).parents[1]
FORGE = ROOT / ".github"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
CONDA_NAMES = {"matplotlib": "matplotlib-base", "jupyterlab-server": "jupyterlab_server"}


def conda(requirement: str) -> str:
    name, operator, version = re.fullmatch(r"([\w-]+)([>=]=)(.+)", requirement).groups()
    return f"{CONDA_NAMES.get(name, name)} {operator}{version}"


def test_conda_recipe_needs_what_the_package_needs():
    recipe = yaml.safe_load((FORGE / "conda" / "recipe.yaml").read_text())
    needs = recipe["requirements"]
    assert set(needs["run"]) == {f"python {PROJECT['requires-python']}", *map(conda, PROJECT["dependencies"])}
    assert set(needs["run_constraints"]) == set(map(conda, PROJECT["optional-dependencies"]["lab"]))
    assert recipe["context"]["version"] == __version__
    (entry,) = recipe["build"]["python"]["entry_points"]
    name, target = entry.split(" = ")
    assert PROJECT["scripts"] == {name: target}
    assert all((ROOT / name).is_file() for name in recipe["about"]["license_file"])


def test_conda_recipe_renders():
    """By the tool that builds it: unknown keys, bad versions and licenses are errors there."""
    rattler = pytest.importorskip("rattler_build", reason="py-rattler-build renders the conda recipe")
    (variant,) = rattler.Stage0Recipe.from_file(FORGE / "conda" / "recipe.yaml").render()
    package = variant.recipe.package
    assert (package.name, str(package.version)) == ("opnav_workbench", __version__)


def test_citation():
    citation = yaml.safe_load((FORGE / "CITATION.cff").read_text())
    assert {"cff-version", "message", "title", "authors"} <= set(citation)
    assert (citation["version"], citation["license"]) == (__version__, PROJECT["license"])


@pytest.mark.parametrize("path", sorted((FORGE / "ISSUE_TEMPLATE").glob("*.yml")), ids=lambda p: p.stem)
def test_issue_forms(path):
    form = yaml.safe_load(path.read_text())
    if path.stem == "config":
        assert form == {"blank_issues_enabled": True}
        return
    assert {"name", "description", "body"} <= set(form)
    for part in form["body"]:
        assert part["type"] == "textarea"
        assert part["attributes"]["label"]
    assert len({part["id"] for part in form["body"]}) == len(form["body"])


@pytest.mark.parametrize(
    "name",
    [".github/CONTRIBUTING.md", ".github/RELEASE.md", ".github/container/Containerfile", ".binder/postBuild"],
)
def test_what_they_name_is_there(name):
    """Files, extras and commands."""
    text = (ROOT / name).read_text()
    files = re.findall(r"`((?:\.github|\.ci|\.docs|opnav_workbench)/[\w./-]+)`", text)
    assert [file for file in files if not (ROOT / file).exists()] == []
    extras = {extra for found in re.findall(r"\[([a-z,]+)\]\"", text) for extra in found.split(",")}
    assert extras <= set(PROJECT["optional-dependencies"])
    assert set(re.findall(r"\bopnav ([a-z]+)\b", text)) <= set(COMMANDS)


def test_binder_installs_a_part_that_is_there():
    assert (ROOT / ".binder" / "requirements.txt").read_text().strip() == ".[lab]"
    assert "lab" in PROJECT["optional-dependencies"]


@pytest.mark.parametrize("path", sorted((ROOT / "notebooks").rglob("*.ipynb")), ids=lambda p: p.stem)
def test_notebooks_tell_before_they_compute(path):
    """Narrative first; a cell longer than a screen's third is folded, but for the parameters."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    assert cells[0]["cell_type"] == "markdown"
    assert "".join(cells[0]["source"]).startswith("# ")
    for cell in cells:
        lines = "".join(cell["source"]).splitlines()
        if cell["cell_type"] == "code" and "parameters" not in cell["metadata"].get("tags", ()):
            assert len(lines) <= 25 or cell["metadata"].get("jupyter", {}).get("source_hidden"), lines[0]


def test_the_first_lesson_names_all():
    lessons = sorted((ROOT / "notebooks/teaching").glob("*.ipynb"))
    told = "".join(json.loads(lessons[0].read_text(encoding="utf-8"))["cells"][0]["source"])
    assert [lesson.name for lesson in lessons if f"({lesson.name})" not in told] == []
    assert f"\n{len(lessons)}. " in told

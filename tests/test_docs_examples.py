"""The documentation is true: its links lead somewhere, its examples run, and every public name has words."""

import inspect
import re
import shutil
import sys
from importlib import import_module
from pathlib import Path

import pytest
from typer.testing import CliRunner

from opnav_workbench.cli import app
from opnav_workbench.contracts import KINDS, schema_of
from opnav_workbench.parts import PARTS

ROOT = Path(__file__).parents[1]
DOCS = ROOT / ".docs"
PAGES = sorted(path for path in DOCS.rglob("*.md") if "generated" not in path.parts)
BLOCK = re.compile(r"^```(python|sh|yaml)\n(.*?)^```", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\(([^)#\s]*)(#[^)\s]*)?\)|^```\{figure\} (\S+)$", re.MULTILINE)
TREE = re.compile(r"```\{toctree\}\n(.*?)```", re.DOTALL)

sys.path.insert(0, str(DOCS))
import generate  # noqa: E402

GENERATED = {
    "glossary.md",
    "files.md",
    "accuracy.md",
    "changelog.md",
    "options.md",
    "exports.md",
    "api.rst",
    "map.rst",
}
GENERATED |= {f"file_{name}.md" for name in KINDS} | {
    f"api_{name}.rst" for name in generate.modules_with_names()
}


def leads_somewhere(page: Path, link: str) -> bool:
    if link.startswith("pictures/"):
        return (ROOT / ".assets" / link.removeprefix("pictures/")).is_file()
    goal = (page.parent / link).resolve()
    return goal.name in GENERATED if goal.parent == DOCS / "generated" else goal.is_file()


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_links_lead_somewhere(page):
    links = [
        one or picture for one, _, picture in LINK.findall(page.read_text(encoding="utf-8")) if one or picture
    ]
    outside = [link for link in links if "://" in link]
    assert not outside, "the site is for machines without a network"
    assert [link for link in links if not leads_somewhere(page, link)] == []


def test_every_page_is_in_a_table_of_contents():
    listed = {
        entry.strip()
        for page in PAGES
        for tree in TREE.findall(page.read_text(encoding="utf-8"))
        for entry in tree.splitlines()
        if entry.strip() and not entry.startswith(":")
    }
    pages = {str(page.relative_to(DOCS).with_suffix("")) for page in PAGES} - {"index"}
    assert pages <= listed
    ends = {f"{name}.md" for name in listed} | {f"{name}.rst" for name in listed}
    inside = {name for name in GENERATED if not name.startswith(("file_", "api_")) and name != "exports.md"}
    assert {f"generated/{name}" for name in inside} <= ends


@pytest.mark.slow
@pytest.mark.parametrize("page", [p for p in PAGES if BLOCK.search(p.read_text())], ids=lambda p: p.stem)
def test_examples_run(page, demo_truths, tmp_path, monkeypatch):
    """In the order of the page, in a folder that holds one picture."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(demo_truths[0].picture, tmp_path / "lorri_4x4.fit")
    (tmp_path / "incoming").mkdir()
    shutil.copy(demo_truths[0].picture, tmp_path / "incoming" / "lorri_4x4.fit")
    names: dict[str, object] = {}
    for language, text in BLOCK.findall(page.read_text(encoding="utf-8")):
        if language == "yaml":
            name = re.match(r"# file: (\S+)\n", text)
            assert name, "a YAML block begins with its file's name"
            (tmp_path / name[1]).write_text(text, encoding="utf-8")
        elif language == "python":
            exec(compile(text, str(page), "exec"), names)
        else:
            for line in text.splitlines():
                program, *arguments = line.split()
                assert program == "opnav"
                answer = CliRunner().invoke(app, arguments)
                assert answer.exit_code == 0, f"{line}\n{answer.output}\n{answer.exception!r}"


@pytest.mark.slow
def test_every_public_name_is_documented():
    silent = []
    for package in generate.modules_with_names():
        for module in generate.public_modules(package):
            loaded = import_module(module)
            if not loaded.__doc__:
                silent.append(module)
            for name in getattr(loaded, "__all__", ()):
                value = getattr(loaded, name)
                own = getattr(value, "__module__", "") == module
                if own and (inspect.isclass(value) or inspect.isroutine(value)) and not inspect.getdoc(value):
                    silent.append(f"{module}.{name}")
    assert silent == []


def test_generated_pages_hold_every_field_and_term():
    for kind in KINDS.values():
        page = generate.file_page(kind)
        missing = [name for name in schema_of(kind)["properties"] if f"| `{name}` |" not in page]
        assert not missing, (kind.name, missing)
    assert "twist\n: Position angle" in generate.glossary()
    assert "| `lab` |" in generate.options()
    assert "requirement" in generate.accuracy()
    assert "| `et` | s | mid-exposure" in generate.exports()
    surfaces = next(
        line for line in generate.file_page(KINDS["mission"]).splitlines() if "`target_surfaces`" in line
    )
    assert "How targets scatter light" in surfaces
    assert set(PARTS) == {"lab", "docs", "cluster", "online"}

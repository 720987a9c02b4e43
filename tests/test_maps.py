"""The maps are true: every package's docstring names each of its modules, and nothing that is not there."""

import ast
import functools
import re
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
ROOT = TESTS.parent
PACKAGE = ROOT / "opnav_workbench"
PACKAGES = sorted(path.parent for path in PACKAGE.rglob("__init__.py"))
TERM = re.compile(r"^``([\w.]+)``$", re.MULTILINE)
LONGEST_CHAIN = 24  # of modules, each importing the next; it was 23 when modules were a third as long

sys.path.insert(0, str(TESTS))
import house  # noqa: E402


def map_of(package: Path) -> str:
    return ast.get_docstring(ast.parse((package / "__init__.py").read_text(encoding="utf-8"))) or ""


def inside(package: Path) -> set[str]:
    modules = {path.stem for path in package.glob("*.py") if not path.stem.startswith("__")}
    return modules | {path.parent.name for path in package.glob("*/__init__.py")}


@pytest.mark.parametrize("package", PACKAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_map_names_every_module_and_no_other(package):
    assert set(TERM.findall(map_of(package))) == inside(package)


@pytest.mark.parametrize("package", PACKAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_map_says_in_words_what_each_module_is(package):
    lines = map_of(package).splitlines()
    for number, line in enumerate(lines):
        if TERM.match(line):
            assert len(lines[number + 1].split()) >= 2, line


def test_every_place_to_change_something_exists():
    """The walk of a new contributor: "how is a limb scan chosen?" leads to a module that stands."""
    text = map_of(PACKAGE)
    walk = text[text.index("Where to change what") : text.index("Glossary")]
    places = re.findall(r"``([a-z_]+(?:\.[a-z_]+)*)``", walk)
    assert len(places) >= 15
    for place in places:
        path = PACKAGE.joinpath(*place.split("."))
        assert path.with_suffix(".py").is_file() or (path / "__init__.py").is_file(), place


def test_glossary_stands_in_order():
    text = map_of(PACKAGE)
    terms = re.findall(r"^(\w.*)\n    \w", text[text.index("Glossary") :], re.MULTILINE)
    assert len(terms) >= 20
    assert terms == sorted(terms, key=str.lower)


def test_layers_name_every_package_once():
    """What import-linter holds, readable without it: the map lists packages in the order of the layers."""
    settings = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    layers = re.search(r"layers = \[(.*?)\]", settings, re.DOTALL)
    assert layers
    order = re.findall(r"\w+", re.sub(r"#.*", "", layers.group(1)))
    assert set(order) - {"__main__"} == inside(PACKAGE)


@functools.cache
def imports_of_the_package():
    found = house.modules(ROOT)
    return found, house.import_graph(found)


@pytest.mark.slow
def test_no_circle_of_imports_not_even_inside_functions():
    assert house.circles(imports_of_the_package()[1]) == []


def test_circles_are_found_where_they_are():
    graph = {"a": {"b"}, "b": {"c"}, "c": {"b", "d"}, "d": set()}
    assert house.circles(graph) == [["b", "c"]]
    assert house.longest_chain(graph) == ["a", "b", "c", "d"]


@pytest.mark.slow
def test_chain_of_imports_stays_short():
    found, graph = imports_of_the_package()
    assert len(house.longest_chain(house.between_modules(graph, found))) <= LONGEST_CHAIN

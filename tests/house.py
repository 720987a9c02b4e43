"""The structure of the package in figures: ``python tests/house.py [CHECKOUT] [--entered]``.

Counts modules, lines and imports, names circles of imports and the longest chain, without importing anything.
``--entered`` also takes one simulated picture from its file to its observables and counts the modules whose functions
were called (it needs the package installed, as the tests do). It reads any checkout, so that two can be compared.
"""

import argparse
import ast
import statistics
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import FrameType

PACKAGE = "opnav_workbench"
Graph = dict[str, set[str]]


@dataclass(frozen=True)
class Module:
    """One file: its dotted name, its tree and its length."""

    name: str
    path: Path
    tree: ast.Module
    n_lines: int

    @property
    def is_package(self) -> bool:
        return self.path.name == "__init__.py"


def modules(checkout: Path) -> dict[str, Module]:
    """Return all modules of the package by dotted name."""
    found = {}
    for path in sorted((checkout / PACKAGE).rglob("*.py")):
        parts = path.relative_to(checkout).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        text = path.read_text(encoding="utf-8")
        found[name] = Module(name, path, ast.parse(text), text.count("\n"))
    return found


def _typing_only(tree: ast.Module) -> set[ast.AST]:
    """Return the nodes below ``if TYPE_CHECKING``, which no run sees."""
    blocks = [n for n in ast.walk(tree) if isinstance(n, ast.If) and "TYPE_CHECKING" in ast.unparse(n.test)]
    return {node for block in blocks for child in block.body for node in ast.walk(child)}


def _imported(module: Module, names: dict[str, Module]) -> Iterator[str]:
    """Yield the package's modules that a module imports, also inside functions."""
    unseen = _typing_only(module.tree)
    for node in ast.walk(module.tree):
        if not isinstance(node, ast.ImportFrom) or node in unseen or node.level:
            continue
        for alias in node.names:
            full = f"{node.module}.{alias.name}"
            target = full if full in names else node.module
            if target in names and target != module.name:
                yield target


def import_graph(found: dict[str, Module]) -> Graph:
    """Return who imports whom; a package's `__init__` is a node of its own."""
    return {name: set(_imported(module, found)) for name, module in found.items()}


def circles(graph: Graph) -> list[list[str]]:
    """Return the sets of modules that import each other (Tarjan's strongly connected components)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in graph[node]:
            if other not in index:
                visit(other)
            if other in stack:
                low[node] = min(low[node], low[other])
        if low[node] == index[node]:
            place = stack.index(node)
            circle = stack[place:]
            del stack[place:]
            if len(circle) > 1:
                found.append(sorted(circle))

    for name in graph:
        if name not in index:
            visit(name)
    return found


def between_modules(graph: Graph, found: dict[str, Module]) -> Graph:
    """Return the graph without the packages' `__init__`, whose imports stand for those of the modules they name."""
    return {
        name: {o for o in others if not found[o].is_package}
        for name, others in graph.items()
        if not found[name].is_package
    }


def longest_chain(graph: Graph) -> list[str]:
    """Return the longest chain of modules of which each imports the next; a circle counts with all its modules."""
    group = {name: (name,) for name in graph} | {name: tuple(c) for c in circles(graph) for name in c}

    @cache
    def chain(members: tuple[str, ...]) -> tuple[str, ...]:
        others = {group[other] for name in members for other in graph[name]} - {members}
        return (*members, *max((chain(other) for other in others), key=len, default=()))

    return list(max((chain(members) for members in group.values()), key=len))


class _Entered:
    """Context that collects the package's modules whose functions are called in it."""

    def __enter__(self) -> set[str]:
        self.names: set[str] = set()
        sys.setprofile(self._called)
        return self.names

    def __exit__(self, *_: object) -> None:
        sys.setprofile(None)

    def _called(self, frame: FrameType, event: str, _: object) -> None:
        name = frame.f_globals.get("__name__", "")
        if event == "call" and name.startswith(PACKAGE + "."):
            self.names.add(name)


def entered() -> dict[str, int]:
    """Return how many modules run functions while one simulated picture becomes observables."""
    from opnav_workbench import ImageSession, KernelSet, load_mission
    from opnav_workbench.rehearsal import (
        DEMO_CATALOG,
        DEMO_KERNELS,
        DEMO_MISSION,
        DEMO_PICTURES,
        simulate_picture,
    )

    mission = load_mission(DEMO_MISSION)
    with tempfile.TemporaryDirectory() as folder, KernelSet(DEMO_KERNELS):
        picture = simulate_picture(DEMO_PICTURES[-1], mission, DEMO_CATALOG, Path(folder)).picture
        with _Entered() as whole:
            session = ImageSession.open(picture, mission=mission, catalog=DEMO_CATALOG)
            session.predict()
            session.find_stars()
            session.repoint()
            with _Entered() as body:
                session.find_body("PLUTO", method="limb_scan")
            sys.setprofile(None)
        with _Entered() as rest:
            session.observables()
    return {
        "modules entered by one picture": len(whole | body | rest),
        "modules entered by its limb scan": len(body),
    }


def report(checkout: Path) -> dict[str, int | float]:
    """Return the figures of a checkout."""
    found = modules(checkout)
    graph = import_graph(found)
    plain = between_modules(graph, found)
    users = {name: sum(name in others for others in plain.values()) for name in plain}
    return {
        "modules": len(plain),
        "packages": len(found) - len(plain),
        "lines": sum(module.n_lines for module in found.values()),
        "median lines of a module": statistics.median(found[name].n_lines for name in plain),
        "longest module": max(found[name].n_lines for name in plain),
        "imports between modules": sum(len(others) for others in graph.values()),
        "modules imported by exactly one other": sum(count == 1 for count in users.values()),
        "circles": len(circles(graph)),
        "longest chain of modules": len(longest_chain(plain)),
        "longest chain, packages' __init__ counted": len(longest_chain(graph)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("checkout", nargs="?", type=Path, default=Path(__file__).resolve().parents[1])
    parser.add_argument(
        "--entered", action="store_true", help="also process one picture and count what it enters"
    )
    options = parser.parse_args()
    for what, value in report(options.checkout).items():
        print(f"{what:44s} {value:g}")
    for circle in circles(import_graph(modules(options.checkout))):
        print("circle:", ", ".join(circle))
    for what, count in entered().items() if options.entered else ():
        print(f"{what:44s} {count:g}")


if __name__ == "__main__":
    main()

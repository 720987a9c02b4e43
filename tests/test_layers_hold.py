"""The package's layers hold: the import contracts of pyproject.toml, where import-linter is installed."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "opnav_workbench"
ONLY_IMPORTERS = {
    "spiceypy": "kernels",
    "papermill": "headless",
    "ipywidgets": "workbench",
    "bokeh": "workbench",
}


def _imports(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module.split(".")[0])
    return names


@pytest.mark.slow
@pytest.mark.parametrize(("library", "layer"), ONLY_IMPORTERS.items())
def test_library_stays_in_its_layer(library: str, layer: str) -> None:
    importers = {p.relative_to(PACKAGE).parts[0] for p in PACKAGE.rglob("*.py") if library in _imports(p)}
    assert importers <= {layer}


def test_spiceypy_is_used_at_all() -> None:
    """The check above would pass on an empty package."""
    assert any("spiceypy" in _imports(p) for p in (PACKAGE / "kernels").rglob("*.py"))

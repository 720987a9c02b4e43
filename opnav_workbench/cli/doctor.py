"""``opnav doctor``: what is installed, what is found, and what to do about what is missing."""

import os
import platform
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata

import typer
from rich.console import Console
from rich.table import Table

from opnav_workbench.catalog import catalog_status
from opnav_workbench.cli.terminal import EXIT_BAD_INPUT, shown
from opnav_workbench.errors import OpNavError
from opnav_workbench.kernels import known_names, toolkit_version
from opnav_workbench.mission import load_mission, mission_names
from opnav_workbench.parts import PARTS, install_command
from opnav_workbench.resources import cache_root, kernels_meta_dir
from opnav_workbench.version import __version__

__all__ = ["doctor"]

LIBRARIES = ("numpy", "scipy", "astropy", "spiceypy", "scikit-image", "matplotlib")
NOTEBOOK = ("jupyterlab", "ipywidgets", "bokeh", "papermill", "ipykernel", "nbconvert")
MIN_FREE_MB = 200  # the bundled catalog's cache takes 30 MB, a picture's results a few
STATE_MARKS = {"ok": "[green]ok[/]", "note": "[yellow]note[/]", "missing": "[bold red]missing[/]"}


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing looked at: ``ok``, ``note`` (works, could be better) or ``missing`` (something will fail)."""

    topic: str
    what: str
    state: str
    detail: str


def findings() -> Iterator[Finding]:
    """Look at everything the package needs."""
    yield Finding("package", "opnav_workbench", "ok", f"{__version__}, Python {platform.python_version()}")
    yield from _versions("library", LIBRARIES)
    yield Finding("library", "SPICE toolkit", "ok", toolkit_version())
    yield from _missions()
    yield from _kernels()
    yield from _catalogs()
    yield from _versions("notebook", NOTEBOOK, "lab")
    yield from _versions("optional", ("astroquery",), "online")
    yield from _versions("optional", ("distributed",), "cluster")
    yield _cache()


def _versions(topic: str, names: tuple[str, ...], extra: str = "") -> Iterator[Finding]:
    """Versions of libraries; one that belongs to a part which not everybody needs is no fault where it is missing."""
    for name in names:
        try:
            yield Finding(topic, name, "ok", metadata.version(name))
        except metadata.PackageNotFoundError:
            if extra:
                detail = f"not installed; for {PARTS[extra][0]}: {install_command(extra)}"
                yield Finding(topic, name, "note", detail)
            else:
                yield Finding(topic, name, "missing", f"run: python -m pip install {name}")


def _missions() -> Iterator[Finding]:
    for name in mission_names():
        try:
            cameras = ", ".join(load_mission(name).camera_names)
            yield Finding("mission", name, "ok", cameras)
        except OpNavError as error:
            yield Finding("mission", name, "missing", str(error))


def _kernels() -> Iterator[Finding]:
    names = known_names()
    if not names:
        yield Finding("kernels", str(kernels_meta_dir()), "missing", "no kernel sets; reinstall the package")
    for name in names:
        yield Finding("kernels", name, "ok", "made from its scenario at first use")
    yield Finding(
        "kernels", "flight kernels", "note", "give your own with --kernels, or: opnav kernels fetch MISSION"
    )


def _catalogs() -> Iterator[Finding]:
    status = catalog_status()
    for item in status:
        yield Finding("catalog", item.form, "ok" if item.available else "missing", item.detail)


def _cache() -> Finding:
    root = cache_root()
    existing = next(p for p in (root, *root.parents) if p.exists())
    free_mb = shutil.disk_usage(existing).free // 2**20
    if not os.access(existing, os.W_OK):
        return Finding(
            "cache", str(root), "note", "not writable: the catalog is built anew each time; set OPNAV_CACHE"
        )
    if free_mb < MIN_FREE_MB:
        return Finding(
            "cache", str(root), "note", f"only {free_mb} MB free; free some space or set OPNAV_CACHE"
        )
    return Finding("cache", str(root), "ok", f"{free_mb / 1024:.0f} GB free")


def doctor() -> None:
    """Show versions, missions, kernels, catalogs and notebook parts, and what to do about what is missing.

    [bold]Example[/]

      opnav doctor
    """
    console = Console()
    table = Table(box=None, header_style="bold", pad_edge=False)
    for name in ("", "what", "", "detail"):
        table.add_column(name, overflow="fold")
    rows = list(findings())
    last = ""
    for row in rows:
        table.add_row(
            "" if row.topic == last else row.topic,
            shown(row.what),
            STATE_MARKS[row.state],
            shown(row.detail),
        )
        last = row.topic
    console.print(table)
    missing = [row for row in rows if row.state == "missing"]
    if missing:
        console.print(f"[bold red]{len(missing)} missing:[/] {', '.join(shown(r.what) for r in missing)}")
        raise typer.Exit(EXIT_BAD_INPUT)
    console.print("[green]Everything needed is here.[/] Try: opnav demo", highlight=False)

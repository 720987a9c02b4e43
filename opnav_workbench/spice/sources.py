"""From what a person names (a scenario, a metakernel, files, a folder) to the kernel files, in order."""

import difflib
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import spiceypy

from opnav_workbench.errors import KernelError
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.spice import pool
from opnav_workbench.spice.cache import scenario_metakernel
from opnav_workbench.spice.files import KINDS, KernelFile, kernel_file, looks_like_kernel
from opnav_workbench.spice.guard import Request, spice_call
from opnav_workbench.spice.manifest import fetched_metakernel

__all__ = ["known_names", "listed_files", "resolve", "unknown_name"]

LONGEST_PATH_BYTES = 255  # CSPICE: N0067, FURNSH
NAME_SUFFIXES = (".tm", ".yaml")  # a metakernel wins over a scenario of the same name
SCENARIO_KEY = "trajectories:"  # required in scenarios, unknown elsewhere
CONTINUED = "+"  # ends a pool string whose rest follows in the next one
META_VARIABLES = ("KERNELS_TO_LOAD", "PATH_VALUES", "PATH_SYMBOLS")

Source = str | os.PathLike[str]


@dataclass(frozen=True, slots=True)
class _Missing:
    path: Path
    listed_in: Path | None

    def __str__(self) -> str:
        return f"{self.path} (listed in {self.listed_in.name})" if self.listed_in else str(self.path)


def resolve(sources: Sequence[Source]) -> tuple[KernelFile, ...]:
    """Return the kernel files that the sources stand for, metakernels followed by what they list.

    Raises
    ------
    KernelError
        A name is unknown; files are missing (all are named); a file is no whole kernel; a path is too long.
    """
    if not sources:
        raise KernelError(
            "no kernel given; give a name from kernels_meta, a metakernel, kernel files or a folder."
        )
    found = [entry for source in sources for entry in _entries(source)]
    missing = [e for e in found if isinstance(e, _Missing)]
    if missing:
        count = "1 kernel is" if len(missing) == 1 else f"{len(missing)} kernels are"
        raise KernelError(
            f"{count} missing: {', '.join(str(m) for m in missing)}; correct the paths or fetch the files. "
            "Nothing was loaded."
        )
    return tuple(e for e in found if isinstance(e, KernelFile))


def known_names() -> tuple[str, ...]:
    """Return the names "mission/name" that kernels_meta offers."""
    folder = kernels_meta_dir()
    files = [*folder.glob("*/*.tm"), *(p for p in folder.glob("*/*.yaml") if _is_scenario(p))]
    return tuple(sorted({p.relative_to(folder).with_suffix("").as_posix() for p in files}))


def _is_scenario(path: Path) -> bool:
    """Tell a scenario from the mission and star files that stand beside it."""
    return any(line.startswith(SCENARIO_KEY) for line in path.read_text(encoding="utf-8").splitlines())


def _entries(source: Source) -> Iterator[KernelFile | _Missing]:
    if isinstance(source, str) and source in known_names():
        yield from _expand(_named(source), named=True)
        return
    path = Path(os.path.expanduser(source)).absolute()  # noqa: PTH111 (Path's own raises for a user it cannot find)
    _require_short(path, None)
    if path.is_dir():
        yield from _folder(path)
    elif isinstance(source, str) and not path.exists() and not path.suffix:
        fetched = fetched_metakernel(source)
        if fetched is None:
            raise KernelError(unknown_name(source))
        yield from _expand(fetched, named=True)
    else:
        yield from _expand(path)


def _named(name: str) -> Path:
    metakernel, scenario = (kernels_meta_dir() / f"{name}{suffix}" for suffix in NAME_SUFFIXES)
    return metakernel if metakernel.is_file() else scenario_metakernel(name, scenario)


def unknown_name(name: str) -> str:
    """Return the message for what is neither a kernel set's name nor a file: the nearest names, and all."""
    names = known_names()
    close = difflib.get_close_matches(name, names, n=3)
    meant = f"did you mean {' or '.join(close)}? " if close else ""
    offered = ", ".join(names) if names else "none"
    return f"no kernels named {name!r}, and no such file: {meant}names are: {offered}; or give a path."


def _folder(folder: Path) -> Iterator[KernelFile | _Missing]:
    """Return all kernels of a folder in loading order, but no metakernels: their files stand there, too."""
    files = [p for p in sorted(folder.iterdir()) if p.is_file() and looks_like_kernel(p)]
    for path in files:
        _require_short(path, None)
    entries = [e for e in map(kernel_file, files) if e.kind != "META"]
    if not entries:
        inner = ", ".join(sorted(p.name for p in folder.iterdir() if p.is_dir())) or "none"
        raise KernelError(
            f"no kernels in the folder {folder}; folders within: {inner}. Give one that holds kernels."
        )
    yield from sorted(entries, key=lambda e: (KINDS.index(e.kind), e.path.name))


def _expand(
    path: Path, above: tuple[Path, ...] = (), *, named: bool = False
) -> Iterator[KernelFile | _Missing]:
    listed_in = above[-1] if above else None
    if path in above:
        raise KernelError(f"{path} lists itself through {above[-1]}; remove it from KERNELS_TO_LOAD.")
    _require_short(path, listed_in)
    if not path.is_file():
        yield _Missing(path, listed_in)
        return
    entry = kernel_file(path)
    yield entry
    if entry.kind == "META":
        for inner in listed_files(path, here_first=not named):
            yield from _expand(inner, (*above, path), named=named)


def _require_short(path: Path, listed_in: Path | None) -> None:
    length = len(os.fsencode(path))
    if length > LONGEST_PATH_BYTES:
        within = f" (listed in {listed_in})" if listed_in else ""
        raise KernelError(
            f"the path {path}{within} has {length} bytes, SPICE takes {LONGEST_PATH_BYTES}; move the kernels "
            "or give them a shorter path by a symbolic link."
        )


def listed_files(metakernel: Path, *, here_first: bool) -> list[Path]:
    """Return the files that a metakernel lists, as absolute paths; SPICE itself parses the text.

    Relative paths count from the working folder, as in SPICE, or else from the metakernel's own. The other
    way round for the package's own metakernels: a file of the same name in the working folder must not slip
    in.
    """
    request = Request(f"reading the metakernel {metakernel}")
    with spice_call(request, needs_kernels=False), pool.isolated():
        spiceypy.ldpool(str(metakernel))
        names, values, symbols = (_texts(pool.pool_value(v)) for v in META_VARIABLES)
    if len(values) != len(symbols):
        raise KernelError(
            f"{metakernel} gives {len(values)} PATH_VALUES for {len(symbols)} PATH_SYMBOLS; make them pairs."
        )
    paths = dict(zip(symbols, values, strict=True))
    folders = (Path.cwd(), metakernel.parent)[:: 1 if here_first else -1]
    return [_located(_substituted(name, paths, metakernel), folders) for name in names]


def _texts(value: pool.PoolValue | None) -> list[str]:
    """Join pool strings that continue in the next one."""
    joined: list[str] = []
    going_on = False
    for part in (str(v) for v in value or ()):
        text = part.rstrip()
        if going_on:
            joined[-1] += text.removesuffix(CONTINUED)
        else:
            joined.append(text.removesuffix(CONTINUED))
        going_on = text.endswith(CONTINUED)
    return joined


def _substituted(name: str, paths: dict[str, str], metakernel: Path) -> str:
    def value(match: re.Match[str]) -> str:
        rest = match[1]
        symbol = max((s for s in paths if rest.startswith(s)), key=len, default=None)
        if symbol is None:
            raise KernelError(
                f"{metakernel} uses the symbol ${rest}; add it to PATH_SYMBOLS and PATH_VALUES."
            )
        return paths[symbol] + rest[len(symbol) :]

    return re.sub(r"\$(\w+)", value, name)


def _located(name: str, folders: tuple[Path, ...]) -> Path:
    candidates = [Path(os.path.normpath(folder / name)) for folder in folders]
    return next((c for c in candidates if c.exists()), candidates[-1])

"""Kernels built from scenario files: made once per scenario and package version, kept in the user's cache."""

import contextlib
import hashlib
import re
import shutil
import tempfile
import time
from pathlib import Path

from opnav_workbench.errors import KernelError
from opnav_workbench.resources import CACHE_VARIABLE, cache_root
from opnav_workbench.version import __version__

__all__ = ["scenario_folder", "scenario_metakernel"]

BUILDING = ".building-"
STALE_BUILD_S = 86_400.0  # a build takes seconds to minutes; what is a day old was killed
HASH_DIGITS = 12
NAMED_FILE = re.compile(rb"\bfile:\s*['\"]?([^\s'\",}]+)")  # tables and shapes that a scenario names


def scenario_metakernel(name: str, scenario: Path) -> Path:
    """Return the metakernel of a scenario, building its kernels the first time.

    Built in a folder beside the final one and renamed, so a killed build leaves nothing half-made and of two
    processes that build at once one wins.

    Parameters
    ----------
    name : str
        "mission/name"; begins the folder's name.
    scenario : Path
        YAML file that `make_kernels` understands.

    Raises
    ------
    KernelError
        The scenario is wrong, or the cache folder cannot be written.
    """
    folder = scenario_folder(name, scenario)
    try:
        if not folder.is_dir():
            _build(scenario, folder)
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


def _build(scenario: Path, folder: Path) -> None:
    # Imported here because the builder itself opens kernel sets.
    from opnav_workbench.spice.make import make_kernels  # noqa: PLC0415

    folder.parent.mkdir(parents=True, exist_ok=True)
    _remove_stale(folder.parent)
    temporary = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f"{BUILDING}{folder.name}-"))
    try:
        make_kernels(scenario, temporary)
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

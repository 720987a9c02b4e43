"""The kernel sets that come with the package: what they are, when they are valid, and whether they are built."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.spice.cache import scenario_folder
from opnav_workbench.spice.sources import known_names

__all__ = ["KernelSetInfo", "kernel_sets"]

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
    return tuple(_info(name) for name in known_names())


def _info(name: str) -> KernelSetInfo:
    path = kernels_meta_dir() / f"{name}.yaml"
    if not path.is_file() or path.with_suffix(".tm").is_file():
        return KernelSetInfo(name, "", "", "", built=True)
    head = _head(path)
    span = head.get("span") or {}
    description = " ".join(str(head.get("description") or "").split())
    return KernelSetInfo(
        name,
        description,
        _utc(span.get("start")),
        _utc(span.get("end")),
        scenario_folder(name, path).is_dir(),
    )


def _head(path: Path) -> dict[str, Any]:
    """Read a scenario's first words only: its tables of states are long."""
    text = path.read_text(encoding="utf-8")
    blocks = (re.search(rf"^{key}:.*\n(?:[ \t]+.*\n|\n)*", text, re.MULTILINE) for key in HEAD_KEYS)
    return dict(yaml.safe_load("".join(b[0] for b in blocks if b)) or {})


def _utc(value: Any) -> str:
    return "" if value is None else str(value).replace("T", " ").partition("+")[0]

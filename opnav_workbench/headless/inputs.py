"""What a picture's result depends on besides the picture: by content, wherever the files are and whatever they are called.

Kernels count for a picture by what they hold of its time (`opnav_workbench.kernels.kernel_parts`), so that a new one
reprocesses the pictures that it touches and no others.  The same values say in words what has changed.

A file that is written to while a night runs may have been read before, after or between: what came of it then is known to
be of no content, whatever the file holds in the end.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from opnav_workbench.catalog import catalog_contents, catalog_files
from opnav_workbench.errors import OpNavError
from opnav_workbench.files import json_text, plain_values, sha256_of
from opnav_workbench.headless.night_spec import NightSpec
from opnav_workbench.image import KeywordMap, read_image
from opnav_workbench.kernels import KernelPart, KernelSet, et_from_sclk, et_from_utc, kernel_parts
from opnav_workbench.mission import Mission
from opnav_workbench.version import __version__
from opnav_workbench.yaml_nodes import YamlError, compose, plain_value, yaml_text

__all__ = [
    "NightInputs",
    "changes",
    "file_stamp",
    "fingerprint",
    "named_file",
    "night_inputs",
    "picture_et",
    "with_named_files",
]

# Parameters that name files, which count by their contents.
FILES = ("decisions", "target_stars")
LONGEST_NAME = 256  # characters, of a file
SHOWN_DIGITS = 12


@dataclass(frozen=True, slots=True)
class NightInputs:
    """What the pictures of a night are processed with.

    Attributes
    ----------
    common
        For all of them: what, and its value or digest.
    kernels
        In loading order.
    stamps
        Of all files that were read for these.
    """

    common: Mapping[str, str]
    kernels: tuple[KernelPart, ...] = ()
    stamps: Mapping[Path, tuple[int, ...]] = field(default_factory=dict)

    def of(self, et: float | None) -> dict[str, str]:
        """Return what counts for a picture of this time (None: unknown), kernels by the names of their files."""
        return dict(self.common) | _by_file([part for part in self.kernels if part.matters_at(et)])

    def fingerprint(
        self, image_sha256: str, et: float | None, beside: Mapping[str, str] = MappingProxyType({})
    ) -> str:
        """Return the digest of a picture, of what lies `beside` it and of all that counts; names of kernels do not."""
        parts = [part.sha256 for part in self.kernels if part.matters_at(et)]
        values = {"image": image_sha256, "common": dict(self.common), "kernels": parts}
        return fingerprint(values | ({"beside": dict(beside)} if beside else {}))

    def touched(self) -> tuple[str, ...]:
        """Return the names of files that have been written to, replaced or removed since they were read."""
        return tuple(path.name for path, stamp in self.stamps.items() if file_stamp(path) != stamp)


def file_stamp(path: Path) -> tuple[int, ...]:
    """Return size and times of change (ns), which stay as long as nobody touches a file; empty where there is none."""
    try:
        status = path.stat()
    except OSError:
        return ()
    return status.st_size, status.st_mtime_ns, status.st_ctime_ns


def _by_file(parts: list[KernelPart]) -> dict[str, str]:
    held: dict[str, list[str]] = {}
    for part in parts:
        held.setdefault(f"kernel {part.name}", []).append(part.sha256)
    return {name: fingerprint({"parts": sums}) for name, sums in held.items()}


def fingerprint(values: Mapping[str, Any]) -> str:
    """Return the SHA-256 of plain values."""
    return hashlib.sha256(json_text(values).encode()).hexdigest()


def changes(before: Mapping[str, str], now: Mapping[str, str]) -> tuple[str, ...]:
    """Return in words what differs.

    Examples
    --------
    >>> changes({"version": "0.2", "kernel a.bsp": "1f"}, {"version": "0.3", "kernel b.bsp": "2e"})
    ('version: 0.2, now 0.3', 'kernel a.bsp: no longer there', 'kernel b.bsp: new')
    """
    if not before:
        return ("processed by a version that did not record what with",)
    said = []
    for name in dict.fromkeys((*before, *now)):
        if name not in now:
            said.append(f"{name}: no longer there")
        elif name not in before:
            said.append(f"{name}: new")
        elif before[name] != now[name]:
            said.append(f"{name}: {_shown(before[name])}, now {_shown(now[name])}")
    return tuple(said) or ("the order of the kernels",)


def _shown(value: str) -> str:
    is_digest = len(value) == hashlib.sha256().digest_size * 2 and value.isalnum()
    return f"content {value[:SHOWN_DIGITS]}" if is_digest else value or "nothing"


# ---- Collected for a night.


def night_inputs(
    spec: NightSpec, mission: Mission, parameters: Mapping[str, Any], notebook: str
) -> NightInputs:
    """Collect what the pictures of a night are processed with; its kernels must be open.

    Parameters
    ----------
    parameters
        Of the notebook, but the picture.
    notebook
        Its digest.

    Raises
    ------
    OpNavError
        A file cannot be read.
    """
    opened = KernelSet.active()
    given = {name: Path(value) for name in FILES if (value := getattr(spec, name)) is not None}
    files = given | {f"shape {body}": file.path for body, file in spec.shape_files.items()}
    files |= {f"maplets {body}": Path(file) for body, file in spec.landmarks.items()}
    missions = tuple(dict.fromkeys(with_named_files(mission.path)))
    kernels = () if opened is None else tuple(file.path for file in opened.kernels())
    read = (*files.values(), *missions, *catalog_files(spec.catalog), *kernels)
    stamps = {path: file_stamp(path) for path in read}  # before they are read
    named = {*given, "kernels", "catalog", "mission", "image"}
    common = {"version": __version__, "notebook": notebook}
    common |= {
        n: json.dumps(plain_values(v), sort_keys=True) for n, v in parameters.items() if n not in named
    }
    common |= {name: sha256_of(path) for name, path in files.items()}
    stars = catalog_contents(spec.catalog)
    common["catalog"] = ", ".join(name for name, _ in stars)  # in order: the first names the stars
    common |= {f"catalog {name}": value for name, value in stars}
    common |= {f"mission {path.name}": sha256_of(path) for path in missions}
    return NightInputs(common, () if opened is None else kernel_parts(opened), stamps)


def with_named_files(path: Path) -> Iterator[Path]:
    """Yield a YAML file and all files that it names beside itself, and so on."""
    yield path
    if path.suffix not in (".yaml", ".yml"):
        return
    try:
        content = plain_value(compose(yaml_text(path)))
    except (OSError, YamlError, UnicodeDecodeError):  # what needs it says what is wrong with it
        return
    for text in _texts(content):
        named = named_file(path.parent, text)
        if named is not None and named != path:
            yield from with_named_files(named)


def named_file(folder: Path, text: str) -> Path | None:
    """Return the file that a YAML file's text names, relative to its folder; None where it is no file's name."""
    if len(text) >= LONGEST_NAME or "\n" in text:
        return None
    named = folder / text
    return named if named.is_file() else None


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping | list):
        for item in value.values() if isinstance(value, Mapping) else value:
            yield from _texts(item)


def picture_et(image: Path, mission: Mission) -> float | None:
    """Return a picture's time, TDB s past J2000, as its session will have it; None where it cannot be told."""
    try:
        picture = read_image(image, KeywordMap(**mission.keywords))
        if picture.et is None and KernelSet.active() is not None:
            if picture.utc is not None:
                return et_from_utc(picture.utc)
            return et_from_sclk(mission.clock_id, picture.sclk) if picture.sclk is not None else None
    except OpNavError:  # processing will say what is wrong
        return None
    return picture.et

"""Manifests: which flight kernels a mission needs, where the archive keeps them, and the metakernel that loads them.

A manifest is YAML beside the mission file, ``kernels_meta/<mission>/manifest.yaml``, or any file of that form.
"""

import difflib
import re
from os import PathLike
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from opnav_workbench.errors import DownloadError, KernelError, MissionError
from opnav_workbench.paths import is_file
from opnav_workbench.resources import cache_root, kernels_meta_dir
from opnav_workbench.yaml_file import StrictModel, read_model

__all__ = [
    "KERNEL_KINDS",
    "KernelKind",
    "Manifest",
    "ManifestKernel",
    "fetched_metakernel",
    "filled_template",
    "kernels_folder",
    "load_manifest",
    "manifest_missions",
    "match_kinds",
]

FILE_NAME = "manifest.yaml"
FLIGHT = "flight"  # "mission/flight" names the kernels that were fetched

KernelKind = Literal["LSK", "SCLK", "PCK", "FK", "IK", "target SPK", "spacecraft SPK", "CK"]
KERNEL_KINDS: tuple[KernelKind, ...] = (
    "LSK", "SCLK", "PCK", "FK", "IK", "target SPK", "spacecraft SPK", "CK",
)  # fmt: skip
"""The eight kinds of kernel that optical navigation needs (AAS 13-443, "SPICE"), in loading order."""

MAX_NAME_CHARS = 60  # of a file within its folder: leaves room for $KERNELS/ in a pool string of 80
COMMENT_MARK = "#"  # begins what a template says to its reader only


def _file_name(name: str) -> str:
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts or not re.fullmatch(r"[\w.+/-]+", name):
        raise ValueError(
            f"{name!r} must be a plain name inside the kernels' folder, such as lsk/naif0012.tls"
        )
    return name


def _web_address(url: str) -> str:
    try:
        from opnav_workbench.downloads import require_web_address  # noqa: PLC0415 (few read a manifest)

        require_web_address(url)
    except DownloadError as error:
        raise ValueError(str(error)) from error
    return url


class ManifestKernel(StrictModel):
    """One kernel of a manifest.

    Attributes
    ----------
    kind : str
        One of `KERNEL_KINDS`.
    file
        Its name within the folder of fetched kernels, with ``/``.
    url
        Where the archive keeps it.
    size
        Bytes; None: not known.
    sha256
        Hexadecimal; None: not known, and the first download is trusted.
    """

    kind: KernelKind
    file: Annotated[str, Field(max_length=MAX_NAME_CHARS), AfterValidator(_file_name)]
    url: Annotated[str, AfterValidator(_web_address)]
    size: Annotated[int, Field(gt=0)] | None
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] | None
    purpose: str


def _each_file_once(kernels: tuple[ManifestKernel, ...]) -> tuple[ManifestKernel, ...]:
    names = [kernel.file for kernel in kernels]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"{', '.join(twice)} listed twice")
    return kernels


class Manifest(StrictModel):
    """A mission's flight kernels, in loading order within a kind, and the metakernel that loads them."""

    mission: Annotated[str, Field(pattern=r"^[\w-]+$")]
    description: str
    metakernel: Annotated[str, AfterValidator(_file_name), Field(pattern=r"^[^/]+\.tm$")]
    template: Annotated[str, AfterValidator(_file_name)]  # beside the manifest
    kernels: Annotated[tuple[ManifestKernel, ...], Field(min_length=1), AfterValidator(_each_file_once)]

    def of_kinds(self, kinds: tuple[KernelKind, ...]) -> tuple[ManifestKernel, ...]:
        """Return the kernels of some kinds; all, if none is named.

        Raises
        ------
        KernelError
            The manifest lists none of them.
        """
        chosen = tuple(k for k in self.kernels if not kinds or k.kind in kinds)
        if not chosen:
            listed = ", ".join(k for k in KERNEL_KINDS if any(kernel.kind == k for kernel in self.kernels))
            raise KernelError(
                f"the manifest of {self.mission} lists no {' and no '.join(kinds)}; it lists {listed}."
            )
        return chosen


def manifest_missions() -> tuple[str, ...]:
    """Return the missions whose flight kernels can be fetched, sorted.

    Examples
    --------
    >>> {"generic", "new_horizons", "osiris_rex"} <= set(manifest_missions())
    True
    """
    return tuple(sorted(path.parent.name for path in kernels_meta_dir().glob(f"*/{FILE_NAME}")))


def load_manifest(name_or_path: str | PathLike[str]) -> tuple[Manifest, Path]:
    """Read a manifest by its mission's name, or from a file; return it and where it stands.

    Raises
    ------
    MissionError
        The mission is unknown (the message lists the known and the nearest), or the file breaks the schema.

    Examples
    --------
    >>> manifest, path = load_manifest("generic")
    >>> [kernel.file for kernel in manifest.kernels][:2]
    ['lsk/naif0012.tls', 'pck/pck00011.tpc']
    """
    known = manifest_missions()
    path = kernels_meta_dir() / str(name_or_path) / FILE_NAME if name_or_path in known else Path(name_or_path)
    if not is_file(path):
        close = difflib.get_close_matches(str(name_or_path).lower().replace("-", "_"), known, n=1, cutoff=0.5)
        hint = f" Did you mean {close[0]}?" if close else ""
        raise MissionError(
            f"no flight kernels are listed for {str(name_or_path)!r}: no such manifest file, and the missions are "
            f"{', '.join(known)}.{hint}"
        )
    return read_model(path, Manifest, "manifest", MissionError), path


def match_kinds(word: str) -> tuple[KernelKind, ...]:
    """Return the kinds that a word stands for: its own, or both kinds of SPK.

    Raises
    ------
    KernelError
        There is no such kind.

    Examples
    --------
    >>> match_kinds("spk"), match_kinds("Ck")
    (('target SPK', 'spacecraft SPK'), ('CK',))
    """
    plain = word.strip().lower().replace("-", " ").replace("_", " ")
    found = tuple(k for k in KERNEL_KINDS if plain in (k.lower(), k.lower().rpartition(" ")[2]))
    if not found:
        raise KernelError(f"{word!r} is no kind of kernel; choose one of {', '.join(KERNEL_KINDS)}, SPK.")
    return found


def kernels_folder(mission: str) -> Path:
    """Return where `fetch_kernels` puts a mission's kernels unless told otherwise."""
    return cache_root() / FLIGHT / mission


def fetched_metakernel(name: str) -> Path | None:
    """Return the metakernel that "mission/flight" stands for, or None if the name is of another form.

    Raises
    ------
    KernelError
        The kernels have not been fetched yet.
    """
    mission, slash, rest = name.partition("/")
    if not slash or rest != FLIGHT or mission not in manifest_missions():
        return None
    manifest, _ = load_manifest(mission)
    path = kernels_folder(mission) / manifest.metakernel
    if not is_file(path):
        raise KernelError(
            f"the flight kernels of {mission} are not on this machine; run: opnav kernels fetch {mission}"
        )
    return path


def filled_template(template: str, kernels: tuple[ManifestKernel, ...]) -> str:
    r"""Return a metakernel: the template's text with the files of each kind in their places.

    A kind without files leaves its place empty; lines that begin with # are for the template's reader only.

    Raises
    ------
    KernelError
        The template has no place for a kind.

    Examples
    --------
    >>> kernel = load_manifest("generic")[0].kernels[0]
    >>> print(filled_template("# for you\n{LSK}\n{CK}", (kernel,)))
    KERNELS_TO_LOAD += ( '$KERNELS/lsk/naif0012.tls' )
    <BLANKLINE>
    """
    text = "\n".join(line for line in template.splitlines() if not line.startswith(COMMENT_MARK))
    for kind in KERNEL_KINDS:
        files = [k.file for k in kernels if k.kind == kind]
        place = f"{{{kind}}}"
        if files and place not in text.splitlines():
            raise KernelError(f"the metakernel template has no line {place}; add it.")
        text = text.replace(place, "\n".join(f"KERNELS_TO_LOAD += ( '$KERNELS/{f}' )" for f in files))
    return text

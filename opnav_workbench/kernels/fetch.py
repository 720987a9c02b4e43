"""Flight kernels from the archive: fetched, verified, and held to their digests ever after.

Beside the kernels stands ``manifest.lock.json`` with the digest of every file that was fetched. Where the
manifest knows no digest, the first download is trusted and its digest written down there; from then on it counts.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

from opnav_workbench.downloads import Progress, download
from opnav_workbench.errors import KernelError, SessionError
from opnav_workbench.files import inside, json_value, make_folder, sha256_of, text_of, write_json, write_text
from opnav_workbench.kernels.files import kernel_file
from opnav_workbench.kernels.manifest import (
    KernelKind,
    Manifest,
    ManifestKernel,
    filled_template,
    kernels_folder,
    load_manifest,
)

__all__ = ["FetchedKernel", "FetchedKernels", "fetch_kernels"]

LOCK_NAME = "manifest.lock.json"


@dataclass(frozen=True, slots=True)
class FetchedKernel:
    """What became of one kernel of a manifest."""

    kernel: ManifestKernel
    path: Path
    size: int
    sha256: str
    already_present: bool  # verified, not fetched again
    trusted: bool  # neither manifest nor lock file knew its digest: now the lock file does


@dataclass(frozen=True, slots=True)
class FetchedKernels:
    """A mission's kernels, whole and verified."""

    manifest: Manifest
    folder: Path
    metakernel: Path  # loads all kernels of the manifest that are in the folder
    kernels: tuple[FetchedKernel, ...]


def fetch_kernels(
    name_or_path: str | PathLike[str],
    folder: Path | None = None,
    *,
    kinds: tuple[KernelKind, ...] = (),
    progress: Callable[[ManifestKernel], Progress] | None = None,
    **settings: Any,
) -> FetchedKernels:
    """Fetch a mission's flight kernels, or what is missing of them, and write the metakernel that loads them.

    Parameters
    ----------
    name_or_path : str or path
        A mission of `manifest_missions`, or a manifest file.
    folder
        Where they go; by default the user's cache, where "mission/flight" names them.
    kinds : tuple of str
        Only these of `KERNEL_KINDS`.
    progress
        Called with a kernel when its download begins; what it returns is told the bytes.
    **settings
        For `opnav_workbench.downloads.download`, such as ``timeout_s`` and ``retries``.

    Raises
    ------
    MissionError
        The mission is unknown, or the manifest breaks its schema.
    DownloadError
        A kernel cannot be fetched. Those fetched before it stay, and the next call goes on from there.
    KernelError
        What was fetched is no kernel of its kind, a file has changed on this machine, or the folder cannot be
        written.
    """
    manifest, path = load_manifest(name_or_path)
    chosen = manifest.of_kinds(kinds)
    target = folder or kernels_folder(manifest.mission)
    try:
        make_folder(target)
        lock = _DigestFile(target / LOCK_NAME)
        done = []
        for kernel in chosen:
            told = partial(progress, kernel) if progress else None
            done.append(
                _fetch_one(kernel, inside(target, kernel.file), lock.digest(kernel.file), told, settings)
            )
            lock.add(done[-1])  # at once: a later failure must not forget it
        metakernel = _write_metakernel(manifest, path, target)
    except (SessionError, OSError) as error:
        raise KernelError(str(error)) from error
    return FetchedKernels(manifest, target, metakernel, tuple(done))


def _fetch_one(
    kernel: ManifestKernel,
    file: Path,
    locked: str | None,
    progress: Callable[[], Progress] | None,
    settings: Mapping[str, Any],
) -> FetchedKernel:
    expected = kernel.sha256 or locked
    already_present = file.is_file()
    if not already_present:
        watch = progress() if progress else None
        check = partial(_require_kernel, kernel)
        download(kernel.url, file, size=kernel.size, sha256=expected, progress=watch, check=check, **settings)
    found = expected if expected and not already_present else sha256_of(file)
    if expected is not None and found != expected:
        raise KernelError(
            f"{file} is not the kernel that it should be: its SHA-256 is {found}, expected is {expected}; "
            "delete it and fetch again."
        )
    return FetchedKernel(kernel, file, file.stat().st_size, found, already_present, trusted=expected is None)


class _DigestFile:
    """The digests of what was fetched, by file name."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.entries: dict[str, dict[str, Any]] = {}
        if path.is_file():
            try:
                self.entries = dict(json_value(text_of(path))["kernels"])
            except (ValueError, KeyError, TypeError) as error:
                raise KernelError(
                    f"{path} is damaged ({error}); delete it, and the kernels beside it count as new."
                ) from error

    def digest(self, name: str) -> str | None:
        """Return the digest of a file's first download."""
        found = self.entries.get(name, {}).get("sha256")
        return str(found) if found else None

    def add(self, done: FetchedKernel) -> None:
        """Write down a file."""
        entry = {"url": done.kernel.url, "size": done.size, "sha256": done.sha256}
        if self.entries.get(done.kernel.file) != entry:
            self.entries[done.kernel.file] = entry
            note = "Digests of fetched kernels. Where the archive publishes none, that of the first download counts."
            write_json(self.path, {"note": note, "kernels": dict(sorted(self.entries.items()))})


def _require_kernel(kernel: ManifestKernel, file: Path) -> None:
    """Raise KernelError unless a file is a whole kernel of its kind: no page that says "not found", no cut file."""
    try:
        found = kernel_file(file).kind
    except KernelError as error:
        raise KernelError(f"what {kernel.url} answers is no kernel, and was thrown away: {error}") from error
    wanted = kernel.kind.rpartition(" ")[2]
    if found not in (wanted, "TEXT"):  # older text kernels do not say their kind
        raise KernelError(f"{kernel.url} is a kernel of kind {found}, not {wanted}; correct the manifest.")


def _write_metakernel(manifest: Manifest, manifest_path: Path, target: Path) -> Path:
    there = tuple(k for k in manifest.kernels if (target / k.file).is_file())
    template = manifest_path.parent / manifest.template
    path = target / manifest.metakernel
    write_text(path, filled_template(template.read_text(encoding="utf-8"), there) + "\n")
    return path

"""Whether a process elsewhere can do a night's pictures: asked of each worker of a cluster before it is given one.

The night leaves a word in its own folder; a worker that reads it there sees the same folder, and not one of the same name.
Kernels are compared by content: the same name may stand for other files on another machine.
"""

import os
import secrets
import uuid
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from opnav_workbench.errors import OpNavError
from opnav_workbench.files import make_folder, text_of, write_text
from opnav_workbench.kernels import KernelSet
from opnav_workbench.version import __version__

__all__ = ["unfit_because", "what_to_ask"]


def what_to_ask(folder: Path, parameters: Mapping[str, Any], images: list[str]) -> dict[str, Any]:
    """Return what a worker must know and see, as plain values; a word for it is left in `folder`.

    Parameters
    ----------
    folder
        Of the night's work; it must be there as long as workers are asked.
    parameters
        Of the notebook.
    images
        Some of the pictures.

    Raises
    ------
    OpNavError
        The folder cannot be written, or a kernel is missing here.
    """
    word = secrets.token_hex(8)
    token = make_folder(folder / f"word-{uuid.uuid4().hex[:8]}") / "word"
    write_text(token, word)
    return {
        "version": __version__,
        "token": str(token),
        "word": word,
        "kernels": parameters.get("kernels") or "",
        "digests": _digests(parameters.get("kernels") or ""),
        "images": images,
    }


def _digests(kernels: str) -> dict[str, str]:
    return {file.path.name: file.sha256 for file in KernelSet(kernels).kernels()} if kernels else {}


def unfit_because(asked: Mapping[str, Any]) -> str:
    """Return why this process cannot do a night's pictures; empty: it can."""
    if asked["version"] != __version__:
        return f"it has version {__version__}, the night {asked['version']}; install the same"
    token = Path(asked["token"])
    try:
        seen = text_of(token) == asked["word"]
    except (OSError, ValueError, OpNavError):
        seen = False
    if not seen:
        return f"it does not see the night's folder {token.parent}; share it under the same path"
    trial = token.with_name(f"{token.name}-{uuid.uuid4().hex[:8]}")
    try:
        trial.write_text("")
        trial.unlink()
    except OSError as error:
        return f"it cannot write into {token.parent} ({error.strerror})"
    missing = [name for name in asked["images"] if not os.access(name, os.R_OK)]
    if missing:
        return f"it cannot read the picture {missing[0]}; share it under the same path"
    return _other_kernels(asked)


def _other_kernels(asked: Mapping[str, Any]) -> str:
    try:
        here = _digests(asked["kernels"])
    except (OpNavError, OSError) as error:
        return f"kernels: {error}"
    other = sorted(
        name for name in asked["digests"].keys() | here.keys() if asked["digests"].get(name) != here.get(name)
    )
    with suppress(IndexError):
        return f"the kernel {other[0]} has other content there than here" + (
            f", and {len(other) - 1} more" if len(other) > 1 else ""
        )
    return ""

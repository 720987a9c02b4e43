"""Picture files: what paths, folders and patterns stand for, and how each picture's own folder of results is named."""

import glob
import os
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from opnav_workbench.errors import SessionError
from opnav_workbench.files import digest, fitting_name, sha256_of
from opnav_workbench.lazy_names import module_on_demand
from opnav_workbench.paths import is_file, is_folder

if TYPE_CHECKING:
    from opnav_workbench.image.formats import sidecar
else:  # for pictures without a header of their own
    sidecar = module_on_demand("opnav_workbench.image.formats.sidecar")

__all__ = ["FolderOwner", "NoPictures", "picture_files", "picture_names"]

PICTURE_SUFFIXES = (".fit", ".fits", ".fts", ".fit.gz", ".fits.gz", ".img", ".vic", ".imq", ".cub")
# In folders that hold other things of these endings too, only those with a sidecar are pictures.
WITH_SIDECAR = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".raw")
WILDCARDS = "*?["
PATH_DIGITS = 8


def picture_files(images: Iterable[str | Path]) -> tuple[Path, ...]:
    """Return the pictures that paths, folders and patterns stand for now, in full, in their order, each once.

    Parameters
    ----------
    images
        Files; folders (the pictures in them, sorted); patterns with ``* ? [`` (``**`` goes through folders). Hidden files
        are passed over there, as what is still being copied often is one.

    Raises
    ------
    SessionError
        A file is not there; a folder or pattern stands for no picture.
    """
    found: dict[Path, None] = {}
    for image in images:
        found.update(dict.fromkeys(_expanded(image)))
    return tuple(found)


def _expanded(image: str | Path) -> list[Path]:
    path = Path(image).expanduser()
    if is_file(path):
        return [path.resolve()]
    if is_folder(path):
        inside = [p for p in path.iterdir() if not p.name.startswith(".") and p.is_file() and _is_picture(p)]
        return _sorted(inside) or _nothing(
            f"the folder {path} holds no picture ({', '.join(PICTURE_SUFFIXES)})."
        )
    if not any(sign in str(image) for sign in WILDCARDS):
        return _nothing(f"the picture {path} is not there.")
    # Path.glob takes no absolute patterns
    matching = [Path(p) for p in glob.glob(str(path), recursive=True) if Path(p).is_file()]  # noqa: PTH207
    return _sorted(matching) or _nothing(
        f"no picture matches {str(image)!r}; quote the pattern, and see that the folder is right."
    )


def _is_picture(path: Path) -> bool:
    name = path.name.lower()
    return name.endswith(PICTURE_SUFFIXES) or (
        name.endswith(WITH_SIDECAR) and sidecar.find_sidecar(path) is not None
    )


def _sorted(paths: Iterable[Path]) -> list[Path]:
    return sorted(path.resolve() for path in paths)


class NoPictures(SessionError):  # noqa: N818  as a rule a slip, but where pictures are waited for none has come
    """A file is not there, or a folder or pattern stands for no picture."""


def _nothing(message: str) -> list[Path]:
    raise NoPictures(message)


@dataclass(frozen=True, slots=True)
class FolderOwner:
    """The picture that a folder of results belongs to.

    Attributes
    ----------
    path
        Where the picture was.
    sha256
        Of its file; empty where that is not known.
    """

    path: Path
    sha256: str = ""


def nobody(_name: str) -> FolderOwner | None:
    """Say that no folder belongs to a picture yet."""
    return None


def picture_names(
    pictures: Sequence[Path], owner: Callable[[str], FolderOwner | None] = nobody
) -> dict[Path, str]:
    """Return the name of each picture's folder: its stem, with the folder it lies in where that is another's.

    Where both are another's, part of the digest of its path stands behind. A picture keeps the folder that it has, whatever
    others come later; one that was moved takes its folder along.

    Parameters
    ----------
    pictures
        In full, each once.
    owner
        Tells whose a folder of this name is; None: nobody's.

    Raises
    ------
    SessionError
        Two pictures cannot be told apart this way.

    Examples
    --------
    >>> list(picture_names((Path("a/x.fit"), Path("b/x.fit"), Path("b/y.fit"))).values())
    ['a_x', 'b_x', 'y']
    >>> known = {"x": FolderOwner(Path("a/x.fit"))}
    >>> list(picture_names((Path("a/x.fit"), Path("b/x.fit")), known.get).values())
    ['x', 'b_x']
    >>> list(picture_names((Path("1/raw/x.fit"), Path("2/raw/x.fit"))).values())
    ['raw_x-1de0f3c7', 'raw_x-355a5701']
    """
    bad = [str(path) for path in pictures if path.stem.strip(".") == "" or path.stem.startswith(".")]
    if bad:
        raise SessionError(f"{', '.join(bad)} gives no name for a folder; rename the picture.")
    owners = {name: owner(name) for path in pictures for name in _candidates(path)}
    names = _kept_names(pictures, owners)
    new = [path for path in pictures if path not in names]
    for candidate in range(len(_candidates(Path()))):
        wished = {path: _candidates(path)[candidate] for path in new}
        count = Counter((*names.values(), *wished.values()))
        names |= {path: name for path, name in wished.items() if owners[name] is None and count[name] == 1}
        new = [path for path in new if path not in names]
    if new:
        raise SessionError(
            f"more than one picture is named {new[0].stem}; give each its own folder of results, in a call of its own."
        )
    return {path: names[path] for path in pictures}


def _kept_names(pictures: Sequence[Path], owners: Mapping[str, FolderOwner | None]) -> dict[Path, str]:
    """Return the names of pictures that have a folder: first those that are where they were, then those that were moved."""
    present, taken = set(pictures), set[str]()
    names: dict[Path, str] = {}
    for same in (_is_at, _was_moved_from):
        for path in pictures:
            for name in () if path in names else _candidates(path):
                whose = owners[name]
                if whose is not None and name not in taken and same(path, whose, present):
                    names[path] = name
                    taken.add(name)
                    break
    return names


def _candidates(path: Path) -> tuple[str, str, str]:
    longer = f"{path.parent.name}_{path.stem}"
    ending = f"-{digest(os.fsencode(path).hex())[:PATH_DIGITS]}"
    return path.stem, fitting_name(longer), fitting_name(longer, ending)


def _is_at(path: Path, owner: FolderOwner, _present: Collection[Path]) -> bool:
    return owner.path == path


def _was_moved_from(path: Path, owner: FolderOwner, present: Collection[Path]) -> bool:
    """Tell whether a folder's picture now lies elsewhere: of the same content, or unknown and not where it was."""
    if owner.path in present:
        return False
    return owner.sha256 == sha256_of(path) if owner.sha256 else not owner.path.exists()

"""Picture files: what paths, folders and patterns stand for, and how each picture's own folder of results is named."""

import glob
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from opnav_workbench.errors import SessionError

__all__ = ["picture_files", "picture_names"]

PICTURE_SUFFIXES = (".fit", ".fits", ".fts", ".fit.gz", ".fits.gz", ".img", ".vic", ".imq")
WILDCARDS = "*?["


def picture_files(images: Iterable[str | Path]) -> tuple[Path, ...]:
    """Return the pictures that paths, folders and patterns stand for now, in full, in their order, each once.

    Parameters
    ----------
    images
        Files; folders (the pictures in them, sorted); patterns with ``* ? [`` (``**`` goes through folders).

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
    if path.is_file():
        return [path.resolve()]
    if path.is_dir():
        inside = [p for p in path.iterdir() if p.name.lower().endswith(PICTURE_SUFFIXES) and p.is_file()]
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


def _sorted(paths: Iterable[Path]) -> list[Path]:
    return sorted(path.resolve() for path in paths)


def _nothing(message: str) -> list[Path]:
    raise SessionError(message)


def picture_names(pictures: Sequence[Path]) -> dict[Path, str]:
    """Return the name of each picture's folder: its stem, with the folder it lies in where stems are not unique.

    Raises
    ------
    SessionError
        Two pictures cannot be told apart this way.

    Examples
    --------
    >>> list(picture_names((Path("a/x.fit"), Path("b/x.fit"), Path("b/y.fit"))).values())
    ['a_x', 'b_x', 'y']
    """
    stems = Counter(path.stem for path in pictures)
    names = {p: p.stem if stems[p.stem] == 1 else f"{p.parent.name}_{p.stem}" for p in pictures}
    twice = [name for name, count in Counter(names.values()).items() if count > 1]
    if twice:
        raise SessionError(
            f"more than one picture is named {', '.join(sorted(twice))}; give each its own folder of results, "
            "in a call of its own."
        )
    bad = [str(path) for path, name in names.items() if name.strip(".") == "" or name.startswith(".")]
    if bad:
        raise SessionError(f"{', '.join(bad)} gives no name for a folder; rename the picture.")
    return names

"""Gaia DR3 of the whole sky, to a magnitude: asked of a TAP service in pieces of the sky, each kept as it came.

A piece is a HEALPix pixel of `LEVEL`, which a source's number begins with; so every star stands in one piece, and a piece
tells by its stars' numbers whether it is the one that was asked for. A TAP service says in its answer whether it is whole.

Sources: Gaia DR3 documentation, section 20.1.1 (source_id); IVOA Table Access Protocol 1.1 (OVERFLOW).
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlencode

import numpy as np

from opnav_workbench.catalog.cache import (
    CachedStars,
    Progress,
    Records,
    RecordStore,
    star_records,
)
from opnav_workbench.catalog.star_store import MotionBound, StoredCatalog
from opnav_workbench.catalog.vizier_tables import TABLES, plain_columns, stars_from_rows
from opnav_workbench.errors import CatalogError, DownloadError

if TYPE_CHECKING:
    from astropy.table import Table

__all__ = ["ARCHIVE", "MAG_LIMITS", "RULE", "archive_files", "check_piece", "piece_records", "stored_gaia"]

RULE = 1  # raise it whenever a record of the same row would change
ARCHIVE = "https://tapvizier.cds.unistra.fr/TAPVizieR/tap/sync"
LAYOUT = TABLES["gaia-dr3"]
LEVEL = 3
N_PIECES = 12 * 4**LEVEL
NUMBERS_A_PIECE = 2 ** (59 - 2 * LEVEL)
MOST_ROWS = 5_000_000  # of a piece: a hundred times what the fullest one holds at the faintest limit
# About 35 million stars, 4 GB in memory while they are sorted; a deeper sky is fetched by the cone
MAG_LIMITS = 3.0, 15.0
TAIL_BYTES = 1 << 16
COPIED = (
    "ra_rad", "dec_rad", "epoch_jyear", "mag", "pmra_rad_yr", "pmdec_rad_yr", "parallax_rad", "sigma", "position_motion",
    "v_mag", "v_sigma", "b_v", "b_v_sigma", "hip", "flags", "motion_known",
)  # fmt: skip


def archive_files(mag_limit: float | None) -> tuple[tuple[str, str], ...]:
    """Return name and address, behind the archive's own, of every piece of the sky to a magnitude.

    Raises
    ------
    CatalogError
        No limit, or none that a machine could keep the stars of.

    Examples
    --------
    >>> name, address = archive_files(12.0)[1]
    >>> name, "9007199254740992+AND+18014398509481983" in address
    ('gaia-001.vot', True)
    """
    low, high = MAG_LIMITS
    if mag_limit is None or not low <= mag_limit <= high:
        raise CatalogError(
            f"of Gaia's 1.8 billion stars a machine keeps those to a magnitude: give --mag-limit, {low:g} to {high:g} "
            "(13: about 7 million stars), or fetch a cone (opnav catalog fetch gaia-dr3 --cone)."
        )
    return tuple((f"gaia-{piece:03d}.vot", f"?{_question(piece, mag_limit)}") for piece in range(N_PIECES))


def _question(piece: int, mag_limit: float) -> str:
    columns = ", ".join(f'"{name}"' for name in LAYOUT.columns)
    first = piece * NUMBERS_A_PIECE
    text = (
        f'SELECT {columns} FROM "{LAYOUT.table}" '  # noqa: S608 (of our own names and numbers)
        f'WHERE "Source" BETWEEN {first} AND {first + NUMBERS_A_PIECE - 1} '
        f'AND "{LAYOUT.mag}" <= {mag_limit:.2f}'
    )
    return urlencode(
        {"REQUEST": "doQuery", "LANG": "ADQL", "FORMAT": "votable", "MAXREC": MOST_ROWS, "QUERY": text}
    )


def check_piece(path: Path) -> None:
    """Raise DownloadError unless a file is a whole answer of a TAP service."""
    with path.open("rb") as stream:
        head = stream.read(TAIL_BYTES)
        stream.seek(max(path.stat().st_size - TAIL_BYTES, 0))
        tail = stream.read()
    name = path.name.removesuffix(".part")
    if b"<VOTABLE" not in head or b"</VOTABLE>" not in tail:
        raise DownloadError(f"{name} came cut short, or is no answer of a TAP service; fetch it again.")
    if b'"ERROR"' in head:
        raise DownloadError(
            f"{name}: the archive answers with an error; try again, or another archive (--from)."
        )
    if b'"OVERFLOW"' in tail or b'"OVERFLOW"' in head:
        raise DownloadError(
            f"{name}: the archive cuts its answers short; give a brighter --mag-limit or another archive (--from)."
        )


def piece_records(folder: Path, progress: Progress | None = None) -> Records:
    """Return the stars of all pieces in a folder, in no order.

    Raises
    ------
    CatalogError
        A file is damaged, or holds another piece of the sky.
    """
    parts = []
    for piece in range(N_PIECES):
        parts.append(_records(folder / f"gaia-{piece:03d}.vot", piece))
        if progress is not None:
            progress((piece + 1) / N_PIECES)
    return np.concatenate(parts)


def _records(path: Path, piece: int) -> Records:
    rows = plain_columns(_table(path), LAYOUT)
    # Stars without place or magnitude are left out of the table; their numbers with them.
    whole = np.all([np.isfinite(rows[name]) for name in (*LAYOUT.position, LAYOUT.mag)], axis=0)
    number = rows["Source"][whole]
    if np.any(number // NUMBERS_A_PIECE != piece):
        raise CatalogError(f"{path} holds stars of another piece of the sky; remove it and fetch again.")
    stars = stars_from_rows(rows, LAYOUT)
    return star_records(len(stars), number=number, band=0, **{name: getattr(stars, name) for name in COPIED})


def _table(path: Path) -> "Table":
    from astropy.io.votable import parse_single_table  # noqa: PLC0415 (only a fetch reads such tables)
    from astropy.io.votable.exceptions import VOWarning  # noqa: PLC0415 (the same)

    try:
        return parse_single_table(path, verify="ignore").to_table(use_names_over_ids=True)
    except (OSError, ValueError, TypeError, IndexError, KeyError, VOWarning) as error:
        words = " ".join(str(error).split())[:120]
        raise CatalogError(f"{path} cannot be read ({words}); remove it and fetch again.") from error


def stored_gaia(name: str, stars: CachedStars, facts: Mapping[str, Any]) -> StoredCatalog:
    """Return fetched stars of Gaia as a catalog of this name; `facts` are told of it besides."""
    return StoredCatalog(
        name=name,
        facts={
            "source": f"Gaia DR3 (VizieR table {LAYOUT.table})",
            **facts,
            "bands": [LAYOUT.band],
            "n_with_motion": stars.n_with_motion,
        },
        store=RecordStore(stars.records, stars.keys, (LAYOUT.band,), _names, stars.limits, stars.checks),
        motion=MotionBound(stars.fastest_rad_yr, stars.first_jyear, stars.last_jyear),
    )


def _names(records: Records) -> Sequence[str]:
    return [f"Gaia DR3 {number}" for number in records["number"].tolist()]

"""Hipparcos-2 from the user's own copy of CDS I/311 (`hipparcos` has the layout), kept in the cache."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from opnav_workbench.catalog.cache import Progress, cache_name, cache_path, cached_stars, source_identity
from opnav_workbench.catalog.hipparcos import HIPPARCOS_JYEAR, read_hipparcos
from opnav_workbench.catalog.indexed import MotionBound, StoredCatalog
from opnav_workbench.catalog.records import Records, RecordStore, star_records
from opnav_workbench.catalog.text import source_files

__all__ = ["open_hip2"]

RULE = 1  # raise it whenever a record of the same row would change
REMEDY = "give the folder or the file of hip2.dat, from CDS catalog I/311 (https://cdsarc.cds.unistra.fr/ftp/I/311/)."


def open_hip2(argument: str, progress: Progress | None = None) -> StoredCatalog:
    """Open ``hip2.dat``, plain or .gz.

    Parameters
    ----------
    argument : str
        The file, or the folder that holds it; ``~`` stands for the home folder.
    progress : callable, optional
        Told the fraction done while the cache file is built.

    Raises
    ------
    CatalogError
        The file is missing or not in the layout of CDS I/311.
    """
    given = Path(argument).expanduser()
    file = given if given.is_file() else source_files(given, ["hip2.dat"], "Hipparcos-2", REMEDY)[0]
    identity = {"rule": RULE, **source_identity([file])}
    stars = cached_stars(cache_path(cache_name("hip2", file)), identity, partial(_records, file, progress))
    return StoredCatalog(
        name=f"hip2:{argument}",
        facts={
            "source": "Hipparcos, the new reduction (van Leeuwen 2007, CDS I/311)",
            "file": str(file),
            "bands": ["Hp"],
            "n_with_motion": stars.n_with_motion,
        },
        store=RecordStore(stars.records, stars.keys, ["Hp"], _names, stars.limits),
        motion=MotionBound(stars.fastest_rad_yr, stars.first_jyear, stars.last_jyear),
    )


def _records(file: Path, progress: Progress | None) -> Records:
    stars = read_hipparcos(file)
    if progress is not None:
        progress(1.0)
    return star_records(
        len(stars),
        number=stars.hip,
        ra_rad=stars.ra_rad,
        dec_rad=stars.dec_rad,
        epoch_jyear=HIPPARCOS_JYEAR,
        mag=stars.hp_mag,
        pmra_rad_yr=stars.motion_rad_yr[:, 0],
        pmdec_rad_yr=stars.motion_rad_yr[:, 1],
        parallax_rad=stars.parallax_rad,
        sigma=stars.sigma,
        **stars.johnson.columns(),
        hip=stars.hip,
        flags=stars.flags,
        motion_known=np.ones(len(stars), dtype=bool),
    )


def _names(records: Records) -> Sequence[str]:
    return [f"HIP {number}" for number in records["number"].tolist()]

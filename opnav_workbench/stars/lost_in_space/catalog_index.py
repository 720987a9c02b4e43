"""The index of a catalog: its stars over the whole sky, brightest first, kept beside the bands of their patterns."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from opnav_workbench.camera import Camera
from opnav_workbench.catalog import Catalog
from opnav_workbench.files import digest
from opnav_workbench.geometry import et_from_jyear
from opnav_workbench.resources import cache_root
from opnav_workbench.stars.lost_in_space.index_file import read_arrays, write_arrays
from opnav_workbench.stars.lost_in_space.sky_index import BANDS, SkyIndex, index_of_stars, patterns_folder

__all__ = ["index_of_catalog", "is_index_at_hand", "is_index_made_soon"]

EPOCH_JYEAR = 2016.0  # of the index: a motion of 0.1 arcsec/yr is a pixel of a narrow camera in 40 years
QUICK_STARS = BANDS[1].last  # whose patterns are made in seconds
MOST_IN_FIELD = 120.0  # stars of a picture that the index is looked into for
MOST_STARS = BANDS[-1].last
DEEP_CATALOG_MAG = 12.0  # limit of a catalog of more stars: about as many as the last band ends with


def index_of_catalog(catalog: Catalog, progress: Callable[[str], None] | None = None) -> SkyIndex:
    """Return the index of a catalog's stars, from the cache where it stands there.

    Parameters
    ----------
    catalog
        Its whole sky is asked for, once; of more than four million stars those to magnitude 12.
    progress : callable, optional
        Told in words what is made, as this takes seconds.

    Raises
    ------
    CatalogError
        The catalog cannot be asked for the whole sky.
    """
    return _opened(_Asked(f"{digest(_identity(catalog))} {cache_root()}", catalog, progress))


def is_index_at_hand(catalog: Catalog, camera: Camera) -> bool:
    """Tell whether the index for pictures of a camera is made already, or in seconds."""
    path = _stars_path(digest(_identity(catalog)))
    part = camera.n_pixel * camera.n_line * camera.pixel_scale_rad**2 / (4.0 * math.pi)
    needed = min(int(catalog.describe().get("n_stars", MOST_STARS)), int(MOST_IN_FIELD / part))
    return needed <= QUICK_STARS or path.is_file()


def is_index_made_soon(catalog: Catalog) -> bool:
    """Tell whether the index of all stars of a catalog is a matter of a minute at most."""
    return int(catalog.describe().get("n_stars", MOST_STARS + 1)) <= MOST_STARS


def _stars_path(key: str) -> Path:
    return patterns_folder() / f"{key[:16]}-stars.opnavindex"


@dataclass(frozen=True, slots=True)
class _Asked:
    """A catalog, known by its identity: what the index of one process is kept for."""

    key: str
    catalog: Catalog = field(compare=False)
    progress: Callable[[str], None] | None = field(compare=False)


@lru_cache(maxsize=2)
def _opened(asked: _Asked) -> SkyIndex:
    path, identity = _stars_path(asked.key), {"catalog": asked.key}
    arrays = read_arrays(path, identity)
    if arrays is not None:
        return SkyIndex(arrays["vectors"], arrays["mag"], patterns_folder(), asked.progress)
    many = int(asked.catalog.describe().get("n_stars", 0)) > MOST_STARS
    limit = DEEP_CATALOG_MAG if many else math.inf
    stars = asked.catalog.cone(0.0, 0.0, math.pi, limit)
    places = stars.directions(float(et_from_jyear(EPOCH_JYEAR)))
    index = index_of_stars(places, stars.mag, progress=asked.progress)
    write_arrays(path, identity, {"vectors": index.vectors, "mag": index.mag})
    return index


def _identity(catalog: Catalog) -> Mapping[str, Any]:
    """Return what changes when the catalog's stars do: what it tells of itself, and times of the files it names."""
    told = dict(catalog.describe())
    words = [catalog.name.partition(":")[2], *told.get("files", ())]
    times = {}
    for part in told.get("parts", ()):
        words += [str(part.get("name", "")).partition(":")[2], *part.get("files", ())]
    for word in words:
        path = Path(str(word)).expanduser()
        if word and path.is_file():
            times[str(path)] = [path.stat().st_size, path.stat().st_mtime_ns]
    return {"catalog": told, "files": times, "epoch": EPOCH_JYEAR}

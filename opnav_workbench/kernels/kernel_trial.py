"""A kernel of DAS architecture tried out: all of a shape that SPICE would ever read is read once, rays are cast at it.

`opnav_workbench.supervised` calls it in a process of its own, which loads this file and nothing
else of the package: SPICE follows the pointers and voxel tables of a DAS file
without a look at them.

Source: NAIF, DAS and DSK Required Reading.
"""

import itertools

import numpy as np
import spiceypy

__all__ = ["try_dsk", "try_ek"]

PLATE_TYPE = 2
MOST_SEGMENTS = 10_000
RAY_SIDES = 13  # of latitude and longitude; the voxel tables are met from all sides


def try_dsk(path: str) -> None:
    """Read every segment of a DSK and cast rays at its plates.

    Raises
    ------
    ValueError, SpiceyError
        What is wrong with it.
    """
    spiceypy.dskobj(path)
    handle = spiceypy.dasopr(path)
    try:
        segment = spiceypy.dlabfs(handle)
        for _ in range(MOST_SEGMENTS):
            if spiceypy.dskgd(handle, segment).dtype == PLATE_TYPE:
                _try_plates(handle, segment)
            segment = spiceypy.dlafns(handle, segment)
        raise ValueError(f"more than {MOST_SEGMENTS} segments")
    except spiceypy.NotFoundError:  # SPICE's way to say: no more
        return
    finally:
        spiceypy.dascls(handle)


def try_ek(path: str) -> None:
    """Load an EK; this package asks nothing of it.

    Raises
    ------
    SpiceyError
        SPICE does not take it.
    """
    spiceypy.furnsh(path)
    spiceypy.unload(path)


def _try_plates(handle: int, segment: spiceypy.utils.support_types.SpiceDLADescr) -> None:
    n_vertices, n_plates = spiceypy.dskz02(handle, segment)
    if n_vertices < 1 or n_plates < 1:
        raise ValueError(f"{n_vertices} vertices, {n_plates} plates")
    vertices = np.asarray(spiceypy.dskv02(handle, segment, 1, n_vertices), dtype=np.float64)
    plates = np.asarray(spiceypy.dskp02(handle, segment, 1, n_plates))
    if not np.isfinite(vertices).all() or plates.min() < 1 or plates.max() > n_vertices:
        raise ValueError("plates without vertices, or vertices that are no places")
    reach = 3.0 * float(np.abs(vertices).max())
    angles = np.linspace(0.0, 2.0 * np.pi, 2 * RAY_SIDES, endpoint=False), np.linspace(-1.5, 1.5, RAY_SIDES)
    for longitude, latitude in itertools.product(*angles):
        place = reach * np.array(
            [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)]
        )
        spiceypy.dskx02(handle, segment, place, -place)

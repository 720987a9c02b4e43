"""What the bits of a quality plane mean, as data: one table an instrument.

Effects     "bad": do not use; "saturated": the value is a lower bound; "usable": a remark only
Unknown     a bit that the table does not list counts as bad
"""

from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray
from opnav_workbench.errors import counted

__all__ = ["QUALITY_TABLES", "QualityBit", "QualityTable", "read_quality"]


# ---- What every reader hands over: planes and header of one file, before masks and time are made of them.


# ---- What the bits of a quality plane mean, as data: one table an instrument.

Effect: TypeAlias = Literal["bad", "saturated", "usable"]


@dataclass(frozen=True, slots=True)
class QualityBit:
    """One bit: its value, its meaning, and what it does to the pixel."""

    value: int
    meaning: str
    effect: Effect


@dataclass(frozen=True, slots=True)
class QualityTable:
    """The bits of one instrument; `missing` is a whole value that means no data, or None."""

    bits: tuple[QualityBit, ...]
    missing: int | None = None


QUALITY_TABLES = MappingProxyType(
    {
        # Every set bit makes the pixel bad: for planes that nobody has described.
        "any_nonzero": QualityTable(bits=()),
        # New Horizons SOC to Instrument Pipeline ICD (05310-SOCINST-01), LORRI. Bit 16: raw value 4095; in
        # flight frames the flagged pixels stand at 4095 minus the bias. Bit 32: the first 34 pixels of line 0
        # of every frame, which carry housekeeping, and pixels lost in telemetry. Other bits stand for
        # defects, and the instrument's hot and dead pixel maps are empty: not known here, hence bad.
        "new_horizons_lorri": QualityTable(
            bits=(
                QualityBit(16, "saturated in the raw data (4095 DN)", "saturated"),
                QualityBit(32, "no image data (housekeeping or lost)", "bad"),
            )
        ),
        # As listed in the comments of MVIC Level-2 quality extensions; table 10-6 of the same ICD.
        "new_horizons_mvic": QualityTable(
            bits=(
                QualityBit(1, "housekeeping out of yellow limits", "usable"),
                QualityBit(2, "defect in a calibration file", "bad"),
                QualityBit(4, "permanent detector defect", "bad"),
                QualityBit(8, "beyond the linear range", "saturated"),
                QualityBit(16, "zero-value pixel", "bad"),
                QualityBit(32, "bad for another reason", "bad"),
            ),
            missing=-1,
        ),
    }
)


def read_quality(quality: ArrayLike, table: QualityTable) -> tuple[BoolArray, BoolArray, tuple[str, ...]]:
    """Turn a quality plane into masks.

    Parameters
    ----------
    quality : (n_line, n_pixel) array_like of whole numbers

    Returns
    -------
    bad, saturated : (n_line, n_pixel) bool arrays
    messages : tuple of str
        One for each meaning that occurs, with its number of pixels.

    Examples
    --------
    >>> read_quality([[0, 16, 32]], QUALITY_TABLES["new_horizons_lorri"])[1]
    array([[False,  True, False]])
    """
    flags = np.asarray(quality).astype(np.int64)
    missing = np.zeros(flags.shape, bool) if table.missing is None else flags == table.missing
    flags = np.where(missing, 0, flags)
    masks: dict[str, BoolArray] = {e: np.zeros(flags.shape, bool) for e in ("bad", "saturated", "usable")}
    found = [("no data", missing, "bad")] if table.missing is not None else []
    found += [(bit.meaning, (flags & bit.value) != 0, bit.effect) for bit in table.bits]
    known = sum(bit.value for bit in table.bits)
    found.append(("flag without a known meaning", (flags & ~known) != 0, "bad"))
    messages = []
    for meaning, where, effect in found:
        masks[effect] |= where
        if count := int(np.count_nonzero(where)):
            messages.append(f"quality plane: {counted(count, 'pixel')}, {meaning}")
    return masks["bad"], masks["saturated"], tuple(messages)

"""Values that a spacecraft squeezed into fewer bits before sending them, by a table, brought back to one scale."""

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.image.frame import Header
from opnav_workbench.image.keywords import KeywordMap
from opnav_workbench.image.source import image_error

__all__ = ["expanded"]


def expanded(
    name: str, image: FloatArray, header: Header, keywords: KeywordMap
) -> tuple[FloatArray, tuple[str, ...]]:
    """Return a picture in DN that are proportional to light, and a remark where its values were squeezed.

    Raises
    ------
    ImageError
        Values that the table does not have.
    """
    how = keywords.value(header, "expansion_keyword")
    table = None if how is None else keywords.expansion.get(str(how))
    if table is None:
        return image, ()
    values = np.asarray(table, dtype=np.float64)
    stored = np.nan_to_num(image)
    if stored.min() < 0.0 or stored.max() > len(values) - 1 or not np.array_equal(stored, np.rint(stored)):
        raise image_error(
            name,
            f"{keywords.expansion_keyword} is {how}, whose table has values 0 to {len(values) - 1}, but pixels hold "
            f"{stored.min():g} to {stored.max():g}; it seems expanded already: correct the header.",
        )
    remark = f"values expanded from {len(values)} steps to {values[-1]:g} DN ({keywords.expansion_keyword} = {how})"
    return np.where(np.isnan(image), np.nan, values[stored.astype(np.int64)]), (remark,)

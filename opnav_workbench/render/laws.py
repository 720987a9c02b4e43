"""Scattering laws by name, as scenario files give them."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from opnav_workbench.errors import MissionError
from opnav_workbench.render.scattering import (
    Hapke,
    Lambert,
    LommelSeeliger,
    LunarLambert,
    Minnaert,
    ScatteringLaw,
)

__all__ = ["LAWS", "law_from_mapping"]

LAWS: dict[str, type[ScatteringLaw]] = {
    "lambert": Lambert,
    "lommel_seeliger": LommelSeeliger,
    "lunar_lambert": LunarLambert,
    "minnaert": Minnaert,
    "hapke": Hapke,
}


def law_from_mapping(values: Mapping[str, Any] | str) -> ScatteringLaw:
    """Return the law that a mapping describes: its name under ``law``, and the parameters that differ from the defaults.

    Parameters
    ----------
    values : mapping or str
        Such as ``{"law": "minnaert", "k": 0.8}``; a bare name stands for a law with its defaults. A parameter that is
        None keeps its default.

    Raises
    ------
    MissionError
        An unknown law or parameter, or a value outside its range; the message says what is allowed.

    Examples
    --------
    >>> law_from_mapping({"law": "minnaert", "k": 0.8})
    Minnaert(k=0.8)
    >>> law_from_mapping("oren_nayar")
    Traceback (most recent call last):
    opnav_workbench.errors.MissionError: scattering law 'oren_nayar' is unknown; use lambert, lommel_seeliger, ...
    """
    given = {"law": values} if isinstance(values, str) else dict(values)
    name = given.pop("law", None)
    if name not in LAWS:
        raise MissionError(f"scattering law {name!r} is unknown; use {', '.join(LAWS)}.")
    law = LAWS[name]
    known = [field.name for field in fields(law)]
    for key in given:
        if key not in known:
            allowed = f"it takes {', '.join(known)}" if known else "it takes none"
            raise MissionError(f"scattering law {name}: unknown parameter {key!r}; {allowed}.")
    chosen = {key: tuple(v) if isinstance(v, list) else v for key, v in given.items() if v is not None}
    try:
        return law(**chosen)
    except TypeError as error:
        raise MissionError(
            f"scattering law {name}: {chosen} is not all numbers; check its values."
        ) from error

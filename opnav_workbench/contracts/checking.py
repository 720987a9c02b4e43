"""One line for every fault of a file: its field, what is wrong and what may stand there.

YAML files are held against their model and, where that finds nothing, read as the program reads them (what they name must be
there). JSON files are held against their layout. Tables of observables and tracking messages are read, and every row is
held against itself: residuals, covariances, time tags.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies.results import BODY_STATUSES
from opnav_workbench.contracts.kinds import KINDS, Kind, kind_of_content
from opnav_workbench.contracts.layouts import has_negative_variance, residual_off_px
from opnav_workbench.errors import MissionError, OpNavError, SessionError
from opnav_workbench.files import read_json as read_json_file
from opnav_workbench.format_versions import as_of_today
from opnav_workbench.geometry.times import et_from_text
from opnav_workbench.landmarks import Maplets
from opnav_workbench.observables import Observable, read_csv, read_ecsv, read_json, read_tdm, tdm_table
from opnav_workbench.observables.observable import LIGHT_TIMES
from opnav_workbench.paths import is_file
from opnav_workbench.yaml_file import file_faults, read_content

__all__ = ["Checked", "check_file"]

YAML_ENDINGS = (".yaml", ".yml")
ROUNDING_S = 2e-3  # a UTC is written to the millisecond


@dataclass(frozen=True, slots=True)
class Checked:
    """What was found in a file.

    Attributes
    ----------
    path
    what
        What kind of file it is, in words.
    faults
        One line each; none: the file is sound.
    """

    path: Path
    what: str
    faults: tuple[str, ...]


def check_file(path: str | Path, kind: str | None = None) -> Checked:
    """Check a file of any kind.

    Parameters
    ----------
    path
    kind
        One of `KINDS`; by default what the file looks like.

    Raises
    ------
    SessionError
        The file cannot be read, or it is not known what it is.
    """
    file = Path(path)
    ending = file.suffix.casefold()
    if not is_file(file):
        raise SessionError(f"{file} is no file; give files that opnav reads or writes.")
    if ending in TABLES:
        return Checked(
            file, f"observables ({ending[1:].upper()})", tuple(_table_faults(file, TABLES[ending]))
        )
    if ending == ".tdm":
        return Checked(file, "tracking data message", tuple(_tdm_faults(file)))
    if ending == ".npz":
        return Checked(file, "maplets", tuple(_maplet_faults(file)))
    if ending in YAML_ENDINGS:
        return _checked_yaml(file, kind)
    if ending == ".json":
        return _checked_json(file, kind)
    raise SessionError(
        f"{file} has no ending that tells what it is; check "
        f"{', '.join((*YAML_ENDINGS, '.json', *TABLES, '.tdm', '.npz'))} files."
    )


def _chosen(file: Path, kind: str | None, content: Any, *, yaml: bool) -> Kind:
    names = [name for name, known in KINDS.items() if known.is_yaml is yaml]
    if kind is not None:
        if kind not in names:
            raise SessionError(f"unknown kind {kind!r} of file; choose one of {', '.join(names)} for {file}.")
        return KINDS[kind]
    found = kind_of_content(content, yaml=yaml)
    if found is None:
        raise SessionError(f"{file} looks like no file of opnav; say what it is (--as {' | '.join(names)}).")
    return found


# ---- YAML


def _checked_yaml(file: Path, name: str | None) -> Checked:
    kind = _chosen(file, name, read_content(file, "file", SessionError), yaml=True)
    try:
        faults = file_faults(file, kind.model, kind.what, kind.failure)
        if not faults and kind.load is not None:
            kind.load(file)
    except OpNavError as error:
        faults = [_without_label(str(error), file, kind.what)]
    return Checked(file, kind.what, tuple(faults))


def _without_label(message: str, file: Path, what: str) -> str:
    for path in (str(file), str(file.resolve())):
        for prefix in (f"{what} {path}: ", f"{path}: ", f"{path}, ", f"{path} "):
            message = message.removeprefix(prefix)
    return " ".join(message.split())


# ---- JSON


def _checked_json(file: Path, name: str | None) -> Checked:
    content = read_json_file(file, "give a file that opnav wrote.")
    kind = _chosen(file, name, content, yaml=False)
    try:
        today = as_of_today(kind.version, content, str(file), SessionError)
        kind.model.model_validate_json(json.dumps(today))
    except ValidationError as error:
        return Checked(file, kind.what, tuple(_json_fault(problem) for problem in error.errors()))
    except OpNavError as error:
        return Checked(file, kind.what, (_without_label(str(error), file, kind.what),))
    if kind.name == "observables":
        return Checked(file, kind.what, tuple(_table_faults(file, read_json)))
    return Checked(file, kind.what, ())


def _json_fault(problem: Mapping[str, Any]) -> str:
    place = ".".join(str(part) for part in problem["loc"]) or "the file"
    if problem["type"] == "missing":
        return f"{place}: this field is required"
    given = problem["input"]
    shown = f", not {json.dumps(given)}" if isinstance(given, str | int | float | None) else ""
    return f"{place}: {str(problem['msg']).removeprefix('Value error, ')}{shown}"


# ---- Maplets


def _maplet_faults(file: Path) -> Iterator[str]:
    try:
        Maplets.read(file)
    except MissionError as error:
        yield _without_label(str(error), file, "maplets")


# ---- Observables


TABLES: Mapping[str, Callable[[Path], tuple[Observable, ...]]] = {".ecsv": read_ecsv, ".csv": read_csv}


def _table_faults(file: Path, read: Callable[[Path], Sequence[Observable]]) -> Iterator[str]:
    try:
        observables = read(file)
    except SessionError as error:
        yield _without_label(str(error), file, "")
        return
    for row, observable in enumerate(observables):
        yield from (
            f"row {row} ({observable.image}, {observable.name}): {f}" for f in _row_faults(observable)
        )


def _row_faults(o: Observable) -> Iterator[str]:
    if o.status not in BODY_STATUSES:
        yield f"status: {o.status!r} is none of {', '.join(BODY_STATUSES)}"
    if o.light_time not in LIGHT_TIMES:
        yield f"light_time: {o.light_time!r} is none of {', '.join(LIGHT_TIMES)}"
    yield from _time_faults(o)
    if (
        o.observed_px is not None
        and o.residual_px is not None
        and (left := residual_off_px(o.residual_px, o.observed_px, o.predicted_px))
    ):
        yield f"pixel_oc, line_oc: not observed minus computed place, by {left:.3g} px"
    for name in (
        "covariance_px2",
        "total_covariance_px2",
        "residual_covariance_arcsec2",
        "attitude_covariance_rad2",
    ):
        yield from _covariance_faults(name, getattr(o, name))
    yield from _angle_faults(o)


def _time_faults(o: Observable) -> Iterator[str]:
    try:
        et = et_from_text(o.utc)
    except ValueError as error:
        yield f"utc: {o.utc!r} is no time: {error}"
        return
    if not abs(et - o.et) < ROUNDING_S:
        yield f"et: {o.et!r} is not the TDB of utc {o.utc} ({et:.3f})"


def _covariance_faults(name: str, matrix: FloatArray | None) -> Iterator[str]:
    if matrix is not None and np.isfinite(matrix).all() and has_negative_variance(matrix):
        yield f"{name}: has a negative variance along a direction; it is no covariance"


def _angle_faults(o: Observable) -> Iterator[str]:
    limits = {
        "ra_deg": (0, 360),
        "apparent_ra_deg": (0, 360),
        "dec_deg": (-90, 90),
        "apparent_dec_deg": (-90, 90),
    }
    for name, (low, high) in limits.items():
        if not (np.isnan(angle := getattr(o, name)) or low <= angle <= high):
            yield f"{name.removesuffix('_deg')}: {angle} is outside {low} to {high} deg"


# ---- Tracking data messages


def _tdm_faults(file: Path) -> Iterator[str]:
    try:
        table = tdm_table(read_tdm(file))
    except SessionError as error:
        yield _without_label(str(error), file, "")
        return
    if not len(table):
        yield "there are no angles in it (ANGLE_TYPE RADEC)"
    for row, entry in enumerate(table):
        place = f"row {row} ({entry['target']}, {entry['utc']})"
        if not abs(entry["dec"].value) <= 90.0:
            yield f"{place}: ANGLE_2: {entry['dec'].value} is no declination"
        for fault in _covariance_faults("COVARIANCE", entry["covariance"].value):
            yield f"{place}: {fault}"

"""Inputs of a session: what came from outside the picture (time, observer, a priori attitude, catalog stars, targets).

They are collected once from kernels, image header, catalog and target list, and kept with the session, so that it
resumes without any of these.  Later steps may add targets and, for a wide search, catalog stars farther around.  As plain
values they stand in ``session.json`` whole, and in ``journal.jsonl`` as what a step added.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.camera import Camera, RowSweep
from opnav_workbench.catalog import Catalog, StarTable, open_catalog, read_star_list
from opnav_workbench.errors import ImageError, KernelError, OpNavError, SessionError
from opnav_workbench.geometry import radec_from_unit
from opnav_workbench.geometry.times import text_from_et
from opnav_workbench.kernels import (
    KernelSet,
    attitude_gaps,
    camera_attitude,
    et_from_sclk,
    et_from_utc,
    knows_frame,
)
from opnav_workbench.kernels.loading import LoadedKernels
from opnav_workbench.kernels.shape_files import ShapeFile
from opnav_workbench.lazy_names import module_on_demand
from opnav_workbench.scene import (
    Observer,
    body_target,
    observer_from_header,
    observer_from_kernels,
    star_target_at,
    sweep_of,
    with_course,
)
from opnav_workbench.session.context import Context, faintest_magnitude
from opnav_workbench.session.contradictions import (
    attitude_contradiction,
    exposure_contradiction,
    header_attitude,
    settled_time,
)
from opnav_workbench.targets import TargetState

if TYPE_CHECKING:
    from opnav_workbench.kernels import dsk_files
    from opnav_workbench.session import beside
else:  # shapes in kernels are asked for where there are kernels; few pictures have anything beside them
    dsk_files = module_on_demand("opnav_workbench.kernels.dsk_files")
    beside = module_on_demand("opnav_workbench.session.beside")

__all__ = [
    "ATTITUDE_SOURCES",
    "IN_PICTURE_ALONE",
    "AttitudeOrigin",
    "AttitudeSource",
    "InputSource",
    "Inputs",
    "LostField",
    "NoAttitudeError",
    "NoAttitudeKernelError",
    "collect_inputs",
    "inputs_added",
    "inputs_dict",
    "inputs_from",
    "mid_exposure_et",
    "with_inputs_added",
    "with_lost_field",
    "with_scene",
    "with_shape",
    "with_sweep",
    "with_target",
    "with_wide_stars",
]


# What told an a priori attitude; none: the stars did; unknown: nothing, the camera's own axes stand for those of the sky.
AttitudeOrigin = Literal["kernels", "header", "none", "unknown"]
AttitudeSource = Literal["auto", AttitudeOrigin]
IN_PICTURE_ALONE = "and bodies have places and ranges, but no right ascension and declination"
ATTITUDE_SOURCES: tuple[AttitudeSource, ...] = get_args(AttitudeSource)


@dataclass(frozen=True, slots=True, eq=False)
class LostField:
    """What a search of the whole sky gave: an attitude, to some pixels, and what there is to say of it.

    Attributes
    ----------
    camera_from_j2000 : (3, 3) array or None
        None where none is sure, or no attitude of this camera makes this picture: it is mirrored, or of another scale.
    message
        One line.
    """

    camera_from_j2000: FloatArray | None
    message: str

    def __post_init__(self) -> None:
        freeze_arrays(self, in_file_order=True)


@dataclass(frozen=True, slots=True, eq=False)
class Inputs:
    """What came from outside the picture (kernels, header, catalog), kept so that a session resumes without them.

    Attributes
    ----------
    et
        Mid-exposure, TDB seconds past J2000.
    a_priori_camera_from_j2000 : (3, 3) array
    attitude_source : {"kernels", "header", "none", "unknown"}
        What told the attitude; "none": neither of the two, but the stars (`lost`); "unknown": nothing does.
    stars
        Catalog rows around the a priori field.
    targets : mapping of str to TargetState
    wide_stars
        Brightest catalog rows as far around as the widest search goes, once one was needed.
    shapes : mapping of str to Path
        Shape models of targets, where the kernels hold one or it was given.
    shape_units : mapping of str to str
        Of shapes that are not in km.
    lost
        What a search of the whole sky gave, where one was needed.
    contradictions
        Which facts of the header contradict each other or the kernels, and what is used (`contradictions`).
    sweep
        How the camera turned while the lines of a rolling shutter or line scanner were exposed.
    catalog_found
        What the catalog's spec was when it was opened: `bundled` has what the machine has beside it.
    """

    et: float
    utc: str
    observer: Observer
    a_priori_camera_from_j2000: FloatArray
    attitude_source: AttitudeOrigin
    stars: StarTable
    targets: MappingProxyType[str, TargetState]
    wide_stars: StarTable | None = None
    shapes: MappingProxyType[str, Path] = field(default_factory=lambda: MappingProxyType({}))
    lost: LostField | None = None
    contradictions: tuple[str, ...] = ()
    shape_units: MappingProxyType[str, str] = field(default_factory=lambda: MappingProxyType({}))
    sweep: RowSweep | None = None
    catalog_found: str = ""

    def __post_init__(self) -> None:
        freeze_arrays(self, in_file_order=True)

    @property
    def told_by_stars(self) -> bool:
        """Whether nothing but the stars tells the a priori attitude."""
        return self.attitude_source == "none"

    @property
    def has_a_priori_attitude(self) -> bool:
        """Whether something else than the stars tells the attitude, so that stars may differ from it."""
        return self.attitude_source in ("kernels", "header")

    @property
    def without_sky(self) -> bool:
        """Whether nothing tells the a priori attitude: the camera's own axes stand for it."""
        return self.attitude_source == "unknown"


# ---- From kernels, image header, catalog and target lists.

WIDE_STARS = 1000  # of a wide search: dozens on the detector of any camera, and a session file of a megabyte
FAINT_MARGIN_MAG = 1.0  # colors, and the zero point's own error
MAX_CONE_RAD = np.pi
NAMED_STARS = 12  # of a list, in a message


class NoAttitudeError(ImageError):
    """Neither kernels nor header tell the attitude."""


class NoAttitudeKernelError(KernelError):
    """The kernels have a gap where the attitude should be."""


@dataclass(frozen=True, slots=True)
class InputSource:
    """Where inputs come from.

    Attributes
    ----------
    catalog
        Catalog spec.
    target_stars
        Star list for stars that are targets.
    attitude : {"auto", "kernels", "header", "none", "unknown"}
        ``none``: the stars alone shall tell it; ``unknown``: nothing does, and pictures are measured without the sky.
    shapes : mapping of str to ShapeFile
        Shape models that were given by name of the body; they outrank those of kernels and mission.
    by_hand
        Whether an analyst has described the picture's bodies: it then needs neither attitude nor spacecraft state.
    """

    catalog: str = "bundled"
    target_stars: Path | None = None
    attitude: str = "auto"
    shapes: Mapping[str, ShapeFile] = field(default_factory=lambda: MappingProxyType({}))
    by_hand: bool = False

    def __post_init__(self) -> None:
        if self.attitude not in ATTITUDE_SOURCES:
            raise SessionError(
                f"unknown attitude source {self.attitude!r}; choose one of {', '.join(ATTITUDE_SOURCES)}."
            )


def collect_inputs(
    context: Context,
    source: InputSource,
    catalog: Catalog | None = None,
    lost: LostField | None = None,
) -> Inputs:
    """Collect time, observer, a priori attitude and the catalog stars around the field.

    Parameters
    ----------
    lost
        The attitude to begin with, where neither kernels nor header shall tell it.

    Raises
    ------
    NoAttitudeError
        Nothing tells it.
    """
    time = settled_time(context, mid_exposure_et(context))
    et = time.et
    origin: AttitudeOrigin
    if lost is None or lost.camera_from_j2000 is None:
        attitude, origin = _attitude(context, source.attitude, et)
    else:
        attitude, origin = lost.camera_from_j2000, "none"
    observer = _observer(context, et)
    sweep, unswept = _sweep(context, et, observer)
    inputs = Inputs(
        et=et,
        utc=text_from_et(et) if _to_middle_line_s(context) else time.utc,
        observer=observer,
        a_priori_camera_from_j2000=attitude,
        attitude_source=origin,
        stars=StarTable.empty(),
        targets=MappingProxyType({}),
        lost=lost,
        contradictions=(
            *context.picture.contradictions,
            *time.contradictions,
            *exposure_contradiction(context),
            *attitude_contradiction(context, et, origin),
            *unswept,
        ),
        sweep=sweep,
    )
    context = with_sweep(context, sweep)
    if inputs.without_sky:
        return inputs
    catalog = catalog or open_catalog(source.catalog)
    return replace(inputs, stars=_stars(context, catalog, inputs), catalog_found=catalog.name)


def with_target(context: Context, source: InputSource, inputs: Inputs, name: str) -> Inputs:
    """Add one target to the inputs, unless they hold it: a star of the target list, else a SPICE body."""
    if name in inputs.targets:
        return inputs
    target = _star_target(context, source, inputs, name)
    shape: ShapeFile | None = None
    if target is None:
        target = _body_target(context, source, inputs, name)
        given = source.shapes.get(name)
        if given is not None:  # it outranks the kernels', which may be large or damaged
            shape = ShapeFile(given.path.resolve(), given.unit)
        elif (by_kernels := dsk_files.shape_file_of(name)) is not None:
            shape = ShapeFile(by_kernels)
    return with_shape(
        replace(inputs, targets=MappingProxyType({**inputs.targets, name: target})), name, shape
    )


def with_shape(inputs: Inputs, name: str, shape: ShapeFile | None) -> Inputs:
    """Add a body's shape model to the inputs, where there is one."""
    if shape is None:
        return inputs
    units = {**inputs.shape_units, **({} if shape.unit == "km" else {name: shape.unit})}
    return replace(
        inputs,
        shapes=MappingProxyType({**inputs.shapes, name: shape.path}),
        shape_units=MappingProxyType(units),
    )


def with_scene(
    context: Context, source: InputSource, inputs: Inputs, described: Sequence[str] = ()
) -> tuple[Inputs, list[str]]:
    """Add the mission's bodies that may hide, shade or outshine another; return which of them are known, too.

    Parameters
    ----------
    described
        Bodies that the analyst described.
    """
    names = list(described)
    for name in context.mission.default_targets:
        if name in described:
            continue
        if KernelSet.active() is not None:
            with suppress(OpNavError):  # nothing is known of it: it is not in the scene
                inputs = with_target(context, source, inputs, name)
        if name in inputs.targets:
            names.append(name)
    return inputs, names


def with_lost_field(
    context: Context,
    source: InputSource,
    inputs: Inputs,
    lost: LostField,
    catalog: Catalog | None = None,
) -> Inputs:
    """Add what a search of the whole sky gave, and the stars around the field that it found."""
    if lost.camera_from_j2000 is None:
        return replace(inputs, lost=lost)
    there = replace(inputs, a_priori_camera_from_j2000=lost.camera_from_j2000)
    catalog = catalog or open_catalog(source.catalog)
    stars = _stars(context, catalog, there)
    known = [inputs.stars] if inputs.wide_stars is None else [inputs.stars, inputs.wide_stars]
    new = stars.take(~np.isin(stars.id, np.concatenate([table.id for table in known])))
    wide = StarTable.concatenate([*known[1:], new])
    return replace(inputs, lost=lost, wide_stars=wide, catalog_found=catalog.name)


def with_wide_stars(
    context: Context, source: InputSource, inputs: Inputs, catalog: Catalog | None = None
) -> Inputs:
    """Add the brightest stars as far around the a priori field as the widest search goes, once, where there is one."""
    if inputs.wide_stars is not None or inputs.without_sky or not context.settings.wide_searches:
        return inputs
    reach_px = max(shift for shift, _ in context.settings.wide_searches)
    radius = context.camera.half_diagonal_rad + reach_px * context.camera.pixel_scale_rad
    limit = min(context.settings.mag_limit, faintest_magnitude(context) + FAINT_MARGIN_MAG)
    catalog = catalog or open_catalog(source.catalog)
    stars = _cone(context, catalog, inputs, radius, limit)
    brightest = np.sort(np.argsort(stars.mag, kind="stable")[:WIDE_STARS])
    return replace(inputs, wide_stars=stars.take(brightest), catalog_found=catalog.name)


def _cone(
    context: Context, catalog: Catalog, inputs: Inputs, radius_rad: float, mag_limit: float
) -> StarTable:
    direction = inputs.a_priori_camera_from_j2000.T @ context.camera.boresight
    ra, dec = (float(a) for a in radec_from_unit(direction))
    return catalog.cone(ra, dec, min(radius_rad, MAX_CONE_RAD), mag_limit=mag_limit, et_s=inputs.et)


def mid_exposure_et(context: Context) -> float:
    """Mid-exposure time from the header's ET, UTC or clock reading, in this order."""
    picture = context.picture
    if picture.et is not None:
        return picture.et + _to_middle_line_s(context)
    if KernelSet.active() is not None and picture.utc is not None:
        return et_from_utc(picture.utc)
    if KernelSet.active() is not None and picture.sclk is not None:
        return et_from_sclk(context.mission.clock_id, picture.sclk)
    raise ImageError(
        f"{picture.name}: the header gives no time but a clock reading ({picture.sclk}); "
        "give kernels with an LSK and the SCLK of this spacecraft (--kernels)."
    )


def _to_middle_line_s(context: Context) -> float:
    """Return from the middle of the first line's exposure, where the header tells its start, to that of the middle line."""
    rows, keywords = context.camera.rows, context.picture.keywords
    if rows is None or keywords is None or keywords.time_reference != "start":
        return 0.0
    return 0.5 * rows.span_s(context.camera.n_line)


def _observer(context: Context, et: float) -> Observer:
    """Return the spacecraft by the kernels, else by the header; aberration that neither tells stands in the covariance."""
    kernels = KernelSet.active()
    spacecraft = context.mission.spacecraft_id
    if kernels is not None and any(c.body == spacecraft for c in kernels.coverage("SPK")):
        return observer_from_kernels(spacecraft, et)
    return observer_from_header(context.picture, et)


def _attitude(context: Context, wanted: str, et: float) -> tuple[FloatArray, AttitudeOrigin]:
    kernels, frame_name = KernelSet.active(), context.camera.frame
    if wanted == "unknown":
        return np.eye(3), "unknown"
    if wanted == "none":
        raise NoAttitudeError("the stars alone shall tell the attitude.")
    if wanted == "kernels" or (
        wanted == "auto" and kernels is not None and _is_oriented(kernels, frame_name)
    ):
        try:
            return camera_attitude(frame_name, et), "kernels"
        except KernelError as error:
            if wanted == "kernels":
                raise KernelError(f"{error} {_instead_of_kernels(context)}") from error
            raise NoAttitudeKernelError(str(error)) from error
    attitude = header_attitude(context)
    if attitude is None:
        raise NoAttitudeError(
            f"{context.picture.name}: the header gives no attitude{_because(context.picture.contradictions)}; "
            f"give kernels with a CK for {frame_name} (--kernels)."
        )
    return attitude, "header"


def _sweep(context: Context, et: float, observer: Observer) -> tuple[RowSweep | None, tuple[str, ...]]:
    """Return how the camera turns while its lines are exposed, by the kernels, and what is wrong with a picture without."""
    camera = context.camera
    if camera.rows is None:
        return None, ()
    span = f"while its lines are exposed ({camera.rows.span_s(camera.n_line):.4g} s)"

    def attitude(time_s: float) -> FloatArray:
        return camera_attitude(camera.frame, et + time_s)

    def velocity(time_s: float) -> FloatArray:
        if observer.source != "kernels":
            return observer.velocity_km_s
        return observer_from_kernels(context.mission.spacecraft_id, et + time_s).velocity_km_s

    try:
        return sweep_of(camera, attitude, velocity), _bridged(camera, et)
    except KernelError as error:
        if camera.rows.scans:
            raise KernelError(
                f"{context.picture.name} is a line scan, and the camera's motion {span} is not known: {error}"
            ) from error
        return None, (f"the camera's motion {span} is not known, and taken as none: {error}",)


def _bridged(camera: Camera, et: float) -> tuple[str, ...]:
    """Return how much of a picture's motion is interpolated across gaps of the CK; a gap within one line is none."""
    assert camera.rows is not None
    half_s = 0.5 * camera.rows.span_s(camera.n_line)
    gaps_s = np.diff(attitude_gaps(camera.frame, et - half_s, et + half_s), axis=1)
    unknown_s = float(gaps_s[gaps_s > abs(camera.rows.line_time_s)].sum())
    if unknown_s == 0.0:
        return ()
    said = (
        f"for {unknown_s:.3g} of the {2.0 * half_s:.4g} s in which the lines are exposed no loaded CK knows the attitude; "
        "it is interpolated there: load a CK without the gap"
    )
    return (said,)


def with_sweep(context: Context, sweep: RowSweep | None) -> Context:
    """Return the context with a camera whose lines have their own times."""
    return context if sweep is None else replace(context, camera=replace(context.camera, sweep=sweep))


def _is_oriented(kernels: LoadedKernels, frame: str) -> bool:
    """Whether the kernels orient a frame at any time; they need not know it where the header does."""
    return knows_frame(frame) and kernels.has_attitude(frame)


def _instead_of_kernels(context: Context) -> str:
    """What else tells the attitude, for one who asked for the kernels' alone."""
    told = "the header states one (--attitude header)" if header_attitude(context) is not None else ""
    return f"Without kernels {told or 'the stars tell it (--attitude none)'}."


def _because(contradictions: Sequence[str]) -> str:
    return f" ({'; '.join(contradictions)})" if contradictions else ""


def _stars(context: Context, catalog: Catalog, inputs: Inputs) -> StarTable:
    """Catalog stars in a cone that holds the detector, the search margin and the twist error's reach."""
    camera, settings = context.camera, context.settings
    margin = settings.max_shift_px * camera.pixel_scale_rad
    reach = camera.half_diagonal_rad * (1.0 + np.radians(settings.max_twist_deg)) + margin
    return _cone(context, catalog, inputs, reach, settings.mag_limit)


def _star_target(context: Context, source: InputSource, inputs: Inputs, name: str) -> TargetState | None:
    path = source.target_stars or context.mission.target_stars
    if path is None:
        return None
    stars = read_star_list(path)
    names = {str(star).casefold(): row for row, star in enumerate(stars.id)}
    row = names.get(name.casefold())
    if row is None:
        return None
    return star_target_at(name, stars, row, inputs.et, inputs.observer)


def _body_target(context: Context, source: InputSource, inputs: Inputs, name: str) -> TargetState:
    """Return a body that kernels know, or support data beside; where none do, the error names the known stars, too."""
    if KernelSet.active() is None and (told := _told_body(context, inputs, name)) is not None:
        return told
    try:
        return _spice_target(context, inputs, name)
    except KernelError as error:
        path = source.target_stars or context.mission.target_stars
        if path is None:
            raise
        known = [str(star) for star in read_star_list(path).id]
        more = f", and {len(known) - NAMED_STARS} more" if len(known) > NAMED_STARS else ""
        raise KernelError(
            f"{error} The target stars of {path.name} are {', '.join(known[:NAMED_STARS])}{more}."
        ) from error


def _told_body(context: Context, inputs: Inputs, name: str) -> TargetState | None:
    """Return the body of image support data beside the picture, unless the header says that another one is its target."""
    told, picture = context.beside, context.picture
    if told is None:
        return None
    header_target = None if picture.keywords is None else picture.keywords.value(picture.header, "target")
    if header_target is not None and str(header_target).casefold() != name.casefold():
        return None
    observer = inputs.observer
    target = beside.body_beside(told, name, np.asarray(observer.velocity_km_s), observer.velocity_sigma_km_s)
    return None if target is None else context.mission.with_magnitude(target)


def _spice_target(context: Context, inputs: Inputs, name: str) -> TargetState:
    if KernelSet.active() is None:
        raise KernelError(
            f"target {name}: it is not in the target star list, and no kernels are loaded; give kernels that "
            "cover the body (--kernels) or a star list (--target-stars)."
        )
    if name != name.strip().upper():  # SPICE would take it, and the picture have one body under two names
        raise KernelError(f"target {name!r}: write the body's name in capitals, {name.strip().upper()}.")
    craft, et = context.mission.spacecraft_id, inputs.et
    target = body_target(name, craft, et)
    if inputs.sweep is not None:
        half_s = 0.5 * float(np.ptp(inputs.sweep.time_s))
        target = with_course(target, half_s, lambda time_s: body_target(name, craft, et + time_s))
    return context.mission.with_magnitude(target)


# ---- As plain values, and back: whole, and what a step added to them.


def inputs_dict(inputs: Inputs) -> dict[str, Any]:
    """Return inputs as plain values."""
    return {
        "et": inputs.et,
        "utc": inputs.utc,
        "observer": _columns(inputs.observer),
        "a_priori_camera_from_j2000": inputs.a_priori_camera_from_j2000,
        "attitude_source": inputs.attitude_source,
        "stars": _columns(inputs.stars),
        "wide_stars": None if inputs.wide_stars is None else _columns(inputs.wide_stars),
        "targets": {name: _columns(target) for name, target in inputs.targets.items()},
        "shapes": dict(inputs.shapes),
        **({} if inputs.lost is None else {"lost": _columns(inputs.lost)}),
        **({"contradictions": inputs.contradictions} if inputs.contradictions else {}),
        **({"shape_units": dict(inputs.shape_units)} if inputs.shape_units else {}),
        **({"sweep": _columns(inputs.sweep)} if inputs.sweep else {}),
        **({"catalog_found": inputs.catalog_found} if inputs.catalog_found else {}),
    }


def _columns(instance: Any) -> dict[str, Any]:
    return {field.name: getattr(instance, field.name) for field in fields(instance) if field.init}


def inputs_from(data: Mapping[str, Any]) -> Inputs:
    """Return inputs from plain values."""
    return Inputs(
        et=float(data["et"]),
        utc=data["utc"],
        observer=_rebuild(Observer, data["observer"]),
        a_priori_camera_from_j2000=np.array(data["a_priori_camera_from_j2000"], dtype=np.float64),
        attitude_source=data["attitude_source"],
        stars=_star_table(data["stars"]),
        targets=MappingProxyType({n: _rebuild(TargetState, t) for n, t in data["targets"].items()}),
        wide_stars=None if data.get("wide_stars") is None else _star_table(data["wide_stars"]),
        shapes=_path_mapping(data.get("shapes", {})),
        lost=_lost_field(data.get("lost")),
        contradictions=tuple(data.get("contradictions", ())),
        shape_units=MappingProxyType(dict(data.get("shape_units", {}))),
        sweep=None if data.get("sweep") is None else _stored_sweep(data),
        catalog_found=data.get("catalog_found", ""),
    )


def _stored_sweep(data: Mapping[str, Any]) -> RowSweep:
    """Return how the camera turns; files of older versions leave the attitude to the a priori one."""
    stored = {name: value for name, value in data["sweep"].items() if name in RowSweep.__slots__}
    sweep: RowSweep = _rebuild(RowSweep, {"camera_from_j2000": data["a_priori_camera_from_j2000"]} | stored)
    return sweep


def _lost_field(values: Mapping[str, Any] | None) -> LostField | None:
    return None if values is None else _rebuild(LostField, values)


def _rebuild(cls: type[Any], values: Mapping[str, Any]) -> Any:
    arrays = {k: np.array(v, dtype=np.float64) if isinstance(v, list) else v for k, v in values.items()}
    return cls(**arrays)


def _star_table(columns: Mapping[str, Any]) -> StarTable:
    """Rebuild the catalog rows; null stands for a number that is not known."""
    text = {"id", "band"}
    arrays: dict[str, Any] = {
        name: np.array(values) if name in text else np.array(values, dtype=np.float64)
        for name, values in columns.items()
        if name != "motion_known"
    }
    arrays["sigma"] = arrays["sigma"].reshape(-1, 5)  # with no star at all, JSON has forgotten the five
    return StarTable(**arrays, motion_known=np.array(columns["motion_known"], dtype=bool))


def inputs_added(before: Inputs | None, inputs: Inputs) -> dict[str, Any]:
    """Return as plain values what `inputs` hold that `before` does not: targets, and the stars of a wide search."""
    known = {} if before is None else before.targets
    targets = {name: _columns(target) for name, target in inputs.targets.items() if name not in known}
    added: dict[str, Any] = {"targets": targets} if targets else {}
    shapes = {name: path for name, path in inputs.shapes.items() if name in targets}
    added |= {"shapes": shapes} if shapes else {}
    units = {name: inputs.shape_units[name] for name in shapes if name in inputs.shape_units}
    added |= {"shape_units": units} if units else {}
    if inputs.wide_stars is not None and (before is None or before.wide_stars is not inputs.wide_stars):
        added["wide_stars"] = _columns(inputs.wide_stars)
    if inputs.lost is not None and (before is None or before.lost is None):
        added["lost"] = _columns(inputs.lost)
    if before is not None and before.catalog_found != inputs.catalog_found:
        added["catalog_found"] = inputs.catalog_found
    return added


def with_inputs_added(inputs: Inputs, added: Mapping[str, Any]) -> Inputs:
    """Return inputs with what `inputs_added` told of a later step."""
    targets = {name: _rebuild(TargetState, target) for name, target in added.get("targets", {}).items()}
    wide = added.get("wide_stars")
    return replace(
        inputs,
        targets=MappingProxyType({**inputs.targets, **targets}),
        wide_stars=inputs.wide_stars if wide is None else _star_table(wide),
        shapes=MappingProxyType({**inputs.shapes, **_path_mapping(added.get("shapes", {}))}),
        lost=_lost_field(added.get("lost")) or inputs.lost,
        shape_units=MappingProxyType({**inputs.shape_units, **added.get("shape_units", {})}),
        catalog_found=added.get("catalog_found", inputs.catalog_found),
    )


def _path_mapping(values: Mapping[str, str]) -> MappingProxyType[str, Path]:
    return MappingProxyType({name: Path(path) for name, path in values.items()})

"""What shall be done with pictures, said in one model that commands, notebooks, nights and queues share.

A field of `Processing` is an option of the commands (``cli.processing_options``), a parameter of the notebooks
(``notebook``), a key of a night's YAML and of a queue's JSON; its description, its default and its allowed values stand
here and nowhere else.
"""

import math
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator, model_validator

from opnav_workbench.catalog import Catalog, open_catalog, read_star_list
from opnav_workbench.errors import SessionError
from opnav_workbench.kernels import KernelSet
from opnav_workbench.kernels.shape_files import SHAPE_FORMATS, UNIT_KM, ShapeFile
from opnav_workbench.landmarks import Maplets
from opnav_workbench.lazy_names import module_on_demand
from opnav_workbench.mission import Mission, load_mission
from opnav_workbench.paths import exists, is_file
from opnav_workbench.session import BODY_METHODS, Settings
from opnav_workbench.session.decisions import Decisions, load_decisions
from opnav_workbench.session.inputs import AttitudeSource
from opnav_workbench.session.star_measurement import FinalMethod, InitialMethod
from opnav_workbench.session.state import BodyMethod
from opnav_workbench.stars.pointing.attitude_steps import PointingModel
from opnav_workbench.yaml_file import Also, check_model

if TYPE_CHECKING:
    from opnav_workbench.session import body_models
else:  # shapes are given now and then
    body_models = module_on_demand("opnav_workbench.session.body_models")

__all__ = [
    "NO_TARGETS",
    "OpenedProcessing",
    "Processing",
    "allowed_values",
    "keep_opened",
    "named_targets",
    "targets_text",
]


# ---- Targets as text: PLUTO:limb_scan,CHARON.

NO_TARGETS = "none"  # as text: an empty one says nothing about targets


def named_targets(targets: str | Iterable[str]) -> dict[str, str]:
    """Return targets with their methods (empty: as for all), from a list such as ``PLUTO:limb_scan,CHARON``.

    Raises
    ------
    ValueError
        A target without a name or with two methods; an unknown method.

    Examples
    --------
    >>> named_targets("PLUTO:limb_scan, CHARON")
    {'PLUTO': 'limb_scan', 'CHARON': ''}
    >>> named_targets("none")
    {}
    """
    parts = targets.split(",") if isinstance(targets, str) else list(targets)
    words = [part.strip() for part in parts if part.strip()]
    if [word.casefold() for word in words] == [NO_TARGETS]:
        return {}
    named: dict[str, str] = {}
    for word in words:
        name, colon, method = (part.strip() for part in word.partition(":"))
        if not name or name.casefold() == NO_TARGETS:
            raise ValueError(f"{word!r} names no target; write NAME or NAME:METHOD, or {NO_TARGETS} alone")
        if colon:
            _check_method(method, f"{name}: ")
        if method and named.get(name, "") not in ("", method):
            raise ValueError(f"{name} is given two methods, {named[name]} and {method}; keep one")
        named[name] = method or named.get(name, "")
    return named


def named_shapes(shapes: str) -> dict[str, str]:
    """Return shape files by body, from a list such as ``BENNU:bennu.obj:m,EROS:eros.plt``.

    Examples
    --------
    >>> named_shapes("BENNU:bennu.obj:m, EROS:eros.plt")
    {'BENNU': 'bennu.obj:m', 'EROS': 'eros.plt'}
    """
    named = {}
    for part in filter(None, (part.strip() for part in shapes.split(","))):
        body, _, file = part.partition(":")
        if not body.strip() or not file.strip():
            raise ValueError(f"{part!r} is no shape of a body; write BODY:FILE, or BODY:FILE:m")
        named[body.strip()] = file.strip()
    if shapes.strip() and not named:
        raise ValueError(f"{shapes!r} names no file; write BODY:FILE")
    return named


def shape_file(text: str) -> ShapeFile:
    """Return a shape file and its unit, from ``bennu.obj`` (km) or ``bennu.obj:m``.

    Examples
    --------
    >>> shape_file("bennu.obj:m").unit, shape_file("bennu.obj").unit
    ('m', 'km')
    """
    path, _, unit = str(text).rpartition(":")
    return ShapeFile(Path(path), unit) if path and unit in UNIT_KM else ShapeFile(Path(str(text)))


def shape_text(path: Path, unit: str) -> str:
    """Return a shape file as `shape_file` reads it."""
    return str(path) if unit == "km" else f"{path}:{unit}"


def targets_text(targets: Iterable[str] | None) -> str:
    """Return targets as `named_targets` reads them; empty where the mission's own are meant.

    Examples
    --------
    >>> targets_text(("PLUTO", "CHARON")), targets_text(()), targets_text(None)
    ('PLUTO,CHARON', 'none', '')
    """
    return "" if targets is None else ",".join(targets) or NO_TARGETS


def _check_method(method: object, where: str = "") -> None:
    if method not in BODY_METHODS:
        raise ValueError(f"{where}unknown method {method!r}; choose one of {', '.join(BODY_METHODS)}")


# ---- Settings as text: max_shift_px=200,max_stars=50.


def settings_of(given: Any) -> dict[str, Any]:
    """Return thresholds that differ from the usual ones, checked.

    Raises
    ------
    ValueError
        A name is no setting, or a value no number.

    Examples
    --------
    >>> settings_of("max_shift_px=200, max_stars=50")
    {'max_shift_px': 200.0, 'max_stars': 50}
    """
    if isinstance(given, str):
        pairs = [part.partition("=") for part in given.split(",") if part.strip()]
        given = {name.strip(): value.strip() for name, _, value in pairs}
    if not isinstance(given, Mapping):
        raise ValueError(  # noqa: TRY004  what pydantic reports
            f"{given!r} is no list of thresholds; write such as max_shift_px=200,max_twist_deg=2"
        )
    usual = Settings().to_dict()
    unknown = [str(name) for name in given if name not in usual]
    if unknown:
        raise ValueError(f"unknown setting {', '.join(unknown)}; settings are {', '.join(sorted(usual))}")
    return {name: _number(name, value, type(usual[name])) for name, value in given.items()}


def _number(name: str, value: Any, kind: type) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number) or isinstance(value, bool):
        raise ValueError(f"{name} is {value!r}; give a number")
    if kind is int and number != int(number):
        raise ValueError(f"{name} is {value!r}; give a whole number")
    return int(number) if kind is int else number


# ---- The model.

# What a wrong value is called.
CHOICES = {
    "method": "method",
    "attitude": "attitude source",
    "model": "pointing model",
    "initial": "method of coarse star centers",
    "centers": "method of star centers",
}


class Processing(BaseModel):
    """How pictures are processed, whoever says it; each field tells what it is.

    Text serves for every field, as shells, papermill and YAML give it: targets and settings are read from lists such as
    ``PLUTO:limb_scan,CHARON`` and ``max_shift_px=200``.  A target's own method goes to `methods`.

    Raises
    ------
    pydantic.ValidationError
        A field is unknown, missing or has a value that is not allowed; `checked` says it in one line.

    Examples
    --------
    >>> how = Processing(mission="new_horizons", targets="PLUTO:limb_scan,CHARON")
    >>> how.targets, how.methods
    (('PLUTO', 'CHARON'), {'PLUTO': 'limb_scan'})
    >>> Processing.checked({"mission": "new_horizons", "model": "eulr"})
    Traceback (most recent call last):
    opnav_workbench.errors.SessionError: processing: model: unknown pointing model 'eulr'; choose one of euler, image_plane
    """

    model_config = ConfigDict(
        extra="forbid", frozen=True, defer_build=True, protected_namespaces=(), allow_inf_nan=False
    )
    path_fields: ClassVar[tuple[str, ...]] = ("target_stars", "decisions")

    mission: str = Field(description="Mission name or mission YAML.")
    kernels: str | None = Field(default=None, description="Metakernel, kernel folder or kernel-set name.")
    catalog: str = Field(default="bundled", description="Catalog spec; see opnav catalog list.")
    targets: Annotated[tuple[str, ...] | None, Also(("string",))] = Field(
        default=None,
        description="Targets, comma-separated, each with its method if wanted (PLUTO:limb_scan,CHARON), or none; "
        "default the mission's, with kernels.",
    )
    method: BodyMethod = Field(default="auto", description="Body centers")
    methods: Annotated[dict[str, BodyMethod], Also(("string",))] = Field(
        default={}, description="Body centers of single targets, by name."
    )
    target_stars: str | None = Field(
        default=None, description="YAML star list; without --targets, its stars are targets."
    )
    shapes: Annotated[dict[str, str], Also(("string",))] = Field(
        default={},
        description="Shape models of bodies, comma-separated, in km unless told (BENNU:bennu.obj:m,EROS:eros.plt).",
    )
    landmarks: Annotated[dict[str, str], Also(("string",))] = Field(
        default={},
        description="Files of maplets of bodies whose landmarks are looked for, comma-separated (BENNU:bennu.npz); "
        "besides, those of the mission.",
    )
    decisions: str | None = Field(
        default=None, description="YAML of an analyst's decisions on stars, bodies and scans."
    )
    attitude: AttitudeSource = Field(default="auto", description="A priori attitude")
    initial: InitialMethod = Field(default="matched_filter", description="Coarse star centers")
    centers: FinalMethod = Field(default="least_squares", description="Star centers")
    model: PointingModel = Field(default="euler", description="Pointing model")
    settings: Annotated[dict[str, float | int], Also(("string",))] = Field(
        default={},
        description="Limits of searches and other thresholds, comma-separated (max_shift_px=200,max_stars=50).",
    )

    @model_validator(mode="before")
    @classmethod
    def _methods_of_targets(cls, values: Any) -> Any:
        """Take the methods that stand with targets to those of single bodies."""
        given = values.get("methods", {}) if isinstance(values, Mapping) else None
        if not isinstance(given, Mapping) or not isinstance(values.get("targets"), str | list | tuple):
            return values
        try:
            named = named_targets(values["targets"])
        except (ValueError, AttributeError):
            return values  # told with the field's name, by its own check
        for name, method in named.items():
            if method and given.get(name, method) != method:
                raise ValueError(f"{name} is given two methods, {method} and {given[name]}; keep one")
        own = {name: method for name, method in named.items() if method}
        return {**values, "targets": tuple(named), "methods": {**given, **own}}

    @field_validator("mission", "kernels", "target_stars", "decisions", mode="before")
    @classmethod
    def _path_as_text(cls, value: Any, info: ValidationInfo) -> Any:
        value = str(value) if isinstance(value, Path) else value
        return None if value == "" and info.field_name != "mission" else value

    @field_validator("targets", mode="before")
    @classmethod
    def _names(cls, value: Any) -> Any:
        return tuple(named_targets(value)) if isinstance(value, str | list | tuple) else value

    @field_validator("methods", mode="before")
    @classmethod
    def _known_methods(cls, value: Any) -> Any:
        named = named_targets(value) if isinstance(value, str) else value
        for name, method in named.items() if isinstance(named, Mapping) else ():
            _check_method(method, f"{name}: ")
        return named

    @field_validator("shapes", mode="before")
    @classmethod
    def _known_shapes(cls, value: Any) -> Any:
        return named_shapes(value) if isinstance(value, str) else value

    @field_validator("landmarks", mode="before")
    @classmethod
    def _known_landmarks(cls, value: Any) -> Any:
        return named_shapes(value) if isinstance(value, str) else value

    @field_validator("settings", mode="before")
    @classmethod
    def _known_settings(cls, value: Any) -> Any:
        return settings_of(value)

    @field_validator(*CHOICES, mode="before")
    @classmethod
    def _known_choice(cls, value: Any, info: ValidationInfo) -> Any:
        field = str(info.field_name)
        allowed = allowed_values(field)
        if value not in allowed:
            raise ValueError(f"unknown {CHOICES[field]} {value!r}; choose one of {', '.join(allowed)}")
        return value

    # -- made, changed, read from elsewhere --------------------------------------------------------------------

    @classmethod
    def checked(cls, values: Mapping[str, Any], what: str = "processing") -> Self:
        """Build the model; what is wrong is said in one line that begins with `what`.

        Raises
        ------
        SessionError
            Field, value and what may stand there.
        """
        return check_model(values, cls, what, SessionError)

    def changed(self, what: str = "processing", **values: Any) -> Self:
        """Return the same with other values, checked; a target keeps its method unless it is given another.

        Raises
        ------
        SessionError
            As `checked`.

        Examples
        --------
        >>> how = Processing(mission="new_horizons", methods={"PLUTO": "limb_scan"})
        >>> how.changed(targets="PLUTO,CHARON:ellipse").methods
        {'PLUTO': 'limb_scan', 'CHARON': 'ellipse'}
        """
        kept = dict(self)
        if "targets" in values and "methods" not in values:
            # What the new targets say outranks, and is not a second method of the same body.
            said = type(self).checked({**kept, "methods": {}, **values}, what)
            return said.changed(what, methods={**self.methods, **said.methods})
        return type(self).checked({**kept, **values}, what)

    @property
    def plain(self) -> "Processing":
        """The same without what a night, a notebook or a queue adds."""
        return Processing.checked({name: getattr(self, name) for name in Processing.model_fields})

    def said(self) -> dict[str, Any]:
        """Return what differs from the defaults, as plain values for YAML and JSON."""
        return self.model_dump(mode="json", exclude_defaults=True)

    def with_full_paths(self, base: Path | None = None) -> Self:
        """Return the same with paths in full, counted from `base`, else from here.

        Kernel sets and missions have names too; what exists as a file or folder is meant as one.
        """
        values = {name: getattr(self, name) for name in (*self.path_fields, "mission", "kernels")}
        places = {name: (base or Path()) / value for name, value in values.items() if value is not None}
        meant = {
            name: place
            for name, place in places.items()
            if name in self.path_fields or (is_file(place) if name == "mission" else exists(place))
        }
        full: dict[str, Any] = {name: str(p.resolve() if base is None else p) for name, p in meant.items()}
        full["shapes"] = {
            body: shape_text(file.path.resolve() if base is None else base / file.path, file.unit)
            for body, file in self.shape_files.items()
        }
        full["landmarks"] = {
            body: str(Path(file).resolve() if base is None else base / file)
            for body, file in self.landmarks.items()
        }
        return self.changed(**full)

    @property
    def shape_files(self) -> dict[str, ShapeFile]:
        """The files of `shapes`."""
        return {body: shape_file(text) for body, text in self.shapes.items()}

    # -- what it stands for ------------------------------------------------------------------------------------

    def kernel_set(self) -> AbstractContextManager[Any]:
        """Return the kernels to work in; without any, those that are open serve, else the header."""
        return KernelSet(self.kernels) if self.kernels else nullcontext()

    def opened(self) -> "OpenedProcessing":
        """Read mission, catalog and decisions, once for all pictures.

        Raises
        ------
        OpNavError
            One of them is not what it should be: refused at once, as it would fail for every picture.
        """
        if (kept := _KEPT.get(repr(self.plain))) is not None:
            return kept
        self._check_files()
        mission = load_mission(self.mission)
        decisions = load_decisions(self.decisions) if self.decisions else Decisions()
        if not decisions.images:  # which may name targets of their own
            self._check_bodies(mission)
        return OpenedProcessing(
            how=self.plain,
            mission=mission,
            catalog=open_catalog(self.catalog),
            decisions=decisions,
        )

    def _check_files(self) -> None:
        """Refuse files of bodies that are not there or cannot be read: only a body that is drawn would tell."""
        for body, file in self.shape_files.items():
            if not is_file(file.path):
                raise SessionError(f"shape of {body}: no file {file.path}; shapes are {SHAPE_FORMATS}.")
            body_models.shape_model(file.path.resolve(), file.unit)
        for body, maplets in self.landmarks.items():
            if not is_file(maplets):
                raise SessionError(
                    f"maplets of {body}: no file {maplets}; make one with opnav landmarks make."
                )
            Maplets.read(maplets)

    def _check_bodies(self, mission: Mission) -> None:
        """Refuse files of bodies that nobody looks for: they would be left without a word."""
        stars = (
            [] if self.target_stars is None else [str(name) for name in read_star_list(self.target_stars).id]
        )
        wanted = {*(mission.default_targets if self.targets is None else self.targets), *stars}
        for option, bodies, known in (
            (
                "shapes",
                self.shapes,
                {*wanted, *mission.default_targets},
            ),  # others of the scene hide and shade
            ("landmarks", self.landmarks, wanted),
        ):
            if unknown := [body for body in bodies if body not in known]:
                raise SessionError(
                    f"{option} of {', '.join(unknown)}: no such target; targets are "
                    f"{', '.join(sorted(known)) or NO_TARGETS}: name it in --targets too, written alike."
                )


def allowed_values(field: str) -> tuple[str, ...]:
    """Return the values that a field of `Processing` may take; none where it is free.

    Examples
    --------
    >>> allowed_values("model"), allowed_values("catalog")
    (('euler', 'image_plane'), ())
    """
    return get_args(Processing.model_fields[field].annotation) if field in CHOICES else ()


@dataclass(frozen=True, slots=True)
class OpenedProcessing:
    """A `Processing` with what it names read once for all pictures."""

    how: Processing
    mission: Mission
    catalog: Catalog
    decisions: Decisions

    @property
    def settings(self) -> Settings:
        """The session's thresholds."""
        return Settings.from_dict(self.how.settings)


# Of a process that pictures are copied from, by what `repr` says: JSON has no words for a path that is no UTF-8.
_KEPT: dict[str, OpenedProcessing] = {}


def keep_opened(how: Processing) -> OpenedProcessing:
    """Open mission, catalog and decisions for this process and its copies, and learn the kernels' digests.

    From now on `Processing.opened` gives the same, whatever becomes of the files.  No kernel is open afterwards.

    Raises
    ------
    OpNavError
        As `Processing.opened`; a kernel is missing or damaged.
    """
    opened = _KEPT[repr(how.plain)] = how.opened()
    if how.kernels:
        for kernel in KernelSet(how.kernels).kernels():
            _ = kernel.sha256  # known as long as the file is the same
    return opened

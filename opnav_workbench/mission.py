"""Missions: which spacecraft, which cameras, and which header keywords mean what.

A mission file is YAML: ``kernels_meta/<name>/mission.yaml``, or any path. It names camera files relative to
itself, and says by header keywords which camera took a picture and that the picture belongs to this mission
at all.
"""

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, PositiveFloat, TypeAdapter

from opnav_workbench.camera import Camera, read_out
from opnav_workbench.errors import CameraError, MissionError
from opnav_workbench.image.header import KeywordMap, header_matches, header_number
from opnav_workbench.paths import is_file, is_folder
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.targets import Photometry, TargetState
from opnav_workbench.yaml_file import StrictModel, read_model

__all__ = ["Mission", "Readout", "TargetSurface", "load_mission", "mission_names"]

FILE_NAME = "mission.yaml"

Value = str | int | float
Keyword = Annotated[str, Field(min_length=1, max_length=80)]
SpanOf = Literal["exposure", "frames"]
KEYWORD_FIELDS = frozenset(field.name for field in fields(KeywordMap))


class _Spacecraft(StrictModel):
    name: str
    id: int


class Readout(StrictModel):
    """Which header words tell the window and the binning of a picture; its camera file describes the whole detector.

    Attributes
    ----------
    binning
        Word, or words along pixel and line, for how many pixels of the detector make one of the picture.
    binning_values
        What its values mean, where they are not that number.
    first_pixel, first_line
        Where the window begins on the detector, counted from `first_is`.
    n_pixel, n_line
        Size of the picture; one of them alone where the other is always the detector's, as of scans.
    line_time
        Time from a line to the next one, of a rolling shutter or line scanner; `rows` of its camera file tell the direction.
    line_time_scale
        Its unit, s: 0.001 of milliseconds.

    A word that the header does not have says that the whole detector was read, pixel by pixel: a picture of another size is
    then refused, and so is a window of which `first_pixel` or `first_line` does not tell the place.
    """

    binning: Keyword | tuple[Keyword, Keyword] | None = None
    binning_values: dict[Value, Annotated[int, Field(ge=1)]] = Field(default_factory=dict)
    first_pixel: Keyword | None = None
    first_line: Keyword | None = None
    n_pixel: Keyword | None = None
    n_line: Keyword | None = None
    first_is: Literal[0, 1] = 0
    line_time: Keyword | None = None
    line_time_scale: PositiveFloat = 1.0

    def told(self, header: Mapping[str, Any]) -> dict[str, Any]:
        """Return binning, first pixel and line, size and line time, as a picture's header says them, for `read_out`.

        Raises
        ------
        CameraError
            A word's value is no number.
        """
        words = (self.binning, self.binning) if isinstance(self.binning, str) else self.binning
        steps = (1, 1) if words is None else (self._factor(header, words[0]), self._factor(header, words[1]))
        starts = [
            0 if w is None or w not in header else _whole(header, w) - self.first_is
            for w in (self.first_pixel, self.first_line)
        ]
        words_of_size = (self.n_pixel, self.n_line)
        named = [w for w in words_of_size if w is not None]
        size = None
        if named and all(w in header for w in named):
            size = tuple(None if w is None else _whole(header, w) for w in words_of_size)
        readout: dict[str, Any] = {"binning": steps, "first": (starts[0], starts[1]), "size": size}
        if self.line_time is not None and self.line_time in header:
            readout["line_time_s"] = _seconds(header, self.line_time) * self.line_time_scale
        return readout

    def check_place(self, header: Mapping[str, Any], camera: Camera, told: Mapping[str, Any]) -> None:
        """Refuse a window whose place on the detector the header does not tell, where the mission file names words for it.

        Parameters
        ----------
        told
            What `told` returns of the header.

        Raises
        ------
        CameraError
            So it is.
        """
        size = told["size"] or (None, None)
        for axis, word in enumerate((self.first_pixel, self.first_line)):
            detector = (camera.n_pixel, camera.n_line)[axis] // max(told["binning"][axis], 1)
            if word is None or word in header or size[axis] in (None, detector) or (axis and camera.scans):
                continue
            raise CameraError(
                f"{camera.name}: the header has no {word}, by which the mission file tells where a window begins, and the "
                f"picture has {size[axis]} of the detector's {detector} {('pixels', 'lines')[axis]}; add it to the header."
            )

    def _factor(self, header: Mapping[str, Any], word: str) -> int:
        if word not in header:
            return 1
        for value, factor in self.binning_values.items():
            if header_matches(header.get(word), value):
                return factor
        return _whole(header, word)


def _seconds(header: Mapping[str, Any], word: str) -> float:
    """A positive number of a header, without its unit."""
    number = header_number(str(header[word]).split("<")[0])
    if number is None or not 0.0 < number < math.inf:
        raise CameraError(f"{word} = {header[word]!r} in the header is no time from a line to the next one.")
    return number


def _whole(header: Mapping[str, Any], word: str) -> int:
    """A whole number of a header."""
    try:
        return int(str(header[word]).split()[0])
    except (KeyError, ValueError, IndexError) as error:
        raise CameraError(
            f"the header has no whole number {word}, which the mission file names for the readout."
        ) from error


class _CameraEntry(StrictModel):
    """A camera of the mission.

    Attributes
    ----------
    file
        Its camera file; a path is relative to the mission file.
    match
        Header words and their values, one or several, that tell its pictures.
    readout
        Which words tell window and binning.
    span_of
        What a header's begin and end enclose: the exposure; or several frames, each of which is exposed so long, as the
        framelets of a push-frame camera are.
    """

    file: str
    match: dict[Keyword, Value | tuple[Value, ...]] = Field(default_factory=dict)
    readout: Readout | None = None
    span_of: SpanOf = "exposure"


class AlbedoMapFile(StrictModel):
    """A map of a target's albedo; the fields are those of `opnav_workbench.render.AlbedoMap.from_file`."""

    file: Path
    darkest: Annotated[float, Field(ge=0.0)] = 0.0
    brightest: Annotated[float, Field(gt=0.0)] = 1.0
    first_longitude_deg: float = 0.0
    east_positive: bool = True
    north_first: bool = True


Part = Annotated[float, Field(gt=0.0, lt=1.0)]


class TargetSurface(StrictModel):
    """How a target's surface looks, where a mission knows more than its brightness, and how well its figure is known.

    Attributes
    ----------
    law
        Scattering law by name, with its parameters: ``{law: lunar_lambert, lunar_weight: 0.5}``.
    shape
        Shape model (OBJ, cmod or DSK); one of the loaded kernels comes first.
    maplets
        Landmarks of the body, a file that ``opnav landmarks make`` writes; pictures are searched for them.
    size_sigma
        1 sigma of the mean radius, as a part of it. By default 0.10, as on a first approach, or a part of that: the picture
        says how much is needed.
    axes_sigma
        1 sigma of each principal axis of the outline beside the common size, as a part of the mean radius: by default
        0.05 or a part of that, with a shape model 0.02.
    limb_roughness
        Root mean square of the topography as a part of the mean radius: by default 0.003, as of the small round moons of
        Saturn; larger moons are smoother, small asteroids rougher by far. One that shows to be more than three times as
        rough is fitted as rough as it shows.
    albedo_sigma
        1 sigma of what whole hemispheres differ by in brightness, as a part of it: by default 0.2, or from a small part of
        that to 0.5 as a picture of the disk has it; with an albedo map 0.05. It makes most of the uncertainty of a center of
        a few pixels.
    law_sigma
        1 sigma of how far the scattering law may lie from `law` toward Lommel-Seeliger's, as a part of the way from
        Lambert's to it: by default 0.3; without a law it lies anywhere between both.
    """

    law: dict[str, Any] | None = None
    albedo_map: AlbedoMapFile | None = None
    shape: Path | None = None
    shape_unit: Literal["km", "m"] = "km"
    maplets: Path | None = None
    size_sigma: Part | None = None
    axes_sigma: Part | None = None
    limb_roughness: Part | None = None
    albedo_sigma: Part | None = None
    law_sigma: Part | None = None


def _checked_keywords(keywords: dict[str, Any]) -> dict[str, Any]:
    """Let `KeywordMap` itself judge its fields."""
    unknown = sorted(set(keywords) - KEYWORD_FIELDS)
    if unknown:
        raise ValueError(f"unknown {', '.join(unknown)}; known are {', '.join(sorted(KEYWORD_FIELDS))}")
    try:
        _keyword_map().validate_python(keywords)
    except MissionError as error:
        raise ValueError(str(error)) from error
    return keywords


@lru_cache(maxsize=1)
def _keyword_map() -> TypeAdapter[KeywordMap]:
    """Made once, when first asked for: it costs as much as reading the file."""
    return TypeAdapter(KeywordMap)


class MissionFile(StrictModel):
    """What the workbench must know of a mission.

    Attributes
    ----------
    spacecraft
        As SPICE knows it.
    clock_id
        Spacecraft clock, SPICE.
    bus_frame
        SPICE frame of the spacecraft bus, the one that its CKs orient.
    reference_body
        Body to which the spacecraft position of the observables' partials refers.
    default_targets
        Bodies that are looked for where nobody names others, with kernels.
    target_photometry
        Brightness of targets by name.
    target_surfaces
        How targets scatter light, by name, their albedo map, shape and maplets, and how well size, axes, limb and law are
        known.
    target_stars
        File of stars that can be targets.
    cameras
        The first whose words match a header took the picture.
    keywords
        Which header words hold what: the arguments of `opnav_workbench.image.KeywordMap`.
    """

    name: str
    spacecraft: _Spacecraft
    clock_id: int
    bus_frame: str
    reference_body: str
    default_targets: tuple[str, ...] = ()
    target_photometry: dict[str, Photometry] = Field(default_factory=dict)
    target_surfaces: dict[str, TargetSurface] = Field(default_factory=dict)
    target_stars: str | None = None
    cameras: Annotated[tuple[_CameraEntry, ...], Field(min_length=1)]
    keywords: Annotated[dict[str, Any], AfterValidator(_checked_keywords)]


@dataclass(frozen=True, slots=True)
class CameraChoice:
    """A camera file, and the header values that tell its pictures.

    Attributes
    ----------
    match : mapping of str to value or tuple of values
        Every keyword must have the value, or one of the values.
    readout
        Which words tell window and binning.
    span_of : {"exposure", "frames"}
        What a header's begin and end enclose: the exposure; or several frames, each of which is exposed so long, as the
        framelets of a push-frame camera are.
    """

    file: Path
    match: Mapping[str, Any]
    readout: Readout | None = None
    span_of: SpanOf = "exposure"


@dataclass(frozen=True, slots=True, eq=False)
class Mission:
    """What the workbench must know of a mission.

    Attributes
    ----------
    path
        The file it was read from.
    spacecraft_name, spacecraft_id
        As SPICE knows them.
    clock_id
        Spacecraft clock, SPICE.
    bus_frame
        SPICE frame of the spacecraft bus, the one that its CKs orient.
    reference_body
        Body to which the spacecraft position of the observables' partials refers.
    target_photometry
        Brightness of targets by name.
    target_surfaces
        How they scatter light, by name, their albedo map and shape, and how well size and shape are known.
    target_stars
        List of stars that can be targets.
    keywords
        Which header keywords hold what: the arguments of `opnav_workbench.image.KeywordMap`.
    """

    name: str
    path: Path
    spacecraft_name: str
    spacecraft_id: int
    clock_id: int
    bus_frame: str
    reference_body: str
    default_targets: tuple[str, ...]
    target_photometry: Mapping[str, Photometry]
    target_surfaces: Mapping[str, TargetSurface]
    target_stars: Path | None
    cameras: tuple[CameraChoice, ...]
    keywords: Mapping[str, Any]

    @property
    def camera_names(self) -> tuple[str, ...]:
        """Names of the camera files."""
        return tuple(choice.file.stem for choice in self.cameras)

    def with_magnitude(self, target: TargetState) -> TargetState:
        """Return `target` with the magnitude seen from the spacecraft, where the mission file knows it."""
        law = self.target_photometry.get(target.name)
        magnitude = None if law is None else law.of(target)
        return target if magnitude is None else replace(target, magnitude=magnitude)

    def camera_named(self, name: str) -> Camera:
        """Return a camera by the stem of its file (``lorri_4x4``) or by its name (``LORRI 4x4``), in any case.

        Raises
        ------
        CameraError
            The mission has no such camera (all are listed).
        """
        for choice in self.cameras:
            camera = Camera.from_yaml(choice.file)
            if name.casefold() in (choice.file.stem.casefold(), camera.name.casefold()):
                return camera
        raise CameraError(
            f"mission {self.name} has no camera {name!r}; it has {', '.join(self.camera_names)}."
        )

    def camera_file(self, camera: Camera) -> Path:
        """Return the file that a camera of this mission was read from.

        Raises
        ------
        CameraError
            The mission has no camera of that name.
        """
        for choice in self.cameras:
            if Camera.from_yaml(choice.file).name == camera.name:
                return choice.file
        raise CameraError(f"mission {self.name} has no camera {camera.name!r}.")

    def camera_for(self, header: Mapping[str, Any]) -> Camera:
        """Return the camera that took a picture: the first whose keywords fit.

        Parameters
        ----------
        header
            Keywords of the picture's header.

        Raises
        ------
        CameraError
            No camera of the mission fits, the picture is of another mission, or the camera file is wrong.

        Examples
        --------
        >>> load_mission("new_horizons").camera_for(
        ...     {"MISSION": "New Horizons", "INSTRU": "lor", "SFORMAT": "4X4"}
        ... ).name
        'LORRI 4x4'
        """
        choice = self._choice_for(header)
        camera = Camera.from_yaml(choice.file)
        if choice.readout is None:
            return camera
        told = choice.readout.told(header)
        read = _read_out(camera, told)
        choice.readout.check_place(header, camera, told)
        return read

    def readout_told(self, header: Mapping[str, Any]) -> dict[str, Any] | None:
        """Return binning, first and size of a picture, as its header says them; None where its camera has one readout.

        Raises
        ------
        CameraError
            No camera of the mission fits, or a word's value is no number.
        """
        choice = self._choice_for(header)
        return None if choice.readout is None else choice.readout.told(header)

    def span_of(self, header: Mapping[str, Any]) -> SpanOf:
        """Return what begin and end of a picture enclose: its exposure, or several frames (`CameraChoice`).

        Raises
        ------
        CameraError
            No camera of the mission fits.
        """
        return self._choice_for(header).span_of

    def camera_as_read(self, name: str, readout: Mapping[str, Any] | None) -> Camera:
        """Return the camera of a name as a readout of `readout_told` leaves it.

        Raises
        ------
        CameraError
            There is no such camera, or the readout is none of it.
        """
        return _read_out(self.camera_named(name), readout)

    def _choice_for(self, header: Mapping[str, Any]) -> CameraChoice:
        required = self.keywords.get("required", {})
        for choice in self.cameras:
            wanted = {**required, **choice.match}
            if all(header_matches(header.get(keyword), value) for keyword, value in wanted.items()):
                return choice
        keywords = sorted({*required, *(keyword for choice in self.cameras for keyword in choice.match)})
        found = ", ".join(f"{k} = {header[k]!r}" if k in header else f"no {k}" for k in keywords)
        raise CameraError(
            f"no camera of mission {self.name} took this picture: its header has {found}; the mission's are "
            f"{', '.join(self.camera_names)}. Choose the mission of this picture "
            f"(--mission), or add its camera to {self.path}."
        )


def _read_out(camera: Camera, readout: Mapping[str, Any] | None) -> Camera:
    if readout is None:
        return camera
    try:
        (binning, first), size = (tuple(map(int, readout[k])) for k in ("binning", "first")), readout["size"]
        return read_out(
            camera,
            binning=(binning[0], binning[1]),
            first=(first[0], first[1]),
            size=None if size is None else (int(size[0] or camera.n_pixel), int(size[1] or camera.n_line)),
            line_time_s=readout.get("line_time_s"),
        )
    except (IndexError, KeyError, TypeError, ValueError) as error:
        raise CameraError(f"{camera.name}: {dict(readout)} is no readout ({error!r}).") from error


def mission_names() -> tuple[str, ...]:
    """Return the names of the missions that come with the package, sorted.

    Examples
    --------
    >>> mission_names()[:6]
    ('cassini', 'clementine', 'dawn', 'galileo', 'generic', 'hayabusa')
    """
    return tuple(sorted(path.parent.name for path in kernels_meta_dir().glob(f"*/{FILE_NAME}")))


def load_mission(name_or_path: str | PathLike[str]) -> Mission:
    """Read a mission by its name, or from a YAML file (or the folder that holds a ``mission.yaml``).

    Raises
    ------
    MissionError
        The name is unknown (the message lists the known and the nearest), or the file breaks the schema.

    Examples
    --------
    >>> load_mission("osiris_rex").spacecraft_id
    -64
    """
    path = _find_mission_file(name_or_path)
    return _mission(read_model(path, MissionFile, "mission file", MissionError), path.resolve())


def _find_mission_file(name_or_path: str | PathLike[str]) -> Path:
    known = mission_names()
    if name_or_path in known:
        return kernels_meta_dir() / str(name_or_path) / FILE_NAME
    path = Path(name_or_path)
    if is_folder(path) and is_file(path / FILE_NAME):
        return path / FILE_NAME
    if is_file(path):
        return path
    close = difflib.get_close_matches(str(name_or_path).lower().replace("-", "_"), known, n=1, cutoff=0.5)
    hint = f" Did you mean {close[0]}?" if close else ""
    raise MissionError(
        f"unknown mission {str(name_or_path)!r}: no mission file, and the names are {', '.join(known)}.{hint}"
    )


def _mission(file: MissionFile, path: Path) -> Mission:
    folder = path.parent
    return Mission(
        name=file.name,
        path=path,
        spacecraft_name=file.spacecraft.name,
        spacecraft_id=file.spacecraft.id,
        clock_id=file.clock_id,
        bus_frame=file.bus_frame,
        reference_body=file.reference_body,
        default_targets=file.default_targets,
        target_photometry=MappingProxyType(file.target_photometry),
        target_surfaces=MappingProxyType(
            {n: _with_files_beside(s, folder) for n, s in file.target_surfaces.items()}
        ),
        target_stars=None if file.target_stars is None else folder / file.target_stars,
        cameras=tuple(
            CameraChoice(folder / c.file, MappingProxyType(c.match), c.readout, c.span_of)
            for c in file.cameras
        ),
        keywords=MappingProxyType(file.keywords),
    )


def _with_files_beside(surface: TargetSurface, folder: Path) -> TargetSurface:
    """Return a surface whose files are relative to the mission file."""
    changes: dict[str, Any] = {}
    if surface.shape is not None:
        changes["shape"] = folder / surface.shape
    if surface.maplets is not None:
        changes["maplets"] = folder / surface.maplets
    if surface.albedo_map is not None:
        changes["albedo_map"] = surface.albedo_map.model_copy(
            update={"file": folder / surface.albedo_map.file}
        )
    return surface.model_copy(update=changes)

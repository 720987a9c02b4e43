"""A new mission in one call: camera, header words, how the detector lies, files; solved and simulated to compare."""

import re
import shutil
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera, Origin, PsfPrior
from opnav_workbench.catalog import open_catalog
from opnav_workbench.commissioning.cameras import (
    NO_WORDS,
    Numbers,
    PictureWords,
    camera_of_kernels,
    camera_of_numbers,
    camera_of_support_data,
    with_rows,
)
from opnav_workbench.commissioning.files import (
    Craft,
    Place,
    able_to_simulate,
    write_camera,
    write_mission,
    write_scenario,
)
from opnav_workbench.commissioning.header_words import (
    HeaderWords,
    header_words,
    instrument_words,
    word_of_lines,
)
from opnav_workbench.commissioning.orientation import (
    Orientation,
    orientation_by_limb,
    orientation_by_stars,
    scanning_cameras,
)
from opnav_workbench.constants import AU_KM
from opnav_workbench.errors import MissionError, OpNavError
from opnav_workbench.geometry import quaternion_from_matrix
from opnav_workbench.image import Header, KeywordMap
from opnav_workbench.image.file_bytes import file_bytes
from opnav_workbench.image.formats.reading import read_stored
from opnav_workbench.kernels import KernelSet, camera_attitude, knows_frame
from opnav_workbench.mission import load_mission, mission_names
from opnav_workbench.paths import exists
from opnav_workbench.scene import body_target, observer_from_kernels
from opnav_workbench.session import ImageSession, Settings
from opnav_workbench.session.context import Context, open_context
from opnav_workbench.session.inputs import mid_exposure_et
from opnav_workbench.simulation import load_picture_scenario, simulate

__all__ = ["NewMission", "Wanted", "new_mission"]

INVENTED = 999  # the spacecraft's number, where nothing tells it
FIRST_UTC = "2030-01-01T00:00:00"
FIRST_POSITION_KM = np.array([1.0, 0.5, 0.2]) * AU_KM
STEM = "camera"  # of the camera file
SIMULATED = "simulated"
SOLVED_STARS = 4  # that a pointing is believed from
LESS_STARS = 0.6  # of those of the best way, that the second may have
NAME = re.compile(r"^[a-z][a-z0-9_-]{0,38}$")


@dataclass(frozen=True, slots=True)
class Wanted:
    """What a person gives for a new mission; None or empty where nothing.

    Attributes
    ----------
    name
        Of the mission: small letters, digits and underscores.
    folder
        Where its files go.
    image
        A picture of the camera.
    instrument_kernels
        Instrument kernels, addenda and frame kernels that describe the camera, in loading order.
    kernels
        Flight kernels of the picture: trajectory and attitude.
    instrument
        NAIF number or part of the name, where the kernels describe several cameras.
    support_data
        Image support data of a picture (ALE's JSON), instead of kernels.
    numbers
        Instead of kernels, or for what they lack.
    target
        Body in the picture, by which its limb tells how the detector lies.
    """

    name: str
    folder: Path
    image: Path | None = None
    instrument_kernels: tuple[str, ...] = ()
    kernels: str | None = None
    instrument: str | None = None
    numbers: Numbers = field(default_factory=Numbers)
    target: str | None = None
    catalog: str = "bundled"
    compare: bool = True
    support_data: Path | None = None


@dataclass(frozen=True, slots=True)
class NewMission:
    """What was made, and what it rests on.

    Attributes
    ----------
    origins
        Of camera and header words: what was known, derived and guessed.
    orientation
        What told how the detector lies, or why nothing did.
    mirrored
        Whether the picture is the mirror image of what the sources made of it.
    solved
        How the picture came out with the new mission; empty without a picture.
    known_mission
        A mission of the package whose header words are those of the picture.
    cautions
        What is wrong with the simulated picture: that nothing solves it, or that it saturates.
    """

    folder: Path
    camera: Camera
    origins: tuple[Origin, ...]
    orientation: str
    mirrored: bool
    solved: str
    pictures: Path
    simulated: tuple[Path, ...] = ()
    known_mission: str = ""
    cautions: tuple[str, ...] = ()


WRITTEN = (
    "mission.yaml",
    "cameras",
    "pictures",
    "star_fields.yaml",
    SIMULATED,
)  # into the folder of a mission


def new_mission(wanted: Wanted, say: Callable[[str], None] | None = None) -> NewMission:
    """Write the files of a mission, with the camera turned as its picture shows it.

    Parameters
    ----------
    say : callable, optional
        Told in words what is being done.

    Raises
    ------
    OpNavError
        What is given does not make a camera, or cannot be read; one line.
    """
    if not NAME.match(wanted.name):
        raise MissionError(
            f"{wanted.name!r} is no name for a mission; take small letters, digits and underscores."
        )
    if (wanted.folder / "mission.yaml").exists():
        raise MissionError(f"{wanted.folder}/mission.yaml is there already; name another folder (--out).")
    with _whole_or_none(wanted.folder):
        return _made(wanted, say or _silent)


@contextmanager
def _whole_or_none(folder: Path) -> Iterator[None]:
    """Take back what a mission that failed has written, so that the command can be given again."""
    stood = {path: exists(path) for path in (folder, *(folder / name for name in WRITTEN))}
    try:
        yield
    except BaseException:
        for path in (path for path, before in stood.items() if not before and path.parent == folder):
            shutil.rmtree(path, ignore_errors=True)
            with suppress(OSError):
                path.unlink(missing_ok=True)
        if not stood[folder]:
            with suppress(OSError):  # another put something there meanwhile
                folder.rmdir()
        raise


def _made(wanted: Wanted, say: Callable[[str], None]) -> NewMission:
    if wanted.image is None:
        camera, told = _camera(wanted, None)
        return _Maker(wanted, _craft(wanted, camera, told), {}, say).without_picture(camera)
    shape, header = _looked_at(wanted.image)
    words = header_words(header)
    camera, told = _camera(wanted, shape, PictureWords(*instrument_words(header)))
    maker = _Maker(
        wanted,
        _craft(wanted, camera, words.spacecraft or told),
        words.match,
        say,
        word_of_lines(header, shape[0]),
    )
    made = maker.with_picture(camera, wanted.image, words)
    return replace(made, known_mission=_known_mission(header))


def _known_mission(header: Header) -> str:
    """The mission of the package that a picture's words name, if there is one."""
    for name in mission_names():
        mission = load_mission(name)
        if mission.keywords.get("required"):
            with suppress(OpNavError):
                mission.camera_for(header)
                return name
    return ""


def _silent(_words: str) -> None:
    """Tell nobody."""


def _looked_at(image: Path) -> tuple[tuple[int, int], Header]:
    """Shape and header of a picture, before any mission is known."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # told where the picture is opened with its mission
        _, stored = read_stored(image, file_bytes(image), KeywordMap())
    lines, pixels = stored.image.shape[-2:]
    return (int(lines), int(pixels)), Header(stored.header)


def _camera(
    wanted: Wanted, shape: tuple[int, int] | None, words: PictureWords = NO_WORDS
) -> tuple[Camera, str]:
    """The camera, and the spacecraft's name where what describes the camera tells it."""
    if wanted.support_data is not None:
        return camera_of_support_data(wanted.support_data, wanted.name, shape)
    if wanted.instrument_kernels:
        camera = camera_of_kernels(wanted.instrument_kernels, wanted.instrument, shape, wanted.numbers, words)
    else:
        camera = camera_of_numbers(wanted.name, -(INVENTED * 1000 + 100), shape, wanted.numbers)
    camera = with_rows(camera, wanted.numbers)
    name = f"{wanted.name} {camera.name}" if wanted.instrument_kernels else wanted.name
    return replace(camera, name=name), ""


def _craft(wanted: Wanted, camera: Camera, told: str) -> Craft:
    """Names and numbers of the spacecraft, which a picture may have told."""
    number = -(abs(camera.instrument_id) // 1000)
    name = re.sub(r"[^A-Z0-9 _-]", " ", (told or wanted.name).upper()).strip()[:32]
    return Craft(
        wanted.name, name or wanted.name.upper(), number, f"{wanted.name.upper()}_BUS", number * 1000
    )


@dataclass(frozen=True, slots=True)
class _Maker:
    wanted: Wanted
    craft: Craft
    match: dict[str, Any]
    say: Callable[[str], None]
    lines: str = "NAXIS2"  # the word for a picture's lines, of which scans have any number

    def write(
        self, camera: Camera, keywords: dict[str, Any] | None, told: str, folder: Path | None = None
    ) -> None:
        """Write mission and camera files."""
        heading, folder = f"Made by `opnav mission new`. {told}", folder or self.wanted.folder
        write_camera(folder, STEM, camera, heading)
        lines = self.lines if camera.scans else ""
        write_mission(folder, self.craft, STEM, keywords, self.match, heading, lines)

    # -- without a picture -------------------------------------------------------------------------------------

    def without_picture(self, camera: Camera) -> NewMission:
        told = "no picture has shown how the detector lies; what was guessed stands under origins"
        camera = able_to_simulate(camera)
        self.write(camera, None, f"Without a picture: {told}.")
        rows = camera.rows
        exposure_s = abs(rows.line_time_s) if rows is not None and rows.scans else 1.0
        place = Place(FIRST_UTC, exposure_s, FIRST_POSITION_KM, np.array([-10.0, 25.0, 5.0]))
        pictures = write_scenario(self.wanted.folder, self.craft, STEM, camera, place, self.wanted.catalog)
        files, cautions = self.simulated(pictures)
        return NewMission(
            self.wanted.folder, camera, camera.origins, told, False, "", pictures, files, cautions=cautions
        )

    # -- with a picture ----------------------------------------------------------------------------------------

    def with_picture(self, camera: Camera, image: Path, words: HeaderWords) -> NewMission:
        keywords = dict(words.keywords)
        self.write(camera, keywords, "Being tried on a picture.")
        with self.kernels():
            self.say("reading the picture")
            context = open_context(image, load_mission(self.wanted.folder), Settings())
            found = (
                self.scan_orientation(context, image, keywords)
                if camera.scans
                else self.orientation(context, words.keywords.get("target"))
            )
            if found is not None:
                camera = _turned(camera, found, image.name)
                if found.inverse_quaternion:
                    keywords["quaternion_sense"] = _other_sense(keywords["quaternion_sense"])
            told = NOT_TOLD if found is None else found.text
            self.write(camera, keywords, f"How the detector lies: {told}.")
            solved, place, session = self.solved(image, words)
        if session is not None:
            camera = _measured(camera, session, image.name)
            if found is not None:
                camera = replace(camera, confirmed_by=f"{image.name}: {solved}")
            self.write(camera, keywords, f"How the detector lies: {told}.")
        # With guesses that a picture's own processing must not rest on
        aside = self.wanted.folder / SIMULATED
        self.write(able_to_simulate(camera), keywords, "To simulate pictures with.", aside)
        pictures = write_scenario(aside, self.craft, STEM, camera, place, self.wanted.catalog)
        origins = (*camera.origins, *_header_origins(words, found, keywords))
        mirrored = found is not None and found.mirrored
        files, cautions = self.simulated(pictures)
        return NewMission(
            self.wanted.folder, camera, origins, told, mirrored, solved, pictures, files, cautions=cautions
        )

    def kernels(self) -> AbstractContextManager[object]:
        """The flight kernels with those of the instrument, if any are given."""
        if self.wanted.kernels is None:
            return nullcontext()
        return KernelSet([self.wanted.kernels, *self.wanted.instrument_kernels])

    def orientation(self, context: Context, word: str | None) -> Orientation | None:
        """By the stars, else by the limb of the target: the one wanted, or the one that a word of the header names."""
        frames = _frames(context)
        self.say("looking for stars")
        with suppress(OpNavError):
            found = orientation_by_stars(context, open_catalog(self.wanted.catalog), frames)
            if found is not None:
                return found
        target = self.wanted.target or (str(context.picture.header[word]) if word else "")
        if KernelSet.active() is None or not frames or not target:
            return None
        self.say(f"comparing {target} with eight drawings")
        with suppress(OpNavError):
            et = mid_exposure_et(context)
            observer = observer_from_kernels(self.craft.number, et)
            seen = body_target(target, self.craft.number, et)
            return orientation_by_limb(context, seen, observer, frames[0])
        return None

    def scan_orientation(self, context: Context, image: Path, keywords: dict[str, Any]) -> Orientation | None:
        """By the motion that the kernels tell, which makes the lines, and the stars, which tell the pixels' sense.

        Stars identified without any attitude need a frame, and a scan is none without its motion: so both ways that the
        motion leaves are solved, and the one with more stars is kept.
        """
        found: list[tuple[int, Camera]] = []
        ways = scanning_cameras(context.camera, mid_exposure_et(context)) if KernelSet.active() else []
        for number, camera in enumerate(ways):
            self.say(f"solving the scan, way {number + 1} of {len(ways)}")
            self.write(camera, keywords, "Being tried on a picture.")
            with suppress(OpNavError):
                session = ImageSession.open(image, self.wanted.folder, catalog=self.wanted.catalog)
                session.predict()
                session.find_stars()
                session.repoint()
                pointing = session.state.pointing
                if pointing is not None and pointing.n_stars >= SOLVED_STARS:
                    found.append((pointing.n_stars, camera))
        found.sort(key=lambda way: -way[0])
        if not found or (len(found) > 1 and found[1][0] > LESS_STARS * found[0][0]):
            return None
        stars, camera = found[0]
        hands = [np.sign(np.linalg.det(c.focal_from_camera)) for c in (camera, context.camera)]
        changed = not np.allclose(camera.focal_from_camera, context.camera.focal_from_camera)
        second = found[1][0] if len(found) > 1 else 0
        text = f"{stars} stars lie where the motion of the scan puts them; in the second of {len(ways)} ways {second}"
        return Orientation(camera, changed, hands[0] != hands[1], True, text)

    def solved(self, image: Path, words: HeaderWords) -> tuple[str, Place, ImageSession | None]:
        """Solve the picture with the new mission: what came out, where to simulate it, and the session, if solved."""
        place = Place(words.utc or FIRST_UTC, words.exposure_s or 1.0, FIRST_POSITION_KM, np.zeros(3))
        self.say("solving the picture")
        try:
            session = ImageSession.open(image, self.wanted.folder, catalog=self.wanted.catalog)
            inputs, exposure_s = session.inputs, session.context.picture.exposure_s
            place = Place(
                inputs.utc.removesuffix("Z").removesuffix(" UTC"),
                exposure_s if exposure_s > 0.0 else place.exposure_s,  # no word tells it: nan
                np.asarray(inputs.observer.position_km),
                np.asarray(inputs.observer.velocity_km_s),
                quaternion_from_matrix(inputs.a_priori_camera_from_j2000),
            )
            session.predict()
            session.find_stars()
            session.repoint()
        except OpNavError as error:
            return f"not solved: {error}", place, None
        pointing = session.state.pointing
        if pointing is None or pointing.n_stars < SOLVED_STARS:
            return "not solved: too few stars", place, None
        place = replace(place, quaternion=quaternion_from_matrix(pointing.camera_from_j2000))
        return f"solved with {pointing.n_stars} stars, rms {pointing.rms_px:.3f} px", place, session

    def simulated(self, pictures: Path) -> tuple[tuple[Path, ...], tuple[str, ...]]:
        """Simulate the picture to compare: its files, and what is wrong with it."""
        if not self.wanted.compare:
            return (), ()
        self.say("simulating a picture")
        (report,) = simulate(load_picture_scenario(pictures), self.wanted.folder / SIMULATED, jobs=1)
        return report.files, report.cautions


def _header_origins(
    words: HeaderWords, found: Orientation | None, keywords: dict[str, Any]
) -> tuple[Origin, ...]:
    """Where the words of the header come from; the sense of a quaternion is told by the stars, where they tell all."""
    if found is None or not found.sure or "quaternion" not in keywords:
        return words.origins
    text = f"{', '.join(keywords['quaternion'])}, {keywords['quaternion_sense']}: the picture agrees with it"
    others = tuple(o for o in words.origins if o.field != "quaternion")
    return (*others, Origin("quaternion", "derived", text))


def _turned(camera: Camera, found: Orientation, image: str) -> Camera:
    """The camera with the axes that a picture tells, and where they come from."""
    others = tuple(o for o in camera.origins if o.field != "focal_from_camera")
    axes = found.camera.focal_from_camera
    shown = np.array2string(axes[:2].round(6) + 0.0, separator=", ").replace("\n", "")
    how = Origin(
        "focal_from_camera",
        "derived" if found.sure else "guessed",
        f"pixel, line {shown}, by {image}: {found.text}",
    )
    return replace(camera, focal_from_camera=axes, origins=(*others, how))


def _measured(camera: Camera, session: ImageSession, image: str) -> Camera:
    """The camera with brightness and width of the stars that a picture was solved with."""
    state, exposure_s = session.state, session.context.picture.exposure_s
    if state.a_priori is None or state.centers is None:
        return camera
    used = np.array([star.status == "used" for star in state.status])
    flux = state.centers.flux_dn[used]
    told, origins = dict[str, Any](), list(camera.origins)
    if exposure_s > 0.0 and camera.zero_point_mag is None and (flux > 0.0).all():
        offsets = state.a_priori.mag[used] + 2.5 * np.log10(flux / exposure_s)
        told["zero_point_mag"] = round(float(np.median(offsets)), 3)
        text = f"{told['zero_point_mag']:.2f}, by {len(flux)} stars of {image}, scatter {np.std(offsets):.2f} mag"
        origins.append(Origin("zero_point_mag", "derived", text))
    widths = np.sqrt(state.centers.shape[used, 0] * state.centers.shape[used, 1])
    width, scatter = float(np.median(widths)), float(np.std(widths))
    told["psf"] = PsfPrior(round(width, 3), round(max(0.05, scatter), 3))
    origins.append(Origin("psf", "derived", f"sigma {width:.2f} px, by the stars of {image}"))
    return replace(camera, **told, origins=tuple(origins))


NOT_TOLD = "neither stars nor a limb told it: as the kernel says, or guessed (see origins)"


def _other_sense(sense: str) -> str:
    return "camera_to_j2000" if sense == "j2000_to_camera" else "j2000_to_camera"


def _frames(context: Context) -> list[FloatArray]:
    """How kernels or header say that the camera's frame stands; of a quaternion both senses, the likelier first."""
    frame, kernels = context.camera.frame, KernelSet.active()
    if kernels is not None:
        with suppress(OpNavError):
            if knows_frame(frame):
                return [np.asarray(camera_attitude(frame, mid_exposure_et(context)))]
    geometry = context.picture.header_geometry
    if geometry is None or geometry.camera_from_j2000 is None:
        return []
    stated = np.asarray(geometry.camera_from_j2000)
    return [stated, stated.T]

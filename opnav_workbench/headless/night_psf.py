"""The effective PSF that a night's own pictures teach it, kept beside its results.

Flow   pictures of an undersampled camera -> solved, the first pass -> one effective PSF with its covariance -> mission file
Files  OUT/.psf/<digest of mission and camera files>/{mission.yaml, <camera>.yaml, <camera>_effective_psf.npz, learned.json}

All pictures of the night are then processed with that mission file, so that their fingerprints, sessions and results hold
what was learned, in whatever order they are done; ``opnav process -m`` takes it too.  What was learned stays: another night
in the same folder uses it again, and other mission or camera files have another digest, so that nothing old is used with
them.  Which pictures teach depends on their contents only.

Reference: Anderson & King (2000), doi:10.1086/316632.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from opnav_workbench.calibration import MAX_EFFECTIVE_SIGMA_PX
from opnav_workbench.camera import Camera
from opnav_workbench.errors import OpNavError, SessionError
from opnav_workbench.files import digest, make_folder, read_json, sha256_of, write_json, write_text
from opnav_workbench.headless.inputs import named_file, with_named_files
from opnav_workbench.headless.night_spec import NightSpec, pictures_of_night
from opnav_workbench.image import KeywordMap, read_image
from opnav_workbench.mission import CameraChoice, Mission, load_mission
from opnav_workbench.processing.star_pictures import (
    effective_psf_of,
    isolation_px,
    sessions_alike,
    solve_star_pictures,
)
from opnav_workbench.psf import EffectivePsf
from opnav_workbench.version import __version__
from opnav_workbench.yaml_nodes import compose, plain_value, yaml_text

__all__ = ["LearnedPsf", "learn_night_psf", "with_kept_psf"]

PSF_FOLDER = ".psf"
MISSION_FILE, RECORD_FILE = "mission.yaml", "learned.json"
PSF_SUFFIX = "_effective_psf.npz"
DIGEST_LETTERS = 12
MIN_PICTURES, MAX_PICTURES = 4, 24  # fewer do not tell how pictures differ; more add little: the exam's night
MAX_PIXELS = 8_000_000  # of all pictures that teach, which are held together
LOOKED_AT = 200  # pictures whose headers are read to find those of a camera
AGAIN_FROM = 2.0  # times the pictures of the last try, where that taught nothing


@dataclass(frozen=True, slots=True)
class LearnedPsf:
    """What came of a camera.

    Attributes
    ----------
    camera
        Stem of its file.
    psf
        None where nothing could be learned.
    why
        The reason then.
    """

    camera: str
    psf: EffectivePsf | None
    why: str = ""

    @property
    def words(self) -> str:
        """One line for a person."""
        if self.psf is None:
            return f"{self.camera}: every picture learns its PSF alone ({self.why})"
        return (
            f"{self.camera}: PSF of sigma {self.psf.sigma_px:.2f} px learned from {self.psf.n_stars} stars of "
            f"{len(self.psf.pictures)} pictures"
        )


def with_kept_psf(spec: NightSpec, out: str | Path) -> NightSpec:
    """Return the night with the mission file that holds what its pictures taught, where they did."""
    if not spec.learn_psf:
        return spec
    mission = load_mission(spec.mission)
    if not _undersampled(mission):
        return spec
    folder = _folder(out, mission)
    if not (folder / MISSION_FILE).is_file():
        return spec
    record, here = _record(folder), {"mission_file": str(mission.path)}
    if record | here != record:  # the mission has moved: what is kept names its files
        _write_files(
            folder, mission, [p.name.removesuffix(PSF_SUFFIX) for p in folder.glob(f"*{PSF_SUFFIX}")]
        )
        write_json(folder / RECORD_FILE, record | here)
    return spec.changed("night", mission=str(folder / MISSION_FILE))


def learn_night_psf(
    spec: NightSpec, out: str | Path, say: Callable[[str, str], None] = lambda _name, _words: None
) -> tuple[LearnedPsf, ...]:
    """Learn the effective PSF of a night's undersampled cameras and keep it, unless that was done before.

    Parameters
    ----------
    out
        Folder of the night's results.
    say
        Called with a picture's name and a few words.

    Returns
    -------
    tuple of LearnedPsf
        Of what was tried now.

    Raises
    ------
    OpNavError
        Mission, kernels or catalog cannot be opened, or the folder cannot be written.
    """
    if not spec.learn_psf:
        return ()
    mission = load_mission(spec.mission)
    choices = _undersampled(mission)
    if not choices:
        return ()
    folder = _folder(out, mission)
    images = pictures_of_night(spec)
    if (folder / MISSION_FILE).is_file() or len(images) < AGAIN_FROM * _tried(folder):
        return ()
    teaching = _teaching(images, mission, choices)
    found = tuple(_learned(spec, name, pictures, say) for name, pictures in teaching.items())
    if found:
        _keep(make_folder(folder), mission, found, len(images))
    return found


# ---- Which pictures teach.


def _undersampled(mission: Mission) -> dict[str, CameraChoice]:
    """Cameras, by the stem of their files, whose light within a pixel no single star tells, and no file yet."""
    cameras = {choice.file.stem: (choice, Camera.from_yaml(choice.file)) for choice in mission.cameras}
    return {
        name: choice
        for name, (choice, camera) in cameras.items()
        if camera.psf.sigma_px < MAX_EFFECTIVE_SIGMA_PX and camera.effective_psf is None
    }


def _teaching(
    images: Sequence[Path], mission: Mission, choices: Mapping[str, CameraChoice]
) -> dict[str, list[Path]]:
    """Pictures of each camera, whole pixels only, chosen by their contents; cameras with enough of them."""
    cameras = {name: Camera.from_yaml(choice.file) for name, choice in choices.items()}
    found: dict[str, list[Path]] = {name: [] for name in choices}
    for image in _by_content(images)[:LOOKED_AT]:
        try:
            picture = read_image(image, KeywordMap(**mission.keywords))
            taken = mission.camera_for(picture.header)
        except (OpNavError, OSError):  # processing will say what is wrong with it
            continue
        for name, camera in cameras.items():
            most = min(MAX_PICTURES, max(MAX_PIXELS // (camera.n_pixel * camera.n_line), MIN_PICTURES))
            whole = taken.name == camera.name and taken.psf.sigma_px == camera.psf.sigma_px
            if whole and len(found[name]) < most:
                found[name].append(image)
    return {name: pictures for name, pictures in found.items() if len(pictures) >= MIN_PICTURES}


def _by_content(images: Sequence[Path]) -> list[Path]:
    """Pictures in an order that neither their names nor their places have a say in, each content once."""
    by_sum: dict[str, Path] = {}
    for image in images:
        try:
            by_sum.setdefault(sha256_of(image), image)
        except OSError:  # gone, or unreadable for now
            continue
    return [by_sum[key] for key in sorted(by_sum)]


def _learned(
    spec: NightSpec, camera: str, images: Sequence[Path], say: Callable[[str, str], None]
) -> LearnedPsf:
    opened = spec.plain.changed("night", targets=()).opened()
    try:
        with spec.kernel_set():
            solved = solve_star_pictures(images, opened, say, least_stars=1)
        alike = sessions_alike(solved.sessions)
        if len(alike) < MIN_PICTURES:
            return LearnedPsf(camera, None, f"{len(alike)} solved pictures alike, {MIN_PICTURES} are needed")
        say(camera, "learning the PSF")
        return LearnedPsf(camera, effective_psf_of(alike, isolation_px(alike[0].context.camera)))
    except OpNavError as error:
        return LearnedPsf(camera, None, str(error))
    except Exception as error:  # a defect of ours must not cost the night
        return LearnedPsf(camera, None, f"unforeseen {type(error).__name__}: {error}")


# ---- What is kept.


def _folder(out: str | Path, mission: Mission) -> Path:
    """Where a night keeps what it learned with these mission and camera files."""
    files = dict.fromkeys(with_named_files(mission.path))
    told = [(path.name, sha256_of(path)) for path in files]
    return Path(out).resolve() / PSF_FOLDER / digest(told)[:DIGEST_LETTERS]


def _record(folder: Path) -> dict[str, Any]:
    """Return what is told of what was learned; empty where there is nothing, or it is damaged."""
    if not (folder / RECORD_FILE).is_file():
        return {}
    try:
        return read_json(folder / RECORD_FILE, "delete it")
    except SessionError:
        return {}


def _tried(folder: Path) -> int:
    """Return how many pictures the night had when it learned nothing; 0: not tried yet."""
    tried = _record(folder).get("pictures", 0)
    return tried if isinstance(tried, int) else 0


def _keep(
    folder: Path,
    mission: Mission,
    found: Sequence[LearnedPsf],
    n_pictures: int,
) -> None:
    """Write what was learned; the mission file last, as it says that the others are whole."""
    told = {
        one.camera: {
            "why": one.why,
            "pictures": [] if one.psf is None else list(one.psf.pictures),
            "n_stars": 0 if one.psf is None else one.psf.n_stars,
        }
        for one in found
    }
    write_json(
        folder / RECORD_FILE,
        {
            "version": __version__,
            "pictures": n_pictures,
            "cameras": told,
            "mission_file": str(mission.path),
        },
    )
    for one in found:
        if one.psf is not None:
            one.psf.save(folder / f"{one.camera}{PSF_SUFFIX}")
    names = [one.camera for one in found if one.psf is not None]
    if names:
        _write_files(folder, mission, names)


def _write_files(folder: Path, mission: Mission, names: Sequence[str]) -> None:
    """Write camera files that name what was learned, and a mission file that names them."""
    sources = {choice.file.stem: choice.file for choice in mission.cameras}
    content = _with_full_paths(_content(mission.path), mission.path.parent)
    for name in names:
        source = sources[name]
        camera = _with_full_paths(_content(source), source.parent)
        camera["psf"]["effective"] = f"{name}{PSF_SUFFIX}"
        _write_yaml(folder / source.name, camera)
        for entry in content["cameras"]:
            if Path(entry["file"]).resolve() == source.resolve():
                entry["file"] = source.name
    _write_yaml(folder / MISSION_FILE, content)


def _content(path: Path) -> dict[str, Any]:
    content: dict[str, Any] = plain_value(compose(yaml_text(path)))
    return content


def _write_yaml(path: Path, content: Mapping[str, Any]) -> None:
    write_text(path, yaml.safe_dump(dict(content), sort_keys=False, allow_unicode=True))


def _with_full_paths(value: Any, base: Path) -> Any:
    """Return a YAML file's content for another folder: what names a file beside it has its path in full."""
    if isinstance(value, Mapping):
        return {name: _with_full_paths(item, base) for name, item in value.items()}
    if isinstance(value, list):
        return [_with_full_paths(item, base) for item in value]
    named = named_file(base, value) if isinstance(value, str) else None
    return value if named is None else str(named.resolve())

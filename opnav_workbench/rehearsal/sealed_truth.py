"""The sealed truth of a rehearsal: written encrypted, opened with the director's key and in no other way.

The plain text is JSON, padded so that its length tells nothing. ``ort.yaml`` holds its SHA-256: nobody can put
another truth in its place, and because the text begins with random digits, nobody can guess at truths until one
fits. The truth in turn holds the SHA-256 of what ``ort.yaml`` tells the team.

The log of reveals says what stood in a team's files when the truth was opened, so that a later change shows as
such. It is the director's: a file beside the key, a line of JSON a reveal.
"""

import hashlib
import io
import json
import os
import secrets
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from cryptography.fernet import Fernet, InvalidToken

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.errors import OpNavError, SessionError
from opnav_workbench.files import atomic_path, json_value, plain_values, sha256_of, text_of, write_text
from opnav_workbench.paths import is_file
from opnav_workbench.rehearsal.package import PICTURE_FOLDER, OrtPackage
from opnav_workbench.simulation import Truth
from opnav_workbench.simulation.charge import CosmicRayHits
from opnav_workbench.simulation.truth import (
    ATTITUDE_FIELDS,
    PLAIN_FIELDS,
    objects_from_ecsv,
    truth_from_values,
)

__all__ = [
    "Delivery",
    "OrtTruth",
    "SealedTruth",
    "log_path",
    "logged_delivery",
    "picture_truth_values",
    "reveal",
    "seal",
]


# ---- What a picture truly shows, as plain values inside the sealed truth, and back.

HIT_FIELDS = ("start_px", "end_px", "electrons")
HIT_DECIMALS = 2  # of a pixel: tracks are for the eye


def picture_truth_values(truth: Truth) -> dict[str, Any]:
    """Return a picture's truth as plain values, without the noiseless picture."""
    table = io.StringIO()
    truth.objects.write(table, format="ascii.ecsv")
    return {
        **{name: getattr(truth, name) for name in (*PLAIN_FIELDS, *ATTITUDE_FIELDS)},
        "picture": truth.picture.name,
        "objects": table.getvalue(),
        "cosmic_rays": {name: getattr(truth.cosmic_rays, name).round(HIT_DECIMALS) for name in HIT_FIELDS},
    }


def picture_truth_from_values(values: Mapping[str, Any], folder: Path) -> Truth:
    """Return the truth of a picture that stands, or stood, in `folder`."""
    objects = objects_from_ecsv(values["objects"].splitlines())
    start, end, electrons = (np.array(values["cosmic_rays"][name], dtype=np.float64) for name in HIT_FIELDS)
    hits = CosmicRayHits(start.reshape(-1, 2), end.reshape(-1, 2), electrons)
    return truth_from_values(folder / values["picture"], values, objects, None, hits)


# ---- The sealed truth of a rehearsal: written encrypted, opened with the director's key and in no other way.

TRUTH_FORMAT = "opnav-ort-truth/1"
# Padded to this, or to twice, four times ... as much: what storms and stars add does not show
SHORTEST_CHARS = 1 << 18
KEY_MODE = 0o600
SALT_BYTES = 32


@dataclass(frozen=True, slots=True, eq=False)
class OrtTruth:
    """What was true in a rehearsal; arrays are read-only.

    Attributes
    ----------
    parameters : mapping of str to (3,) array
        By the package's parameters: true minus predicted at its epoch, km or km/s, J2000; zero where nothing was changed.
    predicted_state_km, relative_state_km : (6,) arrays
        Spacecraft relative to the body of the B-plane at the epoch, km and km/s, J2000, geometric: as predicted, and
        truly.
    b_plane
        ``b_dot_t_km``, ``b_dot_r_km``, ``time_of_flight_s``: each ``predicted``, ``true`` and ``shift``, in the axes of the
        predicted B-plane; the time counts from the epoch and is linearised.
    states_km : mapping of str to (6,) array
        By picture: spacecraft truly relative to that body at mid-exposure, geometric.
    pictures
        By picture, the lost ones too: attitudes, stars and bodies; without the noiseless picture.
    lost
        Why a picture holds nothing usable.
    attitude_errors : mapping of str to (3,) array
        By picture: true minus predicted, px, px, deg, as the pointing solution states it.
    words
        What was perturbed, for people.
    scenario
        As it was read.
    orbit
        Of a rehearsal in orbit: ``body_step`` (4,) and ``map_log`` (3,), what makes rotation and map right,
        ``predicted_place_km`` (3,), where the spacecraft truly is at the time of the prediction, and ``places_km``, where
        the landmarks truly are (body-fixed), by name. Empty of a flyby.
    """

    parameters: Mapping[str, FloatArray]
    predicted_state_km: FloatArray
    relative_state_km: FloatArray
    b_plane: Mapping[str, Mapping[str, float]]
    states_km: Mapping[str, FloatArray]
    pictures: Mapping[str, Truth]
    lost: Mapping[str, str]
    attitude_errors: Mapping[str, FloatArray]
    camera_errors: Mapping[str, float]
    words: tuple[str, ...]
    seed: int
    scenario: Mapping[str, Any]
    orbit: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True)
class SealedTruth:
    """An encrypted truth, the key that opens it, and the SHA-256 of the plain text."""

    token: bytes
    key: bytes
    commitment: str


def seal(truth: Mapping[str, Any], public_sha256: str) -> SealedTruth:
    """Encrypt a truth with a key made for it alone.

    Parameters
    ----------
    truth
        Fields of `OrtTruth`; pictures as `picture_truth_values` gives them.
    public_sha256
        Of what the package tells the team.
    """
    salt = secrets.token_hex(SALT_BYTES)
    head = {"salt": salt, "format": TRUTH_FORMAT, "public_sha256": public_sha256}
    text = json.dumps(plain_values(head | dict(truth)), allow_nan=False, ensure_ascii=True)
    room = SHORTEST_CHARS
    while room < len(text):
        room *= 2
    plain = text.ljust(room).encode("ascii")
    key = Fernet.generate_key()
    return SealedTruth(Fernet(key).encrypt(plain), key, hashlib.sha256(plain).hexdigest())


def write_key(path: Path, key: bytes) -> None:
    """Write the director's key: readable by its owner alone, whole or not at all.

    Raises
    ------
    SessionError
        The folder cannot be written.
    """
    with atomic_path(path, KEY_MODE) as temporary, temporary.open("wb") as stream:
        stream.write(key + b"\n")
        stream.flush()
        os.fsync(stream.fileno())


def reveal(package: "OrtPackage", key: str | os.PathLike[str] | None = None) -> OrtTruth:
    """Open the truth of a rehearsal: the only way to it.

    Parameters
    ----------
    key : path, optional
        The director's key file; default ``DIR.key`` beside the package's folder.

    Raises
    ------
    SessionError
        The key is missing, wrong or no key; the sealed truth or ``ort.yaml`` is not the one that was made.
    """
    values = _decrypted(package, Path(package.key_path if key is None else key))
    if values.get("format") != TRUTH_FORMAT:
        raise SessionError(
            f"the truth of {package.folder} has format {values.get('format')!r}, this version reads {TRUTH_FORMAT!r}; "
            "open it with the version that made it."
        )
    if values["public_sha256"] != package.public_sha256:
        raise SessionError(
            f"{package.folder / 'ort.yaml'} is not the one that was made with this truth: it was altered. Get the package "
            "again from its director."
        )
    return _truth_of_values(values, package)


def _decrypted(package: "OrtPackage", key: Path) -> dict[str, Any]:
    try:
        secret = key.read_bytes().strip()
    except OSError as error:
        raise SessionError(
            f"no key {key} ({error.strerror or error}): the truth stays sealed. The rehearsal's director has the key; "
            "give its path."
        ) from error
    try:
        token = package.sealed.read_bytes()
        plain = Fernet(secret).decrypt(token)
    except OSError as error:
        raise SessionError(
            f"the sealed truth {package.sealed} cannot be read: {error.strerror or error}."
        ) from error
    except (InvalidToken, ValueError) as error:
        raise SessionError(
            f"{key} does not open {package.sealed}: it is the key of another rehearsal, or one of both is damaged; ask the "
            "director for the key of this one."
        ) from error
    if hashlib.sha256(plain).hexdigest() != package.commitment:
        raise SessionError(
            f"{package.sealed} is not the truth that ort.yaml was made with; get the package again from its director."
        )
    return dict(json.loads(plain))


def _truth_of_values(values: Mapping[str, Any], package: OrtPackage) -> OrtTruth:
    pictures = {
        name: picture_truth_from_values(content, package.folder / PICTURE_FOLDER)
        for name, content in values["pictures"].items()
    }
    return OrtTruth(
        parameters=_arrays(values["parameters"]),
        predicted_state_km=np.array(values["predicted_state_km"]),
        relative_state_km=np.array(values["relative_state_km"]),
        b_plane=values["b_plane"],
        states_km=_arrays(values["states_km"]),
        pictures=pictures,
        lost=values["lost"],
        attitude_errors=_arrays(values["attitude_errors"]),
        camera_errors=values["camera_errors"],
        words=tuple(values["words"]),
        seed=int(values["seed"]),
        scenario=values["scenario"],
        orbit=values.get("orbit", {}),
    )


def _arrays(values: Mapping[str, Any]) -> dict[str, FloatArray]:
    arrays = {name: np.array(value, dtype=np.float64) for name, value in values.items()}
    for array in arrays.values():
        array.setflags(write=False)
    return arrays


# ---- The log of reveals.

LOG_SUFFIX = ".reveals.jsonl"
DELIVERED_FILES = ("result.json", "observables.ecsv")


@dataclass(frozen=True, slots=True)
class Delivery:
    """What a team had delivered when the truth was opened for it.

    Attributes
    ----------
    utc
        Of this reveal.
    files
        SHA-256 by path in the team's folder.
    altered
        Files that differ from those at the first reveal for this folder.
    opened_before
        UTC of earlier reveals, for any folder.
    """

    utc: str
    files: Mapping[str, str]
    altered: tuple[str, ...]
    opened_before: tuple[str, ...]


def log_path(key: str | Path) -> Path:
    """Return the log that belongs to a key file."""
    return Path(key).with_name(Path(key).name + LOG_SUFFIX)


@contextmanager
def logged_delivery(
    key: str | Path, package: str, run: str | Path, names: Sequence[str], solution: Path
) -> Iterator[Delivery]:
    """Write down what a team has delivered; the truth is opened inside. If that fails, the line is taken back.

    Parameters
    ----------
    key
        Key file of the package; the log stands beside it.
    run
        The team's folder.
    names
        Of the pictures.
    solution
        The team's solution file.

    Raises
    ------
    SessionError
        There is no such key, or the log cannot be read or written: then the truth must not be opened.
    """
    if not is_file(key):
        raise SessionError(f"no key {key}; the director of the rehearsal has it. Give it with --key.")
    folder, path = Path(run).resolve(), log_path(key)
    files = {
        str(f.relative_to(folder) if f.is_relative_to(folder) else f): sha256_of(f)
        for f in [
            solution.resolve(),
            *(folder / name / counted for name in names for counted in DELIVERED_FILES),
        ]
        if f.is_file()
    }
    earlier = _read_log(path)
    first = next((entry["files"] for entry in earlier if entry["run"] == str(folder)), files)
    altered = tuple(sorted(name for name in {*first, *files} if first.get(name) != files.get(name)))
    now = datetime.now(UTC).isoformat(timespec="seconds")
    entry = {"utc": now, "package": package, "run": str(folder), "files": files}
    _write_log(path, [*earlier, entry])
    try:
        yield Delivery(now, files, altered, tuple(str(line["utc"]) for line in earlier))
    except OpNavError:
        _write_log(path, earlier)
        raise


def _write_log(path: Path, entries: Sequence[Mapping[str, Any]]) -> None:
    write_text(path, "".join(json.dumps(entry) + "\n" for entry in entries))


def _read_log(path: Path) -> list[dict[str, Any]]:
    if not path.is_file():
        return []
    try:
        return [json_value(line) for line in text_of(path).splitlines() if line.strip()]
    except (OSError, ValueError) as error:
        raise SessionError(
            f"the log of reveals {path} cannot be read ({error}); without it nobody can tell what was delivered blind."
        ) from error

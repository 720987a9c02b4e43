"""The sealed truth of a rehearsal: written encrypted, opened with the director's key and in no other way.

The plain text is JSON, padded so that its length tells nothing. ``ort.yaml`` holds its SHA-256: nobody can put another
truth in its place, and because the text begins with random digits, nobody can guess at truths until one fits. The truth
in turn holds the SHA-256 of what ``ort.yaml`` tells the team.
"""

import hashlib
import json
import os
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from cryptography.fernet import Fernet, InvalidToken

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.errors import SessionError
from opnav_workbench.files import atomic_path, plain_values
from opnav_workbench.rehearsal.ort_truth_pictures import truth_from_values
from opnav_workbench.simulation import Truth

if TYPE_CHECKING:
    from opnav_workbench.rehearsal.ort_package_open import OrtPackage

__all__ = ["OrtTruth", "SealedTruth", "reveal", "seal"]

FORMAT = "opnav-ort-truth/1"
SHORTEST_CHARS = (
    1 << 18
)  # padded to this, or to twice, four times ... as much: what storms and stars add does not show
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
    b_plane : mapping of str to mapping
        ``b_dot_t_km``, ``b_dot_r_km``, ``time_of_flight_s``: each ``predicted``, ``true`` and ``shift``, in the axes of the
        predicted B-plane; the time counts from the epoch and is linearised.
    states_km : mapping of str to (6,) array
        By picture: spacecraft truly relative to that body at mid-exposure, geometric.
    pictures : mapping of str to Truth
        By picture, the lost ones too: attitudes, stars and bodies; without the noiseless picture.
    lost : mapping of str to str
        Why a picture holds nothing usable.
    attitude_errors : mapping of str to (3,) array
        By picture: true minus predicted, px, px, deg, as the pointing solution states it.
    camera_errors : mapping of str to float
    words : tuple of str
        What was perturbed, for people.
    seed : int
    scenario : mapping
        As it was read.
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
    truth : mapping
        Fields of `OrtTruth`; pictures as `truth_values` gives them.
    public_sha256 : str
        Of what the package tells the team.
    """
    salt = secrets.token_hex(SALT_BYTES)
    head = {"salt": salt, "format": FORMAT, "public_sha256": public_sha256}
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
    with atomic_path(path) as temporary:
        temporary.chmod(KEY_MODE)
        with temporary.open("wb") as stream:
            stream.write(key + b"\n")
            stream.flush()
            os.fsync(stream.fileno())


def reveal(package: "OrtPackage", key: str | os.PathLike[str] | None = None) -> OrtTruth:
    """Open the truth of a rehearsal: the only way to it.

    Parameters
    ----------
    package : OrtPackage
    key : path, optional
        The director's key file; default ``DIR.key`` beside the package's folder.

    Raises
    ------
    SessionError
        The key is missing, wrong or no key; the sealed truth or ``ort.yaml`` is not the one that was made.
    """
    values = _opened(package, Path(package.key_path if key is None else key))
    if values.get("format") != FORMAT:
        raise SessionError(
            f"the truth of {package.folder} has format {values.get('format')!r}, this version reads {FORMAT!r}; open it "
            "with the version that made it."
        )
    if values["public_sha256"] != package.public_sha256:
        raise SessionError(
            f"{package.folder / 'ort.yaml'} is not the one that was made with this truth: it was altered. Get the package "
            "again from its director."
        )
    return _truth(values, package)


def _opened(package: "OrtPackage", key: Path) -> dict[str, Any]:
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


def _truth(values: Mapping[str, Any], package: "OrtPackage") -> OrtTruth:
    pictures = {
        name: truth_from_values(content, package.folder / "pictures")
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
    )


def _arrays(values: Mapping[str, Any]) -> dict[str, FloatArray]:
    arrays = {name: np.array(value, dtype=np.float64) for name, value in values.items()}
    for array in arrays.values():
        array.setflags(write=False)
    return arrays

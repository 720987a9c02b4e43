"""Random numbers by name: every effect has a stream of its own, so that switching one changes no other."""

import zlib
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from opnav_workbench.errors import MissionError

__all__ = ["STREAMS", "camera_random", "picture_random"]

# A number, once given, is never given to another effect: published pictures could not be made again.
STREAMS: Mapping[str, int] = MappingProxyType(
    {
        "attitude_error": 0,
        "shot_noise": 1,
        "read_noise": 2,
        "dark_current": 3,
        "cosmic_rays": 4,
        "lost_data": 5,
        "jitter": 6,
        "dark_columns": 7,
        "bias_pattern": 20,
        "hot_pixels": 21,
        "dead_pixels": 22,
        "prnu": 23,
        "flat_error": 24,
        "dark_pattern": 25,
        "hot_leak": 26,
    }
)


def picture_random(seed: int, stream: str) -> np.random.Generator:
    """Return the generator of one effect in one picture.

    Parameters
    ----------
    seed
        Of the picture, not negative.
    stream
        A name of `STREAMS`.

    Raises
    ------
    MissionError
        A negative seed.

    Examples
    --------
    >>> first, second = (picture_random(7, "shot_noise").random() for _ in range(2))
    >>> first == second
    True
    """
    if seed < 0:
        raise MissionError(f"seed {seed} is negative; give 0 or a positive whole number.")
    return np.random.default_rng([seed, STREAMS[stream]])


def camera_random(camera_name: str, stream: str) -> np.random.Generator:
    """Return the generator of a fixed pattern: the same for every picture of the camera, whatever its seed."""
    return np.random.default_rng([seed_of_name(camera_name), STREAMS[stream]])


def seed_of_name(name: str) -> int:
    """Return the number by which a name enters a seed."""
    return zlib.crc32(name.encode())

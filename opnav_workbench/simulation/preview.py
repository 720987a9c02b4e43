"""Preview pictures: what was simulated, as a PNG that any program shows, line 0 at the top.

``linear`` shows bodies as a person would see them; ``log`` brings up the stars and the noise, as in the paper's Figure 2.
"""

from pathlib import Path
from typing import Literal, get_args

import numpy as np
from astropy.stats import mad_std
from astropy.visualization import LogStretch
from numpy.typing import NDArray
from PIL import Image

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import MissionError
from opnav_workbench.files import atomic_path

__all__ = ["Stretch", "stretched", "write_preview"]

Stretch = Literal["linear", "log"]
LOG_LOW_SIGMAS = -2.0  # the noise is seen as dark grain
LOG_STRENGTH = 1000.0  # astropy's own default
LEAST_RANGE_SIGMAS = {"linear": 20.0, "log": 300.0}  # an empty picture's noise must not look like stars
COMPRESSION = 1  # noise hardly packs: the usual level takes three times as long for a file an eighth smaller


def stretched(image_dn: FloatArray, stretch: Stretch = "linear") -> NDArray[np.uint8]:
    """Return gray levels (n_line, n_pixel) of a picture.

    Examples
    --------
    >>> stretched(np.eye(3)).tolist()[0]
    [255, 0, 0]
    """
    if stretch not in get_args(Stretch):
        raise MissionError(f"unknown stretch {stretch!r}; use {' or '.join(get_args(Stretch))}.")
    level, noise = float(np.median(image_dn)), float(mad_std(image_dn))
    low = level + LOG_LOW_SIGMAS * noise if stretch == "log" else level
    high = max(float(image_dn.max()), level + LEAST_RANGE_SIGMAS[stretch] * noise, low + np.spacing(low))
    share = np.clip((image_dn - low) / (high - low), 0.0, 1.0)
    if stretch == "log":
        share = LogStretch(LOG_STRENGTH)(share)
    return np.asarray(np.rint(255.0 * share), dtype=np.uint8)


def write_preview(path: Path, image_dn: FloatArray, stretch: Stretch) -> None:
    """Write a preview, whole or not at all.

    Raises
    ------
    SessionError
        The folder cannot be written.
    """
    picture = Image.fromarray(stretched(image_dn, stretch))
    with atomic_path(path) as temporary:
        picture.save(temporary, format="PNG", compress_level=COMPRESSION)

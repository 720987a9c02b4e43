"""What a front end without a live kernel shows: a message, and the picture as it was."""

import base64
import io
from collections.abc import Callable
from typing import Any

import numpy as np
from PIL import Image

from opnav_workbench.arrays import FloatArray
from opnav_workbench.widgets.stretch import shades

__all__ = ["MESSAGE", "frame_png", "with_picture"]

LONGEST_PX = 360  # with 16 shades a noisy frame stays below 50 kB, half of what a notebook may weigh
SHADES = 16

MESSAGE = (
    "opnav_workbench: this view needs a running kernel. Open the notebook in JupyterLab and run its cells; "
    "every decision is kept in the session's folder."
)


def with_picture(bundle: Any, picture: Callable[[], bytes] | None) -> Any:
    """Return a widget's MIME bundle with the message as its text, and message and picture as HTML."""
    data, metadata = bundle if isinstance(bundle, tuple) else (bundle, {})
    data = dict(data) | {"text/plain": MESSAGE}
    if picture is not None:
        png = base64.b64encode(picture()).decode()
        data["text/html"] = (
            f'<p><em>{MESSAGE}</em></p><img src="data:image/png;base64,{png}" alt="the picture">'
        )
    return data, metadata


def frame_png(image_dn: FloatArray, low_dn: float, high_dn: float) -> bytes:
    """Return a frame (n_line, n_pixel) as a small gray PNG, reduced and with few shades so that notebooks stay small."""
    n_line, n_pixel = image_dn.shape
    factor = max(1, -(-max(n_line, n_pixel) // LONGEST_PX))
    padded = np.pad(image_dn, [(0, -size % factor) for size in image_dn.shape], mode="edge")
    height, width = (size // factor for size in padded.shape)
    small = padded.reshape(height, factor, width, factor).mean(axis=(1, 3))
    shade = np.rint(shades(small, low_dn, high_dn) * (SHADES - 1)).astype(np.uint8)
    picture = Image.fromarray(shade, mode="P")
    picture.putpalette([round(255 * level / (SHADES - 1)) for level in range(SHADES) for _ in "rgb"])
    stream = io.BytesIO()
    picture.save(stream, "PNG", optimize=True, bits=4)
    return stream.getvalue()

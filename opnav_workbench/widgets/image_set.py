"""The pictures of a view: the frame itself, and others to blink it against; each one's pixels are sent once."""

import json
from collections.abc import Callable
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.errors import OpNavError
from opnav_workbench.widgets.bridge import Bridge
from opnav_workbench.widgets.stretch import limits_of

__all__ = ["FRAME", "ImageSet"]

FRAME = "data"  # key of the frame itself
MAX_UINT16 = 65535


class ImageSet:
    """Pictures by key, in the bridge's document; their labels and limits in the view's state.

    Parameters
    ----------
    bridge : Bridge
    state : ViewState
    """

    def __init__(self, bridge: Bridge, state: Any) -> None:
        self._bridge, self._state = bridge, state
        self._pixels: dict[str, Any] = {}
        self._told: dict[str, dict[str, Any]] = {}
        self._makers: dict[str, tuple[Callable[[], FloatArray], bool]] = {}

    def limits(self, name: str) -> tuple[float, float]:
        """Limits of the frame by their name, DN."""
        low, high = self._told[FRAME]["limits"][name]
        return low, high

    def put(
        self, key: str, image_dn: ArrayLike, label: str, usable: BoolArray | None, same_limits: bool
    ) -> None:
        """Add or replace a picture; see `ImageView.set_image`."""
        image = np.asarray(image_dn)
        n_pixel, n_line = json.loads(self._state.setup)["size"]
        if image.shape != (n_line, n_pixel):
            raise OpNavError(f"picture {key!r} has shape {image.shape}; the frame has {n_pixel} x {n_line}.")
        limits = self._told[FRAME]["limits"] if same_limits else limits_of(image, usable)
        with self._bridge.batch():
            column = {"dn": [_compact(image)]}
            if key in self._pixels:
                self._pixels[key].data = column
            else:
                self._pixels[key] = ColumnDataSource(column, name=f"opnav-pixels:{key}")
                self._bridge.document.add_root(self._pixels[key])
            self._tell({key: {"label": label or key, "limits": limits, "ready": True}})

    def offer(self, key: str, label: str, make: Callable[[], FloatArray], same_limits: bool) -> None:
        """Offer a picture that is made when the analyst first asks for it."""
        self._makers[key] = make, same_limits
        self._tell({key: {"label": label, "limits": {}, "ready": False}})

    def make(self, key: str) -> None:
        """Make a picture that was offered, if it is not up to date."""
        if key in self._makers and not self._told[key]["ready"]:
            make, same_limits = self._makers[key]
            self.put(key, make(), self._told[key]["label"], None, same_limits)

    def outdate(self) -> None:
        """The session has changed: what is made from it is made anew when it is asked for."""
        for key in self._makers:
            self._told[key]["ready"] = False
        self._tell({})
        self.make(self._state.image)

    def forget(self) -> None:
        """Drop all pictures."""
        for source in self._pixels.values():
            source.data = {"dn": []}
        self._told, self._makers = {}, {}
        self._state.image = FRAME

    def _tell(self, images: dict[str, dict[str, Any]]) -> None:
        self._told |= images
        self._state.images = json.dumps(self._told)


def _compact(image: np.ndarray) -> np.ndarray:
    """Return the smallest type that holds the picture: counts as uint16, anything else as float32."""
    whole = np.isfinite(image).all() and (image == np.floor(image)).all()
    counts = whole and image.min() >= 0 and image.max() <= MAX_UINT16
    return np.ascontiguousarray(image.astype(np.uint16 if counts else np.float32))

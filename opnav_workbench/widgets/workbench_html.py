"""Small pieces of HTML for the workbench's regions; every text goes through `text`, so that none can break the page."""

import base64
import html
import io

import numpy as np
from PIL import Image

from opnav_workbench.arrays import FloatArray
from opnav_workbench.widgets.actions import Action

__all__ = ["button", "gray_png", "image", "residual_png", "text"]

ASINH_SOFTENING = 0.1  # of the range: faint wings are seen beside a bright core
RESIDUAL_SIGMAS = 5.0  # full color of the residual picture
MASKED = (128, 128, 128)
# Residual pictures run from blue through white to orange, which color-blind readers can tell apart.
BELOW, ABOVE = (33, 102, 172), (214, 96, 0)


def text(value: object) -> str:
    """Return a value as HTML text.

    Examples
    --------
    >>> text("a < b & c")
    'a &lt; b &amp; c'
    """
    return html.escape(str(value), quote=True)


def button(
    action: Action,
    *,
    arg: str | None = None,
    on: bool = False,
    enabled: bool = True,
    label: str | None = None,
) -> str:
    """Return a button that does an action; its key stands on it, its tooltip says what it does."""
    key = f"<kbd>{text(action.shown_key)}</kbd>" if action.keys else ""
    argument = "" if arg is None else f' data-arg="{text(arg)}"'
    return (
        f'<button type="button" data-act="{text(action.name)}"{argument} title="{text(action.hint)}"'
        f' aria-pressed="{"true" if on else "false"}"{"" if enabled else " disabled"}>'
        f"{text(label or action.label)}{key}</button>"
    )


def image(png: str, width: int, height: int, title: str) -> str:
    """Return an image element of PNG data (base64), drawn with sharp pixels."""
    return (
        f'<img class="ow-pixels" src="data:image/png;base64,{png}" width="{width}" height="{height}"'
        f' title="{text(title)}" alt="{text(title)}">'
    )


def gray_png(image_dn: FloatArray, low_dn: float, high_dn: float) -> str:
    """Return a picture (n_line, n_pixel) in an asinh stretch as PNG, base64; not-finite pixels are mid-gray."""
    shown = np.isfinite(image_dn)
    share = np.clip((np.where(shown, image_dn, low_dn) - low_dn) / max(high_dn - low_dn, 1e-12), 0.0, 1.0)
    value = np.arcsinh(share / ASINH_SOFTENING) / np.arcsinh(1.0 / ASINH_SOFTENING)
    gray = np.where(shown, np.rint(255.0 * value), MASKED[0]).astype(np.uint8)
    return _base64(Image.fromarray(gray))


def residual_png(residual_dn: FloatArray, full_dn: float) -> str:
    """Return a residual picture as PNG, base64: white is zero, blue below, orange above; masked pixels are gray."""
    shown = np.isfinite(residual_dn)
    share = np.clip(np.where(shown, residual_dn, 0.0) / max(full_dn, 1e-12), -1.0, 1.0)[..., None]
    ends = np.where(share < 0.0, np.array(BELOW), np.array(ABOVE))
    color = np.where(shown[..., None], 255.0 + np.abs(share) * (ends - 255.0), np.array(MASKED))
    return _base64(Image.fromarray(np.rint(color).astype(np.uint8)))


def _base64(picture: Image.Image) -> str:
    stream = io.BytesIO()
    picture.save(stream, "PNG", optimize=False, compress_level=1)
    return base64.b64encode(stream.getvalue()).decode("ascii")

"""HTML pages that open anywhere, offline: one style for all, small figures inside."""

import base64
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader
from PIL import Image

__all__ = ["figure_url", "render_page"]

COLORS = 48  # enough for charts; a page of hundreds of them stays light


def render_page(template: str, filters: dict[str, Callable[..., str]], **content: Any) -> str:
    """Return a page from a template of this folder, which includes ``page_style.css``."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= filters
    return environment.get_template(template).render(**content)


def figure_url(picture: Image.Image) -> str:
    """Return a figure with few colors as a data URL."""
    stream = io.BytesIO()
    picture.convert("RGB").quantize(COLORS).save(stream, "png", optimize=True)
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()

"""Figures as PNG: one resolution for all, and files that are whole or not there."""

import io
from pathlib import Path

from matplotlib.figure import Figure

from opnav_workbench.files import atomic_path

__all__ = ["png_bytes", "write_png"]

DPI = 110


def png_bytes(figure: Figure) -> bytes:
    """Return a figure as a PNG."""
    stream = io.BytesIO()
    figure.savefig(stream, dpi=DPI, format="png")
    return stream.getvalue()


def write_png(figure: Figure, path: str | Path) -> None:
    """Write a figure as a PNG, whole or not at all."""
    picture = png_bytes(figure)
    with atomic_path(path) as temporary:
        temporary.write_bytes(picture)

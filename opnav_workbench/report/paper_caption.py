"""A figure with its number and caption, as a notebook shows it."""

import base64
import html
from dataclasses import dataclass

from matplotlib.figure import Figure

from opnav_workbench.report.png import png_bytes

__all__ = ["CaptionedFigure", "captioned"]

IMAGE_STYLE = "display:block;margin:0 auto;max-width:100%"
CAPTION_STYLE = "max-width:62em;margin:0.5em auto 0.2em;line-height:1.35"


@dataclass(frozen=True, slots=True, eq=False)
class CaptionedFigure:
    """A figure with its number and caption, as a notebook shows it.

    Attributes
    ----------
    png : bytes
    number : str
        "Figure 4".
    caption : str
        Plain text.
    """

    png: bytes
    number: str
    caption: str

    def _repr_html_(self) -> str:
        picture = base64.b64encode(self.png).decode("ascii")
        words = f"<b>{html.escape(self.number)}.</b> {html.escape(self.caption)}"
        name = html.escape(self.number, quote=True)
        return (
            f'<div><img alt="{name}" style="{IMAGE_STYLE}" src="data:image/png;base64,{picture}"/>'
            f'<p style="{CAPTION_STYLE}">{words}</p></div>'
        )


def captioned(figure: Figure, number: str, caption: str) -> CaptionedFigure:
    """Return a figure with its caption; the last expression of a notebook's cell shows it.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> shown = captioned(Figure(figsize=(1.0, 1.0)), "Figure 4", "A star.")
    >>> "<b>Figure 4.</b> A star." in shown._repr_html_()
    True
    """
    return CaptionedFigure(png_bytes(figure), number, caption)

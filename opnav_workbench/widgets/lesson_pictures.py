"""Figures of lessons with their captions, and figures that follow sliders where a person can move them."""

import base64
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from opnav_workbench.report.png import png_bytes
from opnav_workbench.widgets.workbench_html import text

__all__ = ["Exploration", "Picture", "has_person"]

Values = Mapping[str, tuple[Sequence[Any], Any]]  # by name: what a slider may take, and where it starts


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure with its caption, as a notebook shows it.

    Attributes
    ----------
    png : bytes
    caption : str
    """

    png: bytes
    caption: str

    def __repr__(self) -> str:
        return f"[figure] {self.caption}"

    def _repr_html_(self) -> str:
        data, words = base64.b64encode(self.png).decode(), text(self.caption)
        return (
            '<figure style="margin:0.3em 0;max-width:1000px">'
            f'<img src="data:image/png;base64,{data}" alt="{words}" style="max-width:100%;height:auto">'
            f'<figcaption style="padding:0.4em 0;opacity:0.85"><em>{words}</em></figcaption></figure>'
        )


class Exploration:
    """A figure that is drawn anew when a slider moves; without a person it is the first figure.

    Parameters
    ----------
    draw : callable
        Takes the sliders' values by name, returns a matplotlib figure.
    caption : str
    values : mapping of str to (choices, start)
        What each slider may take, and where it starts.
    live : bool
        With sliders; a still picture without.
    """

    def __init__(self, draw: Callable[..., Figure], caption: str, values: Values, *, live: bool) -> None:
        for name, (choices, start) in values.items():
            if start not in list(choices):
                raise ValueError(f"slider {name!r} starts at {start}, which is not among its choices")
        self._draw, self.values = draw, values
        self.still = Picture(self.png(**{name: start for name, (_, start) in values.items()}), caption)
        self.sliders: dict[str, Any] = {}
        self._widget = self._make_widget() if live else None

    def png(self, **values: Any) -> bytes:
        """Draw the figure for given values."""
        figure = self._draw(**values)
        picture = png_bytes(figure)
        figure.clear()
        return picture

    def _make_widget(self) -> Any:
        import ipywidgets  # noqa: PLC0415 - only where there is a person

        shown = ipywidgets.Image(value=self.still.png, format="png", layout={"max_width": "1000px"})
        for name, (choices, start) in self.values.items():
            options = [(_label(choice), choice) for choice in choices]
            self.sliders[name] = ipywidgets.SelectionSlider(
                options=options,
                value=start,
                description=name.replace("_", " "),
                continuous_update=False,
                style={"description_width": "initial"},
                layout={"width": "420px"},
            )

        def redraw(_: Any) -> None:
            shown.value = self.png(**{name: slider.value for name, slider in self.sliders.items()})

        for slider in self.sliders.values():
            slider.observe(redraw, names="value")
        caption = ipywidgets.HTML(f"<em>{text(self.still.caption)}</em>")
        return ipywidgets.VBox([*self.sliders.values(), shown, caption])

    def __repr__(self) -> str:
        return repr(self.still)

    def _repr_mimebundle_(self, **kwargs: Any) -> Any:
        still = {"text/plain": repr(self.still), "text/html": self.still._repr_html_()}
        if self._widget is None:
            return still
        bundle = self._widget._repr_mimebundle_(**kwargs)
        data, metadata = bundle if isinstance(bundle, tuple) else (bundle, {})
        return dict(data) | still, metadata


def has_person() -> bool:
    """Tell whether a person sits at the front end of this kernel.

    JupyterLab and its like let a running cell ask its user for input and say so in every request; papermill and
    nbconvert do not.
    """
    from IPython import get_ipython  # noqa: PLC0415 - only in a notebook

    shell = get_ipython()
    request = shell.get_parent() if hasattr(shell, "get_parent") else None
    return bool(((request or {}).get("content") or {}).get("allow_stdin", False))


def _label(choice: Any) -> str:
    # + 0 makes a negative zero an ordinary one
    return f"{choice + 0:g}" if isinstance(choice, int | float | np.number) else str(choice)

"""Small pieces of HTML for the workbench's pages; every text goes through `text`, so that none can break the page.

Also what a front end without a live kernel shows in place of a widget: a message, and the picture as it was.
"""

import base64
import html
from collections.abc import Callable
from typing import Any

from opnav_workbench.workbench.actions import Action

__all__ = ["button", "image", "text", "with_still_picture"]


# ---- Small pieces of HTML for the workbench's regions; every text goes through `text`, so that none can ...


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


# ---- What a front end without a live kernel shows: a message, and the picture as it was.

NO_KERNEL_MESSAGE = (
    "opnav_workbench: this view needs a running kernel. Open the notebook in JupyterLab and run its cells; "
    "every decision is kept in the session's folder."
)


def with_still_picture(bundle: Any, picture: Callable[[], bytes] | None) -> Any:
    """Return a widget's MIME bundle with the message as its text, and message and picture as HTML."""
    data, metadata = bundle if isinstance(bundle, tuple) else (bundle, {})
    data = dict(data) | {"text/plain": NO_KERNEL_MESSAGE}
    if picture is not None:
        png = base64.b64encode(picture()).decode()
        data["text/html"] = (
            f'<p><em>{NO_KERNEL_MESSAGE}</em></p><img src="data:image/png;base64,{png}" alt="the picture">'
        )
    return data, metadata

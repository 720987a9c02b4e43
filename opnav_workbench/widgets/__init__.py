"""What an analyst touches: the workbench in JupyterLab.  Imported only where there is a notebook."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from opnav_workbench.widgets.bridge import Bridge
    from opnav_workbench.widgets.image_view import ImageView
    from opnav_workbench.widgets.workbench_app import workbench

__all__ = ["Bridge", "ImageView", "workbench"]

# Loaded on first use: nothing of bokeh or ipywidgets is imported before something is to be shown.
_HOMES = {"Bridge": "bridge", "ImageView": "image_view", "workbench": "workbench_app"}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module  # noqa: PLC0415

    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})

"""The workbench in JupyterLab: what an analyst touches.  Imported only where there is a notebook.

Come in by `workbench` (a session, several, a list of images or a campaign), by `ImageView` (the picture alone), or by
`Bridge` (any bokeh document kept in step with the page); lessons by `lessons.Lesson`. Nothing of bokeh or ipywidgets is
imported before one of them is asked for.

Opening
``app``
    `workbench`, and the notebook's widgets around the picture.
``parameters``
    The checked parameters of workbench.ipynb.
``image_queue``
    The list of images: where each stands, opened when its turn comes.

Deciding
``controller``
    The workbench without a browser: events in, HTML out.
``actions``
    Every action with its keys, label and tooltip.
``tabs``
    What every tab has, and the runner of steps that the tabs share.
``stars_tab``
    Star boxes accepted and rejected.
``field_depth``
    The catalog's depth against the picture's, and what fetches what is missing.
``pointing_tab``
    The solution, two stars marked by hand, the nudge.
``bodies_tab``
    Body centers by every method.
``circle_tool``
    The analyst's circle of a body.
``description``
    How a body that no ephemeris knows is lit, and how far it is.
``limb_scan_choice``
    Limb scans chosen by number, click or box, and their page.
``landmarks_tab``
    Landmarks: patch beside drawing beside correlation, accepted and rejected as stars are.
``exports``
    The marks as a DS9 region file, the picture with its solved WCS as FITS.
``observables_tab``
    Observables, export, notes, journal.

Writing the pages
``markup``
    Templates filled in, scripts and styles, and the message without a kernel.
``recent``
    What was made of the last few states, for an undo that comes back to one.
``plots``
    Small plots, and the residuals of the stars.
``status_line``
    What happened last, in plain words; errors and their log.

The picture
``viewer``
    What the workbench asks of the picture: a protocol.
``image_view``
    The picture of a session, and what it is blinked against.
``view_models``
    The bokeh models of a view: glyphs, themes, state.
``overlays``
    Stars, bodies, masks and sky grid as plain tables.
``readout``
    RA and Dec under the cursor, as series that the page evaluates.
``inspection``
    What is measured by hand in a picture: an aperture's sum, center and width; the compass.
``laying``
    Another image laid over the one at hand, by the sky or by pixels.
``stretch``
    From DN to shades: stretches, limits, colour maps, PNGs.
``sent_arrays``
    Pixels on their way to the pages, piece by piece.
``bridge``
    One bokeh document kept in step with every page.

Teaching
``lessons``
    Exercises, answers judged with hints, figures with sliders.

templates/ holds the HTML of the tabs and of the regions around them (jinja2), static/ the page's side: scripts and styles
of the regions (region.js, workbench.css), of ``bridge`` and of ``image_view``.
"""

from typing import TYPE_CHECKING

from opnav_workbench.lazy_names import names_on_demand
from opnav_workbench.parts import told

if TYPE_CHECKING:
    from opnav_workbench.workbench.app import workbench
    from opnav_workbench.workbench.bridge import Bridge
    from opnav_workbench.workbench.image_view import ImageView

__all__ = ["Bridge", "ImageView", "workbench"]

# Loaded on first use: nothing of bokeh or ipywidgets is imported before something is to be shown.
_HOMES = {"Bridge": "bridge", "ImageView": "image_view", "workbench": "app"}

__getattr__ = told(names_on_demand(__name__, _HOMES))


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})

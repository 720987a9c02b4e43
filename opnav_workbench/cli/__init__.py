"""The ``opnav`` program. Enter by `main`; `app` is its Typer application.

One module a command or group of commands; nothing else in the package imports them.

``program``
    The table of commands, loaded when they are called, and how errors end the program.
``terminal``
    Consoles, progress, tables and exit statuses that commands share.
``processing_options``
    The options that say how pictures are processed, the same for every command.
``process``
    Pictures to pointing and observables; also runs pictures for demo and ort.
``demo``
    Simulated approach pictures, solved and held against their truth.
``lab``
    JupyterLab with the workbench open on pictures, and its notebook.
``lab_server``
    A JupyterLab of its own, started, watched and stopped.
``nightly``
    Hundreds of pictures headless, continued at will.
``export``
    Observables of many pictures as one file.
``check``
    Files held against what they must be; their JSON Schemas.
``mission``
    Missions: list, show, and a new one from an instrument kernel or numbers, and a picture.
``simulate``
    Pictures with known truth from a scenario.
``plan``
    What the pictures of a sequence will show, and a verdict on each.
``ort``
    Operational readiness tests: new, solve, score.
``campaign``
    The archive of many runs: ingest, query, export, plot, compare, stack.
``campaign_prune``
    A night's folder made smaller by age.
``campaign_serve``
    The archive's pages in a browser.
``kernels``
    SPICE kernels: list, check, fetch, make, brief, geometry, make-ck.
``kernel_tables``
    What the kernels commands print.
``landmarks``
    Maplets of a body: made from its shape, shown.
``catalog``
    Star catalogs: list, info, build, fetch, cone.
``body``
    ``opnav body solve``: a body from the pictures of an approach.
``calibrate``
    Camera and PSF from star frames.
``docs``
    The documentation site, built here and opened.
``doctor``
    What is installed and what is missing.
"""

from opnav_workbench.cli.program import app, main

__all__ = ["app", "main"]

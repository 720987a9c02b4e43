"""Many pictures without a person: nights, and blind runs of rehearsals.

Enter by `plan_night` and `run_night` of ``night``, and by `process_package` of ``rehearsal_run``; how a picture is processed
is said and done in ``processing``.

``night_spec``
    The YAML file of a night.
``faults``
    What went wrong with a picture, and whether another try may come to another result.
``records``
    What a night leaves beside a picture's results.
``inputs``
    What a result depends on, by content; what of it has changed.
``night_psf``
    The effective PSF that the pictures of a night teach it.
``night_carrying``
    Pictures without stars take the pointing of their neighbors, when all are in place.
``settling``
    A new folder put into its place; the attic.
``night_archive``
    The archive that a night fills, made anew where it is damaged.
``night``
    A night planned, run, recorded and archived.
``pruning``
    A night's folder made smaller by age.
``watching``
    Log, status, metrics and heartbeat of a night.
``night_workers``
    One process per picture with its limits; the pools of this machine and of a Dask cluster.
``starting``
    How a picture's process begins: as a copy of a warm one, or as a new Python.
``warm_server``
    A process that has loaded everything, and copies itself for every picture.
``warm_engine``
    papermill's engine for such a copy: cells executed in the process itself.
``night_pages``
    Its summary as it is written, and the pages for the analyst.
``night_summary``
    The morning's summary, page and queue.
``night_trends``
    The trends on the morning's page.
``notebook_run``
    The program that executes one notebook; it imports nothing of this package.
``worker_check``
    Whether a worker of a cluster can do a night's pictures.
``rehearsal_run``
    All pictures of a rehearsal package.
"""

__all__: list[str] = []

"""Notebooks executed in copies of a process that has loaded the package once: loading it is most of a short one's time.

The cells run as in a night's (`opnav_workbench.headless.warm_engine`), each notebook in a process of its own. That they run
in a kernel of Jupyter's as well is tested with ``first_picture.ipynb`` and ``workbench.ipynb``.
"""

import multiprocessing
import os
import traceback
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

LOADED = (
    "opnav_workbench.headless.warm_engine", "opnav_workbench.headless.notebook_run", "opnav_workbench.session.session",
    "opnav_workbench.processing", "opnav_workbench.report.summary", "opnav_workbench.simulation",
    "opnav_workbench.rehearsal", "opnav_workbench.observables", "papermill", "IPython.display", "IPython.core.magics",
    "ipykernel.comm.manager", "ipykernel.inprocess.ipkernel", "matplotlib.backends.backend_agg",
)  # fmt: skip


def execute(notebook: Path, executed: Path, parameters: dict[str, Any], cwd: Path | None = None) -> None:
    """Execute a notebook with these parameters; a cell that fails is an AssertionError with what it said."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(
        [*LOADED]
    )  # of the first call: the server stays to the end of this process
    told, tell = context.Pipe(duplex=False)
    arguments = (tell, notebook, executed, parameters, cwd or Path.cwd())
    process = context.Process(target=_executed, args=arguments)
    process.start()
    tell.close()
    try:
        failure = told.recv()
    except EOFError:
        failure = "its process ended"
    process.join()
    process.close()
    told.close()
    assert not failure, failure


def _executed(
    tell: Connection, notebook: Path, executed: Path, parameters: dict[str, Any], cwd: Path
) -> None:
    os.environ["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"  # as a kernel of Jupyter's has it
    os.chdir(cwd)
    try:
        from opnav_workbench.headless.notebook_run import load_papermill

        papermill = load_papermill()
        from opnav_workbench.headless.warm_engine import ENGINE

        papermill.execute_notebook(
            notebook, executed, parameters=parameters, engine_name=ENGINE, progress_bar=False,
            request_save_on_cell_execute=False,
        )  # fmt: skip
        tell.send("")
    except Exception:
        tell.send(traceback.format_exc(limit=-3))

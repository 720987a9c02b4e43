"""Cells executed in this process: papermill's engine for a process that has loaded everything already.

The kernel is ipykernel's own, without the sockets; what cells say is put into the notebook by nbclient, as everywhere.  No
start-up file of IPython is run and no history is kept: a night is nobody's session.
"""

import queue
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from ipykernel.inprocess.manager import InProcessKernelManager
from nbclient.exceptions import CellExecutionComplete
from papermill.clientwrap import PapermillNotebookClient
from papermill.engines import Engine, papermill_engines
from traitlets.config import Config

__all__ = ["ENGINE"]

ENGINE = "opnav-in-process"
SAID_WITHIN_S = (
    30.0  # a cell's last words are at hand when it ends; this long only where a thread of it is in the way
)
QUIET = Config({"HistoryManager": {"enabled": False}})


class InProcessEngine(Engine):  # type: ignore[misc]
    """Executes a notebook's cells one after the other; the first that fails is the last."""

    @classmethod
    def execute_managed_notebook(cls, nb_man: Any, kernel_name: str, **_options: Any) -> None:  # noqa: ARG003
        """Execute all cells; papermill's contract."""
        papers = PapermillNotebookClient(nb_man)
        papers.reset_execution_trackers()
        with _kernel() as kernel:
            for index, cell in enumerate(nb_man.nb.cells):
                nb_man.cell_start(cell, index)
                well = cell.cell_type != "code" or _executed(kernel, papers, cell, index)
                if not well:
                    nb_man.cell_exception(cell, cell_index=index)
                nb_man.cell_complete(cell, cell_index=index)
                if not well:
                    return


@contextmanager
def _kernel() -> Iterator[Any]:
    manager = InProcessKernelManager(config=QUIET)
    manager.start_kernel()  # type: ignore[no-untyped-call]
    client: Any = manager.client()  # type: ignore[no-untyped-call]
    client.start_channels()
    try:
        yield client
    finally:
        client.stop_channels()


def _executed(kernel: Any, papers: Any, cell: Any, index: int) -> bool:
    """Execute a cell, take down what it says, and tell whether the next one may follow."""
    cell.outputs = []
    cell.metadata["execution"] = {}  # when it began and ended, as nbclient takes it down
    papers.clear_before_next_output = False
    if not cell.source.strip():
        return True
    kernel.execute(cell.source, allow_stdin=False)
    reply = kernel.get_shell_msg()["content"]
    while True:
        try:
            papers.process_message(kernel.get_iopub_msg(timeout=SAID_WITHIN_S), cell, index)
        except (CellExecutionComplete, queue.Empty):
            break
    cell.execution_count = reply.get("execution_count")
    return reply["status"] == "ok" or "raises-exception" in cell.metadata.get("tags", ())


papermill_engines.register(ENGINE, InProcessEngine)

"""A JupyterLab of its own for one notebook: started, watched, and stopped cleanly."""

import html
import json
import os
import secrets
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Self

from opnav_workbench.errors import SessionError
from opnav_workbench.files import atomic_path, make_folder

__all__ = ["LabServer"]

STARTS_IN_S = 60.0
STOPS_IN_S = 10.0
PRIVATE = ".opnav_lab"  # beside the notebook: settings, layout and log of this JupyterLab
BROWSER_PAGE = "open_in_browser.html"  # not in the hidden folder: packaged browsers may not look there
PAGE_MODE = 0o600  # it holds the token
REDIRECTION = (
    '<!DOCTYPE html><meta charset="utf-8"><meta http-equiv="refresh" content="0;url={0}">'
    '<a href="{0}">Open the workbench</a>\n'
)
WORKSPACE = "workbench"
EXTENSION = Path(__file__).parent / "labextension"  # shows the workbench alone; see its bench.js
HIGHEST_PORT = 65_535
OVERRIDES = {
    # Callbacks of the view then never run beside a cell's code: SPICE serves one thread only.
    "@jupyterlab/apputils-extension:kernels-settings": {"commsOverSubshells": "disabled"},
    "@jupyterlab/apputils-extension:notification": {"fetchNews": "false", "checkForUpdates": False},
    "@jupyterlab/notebook-extension:tracker": {"windowingMode": "none"},  # no cell is taken out of the page
}
# JupyterLab is not built anew here: without this each page would ask node whether it should be, for a second.
PAGE = {"page_config_data": {"buildAvailable": False, "buildCheck": False}}
# The side bars begin closed, so that the workbench has the whole width; JupyterLab keeps what the analyst then changes.
LAYOUT = {
    "layout-restorer:data": {
        "main": {"dock": None},
        "left": {"collapsed": True, "visible": True},
        "right": {"collapsed": True, "visible": True},
        "relativeSizes": [0, 1, 0],
    }
}


class LabServer:
    """A running JupyterLab, as a context manager.

    Parameters
    ----------
    notebook
        What it opens; its folder is all that the server shows.
    port
        0 takes a free one.
    options
        More options of JupyterLab.
    environment
        More environment variables.

    Raises
    ------
    SessionError
        JupyterLab is not installed, does not start, or the port is taken.
    """

    def __init__(
        self,
        notebook: Path,
        port: int = 0,
        *,
        options: Sequence[str] = (),
        environment: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self.folder = notebook.parent
        self.token = secrets.token_urlsafe(16)
        self._port = _free_port(port)
        self.address = f"http://127.0.0.1:{self._port}"
        self.url = f"{self.address}/lab/workspaces/{WORKSPACE}/tree/{notebook.name}?token={self.token}"
        self._private = self.folder / PRIVATE
        self.log_path = self._private / "jupyterlab.log"
        self._page = self.folder / BROWSER_PAGE
        self._more_options, self._more_environment = tuple(options), dict(environment)

    def __enter__(self) -> Self:
        self._write_settings()
        with self.log_path.open("w", encoding="utf-8") as log:
            # A session of its own: Ctrl-C reaches us alone, and we stop the server without its question.
            self._process = subprocess.Popen(  # noqa: S603  our own interpreter and options
                [sys.executable, "-m", "jupyterlab", *self._options()],
                cwd=self.folder,
                env=self._environment(),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        try:
            self._wait_for_start()
        except BaseException:
            self._stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._page.unlink(missing_ok=True)
        self._stop()

    def browser_page(self) -> str:
        """Return the address of a page that leads to the notebook, for this user alone.

        What a browser is started with, every user of the machine can list; so the token stands in the page.
        """
        with atomic_path(self._page, PAGE_MODE) as temporary:
            temporary.write_text(REDIRECTION.format(html.escape(self.url)), encoding="utf-8")
        return self._page.resolve().as_uri()

    def wait(self) -> None:
        """Return when the server has ended, by itself or because of Ctrl-C or SIGTERM."""
        previous = signal.signal(signal.SIGTERM, _raise_interrupt)
        try:
            self._process.wait()
        except KeyboardInterrupt:
            return
        finally:
            signal.signal(signal.SIGTERM, previous)

    def _options(self) -> list[str]:
        options = [
            "--no-browser",
            "--ServerApp.ip=127.0.0.1",
            f"--ServerApp.port={self._port}",
            "--ServerApp.port_retries=0",
            f"--ServerApp.root_dir={self.folder}",
            "--LabApp.extension_manager=readonly",
            f"--ServerApp.tornado_settings={PAGE}",
            f"--LabApp.extra_labextensions_path={EXTENSION}",
        ]
        is_root = hasattr(os, "geteuid") and os.geteuid() == 0  # a container; Jupyter refuses unless told
        return [*options, *(["--allow-root"] if is_root else []), *self._more_options]

    def _environment(self) -> dict[str, str]:
        own = os.environ.get("JUPYTER_CONFIG_PATH", "")
        return (
            os.environ
            | {
                "JUPYTER_TOKEN": self.token,  # not among the options, which every user of the machine can list
                "JUPYTER_CONFIG_PATH": os.pathsep.join(filter(None, [str(self._private), own])),
                "JUPYTERLAB_WORKSPACES_DIR": str(self._private / "workspaces"),
            }
            | self._more_environment
        )

    def _write_settings(self) -> None:
        # Takes a second, which no other command of the program shall wait for.
        from jupyterlab_server.workspaces_handler import WorkspacesManager  # noqa: PLC0415

        make_folder(self._private / "labconfig")
        path = self._private / "labconfig" / "default_setting_overrides.json"
        path.write_text(json.dumps(OVERRIDES, indent=1), encoding="utf-8")
        layouts = WorkspacesManager(str(self._private / "workspaces"))
        if WORKSPACE not in [layout["metadata"]["id"] for layout in layouts.list_workspaces()]:
            layouts.save(WORKSPACE, json.dumps({"data": LAYOUT, "metadata": {"id": WORKSPACE}}))

    def _wait_for_start(self) -> None:
        end = time.monotonic() + STARTS_IN_S
        while time.monotonic() < end:
            if self._process.poll() is not None:
                raise SessionError(
                    f"JupyterLab did not start: {self._last_words()} (all of it: {self.log_path})"
                )
            if self._answers():
                return
            time.sleep(0.1)
        raise SessionError(f"JupyterLab did not answer within {STARTS_IN_S:g} s; see {self.log_path}.")

    def _answers(self) -> bool:
        try:
            with urllib.request.urlopen(f"{self.address}/api", timeout=1.0):  # noqa: S310  our own server
                return True
        except OSError:
            return False

    def _last_words(self) -> str:
        lines = self.log_path.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return lines[-1].strip() if lines else "it said nothing"

    def _stop(self) -> None:
        if self._process.poll() is None:
            self._process.terminate()  # the server ends its kernels itself
        try:
            self._process.wait(STOPS_IN_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def _free_port(wanted: int) -> int:
    if not 0 <= wanted <= HIGHEST_PORT:
        raise SessionError(f"{wanted} is no port; choose one from 1024 to {HIGHEST_PORT}, or leave it out.")
    with socket.socket() as probe:
        # As the server binds it: a port whose last connections are being closed is free.
        if os.name == "posix":
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", wanted))
        except PermissionError as error:
            raise SessionError(
                f"port {wanted} is reserved for the system; choose one from 1024 on, or leave it out."
            ) from error
        except OSError as error:
            raise SessionError(
                f"port {wanted} is taken; choose another with --port, or leave it out."
            ) from error
        return int(probe.getsockname()[1])


def _raise_interrupt(*_: object) -> None:
    raise KeyboardInterrupt

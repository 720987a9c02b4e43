"""``opnav campaign serve``: the pages of an archive in a browser of this machine.

The server answers on the loopback address only, to requests that name it (a page of somebody else's cannot ask through the
browser), and only reads.  Of a picture's folder it gives the files that a run leaves, never a path that was typed.
"""

import contextlib
import webbrowser
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import parse_qs, urlsplit

import typer
from rich.console import Console

from opnav_workbench.campaign import ARCHIVE_FILE, Campaign
from opnav_workbench.cli.terminal import shown
from opnav_workbench.errors import OpNavError, SessionError
from opnav_workbench.headless.notebook_run import notebook_html

__all__ = ["CampaignServer", "serve"]

HOST = "127.0.0.1"
KINDS = {
    ".html": "text/html; charset=utf-8",
    ".png": "image/png",
    ".json": "application/json",
    ".ipynb": "application/json",
}
PAGE = "text/html; charset=utf-8"
OWN_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src 'self'; form-action 'self'; frame-ancestors 'none'"
# An executed notebook shows what its cells printed: it is looked at, it does nothing.
NOTEBOOK_POLICY = "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:"


class CampaignServer(ThreadingHTTPServer):
    """Serves the pages of one archive.

    Parameters
    ----------
    port
        0 takes a free one.

    Raises
    ------
    SessionError
        The port is taken.
    """

    daemon_threads = True

    def __init__(self, campaign: Campaign, port: int = 0) -> None:
        from opnav_workbench.report.campaign_pages import CampaignPages  # noqa: PLC0415  templates load in a second

        self.pages = CampaignPages(campaign)
        try:
            super().__init__((HOST, port), _Answer)
        except (OSError, OverflowError) as error:
            raise SessionError(f"port {port} cannot be used ({error}); give another --port.") from error

    def server_close(self) -> None:
        """Let the port go, and what is being drawn."""
        super().server_close()
        self.pages.close()

    @property
    def address(self) -> str:
        """What a browser opens."""
        return f"http://{HOST}:{self.server_address[1]}/"

    @property
    def names(self) -> tuple[str, ...]:
        """What requests may call it."""
        return tuple(f"{host}:{self.server_address[1]}" for host in (HOST, "localhost"))


class _Answer(BaseHTTPRequestHandler):
    server: CampaignServer
    server_version, sys_version = "opnav", ""

    def do_GET(self) -> None:
        if self.headers.get("Host") not in self.server.names:
            self.send_error(HTTPStatus.FORBIDDEN, "ask by the address that opnav printed")
            return
        try:
            found = self._found()
        except OpNavError as error:
            self.send_error(HTTPStatus.INTERNAL_SERVER_ERROR, explain=str(error))
            return
        if found is None:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        with contextlib.suppress(ConnectionError):  # the browser went on
            self._give(*found)

    do_HEAD = do_GET  # noqa: N815

    def _found(self) -> tuple[str, bytes, str] | None:
        """Return kind, content and policy of what was asked for."""
        address = urlsplit(self.path)
        asked = {name: values[-1] for name, values in parse_qs(address.query).items()}
        pages, parts = self.server.pages, address.path.strip("/").split("/")
        match parts:
            case [""]:
                text: str | None = pages.pictures(
                    _whole(asked.get("page")) or 1, asked.get("status", ""), asked.get("q", "")
                )
            case ["trends"]:
                text = pages.trends()
            case ["trends.png"]:
                return "image/png", pages.trends_png(), OWN_POLICY
            case ["made-with"]:
                text = pages.made_with()
            case ["favicon.ico"]:  # every browser asks
                return "image/png", b"", OWN_POLICY
            case ["changes"]:
                text = pages.changes()
            case ["picture", number] if _whole(number):
                text = pages.picture(_whole(number))
            case ["picture", number, name] if _whole(number):
                return self._file(_whole(number), name)
            case _:
                text = None
        return None if text is None else (PAGE, text.encode(), OWN_POLICY)

    def _file(self, number: int, name: str) -> tuple[str, bytes, str] | None:
        path = self.server.pages.file(number, name)
        kind = KINDS.get(Path(name).suffix, "text/plain; charset=utf-8")
        policy = NOTEBOOK_POLICY if name.endswith(".html") else OWN_POLICY
        if path is not None:
            return kind, path.read_bytes(), policy
        notebook = self.server.pages.file(number, "notebook.ipynb") if name == "notebook.html" else None
        return None if notebook is None else (kind, notebook_html(notebook).encode(), policy)

    def _give(self, kind: str, content: bytes, policy: str) -> None:
        self.send_response(HTTPStatus.OK)
        for name, value in (
            ("Content-Type", kind),
            ("Content-Length", str(len(content))),
            ("Content-Security-Policy", policy),
            ("X-Content-Type-Options", "nosniff"),
            ("Referrer-Policy", "no-referrer"),
            ("Cache-Control", "no-store"),
        ):
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002  the library's name
        """Say nothing: the terminal is the user's."""


def _whole(text: str | None) -> int:
    """Return a whole number as it was typed; 0 where it is none."""
    return int(text) if text and text.isascii() and text.isdigit() and len(text) < 10 else 0


def serve(
    archive: Annotated[Path, typer.Argument(help="Archive file, or the folder it is in.")] = Path(
        ARCHIVE_FILE
    ),
    port: Annotated[int, typer.Option(min=0, max=65_535, help="0 takes a free one.")] = 0,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Only print the address.")] = False,
) -> None:
    """Show an archive in the browser: what needs an analyst by cause, pictures, trends, kernels, changes. Ctrl-C ends it.

    [bold]Example[/]

      opnav campaign serve night

    Only this machine can ask (127.0.0.1), nothing is written, and a page holds a hundred pictures however many there are.
    From elsewhere: ssh -L 8000:127.0.0.1:8000 HOST, with --port 8000.
    """
    with Campaign(archive, create=False) as campaign, CampaignServer(campaign, port) as server:
        Console(soft_wrap=True).print(f"{shown(str(campaign.path))} at {server.address}", highlight=False)
        if not no_browser:
            webbrowser.open(server.address)
        with contextlib.suppress(KeyboardInterrupt):
            server.serve_forever()

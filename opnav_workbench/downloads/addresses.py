"""Which addresses may be opened: those of the web, also after redirects."""

import urllib.request
from typing import Any
from urllib.parse import urlsplit

from opnav_workbench.errors import DownloadError

__all__ = ["require_web_address", "web_opener"]

SCHEMES = ("http", "https")


def require_web_address(url: str) -> None:
    """Raise DownloadError unless an address begins with http or https and names a server.

    Examples
    --------
    >>> require_web_address("file:///etc/passwd")
    Traceback (most recent call last):
    opnav_workbench.errors.DownloadError: 'file:///etc/passwd' is no web address; give one with http or https.
    """
    parts = urlsplit(url)
    if parts.scheme.lower() not in SCHEMES or not parts.hostname:
        raise DownloadError(f"{url!r} is no web address; give one with http or https.")


class _WebRedirects(urllib.request.HTTPRedirectHandler):
    """Redirects stay on the web, and never lead from https back to http."""

    def redirect_request(
        self, req: urllib.request.Request, fp: Any, code: int, msg: str, headers: Any, newurl: str
    ) -> urllib.request.Request | None:
        require_web_address(newurl)
        if req.full_url.startswith("https:") and not newurl.startswith("https:"):
            raise DownloadError(
                f"{req.full_url} redirects to {newurl}, which is not encrypted; fetch it by hand."
            )
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def web_opener() -> urllib.request.OpenerDirector:
    """Return an opener for web addresses, with the proxies of the environment."""
    return urllib.request.build_opener(_WebRedirects)

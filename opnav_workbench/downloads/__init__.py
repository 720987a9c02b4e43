"""Files fetched over http and https: resumed after a cut, checked for size and SHA-256, whole or not there."""

from opnav_workbench.downloads.addresses import require_web_address
from opnav_workbench.downloads.attempts import download
from opnav_workbench.downloads.job import Opener, Progress

__all__ = ["Opener", "Progress", "download", "require_web_address"]

"""The package's errors: one root, one leaf per thing that can be wrong.

Every message says what was wrong, with the numbers, and what to do about it. What is expected in flight data
(a star not seen, a body off the detector, a saturated core) is a status on a result, never an exception.
"""

__all__ = [
    "CameraError",
    "CatalogError",
    "CenterfindingError",
    "DownloadError",
    "EstimationError",
    "ImageError",
    "KernelError",
    "MissionError",
    "OpNavError",
    "PointingError",
    "SelectionPending",
    "SessionError",
    "counted",
]


class OpNavError(Exception):
    """Root of every error that this package raises on purpose."""


class KernelError(OpNavError):
    """A SPICE kernel, body, frame, clock or time span that is missing or unusable."""


class CameraError(OpNavError):
    """A camera description that is incomplete, or a geometry it cannot image."""


class CatalogError(OpNavError):
    """A star catalog that is missing, malformed or asked for something it does not hold."""


class ImageError(OpNavError):
    """A picture file that cannot be read or does not hold a usable picture."""


class DownloadError(OpNavError):
    """A file that cannot be fetched, or that is not the one it should be."""


class MissionError(OpNavError):
    """A mission or scenario file that is unknown or breaks its schema."""


class CenterfindingError(OpNavError):
    """A centerfinder called with input that no center can come from."""


class PointingError(OpNavError):
    """An attitude that the given stars cannot determine."""


class EstimationError(OpNavError):
    """Observables, parameters or a trajectory that no estimate or B-plane can come from."""


class SessionError(OpNavError):
    """A session step taken out of order, or a session that cannot be saved or resumed."""


class SelectionPending(SessionError):  # noqa: N818 - not a fault: an analyst's decision is still to come
    """A decision of the analyst that the next step waits for."""


def counted(count: int, noun: str) -> str:
    """Return a number with its noun, for messages.

    Examples
    --------
    >>> counted(1, "pixel"), counted(2, "pixel")
    ('1 pixel', '2 pixels')
    """
    return f"{count} {noun}{'' if count == 1 else 's'}"

"""What is believed about a camera before its pictures are measured."""

from dataclasses import dataclass

from opnav_workbench.errors import CameraError

__all__ = ["AttitudeSigma", "ExposureLimits", "PsfPrior"]


def _check_positive(**values: float) -> None:
    for name, value in values.items():
        if not 0.0 < value < float("inf"):
            raise CameraError(f"{name} is {value}; give a positive number.")


@dataclass(frozen=True, slots=True)
class PsfPrior:
    """Gaussian width of the point spread function before pixel integration, and how well it is known.

    The defaults span what is usual for a focused, critically sampled camera.

    Attributes
    ----------
    sigma_px
        Gaussian sigma, px.
    sigma_sigma_px
        One-sigma uncertainty of `sigma_px`, px.
    """

    sigma_px: float = 0.7
    sigma_sigma_px: float = 0.3

    def __post_init__(self) -> None:
        _check_positive(sigma_px=self.sigma_px, sigma_sigma_px=self.sigma_sigma_px)

    @property
    def relative_sigma(self) -> float:
        """One-sigma uncertainty of the width, as a part of it."""
        return self.sigma_sigma_px / self.sigma_px


@dataclass(frozen=True, slots=True)
class AttitudeSigma:
    """One-sigma errors of the attitude that a picture comes with.

    Attributes
    ----------
    cross_px
        Across the boresight, per axis, px.
    twist_deg
        About the boresight, deg.
    """

    cross_px: float = 40.0
    twist_deg: float = 0.2

    def __post_init__(self) -> None:
        _check_positive(cross_px=self.cross_px, twist_deg=self.twist_deg)


@dataclass(frozen=True, slots=True)
class ExposureLimits:
    """Shortest and longest exposure that the camera can be commanded to, s."""

    min_s: float
    max_s: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.min_s <= self.max_s < float("inf"):
            raise CameraError(f"exposure limits {self.min_s}..{self.max_s} s; give 0 <= min_s <= max_s.")

"""Where the spacecraft is and how fast it moves, with respect to the solar-system barycenter."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.errors import ImageError
from opnav_workbench.image import Frame, barycentric_from_heliocentric
from opnav_workbench.spice import state

__all__ = ["Observer", "observer_from_header", "observer_from_kernels"]

SOLAR_SYSTEM_BARYCENTER = 0


@dataclass(frozen=True, slots=True, eq=False)
class Observer:
    """The spacecraft's barycentric state: what aberration and parallax need.

    Attributes
    ----------
    position_km, velocity_km_s : (3,) arrays
        With respect to the solar-system barycenter, J2000.
    source : str
        "kernels" or "header", for the record.
    """

    position_km: FloatArray
    velocity_km_s: FloatArray
    source: str

    def __post_init__(self) -> None:
        freeze_arrays(self)


def observer_from_kernels(spacecraft: int, et: float) -> Observer:
    """Read the spacecraft's barycentric state from the active `KernelSet`.

    Raises
    ------
    KernelError
        No kernel set is active, or its SPKs do not cover the spacecraft at `et`.
    """
    geometric = state(spacecraft, et, SOLAR_SYSTEM_BARYCENTER)
    return Observer(geometric.position_km, geometric.velocity_km_s, "kernels")


def observer_from_header(frame: Frame, et: float) -> Observer:
    """Take the spacecraft's state from the image header (Sun vector there, Sun about the barycenter from ERFA).

    Raises
    ------
    ImageError
        The header has no Sun vector or velocity.
    """
    geometry = frame.header_geometry
    if (
        geometry is None
        or geometry.spacecraft_from_sun_km is None
        or geometry.spacecraft_velocity_km_s is None
    ):
        raise ImageError(
            f"{frame.path.name}: the header gives no spacecraft position and velocity; "
            "give kernels that cover the spacecraft (--kernels)."
        )
    position, velocity = barycentric_from_heliocentric(
        np.asarray(geometry.spacecraft_from_sun_km), np.asarray(geometry.spacecraft_velocity_km_s), et
    )
    return Observer(position, velocity, "header")

"""The pictures that ``opnav demo`` and the notebooks simulate: what a spacecraft sees, with its truth.

The spacecraft is one of the active kernel set; the truth goes to files of its own.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from opnav_workbench.catalog import open_catalog
from opnav_workbench.files import make_folder
from opnav_workbench.mission import Mission
from opnav_workbench.simulation import (
    OpenedScenario,
    PictureScenario,
    ScenarioPicture,
    Truth,
    expose_picture,
    truth_of,
    write_picture,
)

__all__ = [
    "DEMO_CATALOG",
    "DEMO_KERNELS",
    "DEMO_MISSION",
    "DEMO_PICTURES",
    "DEMO_TARGETS",
    "PictureRequest",
    "simulate_picture",
]


# ---- Approach pictures of the demonstration.


@dataclass(frozen=True, slots=True)
class PictureRequest:
    """A picture to simulate.

    Attributes
    ----------
    name
        File name stem.
    utc
        Mid-exposure.
    header
        Header values that identify mission and camera (such as ``SFORMAT``).
    sigma_px
        Width of the true PSF.
    """

    name: str
    utc: str
    header: Mapping[str, Any]
    exposure_s: float
    targets: tuple[str, ...]
    sigma_px: float
    sky_dn: float
    seed: int

    def reseeded(self, offset: int) -> "PictureRequest":
        """Return the request with its seed moved by `offset`."""
        return replace(self, seed=self.seed + offset)

    def scenario(self, mission: Mission, catalog: str) -> PictureScenario:
        """Return the request as a picture scenario for the active kernels."""
        picture = {
            "name": self.name,
            "utc": self.utc,
            "header": dict(self.header),
            "exposure_s": self.exposure_s,
            "targets": self.targets,
        }
        return PictureScenario.model_validate(
            {
                "mission": str(mission.path),
                "catalog": catalog,
                "seed": self.seed,
                "psf_sigma_px": (self.sigma_px, self.sigma_px),
                "detector": {"sky": {"level_dn": self.sky_dn}},
                "pictures": [picture],
            }
        )


def simulate_picture(request: PictureRequest, mission: Mission, catalog: str, out: Path) -> Truth:
    """Simulate one picture with the active `KernelSet`; truth goes to files of its own.

    The kernels' attitude is the predicted one and stands in the header; the true one differs by a random error of the
    camera's a priori size, drawn from the seed.

    Parameters
    ----------
    catalog
        Catalog spec of the true stars.
    out
        Folder; gets ``NAME.fit`` and its truth.

    Raises
    ------
    KernelError, CameraError, CatalogError, MissionError
    """
    scenario = request.scenario(mission, catalog)
    opened = OpenedScenario(scenario, mission, open_catalog(catalog), {})
    chosen = ScenarioPicture(0, scenario.pictures[0])
    picture = expose_picture(opened.inputs(chosen))
    report = write_picture(picture, mission, make_folder(out), (), opened.truth_settings(chosen))
    return truth_of(picture, mission, report.files[0])


# ---- The pictures that ``opnav demo`` and the notebooks simulate.

DEMO_MISSION = "new_horizons"
DEMO_KERNELS = "new_horizons/pluto_opnav"
DEMO_CATALOG = "bundled"
DEMO_TARGETS = ("PLUTO", "CHARON")

# Three months before the encounter: Pluto is a pixel wide in both cameras, Charon stands nine pixels off.
DEMO_PICTURES = (
    PictureRequest(
        name="lorri_4x4",
        utc="2015-04-09T12:00:00.000",
        header={"MISSION": "New Horizons", "INSTRU": "lor", "SFORMAT": "4X4"},
        exposure_s=0.1,
        targets=DEMO_TARGETS,
        sigma_px=0.6,
        sky_dn=1.0,
        seed=20150409,
    ),
    PictureRequest(
        name="mvic_framing",
        utc="2015-04-09T14:00:00.000",
        header={"MISSION": "New Horizons", "INSTRU": "mvi", "SCANTYPE": "FRAMING"},
        exposure_s=1.0,
        targets=DEMO_TARGETS,
        sigma_px=0.7,
        sky_dn=1.0,
        seed=20150417,
    ),
)

"""The pictures that ``opnav demo`` and the notebooks simulate."""

from opnav_workbench.rehearsal.approach import PictureRequest

__all__ = ["DEMO_CATALOG", "DEMO_KERNELS", "DEMO_MISSION", "DEMO_PICTURES", "DEMO_TARGETS"]

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

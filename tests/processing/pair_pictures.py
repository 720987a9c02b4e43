"""Pictures of Pluto, 47 px wide in LORRI's 4x4 mode, with an attitude error that all of them share."""

from opnav_workbench.kernels import KernelSet
from opnav_workbench.mission import load_mission
from opnav_workbench.simulation import (
    OpenedScenario,
    PictureScenario,
    ScenarioPicture,
    expose_picture,
    truth_of,
    write_picture,
)

KERNELS = "new_horizons/pluto_approach"
SETTINGS = "carry_within_s=60,carry_jitter_px=0.03,carry_walk_px=0.005,lost_detections=0"


def pair_pictures(folder, times, *, seed, shift_px):
    """The truths of pictures by name, at `times` (UTC, exposure in s) by name."""
    scenario = PictureScenario.model_validate(
        {
            "mission": "new_horizons",
            "catalog": "bundled",
            "magnitude_limit": 13.0,
            "seed": seed,
            "bodies": [{"name": "PLUTO", "law": {"law": "lunar_lambert", "lunar_weight": 0.5}}],
            "attitude": {"actual": {"source": "error", "shift_px": shift_px, "twist_deg": 0.05}},
            "pictures": [
                {"name": name, "utc": utc, "camera": "lorri_4x4", "exposure_s": exposure_s}
                for name, (utc, exposure_s) in times.items()
            ],
        }
    )
    mission, made = load_mission("new_horizons"), {}
    with KernelSet(KERNELS):
        opened = OpenedScenario.open(scenario)
        for index, picture in enumerate(scenario.pictures):
            chosen = ScenarioPicture(index, picture)
            shown = expose_picture(opened.inputs(chosen))
            report = write_picture(shown, mission, folder, (), opened.truth_settings(chosen))
            made[picture.name] = truth_of(shown, mission, report.files[0])
    return made

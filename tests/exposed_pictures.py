"""Pictures of New Horizons' approach to Pluto with LORRI's 4x4 mode, and what they really show."""

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

APPROACH = "new_horizons/pluto_approach"  # kernels of the last days before the encounter
LAW = {"law": "lunar_lambert", "lunar_weight": 0.5}


def exposed_pictures(
    folder, times, *, bodies, seed, shift_px, twist_deg, magnitude_limit=13.0, level="calibrated"
):
    """The truths of pictures by name, at `times` (UTC, exposure in s) by name."""
    scenario = PictureScenario.model_validate(
        {
            "mission": "new_horizons",
            "catalog": "bundled",
            "magnitude_limit": magnitude_limit,
            "seed": seed,
            "bodies": [{"name": name, "law": LAW} for name in bodies],
            "attitude": {"actual": {"source": "error", "shift_px": shift_px, "twist_deg": twist_deg}},
            "pictures": [
                {"name": name, "utc": utc, "camera": "lorri_4x4", "exposure_s": exposure_s, "level": level}
                for name, (utc, exposure_s) in times.items()
            ],
        }
    )
    mission, made = load_mission("new_horizons"), {}
    with KernelSet(APPROACH):
        opened = OpenedScenario.open(scenario)
        for index, picture in enumerate(scenario.pictures):
            chosen = ScenarioPicture(index, picture)
            shown = expose_picture(opened.inputs(chosen))
            report = write_picture(shown, mission, folder, (), opened.truth_settings(chosen))
            made[picture.name] = truth_of(shown, mission, report.files[0])
    return made

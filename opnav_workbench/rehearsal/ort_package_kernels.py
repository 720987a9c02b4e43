"""Predicted kernels and mission file of a package: copied, so that the folder works wherever it goes."""

import shutil
from pathlib import Path

from opnav_workbench.errors import MissionError
from opnav_workbench.mission import Mission, load_mission, mission_names
from opnav_workbench.rehearsal.ort_scenario import OrtScenario
from opnav_workbench.spice import KernelSet, write_text_kernel
from opnav_workbench.spice.text_kernels import metakernel_assignments

__all__ = ["copy_kernels", "copy_mission"]

FOLDER = "kernels"
MISSION_FOLDER = "mission"
NOTE = "Predicted kernels of a rehearsal. Paths count from this folder."


def copy_kernels(scenario: OrtScenario, folder: Path) -> Path:
    """Copy the predicted kernels into ``folder/kernels`` and return their metakernel, all paths relative.

    Raises
    ------
    KernelError
        A kernel is missing or no kernel.
    MissionError
        Two kernels of one name.
    """
    source = scenario.source(scenario.kernels)
    files = [kernel.path for kernel in KernelSet(source).kernels() if kernel.kind != "META"]
    names = [path.name for path in files]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise MissionError(
            f"rehearsal scenario: kernels: two kernels are named {', '.join(twice)}; rename one."
        )
    target = folder / FOLDER
    target.mkdir()
    for path in files:
        shutil.copyfile(path, target / path.name)
    metakernel = target / f"{Path(source).stem}.tm"
    write_text_kernel(metakernel, "MK", metakernel_assignments(names), NOTE)
    return metakernel


def copy_mission(scenario: OrtScenario, folder: Path) -> tuple[Mission, str]:
    """Return the mission and how ``ort.yaml`` names it: by name, else by its file copied into ``folder/mission``.

    Raises
    ------
    MissionError
        There is no such mission, or it names files outside its folder.
    """
    named = scenario.source(scenario.mission)
    mission = load_mission(named)
    if named in mission_names():
        return mission, named
    home = mission.path.parent
    files = [mission.path, *(choice.file for choice in mission.cameras), *home.glob("headers/*.yaml")]
    files += [path for path in (mission.target_stars,) if path is not None]
    for surface in mission.target_surfaces.values():
        files += [surface.shape] if surface.shape is not None else []
        files += [surface.albedo_map.file] if surface.albedo_map is not None else []
    for path in files:
        if not path.resolve().is_relative_to(home.resolve()):
            raise MissionError(
                f"mission file {mission.path}: {path} is not in its folder; a package cannot copy it."
            )
        place = folder / MISSION_FOLDER / path.resolve().relative_to(home.resolve())
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, place)
    return mission, f"{MISSION_FOLDER}/{mission.path.name}"

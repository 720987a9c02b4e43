"""Missions out of the box: each has a scenario of star fields, from which a picture is simulated and solved.

Some of them with --all; every camera of all missions by ``python tests/camera/test_missions_run.py`` (a minute).
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

from opnav_workbench.kernels import KernelSet, load_manifest, manifest_missions
from opnav_workbench.kernels.making.scenario import load_scenario
from opnav_workbench.mission import load_mission, mission_names
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.session import ImageSession
from opnav_workbench.simulation import load_picture_scenario, picture_scenario_names, simulate
from opnav_workbench.simulation.truth import read_truth

SCENARIO = "star_fields"
MISSIONS = [name for name in mission_names() if f"{name}/{SCENARIO}" in picture_scenario_names()]
QUICK = ("galileo", "lro", "voyager1", "voyager2")  # small detectors


def test_missions_come_with_star_fields_and_a_manifest():
    assert set(mission_names()) - set(MISSIONS) == {"new_horizons"}  # it has pictures of its own
    assert set(manifest_missions()) == set(mission_names())


@pytest.mark.slow(keep=["dawn", "juno"])
@pytest.mark.parametrize("name", MISSIONS)
def test_cameras_frames_and_header_words_of_a_mission_fit_together(name):
    """Each picture of the scenario names a camera whose match tells it from the others, and the kernels know its frame."""
    mission, scenario = load_mission(name), load_picture_scenario(f"{name}/{SCENARIO}")
    made = load_scenario(kernels_meta_dir() / name / f"{SCENARIO}.yaml")
    frames = {made.spacecraft.frame.name, *(frame.name for frame in made.frames)}
    assert (made.spacecraft.id, made.clock.id) == (mission.spacecraft_id, mission.clock_id)
    assert made.spacecraft.frame.name == mission.bus_frame
    for entry in scenario.pictures:
        camera = mission.camera_named(entry.camera)
        assert camera.frame in frames
        (choice,) = [choice for choice in mission.cameras if choice.file.stem == entry.camera]
        words = {**mission.keywords.get("required", {}), **choice.match}
        header = {
            word: value[0] if isinstance(value, tuple | list) else value for word, value in words.items()
        }
        assert mission.camera_for(header).name == camera.name
        assert camera.source
        assert camera.origins
    if name in manifest_missions():
        assert load_manifest(name)[0].mission == name


def solved(name, entry, folder):
    """Sigmas squared of a solved attitude from the one that a picture was drawn with, the stars drawn, the rms."""
    scenario, mission = load_picture_scenario(f"{name}/{SCENARIO}"), load_mission(name)
    (report,) = simulate(scenario, folder, only=[entry.name], jobs=1)
    with KernelSet(f"{name}/{SCENARIO}"):
        session = ImageSession.open(folder / f"{entry.name}.fit", mission)
        session.predict()
        session.find_stars()
        session.repoint()
    assert session.context.camera.name == mission.camera_named(entry.camera).name
    pointing = session.state.pointing
    between = pointing.camera_from_j2000 @ read_truth(folder / f"{entry.name}.fit").camera_from_j2000.T
    skew = between - between.T
    error = 0.5 * np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    return (
        float(error @ np.linalg.solve(pointing.covariance_rad2, error)),
        report.stars_drawn,
        pointing.rms_px,
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", QUICK)
def test_a_simulated_picture_of_the_mission_is_solved(name, tmp_path):
    """Header words, kernels, camera and catalog: the stars give the attitude that the picture was drawn with."""
    sigmas2, _, _ = solved(name, load_picture_scenario(f"{name}/{SCENARIO}").pictures[0], tmp_path)
    assert sigmas2 < 25.0  # of three angles: chance in 10^5


if __name__ == "__main__":
    for mission_name in sys.argv[1:] or MISSIONS:
        for picture in load_picture_scenario(f"{mission_name}/{SCENARIO}").pictures:
            with tempfile.TemporaryDirectory() as made_in:
                try:
                    told = "chi2 {:7.2f}  stars {:5d}  rms {:.3f} px".format(
                        *solved(mission_name, picture, Path(made_in))
                    )
                except Exception as error:
                    told = f"{type(error).__name__}: {error}"
            sys.stdout.write(f"{mission_name:12} {picture.name:16} {told}\n")

"""A pair: a long exposure with stars, and short ones of the body alone that take its pointing."""

import sys
from pathlib import Path

import numpy as np
import pytest

from opnav_workbench.errors import SessionError
from opnav_workbench.geometry import matrix_from_quaternion, vector_from_rotation
from opnav_workbench.observables import read_ecsv
from opnav_workbench.processing import Processing, process
from opnav_workbench.processing.carrying import carry_between
from opnav_workbench.session import ImageSession, load_decisions
from opnav_workbench.session.decisions import perform
from opnav_workbench.stars.pointing import AttitudeMotion

sys.path.insert(0, str(Path(__file__).parent))
from pair_pictures import KERNELS, SETTINGS, pair_pictures

pytestmark = pytest.mark.slow

SHIFT_PX = (7.6, -3.1)  # the a priori attitude's error, the same in all three
TIMES = {"long": ("2015-07-12T08:46:47", 0.1), "short": ("2015-07-12T08:46:57", 0.002)}


@pytest.fixture(scope="module")
def truths(tmp_path_factory):
    """One with stars, and ten seconds later one without."""
    return pair_pictures(tmp_path_factory.mktemp("pair"), TIMES, seed=5, shift_px=SHIFT_PX)


@pytest.fixture(scope="module")
def processed(truths, tmp_path_factory):
    out = tmp_path_factory.mktemp("run")
    said, told = [], []
    outcomes = process(
        [truths[name].picture for name in TIMES],
        mission="new_horizons",
        kernels=KERNELS,
        targets="PLUTO",
        settings=SETTINGS,
        out=out,
        say=lambda name, words: said.append((name, words)),
        done=told.append,
    )
    assert sorted(o.image.stem for o in told) == ["long", "short"]  # each once, as it came out
    assert all(any(o is outcome for outcome in outcomes) for o in told)
    return dict(zip(TIMES, outcomes, strict=True)), said


def attitude_error(truth, result):
    solved = matrix_from_quaternion(result["pointing"]["quaternion_camera_from_j2000"])
    return vector_from_rotation(truth.camera_from_j2000 @ solved.T)


def test_body_picture_without_stars_has_its_neighbors_pointing(truths, processed):
    outcomes, said = processed
    long, short = (outcomes[name] for name in TIMES)
    assert long.result["pointing"]["n_stars"] >= 3
    assert short.result["status"] == "ok"
    assert ("short", "carrying the pointing of long.fit") in said
    pointing = short.result["pointing"]
    assert (pointing["model"], pointing["n_stars"]) == ("carried", 0)
    assert np.hypot(pointing["delta_pixel"] - SHIFT_PX[0], pointing["delta_line"] - SHIFT_PX[1]) < 0.3
    error = attitude_error(truths["short"], short.result)
    covariance = np.array(pointing["covariance_rad2"])
    assert error @ np.linalg.solve(covariance, error) < 16.0
    solved = [
        matrix_from_quaternion(o.result["pointing"]["quaternion_camera_from_j2000"]) for o in (long, short)
    ]
    turn = solved[1] @ solved[0].T  # the covariances are of different camera axes
    own = turn @ np.array(long.result["pointing"]["covariance_rad2"]) @ turn.T
    assert np.linalg.eigvalsh(covariance - own).min() > -1e-16  # never surer than the stars it comes from
    assert "carried from the stars of long.fit (10 s before it)" in short.result["messages"][0]
    assert "carried from other pictures" in short.note
    assert not short.error


def test_its_body_is_an_observable_with_the_added_covariance(truths, processed):
    outcomes, _ = processed
    (o,) = read_ecsv(outcomes["short"].folder / "observables.ecsv")
    true = np.array(truths["short"].bodies["PLUTO"])
    assert o.status == "ok"
    assert np.hypot(*(o.observed_px - true)) < 0.2
    # The place predicted with the carried pointing is off by no more than its covariance says.
    from_pointing = o.total_covariance_px2 - o.covariance_px2
    assert np.sqrt(np.diag(from_pointing)).min() > 0.03  # the jitter that was stated
    assert o.residual_px @ np.linalg.solve(o.total_covariance_px2, o.residual_px) < 16.0


def test_nothing_is_carried_farther_than_asked(truths, processed, tmp_path):
    outcomes, _ = processed
    folders = [outcomes[name].folder for name in TIMES]
    for settings in ("", "carry_within_s=5"):
        opened = Processing(mission="new_horizons", targets="PLUTO", settings=settings).opened()
        assert carry_between(folders, opened) == {}


def test_session_carries_and_is_replayed(processed, tmp_path):
    outcomes, _ = processed
    long, short = (ImageSession.resume(outcomes[name].folder) for name in TIMES)
    carried = short.state.pointing
    assert carried.model == "carried"
    with pytest.raises(
        SessionError, match=r"short.fit has no pointing to carry: its own is carried from others"
    ):
        short.solved_attitude()
    while short.standing[-1].step != "carry_pointing":
        short.undo()
    short.undo()
    with pytest.raises(SessionError, match=r"short.fit has no pointing to carry: the "):
        short.solved_attitude()
    short.carry_pointing([long.solved_attitude()], AttitudeMotion(jitter_rad=1e-6, walk_rad=1e-7), "the pair")
    assert short.journal[-1].outcome.startswith("pointing of 1 other pictures, moved by")
    np.testing.assert_allclose(short.state.pointing.camera_from_j2000, carried.camera_from_j2000, atol=1e-12)
    short.save(tmp_path / "short")
    again = ImageSession.resume(tmp_path / "short")
    assert (
        again.state.pointing.camera_from_j2000.tobytes() == short.state.pointing.camera_from_j2000.tobytes()
    )
    # Recorded as an analyst's decisions it can be taken again.
    decisions = load_decisions(again.write_decisions(tmp_path / "decisions.yaml", who="me"))
    (taken,) = decisions.images[again.context.picture.sha256].carried
    assert taken.neighbors[0].image == "long.fit"
    while again.standing and again.standing[-1].step != "carry_pointing":
        again.undo()
    again.undo()
    perform(again, "carried", [taken])
    np.testing.assert_array_equal(
        again.state.pointing.camera_from_j2000, short.state.pointing.camera_from_j2000
    )
    # A picture's own stars count with what is carried.
    before = long.state.pointing
    long.carry_pointing([long.solved_attitude()], AttitudeMotion(jitter_rad=1e-3))
    assert long.state.pointing.n_stars == before.n_stars
    np.testing.assert_allclose(long.state.pointing.camera_from_j2000, before.camera_from_j2000, atol=1e-6)

"""The tab of the landmarks: what is drawn beside what was seen, and decisions by keys, on a simulated bumpy body."""

import sys
from pathlib import Path

import numpy as np
import pytest

from opnav_workbench.workbench.controller import WorkbenchController
from opnav_workbench.workbench.image_queue import ImageQueue

sys.path.insert(0, str(Path(__file__).parents[1] / "session"))


@pytest.mark.slow
def test_landmarks_are_shown_and_decided_by_keys(kernels, demo_truths, tmp_path, hands_on):
    from test_landmark_steps import BODY, OFF_PX, Stage

    session = Stage(demo_truths[0], tmp_path).open()
    hands = hands_on(demo_truths[0].picture)  # a viewer and hands; the bench is another one
    hands.controller = WorkbenchController(ImageQueue.of_sessions([session]), hands.viewer)
    hands.controller.runner.wait()
    hands.press("5")
    assert "No landmarks of BENNU were looked for yet" in hands.panel
    hands.press("f")
    (solution,) = session.state.landmarks
    n = int(solution.accepted.sum())
    assert f"{n} of {len(solution.centers)} landmarks in the pose" in hands.said
    # What is drawn looks like what was seen, where the pose has it.
    ids = solution.centers.id[solution.accepted].tolist()[:6]
    for patch in session.landmark_patches(BODY, ids):
        both = np.isfinite(patch.data_dn) & np.isfinite(patch.model_dn)
        seen = np.corrcoef(patch.data_dn[both], patch.model_dn[both])[0, 1]
        row = solution.centers.id.tolist().index(patch.id)
        assert seen == pytest.approx(solution.centers.correlation[row], abs=0.02)
        assert np.abs(patch.shift_px).max() < 1.0  # the pose has taken up what was believed wrongly
        middle = patch.first_px + 0.5 * (len(patch.data_dn) - 1)
        assert np.abs(middle - solution.centers.observed_px[row]).max() < 1.5
        assert np.abs(middle - (solution.centers.observed_px[row] - OFF_PX)).max() > 2.0
    # Marks over the picture, two strokes each; the ring is at the landmark under decision.
    layer = hands.viewer.layers["landmarks"]
    assert len(layer.segments) == 2 * len(solution.centers)
    assert layer.styles.count("used") == 2 * n
    first = hands.controller.tabs["landmarks"].focused
    row = solution.centers.id.tolist().index(first)
    assert hands.viewer.focused == pytest.approx(solution.centers.observed_px[row])
    hands.press("r", "2")
    assert session.state.landmark_decisions[f"{BODY}:{first}"] == ("rejected", "shadow")
    assert f"{n - 1} of" in hands.said
    hands.press("a")
    assert [verdict for verdict, _ in session.state.landmark_decisions.values()] == ["rejected", "accepted"]
    assert hands.steps[-3:] == ["find_landmarks", "reject_landmarks", "accept_landmarks"]
    hands.press("k")
    order = hands.controller.tabs["landmarks"].ids
    correlation = dict(zip(solution.centers.id.tolist(), solution.centers.correlation, strict=True))
    ranked = [correlation[one] for one in order if np.isfinite(correlation[one])]
    assert ranked == sorted(ranked)
    hands.tap(*solution.centers.observed_px[row])
    assert hands.controller.tabs["landmarks"].focused == first
    hands.press("Ctrl+z", "Ctrl+z")
    assert not session.state.landmark_decisions

"""Light of moving bodies: their own shares of a picture, and derivatives against differences of pictures."""

import numpy as np
import pytest

from opnav_workbench.render import Lambert, render_bodies, render_moving, render_touched

STEP_PX = 0.5
ANGLE_DEG = 70.0


def moving(stage, *models, window, **options):
    return render_moving(
        models, stage.camera, stage.camera_from_j2000, stage.velocity_km_s,
        psf=stage.psf, sunlight_e=1.0, window=window, **options,
    )  # fmt: skip


def test_bodies_add_up_to_their_picture(stage):
    near = stage.model(30.0, ANGLE_DEG, place_px=(400.4, 600.7))
    far = stage.model(12.0, ANGLE_DEG, place_px=(412.1, 612.3), name="FAR")
    window = (370, 570, 64, 64)
    both = moving(stage, near, far, window=window, derivatives=False)
    picture = stage.render(near, far, window=window)
    np.testing.assert_allclose(
        sum(b.electrons for b in both), picture.electrons, atol=1e-9 * picture.electrons.max()
    )
    assert [b.body.name for b in both] == ["BODY", "FAR"]
    assert both[0].slopes.shape == (0, 64, 64)


def test_one_moved_body_changes_itself_and_what_it_touches(stage):
    """What is drawn anew beside what stays is the whole scene drawn anew."""
    window = (350, 550, 120, 120)

    def scene(near_px):
        return [
            stage.model(30.0, ANGLE_DEG, place_px=near_px),
            stage.model(12.0, ANGLE_DEG, place_px=(412.1, 612.3), name="FAR"),
            stage.model(9.0, ANGLE_DEG, place_px=(440.0, 560.0), name="APART"),
        ]

    before = moving(stage, *scene((400.4, 600.7)), window=window, derivatives=False)
    after = moving(stage, *scene((401.0, 600.9)), window=window, derivatives=False)
    drawn = render_touched(
        scene((401.0, 600.9)), stage.camera, stage.camera_from_j2000, stage.velocity_km_s,
        psf=stage.psf, sunlight_e=1.0, window=window, moved=0,
    )  # fmt: skip
    assert set(drawn) == {0, 1}
    assert not np.array_equal(before[1].electrons, after[1].electrons)
    for index, whole in enumerate(after):
        one = drawn[index] if index in drawn else before[index]
        np.testing.assert_array_equal(one.electrons, whole.electrons)


@pytest.mark.parametrize("diameter_px", [0.6, 2.5, 5.0, 30.0, 200.0])
def test_slopes_are_those_of_pictures(stage, diameter_px):
    """Central differences over half a pixel, compared where both are smooth: in their scale."""
    half = int(diameter_px / 2 + 15)
    window = (400 - half, 600 - half, 2 * half, 2 * half)
    (body,) = moving(stage, stage.model(diameter_px, ANGLE_DEG, Lambert()), window=window)
    for slope, step in zip(body.slopes, STEP_PX * np.eye(2), strict=True):
        ahead, behind = (
            render_bodies(
                [stage.model(diameter_px, ANGLE_DEG, Lambert(), place_px=(400.37, 600.71) + sign * step)],
                stage.camera, stage.camera_from_j2000, stage.velocity_km_s,
                psf=stage.psf, sunlight_e=1.0, window=window,
            ).electrons
            for sign in (0.2, -0.2)
        )  # fmt: skip
        difference = (ahead - behind) / (0.4 * STEP_PX)
        assert np.sum(slope * difference) / np.sum(difference**2) == pytest.approx(1.0, abs=0.01)
        assert np.sqrt(np.mean((slope - difference) ** 2)) < 0.03 * np.sqrt(np.mean(difference**2))

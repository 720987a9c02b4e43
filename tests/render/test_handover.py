"""From a point to a resolved disk: light and center go through the three regimes without a step."""

import numpy as np
import pytest

from opnav_workbench.render import LommelSeeliger, focal_plane

PLACE = (400.37, 600.71)
WINDOW = (385, 586, 31, 31)


@pytest.mark.slow
@pytest.mark.parametrize(("phase_deg", "center_px"), [(40.0, 0.004), (110.0, 0.008)])
def test_light_and_center_follow_the_size(stage, center_of, phase_deg, center_px):
    diameters = np.arange(0.3, 12.0, 0.08)
    regimes, flux, offset = [], [], []
    for diameter in diameters:
        rendering = stage.render(
            stage.model(diameter, phase_deg, LommelSeeliger(), axes=(1.0, 0.9, 0.8)), window=WINDOW
        )
        body = rendering.bodies[0]
        regimes.append(body.regime)
        flux.append(rendering.electrons.sum() / diameter**2)
        offset.append((center_of(rendering.electrons, WINDOW[:2]) - body.center_px) / diameter)
        # The truth is one and the same integral over the surface, the picture has it.
        assert rendering.electrons.sum() == pytest.approx(body.flux_e, rel=2e-3)
        np.testing.assert_allclose(center_of(rendering.electrons, WINDOW[:2]), body.light_px, atol=center_px)
    assert {"point", "small", "disk"} == set(regimes)
    np.testing.assert_allclose(flux, np.mean(flux), rtol=3e-3)
    np.testing.assert_allclose(offset, np.tile(np.mean(offset[-30:], axis=0), (len(offset), 1)), atol=0.004)


@pytest.mark.parametrize("diameter_px", [1.2, 2.5, 3.9])
def test_a_small_crescent_has_its_own_center_of_light(stage, center_of, diameter_px):
    rng = np.random.default_rng(4)
    for place in rng.uniform([400.0, 600.0], [401.0, 601.0], (6, 2)):
        model = stage.model(diameter_px, 149.0, LommelSeeliger(), place_px=place)
        rendering = stage.render(model, window=WINDOW)
        assert rendering.bodies[0].regime == "small"
        # 0.02 px when left to cells of 1/32 px
        np.testing.assert_allclose(
            center_of(rendering.electrons, WINDOW[:2]), rendering.bodies[0].light_px, atol=2e-4
        )


@pytest.mark.parametrize(
    ("diameter_px", "limits", "phase_deg", "allowed"),
    [
        (1.0, (2.0, 9.0), 40.0, 4e-3),  # four points leave the disk's fourth moments out
        (1.0, (2.0, 9.0), 120.0, 8e-3),
        (4.0, (0.1, 9.0), 40.0, 1e-4),
        (4.0, (0.1, 9.0), 120.0, 1.5e-3),
    ],
)
def test_pictures_of_two_regimes_agree_at_their_limit(
    stage, monkeypatch, diameter_px, limits, phase_deg, allowed
):
    model = stage.model(diameter_px, phase_deg, LommelSeeliger())
    rendered = stage.render(model, window=WINDOW)
    monkeypatch.setattr(focal_plane, "SMALL_FROM_PX", limits[0])
    monkeypatch.setattr(focal_plane, "DISK_FROM_PX", limits[1])
    monkeypatch.setattr(focal_plane, "OWN_LIGHT_TO_PX", limits[1] + 1.0)
    other = stage.render(model, window=WINDOW)
    assert rendered.bodies[0].regime != other.bodies[0].regime
    peak = rendered.electrons.max()
    np.testing.assert_allclose(other.electrons, rendered.electrons, atol=allowed * peak, rtol=0)

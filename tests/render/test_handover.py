"""From a point to a resolved disk: light and center go through the three regimes without a step."""

import numpy as np
import pytest

from opnav_workbench.render import LommelSeeliger

PLACE = (400.37, 600.71)
WINDOW = (385, 586, 31, 31)


@pytest.mark.parametrize(("phase_deg", "center_px"), [(40.0, 0.002), (110.0, 0.006)])
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
        assert rendering.electrons.sum() == pytest.approx(body.flux_e, rel=1e-3)
        np.testing.assert_allclose(center_of(rendering.electrons, WINDOW[:2]), body.light_px, atol=center_px)
    assert {"point", "small", "disk"} == set(regimes)
    np.testing.assert_allclose(flux, np.mean(flux), rtol=1.5e-3)
    np.testing.assert_allclose(offset, np.tile(np.mean(offset[-30:], axis=0), (len(offset), 1)), atol=0.002)


@pytest.mark.parametrize("limit_px", [1.0, 4.0])
def test_pictures_agree_on_both_sides_of_a_limit(stage, limit_px):
    # The equivalent diameter of this body is 0.9 times the nominal one: search for the step itself.
    def picture(diameter):
        rendering = stage.render(stage.model(diameter, 50.0, LommelSeeliger()), window=WINDOW)
        return rendering.bodies[0], rendering.electrons

    (below, dark), (above, bright) = picture(limit_px * 0.9985), picture(limit_px * 1.0015)
    assert below.regime != above.regime
    scaled = dark * (above.flux_e / below.flux_e)
    # 0.3 % in size itself moves the limb of the larger disk by 0.006 px: 0.3 % of its peak.
    allowed = {1.0: 1e-3, 4.0: 4e-3}[limit_px]
    np.testing.assert_allclose(scaled, bright, atol=allowed * bright.max(), rtol=0)

"""How a body is lit, told by its disk: against light painted by another route, even and mottled, whole and cut."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from opnav_workbench.bodies import Circle, fit_lighting
from opnav_workbench.errors import CenterfindingError


def painted(phase_deg, sun_deg, *, center=(80.0, 70.0), radius=40.0, law="lambert", mottling=0.0, seed=3):
    """A sphere, sampled 4 x 4 in each pixel; Minnaert's law and an albedo that is no even one."""
    over = 4
    line, pixel = ((np.mgrid[: 150 * over, : 160 * over] + 0.5) / over) - 0.5
    x, y = (pixel - center[0]) / radius, (line - center[1]) / radius
    on = x**2 + y**2 < 1.0
    z = np.sqrt(np.where(on, 1.0 - x**2 - y**2, 0.0))
    g, a = np.radians([phase_deg, sun_deg])
    mu0 = np.maximum(np.sin(g) * (np.cos(a) * x + np.sin(a) * y) + np.cos(g) * z, 0.0)
    light = mu0 if law == "lambert" else mu0**0.7 * np.where(on, z, 1.0) ** -0.3
    rng = np.random.default_rng(seed)
    albedo = gaussian_filter(rng.normal(size=light.shape), 0.15 * radius * over)
    light = np.where(on, light, 0.0) * np.exp(mottling * albedo / albedo.std())
    binned = light.reshape(150, over, 160, over).mean(axis=(1, 3))
    return 1000.0 * binned + rng.normal(0.0, 3.0, binned.shape)


def off_deg(lit, phase_deg, sun_deg):
    """Angle between the Sun found and the true one."""

    def sun(phase, angle):
        return np.array([np.sin(phase) * np.cos(angle), np.sin(phase) * np.sin(angle), np.cos(phase)])

    cosine = sun(lit.phase_rad, lit.sun_angle_rad) @ sun(*np.radians([phase_deg, sun_deg]))
    return float(np.degrees(np.arccos(min(1.0, cosine))))


@pytest.mark.parametrize("phase_deg", [5.0, 35.0, 75.0, 110.0, 140.0])
@pytest.mark.parametrize(("law", "mottling", "within_deg"), [("lambert", 0.0, 2.0), ("minnaert", 0.2, 8.0)])
def test_the_sun_is_found_from_a_circle_by_hand(phase_deg, law, mottling, within_deg):
    image = painted(phase_deg, 205.0, law=law, mottling=mottling)
    lit = fit_lighting(image, np.zeros(image.shape, dtype=bool), Circle([82.0, 68.0], 42.5))
    assert off_deg(lit, phase_deg, 205.0) < within_deg


def test_a_disk_that_is_cut_by_the_edge_and_has_bad_pixels():
    image = painted(60.0, 20.0, center=(150.0, 70.0))
    bad = np.zeros(image.shape, dtype=bool)
    bad[60:64] = True
    image[bad] = 60000.0
    assert off_deg(fit_lighting(image, bad, Circle([149.0, 71.0], 39.0)), 60.0, 20.0) < 5.0


def test_what_cannot_tell_it_is_named():
    dark = np.zeros((50, 50))
    with pytest.raises(CenterfindingError, match="too small"):
        fit_lighting(dark, dark > 0.0, Circle([20.0, 20.0], 2.0))
    with pytest.raises(CenterfindingError, match="no light"):
        fit_lighting(dark, dark > 0.0, Circle([20.0, 20.0], 10.0))
    with pytest.raises(CenterfindingError, match="no light"):
        fit_lighting(dark + 1.0, dark > 0.0, Circle([500.0, 20.0], 10.0))

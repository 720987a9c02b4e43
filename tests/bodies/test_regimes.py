"""From points to disks: the chosen method changes without a jump, and sigma stays honest."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from opnav_workbench.bodies import choose_method, find_disk, find_least_squares, find_unresolved_body
from opnav_workbench.bodies.method import UNRESOLVED_TO_PX
from opnav_workbench.bodies.unresolved import law_covariance
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.render import FigureUncertainty, LommelSeeliger, LunarLambert

TRIAXIAL = (1.0, 0.8, 0.65)
BIAS_PX = 0.02
JUMP_PX = 0.02
# Sigmas of the PSF: LORRI 1 x 1, LORRI 4 x 4, and MVIC, which undersamples.
PSFS = (0.8, 0.65, 0.35)
LIMIT = UNRESOLVED_TO_PX
KNOWN = FigureUncertainty(0.001, 0.001, 0.0001, 0.001)


def find(picture, diameter):
    """Find as "auto" does."""
    method = choose_method(diameter)
    finders = {"unresolved": find_unresolved_body, "least_squares": find_least_squares, "disk": find_disk}
    finder = finders[method]
    return finder(picture, "BODY", search_radius_px=5.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("phase", "sigma_px"), [(0.0, 0.65), (0.0, 0.35), (60.0, 0.8), (120.0, 0.65), (120.0, 0.35)]
)
def test_no_bias_from_half_a_pixel_to_twelve(binned_stage, sigma_px, phase):
    """Pictures without noise, at any place between the pixels."""
    stage, rng, errors = (
        binned_stage.with_psf(sigma_px),
        np.random.default_rng(int(10 * sigma_px + phase)),
        [],
    )
    for diameter in (0.5, 0.98 * LIMIT, 1.02 * LIMIT, 2.3, 4.1, 12.0):
        for _ in range(2 if diameter < LIMIT else 1):
            true = 127.0 + rng.uniform(-0.5, 0.5, 2)
            model = stage.body(diameter, phase, true, TRIAXIAL, law=LunarLambert(0.5))
            light = stage.light(model, window=None)
            found = find(stage.picture(light, [model], offset_px=rng.uniform(-1.0, 1.0, 2)), diameter)
            assert found.status == "ok", (diameter, found.messages)
            # A disk's figure, law and PSF are solved too: its error is held to the sigma that they leave.
            sigma = np.sqrt(np.diag(found.covariance_px2).max()) if found.method == "disk" else 0.0
            errors.append(np.abs(found.pixel_line - true).max() / max(BIAS_PX, 1.5 * sigma))
    assert max(errors) < 1.0, np.round(errors, 4)


@pytest.mark.parametrize("phase", [0.0, 60.0, 120.0])
@pytest.mark.parametrize("sigma_px", PSFS)
def test_both_methods_agree_at_the_limit(binned_stage, sigma_px, phase, add_noise):
    """The same noisy picture on both sides of the limit: centers differ by a part of sigma, sigmas by a few percent."""
    stage, rng = binned_stage.with_psf(sigma_px), np.random.default_rng(5)
    model = stage.body(LIMIT, phase, (127.3, 126.6), TRIAXIAL, figure=KNOWN)
    picture = stage.picture(stage.light(model), [model], rng, peak_dn=700.0)
    star = find_unresolved_body(picture, "BODY", search_radius_px=5.0)
    disk = find_least_squares(picture, "BODY", search_radius_px=5.0, known_surface=True)
    assert np.abs(star.pixel_line - disk.pixel_line).max() < JUMP_PX
    sigmas = [np.sqrt(np.diag(f.covariance_px2)) for f in (star, disk)]
    # The star fit does not know the PSF's width as the rendering does; where the PSF is undersampled that costs more.
    assert np.all(
        (sigmas[0] / sigmas[1] > 0.85) & (sigmas[0] / sigmas[1] < (1.25 if sigma_px > 0.5 else 2.5))
    )


@pytest.mark.slow
@pytest.mark.parametrize(("diameter", "phase"), [(0.7, 90.0), (1.6, 60.0), (3.5, 120.0)])
def test_errors_are_what_the_covariance_says(binned_stage, add_noise, diameter, phase):
    """Of the full-disk fit and of a star's: the surface is that of the model, noise is all there is."""
    finder = find_unresolved_body if diameter < LIMIT else partial(find_least_squares, known_surface=True)
    rng, ratios = np.random.default_rng(7), []
    true = np.array([127.31, 126.84])
    model = binned_stage.body(diameter, phase, true, TRIAXIAL, figure=KNOWN)
    light = 700.0 * binned_stage.light(model)
    for _ in range(30):
        picture = binned_stage.picture(
            None, [model], data=add_noise(light, rng), offset_px=rng.uniform(-2, 2, 2)
        )
        found = finder(picture, "BODY", search_radius_px=5.0)
        ratios.append((found.pixel_line - true) / np.sqrt(np.diag(found.covariance_px2)))
    assert 0.72 < np.sqrt(np.mean(np.square(ratios))) < 1.28  # 60 components: 3 sigma
    assert np.abs(np.mean(ratios, axis=0)).max() < 0.6


@pytest.mark.parametrize("final", ["least_squares", "matched_filter", "cross_correlation"])
def test_every_final_corrects_for_phase(binned_stage, final):
    """At 2.5 px and half phase the light lies 0.7 px from the center of figure."""
    true = np.array([127.31, 126.84])
    model = binned_stage.body(2.5, 90.0, true)
    picture = binned_stage.picture(
        binned_stage.light(model), [model], np.random.default_rng(8), peak_dn=5000.0
    )
    found = find_unresolved_body(picture, "BODY", search_radius_px=5.0, final=final)
    allowed = 0.02 if final == "least_squares" else 0.1  # correlations end with a paraboloid
    assert np.abs(found.pixel_line - true).max() < allowed
    assert found.pictures is not None


@pytest.mark.slow
def test_law_enters_sigma_along_the_sun(binned_stage):
    model = binned_stage.body(3.0, 90.0, (127.31, 126.84))
    picture = binned_stage.picture(binned_stage.light(model), [model])
    assert not law_covariance(picture, "BODY", 0.0).any()
    covariance = law_covariance(picture, "BODY", 1.0)
    # Lambert's sphere has its light 0.589 radii from its center, Lommel and Seeliger's 0.563.
    assert np.sqrt(np.trace(covariance)) == pytest.approx(0.5 * (0.589 - 0.563) * 1.5, rel=0.05)
    sunward = np.linalg.eigh(covariance)[1][:, 1]
    other = binned_stage.picture(
        None, [binned_stage.body(3.0, 90.0, (127.31, 126.84), law=LommelSeeliger())], data=picture.signal_dn
    )
    moved = find_least_squares(other, "BODY").pixel_line - find_least_squares(picture, "BODY").pixel_line
    assert abs(moved @ sunward) > 0.9 * np.hypot(*moved)
    plain = find_unresolved_body(picture, "BODY", search_radius_px=5.0)
    wary = find_unresolved_body(picture, "BODY", search_radius_px=5.0, law_sigma=1.0)
    np.testing.assert_allclose(wary.covariance_px2 - plain.covariance_px2, covariance, atol=1e-9)


def test_size_and_hemispheres_enter_the_sigma_of_a_star_like_body(binned_stage):
    """At 1 px and half phase, 10 % of the size are 0.03 px toward the Sun; the hemispheres' 20 % 0.013 px every way."""
    place = (127.31, 126.84)
    model = binned_stage.body(1.0, 90.0, place)
    picture = binned_stage.picture(binned_stage.light(model), [model])
    exact = replace(model, figure=KNOWN)
    sure = find_unresolved_body(binned_stage.picture(binned_stage.light(model), [exact]), "BODY")
    more = find_unresolved_body(picture, "BODY").covariance_px2 - sure.covariance_px2
    across, sunward = np.sqrt(np.linalg.eigvalsh(more))
    assert across == pytest.approx(0.013, rel=0.05)
    assert sunward == pytest.approx(np.hypot(0.013, 0.1 * 0.58 * 0.5), rel=0.05)


def test_brightness_far_from_the_predicted_is_doubted(binned_stage):
    model = binned_stage.body(0.5, 30.0, (127.3, 126.8))
    light = binned_stage.light(model)
    bright = replace(model, flux_e=22.0 * 2000.0 * light.sum())
    assert find_unresolved_body(binned_stage.picture(light, [bright], peak_dn=2000.0), "BODY").status == "ok"
    fainter = find_unresolved_body(binned_stage.picture(light, [bright], peak_dn=300.0), "BODY")
    assert fainter.status == "uncertain"
    assert "0.15 times as bright as predicted" in fainter.messages[0]


def test_unresolved_statuses(binned_stage):
    model = binned_stage.body(1.5, 30.0, (127.3, 126.8))
    light, empty = binned_stage.light(model), np.zeros((256, 256))
    assert find_unresolved_body(binned_stage.picture(empty, [model]), "BODY").status == "not_detected"
    off = binned_stage.picture(light, [model], offset_px=(-200.0, 0.0))
    assert find_unresolved_body(off, "BODY").status == "off_detector"
    data = np.minimum(9000.0 * light, 3000.0)
    full = binned_stage.picture(None, [model], data=data, saturated=data >= 3000.0)
    assert find_unresolved_body(full, "BODY").status == "saturated"
    with pytest.raises(CenterfindingError, match="final must be one of"):
        find_unresolved_body(binned_stage.picture(light, [model]), "BODY", final="guess")

"""Places by crossings of the limb, and centers by the whole disk's light beside the likelihood's."""

from dataclasses import replace

import numpy as np
import pytest
from disk_exam import draw
from disk_truth import TrialSetup, make_trial
from scipy.stats import norm

from opnav_workbench.bodies import BodyCenter, BodyFlag, find_disk, find_least_squares
from opnav_workbench.bodies.crossings import LimbCrossings, crossing_columns, crossing_depths, fit_crossings
from opnav_workbench.bodies.disk.measurement import with_true_sky
from opnav_workbench.bodies.judgement import confirmed_center
from opnav_workbench.bodies.place import find_place
from opnav_workbench.bodies.silhouette import body_outline
from opnav_workbench.render import FigureUncertainty, Lambert, LunarLambert

TRUE = np.array([511.3, 511.8])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("diameter", "phase", "peak", "tracks"),
    [(37.0, 124.0, 80.0, 484), (28.0, 128.0, 105.0, 436), (25.0, 60.0, 77.0, 356), (22.7, 121.4, 156.0, 285)],
)
def test_tracks_of_cosmic_rays_that_outshine_a_crescent_are_not_taken_for_it(diameter, phase, peak, tracks):
    """A track is as narrow as a crescent and brighter: before, one of these was not seen and one 800 px off."""
    setup = TrialSetup(
        8,
        diameter,
        phase,
        family="blobs_0.35",
        contrast=3.0,
        peak_dn=peak,
        cosmic_rays=tracks,
        displacement_px=70.0,
    )
    trial = make_trial(setup)
    place = find_place(with_true_sky(trial.picture), trial.name)
    assert np.hypot(*(place.center_px - trial.truth_px)) < 2.0
    center = find_disk(trial.picture, trial.name)
    error = center.pixel_line - trial.truth_px
    assert center.status == "ok", center.messages
    assert error @ np.linalg.solve(center.covariance_px2, error) < 3.5**2


@pytest.mark.slow(keep=["law1"])
@pytest.mark.parametrize("law", [Lambert(), LunarLambert(0.5)])
def test_neither_albedo_nor_law_moves_a_place(body_stage, law):
    """One half twice as bright as the other, under a law that the model does not have: 0.6 to 1.1 px off without."""
    model = body_stage.body(120.0, 40.0, TRUE)
    light = body_stage.light(replace(model, law=law))
    light[:, 500:] *= 0.5 + 0.5 / (1.0 + np.exp((np.arange(500, 1024) - 520.0) / 4.0))
    picture = body_stage.picture(light, [model], np.random.default_rng(1), offset_px=(2.0, 1.0))
    place = find_place(picture, "BODY")
    np.testing.assert_allclose(place.center_px, TRUE, rtol=0, atol=0.4)
    assert place.size_ratio == pytest.approx(1.0, abs=0.01)
    found = find_disk(picture, "BODY")
    error = found.pixel_line - TRUE
    assert found.status == "ok", found.messages
    assert error @ np.linalg.solve(found.covariance_px2, error) < 14.0  # chi-squared, 1 in 1000
    np.testing.assert_allclose(error, 0.0, rtol=0, atol=0.15)


@pytest.mark.parametrize(("arc", "errors_px"), [(70.0, 25.0), (200.0, 3.0)])
def test_relief_does_not_change_a_figure(body_stage, arc, errors_px):
    """Of 70 deg of a rough limb, 800 px wide, another size and other axes could be made, and a center 100 px off."""
    model = body_stage.body(800.0, 70.0, (512.0, 512.0))
    outline = body_outline(body_stage.picture(np.zeros((1024, 1024)), [model]), "BODY")
    angle = np.radians(np.arange(1.0, 360.0, 2.0))
    known = angle < np.radians(arc)
    away = np.abs(angle[:, None] - angle)
    alike = np.exp(-np.minimum(away, 2.0 * np.pi - away) / 0.2)
    roots, rng, errors = np.linalg.cholesky(alike + 1e-9 * np.eye(len(angle))), np.random.default_rng(3), []
    for _ in range(30):
        depth, none = 1.2 * roots @ rng.normal(size=len(angle)), np.empty((len(angle), 0))
        crossings = LimbCrossings(angle, depth, known, known, none, np.zeros(len(angle)), 0.0)
        fit = fit_crossings(crossings, outline, FigureUncertainty(), 1.2, np.zeros(3), 10.0)
        errors.append(
            np.append(fit.step_px, fit.step_px @ np.linalg.solve(fit.covariance[:2, :2], fit.step_px))
        )
    errors = np.array(errors)
    assert np.sqrt(np.mean(errors[:, :2] ** 2)) < errors_px
    assert errors[:, 2].mean() < 4.0  # 2 of honest sigmas
    assert crossing_columns(angle, outline).shape == (len(angle), 5)


@pytest.mark.parametrize("figure_log_size", [0.0, 0.1, -0.1])
def test_crossings_tell_a_figure_that_is_far_from_the_models(body_stage, figure_log_size):
    """400 px wide, the model 20 px beside the limb: weights that began about it, a pixel wide, led 15 px away."""
    model = body_stage.body(400.0, 20.0, (512.0, 512.0))
    outline = body_outline(body_stage.picture(np.zeros((1024, 1024)), [model]), "BODY")
    angle, rng = np.radians(np.arange(1.0, 360.0, 2.0)), np.random.default_rng(4)
    shift = np.array([0.8, -0.5, 0.0, 0.0, 0.0])
    depth = crossing_columns(angle, outline) @ shift + np.repeat(rng.normal(scale=0.4, size=60), 3)
    depth[rng.choice(len(angle), 12)] = 8.0  # neighbours' light, hits
    known, none = np.ones(len(angle), dtype=bool), np.empty((len(angle), 0))
    crossings = LimbCrossings(angle, depth, known, known, none, np.zeros(len(angle)), 0.0)
    fit = fit_crossings(
        crossings, outline, FigureUncertainty(), 0.5, np.array([figure_log_size, 0.0, 0.0]), 1.0, far=True
    )
    error = fit.step_px - shift[:2]
    assert error @ np.linalg.solve(fit.covariance[:2, :2], error) < 3.5**2
    assert np.hypot(*error) < 0.5
    assert fit.log_size == pytest.approx(0.0, abs=0.003)
    assert fit.relief_px < 0.7


@pytest.mark.slow
def test_a_patchy_disk_nine_percent_smaller_than_its_model_is_confirmed():
    trial = make_trial(draw(9964, 79, "odd"))
    assert trial.setup.figure_error * trial.setup.figure_pattern[0] < -0.08
    center = find_disk(trial.picture, trial.name)
    error = center.pixel_line - trial.truth_px
    assert center.status == "ok", center.messages
    assert error @ np.linalg.solve(center.covariance_px2, error) < 3.5**2
    assert np.hypot(*error) < 0.3


def test_saturation_is_an_unknown_of_a_place(body_stage):
    model = body_stage.body(120.0, 60.0, TRUE)
    picture = body_stage.picture(body_stage.light(model), [model], np.random.default_rng(1))
    top = 0.3 * picture.signal_dn.max()
    saturated = picture.signal_dn > top
    cut = replace(picture, signal_dn=np.minimum(picture.signal_dn, top), saturated=saturated)
    place = find_place(cut, "BODY")
    np.testing.assert_allclose(place.center_px, TRUE, rtol=0, atol=3.0)
    assert np.hypot(*(place.center_px - TRUE)) < 3.0 * place.center_sigma_px


@pytest.mark.slow
@pytest.mark.parametrize(
    ("diameter_px", "place_px", "family", "contrast", "displacement_px"),
    [
        pytest.param(1600.0, (1300.0, 400.0), "blobs_0.05", 3.0, 3.0, id="1600 px"),
        pytest.param(1550.0, (-150.0, 1300.0), "blobs_0.35", 9.0, 70.0, id="a corner"),
        pytest.param(911.0, (-148.0, 1226.0), "blobs_0.35", 9.0, 199.0, id="displaced"),
    ],
)
def test_what_the_frame_cuts_is_found(diameter_px, place_px, family, contrast, displacement_px):
    """Less of the body is in the frame than a third of it: what is bright was taken from the sky, 490 px off or nowhere."""
    setup = TrialSetup(
        5, diameter_px, 40.0, family, contrast, place_px=place_px, displacement_px=displacement_px
    )
    trial = make_trial(setup)
    place = find_place(trial.picture, trial.name)
    assert np.hypot(*(place.center_px - trial.truth_px)) < 0.01 * diameter_px


@pytest.mark.slow
@pytest.mark.parametrize("truth_share", [1.0, 1.08])
def test_full_disk_center_beside_the_likelihood(body_stage, truth_share):
    """A body 8 % larger than expected, half lit, is fitted with its disk's size; with its own it is 1.2 px off."""
    model = body_stage.body(60.0, 80.0, TRUE)
    larger = replace(model, target=replace(model.target, radii_km=truth_share * model.target.radii_km))
    picture = body_stage.picture(body_stage.light(larger), [model], np.random.default_rng(1))
    center = find_least_squares(picture, "BODY")
    assert center.second.method == "the likelihood of the disk"
    assert center.status == "ok", center.messages
    error = center.pixel_line - TRUE
    assert np.sqrt(error @ np.linalg.solve(center.covariance_px2, error)) < 4.0
    assert np.hypot(*error) < 0.05
    alone = find_least_squares(picture, "BODY", known_surface=True)
    assert alone.second is None
    other = confirmed_center(alone, find_disk(picture, "BODY"))
    assert np.array_equal(other.pixel_line, alone.pixel_line)
    right = truth_share == 1.0
    assert bool(other.flags & BodyFlag.UNCONFIRMED) != right
    assert (other.status == "ok") == right
    away = other.pixel_line - other.second.pixel_line
    assert away @ other.covariance_px2 @ away > 0.2 * (away @ away) ** 2  # half of the difference is in it


def test_what_has_no_likelihood_confirms_nothing(body_stage):
    model = body_stage.body(60.0, 40.0, TRUE)
    picture = body_stage.picture(body_stage.light(model), [model], np.random.default_rng(1))
    alone = find_least_squares(picture, "BODY", known_surface=True)
    none = BodyCenter.without_center("BODY", "disk", "failed", "no pixels about its limb")
    center = confirmed_center(alone, none)
    assert (alone.status, center.status) == ("ok", "uncertain")
    assert "no pixels about its limb" in center.messages[-1]
    doubted = replace(find_disk(picture, "BODY"), flags=int(BodyFlag.UNCONFIRMED))
    assert confirmed_center(alone, doubted).status == "uncertain"
    assert confirmed_center(none, doubted) is none


@pytest.mark.parametrize("e_folding_px", [4.0, 12.0])
def test_stray_light_before_a_limb_is_no_limb(e_folding_px):
    """A limb blurred by a PSF behind light that grows toward it, up to a third of the body's own, as of fouled optics."""
    depth = np.arange(-20.0, 60.0, 0.25)
    body = norm.cdf(-depth / 0.9)
    stray = 0.3 * np.exp(-np.maximum(depth, 0.0) / e_folding_px)
    found = crossing_depths(np.stack([body, np.maximum(body, stray)]), depth, 1.1, 0.02)
    np.testing.assert_allclose(found, 0.0, rtol=0, atol=0.35)


def test_a_dark_limb_is_crossed_though_the_surface_is_brighter_behind():
    depth = np.arange(-20.0, 20.0, 0.25)
    profile = 0.12 * norm.cdf(-depth / 0.9) + 0.88 * norm.cdf(-(depth + 5.0) / 0.9)
    np.testing.assert_allclose(crossing_depths(profile[None], depth, 1.1, 0.02), 0.0, rtol=0, atol=0.3)

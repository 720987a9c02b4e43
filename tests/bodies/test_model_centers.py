"""Full-disk methods: against brute-force pictures, error over sigma, and patterns that the model lacks."""

import numpy as np
import pytest

from opnav_workbench.bodies import BodyFlag, ModelFit, find_cross_correlation, find_least_squares
from opnav_workbench.render import AlbedoMap
from opnav_workbench.simulation.surfaces import mottled_map

FINDERS = [find_cross_correlation, find_least_squares]
SPHERE, TRIAXIAL = (1.0, 1.0, 1.0), (1.0, 0.8, 0.65)
BIAS_PX = 0.003


@pytest.mark.slow
@pytest.mark.parametrize(
    ("diameter", "phase", "axes", "rays"),
    [
        (5.0, 0.0, TRIAXIAL, 32),
        (5.0, 120.0, SPHERE, 48),
        (16.0, 60.0, TRIAXIAL, 32),
        (60.0, 90.0, TRIAXIAL, 16),
    ],
)
def test_no_bias_against_brute_force(body_stage, diameter, phase, axes, rays):
    """Pictures from 16 to 48 rays a side of a pixel, without noise: what is left is sampling, of both."""
    true = np.array([511.27, 511.64])
    model = body_stage.body(diameter, phase, true, axes)
    half = int(diameter / 2 + 12)
    light = body_stage.brute_force(model, (511 - half, 511 - half, 2 * half + 2, 2 * half + 2), rays)
    for finder in FINDERS:
        found = finder(body_stage.picture(light, [model], offset_px=(3.2, -2.7)), "BODY")
        assert found.status == "ok", found.messages
        np.testing.assert_allclose(found.pixel_line, true, atol=BIAS_PX, err_msg=finder.__name__)


@pytest.mark.slow
@pytest.mark.parametrize("sigma_px", [0.3, 1.5])
def test_no_bias_with_a_sharp_or_wide_psf(body_stage, sigma_px):
    stage, true = body_stage.with_psf(sigma_px), np.array([300.81, 640.33])
    model = stage.body(20.0, 70.0, true)
    light = stage.brute_force(model, (280, 620, 42, 42), 32)
    for finder in FINDERS:
        found = finder(stage.picture(light, [model], offset_px=(-4.4, 3.1)), "BODY")
        np.testing.assert_allclose(found.pixel_line, true, atol=BIAS_PX, err_msg=finder.__name__)


def trials(stage, model, true, light, count, seed, add_noise):
    """Errors and errors over sigma (count, 2 methods, 2) with fresh noise on one picture."""
    rng, out = np.random.default_rng(seed), []
    for _ in range(count):
        data = add_noise(700.0 * light, rng)  # the brightest pixel has 110 sigma
        picture = stage.picture(light, [model], data=data, offset_px=rng.uniform(-2.0, 2.0, 2))
        # The surface is the model's: what the likelihood leaves open of it is no error here.
        found = [finder(picture, "BODY", search_radius_px=8.0, known_surface=True) for finder in FINDERS]
        out.append(
            [
                ((f.pixel_line - true), (f.pixel_line - true) / np.sqrt(np.diag(f.covariance_px2)))
                for f in found
            ]
        )
    return np.array(out)


def check_trials(result, lowest, highest, bias_px=0.005):
    error, ratio = result[:, :, 0], np.sqrt(np.mean(result[:, :, 1] ** 2, axis=(0, 2)))
    assert np.all((ratio > lowest) & (ratio < highest)), ratio
    assert np.abs(error).max() < 0.02
    assert np.abs(error.mean(axis=0)).max() < bias_px


@pytest.mark.slow
def test_errors_are_what_the_covariance_says(binned_stage, add_noise, sample):
    true = np.array([127.31, 126.84])
    model = binned_stage.body(6.0, 75.0, true, TRIAXIAL)
    light = binned_stage.brute_force(model, (112, 112, 30, 30), 32)
    result = trials(binned_stage, model, true, light, sample.trials(30), 1, add_noise)
    chance = sample.within(0.28)  # 60 components of each: 3 sigma of their root mean square
    check_trials(result, 1.0 - chance, 1.0 + chance, sample.within(0.005))


@pytest.mark.slow
def test_errors_over_sigma_of_many_trials(binned_stage, add_noise):
    """0.9 to 1.1, as far as the 180 components of both bodies can tell (5.3 %), and those of each (7.5 %).

    500 trials of each gave 0.92 to 1.10.
    """
    true, results = np.array([127.31, 126.84]), []
    for diameter, phase, axes in ((5.0, 30.0, SPHERE), (9.0, 110.0, TRIAXIAL)):
        model = binned_stage.body(diameter, phase, true, axes)
        half = int(diameter / 2 + 12)
        light = binned_stage.brute_force(model, (127 - half, 127 - half, 2 * half, 2 * half), 32)
        results.append(trials(binned_stage, model, true, light, 45, 2, add_noise))
        check_trials(results[-1], 0.75, 1.25, 0.006)
    check_trials(np.concatenate(results), 0.81, 1.19)


@pytest.mark.slow
@pytest.mark.parametrize("finder", FINDERS)
def test_body_far_from_its_prediction_is_found(body_stage, finder):
    """A 4500 km error of the barycenter at 2.5 million km: 0.98 radii away."""
    true = np.array([480.3, 530.7])
    model = body_stage.body(190.0, 15.0, true)
    light = body_stage.light(model)
    picture = body_stage.picture(light, [model], np.random.default_rng(3), offset_px=(66.0, -66.0))
    found = finder(picture, "BODY")
    assert found.status == "ok", found.messages
    np.testing.assert_allclose(found.pixel_line, true, atol=0.01)
    assert isinstance(found.detail, ModelFit)


def test_results_tell_the_whole_fit(body_stage):
    true = np.array([480.3, 530.7])
    model = body_stage.body(30.0, 40.0, true)
    picture = body_stage.picture(body_stage.light(model), [model], np.random.default_rng(4), peak_dn=2000.0)
    found = find_least_squares(picture, "BODY", solve_range=True)
    assert found.status == "ok", found.messages
    assert abs(found.diameter_px - 30.0) < 4.0 * found.diameter_sigma_px < 0.05
    assert (
        abs(found.range_km / model.target.range_km - 1.0) < 4.0 * found.range_sigma_km / found.range_km < 2e-3
    )
    assert abs(found.background_dn) < 4.0 * found.background_sigma_dn < 1.0
    assert found.chi2_reduced == pytest.approx(1.0, abs=0.1)
    assert found.noise_covariance_px2[0, 0] <= found.covariance_px2[0, 0]
    window, pictures = found.pictures.window, found.pictures
    assert pictures.data_dn.shape == pictures.model_dn.shape == (window[3], window[2])
    np.testing.assert_allclose(
        pictures.difference_dn[pictures.mask],
        (pictures.data_dn - pictures.model_dn)[pictures.mask],
        atol=1e-9,
    )
    with pytest.raises(ValueError, match="read-only"):
        pictures.model_dn[0, 0] = 1.0


def test_range_from_a_wrong_start(body_stage):
    model = body_stage.body(60.0, 40.0, (480.3, 530.7))
    light = body_stage.light(model)
    expected = body_stage.body(48.0, 40.0, (480.3, 530.7))
    picture = body_stage.picture(light, [expected], np.random.default_rng(5))
    found = find_least_squares(picture, "BODY", solve_range=True)
    assert found.diameter_px == pytest.approx(60.0, abs=0.05)
    np.testing.assert_allclose(found.pixel_line, (480.3, 530.7), atol=0.02)


@pytest.mark.slow
def test_cosmic_rays_and_bad_pixels_do_not_move_it(body_stage):
    rng, true = np.random.default_rng(6), np.array([480.3, 530.7])
    model = body_stage.body(60.0, 40.0, true)
    data = 1200.0 * body_stage.light(model)
    data += rng.normal(size=data.shape) * np.sqrt(9.0 + data / 22.0)
    lines, pixels = rng.integers(490, 570, 40), rng.integers(440, 520, 40)
    data[lines, pixels] += rng.uniform(200.0, 5000.0, 40)
    data[540, 440:520] = -500.0
    bad = np.zeros(data.shape, dtype=bool)
    bad[540] = True
    data[500:504, 470] = np.nan
    picture = body_stage.picture(None, [model], data=data, bad=bad, offset_px=(3.0, 3.0))
    for finder in FINDERS:
        found = finder(picture, "BODY")
        assert found.status == "ok", found.messages
        assert np.all(np.abs(found.pixel_line - true) < 4.0 * np.sqrt(np.diag(found.covariance_px2)))
        assert found.flags & BodyFlag.HIT
        assert found.flags & BodyFlag.BAD_PIXELS
        assert found.chi2_reduced < 1.2
        assert (
            found.detail.hits[lines - found.pictures.window[1], pixels - found.pictures.window[0]].mean()
            > 0.8
        )


@pytest.mark.slow
def test_a_pattern_the_model_lacks_is_in_sigma(body_stage):
    """Maps of Pluto's contrast: sigma must be of the order of the error, not 100 times smaller."""
    squares, shares = [], []
    for seed in range(5):
        true = np.array([480.3, 530.7])
        plain = body_stage.body(50.0, 15.0, true)
        mottled = body_stage.body(
            50.0, 15.0, true, albedo=AlbedoMap(mottled_map(seed, smallest_deg=3.0, largest_deg=12.0, rows=90))
        )
        picture = body_stage.picture(body_stage.light(mottled), [plain], np.random.default_rng(seed))
        found = find_least_squares(picture, "BODY")
        error = found.pixel_line - true
        squares.append(error @ np.linalg.solve(found.covariance_px2, error) / 2.0)
        shares.append(np.sqrt(found.covariance_px2[0, 0] / found.noise_covariance_px2[0, 0]))
        assert found.detail.pattern_sigma > 0.1
        assert found.detail.pattern_length_px > 1.0
    assert 0.3 < np.mean(squares) < 3.0
    assert min(shares) > 20.0

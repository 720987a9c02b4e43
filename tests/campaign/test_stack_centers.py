"""Centers in stacks against truth: honest sigmas, growing signal, hits masked, star fields taken away."""

from dataclasses import replace

import numpy as np
import pytest

from opnav_workbench.campaign.stacking import (
    find_in_stack,
    fit_point,
    snr_growth,
    stack_attitude_covariance,
    stack_observable,
    stack_pictures,
)
from opnav_workbench.campaign.stacking.centers import _FitBox, _fitted
from opnav_workbench.campaign.stacking.grid import target_direction
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.psf import add_sources


def trials(make_sky, count, *, geometries=10, **options):
    """Yield fits of a target and its true place; the pictures of a geometry share all but their noise."""
    rng = np.random.default_rng(11)
    for seed in range(geometries):
        sky = make_sky(seed=seed, offset_px=tuple(rng.uniform(-0.8, 0.8, 2)), **options)
        lit = [f.replace(signal_dn=light) for f, light in zip(sky.pictures, sky.light, strict=True)]
        stacked = stack_pictures(lit, "target", window_px=20, reject_hits=False)
        truth = sky.target(stacked)
        box = _FitBox(stacked, truth)
        still = np.array(box.data)
        for _ in range(count // geometries):
            noise = [
                m @ (rng.normal(size=f.bad.size) * f.noise_dn.ravel())
                for m, f in zip(box.operators, lit, strict=True)
            ]
            box.data = still + np.sum(noise, axis=0)
            yield _fitted(box, truth + rng.uniform(-0.3, 0.3, 2)), truth


@pytest.mark.slow
def test_errors_are_as_large_as_their_sigmas(make_sky, sample):
    """500 stacks of undersampled pictures at random phases: error over sigma 0.9 to 1.1, bias below 0.1 sigma."""
    errors, fluxes, chi2, flux = [], [], [], 35.0
    for fit, truth in trials(make_sky, sample.trials(500), flux=flux, exposures=[5.0, 20.0, 10.0, 20.0]):
        assert fit.converged
        assert fit.snr > 7.0
        errors.append(np.linalg.solve(np.linalg.cholesky(fit.covariance_px2), fit.pixel_line - truth))
        fluxes.append((fit.flux_dn - flux) / fit.flux_sigma_dn)
        chi2.append(fit.chi2_reduced)
    scatter = np.array(errors)
    assert abs(scatter.std() - 1.0) < sample.within(0.1)
    assert np.abs(scatter.mean(axis=0)).max() < sample.within(
        0.15
    )  # 0.1, and 500 trials know a mean to 0.045
    assert abs(np.std(fluxes) - 1.0) < sample.within(0.1)
    assert abs(np.mean(chi2) - 1.0) < sample.within(
        0.03
    )  # the covariance of the pixels is right, correlations and all


def test_the_signal_grows_as_the_root_of_the_number(make_sky, exposed):
    """Sixteen pictures: SNR 3 each, 12 together; and no stack knows more than the pictures themselves."""
    sky = make_sky(16, 18.0, motion_px=0.3, seed=4)
    stacked = stack_pictures(exposed(sky, np.random.default_rng(0)), "target", window_px=20)
    growth = snr_growth(stacked, sky.target(stacked))
    assert growth.pictures.tolist() == [1, 2, 4, 8, 16]
    ideal = growth.flux_sigma_dn[-1] * np.sqrt(16 / growth.pictures)
    assert growth.flux_sigma_dn == pytest.approx(ideal, rel=0.03)
    assert growth.snr[-1] == pytest.approx(18.0 / growth.flux_sigma_dn[-1], abs=3.0)
    information = sum(
        (light / 18.0 / picture.noise_dn) ** 2 for picture, light in zip(sky.pictures, sky.light, strict=True)
    )
    bound = float(np.sum(information)) ** -0.5  # of the flux, everything else known
    assert bound < growth.flux_sigma_dn[-1] < 1.1 * bound


@pytest.mark.slow
def test_a_target_too_faint_for_each_picture_is_found_in_their_stack(make_sky, exposed):
    rng = np.random.default_rng(5)
    found = wrong = 0
    for seed in range(8):
        sky = make_sky(9, 20.0, seed=seed, offset_px=tuple(rng.uniform(-1.0, 1.0, 2)))
        stacked = stack_pictures(exposed(sky, rng), "target", window_px=24)
        center = find_in_stack(stacked, "FAINT")
        assert center.method == "stack"
        if center.status == "ok":
            found += 1
            assert 5.0 < center.snr < 15.0
            off = (center.pixel_line - sky.target(stacked)) / np.sqrt(np.diag(center.covariance_px2))
            assert np.abs(off).max() < 4.5
        empty = make_sky(9, 0.0, seed=seed)
        nothing = find_in_stack(stack_pictures(exposed(empty, rng), "target", window_px=24), "FAINT")
        wrong += nothing.pixel_line is not None
    assert found >= 7
    assert wrong <= 2  # 0.08 expected


def test_hits_are_masked_and_the_target_is_not(make_sky, exposed):
    """Cosmic rays, one on the target itself: the center stays where it was, and nothing else is masked."""
    sky = make_sky(7, 200.0, seed=6, offset_px=(0.3, 0.2))
    pictures = exposed(sky, np.random.default_rng(6))
    clean = stack_pictures(pictures, "target", window_px=24)
    assert sum(clean.hits) <= 2
    place = np.round(clean.grid.to_picture(sky.target(clean)[None], pictures[2])[0]).astype(int)
    hit = np.array(pictures[2].signal_dn)
    hit[place[1], place[0] - 1] += 400.0
    hit[10, 12:16] += 300.0
    pictures[2] = pictures[2].replace(signal_dn=hit)
    masked = stack_pictures(pictures, "target", window_px=24)
    assert masked.hits[2] >= 3
    truth = sky.target(clean)
    fits = [
        fit_point(s, truth)
        for s in (clean, masked, stack_pictures(pictures, "target", window_px=24, reject_hits=False))
    ]
    sigma = np.sqrt(np.diag(fits[1].covariance_px2))
    assert np.abs((fits[1].pixel_line - truth) / sigma).max() < 4.0
    assert np.abs((fits[2].pixel_line - truth) / sigma).max() > 10.0  # what it would have been
    assert fits[1].covariance_px2[0, 0] > fits[0].covariance_px2[0, 0]  # and it knows what it lost
    two = stack_pictures(pictures[:2], "target", window_px=24)
    assert "none is masked" in two.messages[0]


@pytest.mark.slow
def test_a_star_field_is_taken_away(make_sky, exposed):
    """Target among eighty stars that it passes: the errors fall to what the noise and the templates leave."""
    errors, plain, fits = [], [], []
    for seed in range(5):
        sky = make_sky(7, 60.0, size=60, seed=seed, stars=80, motion_px=4.0, offset_px=(0.4, -0.3))
        pictures = exposed(sky, np.random.default_rng(seed))
        subtracted = stack_pictures(pictures, "target", window_px=32, subtract=True)
        truth = sky.target(subtracted)
        fit = fit_point(subtracted, truth)
        fits.append(fit)
        errors.append((fit.pixel_line - truth) / np.sqrt(np.diag(fit.covariance_px2)))
        raw = fit_point(stack_pictures(pictures, "target", window_px=32, reject_hits=False), truth)
        plain.append((raw.pixel_line - truth) / np.sqrt(np.diag(raw.covariance_px2)))
        kernels = np.array([s.kernel for s in subtracted.subtractions])
        assert kernels.sum(axis=(1, 2)) == pytest.approx(
            np.ones(7), abs=0.1
        )  # light is neither lost nor made
    assert all(fit.converged for fit in fits)
    assert np.abs(errors).max() < 4.0
    assert 0.4 < np.std(errors) < 1.6  # 10 values: 22 %
    assert np.std(plain) > 2.0  # what the stars did
    assert np.mean([fit.flux_dn for fit in fits]) == pytest.approx(60.0, abs=4.0)


def test_the_observable_is_that_of_the_mean_epoch(make_sky, exposed):
    sky = make_sky(5, 100.0, seed=2, offset_px=(0.5, -0.25), exposures=[10.0, 10.0, 10.0, 10.0, 20.0])
    attitude, catalog = np.diag([4e-14, 4e-14, 1e-8]), np.diag([1e-14, 1e-14, 2e-9])
    pictures = [
        f.replace(attitude_covariance_rad2=attitude, catalog_covariance_rad2=catalog)
        for f in exposed(sky, np.random.default_rng(2))
    ]
    stacked = stack_pictures(pictures, "target", window_px=20)
    center = find_in_stack(stacked, "FAINT")
    observable = stack_observable(
        stacked, center, image="stack.fits", utc="2015-04-09T12:00:00", reference_body="SUN"
    )
    weights = np.array([1.0, 1.0, 1.0, 1.0, 4.0]) / 8.0  # twice the light in the same noise counts four times
    assert stacked.weights == pytest.approx(weights)
    assert observable.et == pytest.approx(float(weights @ (600.0 * np.arange(5))))
    expected = sky.target(stacked) - stacked.predicted_px
    assert np.abs((observable.residual_px - expected) / np.sqrt(np.diag(center.covariance_px2))).max() < 4.5
    # The target's place at that epoch, by the polynomial that made it.
    states = np.array([f.target.position_km for f in pictures])
    index = np.array([np.interp(observable.et, 600.0 * np.arange(5), states[:, i]) for i in range(3)])
    assert np.abs(stacked.target.position_km - index).max() < 1e-2  # of 1e8 km: straight motion
    own = (attitude - catalog) * float(weights @ weights)
    assert stack_attitude_covariance(pictures, stacked.weights) == pytest.approx(own + catalog)
    by_attitude = (
        np.asarray(observable.partials_px_per_rad)
        @ (own + catalog)
        @ np.asarray(observable.partials_px_per_rad).T
    )
    assert observable.total_covariance_px2 == pytest.approx(center.covariance_px2 + by_attitude)


def test_a_stack_is_no_surer_than_the_pointing_of_its_pictures(make_sky, exposed):
    sky = make_sky(5, 100.0, seed=2)
    pictures = exposed(sky, np.random.default_rng(2))
    names = {"image": "stack.fits", "utc": "2015-04-09T12:00:00", "reference_body": "SUN"}
    stacked = stack_pictures(pictures, "target", window_px=20)
    center = find_in_stack(stacked, "FAINT")
    assert stack_observable(stacked, center, **names).status == center.status == "ok"
    doubtful = tuple(f.replace(pointing_doubt="which field?") for f in stacked.pictures[:2])
    told = stack_observable(replace(stacked, pictures=(*doubtful, *stacked.pictures[2:])), center, **names)
    assert told.status == "uncertain"
    assert told.messages[-1] == "sky_0.fit: which field?; and 1 more picture"


def test_shot_noise_of_a_bright_target_counts(make_sky, exposed):
    sky = make_sky(4, 3000.0, seed=1)
    pictures = exposed(sky, np.random.default_rng(1))
    dark, bright = (
        fit_point(s, sky.target(s))
        for s in (
            stack_pictures([f.replace(gain_e_per_dn=g) for f in pictures], "target", window_px=20)
            for g in (np.inf, 1.0)
        )
    )
    assert bright.flux_sigma_dn > 2.0 * dark.flux_sigma_dn
    assert bright.flux_sigma_dn > np.sqrt(3000.0 / 4.0)  # four pictures of 3000 electrons each


def test_unusable_stacks_say_so(make_sky, exposed):
    sky = make_sky(4, 50.0)
    pictures = exposed(sky, np.random.default_rng(0))
    stacked = stack_pictures(pictures, "target", window_px=20)
    with pytest.raises(CenterfindingError, match="give predicted_px"):
        find_in_stack(replace(stacked, target=None), "FAINT")
    with pytest.raises(CenterfindingError, match="no observable"):
        stack_observable(
            replace(stacked, target=None),
            find_in_stack(stacked, "FAINT"),
            image="x",
            utc="",
            reference_body="SUN",
        )
    hidden = [f.replace(bad=np.ones_like(f.bad)) for f in pictures[:3]]
    with pytest.raises(CenterfindingError, match=r"sky_0\.fit: no usable pixel"):
        stack_pictures([*hidden, pictures[3]], "target")


def test_a_bright_neighbour_does_not_pull(make_sky, exposed):
    """A body 200 times as bright, six pixels away: known, it is left out; the center is where it should be."""
    sky = make_sky(8, 40.0, seed=3, size=48, offset_px=(0.3, -0.2))
    pictures = exposed(sky, np.random.default_rng(3))
    lit = []
    for picture in pictures:
        place = picture.camera.project((picture.camera_from_j2000 @ target_direction(picture))[None])
        image = np.array(picture.signal_dn)
        beside = place + np.array([4.0, 4.5])
        add_sources(image, picture.psf, beside, [8000.0])
        seen = picture.camera.unproject(beside) @ picture.camera_from_j2000
        lit.append(picture.replace(signal_dn=image, neighbours=seen))
    stacked = stack_pictures(lit, "target", window_px=32, reject_hits=False)
    center = find_in_stack(stacked, "FAINT")
    assert center.status == "ok", center.messages
    off = (center.pixel_line - sky.target(stacked)) / np.sqrt(np.diag(center.covariance_px2))
    assert np.abs(off).max() < 4.0

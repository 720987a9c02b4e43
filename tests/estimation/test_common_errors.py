"""Errors of centers that pictures have in common: what the measurements say of the share, and sigmas that hold."""

from dataclasses import replace

import numpy as np
import pytest

from opnav_workbench.estimation import Acceleration, Pointing, estimate, estimate_with_common_errors
from opnav_workbench.estimation.common_errors import SHARES, SIZES

DAYS = np.linspace(8.0, 3.0, 6)
NOISE = 0.01**2 * np.eye(2)


@pytest.fixture(scope="module")
def pictures(approach):
    """Centers of Pluto and Charon, 0.1 px of error beyond 0.01 px of noise; the pointing known ten times better."""
    return approach(pointing_sigma_px=0.01).observables(DAYS)


def spoiled(observables, displaced, rng, share, size=1.0):
    """Centers with noise, errors of their own, and one error east and north that all of them have."""
    common, drawn = rng.normal(size=2), []
    for o in observables:
        u, _, v = np.linalg.svd(o.sky_partials_px_per_rad)
        sigma = size * np.sqrt(0.1**2 - 0.01**2)
        error = sigma * (np.sqrt(share) * u @ v @ common + np.sqrt(1.0 - share) * rng.normal(size=2))
        pointing = np.linalg.cholesky(o.total_covariance_px2 - o.covariance_px2 + 1e-12 * np.eye(2))
        drawn.append(displaced(o, error + 0.01 * rng.normal(size=2) + pointing @ rng.normal(size=2)))
    return drawn


def solved(drawn):
    return estimate_with_common_errors(
        drawn,
        [NOISE] * len(drawn),
        ["target_position"],
        a_priori={"target_position": 5000.0},
        reject_sigmas=np.inf,
    )


def test_measurements_tell_what_is_common(pictures, displaced):
    rng = np.random.default_rng(2)
    shares = {s: solved(spoiled(pictures, displaced, rng, s)).share for s in (0.0, 0.98)}
    assert shares[0.0] < 0.4
    assert shares[0.98] > 0.7


def test_measurements_tell_how_large_errors_are(pictures, displaced):
    """A third or three times of what is stated, of which half is common: the size is seen, and the sigmas follow it."""
    found = {}
    for size in (1.0 / 3.0, 1.0, 3.0):
        rng = np.random.default_rng(7)
        found[size] = solved(spoiled(pictures, displaced, rng, 0.5, size))
    assert found[1.0 / 3.0].size < 0.6
    assert 0.7 < found[1.0].size < 1.4
    assert found[3.0].size > 2.0
    across = {size: np.sqrt(np.linalg.eigvalsh(f.covariance)[0]) for size, f in found.items()}
    assert across[1.0 / 3.0] < 0.7 * across[1.0] < 0.5 * across[3.0]


def test_without_model_errors_it_is_the_batch(pictures, noise_of):
    drawn = noise_of(pictures).draw(np.random.default_rng(2))
    batch = estimate(drawn, ["target_position"], a_priori={"target_position": 5000.0})
    found = estimate_with_common_errors(
        drawn, [None] * len(drawn), ["target_position"], a_priori={"target_position": 5000.0}
    )
    assert np.abs((found.correction - batch.correction) / batch.sigma).max() < 1e-6
    np.testing.assert_allclose(found.covariance, batch.covariance, rtol=1e-6, atol=1e-9)
    shares = found.weights.reshape(len(SHARES), len(SIZES))
    np.testing.assert_allclose(
        shares, np.tile(shares[0], (len(SHARES), 1)), rtol=1e-6
    )  # nothing tells them apart
    for mine, theirs in zip(found.after, found.independent.residuals, strict=True):
        np.testing.assert_allclose(mine, theirs.after, atol=1e-6)


def test_outliers_are_those_of_the_batch(pictures, displaced):
    drawn = spoiled(pictures, displaced, np.random.default_rng(3), 0.5)
    drawn[7] = displaced(drawn[7], np.array([0.8, -0.7]))
    options = {"parameters": ["target_position"], "a_priori": {"target_position": 5000.0}}
    found = estimate_with_common_errors(drawn, [NOISE] * len(drawn), **options)
    assert [(r.image, r.body) for r in found.independent.residuals if not r.used] == [
        ("lor_003.fit", "CHARON")
    ]
    rest = estimate_with_common_errors(
        [o for k, o in enumerate(drawn) if k != 7], [NOISE] * (len(drawn) - 1), **options
    )
    np.testing.assert_allclose(found.correction, rest.correction, rtol=1e-9)


@pytest.mark.slow
def test_filter_in_the_batchs_place(approach, pictures, displaced):
    """Without noise it is the batch; noise of pointing that each picture has for itself is that of its attitude.

    The likelihood of the shares has to count the noise: with pointing as bad as centers it tells them another tale.
    """
    asked = {"parameters": ["target_position"], "a_priori": {"target_position": 5000.0}}
    drawn = spoiled(pictures, displaced, np.random.default_rng(5), 0.5)
    noise = [NOISE] * len(drawn)
    batch = estimate_with_common_errors(drawn, noise, **asked)
    passed = estimate_with_common_errors(drawn, noise, filter_options={}, **asked)
    _same(passed, batch)
    assert batch.filtered is None
    worse = [
        replace(new, observed_px=o.observed_px, residual_px=o.residual_px, ra_deg=o.ra_deg, dec_deg=o.dec_deg)
        for o, new in zip(drawn, approach(pointing_sigma_px=0.1).observables(DAYS), strict=True)
    ]
    of_scale = approach().camera.pixel_scale_rad
    extra = Pointing(tuple(np.array([1.0, 1.0, 1e-9]) * of_scale * np.sqrt(0.1**2 - 0.01**2)))
    turning = estimate_with_common_errors(drawn, noise, filter_options={"pointing": extra}, **asked)
    _same(turning, estimate_with_common_errors(worse, noise, **asked))
    assert np.abs(turning.weights - batch.weights).max() > 0.02


def _same(one, other):
    """But for what the batch's one linearization leaves."""
    assert np.abs((one.correction - other.correction) / np.sqrt(np.diag(other.covariance))).max() < 3e-4
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-3)
    np.testing.assert_allclose(one.weights, other.weights, rtol=1e-3, atol=1e-12)


def test_pushed_spacecraft_is_known_less(pictures, displaced):
    drawn = spoiled(pictures[:6], displaced, np.random.default_rng(6), 0.5)
    names = ("spacecraft_position", "spacecraft_velocity")
    asked = {"parameters": names, "a_priori": dict(zip(names, (5000.0, 0.01), strict=True))}
    quiet, pushed = (
        estimate_with_common_errors(drawn, [NOISE] * len(drawn), filter_options=options, **asked)
        for options in ({}, {"accelerations": (Acceleration(1e-8, 86400.0),)})
    )
    assert (np.diag(pushed.covariance) > 1.05 * np.diag(quiet.covariance))[:3].any()
    assert len(pushed.correction) == 6
    assert pushed.independent.correction.shape == (6,)
    assert len(pushed.filtered.labels) == 9


def starred(approach, observables, rng):
    """Six stars that all pictures show: how they turn each attitude, which errs in little else."""
    scale = np.array([1.0, 1.0, 30.0]) * approach.camera.pixel_scale_rad
    attitudes = {o.image: approach.attitude(o.et, number) for number, o in enumerate(observables[::2])}
    first = next(iter(attitudes.values()))
    axes = 0.05 * rng.normal(size=(6, 3, 2)) * scale[:, None]
    turns = {
        image: {f"star {k}": attitude @ first.T @ axis for k, axis in enumerate(axes)}
        for image, attitude in attitudes.items()
    }
    found = []
    for o in observables:
        covariance = sum(b @ b.T for b in turns[o.image].values()) + np.diag((0.01 * scale) ** 2)
        share = o.partials_px_per_rad @ covariance @ o.partials_px_per_rad.T
        total = o.covariance_px2 + share
        found.append(replace(o, total_covariance_px2=total, attitude_covariance_rad2=covariance))
    return found, turns


def with_turned_attitudes(observables, turns, displaced, rng):
    errors = {name: rng.normal(size=2) for name in turns[observables[0].image]}
    own = {image: rng.normal(size=3) * [1.0, 1.0, 30.0] * 4.96e-8 for image in turns}
    drawn = []
    for o in observables:
        turn = own[o.image] + sum(turns[o.image][name] @ e for name, e in errors.items())
        noise = np.linalg.cholesky(o.covariance_px2) @ rng.normal(size=2)
        drawn.append(displaced(o, noise + o.partials_px_per_rad @ turn))
    return drawn


@pytest.mark.slow
def test_filter_knows_stars_in_common_as_the_batch_does(approach, pictures, displaced):
    rng = np.random.default_rng(8)
    believed, turns = starred(approach(), pictures, rng)
    drawn = with_turned_attitudes(believed, turns, displaced, rng)
    asked = {
        "parameters": ["target_position"],
        "a_priori": {"target_position": 5000.0},
        "star_turns_rad": turns,
    }
    batch = estimate_with_common_errors(drawn, [NOISE] * len(drawn), **asked)
    _same(estimate_with_common_errors(drawn, [NOISE] * len(drawn), filter_options={}, **asked), batch)


@pytest.mark.slow
def test_attitudes_of_the_same_stars_err_alike(approach, pictures, displaced):
    """100 approaches: with the stars told, errors are those of the sigmas; each picture for itself promises too much."""
    rng = np.random.default_rng(9)
    clean = [replace(o, covariance_px2=NOISE, total_covariance_px2=NOISE) for o in pictures]
    believed, turns = starred(approach(), clean, rng)
    sizes, careless = [], []
    for _ in range(100):
        drawn = with_turned_attitudes(believed, turns, displaced, rng)
        for told, into in ((turns, sizes), ({}, careless)):
            found = estimate_with_common_errors(
                drawn,
                [NOISE] * len(drawn),
                ["target_position"],
                a_priori={"target_position": 5000.0},
                reject_sigmas=np.inf,
                star_turns_rad=told,
            )
            error = found.correction
            into.append(error @ np.linalg.solve(found.covariance, error) / 3.0)
    assert 0.85 < np.sqrt(np.mean(sizes)) < 1.15
    assert np.sqrt(np.mean(careless)) > 1.3


@pytest.mark.slow
def test_errors_over_sigmas_whatever_is_common_and_however_large(pictures, displaced):
    """100 approaches, shares and sizes as they are believed in; taking none as common and all as stated is too sure."""
    rng, sizes, careless = np.random.default_rng(4), [], []
    for _ in range(100):
        drawn = spoiled(pictures, displaced, rng, rng.uniform(), 2.0 ** rng.normal())
        found = solved(drawn)
        error = found.correction
        sizes.append(error @ np.linalg.solve(found.covariance, error) / 3.0)
        careless.append(error @ np.linalg.solve(found.independent.covariance, error) / 3.0)
    assert 0.85 < np.sqrt(np.mean(sizes)) < 1.15
    assert np.sqrt(np.mean(careless)) > 1.5

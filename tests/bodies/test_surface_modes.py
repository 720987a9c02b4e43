"""The albedo of disks not much wider than the PSF: modes over the surface, spread as light is, and centers that hold."""

import numpy as np
import pytest
from disk_exam import draw, error_over_sigma, is_false, run
from disk_truth import TrialSetup, make_trial
from scipy.signal import fftconvolve

from opnav_workbench.bodies.disk import problem
from opnav_workbench.bodies.disk.limb_field import BROAD_RAD, FieldPrior
from opnav_workbench.bodies.disk.limb_light import PLANES, limb_light
from opnav_workbench.bodies.disk.measurement import measure_disk
from opnav_workbench.bodies.disk.surface_modes import HIGHEST_DEGREE, surface_field
from opnav_workbench.bodies.silhouette import TURN, Silhouette

CENTER = np.array([500.3, 480.7])
SEED, TRIALS, LARGEST_PX = 9931, 16, 8.0


def places(n, rng):
    """Places even over the disk in sight: shares of its radius, directions, and points (n, 3) on the sphere."""
    share, angle = np.sqrt(rng.random(n)), TURN * rng.random(n)
    return (
        share,
        angle,
        np.stack([share * np.cos(angle), share * np.sin(angle), np.sqrt(1.0 - share**2)], axis=1),
    )


@pytest.mark.slow(keep=["4.0"])
@pytest.mark.parametrize("radius_px", [0.6, 2.0, 4.0])
def test_modes_have_the_covariance_of_the_field_on_the_body(radius_px):
    """As far as they reach: what smooth weights make of the modes is what they make of the field itself."""
    field, rng = surface_field(radius_px, 0.9, 24, 0.2), np.random.default_rng(3)
    share, angle, point = places(4000, rng)
    modes = field.parts.at(share, angle)
    np.testing.assert_allclose(modes[0], 1.0)  # what all pieces of limb are brighter by
    np.testing.assert_allclose(modes @ modes.T / 4000.0, np.eye(field.parts.count), atol=0.15)
    weights = np.stack(
        [np.ones(4000), point[:, 0], point[:, 1] ** 2, 1.0 - share**2]
    )  # light is such a weight
    seen = weights @ modes.T / 4000.0
    cosine = np.clip(point @ point.T, -1.0, 1.0)
    for albedo, length, share_of in ((0.3, 0.2, 0.0), (0.3, 0.6, 0.0), (0.003, 0.3, 1.0)):
        prior = FieldPrior(albedo, length, 0.01, 0.01, hemispheres=max(share_of, 1e-6))
        covariance = albedo**2 * np.exp(-np.arccos(cosine) / length)
        covariance += (0.2 * share_of) ** 2 * np.exp((cosine - 1.0) / BROAD_RAD**2)
        expected = weights @ covariance @ weights.T / 4000.0**2
        found = seen @ field.amplitudes(prior).covariance @ seen.T
        np.testing.assert_allclose(found, expected, atol=0.04 * np.abs(expected).max())


def test_wider_disks_show_more_modes():
    counts = [surface_field(radius, 1.0, 24, 0.2).parts.count for radius in (0.3, 1.0, 2.0, 4.0, 9.0)]
    assert counts == sorted(counts)
    assert counts[-1] == (HIGHEST_DEGREE + 1) * (HIGHEST_DEGREE + 2) // 2


@pytest.mark.parametrize(("diameter", "phase"), [(3.0, 20.0), (7.0, 80.0)])
def test_the_light_of_a_mode_is_spread_over_the_plane(body_stage, diameter, phase):
    """Rays in every pixel, times the mode where they meet the disk, spread by the PSF as a convolution has it."""
    model = body_stage.body(diameter, phase, CENTER)
    picture = body_stage.picture(body_stage.light(model), [model])
    outline = Silhouette(picture, "BODY").at(CENTER)
    modes = surface_field(0.5 * diameter, 0.9, 24, 0.2).parts
    light = limb_light(
        picture, "BODY", outline, 1.0, (0.5 * diameter, 6.0), modes, np.zeros(2), np.zeros(5), fine=True
    )
    n, half = 16, 12
    first = np.floor(CENTER).astype(int) - half
    x, y = (low - 0.5 + (np.arange(2 * half * n) + 0.5) / n for low in first)
    shine = body_stage._shine(model.target, x, y)
    away_x, away_y = np.meshgrid(x - CENTER[0], y - CENTER[1])
    angle = np.arctan2(away_y, away_x)
    share = np.minimum(np.hypot(away_x, away_y) / outline.radius(angle.ravel()).reshape(angle.shape), 1.0)
    each = modes.at(share.ravel(), angle.ravel()).reshape(modes.count, *shine.shape)
    pixel, line = np.meshgrid(*(low + np.arange(2 * half) for low in first))
    depth = np.hypot(pixel - CENTER[0], line - CENTER[1])
    around = np.arctan2(line - CENTER[1], pixel - CENTER[0])
    depth = depth - outline.radius(around.ravel()).reshape(depth.shape)
    near = depth < 4.0
    rows = light.at(around[near], depth[near])
    hats = light.hats_of(rows, on_slopes=False)

    def spread(plane):
        blurred = fftconvolve(plane, body_stage.psf.kernel(n), mode="same")
        return blurred.reshape(2 * half, n, 2 * half, n).sum(axis=(1, 3))[near]

    even = spread(shine)
    scale = float(even @ rows[PLANES.index("light")] / (even @ even))
    for mode, found in zip(each, hats, strict=True):
        expected = scale * spread(shine * mode)
        assert np.abs(found - expected).max() < 0.005 * np.abs(mode[shine > 0.0]).max() * scale * even.max()


@pytest.mark.slow
def test_patches_of_a_small_disk_are_believed(monkeypatch):
    """An albedo that pieces of limb have of their own no such picture shows: it was called even, and its center sure."""
    setups = [
        TrialSetup(seed, 2.5, 60.0, family="blobs_0.6", contrast=9.0, peak_dn=2000.0) for seed in range(1, 5)
    ]
    trials = [make_trial(setup) for setup in setups]

    def measured():
        fits = [measure_disk(trial.picture, trial.name, "disk", None, None).fit for trial in trials]
        off = [fit.center_px - trial.truth_px for fit, trial in zip(fits, trials, strict=True)]
        chi2 = [o @ np.linalg.solve(f.covariance_px2, o) for o, f in zip(off, fits, strict=True)]
        return np.array([fit.prior.albedo for fit in fits]), np.sqrt(np.mean(chi2) / 2.0)

    by_modes, sigmas = measured()
    monkeypatch.setattr(problem, "BLURRED_WIDTHS", 0.0)
    by_pieces, other = measured()
    assert np.all(by_modes > 0.2)
    assert np.all(by_modes > 4.0 * by_pieces)
    assert sigmas < 2.0
    assert other > 1.5 * sigmas


@pytest.mark.slow
def test_centers_of_small_disks_hold_on_patchy_surfaces(sample):
    """Bodies of 1 to 8 px, any phase, law, PSF and figure: their errors are those that their sigmas say."""
    setups = {i: draw(SEED, i, "tiny") for i in range(400)}
    near = [i for i, s in setups.items() if s.contrast > 1.0 and s.displacement_px < 5.0]
    chosen = [i for i in near if setups[i].diameter_px < LARGEST_PX][: sample.trials(TRIALS)]
    records = run(chosen, SEED, "disk", "tiny")
    assert sum(is_false(record) for record in records) <= 1
    assert 0.5 < error_over_sigma([r for r in records if r["status"] == "ok"]) < 1.5

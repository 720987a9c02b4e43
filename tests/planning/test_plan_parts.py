"""Parts of a plan against independent truth: closed forms, SPICE, brute force."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import spiceypy

from opnav_workbench.errors import MissionError
from opnav_workbench.planning import (
    expected_light,
    load_sequence,
    open_sequence,
    plan_document,
    plan_picture,
    plan_sequence,
    sequence_names,
)
from opnav_workbench.planning.attitude import plan_pointing
from opnav_workbench.planning.bodies import body_light, center_bound
from opnav_workbench.planning.stars import plan_stars
from opnav_workbench.simulation import expose_picture

BENNU = {
    "mission": "osiris_rex",
    "kernels": "osiris_rex/bennu_approach",
    "targets": ["BENNU"],
    "bodies": [{"name": "BENNU", "law": "lambert", "albedo": 0.045}],
    "pointing": {"track": "BENNU", "twist_deg": 30.0, "offset_px": [100.0, -50.0]},
    "pictures": [{"name": "a", "utc": "2018-09-24T12:00:00", "camera": "polycam", "exposure_s": 5.0}],
}


@pytest.fixture(scope="module")
def opened():
    with open_sequence(load_sequence(BENNU)) as opened:
        yield opened


@pytest.fixture(scope="module")
def picture(opened):
    return opened.sequence.expanded()[0][1]


@pytest.fixture(scope="module")
def prediction(opened, picture):
    return plan_picture(opened, picture, exposures=True).prediction


@pytest.fixture(scope="module")
def light(opened, picture):
    return expected_light(opened.inputs(picture))


def test_tracked_target_stands_at_its_offset(prediction):
    """The offset is one of tangents; distortion bends it by less than a tenth of a pixel so near the middle."""
    place = prediction.target("BENNU").prediction.pixel_line
    assert place == pytest.approx([612.0, 462.0], abs=0.1)
    assert prediction.twist_deg == pytest.approx(30.0, abs=1e-6)


def test_elongation_is_that_of_spice(opened, prediction):
    sun, _ = spiceypy.spkpos("SUN", prediction.et, "J2000", "CN", "-64")
    boresight = spiceypy.radrec(1.0, math.radians(prediction.ra_deg), math.radians(prediction.dec_deg))
    assert prediction.et == pytest.approx(spiceypy.str2et("2018-09-24T12:00:00"), abs=1e-3)
    assert prediction.elongation_deg == pytest.approx(math.degrees(spiceypy.vsep(sun, boresight)), abs=1e-6)


@pytest.mark.slow
def test_expected_picture_is_the_mean_of_simulated_ones(opened, picture, light):
    """Mean and variance of 25 exposures of a window that holds a star and Bennu."""
    inputs = opened.inputs(picture)
    x, y = np.rint(light.picture.rendering.bodies[0].center_px).astype(int)
    part = np.s_[y - 3 : y + 4, x - 3 : x + 4]
    stack = np.array([expose_picture(replace(inputs, seed=seed)).image_dn[part] for seed in range(25)])
    variance = light.variance_dn2(light.expected_e)[part]
    error = (stack.mean(axis=0) - light.picture.image_dn[part]) / np.sqrt(variance / 25)
    assert np.abs(error).max() < 4.5  # of 49
    assert np.mean(stack.var(axis=0, ddof=1) / variance) == pytest.approx(1.0, abs=4 * math.sqrt(2 / 24 / 49))


def test_snr_of_a_bright_star_is_the_root_of_its_electrons(prediction):
    star = prediction.stars
    electrons = star.flux_dn[0] * 4.5
    assert (
        0.95 * math.sqrt(electrons) < star.snr[0] < math.sqrt(electrons)
    )  # read noise and sky take the rest


def test_pointing_bound_is_that_of_a_plate_fit(prediction):
    """Shift and rotation fitted to the stars as a plain weighted line fit, without distortion."""
    stars, camera = prediction.stars, prediction.camera
    plan = plan_pointing(stars, camera, prediction.camera_from_j2000, guarded=False)
    weight = np.linalg.inv((stars.covariance_px2 + stars.catalog_covariance_px2)[stars.usable])
    x, y = (stars.pixel_line[stars.usable] - camera.center_pixel_line).T
    design = np.stack([[np.ones_like(x), 0 * x, -y], [0 * x, np.ones_like(x), x]]).transpose(2, 0, 1)
    covariance = np.linalg.inv(np.einsum("nia,nij,njb->ab", design, weight, design))
    assert plan.sigma_px == pytest.approx(np.sqrt(np.diag(covariance)[:2]), rel=0.02)
    assert plan.twist_sigma_deg == pytest.approx(math.degrees(math.sqrt(covariance[2, 2])), rel=0.02)
    assert np.hypot(*plan.sigma_arcsec) == pytest.approx(
        np.hypot(*plan.sigma_px) * camera.pixel_scale_rad * 206264.806, rel=1e-6
    )


def test_guarding_costs_something_and_little(prediction):
    bare = plan_pointing(prediction.stars, prediction.camera, prediction.camera_from_j2000, guarded=False)
    assert np.all(prediction.pointing.sigma_px >= bare.sigma_px)
    assert np.all(prediction.pointing.sigma_px < 2.0 * bare.sigma_px)


def mortensen(electrons, variance_e2, sigma_px):
    """Center sigma of a point, Mortensen et al. (2010), doi:10.1038/nmeth.1447."""
    sigma2 = sigma_px**2 + 1 / 12
    tau = 2 * math.pi * sigma2 * variance_e2 / electrons
    return math.sqrt(sigma2 / electrons * (1 + 4 * tau + math.sqrt(2 * tau / (1 + 4 * tau))))


def test_centers_of_points_are_known_as_well_as_theory_says(light, prediction):
    """Bennu below a pixel, and the brightest and the faintest star."""
    variance = float(light.variance_dn2(light.without_stars_e.min())) * 4.5**2
    target, stars = prediction.target("BENNU"), prediction.stars
    bound = mortensen(target.flux_dn * 4.5, variance, 0.7)
    assert target.center_sigma_px == pytest.approx([bound, bound], rel=0.05)
    for row in (0, -1):
        bound = mortensen(stars.flux_dn[row] * 4.5, variance, 0.7)
        assert np.sqrt(np.diag(stars.covariance_px2[row])) == pytest.approx([bound, bound], rel=0.05)


def test_center_bound_by_differences(light):
    """The derivatives of the light against a body moved by a tenth of a pixel."""
    seen = body_light(light, 0)
    covariance, snr = center_bound(light, seen)
    assert np.sqrt(np.diag(covariance)) == pytest.approx(np.sqrt(covariance[0, 0]), rel=0.05)
    assert seen.electrons.sum() == pytest.approx(light.picture.rendering.bodies[0].flux_e, rel=1e-3)
    moved = np.gradient(seen.electrons, axis=1)
    assert np.sum(moved * -seen.slopes[0]) > 0.8 * np.sum(moved**2)
    assert snr > 100.0


def test_best_exposure_is_below_saturation_and_the_smallest(prediction):
    best = prediction.best_exposure
    assert np.nanmin(best.sigma_px) == best.sigma_px[list(best.exposure_s).index(best.best_s)]
    peak = prediction.target("BENNU").peak_dn / 5.0
    assert peak * best.best_s < prediction.camera.saturation_dn
    assert np.isnan(best.sigma_px[best.exposure_s > 1.05 * prediction.camera.saturation_dn / peak]).all()


def test_stray_light_costs_stars(opened, picture):
    bright = load_sequence(BENNU | {"sun": {"stray_light_dn_s": [[0.0, 2000.0], [180.0, 2000.0]]}})
    with open_sequence(bright) as other:
        lit = plan_picture(other, picture, exposures=False).prediction
    dark = plan_stars(expected_light(opened.inputs(picture)), 5.0)
    assert lit.stray_light_dn == pytest.approx(10_000.0)
    assert np.all(lit.stars.snr[lit.stars.status == "usable"] < dark.snr.max())
    assert lit.limit_mag < 13.0


def test_sun_inside_the_keep_out_angle_is_bad(picture):
    with open_sequence(load_sequence(BENNU | {"sun": {"keep_out_deg": 170.0}})) as opened:
        verdict = plan_picture(opened, picture, exposures=False).verdict
    assert verdict.grade == "bad"
    assert "inside the keep-out angle of 170" in verdict.words


def test_a_moving_camera_has_worse_stars(picture, prediction):
    with open_sequence(load_sequence(BENNU | {"motion": {"rate_px_s": [1.0, 0.0]}})) as opened:
        trailed = plan_picture(opened, picture, exposures=False).prediction
    ratio = trailed.stars.covariance_px2[0] / prediction.stars.covariance_px2[0]
    # A trail of 5 px is 5 / sqrt(12) px wide: three times the PSF along, no wider across.
    assert ratio[0, 0] > 2.0 * ratio[1, 1]


def test_other_bodies_in_the_field_are_named():
    with open_sequence(load_sequence("new_horizons/pluto_approach")) as opened:
        picture = next(p for _, p in opened.sequence.expanded() if p.name == "opnav_1_0001")
        seen = plan_picture(opened, picture, others=("NIX", "HYDRA", "SUN"), exposures=False).prediction
        et = seen.et
        direction, _ = spiceypy.spkpos("NIX", et, "J2000", "CN+S", "-98")
    (nix, _) = seen.other_bodies
    place = seen.camera.project((seen.camera_from_j2000 @ direction)[None])[0]
    assert [nix.pixel, nix.line] == pytest.approx(place, abs=0.01)
    assert nix.drawn


def test_ready_sequences_are_whole_and_documents_are_json():
    assert {"new_horizons/pluto_approach", "osiris_rex/bennu_approach"} <= set(sequence_names())
    plan = plan_sequence(load_sequence(BENNU), exposures=False)
    text = json.dumps(plan_document(plan), allow_nan=False)
    assert json.loads(text)["pictures"][0]["verdict"] == "good"
    with pytest.raises(MissionError, match="no picture or search named b"):
        plan_sequence(load_sequence(BENNU), only=["b"])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"pictures": []}, "nothing to plan"),
        ({"sun": {"stray_light_dn_s": [[90, 1], [50, 2]]}}, "must increase"),
        ({"pointing": {"ra_deg": 3.0}}, "ra_deg and dec_deg together"),
        ({"pictures": BENNU["pictures"] * 2}, "a is given twice"),
        ({"bodies": [{"name": "Bennu"}, {"name": "BENNU"}]}, "bodies: BENNU is given twice"),
    ],
)
def test_wrong_sequences_are_refused(change, words):
    with pytest.raises(MissionError, match=words), open_sequence(load_sequence(BENNU | change)):
        pass

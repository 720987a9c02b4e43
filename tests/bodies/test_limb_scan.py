"""Limb scans: centers of spheres and ellipsoids, albedo maps, other sizes, scans by hand, and what cannot be measured."""

from dataclasses import replace

import numpy as np
import pytest

from opnav_workbench.bodies import BodyFlag, Circle, displaced_model
from opnav_workbench.bodies.limb_scan.centerfinder import find_limb_scan
from opnav_workbench.bodies.limb_scan.fan import ScanSampler
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.render import AlbedoMap, FigureUncertainty, Lambert, LommelSeeliger, LunarLambert
from opnav_workbench.simulation.surfaces import mottled_map

PLACE = (500.3, 480.7)
TRIAXIAL = (1.0, 0.85, 0.7)
PEAK_DN = 500.0  # with 3 DN of noise: 115 sigma
# Size, axes and law that nobody knows better than at a first approach move a center seen from one side by tenths of a pixel,
# and sigma says so; how well the scans themselves do shows where they are known, as they are of these simulated bodies.
KNOWN = FigureUncertainty(2e-4, 2e-4, 2e-4, law_sigma=0.02)


@pytest.fixture(scope="module")
def sphere(body_stage):
    model = body_stage.body(60.0, 40.0, PLACE)
    return model, body_stage.light(model)


def test_a_noiseless_sphere_is_found_to_a_thousandth(body_stage, sphere):
    """Its figure and law are stated as known, as they are; PSF and albedo are unknowns."""
    model, light = sphere
    known = replace(model, figure=KNOWN)
    picture = body_stage.picture(light, [known], data=PEAK_DN * light, offset_px=(2.4, -1.8))
    center = find_limb_scan(picture, "BODY")
    assert center.status == "ok"
    assert np.abs(center.pixel_line - PLACE).max() < 0.003
    assert abs(center.diameter_px - 60.0) < 0.05
    assert center.detail.roughness < 0.05  # no surface is taken for more even than 1 %
    assert np.hypot(*center.detail.iterations[-1]) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(("diameter", "phase"), [(5.0, 30.0), (8.0, 90.0), (20.0, 0.0), (40.0, 120.0)])
@pytest.mark.parametrize("axes", [(1.0, 1.0, 1.0), TRIAXIAL])
def test_errors_are_small_and_as_stated(body_stage, diameter, phase, axes):
    rng = np.random.default_rng(int(diameter) + len(set(axes)))
    errors, pulls = [], []
    for _ in range(3):
        place = np.array(PLACE) + rng.uniform(-0.5, 0.5, 2)
        model = body_stage.body(diameter, phase, place, axes, figure=KNOWN)
        light = body_stage.light(model)
        picture = body_stage.picture(light, [model], rng, peak_dn=PEAK_DN, offset_px=(0.8, -0.6))
        center = find_limb_scan(picture, "BODY")
        assert center.status == "ok", center.messages
        error = center.pixel_line - place
        errors.append(error)
        pulls.append(error @ np.linalg.solve(center.covariance_px2, error))
    assert np.sqrt(np.mean(np.square(errors))) < 0.03
    assert np.abs(errors).max() < 0.06
    assert np.sum(pulls) < 22.5  # chi-squared of six numbers: one in a thousand exceeds it


@pytest.mark.slow
def test_a_mottled_surface_does_not_move_the_center(body_stage):
    """An albedo of 0.2 rms, of which nothing is known but what this limb shows; figure and law are stated, as they are.

    What is left is as for a wrong law: the albedo's strength is an unknown, and a coordinate has a sigma of 0.06 px.
    """
    errors = []
    for seed in (1, 2):
        model = body_stage.body(100.0, 15.0, PLACE, law=LunarLambert(0.5), figure=KNOWN)
        mottled = replace(model, albedo=AlbedoMap(mottled_map(seed, rows=90)))
        light = body_stage.light(mottled)
        picture = body_stage.picture(light, [model], np.random.default_rng(seed), offset_px=(1.0, 2.0))
        center = find_limb_scan(picture, "BODY")
        assert center.status == "ok", center.messages
        assert 0.1 < center.detail.roughness < 0.4
        error = center.pixel_line - PLACE
        errors.append(error)
        assert error @ np.linalg.solve(center.covariance_px2, error) < 9.0
    assert np.abs(errors).max() < 0.07


@pytest.mark.slow(keep=["70.0-60.0-law3-taken3"])
@pytest.mark.parametrize(
    ("law", "taken"),
    [
        (LommelSeeliger(), Lambert()),
        (Lambert(), LommelSeeliger()),
        (LunarLambert(0.5), Lambert()),
        (Lambert(), LunarLambert(0.5)),
    ],
)
@pytest.mark.parametrize(("diameter", "phase"), [(70.0, 60.0), (100.0, 30.0), (180.0, 15.0)])
def test_a_wrong_scattering_law_costs_little_and_sigma_says_it(body_stage, law, taken, diameter, phase):
    true = body_stage.body(diameter, phase, PLACE, law=law, figure=replace(KNOWN, law_sigma=None))
    picture = body_stage.picture(
        body_stage.light(true), [replace(true, law=taken)], np.random.default_rng(4), offset_px=(1.0, -1.0)
    )
    center = find_limb_scan(picture, "BODY")
    error = center.pixel_line - PLACE
    assert np.abs(error).max() < 0.07
    assert error @ np.linalg.solve(center.covariance_px2, error) < 9.0


def test_a_body_of_nearly_even_axes_overflows_nowhere(body_stage):
    """At axes of 1 : 0.9 : 0.85 NumPy warned of overflows on the console."""
    model = body_stage.body(60.0, 40.0, PLACE, (1.0, 0.9, 0.85), figure=KNOWN)
    picture = body_stage.picture(
        body_stage.light(model), [model], np.random.default_rng(5), offset_px=(1.0, -1.0)
    )
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        center = find_limb_scan(picture, "BODY")
    assert center.status == "ok", center.messages
    assert np.abs(center.pixel_line - PLACE).max() < 0.06


@pytest.mark.slow(keep=["0.99"])
@pytest.mark.parametrize("ratio", [0.99, 1.02, 1.3])
def test_another_size_is_measured_and_does_not_move_the_center(body_stage, sphere, ratio):
    """Sizes are uncertain by 10 %: 2.6 sigma of that are no misfit."""
    model, light = sphere
    other = replace(model, target=replace(model.target, radii_km=model.target.radii_km * ratio))
    picture = body_stage.picture(light, [other], np.random.default_rng(2), offset_px=(1.0, 1.0))
    center = find_limb_scan(picture, "BODY")
    assert center.status == "ok", center.messages
    assert np.abs(center.pixel_line - PLACE).max() < 0.06
    assert abs(center.diameter_px - 60.0) < 0.15


@pytest.mark.slow
def test_scans_by_hand(body_stage, sphere):
    model, light = sphere
    picture = body_stage.picture(light, [model], np.random.default_rng(3))
    auto = find_limb_scan(picture, "BODY").detail
    numbers = auto.used[::6]
    center = find_limb_scan(picture, "BODY", scans=numbers)
    assert center.detail.used.tolist() == numbers.tolist()
    assert all(reason == "chosen by the analyst" for reason in center.detail.reason[numbers])
    sigma = np.sqrt(np.diag(center.covariance_px2))
    assert np.all(np.abs(center.pixel_line - PLACE) < 3.0 * sigma)
    assert sigma.max() < 0.1
    np.testing.assert_allclose(np.degrees(center.detail.angle_rad[45]), 90.0)
    one_side = find_limb_scan(picture, "BODY", scans=auto.used[len(auto.used) // 2 :][:3])
    assert one_side.covariance_px2.max() > 10.0 * center.covariance_px2.max()
    for wrong in ([180], [-1], []):
        with pytest.raises(CenterfindingError, match="0 to 179"):
            find_limb_scan(picture, "BODY", scans=wrong)


def test_every_scan_has_a_reason(body_stage, sphere):
    model, light = sphere
    scans = find_limb_scan(body_stage.picture(light, [model], np.random.default_rng(3)), "BODY").detail
    assert all(scans.reason)
    assert all(reason.startswith("lit limb; albedo even to") for reason in scans.reason[scans.used])
    dark = scans.reason[scans.status == "not_chosen"]
    assert {"crosses the terminator, not the lit limb"} <= set(dark)
    assert scans.data_dn.shape == scans.model_dn.shape == (180, len(scans.distance_px))
    assert scans.places_px.shape == (180, len(scans.distance_px), 2)
    assert scans.correlation.shape == (180, len(scans.lag_px))
    best = scans.lag_px[np.nanargmax(scans.correlation[scans.used], axis=1)]
    assert np.mean(np.abs(best) <= 0.5) > 0.9  # noise moves the peak of a faint scan by a step
    assert np.abs(best).max() <= 1.0


@pytest.mark.slow
def test_a_scan_that_is_off_is_rejected_with_its_reason(body_stage, sphere):
    model, light = replace(sphere[0], figure=KNOWN), sphere[1]
    clean = find_limb_scan(body_stage.picture(light, [model], np.random.default_rng(3)), "BODY").detail
    row = clean.used[len(clean.used) // 2]
    pixel, line = np.rint(clean.start_px + (clean.limb_px[row] + 1.5) * np.array(
        [np.cos(clean.angle_rad[row]), np.sin(clean.angle_rad[row])]
    )).astype(int)  # fmt: skip
    picture = body_stage.picture(light, [model], np.random.default_rng(3))
    spoiled = np.array(picture.signal_dn)
    spoiled[line - 1 : line + 2, pixel - 1 : pixel + 2] += 400.0  # a star beside the limb
    center = find_limb_scan(replace(picture, signal_dn=spoiled), "BODY")
    gone = np.flatnonzero(center.detail.status != "used")
    assert row in gone
    assert center.detail.reason[row].startswith(("off by", "its edge lies"))
    assert np.abs(center.pixel_line - PLACE).max() < 0.05


def test_a_body_cut_by_the_edge(body_stage):
    model = body_stage.body(80.0, 30.0, (6.2, 500.4))
    picture = body_stage.picture(body_stage.light(model), [model], np.random.default_rng(1))
    center = find_limb_scan(picture, "BODY")
    assert center.flags & BodyFlag.CUT_BY_EDGE
    error = center.pixel_line - [6.2, 500.4]
    assert error @ np.linalg.solve(center.covariance_px2, error) < 14.0
    assert "off the detector" in " ".join(center.detail.reason)


@pytest.mark.slow
def test_nothing_there_saturated_or_not_a_body(body_stage, sphere):
    model, light = sphere
    rng = np.random.default_rng(1)
    picture = body_stage.picture(light, [model], rng)
    empty = find_limb_scan(picture, "BODY", circle=Circle([150.0, 150.0], 30.0))
    assert (empty.status, empty.pixel_line) == ("not_detected", None)
    buried = find_limb_scan(replace(picture, saturated=light > 0.02), "BODY")
    assert (buried.status, buried.flags) == ("saturated", int(BodyFlag.OVEREXPOSED))
    for ratio in (0.7, 1.3):
        circled = find_limb_scan(picture, "BODY", circle=Circle(np.add(PLACE, 3.0), ratio * 30.0))
        # The circle says where to look; the size is the model's, with its own uncertainty.
        assert circled.status == "ok"
        assert np.abs(circled.pixel_line - PLACE).max() < 0.05
    with pytest.raises(CenterfindingError, match="no model of 'MOON'"):
        find_limb_scan(picture, "MOON")
    with pytest.raises(CenterfindingError, match="use 3 at least"):
        find_limb_scan(picture, "BODY", n_scans=2)


def test_an_occulted_limb_is_left_out(body_stage):
    far = body_stage.body(
        80.0, 20.0, PLACE, figure=FigureUncertainty(0.01, 0.002, 5e-4, 0.02, 0.02)
    )  # as drawn
    near = body_stage.body(30.0, 20.0, (PLACE[0] + 30.0, PLACE[1] + 26.0), name="MOON", range_share=0.5)
    light = body_stage.light(far, near)
    picture = body_stage.picture(light, [far, near], np.random.default_rng(1))
    center = find_limb_scan(picture, "BODY")
    assert center.flags & BodyFlag.OCCULTED
    assert np.abs(center.pixel_line - PLACE).max() < 0.05
    assert "another body hides or shades it here" in center.detail.reason


@pytest.mark.slow
def test_range_follows_from_the_size_of_the_image(body_stage, sphere):
    """The size is among the unknowns whether or not the range is asked for: the center does not depend on that."""
    model, light = sphere
    known = replace(model, figure=FigureUncertainty(size_sigma=1e-4, axes_sigma=1e-4))
    rng = np.random.default_rng(3)
    picture = body_stage.picture(light, [known], rng)
    plain, ranged = find_limb_scan(picture, "BODY"), find_limb_scan(picture, "BODY", solve_range=True)
    assert np.isnan(plain.range_km)
    np.testing.assert_array_equal(plain.pixel_line, ranged.pixel_line)
    assert abs(ranged.range_km - model.target.range_km) < 4.0 * ranged.range_sigma_km
    assert ranged.range_sigma_km < 2e-4 * ranged.range_km
    free = find_limb_scan(
        replace(picture, models=(replace(known, figure=FigureUncertainty()),)), "BODY", solve_range=True
    )
    assert free.range_sigma_km > 0.1 * free.range_km
    assert np.linalg.eigvalsh(free.covariance_px2)[1] > np.linalg.eigvalsh(plain.covariance_px2)[1]


@pytest.mark.slow
def test_bit_for_bit_the_same(body_stage, sphere):
    model, light = sphere
    picture = body_stage.picture(light, [model], np.random.default_rng(3))
    first, again = find_limb_scan(picture, "BODY"), find_limb_scan(picture, "BODY")
    assert first.pixel_line.tobytes() == again.pixel_line.tobytes()
    assert first.covariance_px2.tobytes() == again.covariance_px2.tobytes()


def test_samples_follow_a_plane_and_know_their_weights():
    line, pixel = np.mgrid[5:25, 10:40].astype(float)
    rng = np.random.default_rng(1)
    places = rng.uniform([13.0, 8.0], [36.0, 21.0], (4, 9, 2))
    sampler = ScanSampler(places, (10, 5, 30, 20))
    np.testing.assert_allclose(
        sampler.sample(2.0 * pixel - line), 2.0 * places[..., 0] - places[..., 1], atol=1e-12
    )
    weight, plane = rng.normal(size=(4, 9)), rng.normal(size=line.shape)
    np.testing.assert_allclose(
        sampler.pixel_weights(weight) @ plane.ravel(), (weight * sampler.sample(plane)).sum(axis=1)
    )
    usable = np.ones(line.shape, dtype=bool)
    assert not sampler.blocked(usable).any()
    assert sampler.blocked(~usable).all()
    assert ScanSampler(places + 100.0, (10, 5, 30, 20)).blocked(usable).all()


@pytest.mark.slow
def test_displaced_start_ends_in_the_same_place(body_stage, sphere):
    model, light = sphere
    picture = body_stage.picture(light, [model], np.random.default_rng(3))
    moved = replace(picture, models=(displaced_model(picture, "BODY", np.add(PLACE, (14.0, -9.0))),))
    ends = [find_limb_scan(p, "BODY").pixel_line for p in (picture, moved)]
    assert np.abs(ends[0] - ends[1]).max() < 0.01

"""The detector against photon transfer, conservation of charge and closed forms of smear."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.special import ndtr

from opnav_workbench.camera import Camera
from opnav_workbench.errors import CameraError, MissionError
from opnav_workbench.simulation.charge import ChargeTransfer, bloom, draw_cosmic_rays, poisson_counts
from opnav_workbench.simulation.detector import expose
from opnav_workbench.simulation.effects import CosmicRays, DetectorEffects
from opnav_workbench.simulation.randomness import STREAMS, picture_random

GAIN, READ, BIAS = 22.0, 1.1, 538.0


def make_camera(n_pixel=256, n_line=256, **changes):
    fields = {
        "name": "TEST",
        "frame": "TEST",
        "instrument_id": -999001,
        "n_pixel": n_pixel,
        "n_line": n_line,
        "focal_length_mm": 2618.0,
        "center_pixel_line": [0.5 * (n_pixel - 1), 0.5 * (n_line - 1)],
        "pixel_from_mm": [[76.9, 0.0], [0.0, 76.9]],
        "focal_from_camera": np.eye(3),
        "bits": 12,
        "gain_e_per_dn": GAIN,
        "read_noise_dn": READ,
    }
    return Camera(**(fields | changes))


CAMERA = make_camera()
SHAPE = (256, 256)


def effects(**changes):
    """An ideal detector with a few effects switched on."""
    return DetectorEffects.model_validate(DetectorEffects.none().model_dump() | changes)


def flat(level_e):
    return np.full(SHAPE, level_e)


def run(light, settings, *, camera=CAMERA, exposure_s=1.0, seed=7, **options):
    return expose(light, camera, settings, exposure_s=exposure_s, seed=seed, **options)


# -- noise -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("level", ["calibrated", "raw"])
def test_photon_transfer_gives_back_gain_and_read_noise(level):
    """Mean-variance curve of pairs of flat fields, as a calibration team measures it, with the default effects."""
    settings = DetectorEffects.model_validate({"bias": {"level_dn": BIAS}})
    rows = []
    for i, electrons in enumerate(np.geomspace(50.0, 60000.0, 12)):
        first, second = (run(flat(electrons), settings, seed=2 * i + k, level=level).image_dn for k in (0, 1))
        offset = BIAS if level == "raw" else 0.0
        rows.append((0.5 * (first + second).mean() - offset, 0.5 * (first - second).var()))
    mean, variance = np.array(rows).T
    # variance = mean / gain + read^2; each variance of 65536 pixels is good to 0.55 %.
    weight = 1.0 / variance
    design = np.stack([mean, np.ones(12)], axis=1) * weight[:, None]
    slope, _ = np.linalg.lstsq(design, variance * weight, rcond=None)[0]
    assert 1.0 / slope == pytest.approx(GAIN, rel=0.01)
    darks = np.stack([run(flat(0.0), settings, seed=100 + k, level=level).image_dn for k in range(6)])
    assert darks.std(axis=0, ddof=1).mean() / 0.9515 == pytest.approx(READ, rel=0.01)  # c4(6) = 0.9515
    assert np.sqrt(darks.var(axis=0, ddof=1).mean()) == pytest.approx(READ, rel=0.01)


def test_read_noise_below_the_converters_own_is_the_converters():
    settings = effects(read_noise={"sigma_dn": 0.1}, adc=True)
    dark = run(flat(0.0), settings).image_dn
    assert not dark.any()  # nothing reaches half a step


def test_gain_setting_outranks_the_camera():
    assert run(flat(400.0), effects(gain_e_per_dn=4.0)).image_dn == pytest.approx(flat(100.0))


def test_counts_follow_poissons_law_and_its_quantiles():
    rng = np.random.default_rng(3)
    for mean in (0.02, 0.7, 4.0, 9.99, 10.0, 31.0, 400.0):
        counts = poisson_counts(np.full(100_000, mean), rng)
        low, high = (int(v) for v in stats.poisson.ppf([1e-3, 1.0 - 1e-3], mean))
        edges = np.concatenate([[-np.inf], np.arange(low, high) + 0.5, [np.inf]])
        expected = 100_000 * np.diff(stats.poisson.cdf(edges, mean))
        seen = np.histogram(counts, np.where(np.isinf(edges), np.sign(edges) * 1e9, edges))[0]
        good = expected > 5.0
        if good.sum() > 1:
            chi2 = ((seen - expected)[good] ** 2 / expected[good]).sum()
            assert stats.chi2.sf(chi2, good.sum()) > 1e-4, mean
        assert counts.mean() == pytest.approx(mean, abs=5.0 * np.sqrt(mean / 1e5))
    deviates = np.random.default_rng(9).standard_normal(20_000)
    for mean in (3.0, 12.0, 90.0):
        exact = stats.poisson.ppf(ndtr(deviates), mean)
        counts = poisson_counts(np.full(20_000, mean), np.random.default_rng(9))
        assert (counts != exact).mean() < 1e-3
        assert np.abs(counts - exact).max() <= 1.0


def test_one_more_star_changes_the_noise_of_its_own_pixels_only():
    light = flat(40.0)
    brighter = light.copy()
    brighter[10, 20] = 5000.0
    brighter[30, :5] = 0.3
    a, b = (run(x, DetectorEffects(frame_transfer=None)).image_dn for x in (light, brighter))
    changed = light != brighter
    assert np.array_equal(a[~changed], b[~changed])
    assert a[10, 20] != b[10, 20]


# -- independence ------------------------------------------------------------------------------------------------------

ALL = {
    "dark_current": {"rate_e_s": 30.0, "nonuniformity": 0.2},
    "bias": {"level_dn": BIAS, "pattern_dn": 2.0},
    "full_well": {"electrons": 80000.0},
    "frame_transfer": {"transfer_s": 0.0125},
    "flat_field": {"vignetting": 0.1, "prnu": 0.02, "error": 0.005},
    "bad_pixels": {"hot_fraction": 1e-3, "dead_fraction": 1e-3},
    "cosmic_rays": {"rate_per_cm2_s": 400.0},
    "sky": {"level_dn": 2.0, "rate_e_s": 10.0},
    "stray_light": {"center_e_s": 50.0, "along_pixel_e_s": 40.0},
    "lost_data": {"lines": 3, "blocks": 2, "block_px": 16},
}


def test_bit_identical_repeats_and_other_seeds():
    settings = DetectorEffects.model_validate(ALL)
    a, b = (run(flat(100.0), settings) for _ in range(2))
    other = run(flat(100.0), settings, seed=8)
    for name in ("image_dn", "collected_electrons", "lost", "defective"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name
    assert np.array_equal(a.cosmic_rays.electrons, b.cosmic_rays.electrons)
    assert not np.array_equal(a.image_dn, other.image_dn)
    assert np.array_equal(a.defective, other.defective)  # the same camera
    assert a.defective.any()
    assert not np.array_equal(a.lost, other.lost)


def test_fixed_patterns_belong_to_the_camera():
    settings = DetectorEffects.model_validate(ALL)
    twin = run(flat(100.0), settings, camera=replace(CAMERA, name="TWIN"))
    assert not np.array_equal(twin.defective, run(flat(100.0), settings).defective)


def test_switching_one_effect_leaves_the_numbers_of_the_others():
    """The read noise of a frame is seen in its difference from the charge; lost data, hits and defects directly."""
    full = run(flat(100.0), DetectorEffects.model_validate(ALL | {"adc": False}), level="raw")
    kept = ~full.lost & ~full.saturated

    def amplifier(exposed):
        return exposed.image_dn - exposed.collected_electrons / GAIN  # and the bias

    for name in ALL:
        part = run(
            flat(100.0), DetectorEffects.model_validate(ALL | {"adc": False, name: False}), level="raw"
        )
        both = kept & ~part.lost
        if name != "bias":
            assert np.abs(amplifier(full) - amplifier(part))[both].max() < 1e-9, name
        if name != "lost_data":
            assert np.array_equal(full.lost, part.lost), name
        if name not in ("cosmic_rays", "frame_transfer"):  # charge also lies on the detector while it moves
            assert np.array_equal(full.cosmic_rays.electrons, part.cosmic_rays.electrons), name
        if name != "bad_pixels":
            assert np.array_equal(full.defective, part.defective), name


def test_dark_current_and_photons_have_noise_of_their_own():
    dark = effects(shot_noise=True, dark_current={"rate_e_s": 50.0})
    thermal = run(flat(0.0), dark).collected_electrons
    photons = run(flat(80.0), effects(shot_noise=True)).collected_electrons
    assert np.array_equal(run(flat(80.0), dark).collected_electrons, thermal + photons)
    assert np.corrcoef(thermal.ravel(), photons.ravel())[0, 1] == pytest.approx(0.0, abs=0.02)


def test_every_stream_has_a_number_of_its_own():
    assert len(set(STREAMS.values())) == len(STREAMS)
    with pytest.raises(MissionError, match="-1 is negative"):
        picture_random(-1, "shot_noise")


# -- one effect after the other --------------------------------------------------------------------------------------


def test_the_ideal_detector_divides_by_the_gain():
    light = np.random.default_rng(0).uniform(0.0, 1000.0, SHAPE)
    exposed = run(light, DetectorEffects.none())
    assert exposed.image_dn == pytest.approx(light / GAIN)
    assert np.array_equal(exposed.noiseless_electrons, light)
    assert not (exposed.saturated | exposed.lost | exposed.defective).any()


@pytest.mark.parametrize("name", sorted(ALL))
def test_each_effect_shows_when_switched_on(name):
    light = flat(100.0)
    light[100, 100] = 200_000.0
    settings = effects(**{name: ALL[name]})
    exposed = run(light, settings, level="raw")
    assert not np.array_equal(exposed.image_dn, run(light, DetectorEffects.none(), level="raw").image_dn)
    assert np.array_equal(exposed.noiseless_electrons, light)


def test_calibration_removes_what_is_known_and_leaves_the_noise():
    settings = effects(
        bias={"level_dn": BIAS, "pattern_dn": 3.0},
        dark_current={"rate_e_s": 40.0},
        flat_field={"vignetting": 0.2, "prnu": 0.03},
        frame_transfer={"transfer_s": 0.05, "scrub_s": 0.02},
    )
    light = np.random.default_rng(1).uniform(50.0, 2000.0, SHAPE)
    assert run(light, settings).image_dn == pytest.approx(light / GAIN, rel=1e-9)
    raw = run(light, settings, level="raw").image_dn
    assert raw.min() > BIAS - 15.0
    left = run(
        light,
        settings.model_copy(update={"flat_field": settings.flat_field.model_copy(update={"error": 0.01})}),
    )
    assert np.std(left.image_dn / (light / GAIN)) == pytest.approx(0.01, rel=0.03)


def test_sky_and_stray_light():
    settings = effects(
        sky={"rate_e_s": 3.0, "level_dn": 2.0}, stray_light={"center_e_s": 10.0, "along_line_e_s": 8.0}
    )
    exposed = run(flat(0.0), settings, exposure_s=5.0)
    assert exposed.expected_electrons[:, 0] == pytest.approx(
        15.0 + 2.0 * GAIN + 5.0 * np.linspace(6.0, 14.0, 256)
    )
    dim = effects(stray_light={"center_e_s": 1.0, "along_pixel_e_s": 8.0})
    assert run(flat(0.0), dim).expected_electrons.min() == 0.0


def test_hot_and_dead_pixels():
    settings = effects(bad_pixels={"hot_fraction": 0.02, "dead_fraction": 0.01, "hot_rate_e_s": 500.0})
    short, long = (run(flat(1000.0), settings, exposure_s=t).collected_electrons for t in (1.0, 3.0))
    dead, hot = short < 1000.0, short > 1000.0
    assert dead.mean() == pytest.approx(0.01, abs=0.002)
    assert hot.mean() == pytest.approx(0.02, abs=0.003)
    leak = short[hot & ~dead] - 1000.0
    assert leak.mean() == pytest.approx(500.0, rel=0.1)
    assert (long[hot & ~dead] - 1000.0) == pytest.approx(3.0 * leak)
    assert np.array_equal(run(flat(1.0), settings).defective, hot | (short < 1000.0))


def test_lost_lines_and_blocks_are_filled():
    settings = effects(
        bias={"level_dn": BIAS}, lost_data={"lines": 4, "blocks": 3, "block_px": 10, "fill_dn": 0.0}
    )
    exposed = run(flat(2200.0), settings, level="raw")
    assert (exposed.image_dn[exposed.lost] == 0.0).all()
    assert (exposed.image_dn[~exposed.lost] == BIAS + 100.0).all()
    assert (exposed.lost.all(axis=1)).sum() == 4
    assert 4 * 256 + 100 <= exposed.lost.sum() <= 4 * 256 + 300
    calibrated = run(flat(2200.0), settings)
    assert (calibrated.image_dn[calibrated.lost] == -BIAS).all()  # as flight pictures with windows show


def test_converter_ends_at_its_highest_number():
    exposed = run(flat(100_000.0), effects(adc=True, bias={"level_dn": BIAS}), level="raw")
    assert (exposed.image_dn == 4095.0).all()
    assert exposed.saturated.all()
    unknown_bias = run(flat(100_000.0), effects(adc=True), camera=replace(CAMERA, saturation_dn=3500.0))
    assert (unknown_bias.image_dn <= 4095.0).all()


def test_dark_columns_hold_bias_and_read_noise_only():
    settings = DetectorEffects.model_validate({"bias": {"level_dn": BIAS}})
    columns = run(flat(5000.0), settings, level="raw", dark_columns=4).dark_columns_dn
    assert columns.shape == (256, 4)
    assert np.median(columns) == BIAS
    assert columns.std() == pytest.approx(READ, rel=0.1)


# -- blooming ----------------------------------------------------------------------------------------------------------


def test_blooming_conserves_charge_and_limits_it():
    light = np.zeros(SHAPE)
    light[120, 60], light[90, 61], light[100, 61] = 1e6, 4e5, 7e5
    light += 100.0
    held = bloom(light, 80_000.0)
    assert held.max() <= 80_000.0
    assert held.sum() == pytest.approx(light.sum(), abs=1e-3)
    assert held.sum(axis=0) == pytest.approx(light.sum(axis=0), abs=1e-4)
    assert np.array_equal(held[:, 62:], light[:, 62:])
    full = np.flatnonzero(held[:, 60] >= 80_000.0)
    assert np.array_equal(full, np.arange(full[0], full[-1] + 1))
    assert full.mean() == pytest.approx(120.0, abs=0.51)  # as far up as down
    # 920,100 too many, half of them either way into rooms of 79,900: five full pixels and a part of the sixth.
    assert len(full) == 11
    assert bloom(light, 80_000.0, spill=False).sum() < light.sum() - 1e6


def test_blooming_against_pixel_by_pixel_pouring():
    rng = np.random.default_rng(5)
    light = np.where(
        rng.random((60, 40)) < 0.05, rng.integers(0, 900, (60, 40)), rng.integers(0, 90, (60, 40))
    )
    light = light.astype(float)

    def poured(column, excess):
        held, carried = column.copy(), 0.0
        for i in range(len(held)):
            taken = min(carried, 100.0 - held[i])
            held[i], carried = held[i] + taken, carried - taken + excess[i]
        return held

    held = bloom(light, 100.0)
    for j in range(40):
        excess = np.maximum(light[:, j] - 100.0, 0.0)
        down = np.floor(0.5 * excess)
        column = poured(np.minimum(light[:, j], 100.0), down)
        column = poured(column[::-1], (excess - down)[::-1])[::-1]
        assert held[:, j] == pytest.approx(column)


def test_full_pixels_are_saturated():
    light = flat(0.0)
    light[50, 50] = 300_000.0
    exposed = run(light, effects(full_well={"electrons": 80_000.0}))
    assert exposed.saturated.sum() == 3
    assert exposed.saturated[49:52, 50].all()
    assert exposed.collected_electrons.sum() == pytest.approx(300_000.0)


# -- frame transfer ----------------------------------------------------------------------------------------------------


def test_smear_has_the_share_of_the_exposure_that_the_transfer_takes():
    light = np.zeros(SHAPE)
    light[80, 40] = 50_000.0
    exposure_s, transfer_s = 0.1, 0.0125
    settings = effects(frame_transfer={"transfer_s": transfer_s})
    smear = run(light, settings, exposure_s=exposure_s).expected_electrons - light
    ratio = transfer_s / exposure_s
    # All lines but its own, each for one of 256 steps, before or after the exposure.
    assert smear.sum() == pytest.approx(50_000.0 * ratio * 255 / 256)
    assert np.ptp(np.delete(smear[:, 40], 80)) < 1e-9
    assert not np.delete(smear, 40, axis=1).any()


@pytest.mark.parametrize("toward", ["first_line", "last_line"])
def test_direction_of_the_smear(toward):
    """Cleared at once: only charge that has to pass the star on its way out gathers its light."""
    light = np.zeros(SHAPE)
    light[80, 40] = 50_000.0
    settings = effects(frame_transfer={"transfer_s": 0.01, "scrub_s": 0.0, "toward": toward})
    smear = run(light, settings).expected_electrons - light
    behind = slice(81, None) if toward == "first_line" else slice(None, 80)
    assert (smear[behind, 40] > 0.0).all()
    assert smear[behind, 40].sum() == pytest.approx(smear.sum())


def test_smear_against_moving_the_charge_line_by_line():
    """Brute force: the scene is steady while the charge is clocked through it, toward line 0."""
    scene, lines = np.random.default_rng(2).uniform(0.0, 10.0, (12, 5)), 12  # electrons per second
    exposure_s, transfer_s, scrub_s = 2.0, 0.6, 0.3
    charge = np.zeros_like(scene)
    for _ in range(3 * lines):  # clearing goes on until the exposure begins
        charge = np.vstack([(charge + scene * scrub_s / lines)[1:], np.zeros((1, 5))])
    charge = charge + scene * exposure_s
    read = []
    for _ in range(lines):
        read.append(charge[0])
        charge = np.vstack([charge[1:], np.zeros((1, 5))]) + scene * transfer_s / lines
    exposed = exposure_s * scene
    smear = ChargeTransfer.of(transfer_s, scrub_s, exposure_s).smear(exposed)
    assert exposed + smear == pytest.approx(np.array(read))


@pytest.mark.parametrize(("after", "before"), [(0.01, 0.01), (0.3, 0.1), (0.0, 0.2), (4.0, 2.5)])
@pytest.mark.parametrize("first", [True, False])
def test_smear_is_removed_exactly(after, before, first):
    light = np.random.default_rng(4).uniform(0.0, 5000.0, (128, 9))
    transfer = ChargeTransfer(after, before, first)
    assert transfer.remove(light + transfer.smear(light)) == pytest.approx(light, rel=1e-9)


# -- cosmic rays -------------------------------------------------------------------------------------------------------


def test_cosmic_rays_number_length_and_charge():
    settings = CosmicRays(rate_per_cm2_s=5.0, spread=0.3, depth_um=13.0)
    camera, pixel_cm = make_camera(1024, 1024), 1.3e-3
    hits = [draw_cosmic_rays(settings, camera, 100.0, picture_random(k, "cosmic_rays")) for k in range(4)]
    counts = [len(h) for h in hits]
    mean = 5.0 * (1024 / 76.9 / 10.0) ** 2 * 100.0
    assert np.mean(counts) == pytest.approx(mean, rel=4.0 / np.sqrt(4 * mean))
    length = np.concatenate([h.length_px for h in hits])
    depth_px = 13.0e-4 / pixel_cm
    # sin^2(theta) uniform: half of all directions are beyond 45 deg, where the track is as long as the layer is deep.
    assert np.median(length) == pytest.approx(depth_px, rel=0.08)
    electrons = np.concatenate([h.electrons for h in hits])
    path_um = 13.0 * np.hypot(1.0, length / depth_px)
    loss = np.log(electrons / path_um)
    assert loss.mean() == pytest.approx(np.log(80.0), abs=0.03)
    assert loss.std() == pytest.approx(0.3, rel=0.06)


def test_cosmic_rays_lay_their_charge_along_the_track():
    exposed = run(flat(0.0), effects(cosmic_rays={"rate_per_px_s": 3e-3}))
    hits, left = exposed.cosmic_rays, exposed.collected_electrons
    assert 120 < len(hits) < 290
    inside = (
        (hits.end_px > -0.4) & (hits.end_px < 255.4) & (hits.start_px > -0.4) & (hits.start_px < 255.4)
    ).all(1)
    assert left.sum() == pytest.approx(hits.electrons.sum(), rel=0.02)
    assert inside.mean() > 0.9
    long = int(np.argmax(np.where(inside, hits.length_px, 0.0)))
    ends = np.rint([hits.start_px[long], hits.end_px[long]]).astype(int)
    assert hits.length_px[long] > 5.0
    assert (left[ends[:, 1], ends[:, 0]] > 0.0).all()
    longer = run(flat(0.0), effects(cosmic_rays={"rate_per_px_s": 3e-3}), exposure_s=10.0)
    assert len(longer.cosmic_rays) == pytest.approx(10 * len(hits), rel=0.35)


# -- refusals ----------------------------------------------------------------------------------------------------------


def test_what_is_needed_and_not_known_is_named():
    with pytest.raises(CameraError, match="read_noise_dn is not known"):
        run(flat(0.0), DetectorEffects(), camera=replace(CAMERA, read_noise_dn=None))
    with pytest.raises(CameraError, match="exposure of 0"):
        run(flat(0.0), DetectorEffects(), exposure_s=0.0)
    with pytest.raises(CameraError, match=r"256 lines and 256 pixels"):
        run(np.zeros((256, 255)), DetectorEffects())
    with pytest.raises(CameraError, match="1 pixels of light"):
        run(np.where(np.arange(256 * 256).reshape(SHAPE) == 5, np.nan, 1.0), DetectorEffects())
    with pytest.raises(CameraError, match="frame transfer"):
        run(flat(0.0), effects(frame_transfer={"transfer_s": 300.0}))

"""Which light in the picture is which body: displaced ones, overexposed ones whose charge has spilled, and none at all."""

from dataclasses import replace

import numpy as np
import pytest

from opnav_workbench.bodies import BodyFlag, displaced_model, find_disk, find_jointly, standing_at

PLANET, MOON = np.array([420.0, 560.0]), np.array([560.0, 430.0])


def planet_and_moon(stage, widths_px, phase_deg):
    named = zip(widths_px, (PLANET, MOON), ("PLANET", "MOON"), strict=True)
    return [stage.body(width, phase_deg, place, name=name) for width, place, name in named]


def spilled(light, full_well):
    """Charge that pixels cannot hold runs along their columns, as much up as down, until there is room."""
    kept = light.copy()
    for column in np.flatnonzero((light > full_well).any(axis=0)):
        charge = kept[:, column]
        over = np.maximum(charge - full_well, 0.0)
        charge -= over
        for lines in (range(len(charge)), reversed(range(len(charge)))):
            running = 0.0
            for line in lines:
                running += 0.5 * over[line]
                taken = min(running, full_well - charge[line])
                charge[line] += taken
                running -= taken
    return kept


def star(stage, place):
    """Light of a star, its brightest pixel about 1."""
    x, y = (np.arange(1024) - at for at in place)
    return np.exp(-0.5 * (x**2 + y[:, None] ** 2) / stage.psf.sigma_px[0] ** 2)


def chi2(center, truth):
    error = center.pixel_line - truth
    return error @ np.linalg.solve(center.covariance_px2, error)


@pytest.mark.slow
@pytest.mark.parametrize("apart_px", [(70.0, -40.0), (20.0, 60.0)])
def test_a_moon_displaced_otherwise_than_its_planet_is_found(body_stage, apart_px):
    """A satellite's ephemeris is off, too: by more than it is wide, beside what the planet is off by."""
    planet, moon = planet_and_moon(body_stage, (50.0, 16.0), 35.0)
    light = body_stage.light(planet, moon)
    picture = body_stage.picture(light, (planet, moon), np.random.default_rng(5), offset_px=(31.0, -22.0))
    off = displaced_model(picture, "MOON", picture.center_px("MOON") + apart_px)
    picture = replace(picture, models=(picture.model("PLANET"), off))
    for center, truth in zip(find_jointly(picture, ("PLANET", "MOON")).centers, (PLANET, MOON), strict=True):
        assert center.status == "ok", center.messages
        assert chi2(center, truth) < 14.0
    # One after the other, as a session does.
    first = find_disk(picture, "PLANET")
    seen = standing_at(picture, {"PLANET": first.pixel_line}, ("PLANET",))
    second = find_disk(seen, "MOON")
    assert second.status == "ok", second.messages
    assert chi2(second, MOON) < 14.0


@pytest.mark.slow
@pytest.mark.parametrize(("width_px", "offset_px"), [(30.0, (-6.0, 4.0)), (20.0, (60.0, -45.0))])
def test_spilled_charge_does_not_make_a_moon_its_planet(body_stage, width_px, offset_px):
    """A planet so overexposed that its column is longer than it is wide looks less like a disk than its moon does."""
    planet, moon = planet_and_moon(body_stage, (width_px, 0.5 * width_px), 15.0)
    data = 60_000.0 * body_stage.light(planet, moon)
    data = np.random.default_rng(3).poisson(np.minimum(data, 4e6) * 20.0) / 20.0
    data = spilled(data, 4000.0) + np.random.default_rng(4).normal(0.0, 3.0, data.shape)
    picture = body_stage.picture(
        None, (planet, moon), offset_px=offset_px, data=data, saturated=data > 3950.0
    )
    first = find_disk(picture, "PLANET")
    assert chi2(first, PLANET) < 14.0
    moved = {
        name: picture.center_px(name) + first.pixel_line - picture.center_px("PLANET")
        for name in ("PLANET", "MOON")
    }
    second = find_disk(standing_at(picture, moved, ("PLANET",)), "MOON")
    assert chi2(second, MOON) < 14.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_stars_and_hits_are_no_body(body_stage, seed):
    """A body that is not in the picture is not made of what else is."""
    rng = np.random.default_rng(seed)
    model = body_stage.body(14.0, 30.0, (500.0, 500.0))
    light = np.zeros((1024, 1024))
    for _ in range(60):
        at = rng.uniform(20.0, 1000.0, 2)
        light += rng.exponential(0.5) * star(body_stage, at)
    for _ in range(120):  # tracks of cosmic rays
        start, angle = rng.uniform(20.0, 1000.0, 2), rng.uniform(0.0, np.pi)
        along = start + np.arange(0.0, rng.exponential(6.0), 0.5)[:, None] * [np.cos(angle), np.sin(angle)]
        for pixel, line in np.clip(np.rint(along).astype(int), 0, 1023):
            light[line, pixel] += rng.exponential(0.4)
    picture = body_stage.picture(light, [model], rng, offset_px=(3.0, 2.0))
    assert find_disk(picture, "BODY").status == "not_detected"


@pytest.mark.slow
@pytest.mark.parametrize("place", [(322.8, 641.3), (506.2, 497.7)], ids=["far", "near"])
@pytest.mark.parametrize(("width_px", "phase_deg"), [(6.0, 60.0), (12.0, 100.0), (25.0, 100.0)])
def test_a_bright_star_is_no_crescent_that_cannot_be_seen(body_stage, width_px, phase_deg, place):
    """What there is of a thin crescent looks like a star to a search that asks for its silhouette."""
    model = body_stage.body(width_px, phase_deg, (500.0, 500.0))
    picture = body_stage.picture(
        star(body_stage, place), [model], np.random.default_rng(7), offset_px=(3.0, 2.0)
    )
    assert find_disk(picture, "BODY").status == "not_detected"


@pytest.mark.slow(keep=["known"])
@pytest.mark.parametrize(
    ("offset_px", "known"),
    [
        pytest.param((4.0, -3.0), True, id="known"),
        pytest.param((45.0, 30.0), True, id="known and displaced"),
        pytest.param((4.0, -3.0), False, id="unknown"),
    ],
)
def test_a_body_beside_a_brighter_star_is_still_found(body_stage, offset_px, known):
    """On its limb: of a star that nobody knows what is left beside its brightest pixels draws the center along."""
    model, place = body_stage.body(24.0, 40.0, MOON), MOON + np.array([11.0, 6.0])
    light = 0.02 * body_stage.light(model) + star(body_stage, place)
    picture = body_stage.picture(light, [model], np.random.default_rng(8), offset_px=offset_px)
    center = find_disk(replace(picture, stars_px=place[None] if known else None), "BODY")
    assert center.status in ("ok", "uncertain"), center.messages
    error = np.hypot(*(center.pixel_line - MOON))
    assert chi2(center, MOON) < (14.0 if known else 31.0)  # 1.7 or 25 to 30, by the last digits of the light
    assert error < (1.0 if known else 5.0)


@pytest.mark.slow
def test_a_moon_is_not_its_planet_whose_pixels_are_lost(body_stage):
    planet, moon = planet_and_moon(body_stage, (14.0, 7.0), 60.0)
    lost = np.zeros((1024, 1024), dtype=bool)
    lost[PLANET.astype(int)[1] - 20 :, PLANET.astype(int)[0] - 20 :][:40, :40] = True
    light = body_stage.light(planet, moon)
    picture = body_stage.picture(
        light, (planet, moon), np.random.default_rng(5), offset_px=(-3.0, 6.0), bad=lost
    )
    first, second = find_jointly(picture, ("PLANET", "MOON")).centers
    assert first.pixel_line is None
    assert second.status == "ok", second.messages
    assert chi2(second, MOON) < 14.0


@pytest.mark.slow(keep=["0"])
@pytest.mark.parametrize("seed", range(3))
def test_a_disk_fainter_than_the_noise_of_a_pixel_is_found(body_stage, seed):
    """None of its pixels stands out of the sky; all of them together do, by some thirty sigmas."""
    truth = np.array([430.3, 610.7])
    model = body_stage.body(28.0, 20.0, truth)
    light = body_stage.light(model)
    picture = body_stage.picture(
        light, [model], np.random.default_rng(seed), peak_dn=4.0, offset_px=(25.0, -14.0)
    )
    center = find_disk(picture, "BODY")
    assert center.status in ("ok", "uncertain"), center.messages
    assert chi2(center, truth) < 18.0  # of 16 seeds the mean is 2.2, and the first of these by far the most
    assert np.sqrt(np.trace(center.covariance_px2)) < 1.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("width_px", "marked"), [(16.0, True), (80.0, False)], ids=["saturated", "saturated and bad"]
)
def test_columns_that_charge_fills_are_no_body(body_stage, width_px, marked):
    """Exposed so long that charge fills most of its columns from edge to edge, a body lies in them, not where they end."""
    model = body_stage.body(width_px, 15.0, PLANET)
    data = spilled(9e6 / width_px * body_stage.light(model), 4000.0)
    data += np.random.default_rng(4).normal(0.0, 3.0, data.shape)
    saturated = data > 3950.0
    filled = saturated.all(axis=0)
    assert np.count_nonzero(filled) > 0.5 * width_px
    picture = body_stage.picture(
        None, [model], offset_px=(3.0, -2.0), data=data, saturated=saturated, bad=saturated & ~marked & filled
    )
    center = find_disk(picture, "BODY")
    assert center.status in ("ok", "uncertain", "saturated")
    assert "take a shorter exposure" in "; ".join(center.messages)
    assert center.flags & BodyFlag.OVEREXPOSED
    if center.pixel_line is not None:
        assert np.hypot(*(center.pixel_line - PLANET)) < 0.75 * width_px
        assert chi2(center, PLANET) < 14.0


def test_a_body_beside_a_column_that_a_star_fills_keeps_its_center(body_stage):
    model = body_stage.body(60.0, 40.0, PLANET)
    data = 1500.0 * body_stage.light(model)
    data[:, 395:398] = 4000.0
    data += np.random.default_rng(4).normal(0.0, 3.0, data.shape)
    picture = body_stage.picture(None, [model], offset_px=(3.0, -2.0), data=data, saturated=data > 3950.0)
    center = find_disk(picture, "BODY")
    assert center.status == "ok", center.messages
    assert chi2(center, PLANET) < 14.0

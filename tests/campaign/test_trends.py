"""Outliers, completeness and trends against simulated truth."""

import numpy as np
import pytest

from opnav_workbench.campaign import Campaign, completeness, screen, trends
from opnav_workbench.errors import SessionError
from opnav_workbench.headless.night_trends import write_night_trends


@pytest.mark.slow(keep=["False-8-0.0"])
@pytest.mark.parametrize(("count", "slope"), [(8, 0.0), (15, 0.3), (60, 0.3)])
@pytest.mark.parametrize("with_sigmas", [False, True])
def test_false_alarms_are_as_stated(count, slope, with_sigmas):
    """At most one series in a hundred, with room for the scatter of 600 series (3 sigma)."""
    rng = np.random.default_rng(count)
    time, sigma = np.arange(count, dtype=float), rng.uniform(0.5, 2.0, count)
    alarms = 0
    for _ in range(600):
        noise = rng.normal(size=count)
        values = slope * time + (noise * sigma if with_sigmas else noise)
        alarms += screen(time, values, sigma if with_sigmas else None).outlier.any()
    assert alarms <= 6 + 3 * np.sqrt(6)


def test_outliers_are_found_and_nothing_else():
    rng = np.random.default_rng(1)
    time, sigma = np.arange(60.0), np.full(60, 0.1)
    found = missed = false = 0
    for _ in range(200):
        values = 0.05 * time + rng.normal(0.0, 0.1, 60)
        planted = rng.choice(60, 3, replace=False)
        values[planted] += rng.choice([-1.0, 1.0], 3)
        flagged = screen(time, values, sigma).outlier
        found += flagged[planted].sum()
        missed += (~flagged[planted]).sum()
        false += flagged.sum() - flagged[planted].sum()
    assert missed == 0
    assert found == 600
    assert false <= 8  # two would be expected


def test_short_and_odd_series():
    assert not screen([1.0, 2.0, 3.0], [0.0, 0.0, 9.0]).outlier.any()  # three points have no outlier
    assert len(screen([], []).outlier) == 0
    gap = screen(np.arange(12.0), [0.0] * 5 + [np.nan] + [0.0] * 5 + [3.0])
    assert list(np.flatnonzero(gap.outlier)) == [11]  # among points that do not scatter at all
    assert np.isnan(gap.deviation[5])
    # A lonely late point does not bend the line towards itself; how far off it may be, the others' slope tells.
    before = np.random.default_rng(2).normal(size=40)
    for value, outlier in ((4.0, []), (200.0, [40])):
        lonely = screen([*np.arange(40.0), 200.0], [*before, value])
        assert list(np.flatnonzero(lonely.outlier)) == outlier


def test_completeness_against_truth():
    """Half magnitude of 200 simulated campaigns: error over its sigma is a unit normal."""
    rng = np.random.default_rng(3)
    errors = []
    for _ in range(200):
        mag = rng.uniform(9.0, 13.0, 400)
        seen = rng.random(400) < 1.0 / (1.0 + np.exp((mag - 11.2) / 0.25))
        curve = completeness(mag, seen)
        errors.append((curve.half_mag - 11.2) / curve.half_mag_sigma)
    assert 0.85 < np.std(errors) < 1.15  # known to 5 % from 200
    assert abs(np.mean(errors)) < 0.25
    assert curve.stars.sum() == 400
    assert curve.detected.sum() == seen.sum()
    assert np.all((curve.low <= curve.share) & (curve.share <= curve.high))
    assert curve.curve(curve.half_mag) == pytest.approx(0.5)


def test_completeness_without_a_limit():
    everything = completeness([9.0, 9.6, np.nan], [True, True, True])
    assert np.isnan(everything.half_mag)
    assert (everything.stars.sum(), list(everything.share)) == (2, [1.0, 1.0])
    assert everything.low[0] < 0.6  # one star of one says little
    assert len(completeness([], []).mag) == 0
    with pytest.raises(SessionError, match="not a curve"):
        completeness([1.0], [True], bin_mag=0.0)


def test_trends_of_an_archive(make_run, tmp_path):
    def off(result, session):
        result["pointing"]["rms_px"] = 3.0

    def faint_missed(result, session):
        for star in result["stars"]:
            if star["mag"] > 10.5 and star["status"] == "used":
                star["status"] = "not_detected"

    with Campaign(tmp_path / "c.sqlite") as campaign:
        for i in range(12):
            edit = off if i == 4 else faint_missed if i % 2 else lambda result, session: None
            campaign.ingest_run(make_run(tmp_path / f"r{i}", i, edit=edit))
        found = trends(campaign)
        early = trends(campaign, until="2015-04-09T03", body="PLUTO")
    assert [name.partition(",")[0] for name in found.bodies] == ["CHARON", "PLUTO"]
    pixel, line = list(found.bodies.values())[1]
    assert len(pixel) == len(line) == 12
    assert np.all(np.diff(pixel.et) == 3600.0)
    assert 0.5 < np.std(pixel.value / pixel.sigma) < 1.6  # made with these sigmas
    assert [image for image, *_ in found.outliers()] == ["pic_004.fit"]
    assert found.outliers()[0][1] == "star residual"
    assert found.detections.detected.sum() < found.detections.stars.sum()
    assert np.isfinite(found.detections.half_mag)
    assert [len(series) for series in found.pointing] == [12] * 3
    assert (len(early.bodies), len(early.residual)) == (1, 4)


def test_a_night_draws_its_trends_and_names_what_is_off(tmp_path, make_run):
    def moved(result, _session):
        result["pointing"]["delta_line"] = 90.0

    archive = tmp_path / "campaign.sqlite"
    with Campaign(archive) as campaign:
        for number in range(12):
            edit = {"edit": moved} if number == 7 else {}
            campaign.ingest_run(make_run(tmp_path / f"pic_{number:03d}", number, **edit))
    told = write_night_trends(archive, tmp_path)
    assert (tmp_path / told["figure"]).read_bytes().startswith(b"\x89PNG")
    assert [(row["image"], row["series"]) for row in told["outliers"]] == [
        ("pic_007.fit", "pointing error, line")
    ]
    none = write_night_trends(tmp_path / "elsewhere.sqlite", tmp_path)
    assert none["figure"] is None
    assert "elsewhere.sqlite" in none["why_not"]
    assert not (tmp_path / told["figure"]).exists()  # an old one would be taken for this night's

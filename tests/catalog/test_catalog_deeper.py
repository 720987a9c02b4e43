"""What a deeper catalog would bring, told before anybody has it."""

import re

import numpy as np
import pytest

from opnav_workbench.catalog import deeper_catalogs, open_catalog

FIELD_SR = np.radians(0.5) ** 2


def counts(ra_deg, dec_deg, field_sr=FIELD_SR):
    told = deeper_catalogs(np.radians(ra_deg), np.radians(dec_deg), field_sr)
    return told, [int(number) for number in re.findall(r"about (\d+)", told)]


@pytest.mark.slow
def test_commands_and_about_how_many_stars_they_bring(tmp_path, monkeypatch):
    monkeypatch.setenv("OPNAV_CACHE", str(tmp_path))
    told, (tycho2, debian, gaia) = counts(192.9, 27.1)  # the pole of the Galaxy
    assert "opnav catalog fetch tycho2: about" in told
    assert "apt install astrometry-data-tycho2-07" in told
    assert 3 <= debian <= tycho2 < 15 < gaia < 60  # 15 in the mean over the sky, 40
    assert counts(266.0, -60.0)[1][0] > tycho2  # nearer to its plane


def test_what_is_here_is_not_offered(tmp_path, monkeypatch):
    folder = tmp_path / "index"
    folder.mkdir()
    (folder / "index-tycho2-07.fits").touch()
    monkeypatch.setenv("OPNAV_ASTROMETRY", str(folder))
    told, _ = counts(10.0, 20.0)
    assert told.startswith("opnav catalog fetch gaia --mag-limit 13: about")
    assert "tycho2" not in told


def test_about_as_many_as_there_are(data_dir):
    """Against Tycho-2 itself, of which the list here has three quarters of 2.5 million stars."""
    tycho2 = open_catalog(f"npz:{data_dir / 'stars/tycho2.npz'}")
    rng = np.random.default_rng(3)
    ratios = []
    for _ in range(20):
        ra, dec, radius = rng.uniform(0.0, 2.0 * np.pi), np.arcsin(rng.uniform(-1.0, 1.0)), np.radians(1.5)
        there = len(tycho2.cone(ra, dec, radius)) / 0.75
        ratios.append(counts(np.degrees(ra), np.degrees(dec), np.pi * radius**2)[1][0] / there)
    assert np.quantile(ratios, 0.1) > 0.5
    assert np.quantile(ratios, 0.9) < 1.7

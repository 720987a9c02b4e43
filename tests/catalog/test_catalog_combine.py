"""Two catalogs made one: the same stars found, motions from two epochs with honest sigmas, nothing lost."""

from dataclasses import replace

import numpy as np
import pytest
from astropy.table import Table

from opnav_workbench.catalog import StarTable, open_catalog
from opnav_workbench.catalog.combined import CombinedCatalog, combine_stars, same_stars
from opnav_workbench.catalog.quality import StarQuality
from opnav_workbench.catalog.user_files import open_npz
from opnav_workbench.constants import RAD_PER_DEG, RAD_PER_MAS
from opnav_workbench.errors import CatalogError

EPOCHS = (2016.0, 2000.0)
SIGMAS_MAS = (0.1, 40.0)
N = 3000


def stars(ra_rad, dec_rad, motion, mag, epoch, sigma_mas, *, known=False, prefix="a"):
    n = len(ra_rad)
    sigma = np.full((n, 5), 15.0 * RAD_PER_MAS)
    sigma[:, :2] = sigma_mas * RAD_PER_MAS
    sigma[:, 2] = 3.0 * RAD_PER_MAS
    if known:
        sigma[:, 3:] = 0.05 * RAD_PER_MAS
    return StarTable(
        id=np.array([f"{prefix}{i}" for i in range(n)]),
        ra_rad=ra_rad,
        dec_rad=dec_rad,
        pmra_rad_yr=motion[:, 0] * known,
        pmdec_rad_yr=motion[:, 1] * known,
        parallax_rad=np.zeros(n),
        rv_km_s=np.full(n, np.nan),
        mag=mag,
        band=np.full(n, "V"),
        epoch_jyear=np.full(n, epoch),
        sigma=sigma,
        motion_known=np.full(n, known),
        v_mag=mag,
        v_sigma=np.full(n, 0.1),
    )


@pytest.fixture(scope="module")
def truth():
    """Return the later and the earlier list (n rows each, in the same order) and the true motions, rad/yr."""
    random = np.random.default_rng(4)
    ra, dec = 1.0 + 0.3 * random.random(N), 0.4 + 0.3 * random.random(N)
    motion = random.normal(0.0, 20.0 * RAD_PER_MAS, (N, 2))
    mag = random.uniform(6.0, 12.0, N)
    lists = []
    for epoch, sigma, prefix in zip(EPOCHS, SIGMAS_MAS, "ab", strict=True):
        east, north = motion.T * (epoch - EPOCHS[0]) + random.normal(0.0, sigma * RAD_PER_MAS, (2, N))
        lists.append(stars(ra + east / np.cos(dec), dec + north, motion, mag, epoch, sigma, prefix=prefix))
    return lists[0], lists[1], motion


def test_every_star_finds_itself(truth):
    later, earlier, _ = truth
    shuffled = np.random.default_rng(1).permutation(N)
    rows, partner = same_stars(later, earlier.take(shuffled))
    assert len(rows) >= 0.999 * N  # a chance neighbor may lie nearer
    assert np.mean(shuffled[partner] == rows) > 0.999


def test_motion_from_two_epochs_with_its_sigma(truth):
    later, earlier, motion = truth
    both = combine_stars(later, earlier)
    rows = np.array([int(name[1:]) for name in both.id])
    assert len(both) == N
    assert both.motion_known.all()
    assert np.all(both.epoch_jyear == EPOCHS[0])  # the sharper position
    assert set(both.id[rows.argsort()]) == set(later.id)
    error = np.stack([both.pmra_rad_yr, both.pmdec_rad_yr], axis=-1) - motion[rows]
    np.testing.assert_allclose(np.std(error / both.sigma[:, 3:], axis=0), 1.0, atol=0.05)
    np.testing.assert_allclose(both.sigma[:, 3:], 40.0 / 16.0 * RAD_PER_MAS, rtol=0.01)


def test_the_sigma_at_the_other_epoch_is_that_of_the_other_position(truth):
    later, earlier, _ = truth
    both = combine_stars(later, earlier)
    et = (EPOCHS[1] - 2000.0) * 365.25 * 86400.0
    sigma = np.sqrt(both.sky_covariance(et)[:, 0, 0]) / RAD_PER_MAS
    np.testing.assert_allclose(sigma, 40.0, rtol=0.01)  # 0.25 mas/yr more for what orbits leave


def test_a_good_motion_of_its_own_is_kept(truth):
    later, earlier, motion = truth
    known = replace(
        later,
        pmra_rad_yr=motion[:, 0],
        pmdec_rad_yr=motion[:, 1],
        motion_known=np.ones(N, bool),
        sigma=np.concatenate([later.sigma[:, :3], np.full((N, 2), 0.05 * RAD_PER_MAS)], axis=1),
    )
    for first, second in ((known, earlier), (earlier, known)):
        both = combine_stars(first, second)
        rows = np.array([int(name[1:]) for name in both.id])
        np.testing.assert_array_equal(both.pmra_rad_yr, motion[rows, 0])
        # Five sigma of disagreement widen it for next to none.
        assert np.mean(both.sigma[:, 3] < 0.0501 * RAD_PER_MAS) > 0.98


def test_the_first_list_names_and_measures_the_stars(truth):
    later, earlier, _ = truth
    brighter = replace(earlier, mag=earlier.mag + 0.4, v_sigma=np.full(N, 0.02), band=np.full(N, "VT"))
    both = combine_stars(later, brighter)
    assert set(both.band) == {"V"}
    rows = np.array([int(name[1:]) for name in both.id])
    np.testing.assert_array_equal(both.mag, later.mag[rows])
    np.testing.assert_array_equal(both.v_sigma, 0.02)  # the better of the two


def test_nothing_is_lost_and_nothing_is_twice(truth):
    later, earlier, _ = truth
    half = N // 2
    both = combine_stars(later.take(slice(0, half + 100)), earlier.take(slice(half, N)))
    assert len(both) == N
    names = set(both.id)
    assert {f"a{i}" for i in range(half + 100)} <= names
    assert {f"b{i}" for i in range(half + 100, N)} <= names


def test_other_brightness_is_another_star(truth):
    later, earlier, _ = truth
    faint = replace(earlier, v_mag=earlier.v_mag + 4.0, mag=earlier.mag + 4.0)
    assert len(combine_stars(later, faint)) >= 2 * N - 3


def test_unknown_brightness_is_no_objection(truth):
    later, earlier, _ = truth
    assert len(combine_stars(later, replace(earlier, v_mag=np.full(N, np.nan)))) == N


def test_a_doubted_position_that_is_replaced_no_longer_counts(truth):
    later, earlier, _ = truth
    marked = replace(earlier, flags=np.full(N, int(StarQuality.BAD_ASTROMETRY | StarQuality.DOUBLE)))
    assert set(combine_stars(later, marked).flags) == {int(StarQuality.DOUBLE)}


def test_epochs_too_near_give_no_motion(truth):
    later, earlier, _ = truth
    both = combine_stars(later, replace(earlier, epoch_jyear=np.full(N, 2013.0), sigma=earlier.sigma * 100))
    matched = both.take(np.char.startswith(both.id, "a"))
    assert not matched.motion_known.any()


def test_a_contradiction_widens_the_sigma(truth):
    later, earlier, motion = truth
    wrong = replace(
        later,
        pmra_rad_yr=motion[:, 0] + 14.0 * RAD_PER_MAS,
        pmdec_rad_yr=motion[:, 1],
        motion_known=np.ones(N, bool),
        sigma=np.concatenate([later.sigma[:, :3], np.full((N, 2), 1.0 * RAD_PER_MAS)], axis=1),
    )
    both = combine_stars(wrong, earlier)
    matched = both.take(np.char.startswith(both.id, "a"))
    assert 6.0 < np.median(matched.sigma[:, 3]) / RAD_PER_MAS < 14.0


def _npz(path, table, **scalars):
    np.savez(
        path,
        ra_deg=table.ra_rad / RAD_PER_DEG,
        dec_deg=table.dec_rad / RAD_PER_DEG,
        mag=table.mag,
        id=table.id,
        **scalars,
    )
    return f"npz:{path}"


@pytest.fixture
def catalogs(tmp_path, truth):
    later, earlier, _ = truth
    return [
        _npz(tmp_path / f"{name}.npz", table, epoch_jyear=epoch, sigma_mas=sigma, band="V")
        for name, table, epoch, sigma in zip("ab", (later, earlier), EPOCHS, SIGMAS_MAS, strict=True)
    ]


def test_a_cone_of_both(catalogs, truth):
    both = open_catalog("+".join(catalogs))
    assert both.name == "+".join(catalogs)
    assert both.describe()["n_stars"] == 2 * N
    part = open_catalog(catalogs[0])
    cone = (1.15, 0.55, 0.05)
    found, alone = both.cone(*cone), part.cone(*cone)
    assert set(found.id) == set(alone.id)
    assert found.motion_known.all()
    assert np.all(np.diff(found.mag) >= 0.0)
    corners = [[np.cos(d) * np.cos(r), np.cos(d) * np.sin(r), np.sin(d)] for r, d in
               ((1.1, 0.5), (1.2, 0.5), (1.2, 0.6), (1.1, 0.6))]  # fmt: skip
    assert set(both.polygon(corners).id) == set(part.polygon(corners).id)
    assert both.cone(*cone, mag_limit=9.0).mag.max() <= 9.0


def test_a_cone_at_another_epoch(catalogs):
    both = open_catalog("+".join(catalogs))
    et = 25.0 * 365.25 * 86400.0
    cone = (1.15, 0.55, 0.03)
    found = both.cone(*cone, et_s=et)
    whole = both.cone(cone[0], cone[1], 0.04)
    directions = whole.directions(et)
    center = np.array([np.cos(0.55) * np.cos(1.15), np.cos(0.55) * np.sin(1.15), np.sin(0.55)])
    assert set(found.id) == set(whole.id[np.arccos(directions @ center) <= 0.03])


def test_wrong_parts_say_so(catalogs):
    with pytest.raises(CatalogError, match="does not exist"):
        open_catalog(f"{catalogs[0]}+npz:none.npz")
    with pytest.raises(CatalogError, match="radius"):
        open_catalog("+".join(catalogs)).cone(0.0, 0.0, -1.0)


@pytest.mark.slow
@pytest.mark.realdata
def test_gaia_with_tycho_gives_motions_of_1_mas_a_year(data_dir, tmp_path):
    """Positions only, J2016 and J2000; truth is Gaia's own motion, which neither list holds."""
    rows = Table.read(data_dir / "stars/gaia_data_j2016.csv")
    names = np.array([f"Gaia {source}" for source in rows["source_id"]])
    np.savez(
        tmp_path / "gaia.npz",
        ra_deg=np.array(rows["ra"]),
        dec_deg=np.array(rows["dec"]),
        mag=np.array(rows["phot_g_mean_mag"]),
        id=names,
        sigma_mas=0.1,
        epoch_jyear=2016.0,
        band="G",
    )
    parts = [open_npz(str(tmp_path / "gaia.npz")), open_npz(str(data_dir / "stars/tycho2.npz"))]
    found = CombinedCatalog(parts).cone(0.5, 0.2, 1.0, mag_limit=7.5)
    of_gaia = found.take(np.char.startswith(found.id, "Gaia"))
    matched = of_gaia.take(of_gaia.motion_known)
    assert len(matched) > 0.93 * len(of_gaia)  # the rest: very fast ones, and the brightest
    order = {name: i for i, name in enumerate(names)}
    at = np.array([order[name] for name in matched.id])
    true = np.stack([np.array(rows["pmra"])[at], np.array(rows["pmdec"])[at]], axis=-1)
    motion = np.stack([matched.pmra_rad_yr, matched.pmdec_rad_yr], axis=-1) / RAD_PER_MAS
    error = np.abs(motion - true)[np.isfinite(true).all(axis=1)]
    assert np.percentile(error, 68) < 1.5  # mas/yr
    assert np.percentile(error / (matched.sigma[np.isfinite(true).all(axis=1), 3:] / RAD_PER_MAS), 95) < 2.5

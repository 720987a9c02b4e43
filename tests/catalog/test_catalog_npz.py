"""npz catalogs: every array, every default, every complaint."""

import numpy as np
import pytest

from opnav_workbench.catalog import UNKNOWN_MOTION_MAS_YR, open_catalog
from opnav_workbench.catalog.proper_motion import mean_motion_rad_yr
from opnav_workbench.errors import CatalogError

MAS = np.pi / 180.0 / 3.6e6
PLAIN = {"ra_deg": [10.0, 10.1, 350.0], "dec_deg": [0.0, 0.05, -0.1], "mag": [8.0, 7.0, 6.0]}


def saved(folder, **arrays):
    path = folder / "stars.npz"
    np.savez(path, **{name: np.asarray(values) for name, values in arrays.items()})
    return path


def whole(path):
    return open_catalog(f"npz:{path}").cone(0.0, 0.0, np.pi)


def test_a_plain_file_gets_honest_defaults(tmp_path) -> None:
    stars = whole(saved(tmp_path, **PLAIN))
    assert list(stars.id) == ["row:2", "row:1", "row:0"]
    np.testing.assert_allclose(np.degrees(stars.ra_rad), [350.0, 10.1, 10.0], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(stars.epoch_jyear, 2000.0)
    np.testing.assert_array_equal(
        stars.pmra_rad_yr, mean_motion_rad_yr(stars.ra_rad, stars.dec_rad, stars.mag)[:, 0]
    )
    assert not stars.motion_known.any()
    assert np.isnan(stars.rv_km_s).all()
    np.testing.assert_allclose(stars.sigma[:, 3:] / MAS, UNKNOWN_MOTION_MAS_YR, rtol=1e-14)
    np.testing.assert_allclose(stars.sigma[:, :2] / MAS, 100.0, rtol=1e-14)
    # An unknown parallax is zero, give or take that of stars of this brightness: 6.8 mas at magnitude 7.
    np.testing.assert_array_equal(stars.parallax_rad, 0.0)
    np.testing.assert_allclose(
        stars.sigma[:, 2] / MAS, 6.8 * 10.0 ** (-0.15 * np.array([-1, 0, 1])), rtol=1e-14
    )


def test_every_array_arrives_in_radians(tmp_path) -> None:
    path = saved(
        tmp_path,
        **PLAIN,
        id=["a", "Proxima Centauri", "c"],
        pmra_mas_yr=[1.0, -3781.741, np.nan],
        pmdec_mas_yr=[2.0, 769.465, np.nan],
        parallax_mas=[3.0, 768.0665, np.nan],
        rv_km_s=[4.0, -20.578, np.nan],
        sigma_mas=[0.5, 0.1, 60.0],
        epoch_jyear=[2016.0, 2016.0, 1991.25],
        band=["G", "G", "VT"],
        remark=["ignored", "ignored", "ignored"],
    )
    stars = whole(path)
    assert list(stars.id) == ["c", "Proxima Centauri", "a"]
    mean = mean_motion_rad_yr(stars.ra_rad, stars.dec_rad, stars.mag)[0, 0] / MAS
    np.testing.assert_allclose(stars.pmra_rad_yr / MAS, [mean, -3781.741, 1.0], rtol=1e-14)
    np.testing.assert_allclose(stars.parallax_rad / MAS, [0.0, 768.0665, 3.0], rtol=1e-14)
    np.testing.assert_array_equal(stars.rv_km_s, [np.nan, -20.578, 4.0])
    np.testing.assert_array_equal(stars.epoch_jyear, [1991.25, 2016.0, 2016.0])
    assert stars.motion_known.tolist() == [False, True, True]
    # Motions of a file that states position sigmas only: s mas/yr, and 2.5 mas/yr at most.
    np.testing.assert_allclose(stars.sigma[:, 3] / MAS, [UNKNOWN_MOTION_MAS_YR, 0.1, 0.5], rtol=1e-14)
    assert list(stars.band) == ["VT", "G", "G"]


def test_scalars_hold_for_every_star_and_ids_may_be_numbers_or_bytes(tmp_path) -> None:
    stars = whole(saved(tmp_path, **PLAIN, id=[7, 8, 9], sigma_mas=70.0, epoch_jyear=2015.5, band="VT"))
    assert list(stars.id) == ["9", "8", "7"]
    np.testing.assert_allclose(stars.sigma[:, 0] / MAS, 70.0, rtol=1e-14)
    np.testing.assert_array_equal(stars.epoch_jyear, 2015.5)
    assert set(stars.band) == {"VT"}
    assert list(whole(saved(tmp_path, **PLAIN, id=[b"x", b"y", b"z"])).id) == ["z", "y", "x"]


def test_position_sigma_grows_with_the_years_when_the_motion_is_unknown(tmp_path) -> None:
    from opnav_workbench.geometry import et_from_jyear, propagate_covariance

    stars = whole(saved(tmp_path, **PLAIN, sigma_mas=50.0))
    for jyear in (1980.0, 2020.0):
        covariance = propagate_covariance(
            stars.covariance, stars.epoch_jyear, et_from_jyear(jyear), stars.ra_rad, stars.dec_rad
        )
        expected = np.hypot(50.0, 15.0 * 20.0)
        np.testing.assert_allclose(np.sqrt(covariance[:, 0, 0]) / MAS, expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mag": None}, "lacks mag; a catalog needs the arrays ra_deg, dec_deg, mag"),
        ({"ra_deg": None, "mag": None}, "lacks ra_deg, mag"),
        ({"mag": [1.0, 2.0]}, r"mag has shape \(2,\) for 3 stars"),
        ({"mag": [1.0, np.nan, 2.0]}, "mag is nan in row 1"),
        ({"dec_deg": [0.0, 0.0, np.inf]}, "dec_deg is inf in row 2"),
        ({"ra_deg": [-1.0, 0.0, 0.0]}, "ra_deg runs from -1 to 0, outside 0..360; wrap"),
        ({"ra_deg": [0.0, 361.0, 0.0]}, "outside 0..360"),
        ({"dec_deg": [0.0, 91.0, 0.0]}, "dec_deg runs from 0 to 91, outside -90..90"),
        ({"mag": ["a", "b", "c"]}, "mag has type <U1; store it as numbers"),
        ({"ra_deg": [[1.0, 2.0, 3.0]]}, "ra_deg has shape"),
        ({"ra_deg": [], "dec_deg": [], "mag": []}, "give one value a star"),
        ({"pmra_mas_yr": [0.0, 0.0, 0.0]}, "one axis only"),
        ({"sigma_mas": -1.0}, "sigma_mas runs from -1"),
        ({"sigma_mas": [1.0, np.nan, 1.0]}, "sigma_mas is nan in row 1"),
        ({"epoch_jyear": 16.0}, "epoch_jyear runs from 16 to 16"),
        ({"parallax_mas": [0.0, np.inf, 0.0]}, "parallax_mas is inf in row 1"),
        ({"id": ["only", "two"]}, "id has shape"),
        ({"id": "one"}, "a single name for 3 stars"),
        ({"band": 3.0}, "band has type"),
        ({"id": np.array(["a", None, 3], dtype=object)}, "holds Python objects"),
    ],
)
def test_a_malformed_file_gets_one_clear_line(tmp_path, change, message: str) -> None:
    arrays = {name: values for name, values in {**PLAIN, **change}.items() if values is not None}
    with pytest.raises(CatalogError, match=message) as caught:
        whole(saved(tmp_path, **arrays))
    assert "\n" not in str(caught.value)


def test_what_is_no_npz_file_is_refused(tmp_path) -> None:
    with pytest.raises(CatalogError, match=r"gone\.npz does not exist; check the path"):
        open_catalog(f"npz:{tmp_path / 'gone.npz'}")
    (tmp_path / "text.npz").write_text("ra dec mag\n")
    with pytest.raises(CatalogError, match="not a whole npz file"):
        open_catalog(f"npz:{tmp_path / 'text.npz'}")
    np.save(tmp_path / "single.npy", np.zeros(3))
    with pytest.raises(CatalogError, match="a single array"):
        open_catalog(f"npz:{tmp_path / 'single.npy'}")
    with pytest.raises(CatalogError, match="cannot read"):
        open_catalog(f"npz:{tmp_path}")


def test_a_damaged_file_is_refused(tmp_path) -> None:
    path = saved(tmp_path, **{name: np.resize(values, 5000) for name, values in PLAIN.items()})
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(content)
    with pytest.raises(CatalogError, match="damaged"):
        open_catalog(f"npz:{path}")
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(CatalogError, match="not a whole npz file"):
        open_catalog(f"npz:{path}")


def test_describe_counts_and_names(tmp_path) -> None:
    path = saved(tmp_path, **PLAIN, band=["G", "V", "G"], epoch_jyear=[2000.0, 2016.0, 2016.0])
    facts = open_catalog(f"npz:{path}").describe()
    assert facts["n_stars"] == 3
    assert facts["bands"] == ["G", "V"]
    assert (facts["brightest_mag"], facts["faintest_mag"]) == (6.0, 8.0)
    assert (facts["first_epoch_jyear"], facts["last_epoch_jyear"]) == (2000.0, 2016.0)


def test_v_is_made_of_the_band(tmp_path) -> None:
    path = tmp_path / "stars.npz"
    np.savez(
        path, ra_deg=np.zeros(3), dec_deg=np.zeros(3), mag=np.full(3, 9.0), band=np.array(["V", "VT", "K"])
    )
    stars = open_catalog(f"npz:{path}").cone(0.0, 0.0, 0.1)
    np.testing.assert_allclose(stars.v_mag, [9.0, 8.91, np.nan])
    assert np.isnan(stars.b_v).all()
    assert (stars.v_sigma[:2] > 0.0).all()

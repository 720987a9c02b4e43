"""Albedo maps: which way round they lie, how they are read, and what is refused."""

import numpy as np
import pytest
import spiceypy
from astropy.io import fits
from PIL import Image

from opnav_workbench.errors import MissionError
from opnav_workbench.geometry import apparent_direction
from opnav_workbench.render import AlbedoMap, BodyModel, LommelSeeliger

DEG = np.pi / 180.0


def spot_map(longitude_deg, latitude_deg, rows=720, **convention):
    """A dark map with one bright cell of a quarter degree at an east longitude and latitude."""
    first = convention.get("first_longitude_deg", 0.0)
    east = longitude_deg if convention.get("east_positive", True) else -longitude_deg
    column = int(((east - first) % 360.0) * rows / 180.0)
    row = int((90.0 - latitude_deg) * rows / 180.0)
    values = np.full((rows, 2 * rows), 0.01)
    values[row if convention.get("north_first", True) else rows - 1 - row, column] = 1.0
    return AlbedoMap(values, **convention)


@pytest.mark.parametrize(
    "convention",
    [
        {},
        {"first_longitude_deg": -180.0},
        {"east_positive": False},
        {"north_first": False, "first_longitude_deg": 90.0, "east_positive": False},
    ],
)
def test_a_bright_spot_appears_where_spice_says(stage, center_of, convention):
    target = stage.target(200.0, 20.0, axes=(1.0, 0.97, 0.9))
    # A place that the camera sees: the sub-spacecraft point, moved a little.
    toward = -target.body_from_j2000 @ target.position_km
    _, sub_longitude, sub_latitude = spiceypy.reclat(toward)
    longitude = np.floor(np.degrees(sub_longitude) + 20.0) + 0.125
    latitude = np.floor(np.degrees(sub_latitude) - 15.0) + 0.125
    point = spiceypy.latrec(1.0, longitude * DEG, latitude * DEG)
    point = point / np.linalg.norm(point / target.radii_km)  # planetocentric direction, on the ellipsoid
    ray = target.position_km + target.body_from_j2000.T @ point
    apparent = apparent_direction(ray, stage.velocity_km_s) @ stage.camera_from_j2000.T
    expected = stage.camera.project(apparent)

    body = BodyModel(target, LommelSeeliger(), spot_map(longitude, latitude, **convention))
    dark = BodyModel(target, LommelSeeliger(), AlbedoMap(np.full((720, 1440), 0.01)))
    window = (int(expected[0]) - 6, int(expected[1]) - 6, 14, 14)
    spot = stage.render(body, window=window).electrons - stage.render(dark, window=window).electrons
    np.testing.assert_allclose(center_of(spot, window[:2]), expected, atol=0.03)


def test_a_fine_map_keeps_its_light_in_a_small_picture(stage):
    # Stripes of 1 deg on a body of 30 px, where a pixel is 4 deg: the mean, not what rays happen to meet.
    stripes = AlbedoMap(np.tile([0.1, 0.1, 0.9, 0.9], (360, 180)))
    target = stage.target(30.0, 40.0)
    (striped,) = stage.render(BodyModel(target, LommelSeeliger(), stripes)).bodies
    (plain,) = stage.render(BodyModel(target, LommelSeeliger(), 0.5)).bodies
    assert striped.flux_e == pytest.approx(plain.flux_e, rel=2e-3)
    picture = stage.render(BodyModel(target, LommelSeeliger(), stripes)).electrons
    assert picture.sum() == pytest.approx(plain.flux_e, rel=2e-3)


def test_values_stand_for_cell_middles_and_wrap_around():
    ramp = AlbedoMap(np.tile(np.arange(8) / 10.0, (4, 1)))
    middles = (np.arange(8) + 0.5) * 45.0 * DEG
    np.testing.assert_allclose(ramp.sample(middles, np.zeros(8)), np.arange(8) / 10.0, atol=1e-12)
    assert ramp.sample([0.0], [0.0])[0] == pytest.approx(0.35)  # between the last column and the first
    np.testing.assert_allclose(ramp.sample(middles - 10 * np.pi, np.zeros(8)), np.arange(8) / 10.0, atol=1e-9)
    rows = AlbedoMap(np.repeat([[0.1], [0.2], [0.3], [0.4]], 8, axis=1))
    np.testing.assert_allclose(rows.sample(np.zeros(3), [90 * DEG, 0.0, -90 * DEG]), [0.1, 0.25, 0.4])


def test_pictures_and_arrays_are_read_alike(tmp_path):
    gray = np.tile(np.arange(0, 256, 16, dtype=np.uint8), (8, 1))
    Image.fromarray(gray).save(tmp_path / "map.png")
    Image.fromarray(gray.astype(np.uint16) * 257).save(tmp_path / "wide.png")
    Image.fromarray(np.stack([gray] * 3, axis=-1)).save(tmp_path / "colour.png")
    albedo = 0.1 + 0.8 * gray / 255.0
    np.save(tmp_path / "map.npy", albedo)
    fits.writeto(tmp_path / "map.fits", albedo.astype(">f8"))
    for name in ("map.png", "wide.png", "colour.png"):
        read = AlbedoMap.from_file(tmp_path / name, darkest=0.1, brightest=0.9)
        np.testing.assert_allclose(read.values, albedo, atol=1e-12, err_msg=name)
    for name in ("map.npy", "map.fits"):
        np.testing.assert_allclose(AlbedoMap.from_file(tmp_path / name).values, albedo, atol=1e-12)


def test_wrong_maps_are_refused_in_one_line(tmp_path):
    Image.new("L", (300, 200)).save(tmp_path / "square.png")
    with pytest.raises(MissionError, match=r"square.png is 300 x 200 .* twice as wide as high"):
        AlbedoMap.from_file(tmp_path / "square.png")
    (tmp_path / "broken.png").write_bytes(b"no picture")
    with pytest.raises(MissionError, match="cannot be read"):
        AlbedoMap.from_file(tmp_path / "broken.png")
    with pytest.raises(MissionError, match="cannot be read"):
        AlbedoMap.from_file(tmp_path / "missing.npy")
    with pytest.raises(MissionError, match="finite and not negative"):
        AlbedoMap(np.full((2, 4), -0.1))
    np.save(tmp_path / "nan.npy", np.full((2, 4), np.nan))
    with pytest.raises(MissionError, match=r"nan.npy.*finite"):
        AlbedoMap.from_file(tmp_path / "nan.npy")
    Image.new("L", (4, 2)).save(tmp_path / "small.png")
    with pytest.raises(MissionError, match=r"darkest 0\.9 and brightest 0\.1"):
        AlbedoMap.from_file(tmp_path / "small.png", darkest=0.9, brightest=0.1)


@pytest.mark.realdata
def test_published_pluto_map(data_dir):
    pluto = AlbedoMap.from_file(
        data_dir / "maps" / "pluto-bjorn-20150719-filled.png", darkest=0.1, brightest=1.0
    )
    assert pluto.values.shape == (512, 1024)
    assert 0.1 <= pluto.values.min() < pluto.values.max() <= 1.0

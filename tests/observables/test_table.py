"""The table of observables and its ECSV file."""

import io
from dataclasses import replace

import numpy as np
import pytest
from astropy import units as u
from astropy.table import QTable, Table
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from opnav_workbench.bodies import BodyCenter
from opnav_workbench.errors import SessionError
from opnav_workbench.geometry import camera_from_j2000
from opnav_workbench.observables import Origin, ecsv_text, observables_table, observe, write_ecsv
from opnav_workbench.observables.columns import COLUMNS
from opnav_workbench.targets import TargetState

TEXT = {
    "image",
    "utc",
    "body",
    "method",
    "status",
    "observer",
    "reference_body",
    "light_time",
    "center_cross_px2",
    "messages",
}


@pytest.fixture(scope="module")
def observables(cameras, body_seen_at):
    """Three rows: measured, without a center, behind the camera."""
    camera = cameras["lorri"]
    attitude = camera_from_j2000(4.7, -0.25, 2.0, camera.focal_from_camera)
    velocity = np.array([3.1, -12.4, -6.0])
    front = body_seen_at(camera, attitude, (979.04, 34.29), 6.3e6, velocity)
    behind = TargetState("SUN", -front.position_km)
    covariance = np.array([[0.01, 0.002], [0.002, 0.02]])
    centers = [
        BodyCenter("PLUTO", "unresolved", "ok", np.array([979.1, 34.2]), covariance, 5e3, 80.0),
        BodyCenter.without_center(
            "NIX", "unresolved", "not_detected", 'nothing "found", so', "it\u2019s gone"
        ),
        BodyCenter.without_center("SUN", "unresolved", "off_detector", "behind"),
    ]
    return [
        observe(
            target,
            center,
            camera,
            attitude,
            1e-14 * np.eye(3),
            observer_velocity_km_s=velocity,
            a_priori_px=np.array([970.0, 30.0]),
            diameter_px=75.8,
            image="lor_0299.fit",
            et=489998884.123456789,
            utc="2015-07-12T08:46:57.123",
            reference_body="PLUTO BARYCENTER",
        )
        for target, center in zip([front, front, behind], centers, strict=True)
    ]


def test_every_column_has_a_description_and_every_number_a_unit(observables):
    table = observables_table(observables)
    for name in table.colnames:
        assert table[name].info.description
        assert (table[name].info.unit is None) == (name in TEXT)


def test_values_are_those_of_the_observables(observables):
    row, first = observables_table(observables)[0], observables[0]
    assert row["pixel_o"].to_value(u.pix) == 979.1
    assert row["line_oc"].to_value(u.pix) == first.residual_px[1]
    assert row["sigma_line"].to_value(u.pix) == pytest.approx(np.sqrt(0.02), rel=1e-15)
    assert row["covariance_pixel_line"].to_value(u.pix**2) == 0.002
    assert row["sigma_pixel_oc"].to_value(u.pix) > row["sigma_pixel"].to_value(u.pix)
    names = [f"d{axis}_d{name}" for axis in ("pixel", "line") for name in "xyz"]
    partials = [row[name].to_value(u.pix / u.km) for name in names]
    np.testing.assert_array_equal(partials, first.partials_px_per_km.ravel())
    names = [f"d{axis}_drotation_{name}" for axis in ("pixel", "line") for name in "xyz"]
    np.testing.assert_array_equal([row[n].value for n in names], first.partials_px_per_rad.ravel())
    assert row["ra_cosdec_oc"].to_value(u.arcsec) == first.residual_arcsec[0]
    assert row["ra"].to_value(u.deg) == first.ra_deg


def test_missing_values_are_nan(observables):
    table = observables_table(observables)
    for name in ("pixel_o", "line_oc", "sigma_pixel", "ra", "dec_oc", "snr"):
        assert np.isnan(table[name].value[1:]).all(), name
    assert np.isfinite(table["dpixel_dx"].value).tolist() == [True, True, False]
    assert np.isfinite(table["pixel_c"].value).tolist() == [True, True, False]


def test_file_reads_back_to_the_bit(observables, tmp_path):
    path = tmp_path / "run" / "observables.ecsv"
    write_ecsv(observables, path)
    written, read = observables_table(observables), QTable.read(path, format="ascii.ecsv")
    assert read.colnames == written.colnames
    for name in written.colnames:
        assert read[name].info.description == written[name].info.description
        if name in TEXT:
            assert read[name].tolist() == written[name].tolist()
        else:
            assert read[name].unit == written[name].unit
            np.testing.assert_array_equal(read[name].value, written[name].value)
    assert [p.name for p in path.parent.iterdir()] == ["observables.ecsv"]


def test_no_observables_make_a_file_with_all_columns(tmp_path):
    write_ecsv([], tmp_path / "empty.ecsv")
    read = QTable.read(tmp_path / "empty.ecsv", format="ascii.ecsv")
    assert len(read) == 0
    assert read.colnames == observables_table([]).colnames


def test_failure_leaves_the_older_file(observables, tmp_path, monkeypatch):
    path = tmp_path / "observables.ecsv"
    write_ecsv(observables[:1], path)
    before = path.read_bytes()

    def full_disk(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("opnav_workbench.files.os.fsync", full_disk)
    with pytest.raises(SessionError, match="No space left"):
        write_ecsv(observables, path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["observables.ecsv"]


def test_the_text_of_an_ecsv_holds_the_table_whatever_its_names(observables):
    """Its values, units, descriptions and metadata, also of files whose names are no UTF-8."""
    words = 'it\'s "far" off, 3 px: see #2 \udcff'
    odd = replace(observables[0], messages=(words,), image="a b.fit")
    origins = [Origin("m", "c: #1", "1.0", "bundled", (("a b.bsp", "00"), ("\udcff.tf", "01")))]
    rows = (odd, *observables[1:])
    text = ecsv_text(rows, origins).encode("utf-8", "backslashreplace").decode()
    read, made = QTable.read(text, format="ascii.ecsv"), observables_table(rows, origins)
    assert read.colnames == made.colnames
    for name in made.colnames:
        assert type(read[name]) is type(made[name]), name
        assert (read[name].unit, read[name].info.description) == (
            made[name].unit,
            made[name].info.description,
        )
        if made[name].dtype.kind == "f":
            np.testing.assert_array_equal(read[name].value, made[name].value)
        else:
            assert [str(cell) for cell in read[name]] == [
                str(cell).encode("utf-8", "backslashreplace").decode() for cell in made[name]
            ]
    assert dict(read.meta["conventions"]) == dict(made.meta["conventions"])
    assert len(read.meta["origins"][0]["kernels"]) == 2


WORDS = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\x00"), min_size=1, max_size=200)


@pytest.mark.slow
@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(WORDS, WORDS, st.lists(st.floats(), min_size=4, max_size=4))
@example("\t", "a\rb", [0.0, 0.0, 0.0, 0.0])
@example("a b.fit", 'it\'s "far" off: #2, \u00e9 ' * 12, [0.1, 1e300, -0.0, np.nan])
def test_an_ecsv_is_what_astropy_writes(observables, name, words, numbers):
    """To the byte, whatever stands in it."""
    first = replace(
        observables[0], image=name, messages=(words,), et=numbers[0], snr=numbers[1],
        observed_px=np.array(numbers[2:]),
    )  # fmt: skip
    origins = [Origin(name, words, "1.0", "bundled", ((words, "00"), (name, "01")))]
    for rows in ((first, *observables[1:]), ()):
        expected = io.StringIO()
        Table(observables_table(rows, origins), copy=False).write(expected, format="ascii.ecsv")
        assert ecsv_text(rows, origins) == expected.getvalue()


def test_units_are_written_as_astropy_writes_them():
    for column in COLUMNS:
        assert column.unit is None or str(u.Unit(column.unit)) == column.unit, column.name

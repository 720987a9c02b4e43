"""CSV, JSON and ECSV read back; a reader without this package understands CSV and JSON."""

import csv
import io
import json
from dataclasses import fields, replace

import numpy as np
import pytest

from opnav_workbench.errors import SessionError
from opnav_workbench.files import json_text
from opnav_workbench.observables import (
    Observable,
    Origin,
    joint_covariance_px2,
    read_csv,
    read_ecsv,
    read_json,
    write_csv,
    write_ecsv,
    write_observables_json,
)
from opnav_workbench.observables.files import csv_text, observables_dict, observables_of_result

FORMATS = {
    "csv": (write_csv, read_csv),
    "ecsv": (write_ecsv, read_ecsv),
    "json": (write_observables_json, read_json),
}
ONE_ULP = 3e-16  # a sigma is squared again


def same(first, second, exact):
    """Every field alike: to the bit, or with a unit in the last place where a covariance was written as a sigma."""
    for field in fields(Observable):
        one, other = getattr(first, field.name), getattr(second, field.name)
        if field.name == "center_cross_px2":
            assert one.keys() == other.keys()
            assert all(np.array_equal(one[key], other[key]) for key in one)
        elif isinstance(one, np.ndarray | float) and other is not None:
            rtol = 0.0 if exact or "covariance" not in field.name else ONE_ULP
            np.testing.assert_allclose(other, one, rtol=rtol, atol=0.0, err_msg=field.name)
        elif field.name == "messages" and not exact:
            assert "; ".join(other).replace(";", ",") == "; ".join(one).replace(";", ",")
        else:
            assert one == other, field.name


@pytest.mark.parametrize("name", FORMATS)
def test_every_field_reads_back(approach_observables, tmp_path, name):
    write, read = FORMATS[name]
    path = tmp_path / f"observables.{name}"
    write(approach_observables, path)
    back = read(path)
    assert len(back) == len(approach_observables) == 9
    for first, second in zip(approach_observables, back, strict=True):
        same(first, second, exact=name == "json")
    chosen = [0, 1, 3, 4]
    before = joint_covariance_px2([approach_observables[i] for i in chosen])
    after = joint_covariance_px2([back[i] for i in chosen])
    np.testing.assert_allclose(after, before, rtol=1e-14)
    assert np.count_nonzero(before) == 32  # the bodies of a picture are correlated, the pictures are not


@pytest.mark.parametrize("name", FORMATS)
def test_nothing_makes_a_file_that_says_what_would_be_in_it(tmp_path, name):
    write, read = FORMATS[name]
    write([], tmp_path / f"empty.{name}")
    assert read(tmp_path / f"empty.{name}") == ()


def test_csv_explains_itself(approach_observables, tmp_path):
    write_csv(approach_observables, tmp_path / "o.csv")
    text = (tmp_path / "o.csv").read_text()
    notes = [line[2:] for line in text.splitlines() if line.startswith("#")]
    body = "".join(line for line in text.splitlines(keepends=True) if not line.startswith("#"))
    rows = list(csv.DictReader(io.StringIO(body)))
    explained = {note.split(" [")[0] for note in notes if " [" in note}
    assert explained == set(rows[0])
    assert any("pixel_oc [pix] observed minus computed pixel" in note for note in notes)
    assert float(rows[0]["pixel_oc"]) == approach_observables[0].residual_px[0]
    assert float(rows[0]["sigma_line"]) ** 2 == pytest.approx(0.02, rel=1e-15)
    assert rows[7]["pixel_o"] == ""
    assert not any(word in text for word in ("nan", "inf"))
    assert max(map(len, body.splitlines())) < 4000


def test_exported_names_are_no_formulas(approach_observables, tmp_path):
    observable = replace(approach_observables[0], image="=HYPERLINK(1).fit")
    write_csv([observable], tmp_path / "o.csv")
    assert ",=" not in csv_text([observable])
    assert "\n'=HYPERLINK(1).fit," in csv_text([observable])
    assert read_csv(tmp_path / "o.csv")[0].image == "=HYPERLINK(1).fit"


def test_json_explains_itself(approach_observables, tmp_path):
    write_observables_json(approach_observables, tmp_path / "o.json")
    data = json.loads((tmp_path / "o.json").read_text())
    assert data["fields"]["target_partials_px_per_km_s"] == {
        "unit": "pix s / km",
        "shape": [2, 3],
        "description": "d(pixel, line)/d(velocity x, y, z of the target at mid-exposure, J2000)",
    }
    item = data["observables"][0]
    assert set(item) == set(data["fields"]) == {field.name for field in fields(Observable)}
    assert item["center_cross_px2"]["CHARON"][0][0] == pytest.approx(0.01 / 3.0)
    assert data["observables"][7]["observed_px"] is None


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize(
    "text", ["", "hello\nworld,2\n", '{"a": [1, 2', "# %ECSV 1.0\n# ---\nfoo bar\n1 2\n", "\x00\xff"]
)
def test_other_files_are_one_clear_line(tmp_path, name, text):
    path = tmp_path / f"other.{name}"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(SessionError, match=r"other\.") as caught:
        FORMATS[name][1](path)
    assert "\n" not in str(caught.value)
    with pytest.raises(SessionError, match="missing"):
        FORMATS[name][1](tmp_path / f"missing.{name}")


def test_damaged_number_is_named(approach_observables, tmp_path):
    path = tmp_path / "o.csv"
    write_csv(approach_observables, path)
    lines = path.read_text().splitlines()
    lines[-2] = lines[-2].replace("not_detected,", "not_detected,x")
    lines[-1] = lines[-1].replace(repr(approach_observables[-1].et), "yesterday")
    path.write_text("\n".join(lines))
    with pytest.raises(SessionError, match=r"row 8: .*yesterday"):
        read_csv(path)


def test_result_json_alone_gives_what_it_holds(approach_observables):
    o = approach_observables[0]
    body = {
        "name": o.name,
        "method": o.method,
        "status": o.status,
        "a_priori": o.a_priori_px,
        "predicted": o.predicted_px,
        "observed": o.observed_px,
        "covariance_px2": o.covariance_px2,
        "covariance_with_pointing_px2": o.total_covariance_px2,
        "partials_px_per_km": o.partials_px_per_km,
        "ra_deg": o.ra_deg,
        "dec_deg": o.dec_deg,
        "measured_diameter_px": None,
        "measured_range_km": 5.9e6,
        "joint_covariance_px2": {"CHARON": o.center_cross_px2["CHARON"].tolist()},
    }
    lost = dict.fromkeys(body) | {"name": "NIX", "method": "unresolved", "status": "not_detected"}
    result = {"image": o.image, "utc": o.utc, "et": o.et, "pointing": None, "bodies": [body, lost]}
    found, missing = observables_of_result(result)
    np.testing.assert_array_equal(found.residual_px, o.residual_px)
    np.testing.assert_array_equal(found.total_covariance_px2, o.total_covariance_px2)
    assert found.ra_deg == o.ra_deg
    assert np.isnan(found.measured_diameter_px)
    assert found.measured_range_km == 5.9e6
    np.testing.assert_array_equal(found.center_cross_px2["CHARON"], o.center_cross_px2["CHARON"])
    assert missing.observed_px is None
    with pytest.raises(SessionError, match=r"damaged.*process the picture again"):
        observables_of_result({"bodies": [{}], "pointing": None}, "x/result.json")


def changed_json(observables, path, change):
    """Write observables as JSON with the first of them changed."""
    content = json.loads(json_text(observables_dict(observables)))
    change(content["observables"][0])
    path.write_text(json.dumps(content))
    return path


def test_a_field_that_a_later_version_added_is_passed_over(approach_observables, tmp_path):
    """As `format_version` promises; it was "damaged"."""
    path = changed_json(approach_observables, tmp_path / "o.json", lambda first: first.update(surface="icy"))
    assert [o.name for o in read_json(path)] == [o.name for o in approach_observables]


@pytest.mark.parametrize(
    "change",
    [
        lambda first: first.update(et="soon"),
        lambda first: first.update(et=10**400),
        lambda first: first.update(center_cross_px2=1.5),
    ],
)
def test_values_that_no_observable_has(approach_observables, tmp_path, change):
    with pytest.raises(SessionError, match=r"damaged|cannot be read"):
        read_json(changed_json(approach_observables, tmp_path / "o.json", change))


def test_a_table_that_was_shifted_is_refused(approach_observables, tmp_path):
    """A comma too many: numbers stand where texts belong."""
    path = tmp_path / "o.csv"
    write_csv(approach_observables, path)
    text = path.read_text()
    path.write_text(text.replace("\nlor_0.fit,", "\n,lor_0.fit,", 1))
    with pytest.raises(SessionError, match="row 0"):
        read_csv(path)


def test_an_ecsv_of_other_units_is_one_line_and_no_warning(approach_observables, tmp_path):
    """What astropy warns of (here an error) reached the console, or its own exception did."""
    path = tmp_path / "o.ecsv"
    write_ecsv(approach_observables, path)
    text = path.read_text()
    for unit in ("r0", "pix / ''"):
        path.write_text(text.replace("unit: km,", f"unit: {unit!r},"))
        with pytest.raises(SessionError, match=r"convert|unit"):
            read_ecsv(path)


def test_a_result_whose_provenance_is_none(tmp_path):
    result = {"image": "a.fit", "provenance": [1], "bodies": [], "pointing": None}
    with pytest.raises(SessionError, match=r"provenance in the result of a\.fit is damaged"):
        Origin.of_result(result)

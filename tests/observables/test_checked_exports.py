"""`check_file` finds exports sound, and names what is wrong with damaged ones."""

import json
import re

import jsonschema

from opnav_workbench.contracts import KINDS, check_file, schema_of
from opnav_workbench.contracts.layouts import ObservableEntry
from opnav_workbench.files import json_text
from opnav_workbench.observables import (
    observables_dict,
    write_csv,
    write_ecsv,
    write_observables_json,
    write_tdm,
)


def refusals(kind, content):
    return [error.message for error in jsonschema.Draft202012Validator(schema_of(kind)).iter_errors(content)]


def test_exports_are_sound(approach_observables, tmp_path):
    """Times of the fixture are its own: only they are complained of."""
    writers = {"csv": write_csv, "ecsv": write_ecsv, "json": write_observables_json, "tdm": write_tdm}
    for name, write in writers.items():
        write(approach_observables, tmp_path / f"o.{name}")
        faults = check_file(tmp_path / f"o.{name}").faults
        assert all("is not the TDB of utc" in fault for fault in faults), faults
    assert refusals(KINDS["observables"], json.loads((tmp_path / "o.json").read_text())) == []
    written = json.loads(json_text(observables_dict(approach_observables)))
    assert all(set(item) == set(ObservableEntry.model_fields) for item in written["observables"])


def test_damaged_tables(approach_observables, tmp_path):
    path = tmp_path / "o.csv"
    write_csv(approach_observables, path)
    text = path.read_text()
    first = approach_observables[0]
    path.write_text(
        text.replace(repr(float(first.residual_px[0])), "0.75", 1).replace("not_detected", "lost")
    )
    faults = [fault for fault in check_file(path).faults if "TDB" not in fault]
    assert re.search(
        r"^row 0 \(lor_0.fit, PLUTO\): pixel_oc, line_oc: not observed minus computed", faults[0]
    )
    assert any("status: 'lost' is none of ok" in fault for fault in faults)
    path.write_text(text.replace(repr(float(first.et)), "soon", 1))
    assert check_file(path).faults[0].startswith("row 0: et: 'soon' is no number")


def test_damaged_message(approach_observables, tmp_path):
    path = tmp_path / "o.tdm"
    write_tdm(approach_observables, path)
    path.write_text(path.read_text().replace("TIME_SYSTEM = UTC", "TIME_SYSTEM = TAI", 1))
    assert "TAI" in check_file(path).faults[0]

"""What a file of observables says of itself is true, and every format says it."""

import json
import re

import numpy as np
import pytest
import spiceypy
from astropy.table import QTable

from opnav_workbench.constants import SPEED_OF_LIGHT_KM_S
from opnav_workbench.kernels import KernelSet
from opnav_workbench.observables import (
    Origin,
    csv_text,
    observables_dict,
    read_csv,
    read_ecsv,
    read_json,
    read_with_origins,
    tdm_text,
    write_csv,
    write_ecsv,
    write_observables_json,
)
from opnav_workbench.observables.explanation import ASTROMETRIC, CONVENTIONS
from opnav_workbench.rehearsal import DEMO_CATALOG, DEMO_KERNELS, DEMO_MISSION
from opnav_workbench.session import ImageSession
from opnav_workbench.version import __version__

ARCSEC = np.pi / 180 / 3600
ORIGIN = Origin("new_horizons", "lorri_1x1", "0.1.0", "bundled", (("de440.bsp", "a" * 64),), ("lor_0.fit",))


@pytest.fixture(scope="module")
def solved(demo_truths):
    with KernelSet(DEMO_KERNELS):
        session = ImageSession.open(demo_truths[0].picture, mission=DEMO_MISSION, catalog=DEMO_CATALOG)
        session.predict()
        session.add_target("PLUTO")
        session.find_stars()
        session.repoint()
        session.find_body("PLUTO")
        table = session.observables()
        kernels = {k.path.name: k.sha256 for k in KernelSet.active().kernels()}
        yield table, kernels, _directions(float(table["et"][0].value))


def _directions(et: float) -> dict[str, np.ndarray]:
    """Spacecraft to Pluto by states relative to the barycenter and light time of our own, not by SPICE's corrections."""
    craft = np.array(spiceypy.spkssb(-98, et, "J2000"))
    light_time, kinds = 0.0, {"where it is": np.array(spiceypy.spkssb(999, et, "J2000"))[:3] - craft[:3]}
    for _ in range(5):
        seen = np.array(spiceypy.spkssb(999, et - light_time, "J2000"))[:3] - craft[:3]
        light_time = np.linalg.norm(seen) / SPEED_OF_LIGHT_KM_S
    kinds["astrometric"] = seen
    kinds["apparent"] = spiceypy.stelab(seen, craft[3:])
    return kinds


def _unit(ra, dec) -> np.ndarray:
    a, d = ra.to_value("rad"), dec.to_value("rad")
    return np.array([np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)])


def _angle(one, other) -> float:
    return float(np.linalg.norm(np.cross(one, other)) / np.linalg.norm(one) / np.linalg.norm(other))


@pytest.mark.slow
def test_words_of_directions_are_what_kernels_say(solved):
    """Position and RA, Dec are one direction: to where the body was when the light left, not to where it is."""
    table, _, kinds = solved
    row = table[0]
    sigma = max(row["sigma_ra_cosdec_oc"], row["sigma_dec_oc"]).to_value("rad")
    position = np.array([row[f"position_{a}"].to_value("km") for a in "xyz"])
    np.testing.assert_allclose(position, kinds["astrometric"], atol=0.01)
    observed, apparent = _unit(row["ra"], row["dec"]), _unit(row["apparent_ra"], row["apparent_dec"])
    assert _angle(observed, kinds["astrometric"]) < 3 * sigma
    assert _angle(apparent, kinds["apparent"]) < 3 * sigma
    assert _angle(observed, kinds["where it is"]) > 5 * sigma  # the words before could be read so
    assert _angle(observed, kinds["apparent"]) > 5 * sigma
    for column in ("ra", "dec", "position_x"):
        assert ASTROMETRIC in table[column].info.description
        assert "light time not" not in table[column].info.description
        assert "light time removed" not in table[column].info.description


@pytest.mark.slow
def test_signs_are_those_that_are_told(solved):
    """O-C is observed minus computed; partials are of the computed place, so that O-C falls where it rises."""
    row = solved[0][0]
    assert row["pixel_oc"].value == pytest.approx((row["pixel_o"] - row["pixel_c"]).value, abs=1e-9)
    toward = np.array([row[f"dpixel_d{a}"].value for a in "xyz"])
    aim = toward / np.linalg.norm(toward)
    # Seen from a spacecraft that stands 100 km along the partials, the body moves along increasing pixel.
    position = np.array([row[f"position_{a}"].to_value("km") for a in "xyz"])
    moved = position - 100.0 * aim
    sky = np.array([[row[f"d{p}_d{s}"].value for s in ("ra_cosdec", "dec")] for p in ("pixel", "line")])
    east = np.cross([0.0, 0.0, 1.0], position) / np.linalg.norm(np.cross([0.0, 0.0, 1.0], position))
    north = np.cross(position, east) / np.linalg.norm(position)
    shift = (moved / np.linalg.norm(moved) - position / np.linalg.norm(position)) @ np.stack([east, north], 1)
    assert (sky @ shift)[0] == pytest.approx(100.0 * np.linalg.norm(toward), rel=1e-3)


@pytest.mark.slow
def test_session_table_tells_its_origin(solved):
    table, kernels, _ = solved
    assert table.meta["format_version"] == 1
    assert table.meta["written_by"] == f"opnav_workbench {__version__}"
    (origin,) = table.meta["origins"]
    assert {k["file"]: k["sha256"] for k in origin["kernels"]} == kernels
    assert (origin["mission"], origin["camera"]) == ("new_horizons", "LORRI 4x4")
    assert "images" not in origin  # the tables of a night share their header: it is read once


def _ecsv(observables, path):
    write_ecsv(observables, path, [ORIGIN])
    return path.read_text()


FORMATS = {
    "ecsv": _ecsv,
    "csv": lambda o, _: csv_text(o, [ORIGIN]),
    "json": lambda o, _: json.dumps(observables_dict(o, [ORIGIN]), default=str),
    "tdm": lambda o, _: tdm_text(o, origins=[ORIGIN]),
}


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_says_what_a_stranger_must_know(approach_observables, tmp_path, name):
    text = " ".join(
        re.sub(r"[\s#\\]+", " ", FORMATS[name](approach_observables, tmp_path / "o.ecsv")).split()
    )
    common = (
        "middle of the exposure",
        "UTC",
        "astrometric",
        "one light time before",
        "STELAB",
        "ICRF",
        "J2000",
    )
    origin = ("format_version", f"opnav_workbench {__version__}", "lorri_1x1", "de440.bsp", "a" * 64)
    missing = [words for words in common + origin if words not in text]
    assert not missing
    if name != "tdm":  # it has no computed place and no partials
        assert "observed minus computed" in text
        assert "negative" in text


READERS = {
    "ecsv": (write_ecsv, read_ecsv),
    "csv": (write_csv, read_csv),
    "json": (write_observables_json, read_json),
}


@pytest.mark.parametrize("name", ["ecsv", "json"])
def test_origins_read_back(approach_observables, tmp_path, name):
    other = Origin("generic", "pinhole", "0.0.9", "bundled", (), ("lor_1.fit",))
    path = tmp_path / f"o.{name}"
    READERS[name][0](approach_observables, path, [ORIGIN, other])
    observables, origins = read_with_origins(path)
    assert origins == (ORIGIN, other)
    assert len(observables) == len(READERS[name][1](path)) == len(approach_observables)


@pytest.mark.parametrize("name", ["ecsv", "json"])
def test_files_of_older_and_newer_versions(approach_observables, tmp_path, name):
    write, read = READERS[name]
    path = tmp_path / f"o.{name}"
    write(approach_observables, path)
    if name == "json":
        new = json.loads(path.read_text())
        old = {k: v for k, v in new.items() if k in ("format", "fields", "observables")} | {"schema": 1}
        path.write_text(json.dumps(old))
        newer = json.dumps(new | {"format_version": 2})
    else:
        table = QTable.read(path)
        newer = path.read_text().replace("format_version: 1", "format_version: 2")
        table.meta.clear()
        table.write(path, overwrite=True)
    assert len(read(path)) == len(approach_observables)
    path.write_text(newer)
    with pytest.raises(Exception, match=r"format_version: 2 is newer than this program knows \(1\)"):
        read(path)


def test_conventions_tell_each_thing_once():
    assert CONVENTIONS["ra, dec"].endswith(ASTROMETRIC)
    assert ASTROMETRIC in CONVENTIONS["position"]

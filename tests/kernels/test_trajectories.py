"""Trajectories of scenarios, kind by kind: what SPICE reads from the kernels against independent states."""

import copy
import json
import subprocess
import sys
from datetime import UTC, datetime

import numpy as np
import pytest
import spiceypy

from opnav_workbench.constants import AU_KM, DAY_S
from opnav_workbench.errors import MissionError
from opnav_workbench.kernels import KernelSet, et_from_utc
from opnav_workbench.kernels.making import trajectories
from opnav_workbench.kernels.making.forces import planet_ephemeris
from opnav_workbench.kernels.making.make import make_kernels
from opnav_workbench.kernels.writing import SpkSegment

SUN_GM = 132712440041.27942
COMET, ROCK = 1000999, 3999999
PARTS = {
    "mission": "rock_probe", "name": "arcs",
    "span": {"start": "2031-03-01T00:00:00", "end": "2031-03-11T00:00:00"},
    "spacecraft": {"name": "PROBE", "id": -999, "frame": {"name": "RP_BUS", "id": -999000}},
    "clock": {"id": -999, "start": "2031-01-01T00:00:00"},
    "instruments": [
        {
            "name": "RP_NAVCAM", "id": -999100, "frame": "RP_BUS", "focal_length_mm": 100.0,
            "pixel_size_um": 10.0, "n_pixel": 1000, "n_line": 800,
        }
    ],
    "bodies": [
        {"name": "ROCK", "id": ROCK, "source": "made up", "gm_km3_s2": 5e-3, "radii_km": [9.0, 8.0, 7.0]},
        {"name": "COMET", "id": COMET, "source": "made up"},
    ],
    "pointing": {
        "instrument": "RP_NAVCAM",
        "windows": [{"start": "2031-03-01T00:00:00", "end": "2031-03-01T01:00:00", "ra_deg": 1.0, "dec_deg": 2.0}],
    },
}  # fmt: skip
PROBE = {
    "kind": "propagated", "target": "PROBE", "center": 0, "source": "made up", "epoch": "2031-03-05T00:00:00",
    "state": [2.1e8, 1.3e8, 6e7, -15.0, 18.0, 7.0],
}  # fmt: skip
ELEMENTS = {
    "kind": "elements", "target": "ROCK", "source": "made up", "epoch": "2031-03-05T00:00:00",
    "semi_major_axis_au": 1.3, "eccentricity": 0.2, "inclination_deg": 6.0, "node_deg": 80.0, "argument_deg": 66.0,
    "mean_anomaly_deg": 100.0, "propagation": "two_body",
}  # fmt: skip


def scenario(*trajectories: dict) -> dict:
    """A scenario with these trajectories, and a probe if they have none."""
    own = [] if any(t["target"] in ("PROBE", -999) for t in trajectories) else [PROBE]
    return copy.deepcopy(PARTS) | {"trajectories": [*trajectories, *own]}


def epochs(n: int = 300) -> np.ndarray:
    """Times at random within the span; needs an LSK."""
    start, end = et_from_utc("2031-03-01T00:00:00"), et_from_utc("2031-03-11T00:00:00")
    return np.sort(np.random.default_rng(3).uniform(start, end, n))


def read(target: int, center: int, et: np.ndarray, frame: str = "J2000") -> np.ndarray:
    return np.array([spiceypy.spkgeo(target, t, frame, center)[0] for t in et])


def tdb(text: str) -> float:
    return (datetime.fromisoformat(f"{text}+00:00") - datetime(2000, 1, 1, 12, tzinfo=UTC)).total_seconds()


# ---- tables

STATES = [[-7000.0, 10.0, 20.0, 1.5, 0.25, -0.125], [57800.0, 10810.0, -5380.0, 1.5, 0.25, -0.125],
          [122600.0, 21610.0, -10780.0, 1.5, 0.25, -0.125]]  # fmt: skip
DAYS = ["2031-02-28T12:00:00", "2031-03-01T00:00:00", "2031-03-01T12:00:00"]


def table(tmp_path, text: str, **changes) -> dict:
    (tmp_path / "rock.csv").write_text(text)
    return {
        "kind": "table",
        "target": "ROCK",
        "center": 10,
        "source": "made up",
        "file": "rock.csv",
    } | changes


def build(tmp_path, *trajectories: dict):
    path = tmp_path / "scenario.yaml"
    path.write_text(json.dumps(scenario(*trajectories)))  # JSON is YAML
    return make_kernels(path, tmp_path / "kernels")


def csv_text(header: str, first: list[str], factor: tuple[float, float] = (1.0, 1.0)) -> str:
    rows = [
        ",".join([e, *(repr(v / factor[i // 3]) for i, v in enumerate(s))])
        for e, s in zip(first, STATES, strict=True)
    ]
    return "\n".join(["# made up", header, "", *rows]) + "\n"


@pytest.mark.slow(
    keep=[
        "JD_TDB, x_au, y_au, z_au, vx_au_d, vy_au_d, vz_au_d-first2-factor2-0.0",
        "jd_tdb,x_au,y_au,z_au,vx_km_s,vy_km_s,vz_km_s-first3-factor3-0.0",
    ]
)
@pytest.mark.parametrize(
    ("header", "first", "factor", "offset_s"),
    [
        ("tdb,x_km,y_km,z_km,vx_km_s,vy_km_s,vz_km_s", DAYS, (1.0, 1.0), 0.0),
        ("utc,x_km,y_km,z_km,vx_km_s,vy_km_s,vz_km_s", [d + "Z" for d in DAYS], (1.0, 1.0), 69.184),
        ("JD_TDB, x_au, y_au, z_au, vx_au_d, vy_au_d, vz_au_d", ["2462926.0", "2462926.5", "2462927.0000000000"],
         (AU_KM, AU_KM / DAY_S), 0.0),
        ("jd_tdb,x_au,y_au,z_au,vx_km_s,vy_km_s,vz_km_s", ["2462926", "2462926.5", "2462927"], (AU_KM, 1.0), 0.0),
        ("et_s,x_km,y_km,z_km,vx_km_s,vy_km_s,vz_km_s", ["983318400", "983361600.0", "9.8340480e8"], (1.0, 1.0), 0.0),
    ],
)  # fmt: skip
def test_table_beside_the_scenario(tmp_path, header, first, factor, offset_s):
    with KernelSet(build(tmp_path, table(tmp_path, csv_text(header, first, factor)))):
        et = [tdb(d) + offset_s for d in DAYS]
        if offset_s:  # UTC is not TDB by a millisecond or two
            assert spiceypy.spkcov(str(tmp_path / "kernels" / "arcs_bodies.bsp"), ROCK)[0] == pytest.approx(
                et[0], abs=0.002
            )
            et = [et_from_utc(d) for d in DAYS]
        assert np.abs(read(ROCK, 10, np.array(et)) - STATES)[:, :3].max() < 1e-6  # nodes
        between = read(ROCK, 10, np.array([et[0] + 1000.0]))[0]
        assert between[:3] == pytest.approx(np.add(STATES[0][:3], 1000.0 * np.array(STATES[0][3:])), abs=1e-6)


def test_one_table_for_several_bodies(tmp_path):
    header = "body,tdb,x_km,y_km,z_km,vx_km_s,vy_km_s,vz_km_s,note\n"
    rows = [
        f"{b},{d},{s * 1000},0,0,0,0,0,x\n"
        for d in DAYS
        for b, s in (("rock", 1), ("COMET", 2), (str(ROCK + 1), 9))
    ]
    text = table(tmp_path, header + "".join(rows))
    with KernelSet(build(tmp_path, text, text | {"target": "COMET"})):
        at = np.array([tdb("2031-03-01T01:00:00")])
        assert [read(b, 10, at)[0, 0] for b in (ROCK, COMET)] == pytest.approx([1000.0, 2000.0])


HEADER = "tdb,x_km,y_km,z_km,vx_km_s,vy_km_s,vz_km_s"
ROW = "2031-03-01T00:00:00,1,2,3,4,5,6"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "columns are none; needed are one of tdb, utc"),
        ("tdb,x_km,y_km\n", "columns are tdb, x_km, y_km; needed"),
        (f"{HEADER},utc\n{ROW},2031-03-01\n", "needed are one of tdb"),
        (f"{HEADER}\n{ROW}\n{ROW}\n", "line 3: the epoch is not after"),
        (f"{HEADER}\n{ROW}\n", "1 states of .*ROCK.*; two are needed"),
        (f"{HEADER}\n{ROW},7\n", "line 2: 8 fields, 7 columns"),
        (f"{HEADER}\n# x\n\n2031-03-01T00:00:00,1,2,3,4,5,x\n", "line 4: could not convert"),
        (f"{HEADER}\n2031-03-01T00:00:00,1,2,3,4,5,nan\n", "line 2: a number is not finite"),
        (f"{HEADER}\nyesterday,1,2,3,4,5,6\n", "line 2: Invalid isoformat"),
        (f"{HEADER}\n2031-03-01T00:00:00Z,1,2,3,4,5,6\n", "line 2: .* TDB epoch has no time zone"),
    ],
)  # fmt: skip
def test_tables_that_are_wrong(tmp_path, text, message):
    with pytest.raises(MissionError, match=rf"trajectories.0 \(ROCK\): rock.csv.*{message}") as caught:
        build(tmp_path, table(tmp_path, text))
    assert "\n" not in str(caught.value)
    assert not list((tmp_path / "kernels").iterdir())


@pytest.mark.parametrize("name", ["../rock.csv", "/etc/hosts", "a/../../rock.csv", ""])
def test_tables_stay_beside_the_scenario(tmp_path, name):
    with pytest.raises(
        MissionError, match=r"trajectories.0.file: .* not a path inside the scenario's folder"
    ):
        build(tmp_path, table(tmp_path, "", file=name))


def test_table_behind_a_link_out_of_the_folder(tmp_path):
    folder = tmp_path / "here"
    folder.mkdir()
    trajectory = table(tmp_path, csv_text(HEADER, DAYS))
    (folder / "rock.csv").symlink_to(tmp_path / "rock.csv")
    with pytest.raises(MissionError, match=r"points outside"):
        build(folder, trajectory)


def test_table_that_is_not_there(tmp_path):
    with pytest.raises(
        MissionError, match=r"trajectories.0 \(ROCK\): other.csv cannot be read: .*No such file"
    ):
        build(tmp_path, table(tmp_path, "", file="other.csv"))


def test_table_serves_its_arc_only(tmp_path):
    arc = {"start": "2031-02-28T18:00:00", "end": "2031-03-01T06:00:00"}
    metakernel = build(tmp_path, table(tmp_path, csv_text(HEADER, DAYS), **arc))
    window = spiceypy.spkcov(str(metakernel.parent / "arcs_bodies.bsp"), ROCK)
    with KernelSet(metakernel):
        assert list(window)[:2] == [et_from_utc(arc["start"]), et_from_utc(arc["end"])]


# ---- the planetary ephemeris


def test_ephemeris_is_cut_out_without_loss(tmp_path):
    bodies = [{"kind": "ephemeris", "target": b} for b in ("EARTH", "SUN", 301, "JUPITER BARYCENTER", 199)]
    metakernel = make_kernels(scenario(*bodies), tmp_path)
    pairs = [(399, 0), (399, 3), (10, 0), (301, 399), (5, 0), (199, 10), (3, 0)]
    with KernelSet(metakernel):
        et = epochs(50)
        ours = [read(*p, et) for p in pairs]
        with pytest.raises(spiceypy.SpiceyError):
            spiceypy.spkgeo(4, et[0], "J2000", 0)
    with KernelSet(planet_ephemeris()):
        theirs = [read(*p, et) for p in pairs]
    assert np.array_equal(ours, theirs)
    assert (tmp_path / "arcs_bodies.bsp").stat().st_size < 50_000


@pytest.mark.parametrize("spk_type", [13, 9])
def test_ephemeris_about_another_center_is_sampled(tmp_path, spk_type):
    moon = {"kind": "ephemeris", "target": 301, "center": "SUN", "frame": "ECLIPJ2000", "spk_type": spk_type}
    metakernel = make_kernels(scenario(moon), tmp_path)
    segment_type = spiceypy.dafus(_first_summary(tmp_path / "arcs_bodies.bsp"), 2, 6)[1][3]
    assert segment_type == spk_type
    with KernelSet(metakernel):
        et = epochs()
        ours = read(301, 10, et)
    with KernelSet(planet_ephemeris()):
        theirs = read(301, 10, et)
    assert np.linalg.norm((ours - theirs)[:, :3], axis=1).max() < 1e-3  # 1 m
    assert np.linalg.norm((ours - theirs)[:, 3:], axis=1).max() < 1e-7


def _first_summary(path) -> np.ndarray:
    handle = spiceypy.dafopr(str(path))
    spiceypy.dafbfs(handle)
    spiceypy.daffna()
    summary = spiceypy.dafgs(5)
    spiceypy.dafcls(handle)
    return summary


def test_ephemeris_of_another_file(tmp_path):
    first = make_kernels(scenario(ELEMENTS), tmp_path / "first")
    other = {"kind": "ephemeris", "target": "ROCK", "file": str(first.parent / "arcs_bodies.bsp")}
    sun = {"kind": "ephemeris", "target": "SUN"}
    with pytest.raises(
        MissionError, match=r"trajectories.1 \(ROCK\): arcs_bodies.bsp does not hold the body 10"
    ):
        make_kernels(scenario(sun, other), tmp_path / "second")
    about_sun = make_kernels(scenario(sun, other | {"center": "SUN"}), tmp_path / "third")
    with KernelSet(first):
        et = epochs(50)
        truth = read(ROCK, 10, et)
    with KernelSet(about_sun):
        assert np.abs(read(ROCK, 10, et) - truth)[:, :3].max() < 1e-3


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"target": "COMET"}, r"\(COMET\): de440.bsp does not hold the body 1000999; it holds \[1, 2"),
        ({"file": "nothing.bsp"}, r"\(SUN\): file: .*nothing.bsp is not there"),
        ({"end": "2700-01-01T00:00:00"}, r"\(SUN\): de440.bsp covers the body 10 from .* to .*, not all of"),
        ({"target": "COMET", "center": "SUN"}, r"\(COMET\): .*1000999"),
    ],
)
def test_ephemerides_that_cannot_be_had(tmp_path, changes, message):
    with pytest.raises(MissionError, match=rf"trajectories.0 {message}"):
        make_kernels(scenario({"kind": "ephemeris", "target": "SUN"} | changes), tmp_path)
    assert not list(tmp_path.iterdir())


# ---- orbits


def conic(rows: dict, gm: float = SUN_GM) -> list[float]:
    angles = np.radians(
        [rows[k] for k in ("inclination_deg", "node_deg", "argument_deg", "mean_anomaly_deg")]
    )
    q = rows["semi_major_axis_au"] * (1 - rows["eccentricity"]) * AU_KM
    return [q, rows["eccentricity"], *angles, tdb(rows["epoch"]), gm]


@pytest.mark.parametrize("spk_type", [13, 9])
def test_two_body_elements_in_the_ecliptic(tmp_path, spk_type):
    with KernelSet(make_kernels(scenario(ELEMENTS | {"spk_type": spk_type}), tmp_path)):
        et = epochs()
        truth = np.array([spiceypy.conics(conic(ELEMENTS), t) for t in et])
        error = read(ROCK, 10, et, "ECLIPJ2000") - truth
    assert np.linalg.norm(error[:, :3], axis=1).max() < 1e-3
    assert np.linalg.norm(error[:, 3:], axis=1).max() < 1e-7


def test_the_same_elements_in_other_words(tmp_path):
    period_s = 2 * np.pi * np.sqrt((1.3 * AU_KM) ** 3 / SUN_GM)
    other = {k: v for k, v in ELEMENTS.items() if k not in ("semi_major_axis_au", "mean_anomaly_deg")}
    other |= {
        "perihelion_au": 1.3 * 0.8,
        "epoch": 2462931.5,  # 2031-03-06
        "perihelion_time": 2462930.5 - period_s / DAY_S * 100.0 / 360.0,
    }
    places = []
    for n, elements in enumerate((ELEMENTS, other)):
        with KernelSet(make_kernels(scenario(elements), tmp_path / str(n))):
            places.append(read(ROCK, 10, epochs(5))[:, :3])
    assert np.linalg.norm(places[0] - places[1], axis=1).max() < 2.0  # a Julian date keeps 4e-5 s: 1 km


def test_parabola_and_hyperbola_from_the_time_of_perihelion(tmp_path):
    """Barker's equation, and Kepler's hyperbolic one; distances against the closed forms."""
    for e in (1.0, 1.2):
        orbit = {k: v for k, v in ELEMENTS.items() if k not in ("semi_major_axis_au", "mean_anomaly_deg")}
        orbit |= {
            "eccentricity": e,
            "perihelion_au": 0.9,
            "perihelion_time": "2030-12-05T00:00:00",
            "target": "COMET",
        }
        with KernelSet(make_kernels(scenario(orbit), tmp_path / str(e))):
            et = epochs(20)
            r = np.linalg.norm(read(COMET, 10, et)[:, :3], axis=1)
            after_s = et - tdb("2030-12-05T00:00:00")
        q = 0.9 * AU_KM
        if e == 1.0:
            d = np.sqrt(r / q - 1.0)  # tan(half the true anomaly)
            expected_s = np.sqrt(2.0 * q**3 / SUN_GM) * (d + d**3 / 3.0)
        else:
            a = q / (e - 1.0)
            f = np.arccosh((r / a + 1.0) / e)
            expected_s = np.sqrt(a**3 / SUN_GM) * (e * np.sinh(f) - f)
        assert expected_s == pytest.approx(after_s, abs=1e-3)


def test_elements_are_propagated_by_default(tmp_path):
    """Osculating: the propagated orbit touches the ellipse at its epoch, and leaves it as planets pull."""
    orbit = {k: v for k, v in ELEMENTS.items() if k != "propagation"}
    with KernelSet(make_kernels(scenario(orbit), tmp_path)):
        at = tdb(ELEMENTS["epoch"])
        et = at + np.array([0.0, 5.0]) * DAY_S
        truth = np.array([spiceypy.conics(conic(ELEMENTS), t) for t in et])
        apart_km = np.linalg.norm((read(ROCK, 10, et, "ECLIPJ2000") - truth)[:, :3], axis=1)
    assert apart_km[0] < 1e-3
    assert 0.5 < apart_km[1] < 100.0


@pytest.mark.parametrize("spk_type", [13, 9])
def test_propagated_mars_is_mars(tmp_path, spk_type):
    """The Mars system as spacecraft, from its DE440 state, through scenario, integration, SPK and SPICE."""
    with KernelSet(planet_ephemeris()):
        state = spiceypy.spkgeo(4, tdb("2031-03-05T00:00:00"), "ECLIPJ2000", 10)[0]
    rock = PROBE | {
        "target": "PROBE", "center": "SUN", "frame": "ECLIPJ2000", "state": state.tolist(), "spk_type": spk_type,
        "perturbers": ["SUN", "MERCURY", "VENUS BARYCENTER", "EARTH", "MOON", 5, 6, 7, 8],
    }  # fmt: skip
    sun = {"kind": "ephemeris", "target": "SUN"}
    with KernelSet(make_kernels(scenario(sun, rock), tmp_path)):
        et = epochs()
        ours = read(-999, 10, et)
    with KernelSet(planet_ephemeris()):
        theirs = read(4, 10, et)
    assert np.linalg.norm((ours - theirs)[:, :3], axis=1).max() < 1e-3  # 1 m
    assert np.linalg.norm((ours - theirs)[:, 3:], axis=1).max() < 1e-7


def test_state_in_au_at_a_julian_date(tmp_path):
    state = [*(v / AU_KM for v in PROBE["state"][:3]), *(v / AU_KM * DAY_S for v in PROBE["state"][3:])]
    places = []
    for n, probe in enumerate((PROBE, PROBE | {"state": state, "units": "au", "epoch": 2462930.5})):
        with KernelSet(make_kernels(scenario(probe), tmp_path / str(n))):
            places.append(read(-999, 0, epochs(5))[:, :3])
    assert np.linalg.norm(places[0] - places[1], axis=1).max() < 1e-5


def test_maneuvers_make_arcs_that_meet(tmp_path):
    burn = {"epoch": "2031-03-07T00:00:00", "delta_v_m_s": [10.0, -20.0, 5.0]}
    metakernel = make_kernels(scenario(PROBE | {"maneuvers": [burn]}), tmp_path)
    plain = make_kernels(scenario(PROBE), tmp_path / "plain")
    with KernelSet(metakernel):
        at = et_from_utc(burn["epoch"])
        before, after = read(-999, 0, np.array([at - 1.0, at + 1.0]))
        later = read(-999, 0, np.array([at + DAY_S]))[0]
        first = read(-999, 0, np.array([at - 2 * DAY_S]))[0]
    with KernelSet(plain):
        unburnt = read(-999, 0, np.array([at + DAY_S]))[0]
        assert read(-999, 0, np.array([at - 2 * DAY_S]))[0][:3] == pytest.approx(first[:3], abs=1e-3)
    assert after[3:] - before[3:] == pytest.approx([0.01, -0.02, 0.005], abs=1e-4)  # 2 s of gravity
    assert after[:3] - before[:3] == pytest.approx(before[3:] + after[3:], abs=1e-4)
    assert later[:3] - unburnt[:3] == pytest.approx([864.0, -1728.0, 432.0], abs=0.5)


def test_two_arcs_of_one_body(tmp_path):
    early = PROBE | {"end": "2031-03-06T00:00:00"}
    late = PROBE | {"start": "2031-03-06T00:00:00", "state": [2.2e8, 1.3e8, 6e7, -15.0, 18.0, 7.0]}
    with KernelSet(make_kernels(scenario(early, late), tmp_path)):
        cut = et_from_utc("2031-03-06T00:00:00")
        before, after = read(-999, 0, np.array([cut - 0.1, cut + 0.1]))
        assert (after - before)[0] == pytest.approx(1e7, abs=1e4)


@pytest.mark.slow
def test_orbit_about_a_body_of_the_scenario(tmp_path):
    """An orbit of 60 km about a rock that is itself propagated: two bodies, but for a tide of the Sun."""
    rock = {k: v for k, v in ELEMENTS.items() if k != "propagation"}
    speed = np.sqrt(5e-3 / 60.0)
    probe = PROBE | {
        "center": "ROCK", "state": [60.0, 0.0, 0.0, 0.0, speed * 0.8, speed * 0.6],
        "perturbers": ["SUN", "EARTH", "ROCK"],
    }  # fmt: skip
    with KernelSet(make_kernels(scenario(rock, probe), tmp_path)):
        et = epochs()
        r = np.linalg.norm(read(-999, ROCK, et)[:, :3], axis=1)
        elements = spiceypy.oscelt(read(-999, ROCK, et[:1])[0], et[0], 5e-3)
        truth = np.array([spiceypy.conics(elements, t) for t in et])
        apart_km = np.linalg.norm((read(-999, ROCK, et) - truth)[:, :3], axis=1)
    assert 59.9 < r.min() <= r.max() < 60.1
    assert apart_km.max() < 0.2  # GM_sun / R^3 over GM_rock / r^3 is 2e-6


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"perturbers": ["SUN", "COMET"]}, "the perturber COMET has no gm_km3_s2"),
        ({"epoch": "2700-01-01T00:00:00"}, "outside the loaded SPKs of SUN"),
        ({"state": [0.0, 1.5e6, 0.0, 0.0, -10.0, 0.0]}, "runs into body 10: .* km from its center"),
        ({"frame": "NOWHERE"}, "frame NOWHERE"),
        ({"center": "COMET"}, "COMET"),
    ],
)
def test_propagation_that_cannot_be(tmp_path, changes, message):
    with pytest.raises(MissionError, match=rf"trajectories.0 \(PROBE\): .*{message}") as caught:
        make_kernels(scenario(PROBE | changes), tmp_path)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("trajectory", "message"),
    [
        (PROBE | {"state": [1, 2, 3]}, "trajectories.0.state"),
        (PROBE | {"epoch": 5.0}, "trajectories.0.epoch"),
        (PROBE | {"perturbers": ["VULCAN"]}, "trajectories.0.perturbers.0: 'VULCAN' is not a body"),
        (PROBE | {"radiation": {"area_m2": -1.0, "mass_kg": 1.0}}, "trajectories.0.radiation.area_m2"),
        (PROBE | {"tolerance": 1.0}, "trajectories.0.tolerance"),
        (
            PROBE
            | {"maneuvers": [{"epoch": f"2031-03-0{d}T00:00:00", "delta_v_m_s": [0, 0, 1]} for d in (7, 6)]},
            "trajectories.0: maneuvers.1.epoch: 2031-03-06T00:00:00 is not after 2031-03-07",
        ),
        (
            PROBE | {"start": "2031-03-07T00:00:00", "end": "2031-03-06T00:00:00"},
            "trajectories.0: end .* is not after",
        ),
        (
            ELEMENTS | {"perihelion_au": 1.0},
            "trajectories.0: give either perihelion_au or semi_major_axis_au",
        ),
        (
            ELEMENTS | {"mean_anomaly_deg": None},
            "trajectories.0: give either mean_anomaly_deg or perihelion_time",
        ),
        (ELEMENTS | {"eccentricity": 1.5}, "trajectories.0: an open orbit is given by"),
    ],
)
def test_wrong_fields_are_named(tmp_path, trajectory, message):
    with pytest.raises(MissionError, match=message) as caught:
        make_kernels(scenario(trajectory), tmp_path)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_motion_too_rough_for_a_table(monkeypatch):
    monkeypatch.setattr(trajectories, "MAX_STATES", 500)

    def rough(et):
        return np.column_stack([1e6 + np.floor(et), *(np.zeros(len(et)) for _ in range(5))])

    with pytest.raises(ValueError, match="does not follow this motion"):
        trajectories.sampled_segment(
            rough, (0.0, 1e6), lambda et, states: SpkSegment(-999, 0, et, states), 1e5
        )


# ---- through files


def test_states_in_a_new_process(tmp_path):
    metakernel = make_kernels(scenario({"kind": "ephemeris", "target": "SUN"}, ELEMENTS), tmp_path)
    code = (
        "import json, spiceypy; spiceypy.furnsh('arcs.tm');"
        "et = [spiceypy.str2et('2031-03-04') + 12345.678 * k for k in range(40)];"
        "print(json.dumps([[spiceypy.spkgeo(b, t, 'J2000', 0)[0].tolist() for t in et] for b in (-999, 3999999, 10)]))"
    )
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, cwd=metakernel.parent)
    with KernelSet(metakernel):
        et = et_from_utc("2031-03-04T00:00:00") + 12345.678 * np.arange(40)
        here = [read(b, 0, et) for b in (-999, ROCK, 10)]
    assert np.abs(np.array(json.loads(run.stdout)) - here).max() < 1e-6


def test_the_pool_is_as_it_was(tmp_path):
    with KernelSet(planet_ephemeris()):
        before = spiceypy.ktotal("ALL")
        make_kernels(scenario({"kind": "ephemeris", "target": "SUN"}), tmp_path)
        assert spiceypy.ktotal("ALL") == before
        with pytest.raises(MissionError):
            make_kernels(scenario(PROBE | {"epoch": "2700-01-01T00:00:00"}), tmp_path)
        assert spiceypy.ktotal("ALL") == before
        spiceypy.spkgeo(4, 0.0, "J2000", 0)

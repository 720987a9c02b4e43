"""A rolling shutter and a line scanner, from simulated pictures to an attitude; SPICE is asked for each line by itself."""

import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import spiceypy
import yaml
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from opnav_workbench.camera import Camera
from opnav_workbench.errors import KernelError
from opnav_workbench.kernels import KernelSet
from opnav_workbench.kernels.making.make import make_kernels
from opnav_workbench.kernels.writing import write_ck
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.scene import apparent_stars
from opnav_workbench.session import ImageSession, Settings
from opnav_workbench.simulation import load_picture_scenario, read_truth, simulate

SIZE, EXPOSURE_S = 512, 0.02
ROLLING = {"line_time_s": -1e-3}
SCANNER = {"line_time_s": 0.02, "detector_line": 255.5}
DARK = 1e-4  # of a body that does not saturate where stars are seen
PIXEL_DEG = np.degrees(5.5e-3 / 25.0)
FEW_STARS = Settings(mag_limit=9.0)
SHIFT_PX, TWIST_DEG = (6.0, -4.0), 0.5
# As of a larger lens: some hundred stars then tell the twist to 0.002 deg.
BRIGHT = {"bits": 16, "saturation_dn": 64000.0, "full_well_e": 2e5, "prnu": 0.0}
BRIGHTER_MAG = 3.0
CASES = {"rolling": (ROLLING, 0.25, [0.6, 0.8]), "scanner": (SCANNER, 50.0 * PIXEL_DEG, [0.0, 1.0])}


@dataclass(frozen=True)
class Case:
    """A mission of a camera with rows, its kernels and a picture of the Pleiades."""

    mission: Path
    kernels: Path
    picture: Path
    rows: dict


def make_case(folder: Path, name: str, flyby: list | None = None) -> Case:
    """Write mission, kernels and picture.

    `flyby`: states of a body with respect to the spacecraft, as a scenario of kernels has them.
    """
    rows, rate, direction = CASES[name]
    generic = kernels_meta_dir() / "generic"
    content = yaml.safe_load((generic / "cameras/cubesat.yaml").read_text())
    content["detector"] |= {
        "n_pixel": SIZE,
        "n_line": SIZE,
        "center_pixel_line": [255.5, 255.5],
        "rows": rows,
        **BRIGHT,
    }
    content["photometry"]["zero_point_mag"] += BRIGHTER_MAG
    content["optics"]["focal_from_camera"] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    (folder / "cameras").mkdir(parents=True)
    (folder / "cameras/rows.yaml").write_text(yaml.safe_dump(content))
    mission = yaml.safe_load((generic / "mission.yaml").read_text())
    mission["cameras"] = [{"file": "cameras/rows.yaml", "match": {}}]
    (folder / "mission.yaml").write_text(yaml.safe_dump(mission))
    plan = yaml.safe_load((generic / "star_fields.yaml").read_text())
    plan["instruments"][0] |= {"n_pixel": SIZE, "n_line": SIZE}
    plan["pointing"]["windows"] = [
        {
            "start": "2030-01-01T00:00:00", "end": "2030-01-01T00:01:00", "ra_deg": 56.75, "dec_deg": 24.12,
            "twist_deg": 30.0, "scan": {"rate_deg_s": float(rate), "direction": direction},
        }
    ]  # fmt: skip
    if flyby:
        plan["bodies"].append({"name": "ROCK", "id": 2999999, "source": "invented", "radii_km": [40, 40, 40]})
        plan["trajectories"].append(
            {
                "kind": "states",
                "target": "ROCK",
                "center": plan["spacecraft"]["name"],
                "source": "invented",
                "rows": flyby,
            }
        )
    (folder / "kernels.yaml").write_text(json.dumps(plan, default=lambda time: time.isoformat()))
    shutil.copy(generic / "manifest.yaml", folder)
    metakernel = make_kernels(folder / "kernels.yaml", folder / "kernels")
    targets = ["ROCK"] if flyby else []
    scenario = {
        "bodies": [{"name": n, "law": {"law": "lunar_lambert", "lunar_weight": 0.5}, "albedo": DARK} for n in targets],
        "mission": str(folder / "mission.yaml"), "kernels": str(metakernel), "catalog": "bundled",
        "magnitude_limit": 10.5, "seed": 5,
        "attitude": {
            "actual": {"source": "error", "shift_px": list(SHIFT_PX), "twist_deg": TWIST_DEG},
            "motion": {"from_kernels": True},
        },
        "pictures": [
            {"name": name, "utc": "2030-01-01T00:00:07", "camera": "rows", "exposure_s": EXPOSURE_S, "targets": targets}
        ],
    }  # fmt: skip
    (folder / "pictures.yaml").write_text(yaml.safe_dump(scenario))
    simulate(load_picture_scenario(folder / "pictures.yaml"), folder / "pictures")
    return Case(folder / "mission.yaml", metakernel, folder / f"pictures/{name}.fit", rows)


@pytest.fixture(scope="module", params=CASES)
def case(request, tmp_path_factory) -> Case:
    return make_case(tmp_path_factory.mktemp(request.param) / "mission", request.param)


def places_by_spice(case: Case, turned: np.ndarray, et: float, directions: np.ndarray) -> np.ndarray:
    """Return where J2000 directions fall, a CK's attitude asked at each line's own time; bisection, no derivative.

    `turned`: how the camera is mounted against the CK.
    """
    rest = replace(Camera.from_yaml(case.mission.parent / "cameras/rows.yaml"), rows=None)

    def place(line: float, direction: np.ndarray) -> np.ndarray:
        time = et + (line - 0.5 * (SIZE - 1)) * case.rows["line_time_s"]
        return rest.project(turned @ np.array(spiceypy.pxform("J2000", rest.frame, time)) @ direction)

    def off(line: float, direction: np.ndarray) -> float:
        return place(line, direction)[1] - case.rows.get("detector_line", line)

    with KernelSet(case.kernels):
        lines = [brentq(off, -40.0, SIZE + 40.0, (d,), xtol=1e-9) for d in directions]
        return np.array([[place(line, d)[0], line] for line, d in zip(lines, directions, strict=True)])


def apparent(session: ImageSession, ids) -> np.ndarray:
    """J2000 directions in which the spacecraft sees stars, without any camera."""
    stars = session.inputs.stars.take(np.array([list(session.inputs.stars.id).index(i) for i in ids]))
    return apparent_stars(stars, session.inputs.et, session.inputs.observer)


def turn_rad(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return Rotation.from_matrix(first @ second.T).as_rotvec()


@pytest.mark.slow
def test_the_scene_is_drawn_and_solved_with_each_line_at_its_time(case, tmp_path):
    truth = read_truth(case.picture)
    with KernelSet(case.kernels):
        session = ImageSession.open(case.picture, case.mission, settings=FEW_STARS)
        session.predict()
        session.find_stars()
        session.repoint()
        result = json.loads(session.to_json())
        session.save(tmp_path)
    mounted = truth.camera_from_j2000 @ truth.predicted_camera_from_j2000.T
    # drawn where SPICE's CK has the camera at the time of each star's own line
    table = truth.objects
    seen = table[(table["kind"] == "star") & table["on_detector"] & (table["mag"].value < 8.0)]
    drawn = np.column_stack([seen["pixel"].value, seen["line"].value])
    by_spice = places_by_spice(case, mounted, truth.et, apparent(session, list(seen["id"])))
    assert len(seen) > 8
    np.testing.assert_allclose(drawn, by_spice, atol=0.01)
    still = replace(session.context.camera, rows=None, sweep=None)
    at_rest = still.project(apparent(session, list(seen["id"])) @ truth.camera_from_j2000.T)
    assert np.abs(drawn - at_rest).max() > 3.0  # a frame camera would have them elsewhere
    # measured and solved
    assert result["status"] == "ok"
    assert result["pointing"]["n_stars"] >= 4
    pointing = session.state.pointing
    error = turn_rad(truth.camera_from_j2000, pointing.camera_from_j2000)
    assert np.sqrt(error @ np.linalg.solve(pointing.covariance_rad2, error)) < 4.0  # chance: 1 in 1000
    # a camera that is taken to scan along a path turned with it has half the twist
    assert np.degrees(np.sqrt(pointing.covariance_rad2[2, 2])) < 0.01
    assert pointing.excess_sigma_px < 0.03
    used = [star for star in result["stars"] if star["status"] == "used"]
    measured = np.array([star["observed"] for star in used])
    off = measured - places_by_spice(case, mounted, truth.et, apparent(session, [s["id"] for s in used]))
    assert np.abs(np.median(off, axis=0)).max() < 0.1
    # kept with the session: it resumes without kernels
    again = ImageSession.resume(tmp_path)
    assert again.context.camera.sweep is not None
    np.testing.assert_array_equal(again.state.pointing.camera_from_j2000, pointing.camera_from_j2000)


@pytest.mark.slow
def test_without_the_motion_a_frame_is_partial_and_a_scan_refused(case):
    if "detector_line" in case.rows:
        with pytest.raises(
            KernelError, match=r"is a line scan, and the camera's motion .*10\.22 s.* is not known"
        ):
            ImageSession.open(case.picture, case.mission, attitude="header")
        return
    session = ImageSession.open(case.picture, case.mission, attitude="header")
    words = "the camera's motion while its lines are exposed (0.511 s) is not known, and taken as none"
    assert words in str(session.inputs.contradictions)


def with_gap(case: Case, et: float, gap: tuple[float, float], to: Path) -> KernelSet:
    """Return the kernels with a CK that knows nothing in a part of the exposure; s from its middle."""
    others = [p for p in case.kernels.parent.iterdir() if p.suffix not in (".bc", ".tm")]
    half_s = 0.55 * SIZE * abs(case.rows["line_time_s"])
    times = et + np.concatenate([np.linspace(-half_s, gap[0], 9), np.linspace(gap[1], half_s, 9)])
    with KernelSet(case.kernels):
        structure = int(spiceypy.ckobj(str(next(case.kernels.parent.glob("*.bc"))))[0])
        frame = str(spiceypy.frmnam(spiceypy.ccifrm(3, structure)[0]))
        matrices = np.array([spiceypy.pxform("J2000", frame, time) for time in times])
        write_ck(to / "gap.bc", structure, structure // 1000, times, matrices, interval_starts=[9])
    return KernelSet([*others, to / "gap.bc"])


@pytest.mark.slow
def test_a_gap_of_the_ck_while_lines_are_exposed_is_told(case, tmp_path):
    span_s = SIZE * abs(case.rows["line_time_s"])
    with KernelSet(case.kernels):
        et = ImageSession.open(case.picture, case.mission).inputs.et
    # Between two of the attitudes that the motion is first interpolated from: nothing else would notice.
    with with_gap(case, et, (0.07 * span_s, 0.115 * span_s), tmp_path):
        session = ImageSession.open(case.picture, case.mission)
    (said,) = session.inputs.contradictions
    assert said.startswith(f"for {0.045 * span_s:.3g} of the ")
    assert session.context.camera.sweep is not None
    # Within a line there is nothing that it could have spoiled.
    line_s = abs(case.rows["line_time_s"])
    with with_gap(case, et, (0.08 * span_s, 0.08 * span_s + 0.9 * line_s), tmp_path):
        assert ImageSession.open(case.picture, case.mission).inputs.contradictions == ()
    # In the middle the a priori attitude itself is missing.
    with with_gap(case, et, (-0.1 * span_s, 0.1 * span_s), tmp_path):
        if "detector_line" in case.rows:
            with pytest.raises(
                KernelError, match=r"outside the loaded CKs .* load a CK that covers [^ ]+ UTC\. Loaded"
            ):
                ImageSession.open(case.picture, case.mission)
        else:
            said = str(ImageSession.open(case.picture, case.mission).inputs.contradictions)
            assert "is not known, and taken as none" in said


# ---- A body that passes.

MIDDLE_S = 76.184  # past 00:00:00 TDB, in which states are written: 00:00:07 UTC
PLACE_PX, RANGE_KM, SPEED_KM_S = (150.0, 90.0), 5000.0, 8.0


def make_flyby(folder: Path, name: str) -> Case:
    """A body of 73 px that flies across by some 20 px a second, far from the line whose time is the picture's."""
    first = make_case(folder / "first", name)
    with KernelSet(first.kernels):
        session = ImageSession.open(first.picture, first.mission)
        toward = session.inputs.a_priori_camera_from_j2000.T @ session.context.camera.unproject(PLACE_PX)
        across = session.inputs.a_priori_camera_from_j2000.T @ np.array([0.6, 0.8, 0.0])
    rows = []
    for minute in (-1, 0, 1, 2, 3):
        place = RANGE_KM * toward + SPEED_KM_S * (60.0 * minute - MIDDLE_S) * across
        time = f"2030-01-01T00:{minute:02d}:00" if minute >= 0 else "2029-12-31T23:59:00"
        rows.append([time, *place.tolist(), *(SPEED_KM_S * across).tolist()])
    return make_case(folder / "flyby", name, rows)


def center_by_spice(case: Case, turned: np.ndarray, et: float) -> np.ndarray:
    """Return where the body's center falls, body and CK asked at each line's own time."""
    rest = replace(Camera.from_yaml(case.mission.parent / "cameras/rows.yaml"), rows=None)

    def place(line: float) -> np.ndarray:
        time = et + (line - 0.5 * (SIZE - 1)) * case.rows["line_time_s"]
        seen, _ = spiceypy.spkezr("2999999", time, "J2000", "CN+S", "-999")
        return rest.project(turned @ np.array(spiceypy.pxform("J2000", rest.frame, time)) @ seen[:3])

    def off(line: float) -> float:
        return place(line)[1] - case.rows.get("detector_line", line)

    with KernelSet(case.kernels):
        line = brentq(off, -20.0, SIZE + 20.0, xtol=1e-9)
        return np.array([place(line)[0], line])


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_a_body_is_found_where_it_was_at_its_lines_time(name, tmp_path):
    case = make_flyby(tmp_path, name)
    truth = read_truth(case.picture)
    mounted = truth.camera_from_j2000 @ truth.predicted_camera_from_j2000.T
    by_spice = center_by_spice(case, mounted, truth.et)
    np.testing.assert_allclose(truth.bodies["ROCK"], by_spice, atol=0.01)
    with KernelSet(case.kernels):
        session = ImageSession.open(case.picture, case.mission, settings=FEW_STARS)
        session.predict()
        session.find_stars()
        session.repoint()
        session.find_body("ROCK")
        session.observables()
        (body,) = json.loads(session.to_json())["bodies"]
        session.save(tmp_path / "kept")
        at_middle = session.context.camera.project(
            session.camera_from_j2000 @ session.predict_body("ROCK").direction
        )
    assert np.hypot(*(at_middle - by_spice)) > 1.0  # as the stars move, without its own motion
    assert body["status"] == "ok"
    error = np.subtract(body["observed"], by_spice)
    assert np.sqrt(error @ np.linalg.solve(body["covariance_px2"], error)) < 4.0
    assert np.hypot(*error) < 0.3
    assert np.hypot(*np.subtract(body["predicted"], by_spice)) < 0.3
    # how it moved and turned meanwhile is kept: a session resumes without kernels
    kept = ImageSession.resume(tmp_path / "kept").inputs.targets["ROCK"]
    np.testing.assert_array_equal(kept.course_km, session.inputs.targets["ROCK"].course_km)
    assert np.ptp(kept.course_km, axis=0).max() > 1.0

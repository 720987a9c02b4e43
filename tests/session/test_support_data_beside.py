"""A picture without a header and without kernels, whose image support data lie beside it; and support data of others."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from opnav_workbench.camera.support_data import PlaceConvention, SupportData, read_support_data
from opnav_workbench.commissioning import Wanted, new_mission
from opnav_workbench.constants import SPEED_OF_LIGHT_KM_S
from opnav_workbench.errors import CameraError, KernelError
from opnav_workbench.geometry import apparent_direction, matrix_from_quaternion
from opnav_workbench.kernels import KernelSet, state
from opnav_workbench.mission import load_mission
from opnav_workbench.rehearsal import DEMO_KERNELS
from opnav_workbench.scene import body_target, observer_from_kernels
from opnav_workbench.session import ImageSession, support_data_of_result
from opnav_workbench.session.beside import ToldBeside, body_beside


@dataclass(frozen=True)
class Case:
    """A folder with ``frame.tif``, ``frame.json`` and the mission made from them, and what kernels make of the picture."""

    folder: Path
    with_kernels: ImageSession

    def told(self) -> dict:
        return json.loads((self.folder / "frame.json").read_text())


@pytest.fixture(scope="module")
def case(demo_truths, tmp_path_factory) -> Case:
    folder = tmp_path_factory.mktemp("beside")
    with KernelSet(DEMO_KERNELS):
        session = ImageSession.open(demo_truths[0].picture, "new_horizons")
        session.predict()
        session.find_stars()
        session.repoint()
        session.find_body("PLUTO")
        told = support_data_of_result(session.result(), load_mission("new_horizons"), "PLUTO")
    (folder / "frame.json").write_text(json.dumps(told))
    counts = np.nan_to_num(session.context.picture.image_dn)
    Image.fromarray((counts - counts.min()).round().astype(np.uint16)).save(folder / "frame.tif")
    wanted = Wanted(
        "mapped", folder / "mapped", folder / "frame.tif", compare=False, support_data=folder / "frame.json"
    )
    new_mission(wanted)
    return Case(folder, session)


def opened(case: Case, told: dict | None = None, name: str = "other") -> ImageSession:
    """Open the picture with other support data beside it."""
    if told is None:
        return ImageSession.open(case.folder / "frame.tif", case.folder / "mapped")
    (case.folder / f"{name}.tif").write_bytes((case.folder / "frame.tif").read_bytes())
    (case.folder / f"{name}.json").write_text(json.dumps(told))
    return ImageSession.open(case.folder / f"{name}.tif", case.folder / "mapped")


@pytest.mark.slow
def test_picture_and_support_data_are_solved_as_with_kernels(case):
    """Two files, no kernels and no exposure: attitude, spacecraft, Sun and body are where the kernels have them."""
    session = opened(case)
    assert session.inputs.attitude_source == session.inputs.observer.source == "header"
    with KernelSet(DEMO_KERNELS):
        observer = observer_from_kernels(-98, session.inputs.et)
    assert np.linalg.norm(session.inputs.observer.velocity_km_s - observer.velocity_km_s) < 1e-3
    session.predict()
    session.find_stars()
    session.repoint()
    session.find_body("PLUTO")
    ours, theirs = (s.result() for s in (session, case.with_kernels))
    assert ours["status"] == "ok"
    turn = matrix_from_quaternion(ours["pointing"]["quaternion_camera_from_j2000"]).T @ np.array(
        [0.0, 0.0, 1.0]
    )
    sky = case.with_kernels.context.camera.boresight
    kept = matrix_from_quaternion(theirs["pointing"]["quaternion_camera_from_j2000"]).T @ sky
    pixel_rad = session.context.camera.pixel_scale_rad
    assert np.degrees(np.arccos(np.clip(turn @ kept, -1.0, 1.0))) < np.degrees(0.1 * pixel_rad)
    assert ours["bodies"][0]["predicted"] == pytest.approx(theirs["bodies"][0]["predicted"], abs=0.1)
    assert ours["bodies"][0]["diameter_px"] == pytest.approx(theirs["bodies"][0]["diameter_px"], rel=1e-4)
    assert ours["bodies"][0]["observed"] == pytest.approx(theirs["bodies"][0]["observed"], abs=0.3)
    assert "attitude and the spacecraft's state by frame.json" in " ".join(ours["provenance"]["image_notes"])


def test_without_the_sun_s_velocity_the_spacecraft_s_is_not_known(case):
    told = case.told()
    told["sun_position"].pop("velocities")
    observer = opened(case, told).inputs.observer
    assert observer.velocity_sigma_km_s > 1.0


def test_support_data_of_another_picture_contradict(case):
    """A body of that name would be elsewhere: the picture is none of theirs, and says so."""
    told = case.told()
    camera = told | {
        "focal_length_model": {"focal_length": 1.05 * told["focal_length_model"]["focal_length"]}
    }
    with pytest.raises(Exception, match=r"describes another camera, [0-9.]+ px apart; it is not used"):
        opened(case, camera)


def test_what_is_no_frame_camera_is_told_and_other_json_left_alone(case, demo_truths, tmp_path):
    lorri = tmp_path / "a.fit"
    lorri.write_bytes(demo_truths[0].picture.read_bytes())
    with KernelSet(DEMO_KERNELS):
        plain = ImageSession.open(lorri, "new_horizons").context.picture.messages
    scanner = case.told() | {"name_model": "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL"}
    for beside, said in ((scanner, ["only frame cameras"]), ({"note": "mine"}, [])):
        (tmp_path / "a.json").write_text(json.dumps(beside))
        with KernelSet(DEMO_KERNELS):
            session = ImageSession.open(lorri, "new_horizons")
        more = session.context.picture.messages[len(plain) :]
        assert [words in line for words, line in zip(said, more, strict=True)] == [True] * len(said)
        assert session.context.beside is None
    (tmp_path / "a.json").write_text("{")
    with KernelSet(DEMO_KERNELS):
        assert ImageSession.open(lorri, "new_horizons").context.beside is None


def test_another_time_contradicts_and_another_name_is_not_their_body(case, demo_truths, tmp_path):
    """Of a picture with a header of its own, whose time and target are known."""
    lorri = tmp_path / "a.fit"
    lorri.write_bytes(demo_truths[0].picture.read_bytes())
    told = case.told()
    (tmp_path / "a.json").write_text(
        json.dumps(told | {"center_ephemeris_time": told["center_ephemeris_time"] + 60.0})
    )
    session = ImageSession.open(lorri, "new_horizons", attitude="header")
    assert any("a.json is of another time, +60.000 s" in said for said in session.inputs.contradictions)
    (tmp_path / "a.json").write_text(json.dumps(told))
    session = ImageSession.open(lorri, "new_horizons", attitude="header")
    session.add_target("PLUTO")
    with pytest.raises(KernelError, match="no kernels are loaded"):
        session.add_target("CHARON")


def test_support_data_of_another_size_make_no_mission_for_a_picture(case, tmp_path):
    small = tmp_path / "small.tif"
    Image.fromarray(np.zeros((8, 8), np.uint16)).save(small)
    with pytest.raises(
        CameraError, match=r"frame.json is of a picture of \d+ x \d+ pixels, and this one has 8 x 8"
    ):
        new_mission(Wanted("small", tmp_path / "m", small, support_data=case.folder / "frame.json"))


# ---- The places that support data have, corrected in four ways.

CRAFT_KM_S, BODY_KM_S = np.array([-9.0, 21.0, 4.0]), np.array([3.0, -17.0, 8.0])
CONVENTIONS = [
    PlaceConvention(craft_observes, light_time, aberration, to_surface)
    for craft_observes in (False, True)
    for light_time, aberration, to_surface in (
        (True, True, False), (True, False, False), (True, False, True), (False, False, False)
    )
]  # fmt: skip


def written(places: PlaceConvention, away_km: np.ndarray, radius_km: float) -> SupportData:
    """Two bodies that fly straight, in a convention; the craft stands where it says from where the body was when seen."""
    seconds = np.linalg.norm(away_km) / SPEED_OF_LIGHT_KM_S
    delay = (seconds - radius_km / SPEED_OF_LIGHT_KM_S * places.to_surface) * places.light_time
    body_km, craft_km = seconds * BODY_KM_S, np.array(away_km)  # now, from where the body was then
    if places.craft_observes:
        place = craft_km - (body_km - delay * BODY_KM_S)
    else:
        place = craft_km - delay * CRAFT_KM_S - body_km
    if places.aberration:
        observer, sign = (CRAFT_KM_S, -1.0) if places.craft_observes else (BODY_KM_S, 1.0)
        place = sign * apparent_direction(sign * place, observer) * np.linalg.norm(place)
    sun_km = np.array([4.0e8, -7.0e8, 2.0e8])
    return SupportData(
        camera=load_mission("generic").cameras[0],
        et=0.0,
        camera_from_j2000=np.eye(3),
        position_km=place,
        velocity_km_s=CRAFT_KM_S - BODY_KM_S,
        sun_position_km=apparent_direction(sun_km, BODY_KM_S) * np.linalg.norm(sun_km),
        sun_velocity_km_s=-BODY_KM_S,
        radii_km=np.array([radius_km, radius_km]),
        places=places,
    )


@pytest.mark.parametrize("places", CONVENTIONS, ids=str)
def test_the_body_stands_where_it_was_in_every_convention(places):
    """Light time 1.4 s, on the way of which both move by 30 km; the radius takes 0.2 s."""
    away = np.array([1.9e5, -2.8e5, 2.5e5])
    told = ToldBeside("a.json", written(places, away, 6.0e4))
    target = body_beside(told, "BODY", CRAFT_KM_S)
    assert np.linalg.norm(target.position_km + away) < 0.02
    assert np.linalg.norm(target.sun_position_km - [4.0e8, -7.0e8, 2.0e8]) < 1.0
    # A velocity from the Sun that is off: the direction that the camera sees stays, the range has its sigma.
    off = np.array([2.0, -1.0, 1.5])
    other = body_beside(told, "BODY", CRAFT_KM_S + off, 2.0)
    seen, true = (
        apparent_direction(one.position_km, velocity)
        for one, velocity in ((other, CRAFT_KM_S + off), (target, CRAFT_KM_S))
    )
    across_rad = np.linalg.norm(np.cross(seen, true))
    assert across_rad < (2e-8 if places.aberration or not places.light_time else 1e-5)
    sight = away / np.linalg.norm(away)
    sigma_km = np.sqrt(max(sight @ other.covariance_km2 @ sight, 0.0))
    assert abs(other.range_km - target.range_km) < 2.0 * sigma_km + 0.02
    assert sigma_km < 6.0


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("isd", "folder", "mission", "body", "range_m", "sun_km"),
    [
        ("cassiniiss_isd", "N1702360370_1", "cassini", "ENCELADUS", 0.3, 60.0),
        ("dawnfc_isd", "FC21A0038582_15170161546F6F", "dawn", "CERES", 0.3, 60.0),
        ("hayabusa2_isd", "hyb2_onc_20151203_084458_w2f_l2a", "hayabusa2", "EARTH", 0.3, 60.0),
    ],
)
def test_flight_support_data_have_the_body_and_the_sun_where_kernels_do(
    data_dir, isd, folder, mission, body, range_m, sun_km
):
    """ALE's files; taken for what the spacecraft sees, the range was 20 m to 2.3 km off, and the Sun 15,000 to 48,000 km."""
    told = read_support_data(data_dir / f"spice/instruments/isds/{isd}.json")
    inside = (data_dir / "spice/slices" / folder).iterdir()
    generic = [data_dir / "spice/generic" / name for name in ("naif0012.tls", "pck00011.tpc")]
    craft = load_mission(mission).spacecraft_id
    files = [p for p in inside if p.suffix in (".bsp", ".bc", ".ti", ".tf", ".tpc", ".tsc")]
    with KernelSet([*generic, *sorted(files)]):
        velocity = np.asarray(observer_from_kernels(craft, told.et).velocity_km_s)
        known = body_target(body, craft, told.et)
        from_sun = state(craft, told.et, "SUN").position_km
    target = body_beside(ToldBeside(isd, told), body, velocity)
    assert 1e3 * np.linalg.norm(target.position_km - known.position_km) < range_m
    away = target.position_km + target.sun_position_km  # the Sun's way while light came is left out: 13 m/s
    assert np.linalg.norm(away + from_sun) < sun_km + 30.0 * known.range_km / SPEED_OF_LIGHT_KM_S

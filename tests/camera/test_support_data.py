"""Community Sensor Model image support data: ours read back, and those of ALE against cameras from instrument kernels."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from opnav_workbench.camera import BrownDistortion, Camera, NoDistortion
from opnav_workbench.camera.support_data import PlaceConvention, SupportData, read_support_data, support_data
from opnav_workbench.errors import CameraError
from opnav_workbench.files import read_json, write_json
from opnav_workbench.geometry import rotation_from_vector
from opnav_workbench.kernels import KernelSet, camera_attitude, instrument_values, state
from opnav_workbench.mission import load_mission
from opnav_workbench.resources import kernels_meta_dir


def grid(camera):
    axes = (np.linspace(-0.5, size - 0.5, 15) for size in (camera.n_pixel, camera.n_line))
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)


def said(camera):
    """Support data of a camera that is turned somehow, somewhere."""
    return SupportData(
        camera=camera,
        et=4.0e8,
        camera_from_j2000=rotation_from_vector([0.3, -1.1, 0.7]),
        position_km=np.array([1.0e5, -2.0e4, 3.0e3]),
        velocity_km_s=np.array([1.0, 2.0, 3.0]),
        sun_position_km=np.array([1.0e8, 2.0e7, 0.0]),
        body_from_j2000=rotation_from_vector([0.1, 0.2, 0.3]),
        radii_km=np.array([482.0, 446.0]),
    )


@pytest.mark.parametrize(
    "name",
    [
        "new_horizons/cameras/lorri_1x1",
        "osiris_rex/cameras/mapcam",
        "hayabusa2/cameras/onc_w2",
        "near/cameras/msi",
    ],
)
def test_what_is_written_sees_the_sky_where_the_camera_does(tmp_path, name):
    """Mirrored detectors, boresights along -Z or +X, distortions of four kinds: one JSON, read again."""
    camera = Camera.from_yaml(kernels_meta_dir() / f"{name}.yaml")
    write_json(tmp_path / "isd.json", support_data(said(camera)))
    again = read_support_data(tmp_path / "isd.json")
    points = grid(camera)
    sky = camera.unproject(points) @ said(camera).camera_from_j2000
    seen = again.camera.project(sky @ again.camera_from_j2000.T)
    assert np.abs(seen - points).max() < 0.02
    np.testing.assert_allclose(again.position_km, said(camera).position_km)
    np.testing.assert_allclose(again.body_from_j2000, said(camera).body_from_j2000, atol=1e-12)
    np.testing.assert_allclose(again.radii_km, [482.0, 446.0])
    assert again.places == PlaceConvention(
        craft_observes=True
    )  # ISIS' and ALE's own words, read by them, too


def test_missing_geometry_and_other_sensors_are_refused_in_one_line(tmp_path):
    camera = Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml")
    with pytest.raises(CameraError, match="need sun_position_km; load the kernels"):
        support_data(replace(said(camera), sun_position_km=None))
    data = support_data(said(camera))
    for changes, message in (
        ({"name_model": "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL"}, "only frame cameras"),
        ({"detector_center": {"line": None, "sample": 1.0}}, "line is null; a number is needed"),
        ({"detector_center": {"sample": 1.0}}, "lack or spoil 'line'"),
        ({"focal_length_model": {"focal_length": 0.12}}, "seems to be in m"),
        ({"optical_distortion": {"lunarorbiter": {"perspective_x": 1e-6}}}, "type lunarorbiter is not read"),
    ):
        write_json(tmp_path / "isd.json", data | changes)
        with pytest.raises(CameraError, match=message):
            read_support_data(tmp_path / "isd.json")


@dataclass(frozen=True)
class Known:
    """How ALE's file of a picture differs from the camera that its instrument kernel and addendum give, and why."""

    folder: str
    instrument_id: int
    given: dict
    ale_center_px: float = 0.0  # its detector center minus ours
    without_distortion: bool = False
    why: str = ""


BASE = "ALE takes BORESIGHT_SAMPLE, which counts from 1, for a coordinate whose first pixel is 0.5"
DROPPED = "ALE's driver of ISIS labels leaves distortion out"
CASES = {
    "cassiniiss_isd": Known("slices/N1702360370_1", -82360, {"focal_length_mm": 2003.09}),
    "cassiniiss_isis_isd": Known(
        "slices/N1702360370_1", -82360, {"focal_length_mm": 2003.09}, 0.5, True, f"{BASE}; {DROPPED}"
    ),
    "dawnfc_isis_isd": Known("slices/FC21A0038582_15170161546F6F", -203126, {}, 0.0, True, DROPPED),
    "dawnfc_isd": Known(
        "slices/FC21A0038582_15170161546F6F", -203126,
        {"pixel_from_mm": np.eye(2) / 0.014004},
        why="ALE takes the first PIXEL_SIZE of the kernel for both axes, ISIS the addendum's TRANSX and TRANSY",
    ),
    "hayabusa2_isd": Known("slices/hyb2_onc_20151203_084458_w2f_l2a", -37120, {}, 0.5, True, f"{BASE}; {DROPPED}"),
    "clem_uvvis_isd": Known("instruments/clementine_uvvis", -40021, {}, 0.5, True, f"{BASE}; {DROPPED}"),
    "mexsrc_isd": Known(
        "instruments/mex_hrsc", -41220, {"n_pixel": 1008, "n_line": 1008, "center_pixel_line": (511.5, 511.5)}
    ),
    "cassis_isd": Known("instruments/tgo_cassis", -143400, {}, 0.5, True, f"{BASE}; {DROPPED}"),
    "juno_isd": Known("instruments/juno_junocam", -61500, {}, 0.0, True, DROPPED),
    "galileossi_isd": Known(
        "instruments/galileo_ssi", -77001, {}, 0.5, True,
        f"{BASE}; K1 stands where a constant belongs, which changes the scale by 2.5e-5 (0.02 px)",
    ),
    **{
        name: Known(
            f"instruments/voyager{craft}_iss", number, {"n_pixel": 1000, "n_line": 1000}, -0.5,
            why="no center in the kernels: the middle of the 1000 x 1000 of a corrected picture; ISIS has 500 of 1 to 1000",
        )
        for name, craft, number in (
            ("c1637937_isd", 1, -31101), ("c1638610_isd", 1, -31102),
            ("c2065022_isd", 2, -32101), ("c2065801_isd", 2, -32102),
        )
    },
}  # fmt: skip


@pytest.mark.realdata
@pytest.mark.parametrize("name", CASES)
def test_cameras_from_kernels_agree_with_ale_to_a_fiftieth_pixel(data_dir, name):
    """Over the whole detector, once the differences that `CASES` explains are taken out."""
    case = CASES[name]
    theirs = read_support_data(data_dir / f"spice/instruments/isds/{name}.json").camera
    files = [p for p in (data_dir / "spice" / case.folder).iterdir() if p.suffix.lower() in (".ti", ".tf")]
    with KernelSet(sorted(files, key=lambda p: ("ddendum" in p.name, p.name))):
        ours = Camera.from_ik(instrument_values(case.instrument_id), case.instrument_id, **case.given)
    if case.without_distortion:  # with it goes what it moves the boresight by
        where = ours.project(ours.boresight) if name != "cassis_isd" else np.array([1023.5, 1023.5])
        ours = replace(ours, distortion=NoDistortion(), center_pixel_line=where)
    points = grid(theirs)
    directions = theirs.unproject(points)  # Z to the sky, X and Y of the sensor's frame: that of the kernels
    seen = ours.project(directions) + case.ale_center_px
    assert np.abs(seen - points).max() < (0.02 if "2.5e-5" not in case.why else 0.03), case.why


def _undistorted(camera):
    """With the distortion goes what it moves the boresight by."""
    return replace(camera, distortion=NoDistortion(), center_pixel_line=camera.project(camera.boresight))


def _centered_at(x, y):
    return lambda camera: replace(camera, center_pixel_line=np.array([x, y]))


NO_CENTER = "ALE has 0 for a detector center that the kernels do not give"
# Our camera files: mission, stem, what is changed to be ALE's, what ALE's center is beyond ours, and why.
FILES = {
    **{
        isd: (mission, stem, lambda camera: camera, 0.0, "")
        for isd, mission, stem in (
            ("c1637937_isd", "voyager1", "iss_na"), ("c1638610_isd", "voyager1", "iss_wa"),
            ("c2065022_isd", "voyager2", "iss_na"), ("c2065801_isd", "voyager2", "iss_wa"),
        )
    },
    **{
        isd: (mission, stem, _centered_at(-0.5, -0.5), 0.0, NO_CENTER)
        for isd, mission, stem in (
            ("f004a47_isd", "viking1", "vis_a"), ("f735a00_isd", "viking1", "vis_b"),
            ("f004b65_isd", "viking2", "vis_a"), ("f704b28_isd", "viking2", "vis_b"),
        )
    },
    "clem_uvvis_isd": ("clementine", "uvvis_a", _undistorted, 0.5, f"{BASE}; {DROPPED}"),
    "galileossi_isd": ("galileo", "ssi", _undistorted, 0.5, CASES["galileossi_isd"].why),
    "hayabusa2_isd": ("hayabusa2", "onc_w2", _undistorted, 0.5, f"{BASE}; {DROPPED}"),
    "hayabusaamica_isd": (
        "hayabusa", "amica", lambda camera: camera, -0.5,
        "BORESIGHT_SAMPLE 511.5 is the middle counted from 0; ALE takes it for a coordinate whose first pixel is 0.5",
    ),
    "messmdis_isd": (
        "messenger", "mdis_nac",
        lambda camera: replace(
            _centered_at(255.5, 255.5)(camera), n_pixel=512, n_line=512, pixel_from_mm=np.eye(2) / 0.028,
            focal_length_mm=549.5535053027719,
        ),
        0.0, "binned by 2, focal length at the picture's temperature",
    ),
    "messmdis_isis_isd": ("messenger", "mdis_nac", _undistorted, 0.5, f"{BASE}; {DROPPED}"),
    "dawnfc_isd": (
        "dawn", "fc2",
        lambda camera: replace(
            camera, focal_length_mm=150.08, pixel_from_mm=np.eye(2) / 0.014004,
            distortion=BrownDistortion(150.08, k1=9.2e-6 * 150.08**2),
        ),
        0.0, "filter F6, our file is of F1; ALE takes the first PIXEL_SIZE for both axes",
    ),
    "dawnfc_isis_isd": (
        "dawn", "fc2",
        lambda camera: replace(
            _undistorted(camera), focal_length_mm=150.08, pixel_from_mm=np.diag([1.0 / 0.0140088, 1.0 / 0.014])
        ),
        0.0, f"filter F6; the addendum's TRANSX and TRANSY for PIXEL_SIZE of the instrument kernel; {DROPPED}",
    ),
    "nhlorri_isd": (
        "new_horizons", "lorri_1x1",
        lambda camera: replace(_centered_at(-0.5, -0.5)(_undistorted(camera)), pixel_from_mm=np.eye(2) / 0.013),
        0.0, f"{NO_CENTER}; pixels of 13 um in the addendum, 12.997 in the instrument kernel; {DROPPED}",
    ),
}  # fmt: skip
FILES |= {
    "cassis_isd": (
        "tgo", "cassis", lambda camera: _centered_at(1023.5, 1023.5)(_undistorted(camera)), 0.5, f"{BASE}; {DROPPED}"
    ),
    "juno_isd": (
        "juno", "junocam_blue", lambda camera: _centered_at(813.71, 599.5)(_undistorted(camera)), 0.0,
        f"our file is of the strip of the blue filter; {DROPPED}",
    ),
    "osirisrex_isd": (
        "osiris_rex", "mapcam",
        lambda camera: replace(_centered_at(511.0, 511.0)(_undistorted(camera)), pixel_from_mm=np.eye(2) / 0.0085),
        0.0, "ALE takes OD_K of the cameras' own law for coefficients of its radial one; pixels and center of the addendum",
    ),
    "cassiniiss_isd": (
        "cassini", "iss_nac",
        lambda camera: replace(
            camera, focal_length_mm=2003.09,
            distortion=BrownDistortion(camera.distortion.focal_mm, k1=-camera.distortion.k1),
        ),
        0.0, "focal length of the filters CL1, UV3; ALE has barrel distortion where stars show pincushion (Owen 2003)",
    ),
    "cassiniiss_isis_isd": (
        "cassini", "iss_nac", lambda camera: replace(_undistorted(camera), focal_length_mm=2003.09), 0.5,
        f"focal length of the filters CL1, UV3; {BASE}; {DROPPED}",
    ),
    "msi_isd": (
        "near", "msi",
        lambda camera: replace(
            _centered_at(268.0, 205.5)(camera), n_line=412, pixel_from_mm=np.diag([62.5, -62.5]), focal_length_mm=166.85
        ),
        0.5,
        f"{BASE}; calibrated pictures of 412 square lines, the first below; ours are 244 as read out; 166.85 mm, not 167",
    ),
}  # fmt: skip
# What turns directions of ALE's sensor into those of our camera's frame.
TURNED = {
    "nhlorri_isd": np.diag([1.0, 1.0, -1.0]),  # LORRI looks along -Z, ALE's sensors along +Z
    # Frame CASSINI_ISS_NAC_USGS of the addendum
    "cassiniiss_isd": np.diag([-1.0, -1.0, 1.0]),
    "cassiniiss_isis_isd": np.diag([-1.0, -1.0, 1.0]),
    "msi_isd": np.array(  # our frame is that of the bus, whose attitude headers give: ALE's constant_rotation
        [
            [-0.0014422521585655882, 6.97819591591179e-07, 0.9999989599535712],
            [-0.00048384015636002327, -0.9999998829493447, 0.0],
            [0.9999988429030378, -0.00048383965314379655, 0.0014422523273822038],
        ]
    ),
}


@pytest.mark.realdata
@pytest.mark.parametrize("name", FILES)
def test_camera_files_agree_with_ale_to_a_fiftieth_pixel(data_dir, tmp_path, name):
    """What comes with the program, over the whole detector, once the differences that `FILES` explains are taken out."""
    mission, stem, to_ale, center_px, why = FILES[name]
    told = read_json(data_dir / f"spice/instruments/isds/{name}.json", "")
    if name == "hayabusaamica_isd":  # in m, as in the instrument kernel: refused
        told["focal_length_model"]["focal_length"] *= 1e3
    write_json(tmp_path / "isd.json", told)
    theirs = read_support_data(tmp_path / "isd.json").camera
    ours = to_ale(load_mission(mission).camera_named(stem))
    if name == "osirisrex_isd":  # coefficients of another law
        theirs = replace(theirs, distortion=NoDistortion())
    if theirs.n_pixel == 1:  # of a cube without pixels
        theirs = replace(theirs, n_pixel=ours.n_pixel, n_line=ours.n_line)
    points = grid(theirs)
    seen = ours.project(theirs.unproject(points) @ TURNED.get(name, np.eye(3))) + center_px
    assert np.abs(seen - points).max() < 0.02, why


SLICES = {  # kernels of one picture, its image support data, the mission's camera, how far both are apart at the edge, px
    # filter F6 has 150.08 mm and 9.2e-6 /mm^2, our file is of F1; ALE's lines have the pixels' width for their height
    "Dawn at Ceres": ("FC21A0038582_15170161546F6F", "dawnfc_isd", ("dawn", "fc2"), 0.30),
    # Owen's calibration has pincushion, ISIS' K1 and ALE barrel: twice 0.4 px, less 0.2 of the filter's focal length
    "Cassini at Enceladus": ("N1702360370_1", "cassiniiss_isd", ("cassini", "iss_nac"), 0.60),
}


@pytest.mark.realdata
@pytest.mark.parametrize("name", SLICES)
def test_a_mission_s_camera_sees_the_sky_where_the_picture_s_support_data_do(data_dir, name):
    """Kernels, mission file and camera against ALE's JSON of the same picture: attitude, axes and optics together."""
    folder, isd, (mission, stem), edge_px = SLICES[name]
    theirs = read_support_data(data_dir / f"spice/instruments/isds/{isd}.json")
    inside = (data_dir / "spice/slices" / folder).iterdir()
    files = [p for p in inside if p.suffix in (".bsp", ".bc", ".ti", ".tf", ".tpc", ".tsc")]
    generic = data_dir / "spice/generic"
    camera = load_mission(mission).camera_named(stem)
    with KernelSet([generic / "naif0012.tls", generic / "pck00011.tpc", *sorted(files)]):
        attitude = camera_attitude(camera.frame, theirs.et)
        from_sun = state(load_mission(mission).spacecraft_id, theirs.et, "SUN")

    def apart_px(points):
        sky = theirs.camera.unproject(points) @ theirs.camera_from_j2000
        return float(np.abs(camera.project(sky @ attitude.T) - points).max())

    velocity = (theirs.velocity_km_s - theirs.sun_velocity_km_s) - from_sun.velocity_km_s
    # The rate of an apparent place: the acceleration of a moon is in it (`opnav_workbench.session.beside`).
    assert np.linalg.norm(velocity) < (0.002 if mission == "dawn" else 3.3)
    assert theirs.target_id == {"dawn": 2000001, "cassini": 602}[mission]
    assert apart_px(np.array([[511.5, 511.5]])) < 1e-6
    assert apart_px(grid(theirs.camera)) < edge_px

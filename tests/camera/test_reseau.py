"""Raw vidicon pictures: their distortion from the marks that they show, on pictures made here and one of Voyager 2."""

from dataclasses import replace

import numpy as np
import pytest

from opnav_workbench.camera import Camera, Reseau, fit_reseau
from opnav_workbench.errors import CameraError
from opnav_workbench.image import KeywordMap, read_image
from opnav_workbench.mission import load_mission
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.session import ImageSession

CAMERAS = [(f"voyager{n}", f"iss_{lens}") for n in (1, 2) for lens in ("na", "wa")]
RNG = np.random.default_rng(1981)


def raw_camera(mission="voyager2", name="iss_na") -> Camera:
    return Camera.from_yaml(kernels_meta_dir() / mission / f"cameras/{name}_raw.yaml")


def bent(places):
    """How a frame's beam bends: pixels, from where the nominal marks stand (n, 2)."""
    u, v = (np.asarray(places).T - 400.0) / 400.0
    return np.column_stack([2.0 + 1.5 * u * v - u**3, -3.0 + v**2 + 0.8 * u**2 * v])


def picture_of(marks, level=22.0, depth=14.0, body=True):
    """Marks, dark, on a sky and a bright disk, in whole numbers."""
    line, pixel = np.mgrid[:800, :800]
    image = np.full((800, 800), level)
    if body:
        image += 90.0 * (np.hypot(pixel - 480.0, line - 350.0) < 160.0)
    for x, y in marks:
        near = slice(max(int(y) - 6, 0), int(y) + 8), slice(max(int(x) - 6, 0), int(x) + 8)
        dip = np.exp(-0.5 * ((pixel[near] - x) ** 2 + (line[near] - y) ** 2) / 1.2**2)
        image[near] *= 1.0 - dip * depth / level
    return np.round(image + RNG.normal(0.0, 1.0, image.shape)).clip(0, 255)


def test_a_picture_s_own_marks_tell_its_distortion():
    camera = raw_camera()
    nominal = (
        camera.center_pixel_line + camera.distortion.distort(camera.reseau.ideal_mm) @ camera.pixel_from_mm.T
    )
    inner = (np.abs(camera.reseau.ideal_mm) < 4.6).all(axis=1)
    marks = nominal + bent(nominal)
    fit = fit_reseau(camera, picture_of(marks))
    assert fit.is_solved
    assert np.count_nonzero(fit.seen) > 140
    ideal = RNG.uniform(-4.6, 4.6, (200, 2))

    def raw(camera):
        return camera.center_pixel_line + camera.distortion.distort(ideal) @ camera.pixel_from_mm.T

    truth = raw(camera) + bent(raw(camera))
    assert np.abs(raw(fit.camera) - truth).max() < 0.3
    assert np.sqrt(np.mean((raw(fit.camera) - truth) ** 2)) < 0.1
    assert np.abs(raw(camera) - truth).max() > 3.0  # by nominal places it would be off
    x, y = np.round(marks[np.flatnonzero(inner & fit.seen)[0]]).astype(int)
    assert fit.hidden[y, x]
    assert 0.003 < fit.hidden.mean() < 0.01


def test_where_no_marks_are_seen_the_nominal_distortion_stays():
    camera = raw_camera()
    for image in (np.zeros((800, 800)), RNG.normal(20.0, 2.0, (800, 800))):
        fit = fit_reseau(camera, image)
        assert not fit.is_solved
        assert fit.camera is camera
        assert not fit.seen.any()


@pytest.mark.parametrize(("mission", "name"), CAMERAS)
def test_nominal_marks_stand_where_the_camera_file_has_them(mission, name):
    camera, corrected = (
        raw_camera(mission, name),
        Camera.from_yaml(kernels_meta_dir() / mission / f"cameras/{name}.yaml"),
    )
    marks = (
        camera.center_pixel_line + camera.distortion.distort(camera.reseau.ideal_mm) @ camera.pixel_from_mm.T
    )
    inner = (np.abs(camera.reseau.ideal_mm) < 4.9).all(axis=1)
    assert np.count_nonzero(inner) > 100
    assert np.sqrt(np.mean((marks - camera.reseau.marks_px)[inner] ** 2)) < 0.5
    # the same sky: a direction in the middle of the one is in the middle of the other
    middle = corrected.unproject([499.0, 499.0])
    assert np.hypot(*(camera.project(middle) - 400.0)) < 6.0
    edge = camera.project(corrected.unproject([900.0, 499.0]))
    assert edge[0] > 720.0


def test_a_reseau_is_kept_in_camera_files_and_lost_in_windows(tmp_path):
    camera = raw_camera()
    camera.to_yaml(tmp_path / "raw.yaml")
    again = Camera.from_yaml(tmp_path / "raw.yaml")
    np.testing.assert_array_equal(again.reseau.marks_px, camera.reseau.marks_px)
    with pytest.raises(CameraError, match="201 places and 200 ideal ones"):
        Reseau(camera.reseau.marks_px, camera.reseau.ideal_mm[1:])
    with pytest.raises(CameraError, match="has no reseau marks"):
        fit_reseau(replace(camera, reseau=None), np.zeros((800, 800)))


def test_a_mission_tells_raw_pictures_by_their_size():
    words = {"SPACECRAFT_NAME": "VOYAGER_2", "INSTRUMENT_NAME": "NARROW_ANGLE_CAMERA"}
    mission = load_mission("voyager2")
    assert mission.camera_for(words | {"PICTURE.LINES": 800}).name == "Voyager 2 ISS NA raw"
    assert mission.camera_for(words | {"PICTURE.LINES": 1000}).name == "Voyager 2 ISS NA"
    assert mission.camera_for(words).name == "Voyager 2 ISS NA"


@pytest.mark.realdata
def test_a_raw_picture_of_voyager(data_dir):
    """Enceladus, 1981: marks of one half of the faceplate say where those of the other stand."""
    image = read_image(data_dir / "images/formats/c4400436.imq", KeywordMap()).image_dn
    camera = raw_camera()
    fit = fit_reseau(camera, image)
    assert np.count_nonzero(fit.seen) > 145
    assert fit.rms_px < 0.1
    half = np.random.default_rng(0).random(len(fit.seen)) < 0.5
    other = replace(camera, reseau=Reseau(camera.reseau.marks_px[half], camera.reseau.ideal_mm[half]))
    told = fit_reseau(other, image)
    inner = ~half & fit.seen & (np.abs(camera.reseau.ideal_mm) < 4.9).all(axis=1)
    places = [
        c.center_pixel_line + c.distortion.distort(camera.reseau.ideal_mm[inner]) @ c.pixel_from_mm.T
        for c in (fit.camera, told.camera)
    ]
    assert np.sqrt(np.mean((places[0] - places[1]) ** 2)) < 0.15


def test_a_raw_picture_without_marks_is_doubted(tmp_path):
    image = RNG.integers(0, 2, (800, 800)).astype(np.uint8)
    image[300:500, 300:500] = RNG.integers(100, 140, (200, 200))
    label = (
        "PDS_VERSION_ID = PDS3\nRECORD_BYTES = 800\n^IMAGE = 2\nSPACECRAFT_NAME = VOYAGER_2\n"
        "INSTRUMENT_NAME = NARROW_ANGLE_CAMERA\nIMAGE_TIME = 1981-08-26T02:35:11Z\nEXPOSURE_DURATION = 0.12 <SECONDS>\n"
        "OBJECT = IMAGE\n LINES = 800\n LINE_SAMPLES = 800\n SAMPLE_TYPE = UNSIGNED_INTEGER\n SAMPLE_BITS = 8\n"
        "END_OBJECT = IMAGE\nEND\n"
    )
    (tmp_path / "a.img").write_bytes(label.encode().ljust(800) + image.tobytes())
    session = ImageSession.open(tmp_path / "a.img", "voyager2", attitude="unknown", by_hand=True)
    assert "reseau marks are not seen" in str(session.context.picture.contradictions)


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("file", "camera", "said"),
    [
        ("c4400436.imq", "Voyager 2 ISS NA raw", "is fitted to 15"),
        ("c4400436.cub", "Voyager 2 ISS NA raw", "is fitted to 15"),
        ("C2069302_RAW.IMG", "Voyager 2 ISS WA raw", "is fitted to 6"),  # half of its lines are lost
    ],
)
def test_raw_pictures_open_with_their_own_geometry_or_are_doubted(data_dir, file, camera, said):
    session = ImageSession.open(
        data_dir / "images/formats" / file, "voyager2", attitude="unknown", by_hand=True
    )
    picture = session.context.picture
    assert session.context.camera.name == camera
    assert said in str(picture.messages)
    assert picture.contradictions == ()
    if file.endswith("RAW.IMG"):
        assert (picture.exposure_s, picture.utc[:16]) == (15.36, "1979-07-11T01:19")

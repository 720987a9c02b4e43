"""What is drawn over the picture, against the session and by brute force."""

import numpy as np
import pytest
from PIL import Image

from opnav_workbench.camera import Camera
from opnav_workbench.geometry import camera_from_j2000, radec_from_unit
from opnav_workbench.kernels import KernelSet
from opnav_workbench.rehearsal import DEMO_KERNELS, DEMO_MISSION
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.session import ImageSession
from opnav_workbench.workbench.image_view import difference_picture, modeled_picture
from opnav_workbench.workbench.overlays import (
    MOST_RUNS,
    body_marks,
    mask_runs,
    sky_grid,
    star_marks,
)
from opnav_workbench.workbench.plots import star_residuals
from opnav_workbench.workbench.stretch import picture_png


@pytest.fixture(scope="module")
def session(demo_truths):
    with KernelSet(DEMO_KERNELS):
        session = ImageSession.open(demo_truths[0].picture, DEMO_MISSION)
        for name in ("PLUTO", "CHARON"):
            session.add_target(name)
        session.predict()
        session.find_stars()
        session.repoint()
        session.find_body("PLUTO", method="unresolved")
    return session


def test_star_marks_are_the_sessions_stars(session):
    marks = star_marks(session)
    result = session.result()["stars"]
    used = {star["id"]: star for star in result if star["status"] == "used"}
    assert marks.used["id"]
    assert set(marks.used["id"]) == set(used)
    for star, pixel, line in zip(*(marks.used[k] for k in ("id", "pixel", "line")), strict=True):
        np.testing.assert_allclose((pixel, line), used[star]["observed"], atol=1e-6)
    residual = np.array([used[star]["residual_px"] for star in marks.used["id"]])
    np.testing.assert_allclose(np.c_[marks.vectors["d_pixel"], marks.vectors["d_line"]], residual, atol=1e-6)


def test_no_marks_before_a_prediction(demo_truths):
    session = ImageSession.open(demo_truths[0].picture, DEMO_MISSION, attitude="header")
    marks = star_marks(session)
    assert len(marks.predicted["pixel"]) == len(marks.labels["text"]) == len(marks.vectors["pixel"]) == 0


@pytest.mark.slow
def test_marks_stand_where_the_field_was_found(demo_truths):
    """Nothing is missing before a search; after it marks, boxes and plots say the same, though no pointing is solved."""
    with KernelSet(DEMO_KERNELS):
        session = ImageSession.open(demo_truths[0].picture, DEMO_MISSION)
        session.add_target("PLUTO")
        session.predict()
        before = star_marks(session)
        assert len(before.missing["pixel"]) == 0
        session.find_stars()
    marks, boxes = star_marks(session), session.star_boxes()
    moved = np.hypot(
        *(np.array([boxes[0].predicted_px - [before.predicted[a][0] for a in ("pixel", "line")]]).T)
    )
    assert moved > 5.0  # the demo's pointing is off by some 12 px
    used = {b.id: b.observed_px - b.predicted_px for b in boxes if b.status == "used"}
    rows = star_residuals(session)
    assert rows.reference == "from the field found"
    for star, after in zip(rows.ids, rows.after_px, strict=True):
        np.testing.assert_allclose(after, used[star], atol=1e-9)
    np.testing.assert_allclose(
        np.c_[marks.vectors["d_pixel"], marks.vectors["d_line"]], list(used.values()), atol=1e-9
    )
    (pluto,) = body_marks(session)
    np.testing.assert_allclose(pluto.center_px, demo_truths[0].bodies["PLUTO"], atol=1.5)


def test_rejected_star_changes_its_mark(session):
    star = star_marks(session).used["id"][0]
    session.reject_stars([star], "test")
    marks = star_marks(session)
    session.undo()
    assert star in marks.rejected["id"]
    assert star not in marks.used["id"]


def test_bodies_are_marked_at_their_centers(session):
    marks = {mark.name: mark for mark in body_marks(session)}
    assert list(marks) == ["PLUTO", "CHARON"]  # the larger first
    np.testing.assert_allclose(marks["PLUTO"].center_px, session.state.bodies[-1].pixel_line)
    assert marks["PLUTO"].observed
    assert not marks["CHARON"].observed
    assert len(marks["CHARON"].limb_px) == 0  # one pixel: its limb tells nothing


def test_mask_runs_cover_the_mask_exactly():
    rng = np.random.default_rng(5)
    mask = rng.random((40, 60)) < 0.2
    drawn = np.zeros_like(mask)
    for left, right, top, bottom in zip(*mask_runs(mask).values(), strict=True):
        drawn[int(top + 0.5) : int(bottom + 0.5), int(left + 0.5) : int(right + 0.5)] = True
    np.testing.assert_array_equal(drawn, mask)


def test_noisy_mask_is_drawn_coarser():
    mask = np.random.default_rng(6).random((1024, 1024)) < 0.3
    runs = mask_runs(mask)
    assert 0 < len(runs["left"]) <= MOST_RUNS
    assert runs["right"].max() <= 1023.5


@pytest.mark.parametrize("dec_deg", [0.0, -60.0, 89.95])
@pytest.mark.parametrize("ra_deg", [0.0, 200.0])
def test_grid_lines_are_lines_of_ra_and_dec(ra_deg, dec_deg):
    camera = Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/lorri_1x1.yaml")
    attitude = camera_from_j2000(np.radians(ra_deg), np.radians(dec_deg), 0.3, camera.focal_from_camera)
    grid = sky_grid(camera, attitude)
    assert len(grid.lines_px) >= 3
    for line in grid.lines_px:
        on = line[camera.on_detector(line)]
        ra, dec = radec_from_unit(camera.unproject(on) @ attitude)
        turned = (ra - ra[0] + np.pi) % (2.0 * np.pi) - np.pi
        assert min(np.ptp(turned) * np.cos(dec[0]), np.ptp(dec)) < 1e-9
    assert all(camera.on_detector(place) for place in grid.places_px)


def test_model_frame_explains_the_stars(session):
    difference = difference_picture(session)
    noise = np.median(session.context.noise_dn)
    places = np.c_[star_marks(session).used["pixel"], star_marks(session).used["line"]]
    image = session.context.picture.image_dn
    for pixel, line in places:
        box = np.s_[max(round(line) - 2, 0) : round(line) + 3, max(round(pixel) - 2, 0) : round(pixel) + 3]
        peak = image[box].max() - session.context.background.level_dn[box].mean()
        assert peak > 15.0 * noise
        assert np.nanmax(np.abs(difference[box])) < 0.25 * peak
    assert modeled_picture(session).shape == image.shape


@pytest.mark.parametrize("shape", [(1024, 1024), (128, 5024)])
def test_static_picture_is_small(shape):
    import io

    noisy = np.random.default_rng(7).normal(100.0, 5.0, shape)
    png = picture_png(noisy, 90.0, 200.0)
    assert len(png) < 60_000
    assert max(Image.open(io.BytesIO(png)).size) <= 360

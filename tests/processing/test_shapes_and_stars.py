"""Shapes given by one option, and stars of a list that are targets without being named."""

import re

import numpy as np
import pytest

from opnav_workbench.errors import OpNavError, SessionError
from opnav_workbench.kernels import KernelSet
from opnav_workbench.kernels.shape_files import ShapeFile
from opnav_workbench.mission import load_mission
from opnav_workbench.processing import Processing, process_image
from opnav_workbench.rehearsal import DEMO_CATALOG, DEMO_KERNELS, DEMO_PICTURES
from opnav_workbench.session import ImageSession


@pytest.fixture
def cube(tmp_path):
    """A cube of 4000 km, in m, as a plate table."""
    corners = 2e6 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    plates = [(1, 2, 4), (1, 4, 3), (5, 7, 8), (5, 8, 6), (1, 5, 6), (1, 6, 2), (3, 4, 8), (3, 8, 7), (1, 3, 7), (1, 7, 5),
              (2, 6, 8), (2, 8, 4)]  # fmt: skip
    rows = ["8", *(f"{i} {x} {y} {z}" for i, (x, y, z) in enumerate(corners, start=1))]
    rows += ["12", *(f"{i} {a} {b} {c}" for i, (a, b, c) in enumerate(plates, start=1))]
    path = tmp_path / "cube.plt"
    path.write_text("\n".join(rows))
    return path


@pytest.mark.slow
def test_a_shape_that_was_given_is_taken_and_kept(demo_truths, cube, tmp_path):
    with KernelSet(DEMO_KERNELS):
        plain = ImageSession.open(demo_truths[1].picture, "new_horizons", catalog=DEMO_CATALOG)
        shapes = {"PLUTO": ShapeFile(cube, "m")}
        given = ImageSession.open(demo_truths[1].picture, "new_horizons", catalog=DEMO_CATALOG, shapes=shapes)
        for session in (plain, given):
            session.predict()
            session.add_target("PLUTO")
        known, cubic = (session.predict_body("PLUTO").diameter_px for session in (plain, given))
        given.save(tmp_path / "kept")
    assert cubic > 1.5 * known
    again = ImageSession.resume(tmp_path / "kept")
    assert again.predict_body("PLUTO").diameter_px == cubic
    assert again.source.shapes == {"PLUTO": ShapeFile(cube.resolve(), "m")}


def test_shapes_as_text(tmp_path):
    how = Processing(mission="new_horizons", shapes="PLUTO:pluto.obj:m, CHARON:charon.bds")
    assert how.shapes == {"PLUTO": "pluto.obj:m", "CHARON": "charon.bds"}
    full = how.with_full_paths(tmp_path).shape_files
    assert full == {
        "PLUTO": ShapeFile(tmp_path / "pluto.obj", "m"),
        "CHARON": ShapeFile(tmp_path / "charon.bds"),
    }
    with pytest.raises(SessionError, match="no shape of a body; write BODY:FILE"):
        Processing.checked({"mission": "new_horizons", "shapes": "pluto.obj"})


STARS = """stars:
- {{name: NEAR ONE, ra_deg: {0:.5f}, dec_deg: {1:.5f}, epoch_jyear: 2015.3, mag: 9.0}}
- {{name: FAR OFF, ra_deg: {2:.5f}, dec_deg: {1:.5f}, epoch_jyear: 2015.3, mag: 9.0}}
"""


@pytest.fixture
def stars(demo_truths, tmp_path):
    """A list of a star in the middle of the demo picture, and one 90 deg off."""
    camera = load_mission("new_horizons").camera_for(DEMO_PICTURES[1].header)
    direction = demo_truths[1].camera_from_j2000.T @ camera.boresight
    ra, dec = np.degrees(np.arctan2(direction[1], direction[0])) % 360.0, np.degrees(np.arcsin(direction[2]))
    path = tmp_path / "stars.yaml"
    path.write_text(STARS.format(ra, dec, (ra + 90.0) % 360.0))
    return path


@pytest.mark.slow
def test_the_stars_of_a_list_are_targets(demo_truths, stars, tmp_path):
    how = Processing(mission="new_horizons", catalog=DEMO_CATALOG, target_stars=stars)
    outcome = process_image(demo_truths[1].picture, how.opened(), tmp_path / "run")
    assert {body["name"]: body["status"] for body in outcome.result["bodies"]}.keys() == {
        "NEAR ONE",
        "FAR OFF",
    }


def test_an_unknown_target_star_lists_those_that_are_known(demo_truths, stars):
    session = ImageSession.open(
        demo_truths[1].picture, "new_horizons", catalog=DEMO_CATALOG, target_stars=stars
    )
    session.predict()
    with pytest.raises(OpNavError, match=r"target stars of stars\.yaml are NEAR ONE, FAR OFF\."):
        session.add_target("NEAR TWO")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"shapes": "NOWHERE:cube.plt:m"}, "shapes of NOWHERE: no such target; targets are CHARON, PLUTO"),
        ({"shapes": "CHARON:none.obj"}, "shape of CHARON: no file"),
        (
            {"shapes": "CHARON:empty.obj", "targets": "PLUTO"},
            "empty.obj",
        ),  # in the scene without being a target
        ({"landmarks": "PLUTO:empty.npz", "targets": "PLUTO"}, "not a whole npz file"),
        ({"landmarks": "PLUTO:none.npz"}, "no file"),
    ],
)
def test_files_of_bodies_that_would_not_be_used_are_refused(cube, monkeypatch, options, said):
    monkeypatch.chdir(cube.parent)
    for name in ("empty.obj", "empty.npz"):
        cube.with_name(name).write_bytes(b"")
    with pytest.raises(OpNavError, match=re.escape(said)):
        Processing(mission="new_horizons", catalog=DEMO_CATALOG, **options).opened()


def test_shapes_are_taken_for_targets_and_for_the_scene(cube):
    shapes = {"PLUTO": f"{cube}:m", "CHARON": f"{cube}:m"}
    assert Processing(mission="new_horizons", catalog=DEMO_CATALOG, shapes=shapes, targets="none").opened()
    with pytest.raises(SessionError, match=r"landmarks.*names no file"):
        Processing.checked({"mission": "new_horizons", "landmarks": ","})

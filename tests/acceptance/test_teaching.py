"""Every lesson as a student runs it: unanswered, answered right, answered wrong; and as a teacher runs it headless."""

import json
import re
import sys
from pathlib import Path

import nbformat
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from warm_notebooks import execute

TEACHING = Path(__file__).parents[2] / "notebooks/teaching"
LESSONS = sorted(path.stem for path in TEACHING.glob("*.ipynb"))

# What a student writes into the exercises' cells: (right, wrong, what the hint to the wrong answer must say).
# Right answers go another way than the checks: they are what the lessons' texts teach, put into numpy.
ANSWERS = {
    "01_pixels_and_pointing": [
        (
            "answer_1 = np.degrees(1.0 / (camera.pixel_from_mm[0, 0] * camera.focal_length_mm)) * 3600",
            "answer_1 = 1.0 / (camera.pixel_from_mm[0, 0] * camera.focal_length_mm)",
            "radians and arcseconds",
        ),
        (
            (
                "def pinhole(direction, camera):\n"
                "    a, b, c = camera.focal_from_camera @ direction\n"
                "    f = camera.focal_length_mm\n"
                "    return camera.center_pixel_line + camera.pixel_from_mm @ [f * a / c, f * b / c]"
            ),
            (
                "def pinhole(direction, camera):\n"
                "    xy = camera.focal_length_mm * direction[:2] / direction[2]\n"
                "    return camera.center_pixel_line + camera.pixel_from_mm @ xy"
            ),
            "minus Z",
        ),
        ("answer_3 = (14, -10)", "answer_3 = (-14, 10)", "observed minus predicted"),
        (
            "answer_4 = [511.5 * np.radians(0.06), 0.0]",
            "answer_4 = [511.5 * 0.06, 0.0]",
            "radians and degrees",
        ),
    ],
    "02_aberration_and_parallax": [
        (
            (
                "def aberration_arcsec(speed_km_s, angle_deg):\n"
                "    sine = speed_km_s / SPEED_OF_LIGHT_KM_S * np.sin(np.radians(angle_deg))\n"
                "    return np.degrees(np.arcsin(sine)) * 3600"
            ),
            (
                "def aberration_arcsec(speed_km_s, angle_deg):\n"
                "    sine = speed_km_s / SPEED_OF_LIGHT_KM_S * np.cos(np.radians(angle_deg))\n"
                "    return np.degrees(np.arcsin(sine)) * 3600"
            ),
            "Sine, not cosine",
        ),
        (
            (
                "d_ra, d_dec = 268.45280 - 268.45246, -34.79019 + 34.78927\n"
                "answer_2 = 3600 * np.hypot(d_ra * np.cos(np.radians(34.79)), d_dec)"
            ),
            "answer_2 = 20.5",
            "Pythagoras",
        ),
        (
            "answer_3 = 14.57 / SPEED_OF_LIGHT_KM_S * np.sin(np.radians(22.66)) * 114.32e6",
            "answer_3 = 14.57 / SPEED_OF_LIGHT_KM_S * 114.32e6",
            "target abeam",
        ),
        (
            (
                "toward = seen['barycenter']\n"
                "across = spacecraft_km - (spacecraft_km @ toward) * toward\n"
                "angle = np.linalg.norm(measured['New Horizons'] - measured['barycenter']) * lorri.pixel_scale_rad\n"
                "answer_4 = np.linalg.norm(across) / AU_KM / angle / 63241"
            ),
            "answer_4 = 4.9",
            "Distance =",
        ),
    ],
    "03_star_centers": [
        (
            (
                "def center_of_light(box):\n"
                "    pixel, line = np.arange(box.shape[1]), np.arange(box.shape[0])\n"
                "    return [box.sum(axis=0) @ pixel / box.sum(), box.sum(axis=1) @ line / box.sum()]"
            ),
            (
                "def center_of_light(box):\n"
                "    pixel, line = np.arange(box.shape[1]), np.arange(box.shape[0])\n"
                "    return [box.sum(axis=1) @ line / box.sum(), box.sum(axis=0) @ pixel / box.sum()]"
            ),
            "other order",
        ),
        (
            (
                "def top_of_parabola(r_minus, r_0, r_plus):\n"
                "    return 0.5 * (r_minus - r_plus) / (r_minus - 2 * r_0 + r_plus)"
            ),
            (
                "def top_of_parabola(r_minus, r_0, r_plus):\n"
                "    return 0.5 * (r_plus - r_minus) / (r_minus - 2 * r_0 + r_plus)"
            ),
            "the sign is not",
        ),
        (
            "answer_3 = np.sqrt(2.0) * np.sqrt(sigma_px**2 + 1 / 12) / 25",
            "answer_3 = np.sqrt(sigma_px**2 + 1 / 12) / 25",
            "square root of two",
        ),
        ("answer_4 = (2, 4)", "answer_4 = (4, 2)", "other"),
    ],
    "04_limb_scans": [
        (
            "answer_1 = 3 / 8 * phase * radius_px",
            "answer_1 = 3 / 8 * np.degrees(phase) * radius_px",
            "degrees",
        ),
        (
            (
                "def center_shift(angle_rad, offset_px):\n"
                "    a = np.column_stack([np.cos(angle_rad), np.sin(angle_rad)])\n"
                "    return np.linalg.solve(a.T @ a, a.T @ offset_px)"
            ),
            (
                "def center_shift(angle_rad, offset_px):\n"
                "    return [np.mean(offset_px * np.cos(angle_rad)), np.mean(offset_px * np.sin(angle_rad))]"
            ),
            "mean of projections",
        ),
        (
            "h = np.radians(30)\nanswer_3 = np.sqrt((2 * h + np.sin(2 * h)) / (2 * h - np.sin(2 * h)))",
            "h = np.radians(30)\nanswer_3 = (2 * h + np.sin(2 * h)) / (2 * h - np.sin(2 * h))",
            "variances",
        ),
        ("answer_4 = range(84, 166, 5)", "answer_4 = range(100, 110)", "Spread the scans"),
    ],
    "05_partials": [
        ("answer_1 = 2_533_159 * camera.pixel_scale_rad", "answer_1 = 0.0796", "pixels per kilometer"),
        (
            (
                "def partials(place):\n"
                "    steps = 10.0 * np.eye(3)\n"
                "    return np.stack([(place(s) - place(-s)) / 20.0 for s in steps], axis=1)"
            ),
            (
                "def partials(place):\n"
                "    steps = 10.0 * np.eye(3)\n"
                "    return np.stack([(place(s) - place(-s)) / 10.0 for s in steps], axis=1)"
            ),
            "Twice too large",
        ),
        ("answer_3 = np.linalg.svd(H)[2][2]", "answer_3 = [0, 0, 1]", "shifts Pluto by 77"),
        ("answer_4 = -H @ (4500 * sun)", "answer_4 = H @ (4500 * sun)", "here Pluto moves"),
    ],
    "06_residual_plots": [
        (
            (
                'answer_1 = {"A": "pixel shape", "B": "distortion", "C": "nothing", '
                '"D": "identification", "E": "twist", "F": "focal length"}'
            ),
            (
                'answer_1 = {"A": "pixel shape", "B": "focal length", "C": "nothing", '
                '"D": "identification", "E": "twist", "F": "distortion"}'
            ),
            "4 of 6 are right",
        ),
        (
            "answer_2 = -1e6 * (g_place * g_residual).sum() / (g_place**2).sum()",
            "answer_2 = 1e6 * (g_place * g_residual).sum() / (g_place**2).sum()",
            "the sign is not",
        ),
        ('answer_3 = names[np.argmax(np.hypot(*shown["D"].T))]', 'answer_3 = "HIP 1"', "names[np.argmax"),
        (
            "answer_4 = ((h_residual / H_SIGMA) ** 2).sum() / (2 * len(h_residual) - 3)",
            "answer_4 = ((h_residual / H_SIGMA) ** 2).sum()",
            "degrees of freedom",
        ),
    ],
    "07_disks_and_albedo": [
        (
            "answer_1 = 4 * radius_px / (3 * np.pi) * (0.8 - 0.2) / (0.8 + 0.2)",
            "answer_1 = 4 * radius_px / (3 * np.pi)",
            "dark half is black",
        ),
        (
            (
                "def best_scale(data, model):\n"
                "    return np.linalg.lstsq(model.reshape(-1, 1), data.ravel(), rcond=None)[0][0]"
            ),
            "def best_scale(data, model):\n    return data.sum() / model.sum()",
            "ratio of the sums",
        ),
        (
            (
                "angle = np.radians(np.linspace(-90, 90, 2001))\n"
                "answer_3 = 0.01 * radius_px * np.cos(angle).mean() / (np.cos(angle) ** 2).mean()"
            ),
            "answer_3 = 0.01 * radius_px",
            "another direction",
        ),
        ('answer_4 = "limb_scan"', 'answer_4 = "least_squares"', "says so"),
    ],
    "08_lost_in_space": [
        (
            "answer_1 = len(mag) * np.radians(fov_deg) ** 2 / (4 * np.pi)",
            "answer_1 = len(mag) * (fov_deg / 360) ** 2",
            "no square",
        ),
        (
            (
                "def angle_deg(first, second, focal):\n"
                "    a, b = np.r_[first, focal], np.r_[second, focal]\n"
                "    return np.degrees(np.arccos(a @ b / np.sqrt((a @ a) * (b @ b))))"
            ),
            (
                "def angle_deg(first, second, focal):\n"
                "    return np.degrees(np.hypot(*(np.array(first) - np.array(second))) / focal)"
            ),
            "near the middle only",
        ),
        (
            "answer_3 = len(mag) * (len(mag) - 1) / 2 * np.sin(np.radians(5)) * np.radians(0.01)",
            "answer_3 = len(mag) * (len(mag) - 1) * np.sin(np.radians(5)) * np.radians(0.01)",
            "counts once",
        ),
        (
            (
                "def attitude(camera_1, camera_2, sky_1, sky_2):\n"
                "    found, _ = Rotation.align_vectors([camera_1, camera_2], [sky_1, sky_2])\n"
                "    return found.as_matrix()"
            ),
            (
                "def attitude(camera_1, camera_2, sky_1, sky_2):\n"
                "    found, _ = Rotation.align_vectors([sky_1, sky_2], [camera_1, camera_2])\n"
                "    return found.as_matrix()"
            ),
            "from the camera to J2000",
        ),
    ],
    "09_landmarks_in_orbit": [
        (
            "answer_1 = 5000 * 272e-6",
            "answer_1 = 5 * camera.pixel_scale_rad",
            "in kilometers",
        ),
        (
            (
                "def predict(landmark_km, camera_km, attitude):\n"
                "    x, y, z = camera.focal_from_camera @ attitude @ (landmark_km - camera_km)\n"
                "    f = camera.focal_length_mm\n"
                "    return camera.center_pixel_line + camera.pixel_from_mm @ [f * x / z, f * y / z]"
            ),
            (
                "def predict(landmark_km, camera_km, attitude):\n"
                "    return camera.project(attitude @ (landmark_km - camera_km)) + 0.5"
            ),
            "nothing is added",
        ),
        (
            (
                "def range_sigma(places, range_km, sigma_px):\n"
                "    x, y = np.transpose(places)\n"
                "    return sigma_px * range_km * (x @ x + y @ y) ** -0.5"
            ),
            (
                "def range_sigma(places, range_km, sigma_px):\n"
                "    return sigma_px * range_km / np.sqrt((np.asarray(places) ** 2).sum(axis=1).mean())"
            ),
            "every landmark helps",
        ),
        ("answer_4 = 5000 * np.pi / 900", "answer_4 = 270 * np.radians(0.2)", "how far the surface moves"),
    ],
}


def tagged(cell, tag):
    return tag in cell["metadata"].get("tags", ())


def three_students(lesson):
    """Return the lesson with each exercise three times: as it is, answered right, answered wrong."""
    notebook = nbformat.read(TEACHING / f"{lesson}.ipynb", as_version=4)
    answers, cells, exercise = iter(ANSWERS[lesson]), [], None
    for cell in notebook.cells:
        cells.append(cell)
        if tagged(cell, "exercise"):
            exercise = cell
        if tagged(cell, "check"):
            right, wrong, _ = next(answers)
            for answer in (right, wrong):
                cells += [nbformat.v4.new_code_cell(answer), nbformat.v4.new_code_cell(cell.source)]
                cells[-1].metadata["tags"] = ["check"]
            cells.append(nbformat.v4.new_code_cell(exercise.source))
    assert next(answers, None) is None
    notebook.cells = cells
    return notebook


def run(notebook, folder, **parameters):
    source, executed = folder / "lesson.ipynb", folder / "executed.ipynb"
    nbformat.write(notebook, source)
    execute(source, executed, {"out": str(folder / "out"), **parameters})
    return nbformat.read(executed, as_version=4)


def said(notebook):
    """Return what each check said, in order."""
    return [
        output["data"]["text/plain"]
        for cell in notebook.cells
        if tagged(cell, "check")
        for output in cell.outputs
        if output["output_type"] == "execute_result"
    ]


def test_there_are_nine_lessons():
    assert sorted(ANSWERS) == LESSONS
    assert [name[:2] for name in LESSONS] == [f"0{number}" for number in range(1, 10)]


@pytest.mark.slow
def test_the_parallax_is_seen_from_where_the_spacecraft_was():
    """The position that lesson 2 states is that of the kernels, on the day of the flight frames of Proxima."""
    from opnav_workbench.constants import AU_KM
    from opnav_workbench.kernels import KernelSet, et_from_utc, state

    text = (TEACHING / "02_aberration_and_parallax.ipynb").read_text()
    stated = re.search(
        r"np\.array\(\[([\d., -]+)\]\) \* AU_KM.{1,40}# (2020-04-22T[\d:]+), J2000", text, re.DOTALL
    )
    with KernelSet("new_horizons/interstellar_2020"):
        et = et_from_utc(stated[2])
        position_au = state(-98, et, 0).position_km / AU_KM
    assert [float(x) for x in stated[1].split(",")] == pytest.approx(position_au, abs=1e-6)
    assert float(re.search(r"et_2020 = ([\d_.]+)", text)[1]) == pytest.approx(et, abs=0.01)


@pytest.mark.parametrize("lesson", LESSONS)
def test_a_lesson_is_kept_without_outputs_and_with_its_exercises(lesson):
    notebook = json.loads((TEACHING / f"{lesson}.ipynb").read_text())
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    cells = notebook["cells"]
    assert all(cell["id"] for cell in cells)
    assert all(not cell.get("outputs") and not cell.get("execution_count") for cell in cells)
    (parameters,) = (cell for cell in cells if tagged(cell, "parameters"))
    assert any(line.startswith("out = ") for line in parameters["source"])
    kinds = [
        next(k for k in ("exercise", "check") if tagged(c, k))
        for c in cells
        if c["metadata"].get("tags") and not tagged(c, "parameters")
    ]
    assert kinds == ["exercise", "check"] * len(ANSWERS[lesson])
    assert 2 <= len(ANSWERS[lesson]) <= 4
    text = "".join(line for cell in cells for line in cell["source"])
    assert "*Source:" in text
    assert "**Goal.**" in text


@pytest.mark.slow
@pytest.mark.parametrize("lesson", LESSONS)
def test_a_lesson_knows_right_from_wrong(lesson, tmp_path):
    executed = run(three_students(lesson), tmp_path)
    verdicts = said(executed)
    number = int(lesson[:2])
    assert len(verdicts) == 3 * len(ANSWERS[lesson])
    for k, (_, _, hint) in enumerate(ANSWERS[lesson]):
        empty, right, wrong = verdicts[3 * k : 3 * k + 3]
        assert empty.startswith(f"Exercise {number}.{k + 1}: not answered.")
        assert right.startswith(f"Exercise {number}.{k + 1}: right.")
        assert wrong.startswith(f"Exercise {number}.{k + 1}: not yet.")
        assert hint in wrong
    assert not [o for cell in executed.cells for o in cell.get("outputs", ()) if o.get("name") == "stderr"]
    pictures = sorted((tmp_path / "out").glob("*.png"))
    assert pictures
    assert all(picture.stat().st_size > 5_000 for picture in pictures)


@pytest.mark.slow
def test_a_teacher_gives_answers_as_parameters(tmp_path):
    notebook = nbformat.read(TEACHING / "03_star_centers.ipynb", as_version=4)
    right = [answers[0] for answers in ANSWERS["03_star_centers"]]
    executed = run(notebook, tmp_path, answers={"3.1": right[0], "3.3": 1.0, "3.4": [2.0, 4.0]}, trials=16)
    states = [words.split(": ")[1].split(".")[0] for words in said(executed)]
    assert states == ["right", "not answered", "not yet", "right"]
    kept = json.loads((tmp_path / "out/verdicts.json").read_text())
    assert kept["right"] == 2
    assert [row["state"] for row in kept["exercises"]] == states

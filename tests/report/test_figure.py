"""The summary figure of simulated frames: there, large enough, with marks in it, and whole or not at all."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from opnav_workbench.errors import SessionError
from opnav_workbench.kernels import KernelSet
from opnav_workbench.rehearsal import (
    DEMO_CATALOG,
    DEMO_KERNELS,
    DEMO_TARGETS,
)
from opnav_workbench.report import summary_figure, write_summary
from opnav_workbench.report.scales import round_scale
from opnav_workbench.session import ImageSession

PREDICTED, OBSERVED, BODY = "#F0E442", "#56B4E9", "#CC79A7"


@pytest.fixture(scope="module")
def pictures(demo_truths):
    with KernelSet(DEMO_KERNELS):
        yield [truth.picture for truth in demo_truths]


@pytest.fixture
def opened(pictures) -> ImageSession:
    return ImageSession.open(pictures[0], "new_horizons", catalog=DEMO_CATALOG)


def process(session: ImageSession) -> ImageSession:
    for name in DEMO_TARGETS:
        session.add_target(name)
    session.predict()
    session.find_stars()
    session.repoint()
    for name in DEMO_TARGETS:
        session.find_body(name)
    session.observables()
    return session


@pytest.fixture(scope="module")
def processed(pictures) -> list[ImageSession]:
    return [process(ImageSession.open(p, "new_horizons", catalog=DEMO_CATALOG)) for p in pictures]


def pixels_of(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        assert image.format == "PNG"
        return np.asarray(image.convert("RGB"), dtype=float)


def share_of(pixels: np.ndarray, color: str) -> float:
    """Share of the figure's pixels in a color."""
    return float((np.abs(pixels - 255.0 * np.array(to_rgb(color))).max(axis=-1) < 20.0).mean())


@pytest.mark.slow
@pytest.mark.parametrize("camera", [0, 1], ids=["square", "strip"])
def test_summary_shows_the_processed_frame(processed, tmp_path, camera):
    path = tmp_path / "new folder" / "summary.png"
    write_summary(processed[camera], path)
    pixels = pixels_of(path)
    assert pixels.shape[1] > 800
    assert pixels.shape[0] > 600
    assert pixels.std() > 20.0  # of 255: a blank page has 0
    # One mark of the legend is some 30 pixels, 2.5e-5 of the page; the picture holds several of each kind.
    assert min(share_of(pixels, color) for color in (PREDICTED, OBSERVED, BODY)) > 7e-5
    assert [p.name for p in path.parent.iterdir()] == ["summary.png"]


@pytest.mark.slow
def test_title_and_plots_hold_the_solution(processed):
    session = processed[0]
    drawn = summary_figure(session)
    title, pointing = drawn.get_suptitle(), session.state.pointing
    assert "lorri_4x4.fit" in title
    assert f"{pointing.n_stars} stars, rms {pointing.rms_px:.3f} px" in title
    assert f"RA {np.degrees(pointing.ra_rad):.5f}°" in title
    picture, vectors, before, after = drawn.axes
    assert {text.get_text() for text in picture.texts} == {"PLUTO", "CHARON"}
    assert vectors.get_title().startswith("residuals, observed − predicted")
    medians = [np.median(np.abs(spread_of(axes)), axis=1) for axes in (before, after)]
    delta = np.abs([pointing.delta_pixel, pointing.delta_line])
    # Before, stars are off by the pointing error (the twist of 0.15 deg adds up to 0.5 px); after, by noise.
    assert medians[0] == pytest.approx(delta, abs=0.5)
    assert (medians[1] < 0.1).all()


def spread_of(axes) -> np.ndarray:
    """Residuals (2, n) of pixel and line, as drawn."""
    return np.array([container.lines[0].get_ydata() for container in axes.containers])


def test_vectors_are_residuals_at_the_stars_in_picture_sense(processed):
    session = processed[0]
    axes = summary_figure(session).axes[1]
    (arrows,) = [c for c in axes.collections if hasattr(c, "U")]
    pointing = session.state.pointing
    scale = float(axes.get_title().split("×")[1])
    drawn = np.column_stack([arrows.U, arrows.V]) / scale
    assert drawn == pytest.approx(pointing.residual_px[pointing.used], abs=1e-9)
    places = session.state.centers.pixel_line[pointing.used] - pointing.residual_px[pointing.used]
    assert np.column_stack([arrows.X, arrows.Y]) == pytest.approx(places, abs=1e-6)
    assert axes.yaxis_inverted()  # lines run down, as in the picture


def test_strip_is_cut_into_four_rows_without_a_gap(processed):
    pictures = summary_figure(processed[1]).axes[:4]
    edges = [axes.get_xlim() for axes in pictures]
    n_pixel = processed[1].context.camera.n_pixel
    assert edges[0][0] == -0.5
    assert edges[3][1] == n_pixel - 0.5
    assert [left for left, _ in edges[1:]] == [right for _, right in edges[:3]]


@pytest.mark.slow
def test_each_stage_of_a_session_can_be_drawn(opened, tmp_path):
    stages = {
        "opened": lambda: None,
        "predicted": opened.predict,
        "found": opened.find_stars,
    }
    shares = {}
    for name, step in stages.items():
        step()
        write_summary(opened, tmp_path / f"{name}.png")
        pixels = pixels_of(tmp_path / f"{name}.png")
        assert pixels.shape[1] > 800
        shares[name] = [share_of(pixels, color) for color in (PREDICTED, OBSERVED)]
        drawn = summary_figure(opened)
        assert drawn.get_suptitle().endswith("pointing not determined")
        assert drawn.axes[1].get_title() == "residual vectors: no pointing"
    # The legend shows one of each in every figure; stars come on top, first predicted, then observed ones.
    assert shares["predicted"][0] > 2.0 * shares["opened"][0] > 0.0
    assert shares["found"][1] > 2.0 * shares["predicted"][1] > 0.0


@pytest.mark.parametrize(
    ("scale", "rounded"), [(1.0, 1.0), (1.99, 1.0), (2.0, 2.0), (49.9, 20.0), (0.73, 0.5)]
)
def test_vector_scale_is_round_and_never_larger(scale, rounded):
    assert round_scale(scale) == pytest.approx(rounded, rel=1e-12)


def test_a_folder_that_cannot_be_written_is_one_line(processed, tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(SessionError, match=r"summary\.png") as caught:
        write_summary(processed[0], tmp_path / "file" / "summary.png")
    assert "\n" not in str(caught.value)


def test_a_full_disk_leaves_the_older_figure(processed, tmp_path, monkeypatch):
    path = tmp_path / "summary.png"
    path.write_bytes(b"older")

    write_bytes = Path.write_bytes

    def half_written(self, data):
        write_bytes(self, data[:100])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", half_written)
    with pytest.raises(SessionError, match="No space left"):
        write_summary(processed[0], path)
    assert path.read_bytes() == b"older"
    assert [p.name for p in tmp_path.iterdir()] == ["summary.png"]


def test_a_rename_that_fails_leaves_the_older_figure(processed, tmp_path, monkeypatch):
    path = tmp_path / "summary.png"
    path.write_bytes(b"older")

    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(SessionError, match="Permission denied"):
        write_summary(processed[0], path)
    assert path.read_bytes() == b"older"
    assert [p.name for p in tmp_path.iterdir()] == ["summary.png"]

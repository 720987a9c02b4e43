"""Figures of body centers: made of centers with known numbers, so that what they show can be read back."""

from collections.abc import Iterator

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.patches import Ellipse

from opnav_workbench.bodies import BodyCenter, BodyFlag, BodyResiduals
from opnav_workbench.bodies.results import LimbScans
from opnav_workbench.errors import SessionError
from opnav_workbench.kernels import KernelSet
from opnav_workbench.rehearsal import DEMO_CATALOG, DEMO_KERNELS
from opnav_workbench.report import body_figure, difference_figure, methods_figure, scan_figure, write_body
from opnav_workbench.session import ImageSession

CENTER, RADIUS = np.array([120.4, 81.7]), 18.0
WINDOW = (90, 50, 61, 63)
N_SCANS, USED, REJECTED = 36, (20, 22, 24, 26, 28), 25


def disk(center: np.ndarray) -> np.ndarray:
    line, pixel = np.mgrid[WINDOW[1] : WINDOW[1] + WINDOW[3], WINDOW[0] : WINDOW[0] + WINDOW[2]]
    return 500.0 * np.clip(RADIUS + 0.5 - np.hypot(pixel - center[0], line - center[1]), 0.0, 1.0)


def scans() -> LimbScans:
    angle, distance = 2.0 * np.pi * np.arange(N_SCANS) / N_SCANS, np.arange(0.0, 24.1, 0.5)
    along = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    light = np.tile(500.0 * np.clip(RADIUS + 0.5 - distance, 0.0, 1.0), (N_SCANS, 1))
    lag = np.arange(-5.0, 5.1, 0.5)
    status = np.full(N_SCANS, "not_chosen", dtype="U12")
    status[list(USED)], status[REJECTED] = "used", "rejected"
    full = lambda value: np.full(N_SCANS, value)  # noqa: E731
    return LimbScans(
        start_px=CENTER,
        angle_rad=angle,
        distance_px=distance,
        places_px=CENTER + distance[:, None] * along[:, None, :],
        data_dn=light,
        model_dn=light,
        limb_px=full(RADIUS),
        edge_px=full(RADIUS),
        correlation=np.tile(np.exp(-0.5 * lag**2), (N_SCANS, 1)),
        lag_px=lag,
        offset_px=full(0.01),
        sigma_px=full(0.05),
        motion=along,
        brightness=full(1.0),
        unevenness=full(0.02),
        residual_px=full(0.01),
        status=status,
        reason=np.full(N_SCANS, "lit limb"),
        roughness=0.1,
        iterations=((0.0, 0.0),),
    )


def found(method: str, off: tuple[float, float], sigma: tuple[float, float], **more: object) -> BodyCenter:
    place = CENTER + off
    data, model = disk(CENTER), disk(place)
    mask = np.ones_like(data, dtype=bool)
    mask[30:34, 30:34] = False
    return BodyCenter(
        "PLUTO",
        method,
        "ok",
        place,
        np.diag(np.square(sigma)),
        pictures=BodyResiduals(WINDOW, data, model, data - model, mask),
        **more,
    )


CENTERS = {
    "full disk": found("least_squares", (0.9, -0.4), (0.5, 0.25)),
    "limb scan": found("limb_scan", (0.02, 0.01), (0.02, 0.03), detail=scans()),
}


@pytest.fixture
def words():
    def read(figure) -> str:
        figure.canvas.draw()
        return "\n".join(t.get_text() for t in figure.findobj(lambda a: hasattr(a, "get_text")))

    return read


def clipped(figure) -> float:
    """By how many inches what is drawn leaves the page."""
    figure.canvas.draw()
    drawn, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
    return max(-drawn.x0, -drawn.y0, drawn.x1 - width, drawn.y1 - height)


# -- one method ------------------------------------------------------------------------------------------------------


def test_three_panels_hold_data_model_and_difference():
    center = CENTERS["full disk"]
    panels = body_figure(center).axes[:3]
    for axes, expected in zip(panels, ("data_dn", "model_dn", "difference_dn"), strict=True):
        image = axes.images[0]
        np.testing.assert_array_equal(image.get_array(), getattr(center.pictures, expected))
        assert image.get_extent() == [89.5, 150.5, 112.5, 49.5]  # pixel and line of the detector
        low, high = image.get_clim()
        assert image.norm((low + high) / 2.0) == pytest.approx(0.5)  # linear
    assert panels[0].images[0].get_clim() == panels[1].images[0].get_clim()
    low, high = panels[2].images[0].get_clim()
    assert low == -high < 0.0


@pytest.mark.slow
def test_ellipse_is_enlarged_by_what_the_legend_says(words):
    figure = body_figure(CENTERS["full disk"])
    (ellipse,) = [p for p in figure.axes[0].patches if isinstance(p, Ellipse)]
    # 0.15 of 61 px is 9.15 px: 18.3 sigmas of 0.5 px, so 10 times.
    assert "drawn 10 × larger" in words(figure)
    assert (ellipse.width, ellipse.height) == pytest.approx((2 * 10 * 0.5, 2 * 10 * 0.25))
    assert ellipse.angle % 180.0 == pytest.approx(0.0)
    assert ellipse.center == pytest.approx(CENTER + np.array([0.9, -0.4]))


def test_title_says_numbers_messages_and_flags(words):
    center = found(
        "cross_correlation",
        (0, 0),
        (0.1, 0.1),
        messages=("its surface is mottled",),
        flags=int(BodyFlag.OCCULTED),
    )
    text = words(body_figure(center))
    for expected in (
        "PLUTO, cross-correlation: ok",
        "pixel 120.400 ± 0.100",
        "surface is mottled",
        "hides part of it",
    ):
        assert expected in text


def test_pixels_not_used_are_veiled():
    veil = body_figure(CENTERS["full disk"]).axes[2].images[1].get_array()
    assert np.isfinite(np.asarray(veil)).sum() == 16


def test_covariance_axes_turn_with_the_ellipse():
    turn = np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])
    base = CENTERS["full disk"]
    center = BodyCenter(
        "A", "ellipse", "ok", CENTER, turn @ np.diag([0.04, 0.01]) @ turn.T, pictures=base.pictures
    )
    (ellipse,) = [p for p in body_figure(center).axes[0].patches if isinstance(p, Ellipse)]
    assert np.radians(ellipse.angle) % np.pi == pytest.approx(0.5)
    assert ellipse.width / ellipse.height == pytest.approx(2.0)


def test_no_pictures_is_one_line_with_the_remedy():
    lost = BodyCenter.without_center("CHARON", "limb_scan", "off_detector", "it lies off the detector")
    for draw in (body_figure, scan_figure):
        with pytest.raises(SessionError, match=r"CHARON.*limb_scan.*off_detector.*find_body"):
            draw(lost)
    with pytest.raises(SessionError, match="find_body"):
        methods_figure({"limb scan": lost})
    with pytest.raises(SessionError, match="find_body"):
        difference_figure({"limb scan": lost})


# -- scans -----------------------------------------------------------------------------------------------------------


def test_scans_differ_by_colour_and_dashes():
    picture = scan_figure(CENTERS["limb scan"]).axes[0]
    drawn = [c for c in picture.collections if isinstance(c, LineCollection)]
    assert sorted(len(c.get_segments()) for c in drawn) == [1, len(USED), N_SCANS - len(USED) - 1]
    assert len({tuple(c.get_color()[0]) for c in drawn}) == 3
    assert len({str(c.get_linestyle()) for c in drawn}) == 3
    used = next(c for c in drawn if len(c.get_segments()) == len(USED))
    # Scan 20 of 36 leaves the center at 200 degrees from +pixel toward +line and is drawn to its end.
    end = CENTER + 24.0 * np.array([np.cos(np.radians(200.0)), np.sin(np.radians(200.0))])
    np.testing.assert_allclose(used.get_segments()[0][1], end, atol=1e-9)


@pytest.mark.slow
def test_plotted_scans_are_those_asked_for_and_bold(words):
    figure = scan_figure(CENTERS["limb scan"], numbers=[25, 3])
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert [label for label in labels if label.startswith("scan ")] == ["scan 25", "scan 3"]
    bold = {t.get_text() for t in figure.axes[0].texts if t.get_fontweight() == "bold"}
    assert bold == {"25", "3"}
    text = words(figure)
    assert "5 used, 30 not chosen, 1 rejected" in text
    assert "+0.010 ± 0.050" in text


def test_without_a_choice_the_plotted_ones_are_used_scans():
    figure = scan_figure(CENTERS["limb scan"])
    labels = [a.get_ylabel() for a in figure.axes if a.get_ylabel().startswith("scan ")]
    assert labels == [f"scan {number}" for number in USED]


def test_a_scan_that_does_not_exist_and_a_center_without_scans():
    with pytest.raises(SessionError, match=r"no limb scan \[36\]; they are numbered 0 to 35"):
        scan_figure(CENTERS["limb scan"], numbers=[36])
    with pytest.raises(SessionError, match="no limb scans to show"):
        scan_figure(CENTERS["full disk"])


# -- methods side by side --------------------------------------------------------------------------------------------


def test_centers_stand_where_they_are_off_the_truth(words):
    figure = methods_figure(CENTERS, truth_px=CENTER)
    whole, close = figure.axes[:2]
    for axes in (whole, close):
        ellipses = [p for p in axes.patches if isinstance(p, Ellipse)]
        assert [e.center for e in ellipses] == [pytest.approx((0.9, -0.4)), pytest.approx((0.02, 0.01))]
        assert sorted((ellipses[0].width, ellipses[0].height)) == pytest.approx(
            [0.5, 1.0]
        )  # 1 sigma, both sides
        assert axes.get_ylim()[0] > axes.get_ylim()[1]  # lines count downward
        assert len({line.get_marker() for line in axes.lines}) == 3
    assert close.get_title() == "close to limb scan"
    assert np.diff(close.get_xlim())[0] == pytest.approx(2 * 5 * 0.03)
    left, right = whole.get_xlim()
    assert left < 0.0 < 0.9 + 0.5 < right
    assert "pixel +0.900 ± 0.500, line -0.400 ± 0.250" in words(figure)


def test_differences_share_one_stretch():
    figure = difference_figure(CENTERS, truth_px=CENTER)
    panels = [axes for axes in figure.axes if axes.images]
    assert len({axes.images[0].get_clim() for axes in panels}) == 1
    assert panels[0].get_title() == "full disk: off by +0.900, -0.400 px"


@pytest.mark.slow
def test_nothing_leaves_the_page():
    for figure in (
        body_figure(CENTERS["full disk"], truth_px=CENTER),
        scan_figure(CENTERS["limb scan"]),
        methods_figure(CENTERS, truth_px=CENTER),
        difference_figure(CENTERS),
    ):
        assert clipped(figure) < 0.01


# -- from a session --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def session(demo_truths) -> Iterator[ImageSession]:
    with KernelSet(DEMO_KERNELS):
        made = ImageSession.open(demo_truths[0].picture, "new_horizons", catalog=DEMO_CATALOG)
        made.predict()
        made.find_stars()
        made.repoint()
        made.find_body("PLUTO", "cross_correlation")
        made.find_body("PLUTO", "least_squares")
        yield made


@pytest.mark.slow
def test_session_gives_prediction_limb_and_circle(session, words, tmp_path):
    figure = body_figure(session, "PLUTO", "least_squares")
    text = words(figure)
    for expected in ("observed − predicted", "limb of the model", "predicted center", session.inputs.utc):
        assert expected in text
    (limb,) = [line for line in figure.axes[0].lines if len(line.get_xdata()) > 10]
    expected = session.predict_body("PLUTO")
    across = np.ptp(np.asarray(limb.get_xdata(), dtype=float))
    assert across == pytest.approx(expected.diameter_px, rel=0.02)
    middle = np.mean(limb.get_xydata()[:-1], axis=0)
    np.testing.assert_allclose(middle, session.state.bodies[-1].pixel_line, atol=0.01)
    write_body(session, tmp_path / "new" / "pluto.png", "PLUTO")
    assert (tmp_path / "new" / "pluto.png").read_bytes().startswith(b"\x89PNG")
    session.set_circle("PLUTO", (10.0, 12.0), 4.0)
    assert "analyst's circle" in words(body_figure(session, "PLUTO"))
    session.undo()


@pytest.mark.slow
def test_methods_of_a_session_are_those_it_has(session):
    labels = methods_figure(session).legends[0].get_texts()
    assert [text.get_text().split(" (")[0] for text in labels] == ["cross-correlation", "least squares"]


def test_center_that_nobody_found(session):
    with pytest.raises(SessionError, match=r"no center of CHARON \(ellipse\).*PLUTO \(least_squares\)"):
        body_figure(session, "CHARON", "ellipse")
    with pytest.raises(SessionError, match="no center of PLUTO"):
        scan_figure(session, "PLUTO")

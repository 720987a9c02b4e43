"""What may befall a body: off the picture, cut, saturated, hidden, absent, of another size, without pixels."""

import numpy as np
import pytest

from opnav_workbench.bodies import (
    BodyFlag,
    BodyResiduals,
    Circle,
    JointCenters,
    choose_method,
    choose_subarray,
    describe_body_flags,
    displaced_model,
    find_cross_correlation,
    find_jointly,
    find_least_squares,
    model_picture,
)
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.render import FigureUncertainty, focal_plane

FINDERS = [find_cross_correlation, find_least_squares]
TRUE = np.array([480.3, 530.7])
BEFORE = TRUE + np.array([19.0, 8.0])
APART = TRUE + np.array([200.0, -90.0])


def within_sigmas(found, true=TRUE, sigmas=4.5):
    return np.all(np.abs(found.pixel_line - true) < sigmas * np.sqrt(np.diag(found.covariance_px2)))


@pytest.mark.parametrize("finder", FINDERS)
def test_no_body_in_the_circle(body_stage, finder):
    rng = np.random.default_rng(1)
    model = body_stage.body(60.0, 40.0, TRUE)
    picture = body_stage.picture(np.zeros((1024, 1024)), [model], rng)
    found = finder(picture, "BODY", circle=Circle(TRUE, 30.0))
    assert (found.status, found.pixel_line) == ("not_detected", None)
    assert "nothing of its size and phase stands out of the sky within 15 px" in found.messages[0]


@pytest.mark.parametrize("finder", FINDERS)
def test_bright_star_in_the_circle_is_no_body(body_stage, finder):
    model, star = body_stage.body(60.0, 40.0, TRUE), body_stage.body(0.2, 0.0, TRUE + 4.0)
    picture = body_stage.picture(body_stage.light(star), [model], np.random.default_rng(2), peak_dn=20000.0)
    found = finder(picture, "BODY")
    assert found.status == "not_detected"
    assert "nothing of its size and phase" in found.messages[0]


@pytest.mark.slow
@pytest.mark.parametrize("finder", FINDERS)
@pytest.mark.parametrize("factor", [0.7, 1.4])
def test_wrong_radius(body_stage, finder, factor):
    """Farther off than three times the 10 % that nobody has stated; the center is that of the disk as it is."""
    light = body_stage.light(body_stage.body(60.0, 40.0, TRUE))
    expected = body_stage.body(60.0 * factor, 40.0, TRUE)
    found = finder(body_stage.picture(light, [expected], np.random.default_rng(3)), "BODY")
    assert found.status == "uncertain"
    assert found.flags & BodyFlag.CIRCLE_MISFIT
    word = "larger" if factor < 1.0 else "smaller"
    assert any(word in message for message in found.messages)
    assert within_sigmas(found)


@pytest.mark.slow(keep=["0.1"])
@pytest.mark.parametrize("size_sigma", [0.1, 0.005])
def test_known_surface_of_another_size(body_stage, size_sigma):
    """Where the disk is not asked, the crossings of its limb tell the size; the center goes with the model's."""
    light = body_stage.light(body_stage.body(60.0, 40.0, TRUE))
    expected = body_stage.body(50.0, 40.0, TRUE, figure=FigureUncertainty(size_sigma=size_sigma))
    picture = body_stage.picture(light, [expected], np.random.default_rng(3))
    found = find_least_squares(picture, "BODY", known_surface=True)
    assert found.second is None
    assert found.flags & BodyFlag.CIRCLE_MISFIT
    solved = find_least_squares(picture, "BODY", known_surface=True, solve_range=True)
    assert solved.status == "ok"
    assert within_sigmas(solved)


@pytest.mark.slow
@pytest.mark.parametrize("finder", FINDERS)
def test_a_size_that_was_stated_wrongly(body_stage, finder):
    """7 % larger than what is stated to 0.5 %: 2 px off by the stated size, which the limb's crossings contradict."""
    light = body_stage.light(body_stage.body(60.0, 40.0, TRUE))
    expected = body_stage.body(56.0, 40.0, TRUE, figure=FigureUncertainty(size_sigma=0.005))
    found = finder(body_stage.picture(light, [expected], np.random.default_rng(3)), "BODY")
    assert found.status == "uncertain"
    assert found.flags & BodyFlag.CIRCLE_MISFIT
    assert "it is 7 % larger" in " ".join(found.messages)
    np.testing.assert_allclose(found.pixel_line, TRUE, rtol=0, atol=0.1)


@pytest.mark.slow
def test_a_circle_of_another_size_leads_nowhere_else(body_stage):
    """A circle is where to begin from; the disk tells its size."""
    model = body_stage.body(60.0, 40.0, TRUE)
    picture = body_stage.picture(body_stage.light(model), [model], np.random.default_rng(4))
    centers = [find_least_squares(picture, "BODY", circle=Circle(TRUE + 2.0, r)) for r in (21.0, 30.0)]
    assert [center.status for center in centers] == ["ok", "ok"], centers[0].messages
    assert all(within_sigmas(center) for center in centers)
    np.testing.assert_allclose(centers[0].pixel_line, centers[1].pixel_line, rtol=0, atol=0.005)


@pytest.mark.slow(keep=["true1-find_least_squares", "true2-find_cross_correlation"])
@pytest.mark.parametrize("finder", FINDERS)
@pytest.mark.parametrize("true", [(12.4, 500.2), (1015.7, 1010.1), (-9.6, 300.0)])
def test_cut_by_the_edge(body_stage, finder, true):
    model = body_stage.body(60.0, 40.0, true)
    picture = body_stage.picture(
        body_stage.light(model), [model], np.random.default_rng(5), offset_px=(3.0, -2.0)
    )
    found = finder(picture, "BODY")
    assert found.flags & BodyFlag.CUT_BY_EDGE
    assert found.status == "ok"  # its disk has a center of its own, and they agree
    assert "off the detector" in found.messages[0]
    assert found.second.difference_sigmas < 3.5
    assert within_sigmas(found, true)
    assert np.abs(found.pixel_line - true).max() < 0.05


@pytest.mark.parametrize("finder", FINDERS)
def test_off_the_detector(body_stage, finder):
    model = body_stage.body(20.0, 40.0, (500.0, 500.0))
    picture = body_stage.picture(body_stage.light(model), [model], offset_px=(-600.0, 0.0))
    found = finder(picture, "BODY")
    assert (found.status, found.pixel_line) == ("off_detector", None)
    assert "off the 1024 x 1024 detector" in found.messages[0]


@pytest.mark.slow(keep=["find_least_squares"])
@pytest.mark.parametrize("finder", FINDERS)
def test_saturated(body_stage, finder):
    model, rng = body_stage.body(60.0, 40.0, TRUE), np.random.default_rng(6)
    data = 3000.0 * body_stage.light(model)
    data += rng.normal(size=data.shape) * np.sqrt(9.0 + data / 22.0)

    def clipped(level):
        return body_stage.picture(None, [model], data=np.minimum(data, level), saturated=data >= level)

    found = finder(clipped(150.0), "BODY")
    assert (found.status, found.pixel_line) == ("saturated", None)
    assert "shorter exposure" in found.messages[0]
    part = finder(clipped(2700.0), "BODY")
    assert part.flags & BodyFlag.OVEREXPOSED
    assert within_sigmas(part)


@pytest.mark.parametrize("finder", FINDERS)
def test_nan_area(body_stage, finder):
    model, rng = body_stage.body(60.0, 40.0, TRUE), np.random.default_rng(7)
    light = body_stage.light(model)
    data = 1200.0 * light + rng.normal(0.0, 3.0, light.shape)
    half = data.copy()
    half[:, :480] = np.nan
    found = finder(body_stage.picture(None, [model], data=half), "BODY")
    assert found.flags & BodyFlag.BAD_PIXELS
    assert found.second is not None
    assert within_sigmas(found)
    data[400:660, 350:610] = np.nan
    found = finder(body_stage.picture(None, [model], data=data), "BODY")
    assert (found.status, found.pixel_line) == ("failed", None)
    assert "no usable pixels" in found.messages[0]


@pytest.mark.slow
def test_thin_crescent(body_stage):
    model = body_stage.body(20.0, 160.0, TRUE)
    found = find_least_squares(body_stage.picture(body_stage.light(model), [model]), "BODY")
    assert found.flags & BodyFlag.THIN_CRESCENT
    assert found.status == "uncertain"


@pytest.fixture(scope="module")
def pair(body_stage):
    """A large body and a nearer, smaller one before its limb."""
    large = body_stage.body(40.0, 30.0, TRUE, name="PLUTO")
    small = body_stage.body(20.0, 30.0, BEFORE, name="CHARON", range_share=0.3)
    return large, small


@pytest.mark.slow
def test_joint_centers_and_their_correlation(body_stage, pair, add_noise):
    rng, light = np.random.default_rng(8), body_stage.light(*pair)
    true = np.concatenate([TRUE, BEFORE])
    errors = []
    for _ in range(4):
        picture = body_stage.picture(light, pair, data=add_noise(900.0 * light, rng), offset_px=(4.0, -3.0))
        joint = find_jointly(picture, ("PLUTO", "CHARON"))
        assert [c.status for c in joint.centers] == ["ok", "ok"], joint.centers[0].messages
        error = np.concatenate([c.pixel_line for c in joint.centers]) - true
        errors.append(error @ np.linalg.solve(joint.covariance_px2, error))
    assert 0.8 < np.mean(errors) < 9.0  # 4 expected, 4 trials: 3 sigma
    pluto = joint.center("PLUTO")
    assert pluto.flags & BodyFlag.OCCULTED
    np.testing.assert_array_equal(joint.covariance_px2[:2, :2], pluto.covariance_px2)
    assert np.all(np.linalg.eigvalsh(joint.covariance_px2) > 0.0)
    # The edge that one cuts into the other ties their errors; what their disks differ by is of each alone.
    known = find_jointly(picture, ("PLUTO", "CHARON"), known_surfaces=("PLUTO", "CHARON"))
    assert np.abs(known.correlation[:2, 2:]).max() > 0.03
    assert np.all(np.diag(known.covariance_px2) < np.diag(joint.covariance_px2))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("apart_px", "range_share", "sigma_px"), [(2.0, 1.0, 0.1), (-8.0, 1.5, 0.2), (-14.0, 1.5, 0.8)]
)
def test_smaller_bodies_are_found_by_the_shift_of_the_largest(body_stage, apart_px, range_share, sigma_px):
    """Beside the limb or behind it, farther from its prediction than it is wide; what is hidden is less sure."""
    beside = TRUE + np.array([0.6, -0.8]) * (30.0 + 10.0 + apart_px)
    large = body_stage.body(60.0, 50.0, TRUE, name="PLUTO")
    small = body_stage.body(20.0, 50.0, beside, name="CHARON", range_share=range_share)
    picture = body_stage.picture(
        body_stage.light(large, small), (large, small), np.random.default_rng(10), offset_px=(25.0, 18.0)
    )
    pluto, charon = find_jointly(picture, ("CHARON", "PLUTO")).centers[::-1]
    assert pluto.status == "ok", pluto.messages
    # Of which 93 % are hidden, that may be uncertain.
    assert charon.status in ("ok", "uncertain" if apart_px < -10.0 else "ok"), charon.messages
    assert np.hypot(*(charon.pixel_line - beside)) < 0.1
    assert np.sqrt(charon.covariance_px2.diagonal().max()) < sigma_px
    assert bool(charon.flags & BodyFlag.OCCULTED) == (apart_px < 0.0)
    np.testing.assert_allclose(pluto.pixel_line, TRUE, rtol=0, atol=0.01)
    np.testing.assert_allclose(charon.pixel_line, beside, rtol=0, atol=0.02)


@pytest.mark.slow
def test_renderings_and_pixels_of_a_joint_fit_grow_as_its_bodies_do(body_stage, monkeypatch):
    counts = []
    draw = focal_plane.draw_body_light
    monkeypatch.setattr(focal_plane, "draw_body_light", lambda *a: counts.append(1) or draw(*a))
    largest = (
        2.0 * (8.0 + 60.0)
    ) ** 2  # px: a body, its PSF and the sky beside it, not the frame they are spread over

    def drawn(n):
        places = [(150.0 + 200.0 * (i % 4), 200.0 + 200.0 * (i // 4)) for i in range(n)]
        models = [body_stage.body(16.0, 30.0, place, name=f"B{i}") for i, place in enumerate(places)]
        light = body_stage.light(*models)
        picture = body_stage.picture(light, models, np.random.default_rng(2), offset_px=(3.0, 2.0))
        counts.clear()
        joint = find_jointly(picture, [f"B{i}" for i in range(n)])
        assert all(center.status == "ok" for center in joint.centers)
        assert all(center.pictures.data_dn.size < largest for center in joint.centers)
        np.testing.assert_array_equal(joint.covariance_px2[:2, 2:], 0.0)
        return len(counts)

    assert drawn(8) <= 4 * drawn(2) + 2


@pytest.mark.slow
def test_joint_centers_of_bodies_apart(body_stage):
    models = [
        body_stage.body(60.0, 30.0, TRUE, name="PLUTO"),
        body_stage.body(30.0, 30.0, APART, name="CHARON"),
        body_stage.body(9.0, 30.0, (900.0, 900.0), name="NIX"),
    ]
    light = body_stage.light(*models[:2])
    joint = find_jointly(
        body_stage.picture(light, models, np.random.default_rng(9), offset_px=(8.0, 5.0)),
        ("CHARON", "NIX", "PLUTO"),
    )
    assert [c.name for c in joint.centers] == ["CHARON", "NIX", "PLUTO"]
    assert joint.center("NIX").status == "not_detected"
    assert np.isnan(joint.covariance_px2[2:4]).all()
    np.testing.assert_allclose(joint.center("PLUTO").pixel_line, TRUE, atol=0.015)
    np.testing.assert_allclose(joint.center("CHARON").pixel_line, APART, atol=0.015)
    assert np.abs(joint.correlation[:2, 4:]).max() < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("finder", FINDERS)
def test_one_body_before_another(body_stage, pair, finder):
    picture = body_stage.picture(
        body_stage.light(*pair), pair, np.random.default_rng(10), offset_px=(2.0, 1.0)
    )
    found = finder(picture, "PLUTO")
    assert found.flags & BodyFlag.OCCULTED
    assert np.abs(found.pixel_line - TRUE).max() < 0.03


def test_pieces(body_stage):
    model = body_stage.body(60.0, 30.0, TRUE)
    picture = body_stage.picture(body_stage.light(model), [model])
    np.testing.assert_allclose(picture.center_px("BODY"), TRUE, atol=1e-6)
    assert picture.diameter_px("BODY") == pytest.approx(60.0, abs=0.05)
    moved = displaced_model(picture, "BODY", (100.2, 900.9), 1.5)
    assert moved.target.range_km == pytest.approx(1.5 * model.target.range_km)
    again = body_stage.picture(None, [moved], data=picture.signal_dn)
    np.testing.assert_allclose(again.center_px("BODY"), (100.2, 900.9), atol=1e-6)
    assert again.diameter_px("BODY") == pytest.approx(40.0, abs=0.3)  # the distortion there is another
    part = choose_subarray(picture, "BODY", Circle((5.0, 500.0), 30.0))
    assert part.clipped
    assert part.window[0] == 0
    assert picture.signal_dn[part.slices].shape == part.window[3:1:-1]
    window = choose_subarray(picture, "BODY").window
    light = model_picture(picture, window, {"BODY": TRUE})
    shown = picture.signal_dn[choose_subarray(picture, "BODY").slices]
    np.testing.assert_allclose(light / light.max(), shown / shown.max(), atol=1e-3)


def test_bad_input_is_refused(body_stage):
    model = body_stage.body(60.0, 30.0, TRUE)
    picture = body_stage.picture(body_stage.light(model), [model])
    with pytest.raises(CenterfindingError, match="no model of 'NIX' in this picture; it has BODY"):
        find_least_squares(picture, "NIX")
    with pytest.raises(CenterfindingError, match="give a list of different names"):
        find_jointly(picture, ("BODY", "BODY"))
    with pytest.raises(CenterfindingError, match="radius is -3"):
        Circle((1.0, 2.0), -3.0)
    with pytest.raises(CenterfindingError, match="center is"):
        Circle((np.nan, 2.0), 3.0)
    with pytest.raises(CenterfindingError, match=r"shape \(5, 5\)"):
        body_stage.picture(None, [model], data=np.zeros((5, 5)))
    with pytest.raises(CenterfindingError, match="two bodies"):
        body_stage.picture(picture.signal_dn, [model, model])
    with pytest.raises(CenterfindingError, match="joint covariance"):
        JointCenters((), np.eye(2))


def test_flags_in_words():
    assert describe_body_flags(0) == "ok"
    assert describe_body_flags(BodyFlag.CUT_BY_EDGE | BodyFlag.OCCULTED).count(";") == 1
    assert all(describe_body_flags(flag) != "ok" for flag in BodyFlag)
    assert choose_method(np.nan) == "unresolved"
    assert choose_method(190.0, known_surface=True) == "least_squares"
    assert BodyResiduals.__slots__

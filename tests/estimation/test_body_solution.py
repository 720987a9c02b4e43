"""A body from a sequence of what pictures say: size, axes, pole, spin, center of figure; what is not observed; the PCK."""

from dataclasses import replace

import numpy as np
import pytest
import spiceypy
from body_exam import BODIES, make_sequence, map_scores, scores

from opnav_workbench.bodies import BodyPicture
from opnav_workbench.bodies.silhouette import Silhouette
from opnav_workbench.camera import Camera
from opnav_workbench.errors import EstimationError
from opnav_workbench.estimation.body import (
    BodyKnowledge,
    BodyRotation,
    BodySighting,
    BodyState,
    LandmarkReading,
    OutlineReading,
    albedo_from_pictures,
    solve_body,
    solve_body_from_pictures,
)
from opnav_workbench.estimation.body.design import outline_rows
from opnav_workbench.geometry import rotation_from_vector, tangent_basis, unit, vector_from_rotation
from opnav_workbench.kernels import KernelSet, body_periodic_terms
from opnav_workbench.landmarks.prediction import landmark_places
from opnav_workbench.psf import GaussianPsf
from opnav_workbench.render import AlbedoMap, BodyModel, FigureUncertainty
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.targets import TargetState

BENNU_ID = 2101955
EPOCH = 5.9e8
LIGHT_KM_S = 299792.458
OUTLINE_PX = np.array([0.05, 0.05, 0.05, 0.05, 0.05])  # center, then the figure's share of the radius
ATTITUDE = rotation_from_vector(np.array([0.3, -0.2, 1.1]))
TRUE = BodyRotation(1.5, -1.05, 2.0, 4.06e-4, EPOCH)
RADII = np.array(BODIES["bennu"][0])


@pytest.fixture(scope="module")
def camera():
    return Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/lorri_1x1.yaml")


def approach(
    camera, count=14, radii=RADII, seed=3, landmarks=0, offset=(0.001, -0.002, 0.0), state=None, noise=1.0
):
    """Sightings of an approach, noise as they state it, and the correction of the state that they hold."""
    random = np.random.default_rng(seed)
    diameters = np.geomspace(30.0, 400.0, count)
    ranges = 2.0 * np.cbrt(np.prod(radii)) / (diameters * camera.pixel_scale_rad)
    speed = (ranges[0] - ranges[-1]) / 3e5
    times = EPOCH - 1.5e5 + (ranges[0] - ranges) / speed
    toward = ATTITUDE.T @ camera.boresight
    across = unit(np.cross(toward, [0.2, 0.4, 1.0]))
    state = np.array([*0.4 * across, *1e-6 * toward]) if state is None else state
    places = unit(random.normal(size=(landmarks, 3))) * radii
    sightings = []
    for k, (et, distance) in enumerate(zip(times, ranges, strict=True)):
        position = distance * toward + 0.1 * across
        turn = TRUE.body_from_j2000(et - distance / LIGHT_KM_S)
        eps = noise * 5e-7 * random.normal(size=3) * [1.0, 1.0, 30.0]
        attitude = rotation_from_vector(-eps) @ ATTITUDE  # what is believed
        figure = position + np.array(offset) @ turn
        outline = true_outline(camera, figure, turn, radii)
        radius = 0.5 * outline.diameter_px
        sigma = OUTLINE_PX / [1.0, 1.0, radius, radius, radius]
        step = noise * sigma * random.normal(size=5)
        moved = outline.strained(step[2], step[3:])
        outline = replace(moved, center_px=moved.center_px + step[:2])
        believed = position - state[:3] - (et - EPOCH) * state[3:]
        target = TargetState("BENNU", believed, radii_km=radii, body_from_j2000=turn)
        reading = OutlineReading(outline, np.diag(sigma**2), np.zeros(5), np.ones(len(outline.angle_rad)))
        covariance = np.diag((5e-7 * np.array([1.0, 1.0, 30.0])) ** 2)
        marks = (
            marked(camera, replace(target, position_km=position), places, random, noise)
            if landmarks
            else None
        )
        sightings.append(
            BodySighting(f"{k:02d}", et, target, camera, attitude, covariance, np.zeros(3), reading, marks)
        )
    return sightings, state


def true_outline(camera, position, turn, radii):
    target = TargetState(
        "BENNU", position, radii_km=radii, body_from_j2000=turn, sun_position_km=-position * 1e6
    )
    size = (camera.n_line, camera.n_pixel)
    picture = BodyPicture(
        np.zeros(size),
        1.0,
        False,
        False,
        camera,
        ATTITUDE,
        np.zeros(3),
        (BodyModel(target),),
        GaussianPsf(1.0, 1.0),
    )
    return Silhouette(picture, "BENNU").at(picture.center_px("BENNU"))


def marked(camera, target, places, random, noise):
    """Landmarks on the near side, their believed places off by a meter."""
    near = (
        places @ (target.body_from_j2000 @ -target.position_km)
        > 0.3 * np.linalg.norm(target.position_km) * 0.25
    )
    seen = landmark_places(places[near], target, camera, ATTITUDE, np.zeros(3))
    n = int(near.sum())
    wrong = 1e-3 * np.random.default_rng(9).normal(size=places.shape)
    return LandmarkReading(
        np.array([f"L{i:02d}" for i in np.flatnonzero(near)]),
        (places + wrong)[near],
        np.tile(1e-6 * np.eye(3), (n, 1, 1)),
        seen + noise * 0.1 * random.normal(size=(n, 2)),
        np.tile(0.01 * np.eye(2), (n, 1, 1)),
        np.zeros((2, 2)),
    )


def believed(pole_deg=3.0, phase_deg=5.0, spin=1e-3):
    return TRUE.turned(
        np.array([*np.radians([0.8 * pole_deg, 0.6 * pole_deg, phase_deg]), spin * TRUE.rate_rad_s])
    )


KNOWN = BodyKnowledge(position_sigma_km=0.5, velocity_sigma_km_s=1e-6)
# Where the rotation is nearly known one start is enough, and a test takes a third of the time.
NEARLY = BodyKnowledge(
    position_sigma_km=0.5,
    velocity_sigma_km_s=1e-6,
    pole_sigma_deg=3.0,
    meridian_sigma_deg=3.0,
    spin_sigma=3e-4,
)
WRONG_RADII = RADII * [1.05, 0.95, 1.05]


def test_rotation_is_spices_and_its_partials_are_slopes():
    et = EPOCH + 5432.0
    angle = TRUE.meridian_rad + TRUE.rate_rad_s * 5432.0
    spice = spiceypy.eul2m(angle, 0.5 * np.pi - TRUE.pole_dec_rad, 0.5 * np.pi + TRUE.pole_ra_rad, 3, 1, 3)
    assert np.abs(TRUE.body_from_j2000(et) - spice).max() < 1e-14
    for k, h in enumerate((1e-6, 1e-6, 1e-6, 1e-10)):
        step = np.zeros(4)
        step[k] = h
        ends = [TRUE.turned(sign * step) for sign in (1.0, -1.0)]
        turned = [vector_from_rotation(end.body_from_j2000(et) @ spice.T) for end in ends]
        assert np.allclose((turned[0] - turned[1]) / (2.0 * h), TRUE.partials(et)[:, k], rtol=1e-6, atol=2e-6)
        names = ("pole_ra_rad", "pole_dec_rad", "meridian_rad", "rate_rad_s")
        slopes = [(getattr(ends[0], name) - getattr(ends[1], name)) / (2.0 * h) for name in names]
        assert np.allclose(slopes, TRUE.angles_jacobian()[:, k], atol=1e-5)
    again = BodyRotation.from_attitudes(TRUE.body_from_j2000, EPOCH + 1e4).at_epoch(EPOCH)
    assert np.abs(again.body_from_j2000(et) - TRUE.body_from_j2000(et)).max() < 1e-10


def test_a_body_that_tumbles_is_refused():
    with pytest.raises(EstimationError, match="tumbles"):
        BodyRotation.from_attitudes(
            lambda et: rotation_from_vector(np.array([1e-3, 0.0, 1e-4]) * (et - EPOCH)), EPOCH
        )


def test_partials_of_an_outline_are_its_slopes(camera):
    """The silhouette itself is computed anew for each step: no first order in it."""
    sightings, state = approach(camera, 2, noise=0.0)
    s = sightings[-1]
    transition = np.hstack([np.eye(3), (s.et - EPOCH) * np.eye(3)])
    at = BodyState(state, RADII, TRUE, np.array([0.001, -0.002, 0.0]), 0.0, np.zeros(3), np.zeros((1, 3)), {})
    rows = outline_rows(s, s.outline, at, np.zeros(3), transition)
    sizes = [1e-3] * 3 + [1e-8] * 3 + [1e-5] * 3 + [1e-4] * 3 + [1e-9] + [1e-5] * 3 + [1e-3] + [0.0] * 3
    for k, h in enumerate(sizes[:17]):
        step = np.zeros(23)
        step[k] = h
        ends = [
            outline_rows(s, s.outline, at.moved(sign * step), np.zeros(3), transition).residual
            for sign in (1, -1)
        ]
        slope = (ends[1] - ends[0]) / (2.0 * h)
        weight = np.array([1.0, 1.0, 200.0, 200.0, 200.0])
        # Distortion changes across a disk of 400 px: by a thousandth, which no step of a solution feels.
        change, expected = weight * slope * h, weight * rows.by_shared[:, k] * h
        assert np.allclose(change, expected, rtol=1.5e-3, atol=5e-4), k


@pytest.fixture(scope="module")
def solved(camera):
    """An approach, the correction of the state that it holds, and the body that was solved from it."""
    sightings, state = approach(camera, 10)
    return sightings, state, solve_body(sightings, believed(), KNOWN, radii_km=WRONG_RADII)


def test_an_approach_tells_size_pole_spin_and_center(solved):
    _, state, solution = solved
    assert solution.converged
    axes = solution.radii_km / RADII - 1.0
    assert np.abs(axes).max() < 5e-3
    assert np.abs(axes * RADII / solution.radii_sigma_km).max() < 3.0
    assert np.arccos(solution.rotation.pole @ TRUE.pole) < np.radians(1.0)
    spin = solution.rotation.rate_rad_s - TRUE.rate_rad_s
    assert abs(spin) < 4e-4 * TRUE.rate_rad_s  # of ten outlines; 1e-4 is asked of thirty pictures
    assert abs(spin) < 3.0 * solution.spin_sigma_rad_s
    assert np.all(np.abs(solution.offset_km - [0.001, -0.002, 0.0]) < 3.0 * solution.offset_sigma_km)
    assert np.all(np.abs(solution.state.state - state) < 3.0 * np.sqrt(np.diag(solution.covariance)[:6]))
    z = [
        words for words in solution.words if words.startswith("the center of figure along z is not observed")
    ]
    assert z, "along the pole a center of figure is the trajectory's"


@pytest.mark.slow
def test_sigmas_are_true(camera):
    """Noise as stated, nothing else: 8 quantities of 6 approaches; the radii of one go together, so 1.5 and not 1.2."""
    sharp = BodyKnowledge(position_sigma_km=0.5, velocity_sigma_km_s=1e-6, meridian_sigma_deg=2.0)
    errors = []
    for seed in range(6):
        solution = solve_body(approach(camera, 8, seed=seed)[0], TRUE, sharp, radii_km=RADII)
        spin = (solution.rotation.rate_rad_s - TRUE.rate_rad_s) / solution.spin_sigma_rad_s
        axes = (solution.radii_km - RADII) / solution.radii_sigma_km
        east, north = tangent_basis(TRUE.pole_ra_rad, TRUE.pole_dec_rad)
        pole = (
            np.array([solution.rotation.pole @ east, solution.rotation.pole @ north])
            / solution.pole_sigma_rad
        )
        offset = (solution.offset_km[:2] - [0.001, -0.002]) / solution.offset_sigma_km[:2]
        errors.append([spin, *axes, *pole, *offset])
    assert 0.6 < np.sqrt(np.mean(np.square(errors))) < 1.5


@pytest.mark.slow
def test_landmarks_join_the_batch(camera):
    """With landmarks the center of figure is known against the map, and places are better than they were believed."""
    sightings, _ = approach(camera, 6, landmarks=25)
    solution = solve_body(sightings, believed(1.0, 1.0, 1e-5), NEARLY, radii_km=WRONG_RADII)
    without = solve_body([replace(s, landmarks=None) for s in sightings], believed(1.0, 1.0, 1e-5), NEARLY)
    assert solution.phase_sigma_rad < 0.5 * without.phase_sigma_rad
    turned = vector_from_rotation(solution.rotation.body_from_j2000(EPOCH) @ TRUE.body_from_j2000(EPOCH).T)
    assert np.degrees(np.linalg.norm(turned)) < 0.5
    assert sum(r.kind != "outline" and r.used for r in solution.residuals) > 40
    alone = solve_body([replace(s, outline=None) for s in sightings], believed(1.0, 1.0, 1e-5), NEARLY)
    assert "no outline was used: size, axes and center of figure stay as believed" in alone.words
    assert not any("limbs" in words or "radius" in words for words in alone.words)


@pytest.mark.slow
def test_what_a_sphere_does_not_tell_is_said(camera):
    sightings, _ = approach(camera, 8, radii=np.full(3, 0.26), offset=(0.0, 0.0, 0.0))
    words = "\n".join(
        solve_body(sightings, believed(1.0, 1.0, 1e-4), NEARLY, radii_km=np.full(3, 0.26)).words
    )
    assert "the prime meridian is hardly observed" in words or "the prime meridian is not observed" in words
    assert "the spin rate is not observed" in words


@pytest.mark.slow
def test_size_needs_a_known_speed(camera):
    """The same pictures show a larger body that is farther and faster."""
    sightings, _ = approach(camera, 8)
    loose = replace(NEARLY, position_sigma_km=1e4, velocity_sigma_km_s=1.0)
    words = "\n".join(solve_body(sightings, believed(1.0, 1.0, 1e-4), loose, radii_km=RADII).words)
    assert "the size is not observed" in words
    known = solve_body(sightings, believed(1.0, 1.0, 1e-4), NEARLY, radii_km=RADII)
    assert not any(words.startswith("the size") for words in known.words)


@pytest.mark.slow
def test_an_outline_that_does_not_fit_is_left_out_and_named(camera):
    sightings, _ = approach(camera, 7)
    bad = sightings[4].outline
    outline = replace(bad.outline, radius_px=bad.outline.radius_px * 1.1)
    sightings[4] = replace(sightings[4], outline=replace(bad, outline=outline))
    solution = solve_body(sightings, believed(1.0, 1.0, 1e-4), NEARLY, radii_km=WRONG_RADII)
    left = [r for r in solution.residuals if not r.used]
    assert [r.image for r in left] == ["04"]
    assert "sigma off" in left[0].reason
    assert np.all(np.abs(solution.radii_km - RADII) < 3.0 * solution.radii_sigma_km)


def test_nothing_and_nonsense_are_refused(camera):
    sightings, _ = approach(camera, 3)
    with pytest.raises(EstimationError, match="no pictures to solve"):
        solve_body_from_pictures([], "BENNU", TRUE)
    with pytest.raises(EstimationError, match="pole_sigma_deg is 0"):
        BodyKnowledge(pole_sigma_deg=0.0)
    singular = replace(sightings[0], attitude_covariance_rad2=np.zeros((3, 3)))
    with pytest.raises(EstimationError, match="00: the covariance of its attitude"):
        solve_body([singular], TRUE)


def test_the_pck_gives_spice_the_body_that_was_solved(solved, tmp_path):
    solution = solved[2]
    path = solution.write_pck(tmp_path / "bennu.tpc", BENNU_ID)
    try:
        spiceypy.furnsh(str(path))
        assert np.allclose(spiceypy.bodvcd(BENNU_ID, "RADII", 3)[1], solution.radii_km, rtol=1e-14)
        for et in (EPOCH - 2e5, EPOCH, EPOCH + 2e5):
            turned = spiceypy.pxform("J2000", "IAU_BENNU", et) - solution.rotation.body_from_j2000(et)
            assert np.abs(turned).max() < 1e-10
    finally:
        spiceypy.kclear()


def test_the_pck_takes_out_periodic_terms_of_another(solved, tmp_path):
    """SPICE adds the old kernel's librations to the new pole, unless the new one says that there are none."""
    solution, old = solved[2], tmp_path / "old.tpc"
    number = f"BODY{BENNU_ID}"
    old.write_text(
        f"KPL/PCK\n\\begindata\n{number}_POLE_RA = (10 0 0)\n{number}_POLE_DEC = (20 0 0)\n{number}_PM = (0 1 0)\n"
        f"{number}_NUT_PREC_ANGLES = (30 0)\n{number}_NUT_PREC_RA = (5)\n\\begintext\n"
    )
    with KernelSet(old):
        terms = body_periodic_terms(BENNU_ID)
    assert terms == {f"{number}_NUT_PREC_RA": 1}
    new = solution.write_pck(tmp_path / "new.tpc", BENNU_ID, terms)
    try:
        spiceypy.furnsh([str(old), str(new)])
        turned = spiceypy.pxform("J2000", "IAU_BENNU", EPOCH) - solution.rotation.body_from_j2000(EPOCH)
        assert np.abs(turned).max() < 1e-10
    finally:
        spiceypy.kclear()


def test_the_model_of_a_disk_is_the_solved_body(camera, solved):
    sightings, _, solution = solved
    wrong = BodyModel(
        replace(sightings[-1].target, radii_km=WRONG_RADII, sun_position_km=np.array([1e8, 0.0, 0.0]))
    )
    model = solution.model(wrong, sightings[-1])
    assert np.array_equal(model.target.radii_km, solution.radii_km)
    figure = solution.figure(FigureUncertainty(limb_roughness=0.01))
    assert figure.size_sigma < 0.01
    assert figure.axes_sigma < 0.03
    assert figure.limb_roughness == 0.01
    outline = true_outline(
        camera, model.target.position_km, model.target.body_from_j2000, model.target.radii_km
    )
    seen = sightings[-1].outline.outline
    assert np.abs(outline.radius_px - seen.radius_px).max() < 0.4


@pytest.mark.slow
def test_pictures_of_an_approach_tell_the_body():
    """A small exam: `body_exam.py` is the whole one."""
    sequence = make_sequence(
        7, "bennu", 2, (30.0, 60.0), window=256, family="uniform", contrast=1.0, position_sigma=3e-4
    )
    solution = solve_body_from_pictures(
        sequence.pictures, "BODY", sequence.believed, sequence.knowledge, radii_km=sequence.radii_km, passes=2
    )
    assert {r.image for r in solution.residuals if r.used} == {p.image for p in sequence.pictures}
    score = scores(sequence, solution)
    assert np.abs(score["axes_sigmas"]).max() < 3.0
    assert score["pole_sigmas"] < 3.4
    assert abs(score["spin_sigmas"]) < 3.0
    assert np.sort(np.abs(score["axes"]))[1] < 0.005, "two pictures see two of the axes"


@pytest.mark.slow
def test_pictures_tell_albedo_and_law_of_the_body_that_they_told(tmp_path):
    sequence = make_sequence(
        7,
        "bennu",
        4,
        (40.0, 80.0),
        window=256,
        family="field_mid",
        contrast=3.0,
        position_sigma=3e-4,
        arc_s=2e4,
    )
    solution = solve_body_from_pictures(
        sequence.pictures, "BODY", sequence.believed, sequence.knowledge, radii_km=sequence.radii_km, passes=2
    )
    surface = albedo_from_pictures(sequence.pictures, "BODY", solution)
    assert surface.images == solution.images
    assert surface.law.lunar_weight == pytest.approx(0.6, abs=0.15), (
        "the truth's, where Lambert's was believed"
    )
    told = map_scores(sequence, surface)
    assert told["seen"] > 0.5
    # With gains that every picture tells of itself alone these were 0.88, 0.48 and 2.4. Seeds 8 to 10: 0.995 to 0.998 and
    # less than 0.9 sigma; here the solution's axes are 1.5 % off, and with them the map.
    assert told["correlation"] > 0.95
    assert told["rms"] < 0.32 * told["contrast"]
    assert 0.2 < told["sigmas"] < 2.1
    hidden = surface.pictures == 0
    assert np.median(surface.sigma[hidden]) > 4.0 * np.median(surface.sigma[~hidden])
    again = AlbedoMap.from_file(surface.write(tmp_path / "map.fits"))
    np.testing.assert_allclose(again.values, surface.albedo.values, rtol=1e-6)
    unseen = [replace(one, image="another") for one in sequence.pictures]
    with pytest.raises(EstimationError, match="20 px wide"):
        albedo_from_pictures(unseen, "BODY", solution)

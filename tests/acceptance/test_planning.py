"""Picture planning as a user does it, and its predictions held against pictures simulated and processed.

Facts: AAS 13-443, Figure 3: PolyCam's picture of 2018-09-24, 28 days before arrival, has enough bright stars and an
asteroid that is smaller than a pixel. Mission log of OSIRIS-REx (asteroidmission.org): PolyCam saw Bennu on 2018-08-17 from
2.2 million km.
"""

import json

import numpy as np
import pytest
from astropy.table import QTable
from typer.testing import CliRunner

from opnav_workbench.bodies import BodyPicture, find_least_squares
from opnav_workbench.cli import app
from opnav_workbench.planning import (
    confirming_inputs,
    expected_light,
    load_sequence,
    open_sequence,
    plan_picture,
)
from opnav_workbench.scene import predict_body
from opnav_workbench.session import ImageSession
from opnav_workbench.session.body_models import body_picture
from opnav_workbench.simulation import expose_picture, truth_of, write_picture
from opnav_workbench.stars import ShapePrior, fit_gaussian
from opnav_workbench.stars.pointing import attitude_shift, solve_pointing

LOW, HIGH = 0.8, 1.25  # predicted sigma over achieved scatter


def opnav(*arguments, code=0) -> str:
    answer = CliRunner().invoke(app, [str(a) for a in arguments], env={"COLUMNS": "160"})
    assert answer.exit_code == code, answer.output + repr(answer.exception)
    return answer.output


@pytest.fixture(scope="module")
def bennu(tmp_path_factory):
    """The paper's case, planned by the program: its output and its folder."""
    out = tmp_path_factory.mktemp("plan")
    chosen = ("figure_3", "approach", "too_late", "polycam_first_light", "mapcam_first_light")
    words = opnav(
        "plan",
        "osiris_rex/bennu_approach",
        "--out",
        out,
        "--no-exposures",
        *(f"--only={name}" for name in chosen),
    )
    return words, out


@pytest.fixture(scope="module")
def pictures(bennu):
    document = json.loads((bennu[1] / "plan.json").read_text())
    return {picture["name"]: picture for picture in document["pictures"]}


# -- the paper's case ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_figure_3_has_enough_bright_stars_and_a_sub_pixel_asteroid(pictures):
    figure = pictures["figure_3"]
    assert figure["verdict"] == "good"
    usable = [star for star in figure["stars"] if star["status"] == "usable"]
    assert len(usable) >= 5
    assert all(star["snr"] > 100.0 for star in usable)  # bright
    (target,) = figure["targets"]
    # 2 x 0.268 km (volume) at 480 000 km in pixels of 13.5 microrad (Bennu's radii, IK)
    assert target["diameter_px"] == pytest.approx(2 * 0.268 / 480_000 / 13.516e-6, rel=0.03)
    assert target["diameter_px"] < 1.0
    assert figure["attitude"]["twist_solved"]
    assert max(figure["attitude"]["sigma_px"]) < 0.01


@pytest.mark.slow
def test_pictures_around_that_day_have_stars_too(pictures):
    """Within a week of it each picture has three stars and more; those that have not say so."""
    near = [p for p in pictures.values() if "2018-09-17" <= p["utc"] <= "2018-10-01"]
    assert len(near) >= 5
    for picture in near:
        assert sum(star["status"] == "usable" for star in picture["stars"]) >= 3
    for picture in pictures.values():
        count = sum(star["status"] == "usable" for star in picture.get("stars", ()))
        assert count >= 3 or any("star" in reason or "cover" in reason for reason in picture["reasons"])


@pytest.mark.slow
@pytest.mark.realdata
def test_with_tycho2_every_picture_of_the_approach_has_enough_stars(data_dir, tmp_path):
    catalog = f"npz:{data_dir / 'stars/tycho2.npz'}"
    chosen = ("--only=figure_3", "--only=approach", "--no-exposures", "--catalog", catalog)
    opnav("plan", "osiris_rex/bennu_approach", "--out", tmp_path, *chosen)
    planned = json.loads((tmp_path / "plan.json").read_text())["pictures"]
    usable = {p["name"]: sum(star["status"] == "usable" for star in p["stars"]) for p in planned}
    assert len(usable) == 16
    assert min(usable.values()) >= 8, usable


@pytest.mark.slow
def test_bennu_grows_brighter_and_better_known(pictures):
    approach = [p for name, p in sorted(pictures.items()) if name.startswith("approach")]
    for key in ("snr", "diameter_px"):
        assert np.all(np.diff([p["targets"][0][key] for p in approach]) > 0.0)
    assert all(p["targets"][0]["diameter_px"] < 1.0 for p in approach)


@pytest.mark.slow
def test_first_detection(bennu):
    """PolyCam sees it from the first day on, as in flight; the wide-field MapCam weeks later, a stack of five before it."""
    searches = {s["name"]: s for s in json.loads((bennu[1] / "plan.json").read_text())["searches"]}
    single, stack = searches["polycam_first_light"]["detections"]
    assert single["utc"] == stack["utc"] == "2018-08-17T01:00:00"
    assert single["range_km"] == pytest.approx(2.19e6, rel=0.01)
    single, stack = searches["mapcam_first_light"]["detections"]
    assert "2018-09-01" < stack["utc"] < "2018-09-08" < single["utc"] < "2018-09-16"
    # A stack of five holds five times the information: 1.25 log10(5) = 0.87 mag fainter while the sky's noise rules.
    assert stack["limiting_mag"] - single["limiting_mag"] == pytest.approx(0.87, abs=0.05)
    assert single["mag"] == pytest.approx(single["limiting_mag"], abs=0.01)


@pytest.mark.slow
def test_a_picture_without_kernels_is_bad_with_its_reason(bennu, pictures):
    assert pictures["too_late"]["verdict"] == "bad"
    assert "2018-10-23" in pictures["too_late"]["reasons"][0]
    assert "bad too_late" in bennu[0]


@pytest.mark.slow
def test_files_and_catalog_depth(bennu):
    words, out = bennu
    assert "Catalog: bundled, to about magnitude" in words
    table = QTable.read(out / "plan.ecsv", format="ascii.ecsv")
    assert "bundled" in table.meta["catalog"]
    assert table["sigma_km"].unit == "km"
    assert all(table[name].info.description for name in table.colnames)
    row = table[list(table["picture"]).index("figure_3")]
    assert float(row["catalog_limit"].value) == pytest.approx(10.0, abs=0.3)
    page = (out / "plan.html").read_text()
    assert "://" not in page  # no address; base64 may spell "http" by chance
    assert page.count("data:image/png") >= 15
    assert (out / "charts" / "figure_3.png").stat().st_size > 10_000
    assert (out / "timeline.png").stat().st_size > 20_000


# -- predictions against processing --------------------------------------------------------------------------------

LORRI = {
    "mission": "new_horizons",
    "kernels": "new_horizons/pluto_opnav",
    "targets": ["PLUTO", "CHARON"],
    "bodies": [{"name": "PLUTO", "law": {"law": "lunar_lambert", "lunar_weight": 0.5}, "albedo": 0.6},
               {"name": "CHARON", "law": {"law": "lunar_lambert", "lunar_weight": 0.5}, "albedo": 0.4}],
    "pictures": [{"name": "lorri", "utc": "2015-04-09T12:00:00", "camera": "lorri_4x4", "exposure_s": 0.1}],
}  # fmt: skip
TRIALS = 32  # with pixel and line pooled, a scatter is known to 9 %


def processed(sequence, methods, trials, folder):
    """Plan a picture, then simulate and process it anew so often; return plan and errors of all kinds."""
    with open_sequence(load_sequence(sequence)) as opened:
        ((_, picture),) = opened.sequence.expanded()
        plan = plan_picture(opened, picture, exposures=False).prediction
        errors = []
        for number in range(trials):
            inputs = confirming_inputs(opened, picture, number, shift_px=(3.3, -2.6), twist_deg=0.05)
            image = expose_picture(inputs)
            write_picture(image, opened.mission, folder, stretches=())
            path = folder / f"{inputs.name}.fit"
            session = ImageSession.open(path, opened.mission, opened_catalog=opened.opened_scenario.catalog)
            session.predict()
            for _ in range(2):
                session.find_stars()
                session.repoint()
            solved = session.state.pointing.camera_from_j2000
            shift = attitude_shift(plan.camera, inputs.path.middle, solved)
            row = [shift.delta_pixel, shift.delta_line, np.degrees(shift.delta_twist_rad)]
            true = truth_of(image, opened.mission, path).bodies
            for name, method in methods.items():
                session.find_body(name, method=method)
                found = session.state.bodies[-1]
                assert found.status == "ok", found.messages
                model = next(body.target for body in inputs.bodies if body.target.name == name)
                predicted = predict_body(model, inputs.observer, plan.camera, solved).pixel_line
                row += [*(found.pixel_line - true[name]), *(found.pixel_line - predicted)]
            errors.append(row)
    return plan, np.array(errors)


def scatter_ratio(sigma, errors):
    """Predicted over achieved: root mean squares over axes, and trials about zero."""
    return 1.0 / np.sqrt(np.mean((np.asarray(errors) / sigma) ** 2))


def check(plan, errors, names):
    ratios = {"pointing": scatter_ratio(plan.pointing.sigma_px, errors[:, :2])}
    ratios["twist"] = scatter_ratio(plan.pointing.twist_sigma_deg, errors[:, 2])
    for k, name in enumerate(names):
        target, columns = plan.target(name), errors[:, 3 + 4 * k : 7 + 4 * k]
        ratios[f"{name} center"] = scatter_ratio(target.center_sigma_px, columns[:, :2])
        ratios[f"{name} direction"] = scatter_ratio(target.sigma_px, columns[:, 2:])
    assert all(LOW < ratio < HIGH for ratio in ratios.values()), ratios
    return ratios


@pytest.mark.slow
def test_lorri_unresolved_is_as_predicted(tmp_path):
    """Pluto (1 px) and Charon (half a pixel) among four stars, measured as unresolved bodies by the session."""
    plan, errors = processed(LORRI, {"PLUTO": "unresolved", "CHARON": "unresolved"}, TRIALS, tmp_path)
    assert plan.target("CHARON").prediction.diameter_px < 1.0
    check(plan, errors, ["PLUTO", "CHARON"])


@pytest.mark.slow
def test_a_disk_of_a_few_pixels_is_as_predicted(tmp_path):
    """Pluto 5.5 px wide at an SNR of 900 on 2015-06-26, measured with its rendered model: noise is all that is planned.

    So its surface is known, and no likelihood of its disk is asked for.
    """
    sequence = load_sequence(
        LORRI
        | {
            "kernels": "new_horizons/pluto_approach",
            "pictures": [
                {"name": "few", "utc": "2015-06-26T08:00:00", "camera": "lorri_4x4", "exposure_s": 0.02}
            ],
        }
    )
    errors, names = [], ("PLUTO", "CHARON")
    with open_sequence(sequence) as opened:
        ((_, picture),) = opened.sequence.expanded()
        target = plan_picture(opened, picture, exposures=False).prediction.target("PLUTO")
        for number in range(TRIALS):
            inputs = confirming_inputs(
                opened, picture, number, shift_px=(0.37 * (number % 5), 0.21 * (number % 7))
            )
            image = expose_picture(inputs)
            write_picture(image, opened.mission, tmp_path, stretches=())
            path = tmp_path / f"{inputs.name}.fit"
            session = ImageSession.open(path, opened.mission, opened_catalog=opened.opened_scenario.catalog)
            session.predict()
            for name in names:
                session.add_target(name)
            bodies = body_picture(session.context, session.inputs, session.state, names, names)
            found = find_least_squares(bodies, "PLUTO", known_surface=True)
            errors.append(found.pixel_line - truth_of(image, opened.mission, path).bodies["PLUTO"])
    assert target.prediction.diameter_px == pytest.approx(5.5, abs=0.1)
    assert 800.0 < target.snr < 1000.0
    assert LOW < scatter_ratio(target.center_sigma_px, errors) < HIGH


@pytest.mark.slow
def test_lorri_resolved_is_as_predicted():
    """Pluto 76 px wide on 2015-07-09: noise realisations of its disk, each measured with its rendered model."""
    sequence = load_sequence(
        LORRI
        | {
            "kernels": "new_horizons/pluto_approach",
            "targets": ["PLUTO"],
            "pointing": {"track": ["PLUTO", "CHARON"], "twist_deg": 140.0},
            "pictures": [
                {"name": "disk", "utc": "2015-07-09T04:29:00", "camera": "lorri_1x1", "exposure_s": 0.1}
            ],
        }
    )
    with open_sequence(sequence) as opened:
        ((_, picture),) = opened.sequence.expanded()
        plan = plan_picture(opened, picture, exposures=False).prediction
        light = expected_light(opened.inputs(picture))
    target = plan.target("PLUTO")
    assert target.prediction.diameter_px == pytest.approx(75.8, abs=0.2)  # 1188.3 km at 6.318e6 km
    centers = fitted_disks(light, target, 30)
    count = len(centers)
    check(plan, realised(plan, light, "PLUTO", centers, target.prediction.pixel_line, count), ["PLUTO"])


@pytest.mark.slow
def test_polycam_is_as_predicted():
    """PolyCam on the paper's day: 150 noise realisations of stars and asteroid in one mosaic, fitted at once."""
    with open_sequence(load_sequence("osiris_rex/bennu_approach")) as opened:
        picture = next(p for _, p in opened.sequence.expanded() if p.name == "figure_3")
        plan = plan_picture(opened, picture, exposures=False).prediction
        light = expected_light(opened.inputs(picture))
    # A point's light lies beside its center of figure by what the renderer says, and a navigator takes that out.
    true = light.picture.rendering.bodies[0].light_px
    centers = fitted_mosaic(light, true[None], 150)[:, 0]
    check(plan, realised(plan, light, "BENNU", centers, true, 150), ["BENNU"])


def realised(plan, light, name, centers, true_px, count):
    """Errors of pointing and target, stars fitted in `count` noise realisations and their catalog places drawn."""
    stars, target, camera = plan.stars, plan.target(name), plan.camera
    rows = stars.usable
    found = fitted_mosaic(light, stars.pixel_line[rows], count)
    catalog = stars.catalog_covariance_px2[rows]
    draws = np.random.default_rng(24).normal(size=(count, int(rows.sum()), 2))
    observed = found + np.einsum("nij,knj->kni", np.linalg.cholesky(catalog), draws)
    errors = []
    for center, places in zip(centers, observed, strict=True):
        solution = solve_pointing(
            places, stars.covariance_px2[rows], stars.directions[rows], camera, plan.camera_from_j2000,
            catalog_covariance_px2=catalog,
        )  # fmt: skip
        shift = attitude_shift(camera, plan.camera_from_j2000, solution.camera_from_j2000)
        predicted = camera.project(solution.camera_from_j2000 @ target.prediction.direction)
        moved = predicted - target.prediction.pixel_line
        off = center - true_px
        errors.append(
            [shift.delta_pixel, shift.delta_line, np.degrees(shift.delta_twist_rad), *off, *(off - moved)]
        )
    return np.array(errors)


def noisy_dn(light, electrons, rng):
    """Calibrated DN of these mean electrons: photon noise, read noise, whole numbers."""
    gain, read = light.values.gain_e_per_dn, light.values.read_noise_dn
    charge = rng.poisson(electrons + light.dark_e) - light.dark_e
    return np.rint(charge / gain + rng.normal(0.0, np.sqrt(read**2 - 1.0 / 12.0), charge.shape))


def fitted_mosaic(light, places, count, box=25):
    """Fit `count` noise realisations of boxes about places (n, 2); return centers (count, n, 2) on the detector."""
    half, n = box // 2, len(places)
    corner = np.rint(places).astype(int) - half
    padded = np.pad(light.expected_e, box, mode="edge")  # for stars whose box is cut by the edge
    boxes = np.stack([padded[y + box : y + 2 * box, x + box : x + 2 * box] for x, y in corner])
    noisy = noisy_dn(light, np.broadcast_to(boxes, (count, n, box, box)), np.random.default_rng(n))
    image = noisy.transpose(0, 2, 1, 3).reshape(count * box, n * box)
    offset = np.stack(np.meshgrid(np.arange(n), np.arange(count)), axis=-1) * box  # (count, n, 2) pixel, line
    sky = np.sqrt(light.variance_dn2(np.median(light.without_stars_e)))
    prior = ShapePrior.round_psf(light.inputs.camera.psf.sigma_px, 0.02, 0.02)
    fit = fit_gaussian(
        image, np.full(image.shape, sky), None, (places - corner + offset).reshape(-1, 2), prior,
        noise_model=light.noise_model, joint=False, mask_hits=False,
    )  # fmt: skip
    return fit.pixel_line.reshape(count, n, 2) - offset + corner


def fitted_disks(light, target, count):
    """Measure the first body in `count` noise realisations of its surroundings; return centers (count, 2)."""
    inputs, rng = light.inputs, np.random.default_rng(5)
    half = int(0.5 * target.prediction.diameter_px) + 25
    pixel, line = np.rint(target.prediction.pixel_line).astype(int)
    part = np.s_[line - half : line + half + 1, pixel - half : pixel + half + 1]
    # Of the frame transfer: calibration takes it off
    smear = light.expected_e - light.picture.noiseless_electrons
    blank = np.zeros(light.expected_e.shape)
    centers = []
    for _ in range(count):
        signal = blank.copy()
        signal[part] = noisy_dn(light, light.expected_e[part], rng) - smear[part] / light.values.gain_e_per_dn
        picture = BodyPicture(
            signal_dn=signal,
            noise_dn=np.full(signal.shape, light.values.read_noise_dn),
            bad=np.zeros(signal.shape, bool),
            saturated=np.zeros(signal.shape, bool),
            camera=inputs.camera,
            camera_from_j2000=inputs.path.middle,
            observer_velocity_km_s=inputs.observer.velocity_km_s,
            models=inputs.bodies[:1],
            psf=inputs.psf,
            sunlight_e=inputs.camera.sunlight_e(inputs.exposure_s),
            noise_model=light.noise_model,
        )
        found = find_least_squares(picture, target.name)
        assert found.pixel_line is not None, found.messages
        centers.append(found.pixel_line)
    return np.array(centers)


# -- what can be wrong ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ("targets: [BENU]", "BENU"),
        ("kernels: osiris_rex/nothing", "osiris_rex/nothing"),
        ("pointing: {track: BENNU, ra_deg: 3.0, dec_deg: 1.0}", "give one of"),
        ("exposure: 3", "exposure"),
    ],
)
def test_bad_input_is_one_line(tmp_path, change, word):
    """Unknown body, kernels, contradiction, unknown field: one line that names it, and no file."""
    key = change.split(":")[0]
    lines = ["mission: osiris_rex", "kernels: osiris_rex/bennu_approach", "targets: [BENNU]",
             "pictures: [{name: a, utc: 2018-09-24T12:00:00, camera: polycam, exposure_s: 5.0}]"]  # fmt: skip
    content = [line for line in lines if not line.startswith(f"{key}:")] + [change]
    (tmp_path / "bad.yaml").write_text("\n".join(content))
    answer = CliRunner().invoke(app, ["plan", str(tmp_path / "bad.yaml"), "--out", str(tmp_path / "out")])
    assert answer.exit_code != 0
    assert word in str(answer.exception)
    assert "\n" not in str(answer.exception)
    assert not (tmp_path / "out").exists()


def test_listing_and_help():
    assert "osiris_rex/bennu_approach" in opnav("plan", "--list")
    assert "opnav plan osiris_rex/bennu_approach" in opnav("plan", "--help")


def test_saturated_and_empty_pictures_say_so():
    base = LORRI["pictures"][0]
    sequence = load_sequence(
        LORRI
        | {
            "pointing": "kernels",
            "pictures": [
                base | {"name": "saturated", "exposure_s": 10.0},
                base | {"name": "away", "pointing": {"ra_deg": 10.0, "dec_deg": 60.0}},
                base | {"name": "too_long", "exposure_s": 100.0},
                base | {"name": "mvic", "camera": "none_such"},
            ],
        }
    )
    with open_sequence(sequence) as opened:
        found = {p.name: plan_picture(opened, p, exposures=False).verdict for _, p in sequence.expanded()}
    assert {verdict.grade for verdict in found.values()} == {"bad"}
    assert "PLUTO is saturated" in found["saturated"].words
    assert "PLUTO is off the detector" in found["away"].words
    assert "64.967 s" in found["too_long"].words
    assert "none_such" in found["mvic"].words

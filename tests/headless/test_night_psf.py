"""The PSF that a night learns by itself: from simulated pictures of another PSF; what is kept, and when no longer."""

import shutil

import numpy as np
import psf_night_exam as exam
import pytest

from opnav_workbench.camera import Camera
from opnav_workbench.headless import night_psf
from opnav_workbench.headless.night import plan_night
from opnav_workbench.headless.night_psf import LearnedPsf, learn_night_psf, with_kept_psf
from opnav_workbench.headless.night_spec import NightSpec
from opnav_workbench.mission import load_mission
from opnav_workbench.psf import EffectivePsf

COUNT = 4
FIELD_DEG = (270.53, -14.6)


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    """Pictures of a dozen stars with a Moffat PSF, and their catalog."""
    folder, rng = tmp_path_factory.mktemp("undersampled"), np.random.default_rng(3)
    ra, dec = (center + rng.uniform(-0.3, 0.3, 70) for center in FIELD_DEG)
    np.savez(folder / "stars.npz", ra_deg=ra, dec_deg=dec, mag=rng.uniform(10.5, 13.0, 70))
    return f"npz:{folder / 'stars.npz'}", exam.simulated(f"npz:{folder / 'stars.npz'}", folder, COUNT)


def night(field, **options):
    catalog, pictures = field
    return NightSpec(
        images=(str(pictures / "*.fit"),), mission="new_horizons", kernels=exam.KERNELS, catalog=catalog, **options
    )  # fmt: skip


@pytest.mark.slow
def test_a_night_learns_keeps_and_uses_its_psf(field, tmp_path):
    spec, out = night(field), tmp_path / "out"
    before = plan_night(spec, out)
    (one,) = learn_night_psf(spec, out)
    assert one.psf is not None, one.why
    assert (one.camera, len(one.psf.pictures)) == ("lorri_4x4", COUNT)
    after = plan_night(spec, out)
    used = load_mission(after.spec.mission)
    camera = used.camera_named("lorri_4x4")
    assert camera.effective_psf is not None
    assert camera.effective_psf.pictures == one.psf.pictures
    # Results with it are others, and the fingerprints say so; learned once, it stays.
    marks = [{p.image.name: p.fingerprint for p in plan.pictures} for plan in (before, after)]
    assert all(marks[0][name] != marks[1][name] for name in marks[0])
    assert learn_night_psf(spec, out) == ()
    assert plan_night(spec, out).pictures == after.pictures
    # Another folder, the pictures found in another order under other names: the same, to the bit.
    others = tmp_path / "renamed"
    others.mkdir()
    for number, path in enumerate(sorted(field[1].glob("*.fit"), reverse=True)):
        shutil.copy(path, others / f"q{number}.fit")
    learn_night_psf(spec.changed(images=(str(others / "*.fit"),)), tmp_path / "again")
    names = [next((folder / ".psf").glob("*/*.npz")) for folder in (out, tmp_path / "again")]
    assert names[0].read_bytes() == names[1].read_bytes()
    errors = [
        np.sqrt(np.mean(exam.processed(field[0], field[1], m, tmp_path / "run")[0] ** 2))
        for m in ("new_horizons", used.path)
    ]
    assert errors[1] < errors[0]


def learned(camera="lorri_4x4"):
    """What a night might have learned."""
    return LearnedPsf(camera, EffectivePsf.of_pictures(np.log(0.4), np.zeros(2), {}))


def test_what_was_learned_is_used_with_the_same_files_only(tmp_path):
    mission_file = exam.true_mission(tmp_path)
    spec = NightSpec(images=("none",), mission=str(mission_file))
    mission = load_mission(mission_file)
    folder = night_psf._folder(tmp_path, mission)
    folder.mkdir(parents=True)
    night_psf._keep(folder, mission, (learned(),), 4)
    kept = load_mission(with_kept_psf(spec, tmp_path).mission)
    assert kept.camera_named("lorri_4x4").effective_psf is not None
    # All else is as it was, wherever the files are.
    assert kept.camera_names == mission.camera_names
    assert kept.target_surfaces.keys() == mission.target_surfaces.keys()
    assert kept.camera_named("lorri_1x1").name == mission.camera_named("lorri_1x1").name
    assert with_kept_psf(spec.changed(learn_psf=False), tmp_path).mission == spec.mission
    # All moved together, as with a project's folder: what was learned names the files where they are now.
    (tmp_path / "moved").mkdir()
    for name in ("truth_mission", ".psf"):
        shutil.move(tmp_path / name, tmp_path / "moved" / name)
    tmp_path = tmp_path / "moved"
    spec = spec.changed(mission=str(tmp_path / "truth_mission" / mission_file.name))
    kept = load_mission(with_kept_psf(spec, tmp_path).mission)
    assert kept.camera_named("lorri_4x4").effective_psf is not None
    assert kept.camera_named("lorri_1x1").name == "LORRI 1x1"
    camera = tmp_path / "truth_mission" / "cameras" / "lorri_4x4.yaml"
    camera.write_text(camera.read_text().replace("read_noise_dn: 1.1", "read_noise_dn: 1.2"))
    assert Camera.from_yaml(camera).read_noise_dn == 1.2
    assert with_kept_psf(spec, tmp_path).mission == spec.mission


def test_few_pictures_teach_nothing_and_are_not_asked_again(field, tmp_path):
    few = night(field).changed(images=tuple(map(str, sorted(field[1].glob("*.fit"))[:3])))
    assert learn_night_psf(few, tmp_path) == ()
    assert not (tmp_path / ".psf").exists()


def test_pictures_that_cannot_be_solved_are_told(field, tmp_path):
    empty = tmp_path / "none.npz"
    np.savez(empty, ra_deg=[10.0], dec_deg=[80.0], mag=[5.0])
    spec = night((f"npz:{empty}", field[1]))
    (one,) = learn_night_psf(spec, tmp_path / "out")
    assert one.psf is None
    assert "no picture could be solved" in one.why
    assert learn_night_psf(spec, tmp_path / "out") == ()  # not again before there are twice as many
    assert with_kept_psf(spec, tmp_path / "out").mission == spec.mission

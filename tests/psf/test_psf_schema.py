"""PSFs from mappings, as YAML files hold them."""

import numpy as np
import pytest

from opnav_workbench.errors import CameraError
from opnav_workbench.psf import EmpiricalPsf, FieldPsf, GaussianPsf, MoffatPsf, TrailedPsf, psf_from_mapping


def test_gaussian_with_one_width_or_two():
    assert psf_from_mapping({"model": "gaussian", "sigma_px": 0.8}) == GaussianPsf(0.8, 0.8)
    two = {"model": "gaussian", "sigma_major_px": 1.2, "sigma_minor_px": 0.8, "angle_deg": 90.0}
    assert psf_from_mapping(two) == GaussianPsf(1.2, 0.8, np.pi / 2.0)


def test_moffat():
    assert psf_from_mapping({"model": "moffat", "fwhm_px": 2.0, "beta": 3.0}) == MoffatPsf(2.0, 3.0)


def test_empirical_from_samples_or_from_a_file_beside(tmp_path):
    template = EmpiricalPsf(GaussianPsf(0.8, 0.8).kernel(4), 4)
    template.save(tmp_path / "stars.npz")
    read = psf_from_mapping({"model": "empirical", "file": "stars.npz"}, tmp_path)
    given = psf_from_mapping({"model": "empirical", "samples": template.samples.tolist(), "oversampling": 4})
    for psf in (read, given):
        assert isinstance(psf, EmpiricalPsf)
        np.testing.assert_allclose(psf.samples, template.samples, rtol=1e-15)


def test_field_by_polynomial_or_grid():
    size = {"model": "field", "n_pixel": 100, "n_line": 100}
    polynomial = psf_from_mapping({**size, "polynomial": {"sigma_px": [0.8, 0.1, 0.0]}})
    grid = {"pixel": [0, 99], "line": [0, 99], "sigma_px": [[0.7, 0.9], [0.7, 0.9]]}
    bilinear = psf_from_mapping({**size, "grid": grid})
    assert isinstance(polynomial, FieldPsf)
    np.testing.assert_allclose(polynomial.at([99.5, 50.0]).sigma_px, 0.9)
    np.testing.assert_allclose(bilinear.at([49.5, 50.0]).sigma_px, 0.8)


def test_trailed():
    inner = {"model": "gaussian", "sigma_px": 0.8}
    trail = psf_from_mapping({"model": "trailed", "psf": inner, "offsets_px": [[-1, 0], [1, 0]]})
    assert isinstance(trail, TrailedPsf)
    np.testing.assert_allclose(trail.sigma_px, [np.sqrt(1.64), 0.8])


@pytest.mark.parametrize(
    ("mapping", "message"),
    [
        ({"model": "gaussian", "sigma": 0.8}, "did you mean sigma_px"),
        ({"model": "airy"}, "airy"),
        ({"model": "gaussian"}, "give sigma_px, or sigma_major_px and sigma_minor_px"),
        ({"model": "gaussian", "sigma_px": 1.0, "sigma_minor_px": 1.0}, "give sigma_px, or"),
        ({"model": "gaussian", "sigma_px": -1.0}, "greater than 0"),
        ({"model": "moffat", "fwhm_px": 2.0, "beta": 1.0}, "greater than 1"),
        ({"model": "empirical"}, "give file, or samples and oversampling"),
        ({"model": "empirical", "samples": [[1, 1, 1], [1, 1]], "oversampling": 1}, "different lengths"),
        ({"model": "empirical", "file": "nowhere.npz"}, "nowhere.npz cannot be read"),
        ({"model": "field", "n_pixel": 9, "n_line": 9}, "give polynomial or grid"),
        ({"sigma_px": 0.8}, "model"),
    ],
)
def test_errors_name_the_field_and_what_is_allowed(mapping, message):
    with pytest.raises(CameraError, match=message) as caught:
        psf_from_mapping(mapping)
    assert "\n" not in str(caught.value)

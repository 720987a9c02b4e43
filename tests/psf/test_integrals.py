"""The pixel-integrated Gaussian against independent quadrature, its derivatives against differences."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import dblquad

from opnav_workbench.errors import CenterfindingError
from opnav_workbench.psf import (
    box_integrals,
    covariance_from_shape,
    ellipse_from_shape,
    pixel_gaussian,
    shape_from_ellipse,
)

VALUE_TOLERANCE = 1e-6  # of the total flux
STEP = 1e-5


def density(x, y, covariance):
    inverse = np.linalg.inv(covariance)
    d = inverse[0, 0] * x * x + 2.0 * inverse[0, 1] * x * y + inverse[1, 1] * y * y
    return np.exp(-0.5 * d) / (2.0 * np.pi * np.sqrt(np.linalg.det(covariance)))


@pytest.mark.parametrize(
    ("major", "minor", "angle"),
    [(0.2, 0.2, 0.0), (0.6, 0.2, 0.7), (1.0, 0.3, -0.4), (5.0, 5.0, 0.0), (5.0, 0.5, 2.0), (1.3, 0.9, 1.2)],
)
def test_pixel_value_agrees_with_adaptive_quadrature(major, minor, angle):
    shape = shape_from_ellipse(np.array([major, minor, angle]))
    uu, uv, vv = covariance_from_shape(*shape)
    covariance = np.array([[uu, uv], [uv, vv]])
    center = np.array([0.31, -0.27])
    for pixel, line in ((0.0, 0.0), (1.0, 0.0), (-1.0, 1.0)):
        expected, _ = dblquad(
            lambda y, x: density(x - center[0], y - center[1], covariance),
            pixel - 0.5, pixel + 0.5, line - 0.5, line + 0.5, epsabs=1e-9,
        )  # fmt: skip
        got = pixel_gaussian(center[None], shape[None], [[pixel]], [[line]]).value[0, 0]
        assert abs(got - expected) < VALUE_TOLERANCE


def test_pixel_values_agree_with_brute_force_at_any_phase_and_rotation(pixel_quadrature, gaussian_density):
    rng = np.random.default_rng(20130443)
    line, pixel = np.indices((9, 9)).reshape(2, -1) - 4.0
    for _ in range(60):
        minor = rng.uniform(0.3, 1.5)
        ellipse = np.array([minor * rng.uniform(1.0, 3.0), minor, rng.uniform(-np.pi, np.pi)])
        center = rng.uniform(-0.5, 0.5, 2)
        expected = pixel_quadrature(gaussian_density(center, *ellipse), pixel, line)
        got = pixel_gaussian(center[None], shape_from_ellipse(ellipse)[None], pixel[None], line[None]).value[
            0
        ]
        np.testing.assert_allclose(got, expected, rtol=0.0, atol=VALUE_TOLERANCE)


@settings(max_examples=60, deadline=None)
@given(
    sigma=st.floats(0.2, 5.0),
    ratio=st.floats(0.2, 1.0),
    angle=st.floats(-3.2, 3.2),
    x=st.floats(-0.5, 0.5),
    y=st.floats(-0.5, 0.5),
)
def test_all_pixels_together_hold_the_whole_flux(sigma, ratio, angle, x, y):
    minor = max(sigma * ratio, 0.2)
    half = int(np.ceil(6.5 * sigma + 1.0))
    shape = shape_from_ellipse(np.array([max(sigma, minor), minor, angle]))
    values = box_integrals(np.array([[x, y]]), shape[None], np.full((1, 2), -float(half)), 2 * half + 1).value
    assert abs(values.sum() - 1.0) < VALUE_TOLERANCE
    assert values.min() > -VALUE_TOLERANCE


@settings(max_examples=40, deadline=None)
@given(
    log_scale=st.floats(-1.2, 0.8),
    e1=st.floats(-0.5, 0.5),
    e2=st.floats(-0.5, 0.5),
    x=st.floats(-0.5, 0.5),
    y=st.floats(-0.5, 0.5),
)
def test_derivatives_agree_with_central_differences(log_scale, e1, e2, x, y):
    center, shape = np.array([[x, y]]), np.array([[log_scale, e1, e2]])
    first = np.full((1, 2), -4.0)
    analytic = box_integrals(center, shape, first, 9)

    def difference(dc, ds):
        ahead = box_integrals(center + STEP * np.array(dc), shape + STEP * np.array(ds), first, 9).value
        behind = box_integrals(center - STEP * np.array(dc), shape - STEP * np.array(ds), first, 9).value
        return (ahead - behind) / (2.0 * STEP)

    # The value's quadrature (1e-8) and the difference's truncation set the tolerance.
    for name, dc, ds in (
        ("d_pixel", (1, 0), (0, 0, 0)), ("d_line", (0, 1), (0, 0, 0)), ("d_log_scale", (0, 0), (1, 0, 0)),
        ("d_e1", (0, 0), (0, 1, 0)), ("d_e2", (0, 0), (0, 0, 1)),
    ):  # fmt: skip
        np.testing.assert_allclose(
            getattr(analytic, name), difference(dc, ds), rtol=0.0, atol=3e-6, err_msg=name
        )


@given(major=st.floats(0.2, 5.0), ratio=st.floats(0.2, 0.99), angle=st.floats(-1.5, 1.5))
def test_ellipse_and_shape_are_inverse(major, ratio, angle):
    ellipse = np.array([major, major * ratio, angle])
    np.testing.assert_allclose(
        ellipse_from_shape(*shape_from_ellipse(ellipse)), ellipse, rtol=1e-9, atol=1e-9
    )


def test_angle_turns_from_pixel_toward_line():
    along_line = np.array([[0.0, 0.0]]), shape_from_ellipse(np.array([2.0, 0.5, np.pi / 2]))[None]
    star = pixel_gaussian(*along_line, [[0.0, 3.0]], [[3.0, 0.0]]).value[0]
    assert star[0] > 100.0 * star[1]


@pytest.mark.parametrize("shape", [[0.0, 1.0, 0.0], [0.0, 0.8, 0.8], [np.nan, 0.0, 0.0]])
def test_a_shape_that_is_no_ellipse_is_refused(shape):
    with pytest.raises(CenterfindingError, match="ellipticity"):
        pixel_gaussian([[0.0, 0.0]], [shape], [[0.0]], [[0.0]])

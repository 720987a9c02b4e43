"""How far a body's size may be off as it looks: its own uncertainty, and that of its range."""

from dataclasses import replace

import numpy as np
import pytest

from opnav_workbench.render import BodyModel, FigureUncertainty
from opnav_workbench.targets import TargetState


@pytest.mark.parametrize(
    ("sigma_km", "figure", "size_sigma"),
    [
        (None, FigureUncertainty(), 0.1),
        (0.0, FigureUncertainty(size_sigma=0.002), 0.002),
        (1e4, FigureUncertainty(size_sigma=0.002), np.hypot(0.1, 0.002)),
        (1e4, FigureUncertainty(), np.hypot(0.1, 0.1)),
        (3e5, FigureUncertainty(size_sigma=0.002), 0.9),
    ],
)
def test_an_uncertain_range_is_an_uncertain_size(sigma_km, figure, size_sigma):
    body = TargetState("MOON", [0.0, 6e4, 8e4], radii_km=[200.0] * 3, sun_position_km=[1e8, 0.0, 0.0])
    if sigma_km is not None:
        along = np.outer(body.direction, body.direction)
        body = replace(body, covariance_km2=sigma_km**2 * along + 50.0**2 * (np.eye(3) - along))
    model = BodyModel(body, figure=figure)
    assert model.seen_figure.size_sigma == pytest.approx(size_sigma, rel=1e-9)
    assert model.figure is figure

"""How well a center can be known at best, its nuisances left free: `bound_px2` of a trial.

The Cramer-Rao bound of a picture of the truth, from derivatives of the truth's own renderer. Free with a priori sigmas are
the body's axes (10 % in common, 5 % each), the law's share between that of the truth and another (0.5), the width of the
core of the PSF (10 %) and the light in its wings (3 %); free without are brightness, background and place. Where the
surface is a Gaussian field of one scale (`field_mid`), its values all over the visible half are free too, their strength and
correlation known; other surfaces count as known, and then no method can reach the bound.
"""

from dataclasses import dataclass, replace

import numpy as np
from disk_surfaces import Uniform, lambert, lommel_seeliger
from disk_truth import draw_light, lorri, noise_dn, toward_place

SIZE_SIGMA, AXES_SIGMA, LAW_SIGMA, WIDTH_SIGMA, WINGS_SIGMA = 0.10, 0.05, 0.5, 0.10, 0.03
STEP_PX, STEP = 0.1, 0.01
FIELD_RAD = 0.25  # correlation length of `field_mid`: exp(-r^2 / 2 l^2), r the chord
NODE_STEP = 0.7  # of it
MAX_DIAMETER_PX = 150.0


@dataclass(frozen=True)
class Bump(Uniform):
    """Albedo that the field's correlation spreads about one node."""

    node: np.ndarray

    def albedo(self, q):
        return correlation(q, self.node)


def correlation(a, b):
    """Correlation of the field between unit vectors."""
    return np.exp((a @ b.T - 1.0) / FIELD_RAD**2)


def has_bound(setup):
    """Whether all that is unknown of a surface is in the bound, and the picture is one that it takes a few seconds for."""
    return setup.family in ("uniform", "field_mid") and setup.diameter_px < MAX_DIAMETER_PX


def bound_px2(trial):
    """Return the least covariance (2, 2) of the center of a trial's body."""
    use = trial.light_dn > 0.0
    columns = [*_place(trial), *_axes(trial), *_light_and_optics(trial)]
    precision = np.zeros((len(columns), len(columns)))
    axes_covariance = SIZE_SIGMA**2 * np.ones((3, 3)) + AXES_SIGMA**2 * np.eye(3)
    precision[2:5, 2:5] = np.linalg.inv(axes_covariance)
    precision[[5, 6, 7], [5, 6, 7]] = np.array([LAW_SIGMA, WIDTH_SIGMA, WINGS_SIGMA]) ** -2.0
    if trial.setup.family == "field_mid":
        nodes, strength = _nodes(trial), trial.body.surface.scale * trial.body.surface.cube.std()
        columns += [_drawn(trial, surface=Bump(node)) for node in nodes]
        known = precision
        precision = np.zeros((len(columns), len(columns)))
        precision[: len(known), : len(known)] = known
        precision[len(known) :, len(known) :] = correlation(nodes, nodes) / strength**2
    design = np.stack([column[use] for column in columns], axis=1) / noise_dn(trial.light_dn[use])[:, None]
    information = design.T @ design + precision
    scale = 1.0 / np.sqrt(np.diag(information))
    return (np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale))[:2, :2]


def _drawn(trial, *, core=1.0, share=0.0, **changes):
    """Light in DN with the body changed, the core wider by a factor and a share more of the light in the wings."""
    body = replace(trial.body, **changes)
    light = draw_light(
        body, lorri(), trial.truth_px, trial.setup.diameter_px, trial.core_px * core, trial.wing_share + share
    )[0]
    return trial.scale_dn * light


def _place(trial):
    distance = np.linalg.norm(trial.body.position_km)
    for step in STEP_PX * np.eye(2):
        beside = [toward_place(lorri(), trial.truth_px + s * step) * distance for s in (1.0, -1.0)]
        ahead, behind = (_drawn(trial, position_km=position) for position in beside)
        yield (ahead - behind) / (2.0 * STEP_PX)


def _axes(trial):
    for step in STEP * np.eye(3):
        larger, smaller = (_drawn(trial, axes_km=trial.body.axes_km * (1.0 + s * step)) for s in (1.0, -1.0))
        yield (larger - smaller) / (2.0 * STEP)


def _light_and_optics(trial):
    light = trial.light_dn
    other = _drawn(trial, law=lommel_seeliger if trial.body.law is lambert else lambert)
    yield other * (light.sum() / other.sum()) - light
    yield (_drawn(trial, core=1.0 + STEP) - _drawn(trial, core=1.0 - STEP)) / (2.0 * STEP)
    yield (_drawn(trial, share=STEP) - light) / STEP
    yield light
    yield np.ones_like(light)


def _nodes(trial):
    """Evenly spread unit vectors (n, 3) of the visible half, and a little beyond, in the body's frame."""
    number = round(4.0 * np.pi / (NODE_STEP * FIELD_RAD) ** 2)
    z = 1.0 - (2.0 * np.arange(number) + 1.0) / number
    longitude = np.arange(number) * np.pi * (3.0 - np.sqrt(5.0))
    ring = np.sqrt(1.0 - z**2)
    nodes = np.stack([ring * np.cos(longitude), ring * np.sin(longitude), z], axis=-1)
    toward = -(trial.body.body_from_j2000 @ trial.body.position_km)
    return nodes[nodes @ (toward / np.linalg.norm(toward)) > -0.2]

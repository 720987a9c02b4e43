"""Cells of a disk: likelihoods of strips with other cells compare, and cells stay while an outline hardly moves."""

from dataclasses import replace

import numpy as np
import pytest

from opnav_workbench.bodies.disk.fit import Fitter
from opnav_workbench.bodies.disk.measurement import _usable, measure_disk
from opnav_workbench.bodies.disk.problem import DiskProblem

PLACE = np.array([500.3, 480.7])


@pytest.fixture(scope="module")
def disk(body_stage):
    body = body_stage.body(50.0, 40.0, PLACE)
    picture = body_stage.picture(body_stage.light(body), [body], np.random.default_rng(3))
    return measure_disk(picture, "BODY", "disk", None, None)


def test_cells_of_empty_sky_change_no_likelihood(disk):
    """Cells with the noise that was expected of them say nothing of a model: they counted 2 each, and decided of laws."""
    system, prior = disk.fit.system, disk.fit.prior
    sky = system.light < 0.01 * system.light.max()
    dropped = sky & np.isfinite(system.variance) & (np.arange(system.data.shape[1]) % 3 == 0)
    assert dropped.sum() > 50
    fewer = replace(system, variance=np.where(dropped, np.inf, system.variance))
    whole, part = (each.solve(prior) for each in (system, fewer))
    scatter = np.sqrt(0.5 * dropped.sum())
    assert abs(whole.log_likelihood - part.log_likelihood) < 4.0 * scatter
    assert abs(whole.held_cost - part.held_cost) < 8.0 * scatter


def test_cells_stay_what_they_are_while_an_outline_hardly_moves(disk):
    fit, picture = disk.fit, disk.picture
    problem = DiskProblem(picture, "BODY", _usable(picture, "BODY", disk.place), disk.place)
    fitter = Fitter(problem, fit)
    fitter._solve()
    first = fitter.linear.celled
    for away, same in ((0.2, True), (0.5, False)):
        moved = replace(fit.shape, center_px=fit.shape.center_px + np.array([away, 0.0]))
        fitter.celled = first
        celled = fitter._celled(fit.made.outline(moved))
        assert (celled.cell is first.cell) == same
        np.testing.assert_allclose(
            celled.samples.places.limb_px.mean(), first.samples.places.limb_px.mean(), atol=0.2
        )
        # About the other outline every sample has another depth.
        n = min(len(celled.cell), len(first.cell))
        change = celled.samples.places.depth_px[:n] - first.samples.places.depth_px[:n]
        assert np.ptp(change) > away

"""Gaps, overlaps and covered shares against brute force on a fine grid of instants."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from opnav_workbench.kernels.coverage import covered_share, gaps_between, overlaps_of

END = 40


@st.composite
def windows(draw):
    """Disjoint windows in order, with whole ends."""
    ends = sorted(draw(st.sets(st.integers(0, END), max_size=8)))
    ends = ends[: len(ends) // 2 * 2]
    return np.array(ends, float).reshape(-1, 2)


def _inside(spans, instants):
    return np.array([((spans[:, 0] < t) & (t < spans[:, 1])).any() for t in instants])


HALVES = np.arange(END) + 0.5  # never an end


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(st.lists(windows(), max_size=4))
def test_overlaps_are_where_two_files_are_valid(sets):
    found = overlaps_of(sets)
    depth = sum((_inside(spans, HALVES).astype(int) for spans in sets), np.zeros(END, int))
    assert (_inside(found, HALVES) == (depth >= 2)).all()
    assert (found[:, 1] > found[:, 0]).all()
    assert (found[1:, 0] >= found[:-1, 1]).all()


@settings(max_examples=100, deadline=None)
@given(windows())
def test_gaps_and_windows_share_the_whole_stretch(spans):
    gaps = gaps_between(spans)
    within = (spans[:1, :1].min(initial=END) < HALVES) & (spans[-1:, 1:].max(initial=0) > HALVES)
    assert (_inside(gaps, HALVES) == (within & ~_inside(spans, HALVES))).all()


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(windows())
def test_share_of_each_cell(spans):
    edges = np.linspace(0.0, END, 8)
    fine = np.linspace(0.0, END, 7 * 400 + 1)
    inside = _inside(spans, 0.5 * (fine[1:] + fine[:-1])).reshape(7, 400)
    assert_allclose(covered_share(spans, edges), inside.mean(axis=1), atol=5e-3)


@pytest.mark.parametrize("spans", [np.empty((0, 2)), np.array([[3.0, 3.0]])])
def test_nothing_and_single_instants(spans):
    assert gaps_between(spans).shape == (0, 2)
    assert overlaps_of([spans, spans]).shape == (0, 2)
    assert_allclose(covered_share(spans, np.array([0.0, 5.0])), [0.0])

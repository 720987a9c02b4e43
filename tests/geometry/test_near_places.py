"""Few places compared one by one have the neighbors that SciPy's tree finds, and many are left to it."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from opnav_workbench.geometry import near_places
from opnav_workbench.geometry.near_places import NearPlaces, pairs_within


@pytest.fixture(params=["few", "many"])
def _way(request, monkeypatch):
    monkeypatch.setattr(near_places, "FEW", 10**9 if request.param == "few" else -1)


@pytest.mark.usefixtures("_way")
@pytest.mark.parametrize(("n", "m", "dimensions"), [(0, 3, 2), (1, 2, 2), (17, 40, 2), (60, 9, 3), (5, 0, 2)])
def test_neighbors_are_those_of_the_tree(n, m, dimensions):
    rng = np.random.default_rng(n)
    places, asked = rng.uniform(0.0, 100.0, (n, dimensions)), rng.uniform(0.0, 100.0, (m, dimensions))
    tree = cKDTree(places)
    for count, within in ((1, np.inf), (1, 12.0), (4, 30.0)):
        distance, row = tree.query(asked, k=count, distance_upper_bound=within)
        found = NearPlaces(places).nearest(asked, count, within)
        np.testing.assert_array_equal(found[0], distance)
        np.testing.assert_array_equal(found[1], row)
    for radius, along_axes in ((20.0, False), (15.0, True)):
        expected = tree.query_pairs(radius, p=np.inf if along_axes else 2.0)
        found = pairs_within(places, radius, along_axes=along_axes)
        assert found.shape[1] == 2
        assert {tuple(pair) for pair in found.tolist()} == expected


@pytest.mark.usefixtures("_way")
def test_what_is_just_as_far_as_asked():
    """Pairs reach to their radius, a neighbor must be nearer than its bound."""
    places = np.array([[0.0, 0.0], [3.0, 4.0]])
    assert pairs_within(places, 5.0).tolist() == [[0, 1]]
    assert pairs_within(places, np.nextafter(5.0, 0.0)).tolist() == []
    assert pairs_within(places, 4.0, along_axes=True).tolist() == [[0, 1]]
    assert NearPlaces(places[1:]).nearest(places[:1], within=5.0)[0].tolist() == [np.inf]
    assert NearPlaces(places[1:]).nearest(places[:1], within=np.nextafter(5.0, 6.0))[0].tolist() == [5.0]

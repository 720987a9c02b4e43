"""Shared fixtures: where flight data for development is found, and a user cache of each test run's own."""

import os
from pathlib import Path

import numpy as np
import pytest

from opnav_workbench.catalog.ucac4 import UCAC4_RECORD
from opnav_workbench.kernels import KernelSet
from opnav_workbench.mission import load_mission
from opnav_workbench.rehearsal import (
    DEMO_CATALOG,
    DEMO_KERNELS,
    DEMO_MISSION,
    DEMO_PICTURES,
    simulate_picture,
)
from opnav_workbench.simulation.truth import Truth

DATA_VARIABLE = "OPNAV_DATA"


def pytest_configure() -> None:
    """One thread of linear algebra in each of xdist's processes, which inherit this: there is one a core already."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def _find_data() -> Path | None:
    named = os.environ.get(DATA_VARIABLE)
    candidates = [Path(named)] if named else [Path(__file__).parents[2] / "shared" / "data"]
    return next((c for c in candidates if (c / "images").is_dir()), None)


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder with flight frames, kernels and catalogs; tests that need it skip where it is absent."""
    found = _find_data()
    if found is None:
        pytest.skip(f"no flight data: set {DATA_VARIABLE} to a folder with images/, spice/ and stars/")
    return found


@pytest.fixture(scope="session")
def demo_truths(tmp_path_factory: pytest.TempPathFactory) -> tuple[Truth, Truth]:
    """The two demo pictures (LORRI 4x4 with 4 stars, MVIC with 15), simulated once, and what they really show."""
    mission, folder = load_mission(DEMO_MISSION), tmp_path_factory.mktemp("demo")
    with KernelSet(DEMO_KERNELS):
        lorri, mvic = (simulate_picture(r, mission, DEMO_CATALOG, folder) for r in DEMO_PICTURES)
    return lorri, mvic


@pytest.fixture(scope="session")
def ucac4_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """UCAC4 zones 449 to 453 (dec -0.4 to +0.6 deg), written by the documented layout, as dense as the real zone 451."""
    folder = tmp_path_factory.mktemp("ucac4")
    (folder / "u4b").mkdir()
    rng = np.random.default_rng(451)
    for zone in range(449, 454):
        n = 133_410
        stars = np.zeros(n, dtype=UCAC4_RECORD)
        stars["ra"] = np.sort(rng.integers(0, 1_296_000_000, n))
        stars["spd"] = rng.integers((zone - 1) * 720_000, zone * 720_000, n)
        stars["maga"] = np.maximum(
            16_500 - rng.exponential(1_150.0, n), 6_000
        )  # 2.4 times as many a magnitude
        stars["magm"], stars["sigmag"] = stars["maga"] + rng.integers(-50, 50, n), rng.integers(1, 40, n)
        stars["sigra"], stars["sigdc"] = rng.integers(-127, 127, n), rng.integers(-127, 127, n)
        stars["na1"] = stars["nu1"] = 2
        stars["cep"] = rng.integers(9_000, 10_200, (n, 2))
        stars["pm"], stars["sigpm"] = rng.integers(-3000, 3000, (n, 2)), rng.integers(-118, 122, (n, 2))
        stars["jhk"] = stars["maga"][:, None] - rng.integers(500, 2_500, (n, 3))
        apass = rng.random(n)[:, None] < 0.45  # as many as in the real catalog
        stars["apasm"] = np.where(apass, stars["maga"][:, None] + rng.integers(-500, 1_500, (n, 5)), 20_000)
        stars["apase"] = np.where(apass, rng.integers(1, 20, (n, 5)), 99)
        stars["apase"][apass[:, 0] & (stars["maga"] < 8_500), :2] = 0  # Tycho magnitudes in their place
        stars["rnm"] = zone * 1_000_000 + np.arange(n)
        stars.tofile(folder / "u4b" / f"z{zone:03d}")
    return folder

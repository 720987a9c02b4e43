"""Shared fixtures: where flight data for development is found, and a user cache of each test run's own."""

import os
from pathlib import Path

import pytest

from opnav_workbench.mission import load_mission
from opnav_workbench.rehearsal import (
    DEMO_CATALOG,
    DEMO_KERNELS,
    DEMO_MISSION,
    DEMO_PICTURES,
    Truth,
    simulate_picture,
)
from opnav_workbench.spice import KernelSet

DATA_VARIABLE = "OPNAV_DATA"


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

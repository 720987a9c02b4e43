"""Shared fixtures: where flight data for development is found, and a user cache of each test run's own."""

import os
from pathlib import Path

import pytest

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

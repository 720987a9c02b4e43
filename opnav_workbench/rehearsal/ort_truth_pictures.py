"""What a picture truly shows, as plain values inside the sealed truth, and back."""

import io
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from astropy.table import QTable

from opnav_workbench.simulation import Truth
from opnav_workbench.simulation.cosmic_rays import CosmicRayHits

__all__ = ["truth_from_values", "truth_values"]

PLAIN = ("mission", "camera", "utc", "et", "exposure_s", "seed", "settings", "exposure")
MATRICES = ("camera_from_j2000", "predicted_camera_from_j2000")
HITS = ("start_px", "end_px", "electrons")
HIT_DECIMALS = 2  # of a pixel: tracks are for the eye


def truth_values(truth: Truth) -> dict[str, Any]:
    """Return a picture's truth as plain values, without the noiseless picture."""
    table = io.StringIO()
    truth.objects.write(table, format="ascii.ecsv")
    return {
        **{name: getattr(truth, name) for name in PLAIN},
        **{name: getattr(truth, name) for name in MATRICES},
        "picture": truth.picture.name,
        "objects": table.getvalue(),
        "cosmic_rays": {name: getattr(truth.cosmic_rays, name).round(HIT_DECIMALS) for name in HITS},
    }


def truth_from_values(values: Mapping[str, Any], folder: Path) -> Truth:
    """Return the truth of a picture that stands, or stood, in `folder`."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        objects = QTable.read(values["objects"].splitlines(), format="ascii.ecsv")
    hits = {name: np.array(values["cosmic_rays"][name], dtype=np.float64) for name in HITS}
    matrices: dict[str, Any] = {name: np.array(values[name], dtype=np.float64) for name in MATRICES}
    return Truth(
        picture=folder / values["picture"],
        objects=objects,
        cosmic_rays=CosmicRayHits(
            hits["start_px"].reshape(-1, 2), hits["end_px"].reshape(-1, 2), hits["electrons"]
        ),
        **matrices,
        **{name: values[name] for name in PLAIN},
    )

"""Pictures of Pluto, 47 px wide in LORRI's 4x4 mode, with an attitude error that all of them share."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from exposed_pictures import APPROACH as KERNELS
from exposed_pictures import exposed_pictures

__all__ = ["KERNELS", "SETTINGS", "pair_pictures"]

SETTINGS = "carry_within_s=60,carry_jitter_px=0.03,carry_walk_px=0.005,lost_detections=0"


def pair_pictures(folder, times, *, seed, shift_px):
    """The truths of pictures by name, at `times` (UTC, exposure in s) by name."""
    return exposed_pictures(folder, times, bodies=["PLUTO"], seed=seed, shift_px=shift_px, twist_deg=0.05)

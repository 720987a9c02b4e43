"""SPICE: kernels opened as a set or written; states, attitudes, times and instrument values from them.

The only package here that imports spiceypy. SPICE's kernel pool is global; it is reached through
`KernelSet` and the functions below only, one thread at a time, and every failure is one `KernelError` with
its remedy.
"""

from opnav_workbench.spice.attitude import body_attitude, body_frame, camera_attitude
from opnav_workbench.spice.coverage import Coverage
from opnav_workbench.spice.files import KernelFile
from opnav_workbench.spice.guard import toolkit_version
from opnav_workbench.spice.instrument import instrument_values
from opnav_workbench.spice.kernels import KernelSet
from opnav_workbench.spice.make import make_kernels
from opnav_workbench.spice.sources import known_names
from opnav_workbench.spice.states import State, body_id, body_name, body_radii_km, state
from opnav_workbench.spice.time import et_from_sclk, et_from_utc, sclk_from_et, utc_from_et
from opnav_workbench.spice.writing import SpkSegment, write_ck, write_spk, write_text_kernel

__all__ = [
    "Coverage",
    "KernelFile",
    "KernelSet",
    "SpkSegment",
    "State",
    "body_attitude",
    "body_frame",
    "body_id",
    "body_name",
    "body_radii_km",
    "camera_attitude",
    "et_from_sclk",
    "et_from_utc",
    "instrument_values",
    "known_names",
    "make_kernels",
    "sclk_from_et",
    "state",
    "toolkit_version",
    "utc_from_et",
    "write_ck",
    "write_spk",
    "write_text_kernel",
]

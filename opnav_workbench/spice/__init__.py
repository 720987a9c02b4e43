"""SPICE: kernels opened as a set or written; states, attitudes, times and instrument values from them.

The only package here that imports spiceypy. SPICE's kernel pool is global; it is reached through
`KernelSet` and the functions below only, one thread at a time, and every failure is one `KernelError` with
its remedy.
"""

from opnav_workbench.spice.attitude import (
    body_attitude,
    body_frame,
    camera_attitude,
    camera_rate,
    ck_structure,
    knows_frame,
    rotation,
)
from opnav_workbench.spice.brief import BriefRow, BriefVariable, KernelBrief, brief
from opnav_workbench.spice.check import CoverageRow, KernelCheck, KindCheck, check_kernels
from opnav_workbench.spice.coverage import Coverage
from opnav_workbench.spice.fetch import FetchedKernel, FetchedKernels, fetch_kernels
from opnav_workbench.spice.files import KernelFile
from opnav_workbench.spice.geometry_points import SurfacePoint, sub_observer_point, sub_solar_point
from opnav_workbench.spice.guard import toolkit_version
from opnav_workbench.spice.instrument import instrument_values
from opnav_workbench.spice.kernel_sets import KernelSetInfo, kernel_sets
from opnav_workbench.spice.kernels import KernelSet
from opnav_workbench.spice.leapseconds import packaged_leap_seconds
from opnav_workbench.spice.make import make_kernels
from opnav_workbench.spice.manifest import (
    KERNEL_KINDS,
    KernelKind,
    Manifest,
    ManifestKernel,
    kernels_folder,
    load_manifest,
    manifest_missions,
    match_kinds,
)
from opnav_workbench.spice.sources import known_names
from opnav_workbench.spice.states import State, body_gm_km3_s2, body_id, body_name, body_radii_km, state
from opnav_workbench.spice.text_kernels import write_text_kernel
from opnav_workbench.spice.time import et_from_sclk, et_from_utc, sclk_from_et, utc_from_et
from opnav_workbench.spice.writing import SpkSegment, write_spk
from opnav_workbench.spice.writing_ck import write_ck

__all__ = [
    "KERNEL_KINDS",
    "BriefRow",
    "BriefVariable",
    "Coverage",
    "CoverageRow",
    "FetchedKernel",
    "FetchedKernels",
    "KernelBrief",
    "KernelCheck",
    "KernelFile",
    "KernelKind",
    "KernelSet",
    "KernelSetInfo",
    "KindCheck",
    "Manifest",
    "ManifestKernel",
    "SpkSegment",
    "State",
    "SurfacePoint",
    "body_attitude",
    "body_frame",
    "body_gm_km3_s2",
    "body_id",
    "body_name",
    "body_radii_km",
    "brief",
    "camera_attitude",
    "camera_rate",
    "check_kernels",
    "ck_structure",
    "et_from_sclk",
    "et_from_utc",
    "fetch_kernels",
    "instrument_values",
    "kernel_sets",
    "kernels_folder",
    "known_names",
    "knows_frame",
    "load_manifest",
    "make_kernels",
    "manifest_missions",
    "match_kinds",
    "packaged_leap_seconds",
    "rotation",
    "sclk_from_et",
    "state",
    "sub_observer_point",
    "sub_solar_point",
    "toolkit_version",
    "utc_from_et",
    "write_ck",
    "write_spk",
    "write_text_kernel",
]

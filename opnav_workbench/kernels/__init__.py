"""SPICE: kernels opened as a set, checked, fetched or written; states, attitudes, times and instrument values from them.

The only package that imports spiceypy. SPICE's kernel pool is global; it is reached through `KernelSet` and the
functions below only, one thread at a time, and every failure is one `KernelError` with its remedy. Enter by
`KernelSet`: inside its block `state`, `camera_attitude`, `et_from_utc` and the others answer from its kernels.
`check_kernels` and `brief` look into kernels, `fetch_kernels` gets them, `write_spk`, `write_ck`,
`write_text_kernel` and `make_kernels` make them. Listed from the ground up: a module uses those above it.

``pool``
    The CSPICE pool: lock, snapshots, variables, loaded files.
``files``
    One kernel file before SPICE opens it: kind, wholeness, segments, checksum.
``kernel_trial``
    Shape kernels tried out in a supervised process.
``segment_layouts``
    What the numbers of a segment must be, for every type that SPICE knows.
``coverage``
    Windows of bodies and structures over the loaded files; gaps, overlaps, shares.
``calls``
    The guard around calls into SPICE, and its failures in clear words.
``time``
    UTC, spacecraft clock, calendar and Julian dates, et; the packaged leap seconds.
``states``
    States, sizes, names, orientation of bodies; points below observer and Sun; two-body motion.
``cameras``
    Attitudes, rates, frames and instrument values of cameras.
``loading``
    Kernel files, metakernels and folders in loading order, loaded for a block.
``digests``
    What kernels say of a time, as digests (`kernel_parts`).
``contents``
    What a single kernel holds (`brief`).
``text_kernels``
    Text kernels and metakernels written.
``writing``
    SPK and CK files written; excerpts of SPKs.
``shape_files``
    OBJ and cmod shape files read.
``dsk_files``
    Shapes as DSK files, written and read.
``manifest``
    Which flight kernels a mission needs, and where the archive keeps them.
``fetch``
    Flight kernels fetched and held to their digests.
``making``
    Kernels made from scenario files: orbits, pointing plans, flown attitudes.
``kernel_set``
    `KernelSet`: names, paths and folders resolved, made on first use, opened.
``check``
    What a kernel set covers and lacks (`check_kernels`).
"""

from typing import TYPE_CHECKING

from opnav_workbench.lazy_names import names_on_demand

if TYPE_CHECKING:
    from opnav_workbench.kernels.calls import toolkit_version
    from opnav_workbench.kernels.cameras import (
        attitude_gaps,
        camera_attitude,
        camera_rate,
        ck_structure,
        instrument_ids,
        instrument_values,
        knows_frame,
        rotation,
    )
    from opnav_workbench.kernels.check import CoverageRow, KernelCheck, KindCheck, check_kernels
    from opnav_workbench.kernels.contents import BriefRow, BriefVariable, KernelBrief, brief
    from opnav_workbench.kernels.coverage import Coverage
    from opnav_workbench.kernels.digests import KernelPart, kernel_parts
    from opnav_workbench.kernels.fetch import FetchedKernel, FetchedKernels, fetch_kernels
    from opnav_workbench.kernels.files import KernelFile
    from opnav_workbench.kernels.kernel_set import KernelSet, KernelSetInfo, kernel_sets, known_names
    from opnav_workbench.kernels.making.make import make_kernels
    from opnav_workbench.kernels.manifest import (
        KERNEL_KINDS,
        KernelKind,
        Manifest,
        ManifestKernel,
        kernels_folder,
        load_manifest,
        manifest_missions,
        match_kinds,
    )
    from opnav_workbench.kernels.states import (
        State,
        SurfacePoint,
        body_attitude,
        body_frame,
        body_gm_km3_s2,
        body_id,
        body_name,
        body_periodic_terms,
        body_radii_km,
        state,
        sub_observer_point,
        sub_solar_point,
    )
    from opnav_workbench.kernels.text_kernels import write_text_kernel
    from opnav_workbench.kernels.time import (
        clock_tolerance_s,
        et_from_sclk,
        et_from_utc,
        knows_clock,
        packaged_leap_seconds,
        sclk_from_et,
        utc_from_et,
    )
    from opnav_workbench.kernels.writing import SpkSegment, write_ck, write_spk
else:  # loaded on first use: most calls need a few of these
    __getattr__ = names_on_demand(
        __name__,
        {
            "toolkit_version": "calls",
            "attitude_gaps": "cameras",
            "camera_attitude": "cameras",
            "camera_rate": "cameras",
            "ck_structure": "cameras",
            "instrument_ids": "cameras",
            "instrument_values": "cameras",
            "knows_frame": "cameras",
            "rotation": "cameras",
            "CoverageRow": "check",
            "KernelCheck": "check",
            "KindCheck": "check",
            "check_kernels": "check",
            "BriefRow": "contents",
            "BriefVariable": "contents",
            "KernelBrief": "contents",
            "brief": "contents",
            "Coverage": "coverage",
            "KernelPart": "digests",
            "kernel_parts": "digests",
            "FetchedKernel": "fetch",
            "FetchedKernels": "fetch",
            "fetch_kernels": "fetch",
            "KernelFile": "files",
            "KernelSet": "kernel_set",
            "KernelSetInfo": "kernel_set",
            "kernel_sets": "kernel_set",
            "known_names": "kernel_set",
            "make_kernels": "making.make",
            "KERNEL_KINDS": "manifest",
            "KernelKind": "manifest",
            "Manifest": "manifest",
            "ManifestKernel": "manifest",
            "kernels_folder": "manifest",
            "load_manifest": "manifest",
            "manifest_missions": "manifest",
            "match_kinds": "manifest",
            "State": "states",
            "SurfacePoint": "states",
            "body_attitude": "states",
            "body_frame": "states",
            "body_gm_km3_s2": "states",
            "body_id": "states",
            "body_name": "states",
            "body_periodic_terms": "states",
            "body_radii_km": "states",
            "state": "states",
            "sub_observer_point": "states",
            "sub_solar_point": "states",
            "write_text_kernel": "text_kernels",
            "clock_tolerance_s": "time",
            "et_from_sclk": "time",
            "et_from_utc": "time",
            "knows_clock": "time",
            "packaged_leap_seconds": "time",
            "sclk_from_et": "time",
            "utc_from_et": "time",
            "SpkSegment": "writing",
            "write_ck": "writing",
            "write_spk": "writing",
        },
    )

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
    "KernelPart",
    "KernelSet",
    "KernelSetInfo",
    "KindCheck",
    "Manifest",
    "ManifestKernel",
    "SpkSegment",
    "State",
    "SurfacePoint",
    "attitude_gaps",
    "body_attitude",
    "body_frame",
    "body_gm_km3_s2",
    "body_id",
    "body_name",
    "body_periodic_terms",
    "body_radii_km",
    "brief",
    "camera_attitude",
    "camera_rate",
    "check_kernels",
    "ck_structure",
    "clock_tolerance_s",
    "et_from_sclk",
    "et_from_utc",
    "fetch_kernels",
    "instrument_ids",
    "instrument_values",
    "kernel_parts",
    "kernel_sets",
    "kernels_folder",
    "known_names",
    "knows_clock",
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

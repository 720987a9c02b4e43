"""Kernels from a scenario: all eight kinds, shapes, and the metakernel that loads them, in one folder.

The paper's "capability to simulate the various kernels" (AAS 13-443, section on the use of SPICE).
"""

import contextlib
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from opnav_workbench.errors import KernelError, MissionError
from opnav_workbench.kernels.cameras import rotation
from opnav_workbench.kernels.loading import LoadedKernels, kernel_files
from opnav_workbench.kernels.making.attitude_error import flown_attitudes
from opnav_workbench.kernels.making.attitude_history import AttitudeHistory, joined_histories
from opnav_workbench.kernels.making.pool_variables import (
    clock_values,
    frame_values,
    instrument_values,
    pck_values,
)
from opnav_workbench.kernels.making.scenario import AttitudeError, Scenario, load_scenario
from opnav_workbench.kernels.making.scenario_parts import Body, Shape
from opnav_workbench.kernels.making.steering import window_attitudes
from opnav_workbench.kernels.making.trajectories import BuildFolders, spk_segments
from opnav_workbench.kernels.states import body_frame
from opnav_workbench.kernels.text_kernels import metakernel_assignments, write_text_kernel
from opnav_workbench.kernels.time import packaged_leap_seconds
from opnav_workbench.kernels.writing import write_ck, write_spk

__all__ = ["make_kernels"]


# ---- Shape models of a scenario's bodies as DSK files.


def write_body_dsk(path: Path, body: Body, shape: Shape, folder: Path) -> None:
    """Write the DSK of a body; needs the scenario's FK in the active `KernelSet`.

    Raises
    ------
    KernelError
        The body has no body-fixed frame, or the file is no shape model.
    """
    from opnav_workbench.kernels.dsk_files import write_dsk  # noqa: PLC0415
    from opnav_workbench.kernels.shape_files import read_shape  # noqa: PLC0415

    vertices_km, plates = read_shape(folder / shape.file, shape.unit)  # a full path stays what it is
    write_dsk(path, vertices_km, plates, body.id, body_frame(body.id))


# ---- Kernels from a scenario: all eight kinds and the metakernel that loads them, in one folder.


def make_kernels(
    scenario: Mapping[str, Any] | PathLike[str] | str, out: PathLike[str] | str, *, actual: bool = False
) -> Path:
    """Write all kernels of a scenario and return the path of their metakernel.

    The folder then holds LSK, SCLK, FK, IK, PCK, the SPK of the spacecraft, the SPK of the bodies and the CK
    with the predicted attitudes, a DSK for every body with a shape model, all named after the scenario, and
    ``NAME.tm``. Its paths are relative:
    SPICE's own tools load it from inside the folder, `KernelSet` from anywhere. The same scenario gives the
    same bytes.

    Parameters
    ----------
    scenario : mapping or path
        See `load_scenario`.
    out : path
        Made if it is not there. Files of the same names are replaced, once all of the new ones are written.
    actual
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
    beside = Path() if isinstance(scenario, Mapping) else Path(scenario).absolute().parent
    folder = Path(out)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".making-", dir=folder) as temporary:
            names = _Builder(content, Path(temporary), beside).build(actual=actual)
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

    def __init__(self, scenario: Scenario, folder: Path, beside: Path) -> None:
        self.scenario = scenario
        self.folder = folder
        self.beside = beside  # files that the scenario names
        self.comment = (
            f"Scenario {scenario.name} of mission {scenario.mission}, written by opnav_workbench.\n\n"
            f"{' '.join(scenario.description.split())}\n\n"
        )

    def build(self, *, actual: bool) -> list[str]:
        """Write everything; return the names of the files, metakernels last."""
        stem = self.scenario.name
        lsk = self._leap_seconds()
        with LoadedKernels(kernel_files([self.folder / lsk])):
            text = [lsk, *self._text_kernels(stem)]
        with LoadedKernels(kernel_files(self.folder / name for name in text)):
            common = [*text, *self._trajectories(stem, text), *self._shapes(stem)]
        with LoadedKernels(kernel_files(self.folder / name for name in common)):
            attitudes = self._attitudes(f"{stem}_predicted.bc", f"{stem}_actual.bc" if actual else None)
        metakernels = [f"{stem}.tm", f"{stem}_actual.tm"][: len(attitudes)]
        for metakernel, ck in zip(metakernels, attitudes, strict=True):
            files = metakernel_assignments([*common, ck])
            self._text("MK", metakernel, files, "Load it from inside its folder.")
        return [*common, *attitudes, *reversed(metakernels)]

    def _leap_seconds(self) -> str:
        with packaged_leap_seconds() as path:
            return Path(shutil.copyfile(path, self.folder / path.name)).name

    def _text(self, kind: Any, name: str, assignments: Mapping[str, Any], note: str = "") -> str:
        write_text_kernel(self.folder / name, kind, assignments, self.comment + note)
        return name

    def _text_kernels(self, stem: str) -> list[str]:
        s = self.scenario
        sources = "\n".join(f"{b.name}: {b.source}" for b in s.bodies)
        constants = pck_values(s)  # none for bodies without radii, mass and pole: other kernels have them
        return [
            *([self._text("PCK", f"{stem}.tpc", constants, sources)] if constants else []),
            self._text("FK", f"{stem}.tf", frame_values(s)),
            self._text("IK", f"{stem}.ti", instrument_values(s)),
            self._text("SCLK", f"{stem}.tsc", clock_values(s)),
        ]

    def _trajectories(self, stem: str, text: Sequence[str]) -> list[str]:
        s = self.scenario
        names = [f"{stem}_bodies.bsp", f"{stem}_spacecraft.bsp"]
        place = BuildFolders(self.beside, tuple(self.folder / name for name in text), self.folder)
        made = spk_segments(s, place)
        written = []
        for name, of_spacecraft in zip(names, (False, True), strict=True):
            chosen = [(i, x) for i, x in made if (x.target == s.spacecraft.id) is of_spacecraft]
            sources = (f"{x.target} about {x.center}: {s.trajectories[i].source}" for i, x in chosen)
            comment = self.comment + "\n".join(dict.fromkeys(sources))
            segments = list(dict.fromkeys(x for _, x in chosen))  # two excerpts may need the same center
            if segments:  # a scenario may leave the bodies to other kernels
                write_spk(self.folder / name, segments, comment)
                written.append(name)
        return written

    def _shapes(self, stem: str) -> list[str]:
        """Write a DSK for every body with a shape model."""
        names = []
        for i, body in enumerate(self.scenario.bodies):
            if body.shape is not None:
                names.append(f"{stem}_{body.id}.bds")
                with _as_mission_error(f"bodies.{i}.shape"):
                    write_body_dsk(self.folder / names[-1], body, body.shape, self.beside)
        return names

    def _attitudes(self, predicted: str, actual: str | None) -> list[str]:
        """Write the CKs, predicted and actual."""
        pieces = []
        for i, window in enumerate(self.scenario.pointing.windows):
            with _as_mission_error(f"pointing.windows.{i}"):
                pieces.append(window_attitudes(self.scenario, window))
        attitudes = joined_histories(pieces)
        self._ck(predicted, attitudes)
        if actual is None:
            return [predicted]
        error = self.scenario.pointing.actual or AttitudeError()
        with _as_mission_error("pointing.actual"):
            self._ck(actual, flown_attitudes(attitudes, error, self.scenario))
        return [predicted, actual]

    def _ck(self, name: str, attitudes: AttitudeHistory) -> None:
        bus, epoch = self.scenario.spacecraft.frame, float(attitudes.et[0])
        bus_from_camera = rotation(self.scenario.pointed_instrument.frame, bus.name, epoch)
        write_ck(
            self.folder / name,
            bus.id,
            self.scenario.clock.id,
            attitudes.et,
            bus_from_camera @ attitudes.camera_from_j2000,
            attitudes.rates_rad_s,  # the mounting is rigid: the bus turns as the camera does
            interval_starts=attitudes.interval_starts.tolist(),
            comment=self.comment,
        )


@contextlib.contextmanager
def _as_mission_error(field: str) -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise MissionError(f"scenario: {field}: {error}.") from error

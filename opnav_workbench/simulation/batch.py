"""A scenario's pictures, one after the other or on several processes; the bytes are the same either way.

What can be wrong with a scenario is checked for every picture before the first is made. Each picture is written
whole or not at all, so what is finished when a run is stopped stays, and is good.
"""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from opnav_workbench.errors import MissionError
from opnav_workbench.files import make_folder
from opnav_workbench.kernels import KernelSet
from opnav_workbench.processes import in_processes
from opnav_workbench.simulation.opened_scenario import OpenedScenario, ScenarioPicture
from opnav_workbench.simulation.output import PictureReport, write_picture
from opnav_workbench.simulation.picture import expose_picture
from opnav_workbench.simulation.scenario import PictureScenario

__all__ = ["chosen_pictures", "simulate"]


def simulate(
    scenario: PictureScenario,
    out: Path,
    *,
    jobs: int = 1,
    only: Sequence[str] = (),
    done: Callable[[PictureReport], None] = lambda _: None,
) -> tuple[PictureReport, ...]:
    """Simulate the pictures of a scenario and write them.

    Parameters
    ----------
    out
        Folder; gets for every picture ``NAME.fit``, its truth and its preview.
    jobs
        Processes. A script that asks for more than one must guard its main part (``if __name__ == "__main__"``).
    only
        Names of pictures (of a series: its name, or that of one of its pictures); none: all.
    done
        Called with each picture's report as soon as it stands, in any order.

    Returns
    -------
    tuple of PictureReport
        In the scenario's order.

    Raises
    ------
    MissionError, KernelError, CameraError, CatalogError
        The scenario asks for something that there is not; nothing has been written.
    SessionError
        The folder cannot be written any more; finished pictures stay.
    """
    if jobs < 1:
        raise MissionError(f"{jobs} jobs; give 1 or more.")
    pictures = chosen_pictures(scenario, only)
    with _scenario_opened(scenario) as opened:
        opened.check(pictures)
        make_folder(out)
        opening = partial(_scenario_opened, scenario, _active_kernels())
        return in_processes(pictures, jobs, opening, partial(_make_picture, out=out), done, here=opened)


def chosen_pictures(scenario: PictureScenario, only: Sequence[str]) -> tuple[ScenarioPicture, ...]:
    """Return the pictures to make.

    Raises
    ------
    MissionError
        A name in `only` is that of no picture.
    """
    pictures = [
        (entry.name, ScenarioPicture(index, picture))
        for index, entry in enumerate(scenario.pictures)
        for picture in entry.expanded()
    ]
    names = {name for series, picture in pictures for name in (series, picture.name)}
    unknown = [name for name in only if name not in names]
    if unknown:
        offered = ", ".join(dict.fromkeys(series for series, _ in pictures))
        raise MissionError(f"no picture named {', '.join(unknown)} in this scenario; it has {offered}.")
    return tuple(picture for series, picture in pictures if not only or {series, picture.name} & set(only))


@contextlib.contextmanager
def _scenario_opened(scenario: PictureScenario, kernels: Sequence[Path] = ()) -> Iterator[OpenedScenario]:
    """Open kernels and catalog; kernels of the caller serve a scenario that names none."""
    with contextlib.ExitStack() as stack:
        source = scenario.kernel_source()
        if source is not None:
            with scenario.naming(("kernels",)):
                stack.enter_context(KernelSet(source))
        elif kernels:
            stack.enter_context(KernelSet(kernels))
        elif KernelSet.active() is None:
            raise scenario.fault(
                ("kernels",), "the scenario names no kernels, and none are loaded; name a set"
            )
        yield OpenedScenario.open(scenario)


def _active_kernels() -> tuple[Path, ...]:
    """Return the caller's kernels, so that other processes can open them too; metakernels are followed by theirs."""
    active = KernelSet.active()
    return () if active is None else tuple(k.path for k in active.kernels() if k.kind != "META")


def _make_picture(opened: OpenedScenario, picture: ScenarioPicture, out: Path) -> PictureReport:
    made = expose_picture(opened.inputs(picture))
    return write_picture(made, opened.mission, out, picture.entry.stretch, opened.truth_settings(picture))

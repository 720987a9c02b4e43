"""The second round of a night: pictures without stars take the pointing of their neighbors, once all of them are in place.

Flow   folders of the night -> who has stars, who has none -> a copy in the working folder, with the carried pointing -> put
       into its place, as every result of a night

Pictures of earlier nights take part: one that waited for its neighbor has it when the neighbor arrives. What an analyst has
worked on gives its pointing, and takes none. The notebook of a picture shows how far its own stars led.
"""

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from opnav_workbench.errors import OpNavError, plain_line
from opnav_workbench.files import fitting_name
from opnav_workbench.headless.night_spec import NightSpec
from opnav_workbench.headless.records import (
    RECORD_FILE,
    is_of_an_analyst,
    read_record,
    result_field,
    session_digest,
)
from opnav_workbench.headless.settling import Settled, settle
from opnav_workbench.processing import OpenedProcessing
from opnav_workbench.processing.carrying import pointings_to_take, take_pointing
from opnav_workbench.session import Settings
from opnav_workbench.session.folder_lock import LOCK_FILE
from opnav_workbench.stars.pointing import SolvedAttitude

__all__ = ["CarriedPicture", "carry_in_night"]


@dataclass(frozen=True, slots=True)
class CarriedPicture:
    """A picture that should have its neighbors' pointing.

    Attributes
    ----------
    placed
        Whether its new result stands in its place.
    note
        What somebody must know; empty as a rule.
    """

    name: str
    placed: bool
    note: str = ""


def carry_in_night(spec: NightSpec, folders: Sequence[Path], work: Path) -> Iterator[CarriedPicture]:
    """Carry pointings between the pictures of a night, where that is asked for (``carry_within_s``).

    Parameters
    ----------
    folders
        Of its pictures; those without results are left out.
    work
        Folder on the same file system, for copies.

    Raises
    ------
    OpNavError
        Mission, kernels or catalog cannot be opened any more; the folders cannot be written.
    """
    settings = Settings.from_dict(dict(spec.settings))
    if not settings.carry_within_s > 0.0:
        return
    taking = pointings_to_take(folders, settings)
    own = {folder: near for folder, near in taking.items() if _is_the_nights(folder)}
    if not own:
        return
    opened = spec.opened()
    with spec.kernel_set():
        for folder, near in own.items():
            yield _carried(folder, near, opened, work)


def _is_the_nights(folder: Path) -> bool:
    record = read_record(folder)
    return record is not None and not is_of_an_analyst(record, session_digest(folder))


def _carried(
    folder: Path, near: Sequence[SolvedAttitude], opened: OpenedProcessing, work: Path
) -> CarriedPicture:
    record, copy = read_record(folder), work / fitting_name(folder.name, "-carried")
    assert record is not None
    shutil.copytree(folder, copy, ignore=shutil.ignore_patterns(RECORD_FILE, LOCK_FILE))
    try:
        take_pointing(copy, near, opened)
    except OpNavError as error:
        return _not_carried(folder, near, str(error))
    except Exception as error:  # a defect of ours must not cost the other pictures
        return _not_carried(folder, near, plain_line(f"unforeseen {type(error).__name__}: {error}"))
    settled: Settled = settle(
        copy, folder, replace(record, session=session_digest(copy), status=result_field(copy, "status"))
    )
    return CarriedPicture(folder.name, settled.placed, settled.note)


def _not_carried(folder: Path, near: Sequence[SolvedAttitude], why: str) -> CarriedPicture:
    return CarriedPicture(
        folder.name, placed=False, note=f"the pointing of {near[0].image} is not carried: {why}"
    )

"""The kinds of files that people and other programs read or write: how each is recognized, described and loaded.

To add a kind of YAML file, give its pydantic model a line in `KINDS`: schema, check and documentation follow.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from opnav_workbench.camera import Camera
from opnav_workbench.camera.camera_file import CameraFile
from opnav_workbench.catalog.user_files import StarList, read_star_list
from opnav_workbench.contracts.layouts import BodyFile, ObservablesFile, ResultFile, SessionFile, StatusFile
from opnav_workbench.errors import CameraError, CatalogError, MissionError, OpNavError, SessionError
from opnav_workbench.headless.night_spec import NightSpec, load_night
from opnav_workbench.kernels.making.scenario import Scenario, load_scenario
from opnav_workbench.kernels.manifest import Manifest, load_manifest
from opnav_workbench.mission import MissionFile, load_mission
from opnav_workbench.planning.sequence import PictureSequence, load_sequence
from opnav_workbench.rehearsal.scenario import OrtScenario, load_ort_scenario
from opnav_workbench.session.decisions import Decisions, load_decisions
from opnav_workbench.simulation.scenario import PictureScenario, load_picture_scenario

__all__ = ["KINDS", "Kind", "kind_of_content"]


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of file.

    Attributes
    ----------
    name
        As ``opnav check --as`` takes it, and as its schema is called.
    what
        In words.
    model
        Its layout.
    load
        What reads such a YAML file whole, with what the model alone cannot tell; None for JSON.
    failure
        The error that reading raises.
    version
        Of `opnav_workbench.format_versions.PRESENT_VERSION`.
    """

    name: str
    what: str
    model: type[BaseModel]
    load: Callable[[Path], Any] | None = None
    failure: type[OpNavError] = SessionError
    version: str = "yaml"

    @property
    def is_yaml(self) -> bool:
        """Whether people write it, as YAML; the others are JSON that the program writes."""
        return self.load is not None

    def score(self, content: Mapping[str, Any]) -> tuple[bool, int]:
        """Tell how much a content looks like this kind: whether all that is required is there, and how many keys fit."""
        fields = self.model.model_fields
        whole = all(name in content for name, field in fields.items() if field.is_required())
        known = sum(str(key) in fields for key in content)
        return whole and known > 0, known - sum(str(key) not in fields for key in content)


def _whole_mission(path: Path) -> None:
    """Read a mission and every camera that it names."""
    mission = load_mission(path)
    for name in mission.camera_names:
        mission.camera_named(name)
    if mission.target_stars is not None:
        read_star_list(mission.target_stars)


_ALL = (
    Kind("mission", "mission file", MissionFile, _whole_mission, MissionError),
    Kind("camera", "camera file", CameraFile, Camera.from_yaml, CameraError),
    Kind("scenario", "scenario of kernels", Scenario, load_scenario, MissionError),
    Kind("pictures", "picture scenario", PictureScenario, load_picture_scenario, MissionError),
    Kind("sequence", "picture sequence", PictureSequence, load_sequence, MissionError),
    Kind("rehearsal", "rehearsal scenario", OrtScenario, load_ort_scenario, MissionError),
    Kind("decisions", "decisions file", Decisions, load_decisions),
    Kind("night", "night file", NightSpec, load_night),
    Kind("manifest", "manifest", Manifest, load_manifest, MissionError),
    Kind("stars", "star list", StarList, read_star_list, CatalogError),
    Kind("result", "result", ResultFile, version="result"),
    Kind("session", "session", SessionFile, version="session"),
    Kind("status", "status of a night", StatusFile, version="status"),
    Kind("observables", "observables", ObservablesFile, version="observables"),
    Kind("body", "body of a sequence", BodyFile, version="body"),
)
KINDS: Mapping[str, Kind] = {kind.name: kind for kind in _ALL}


def kind_of_content(content: Any, *, yaml: bool) -> Kind | None:
    """Return the kind that a file's content looks like; None where it looks like none.

    Examples
    --------
    >>> kind_of_content({"mission": "new_horizons", "images": ["a.fit"]}, yaml=True).name
    'night'
    """
    if not isinstance(content, Mapping):
        return None
    scores = [(kind.score(content), kind) for kind in _ALL if kind.is_yaml is yaml]
    best, kind = max(scores, key=lambda item: item[0])
    return kind if best[0] or best[1] > 0 else None

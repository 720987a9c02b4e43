"""The automatic policy: how pictures are processed without a person, checked before the first of them is opened."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from opnav_workbench.catalog import Catalog, open_catalog
from opnav_workbench.errors import SessionError
from opnav_workbench.mission import Mission
from opnav_workbench.session import ATTITUDE_SOURCES, BODY_METHODS, Settings
from opnav_workbench.session.decisions import Decisions
from opnav_workbench.stars.pointing.attitude_steps import POINTING_MODELS

__all__ = ["Policy"]


@dataclass(frozen=True, slots=True)
class Policy:
    """How pictures are processed without a person.

    Attributes
    ----------
    mission : Mission
    catalog : str
    targets : sequence of str or None
        None takes the mission's default targets where kernels are loaded, and none without.
    method : str
        How bodies are found; ``auto`` takes what suits each.
    methods : mapping of str to str
        The same for single bodies, by name.
    target_stars : Path or None
    attitude : {"auto", "kernels", "header"}
    model : {"euler", "image_plane"}
    initial, final : str
        Star centerfinders.
    decisions : Decisions
    settings : Settings
    """

    mission: Mission
    catalog: str = "bundled"
    targets: Sequence[str] | None = None
    method: str = "auto"
    methods: Mapping[str, str] = field(default_factory=dict)
    target_stars: Path | None = None
    attitude: str = "auto"
    model: str = "euler"
    initial: str = "matched_filter"
    final: str = "least_squares"
    decisions: Decisions = field(default_factory=Decisions)
    settings: Settings = field(default_factory=Settings)
    opened_catalog: Catalog = field(init=False, repr=False)  # once for all pictures

    def __post_init__(self) -> None:
        """Refuse at once what would fail for every picture."""
        if self.model not in POINTING_MODELS:
            raise SessionError(
                f"unknown pointing model {self.model!r}; choose one of {', '.join(POINTING_MODELS)}."
            )
        if self.attitude not in ATTITUDE_SOURCES:
            raise SessionError(
                f"unknown attitude source {self.attitude!r}; choose one of {', '.join(ATTITUDE_SOURCES)}."
            )
        unknown = sorted({self.method, *self.methods.values()} - set(BODY_METHODS))
        if unknown:
            raise SessionError(
                f"unknown body method {', '.join(unknown)}; choose one of {', '.join(BODY_METHODS)}."
            )
        object.__setattr__(self, "opened_catalog", open_catalog(self.catalog))

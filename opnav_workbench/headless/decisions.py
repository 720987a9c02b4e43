"""Decisions: what an analyst accepted and rejected, as a file that headless runs apply (YAML).

::

    images:
      lor_0299.fit:            # file name of the picture, or "*" for every picture
        reject:
          - {star: TYC 1234-567-1, reason: cosmic ray}
        accept:
          - {star: "row:17", reason: faint but clean}
"""

from pathlib import Path

from pydantic import BaseModel, ConfigDict

from opnav_workbench.errors import SessionError
from opnav_workbench.session import ImageSession
from opnav_workbench.yaml_file import read_model

__all__ = ["Decisions", "load_decisions"]

EVERY_IMAGE = "*"


class _Verdict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    star: str
    reason: str = ""


class _ImageDecisions(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    reject: tuple[_Verdict, ...] = ()
    accept: tuple[_Verdict, ...] = ()


class Decisions(BaseModel):
    """Recorded decisions by picture."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    images: dict[str, _ImageDecisions] = {}

    def apply(self, session: ImageSession) -> None:
        """Make the session's decisions; those for every picture skip stars that are not in its field."""
        name = session.context.frame.path.name
        stars = session.state.a_priori
        known = set() if stars is None else set(stars.id.tolist())
        for key in (EVERY_IMAGE, name):
            chosen = self.images.get(key, _ImageDecisions())
            for verdicts, decide in (
                (chosen.reject, session.reject_stars),
                (chosen.accept, session.accept_stars),
            ):
                for verdict in verdicts:
                    if key == name or verdict.star in known:
                        decide([verdict.star], verdict.reason)


def load_decisions(path: str | Path) -> Decisions:
    """Read a decisions file.

    Raises
    ------
    SessionError
        The file is missing, is not YAML, or breaks the layout (the place is named).
    """
    return read_model(path, Decisions, "decisions file", SessionError)

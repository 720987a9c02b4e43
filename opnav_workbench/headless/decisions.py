"""Recorded decisions, as headless runs read them; the file's layout is described in `opnav_workbench.session.decisions`."""

from opnav_workbench.session.decisions import Decisions, load_decisions, write_decisions

__all__ = ["Decisions", "load_decisions", "write_decisions"]

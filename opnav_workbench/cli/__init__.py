"""The ``opnav`` program."""

from opnav_workbench.cli.app import app, main

__all__ = ["app", "main"]

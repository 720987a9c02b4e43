"""opnav_workbench: optical navigation from spacecraft images."""

__version__ = "0.1.0"

"""``python -m opnav_workbench`` is the ``opnav`` program."""

from opnav_workbench.cli import main

if __name__ == "__main__":
    main()

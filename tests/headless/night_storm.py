"""A storm over a night, ``python tests/headless/night_storm.py [--warm] [--pictures 300] [--events 500] [--seed 1]``.

``--keep FOLDER --seconds 500`` holds on after that time, with status 75; the same command goes on with the storm.

Nights with changing options run over the same pictures and are killed (SIGKILL) or ended (SIGTERM) at random moments, while
analysts open some of the pictures, decide, and leave or are killed.  Real processes, locks and signals; a picture's
processing is stood in for, so that an event takes a second.  With ``--warm`` a short notebook stands in for it, in
processes as a real night has them, which are killed too: copies of a warm one, in every fourth night a new Python each.  At
the end a night is left in peace, and it is asked:

* does every decision that an analyst was told is saved stand in the picture's folder, or in the attic?
* is everything else what a night that nobody disturbed makes of the same pictures?

Prints what happened; exit status 1 if anything was lost.
"""

import argparse
import json
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import nbformat
import psutil
from rich.console import Console

from opnav_workbench.campaign import Campaign
from opnav_workbench.cli.nightly import _run_plan
from opnav_workbench.errors import SessionError
from opnav_workbench.files import write_json
from opnav_workbench.headless.night import plan_night
from opnav_workbench.headless.night_workers import LocalPool
from opnav_workbench.headless.records import is_of_an_analyst, read_record, session_digest
from opnav_workbench.resources import notebooks_dir

sys.path.insert(0, str(Path(__file__).parent))
from stub_night import Analyst, StubPool, decisions_below, result_of, spec_of

MODELS = ("euler", "image_plane")
NEW_DESKS = 0.05  # of the events
COLD_NIGHTS = 0.25
LONGEST_S = 2.5  # before a night is ended: some come far, some not to their first picture
LONGEST_WARM_S = 15.0  # of which it takes some to load everything
STATE_FILE = "storm.json"
TO_BE_CONTINUED = 75


def work(job, folder):
    """Take a moment, and leave what a notebook leaves; now and then something goes wrong."""
    time.sleep(0.005)
    if random.random() < 0.02:
        return "machine", "a worker was lost"
    return result_of(job, folder)


def run_night(images: Path, out: Path, model: str, pool=None, **how) -> None:
    """A night as the command runs it."""
    plan = plan_night(spec_of(images, model=model, **how), out)
    with Path(os.devnull).open("w", encoding="utf-8") as nothing:
        _run_plan(Console(file=nothing), plan, pool or StubPool(), None, None)


# What `result_of` leaves, by a notebook in a process of its own.
NOTEBOOK = """
import sys
from pathlib import Path
from types import SimpleNamespace
sys.path.insert(0, {tests!r})
from stub_night import result_of
result_of(SimpleNamespace(image=image, parameters={{"model": model}}), Path(out))
"""


def short_notebook(path: Path) -> Path:
    """Write a notebook with the parameters of the real one, which leaves a result at once."""
    real = nbformat.read(notebooks_dir() / "process_image.ipynb", 4)
    parameters = next(cell for cell in real.cells if "parameters" in cell.metadata.get("tags", []))
    code = NOTEBOOK.format(tests=str(Path(__file__).parent))
    real.cells = [parameters, nbformat.v4.new_code_cell(code, id="work")]
    nbformat.write(real, path)
    return path


def in_a_process(call) -> int:
    """Start `call` in a process of its own; return its id."""
    child = os.fork()
    if child:
        return child
    status = 1
    try:
        call()
        status = 0
    except (SessionError, AssertionError):
        status = 3  # refused: another is at work there
    except KeyboardInterrupt:
        status = 0
    finally:
        os._exit(status)


def analyst_at(folder: Path, said: int, seed: int) -> None:
    """Open a picture, decide some things, tell of each that is saved, and leave."""
    chance = random.Random(seed)
    analyst = Analyst(folder)
    for number in range(chance.randint(1, 4)):
        reason = f"{folder.name} {seed} {number}"
        analyst.decide(reason)
        os.write(said, f"{reason}\n".encode())
        time.sleep(chance.uniform(0.0, 0.2))
    analyst.leave()


class Storm:
    """Pictures, their nights and their analysts."""

    def __init__(self, top: Path, pictures: int, desks: int, seed: int, *, warm: bool = False) -> None:
        self.top, self.n_desks, self.warm = top, desks, warm
        self.images, self.out = top / "in", top / "out"
        self.told, self.tell = os.pipe()
        os.set_blocking(self.told, False)
        self.analysts: list[int] = []
        before = json.loads((top / STATE_FILE).read_text()) if (top / STATE_FILE).exists() else {}
        self.saved, self.used = set(before.get("saved", ())), set(before.get("used", ()))
        self.count, self.events = Counter(before.get("count", {})), before.get("events", 0)
        self.chance = random.Random(f"{seed} {self.events}")
        self.how = {"notebook": str(short_notebook(top / "short.ipynb")), "retries": 1} if warm else {}
        if not before:
            self.images.mkdir()
            for number in range(pictures):
                (self.images / f"p{number:04d}.fit").write_text(f"picture {number}")
            self.night(self.out, MODELS[0], peace=True)
        self.names = sorted(path.stem for path in self.images.iterdir())
        self.desks = before.get("desks") or self.chance.sample(self.names, desks)

    def hold_on(self) -> None:
        """Let the analysts leave, and write down all that is to be known when the storm goes on."""
        self.look_after(wait=True)
        known = {"saved": sorted(self.saved), "used": sorted(self.used), "desks": self.desks}
        write_json(self.top / STATE_FILE, {**known, "count": dict(self.count), "events": self.events})

    def night(self, out: Path, model: str, *, peace: bool = False, cold: bool = False) -> None:
        """One night, in this process."""
        pool = LocalPool(2, warm=not cold) if self.warm else StubPool() if peace else StubPool(work)
        run_night(self.images, out, model, pool, **self.how)

    def cut_short(self) -> None:
        """One night that is cut short, with whoever comes meanwhile."""
        if self.chance.random() < NEW_DESKS:  # what analysts worked on no night replaces: on with others
            self.desks = self.chance.sample(self.names, self.n_desks)
        model = self.chance.choice(MODELS)
        cold = self.warm and self.chance.random() < COLD_NIGHTS
        self.count["cold nights"] += cold
        child = in_a_process(lambda: self.night(self.out, model, cold=cold))
        ends = time.monotonic() + self.chance.uniform(0.05, LONGEST_WARM_S if self.warm else LONGEST_S)
        while time.monotonic() < ends:
            if self.chance.random() < (0.03 if self.warm else 0.15):
                self.analyst_comes()
            if self.warm and self.chance.random() < 0.1:
                self.picture_ends(child, cold=cold)
            time.sleep(0.1)
        how = self.chance.choice((signal.SIGKILL, signal.SIGTERM))
        with suppress(ProcessLookupError):
            os.kill(child, how)
        _, status = os.waitpid(child, 0)
        finished = how == signal.SIGKILL and os.WIFEXITED(status)
        self.happened("nights that were ready first" if finished else f"nights ended by {how.name}")
        if self.chance.random() < 0.3 and self.analysts:
            with suppress(ProcessLookupError):
                os.kill(self.analysts[-1], signal.SIGKILL)
            self.count["analysts killed"] += 1
        self.look_after()

    def happened(self, what: str) -> None:
        self.events += 1
        self.count[what] += 1

    def picture_ends(self, night: int, *, cold: bool) -> None:
        """Kill the process of a picture or its kernel, now and then the one that all are copied from."""
        with suppress(psutil.Error, IndexError):
            first = self.chance.choice(psutil.Process(night).children())
            if self.chance.random() < (0.5 if cold else 0.1):
                first.kill()
                self.happened("cold pictures' processes killed" if cold else "warm processes killed")
            else:
                self.chance.choice(first.children()).kill()
                self.happened("kernels killed" if cold else "pictures' processes killed")

    def analyst_comes(self) -> None:
        name, seed = self.chance.choice(self.desks), self.chance.randrange(10**9)
        folder = self.out / name
        self.used.add(name)
        self.analysts.append(in_a_process(lambda: analyst_at(folder, self.tell, seed)))
        self.count["analysts came"] += 1

    def look_after(self, *, wait: bool = False) -> None:
        left = []
        for child in self.analysts:
            done, _ = os.waitpid(child, 0 if wait else os.WNOHANG)
            left += [] if done else [child]
        self.analysts = left
        with suppress(BlockingIOError):
            while heard := os.read(self.told, 1 << 16):
                self.saved |= set(heard.decode().splitlines())

    def verdict(self, top: Path) -> list[str]:
        """Let a night run in peace, and return what was lost."""
        self.look_after(wait=True)
        self.night(self.out, MODELS[0], peace=True)
        self.night(top / "peace", MODELS[0], peace=True)
        wrong = [f"lost: {reason}" for reason in self.saved - decisions_below(self.out)]
        mine = {
            f.name for f in self.out.iterdir() if f.is_dir() and not f.name.startswith(".") and of_analyst(f)
        }
        self.count["pictures that are analysts'"] = len(mine)
        self.count["decisions saved"] = len(self.saved)
        self.count["in the attic"] = len(list((self.out / ".attic").glob("*/*")))
        wrong += [f"{name} was worked on by nobody" for name in mine - self.used]
        with Campaign(self.out) as ours, Campaign(top / "peace") as theirs:
            one, other = (
                {e.image: (e.status, e.folder.name) for e in c.entries() if e.folder.name not in mine}
                for c in (ours, theirs)
            )
            content = [
                {
                    row["image"]: {k: v for k, v in row.items() if k not in ("history",)}
                    for row in c.dump()["images"]
                    if Path(row["image"]).stem not in mine
                }
                for c in (ours, theirs)
            ]
        wrong += [] if one == other and content[0] == content[1] else ["the archive is another one"]
        wrong += [str(path) for path in self.out.glob(".work/*")]
        return wrong


def of_analyst(folder: Path) -> bool:
    return is_of_an_analyst(read_record(folder), session_digest(folder))


def say(words: str) -> None:
    print(words, flush=True)  # noqa: T201


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name, value in (("pictures", 300), ("events", 500), ("desks", 10), ("seed", 1)):
        parser.add_argument(f"--{name}", type=int, default=value)
    parser.add_argument("--warm", action="store_true")
    parser.add_argument("--keep", type=Path, help="folder of a storm that goes on another time")
    parser.add_argument("--seconds", type=float, default=float("inf"))
    given = parser.parse_args()
    if given.keep:
        given.keep.mkdir(exist_ok=True)
        return weather(given.keep, given)
    with tempfile.TemporaryDirectory() as folder:
        return weather(Path(folder), given)


def weather(top: Path, given: argparse.Namespace) -> int:
    """Storm until all has happened, or for a while; return the exit status."""
    began = time.monotonic()
    storm = Storm(top, given.pictures, given.desks, given.seed, warm=given.warm)
    told = storm.events
    while storm.events < given.events:
        storm.cut_short()
        if storm.events >= told + 25:
            told = storm.events
            say(f"{told} events, {time.monotonic() - began:.0f} s: {dict(storm.count)}")
        if time.monotonic() > began + given.seconds:
            storm.hold_on()
            say(f"{storm.events} events, to be continued")
            return TO_BE_CONTINUED
    wrong = storm.verdict(top)
    say(f"{dict(storm.count)}\n" + ("\n".join(wrong) or "nothing lost, nothing else changed"))
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())

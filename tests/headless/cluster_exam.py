"""A night of many pictures on a Dask cluster of this machine, their processing stood in for: what the rest costs.

    python tests/headless/cluster_exam.py 10000 [workers]

Prints pictures a second and memory; the archive must hold every picture once.
"""

import hashlib
import json
import resource
import sys
import tempfile
import time
import uuid
from pathlib import Path

import distributed

sys.path.insert(0, str(Path(__file__).parent))
from stub_night import spec_of

from opnav_workbench.campaign import Campaign
from opnav_workbench.headless.night import Night, plan_night, run_night
from opnav_workbench.headless.night_summary import write_night_summary
from opnav_workbench.headless.night_workers import ClusterPool


def synthetic(values: dict) -> dict:
    """What a picture's process leaves, at once."""
    folder = Path(values["folder"]) / f"{values['name']}-{uuid.uuid4().hex[:8]}"
    folder.mkdir(parents=True)
    image = Path(values["image"])
    result = {"image": image.name, "mission": values["mission"], "status": "ok", "messages": [], "bodies": []}
    result |= {"sha256": hashlib.sha256(image.read_bytes()).hexdigest(), "stars": [], "pointing": None}
    (folder / "result.json").write_text(json.dumps(result | {"provenance": {"version": "stub"}}))
    outcome = {"fault": "", "reason": "", "seconds": 0.0, "peak_mb": 0.0, "tries": 1}
    return {"name": values["name"], "folder": str(folder), **outcome}


def main(count: int, workers: int) -> None:
    with tempfile.TemporaryDirectory() as place:
        images, out = Path(place) / "in", Path(place) / "out"
        images.mkdir()
        for number in range(count):
            (images / f"p{number:06d}.fit").write_text(f"picture {number}")
        began = time.monotonic()
        night = Night(plan_night(spec_of(images), out))
        planned = time.monotonic()
        with distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
        ) as cluster:
            ready = time.monotonic()
            run_night(night, ClusterPool(cluster.scheduler_address, work=synthetic))
            done = time.monotonic()
        write_night_summary(night)
        ended = time.monotonic()
        with Campaign(out) as campaign:
            entries = campaign.entries()
        assert len({entry.image for entry in entries}) == len(entries) == len(night.verdicts) == count
        assert not night.unplaced, night.unplaced
        assert not (out / ".work").exists()
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        sys.stdout.write(
            f"{count} pictures, {workers} workers: planned in {planned - began:.1f} s, done in {done - ready:.1f} s "
            f"({count / (done - ready):.0f} a second), summary {ended - done:.1f} s, {memory:.0f} MB with the scheduler\n"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 2)

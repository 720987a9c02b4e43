"""An archive of as many pictures as one likes, cloned from one run: for questions of size.

    python tests/campaign/many_pictures.py RUN ARCHIVE 100000

Every picture has its own name, time, pointing error and O-C; one in 50 fails for one of three causes.
"""

import sys
from pathlib import Path

import numpy as np
import sqlalchemy as sa

from opnav_workbench.campaign import Campaign
from opnav_workbench.campaign.schema import PARTS, tables

CAUSES = (
    "no attitude of NH_SPACECRAFT",
    "truncated: 100000 of 685440 bytes",
    "stopped at its time limit (300 s of 300 s)",
)
BLOCK = 2_000


def clone(
    run: Path, archive: Path, count: int, *, offset_px: float = 0.0, parts: tuple[str, ...] = PARTS
) -> None:
    """Fill an archive with `count` pictures like that of a run; `offset_px` moves every body's O-C along pixel."""
    with Campaign(archive) as campaign:
        campaign.ingest_run(run)
    engine = sa.create_engine(f"sqlite:///{archive}")
    with engine.begin() as connection:
        first = dict(connection.execute(sa.select(tables["images"])).mappings().one())
        rows = {name: _rows(connection, name) for name in parts}
        for name in (*PARTS, "images"):
            connection.execute(sa.delete(tables[name]))
        for start in range(0, count, BLOCK):
            numbers = range(start, min(start + BLOCK, count))
            connection.execute(sa.insert(tables["images"]), [_image(first, n) for n in numbers])
            for name, found in rows.items():
                made = [_row(name, row, n, offset_px) for n in numbers if n % 50 for row in found]
                if made:
                    connection.execute(sa.insert(tables[name]), made)
    engine.dispose()


def _rows(connection: sa.Connection, name: str) -> list[dict]:
    return [dict(row) for row in connection.execute(sa.select(tables[name])).mappings()]


def _image(first: dict, number: int) -> dict:
    minutes = 10 * number
    utc = np.datetime64("2015-04-09T12:00:00.000") + np.timedelta64(minutes, "m")
    made = {
        "id": number + 1,
        "key": f"{number:064x}",
        "image": f"pic_{number:06d}.fit",
        "sha256": f"{number:064x}",
    }
    made |= {"utc": str(utc), "et": first["et"] + 60.0 * minutes, "folder": f"/night/pic_{number:06d}"}
    if number % 50 == 0:
        cause = [CAUSES[number // 50 % len(CAUSES)]]
        made |= {"status": "failed", "messages": cause, "attention": cause}
    return first | made


def _row(name: str, row: dict, number: int, offset_px: float) -> dict:
    rng = np.random.default_rng([number, row.get("position", 0)])
    made = row | {"image_id": number + 1}
    if name == "pointings":
        made |= dict(zip(("delta_pixel", "delta_line"), rng.normal(0.0, 5.0, 2).tolist(), strict=True))
    if name == "bodies":
        for axis, shift in (("pixel", offset_px), ("line", 0.0)):
            sigma = row[f"covariance_oc_{axis}_{axis}"] ** 0.5
            made[f"residual_{axis}"] = shift + sigma * float(rng.normal())
    return made


if __name__ == "__main__":
    clone(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))

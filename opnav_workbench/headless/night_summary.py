"""The morning after: what came out of every picture, as plain values (``summary.json``), for a page, and for the queue."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from opnav_workbench.campaign.run_folder import attention_reasons
from opnav_workbench.errors import some_of
from opnav_workbench.files import inside, json_value, text_of
from opnav_workbench.headless.night import Night, NightPicture
from opnav_workbench.headless.night_pages import write_pages
from opnav_workbench.headless.night_trends import write_night_trends
from opnav_workbench.headless.night_workers import EXECUTED_FILE, HTML_FILE
from opnav_workbench.headless.records import NightRecord, read_record
from opnav_workbench.paths import exists, is_file  # a stale handle costs no page
from opnav_workbench.processing.queue_file import AnalystQueue, QueuedImage, write_queue
from opnav_workbench.session import RESULT_FILE
from opnav_workbench.version import __version__

__all__ = ["NOT_PROCESSED", "night_summary_dict", "not_archived", "write_night_summary"]

FIGURE_FILE = "summary.png"
POINTING_KEYS = ("delta_pixel", "delta_line", "delta_twist_deg", "rms_px", "n_stars")
BODY_KEYS = (
    "name",
    "method",
    "status",
    "residual_px",
    "residual_arcsec",
    "diameter_px",
    "measured_diameter_px",
)
NOT_PROCESSED = "not processed yet; run the same command again"


def write_night_summary(night: Night) -> dict[str, Any]:
    """Write ``summary.json``, ``summary.html``, ``trends.png`` and ``queue.json`` of a night's folder; return the summary.

    Raises
    ------
    SessionError
        The folder cannot be written.
    """
    out, spec = night.plan.out, night.plan.spec
    summary = night_summary_dict(night) | {"trends": write_night_trends(night.archive, out)}
    write_pages(summary, out)
    flagged = tuple(
        QueuedImage(row["path"], row["name"], row["status"], tuple(row["attention"]))
        for row in summary["images"]
        if row["attention"]
    )
    write_queue(out, AnalystQueue(flagged, spec.plain))
    return summary


def night_summary_dict(night: Night) -> dict[str, Any]:
    """Return what came out of a night, read from its folders.

    Returns
    -------
    dict
        ``version, written_utc, mission, kernels, catalog, targets, counts, processed_now, failed_now, not_archived_now,
        not_archived, notes, images``; an image has ``name, path, state, status, utc, messages, attention, why, pointing,
        bodies, seconds, peak_mb, tries`` and the names of its files. ``failed_now`` counts the pictures of this night that
        failed, whether an older result of theirs stands or not; ``not_archived_now`` those that the archive did not take.
    """
    spec = night.plan.spec
    now = {verdict.name: verdict for verdict in night.verdicts}
    images = [_image_row(night, picture, picture.name in now) for picture in night.plan.pictures]
    failed = {row["name"] for row in images if row["name"] in now and row["status"] == "failed"}
    failed |= {name for name, verdict in now.items() if verdict.fault}
    images.sort(key=lambda row: (row["utc"] is None, row["utc"] or "", row["name"]))
    return {
        "version": __version__,
        "written_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "mission": night.plan.mission,
        "kernels": spec.kernels,
        "catalog": spec.catalog,
        "targets": spec.targets,
        "counts": dict(Counter(row["status"] for row in images)),
        "processed_now": len(now),
        "failed_now": len(failed),
        "not_archived_now": len({line.partition(": ")[0] for line in night.unarchived} & now.keys()),
        "not_archived": not_archived(night),
        "notes": [
            *night.notes,
            *_told_once(f"{n}: {why}" for n, why in (night.unplaced | night.outlived).items()),
            *_touched_files(night.touched),
            *_copies(night.plan.pictures),
        ],
        "images": images,
    }


def not_archived(night: Night) -> list[str]:
    """Return what is not in the archive and why, pictures with the same reason in one line."""
    return _told_once(night.unarchived)


def _told_once(told: Iterable[str]) -> list[str]:
    """Return what is told of pictures (``name: why``), of those with the same reason in one line."""
    names: dict[str, list[str]] = {}
    for line in told:
        name, _, why = line.partition(": ")
        names.setdefault(why, []).append(name)
    return [f"{some_of(same)}: {why}" for why, same in names.items()]


def _touched_files(touched: Mapping[str, int]) -> Iterator[str]:
    files: dict[int, list[str]] = {}
    for name, count in touched.items():
        files.setdefault(count, []).append(name)
    for count, same in files.items():
        were, them = ("were", "them") if len(same) > 1 else ("was", "it")
        yield (
            f"{some_of(same)} {were} written to or taken away while the night ran: pictures processed with {them} "
            f"({count}) are done again next time"
        )


def _copies(pictures: Iterable[NightPicture]) -> Iterator[str]:
    """Tell of files with the same content: a picture's observables count once, however often it was delivered."""
    names: dict[str, list[str]] = {}
    for picture in pictures:
        if picture.basis.image_sha256:
            names.setdefault(picture.basis.image_sha256, []).append(picture.name)
    for same in names.values():
        if len(same) > 1:
            yield f"{some_of(same)} are one picture (the same content): the archive, and what is exported, hold it once"


def _image_row(night: Night, picture: NightPicture, processed_now: bool) -> dict[str, Any]:
    folder = inside(night.plan.out, picture.name)
    record = read_record(folder)
    result = _read_result(folder, record)
    state = _state_word(night, picture, record, processed_now)
    if state == "waiting":
        result = {"status": "waiting", "messages": [NOT_PROCESSED]}
    bodies = result.get("bodies") or []
    pointing = result.get("pointing")
    attention = attention_reasons(
        result["status"], result["messages"], [(b["name"], b["status"]) for b in bodies]
    )
    attention = attention if state != "waiting" else ()  # there is nothing yet that a person could look at
    return {
        "name": picture.name,
        "path": str(picture.image),
        "state": state,
        "status": result["status"],
        "utc": result.get("utc"),
        "messages": result["messages"],
        "attention": list(attention),
        "why": list(picture.why) if state == "now" and picture.state != "new" else [],
        "pointing": None if pointing is None else {key: pointing[key] for key in POINTING_KEYS},
        "bodies": [_body_row(body) for body in bodies],
        "seconds": None if record is None else record.seconds,
        "peak_mb": None if record is None else record.peak_mb,
        "tries": None if record is None else record.tries,
        "files": [n for n in (RESULT_FILE, FIGURE_FILE, HTML_FILE, EXECUTED_FILE) if is_file(folder / n)],
    }


def _state_word(night: Night, picture: NightPicture, record: NightRecord | None, processed_now: bool) -> str:
    """Return whose the result is that stands in a picture's folder; "waiting" where there is none yet."""
    if picture.name in night.unplaced:
        return "kept"
    if picture.name in night.outlived:
        return "older"
    if picture.state in ("new", "arriving"):
        return "now" if processed_now else "done" if _stands(picture, record) else "waiting"
    return picture.state


def _stands(picture: NightPicture, record: NightRecord | None) -> bool:
    """Tell of a picture whose turn did not come, or did not end, whether a good result of the same inputs is in its place.

    A night that is stopped as it puts a result there has it.
    """
    if record is None or record.fault or record.status == "failed":
        return False
    return bool(picture.fingerprint) and record.fingerprint == picture.fingerprint


def _body_row(body: Mapping[str, Any]) -> dict[str, Any]:
    covariance = body.get("covariance_with_pointing_px2")
    known = covariance is not None and None not in (covariance[0][0], covariance[1][1])
    sigma = [covariance[0][0] ** 0.5, covariance[1][1] ** 0.5] if known else None  # type: ignore[index]
    return {key: body.get(key) for key in BODY_KEYS} | {"sigma_px": sigma, "observed": body.get("observed")}


def _read_result(folder: Path, record: NightRecord | None) -> dict[str, Any]:
    """Return what came out; where the machine failed a picture there is no result, but a record that says why."""
    if record is not None and record.reason and not exists(folder / RESULT_FILE):
        return {"status": "failed", "messages": [record.reason]}
    try:
        result: dict[str, Any] = json_value(text_of(folder / RESULT_FILE))
        return {"status": result["status"], "messages": list(result["messages"])} | result
    except (OSError, ValueError, KeyError, TypeError):
        return {
            "status": "failed",
            "messages": [f"its {RESULT_FILE} is missing or damaged; process it again"],
        }

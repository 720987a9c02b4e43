"""One clear line for a SPICE failure: what was asked, when, what is missing, what helps, what is loaded."""

import contextlib
import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import spiceypy

from opnav_workbench.spice import pool
from opnav_workbench.spice.coverage import Coverage, ck_structures, windows_of
from opnav_workbench.spice.messages import MESSAGES, UNKNOWN, VARIABLE_REMEDIES, Look

__all__ = ["Request", "explanation", "loaded_text", "time_text", "unknown_body", "unlisted_explanation"]

SHOWN_FILES = 12  # more names than this hide the message
SHOWN_WINDOWS = 3
NAMED_BODIES = range(1, 1000)  # Sun, planets, moons: SPICE knows these names by itself
SOLAR_SYSTEM_BARYCENTER = 0


@dataclass(frozen=True, slots=True)
class Request:
    """What a caller wants from SPICE; the words of an error message."""

    what: str  # begins the message
    et: float | None = None
    bodies: tuple[str | int, ...] = ()
    frame: str | None = None


def explanation(error: spiceypy.SpiceyError, request: Request) -> str:
    """Return one line on a failure, with the loaded kernels, lock held."""
    return f"{unlisted_explanation(error, request)}. {loaded_text()}"


def unlisted_explanation(error: spiceypy.SpiceyError, request: Request) -> str:
    """Return what failed, why and what helps, without the loaded kernels and the final stop; lock held."""
    short = (getattr(error, "short", "") or "").removeprefix("SPICE(").removesuffix(")")
    detail = _detail(error)
    message = MESSAGES.get(short, UNKNOWN)
    cause, remedy = message.cause, message.remedy
    with contextlib.suppress(spiceypy.SpiceyError):  # a look that fails must not hide the failure
        cause, remedy = _looked(message.look, detail, request) or (cause, remedy)
    cause, remedy = (
        t.replace("{detail}", detail).replace("{short}", short or "nothing found") for t in (cause, remedy)
    )
    when = f" at {time_text(request.et)}" if request.et is not None else ""
    return f"{request.what}{when}: {cause}; {remedy}"


def _detail(error: spiceypy.SpiceyError) -> str:
    text = " ".join(
        (getattr(error, "long", "") or getattr(error, "message", "") or "no further word").split()
    )
    return re.split(r"\.\s+[A-Z]", text, maxsplit=1)[0].rstrip(".")  # the first sentence says it


def time_text(et: float) -> str:
    """Return a time as UTC, or as TDB seconds past J2000 while no LSK is loaded; lock held."""
    try:
        return f"{spiceypy.et2utc(et, 'ISOC', 3)} UTC"
    except spiceypy.SpiceyError:
        return f"et {et:.3f} s"


def loaded_text() -> str:
    """Name the loaded kernel files, lock held."""
    names = [f.path.name for f in pool.loaded_files()]
    more = f" and {len(names) - SHOWN_FILES} more" if len(names) > SHOWN_FILES else ""
    return f"Loaded kernels: {', '.join(names[:SHOWN_FILES]) or 'none'}{more}."


def _looked(look: Look | None, detail: str, request: Request) -> tuple[str, str] | None:
    if look is Look.EPHEMERIS and request.et is not None:
        return _ephemeris_gap(request.et, request.bodies, detail)
    if look is Look.ATTITUDE and request.et is not None and request.frame is not None:
        return _attitude_gap(request.et, request.frame, has_velocity=bool(request.bodies))
    if look is Look.FRAME:
        return _unknown_frame(request.frame)
    if look is Look.BODY:
        return unknown_body(request.bodies)
    if look is Look.VARIABLE:
        return _missing_variable(detail)
    return None


def _ephemeris_gap(et: float, bodies: Iterable[str | int], detail: str) -> tuple[str, str] | None:
    """Name the bodies without coverage; SPICE may have stopped at one that the caller did not name."""
    stopped_at = re.findall(r"(?:state of|relative to) (-?\d+)", detail)
    numbers = dict.fromkeys(_number(b) for b in (*bodies, *stopped_at))
    windows = [windows_of("SPK", n) for n in numbers if n is not None and n != SOLAR_SYSTEM_BARYCENTER]
    missing = [w for w in windows if not w.contains(et)]
    if missing:
        cause = ", and ".join(_spk_gap_text(w, et) for w in missing)
        return (
            cause,
            f"load an SPK that covers {' and '.join(_body_text(w) for w in missing)} at {time_text(et)}",
        )
    names = " and ".join(_body_text(w) for w in windows)
    return (
        f"the loaded SPKs hold {names} but do not connect them, or not as early as one light time before",
        "load a planetary ephemeris that ties their centers to the solar system barycenter, or a longer SPK",
    )


def _spk_gap_text(window: Coverage, et: float) -> str:
    if not window.paths:
        return f"no loaded SPK holds {_body_text(window)}"
    return f"outside the loaded SPKs of {_body_text(window)}, which cover {_windows_text(window, et)}"


def _attitude_gap(et: float, frame: str, *, has_velocity: bool) -> tuple[str, str] | None:
    structures = ck_structures(spiceypy.namfrm(frame))
    for structure in structures:
        clock = spiceypy.ckmeta(structure, "SCLK")
        if pool.pool_value(f"SCLK_DATA_TYPE_{-clock}") is None:
            return f"the spacecraft clock {clock} is unknown", f"add the SCLK kernel of clock {clock}"
        window = windows_of("CK", structure)
        if not window.paths:
            cause = f"no loaded CK holds the structure {_body_text(window)}"
            return cause, f"load a CK that covers it at {time_text(et)}"
        if not window.contains(et):
            return (
                f"outside the loaded CKs of {_body_text(window)}, which cover {_windows_text(window, et)}",
                f"load a CK that covers {time_text(et)}",
            )
    if not structures or not has_velocity:
        return None
    names = " and ".join(str(s) for s in structures)
    return (
        f"the loaded CKs cover {names} then, but without the angular rates that a velocity in {frame} needs",
        "ask in J2000 and rotate with the attitude, or load a CK with rates",
    )


def _body_text(window: Coverage) -> str:
    return window.name if window.name == str(window.body) else f"{window.name} ({window.body})"


def _windows_text(window: Coverage, et: float) -> str:
    """Show the windows nearest to a time, in order."""
    spans = window.intervals_et
    distance = np.maximum(spans[:, 0] - et, et - spans[:, 1])
    nearest = np.sort(np.argsort(distance, kind="stable")[:SHOWN_WINDOWS])
    shown = ", ".join(f"{_stamp(start)} to {_stamp(stop)}" for start, stop in spans[nearest])
    rest = len(spans) - SHOWN_WINDOWS
    return shown + (f" and {rest} window{'' if rest == 1 else 's'} farther away" if rest > 0 else "")


def _stamp(et: float) -> str:
    return time_text(et).removesuffix(" UTC")


def _number(body: str | int) -> int | None:
    try:
        return int(spiceypy.bods2c(str(body)))
    except spiceypy.NotFoundError:
        return None


def _unknown_frame(frame: str | None) -> tuple[str, str] | None:
    if frame is None:
        return None
    names = [str(v) for n in pool.pool_names("FRAME_*_NAME") for v in pool.pool_value(n) or ()]
    return (
        f"the frame {frame} is unknown{_close(frame, names)}",
        "correct its name or load the FK that defines it",
    )


def unknown_body(bodies: Iterable[str | int]) -> tuple[str, str]:
    """Return cause and remedy for the bodies that nobody knows, lock held."""
    unknown = [str(b) for b in bodies if _number(b) is None]
    own = [str(v) for v in pool.pool_value("NAIF_BODY_NAME") or ()]
    names = own + [spiceypy.bodc2s(n) for n in NAMED_BODIES]
    hints = ", ".join(f"{b!r} is unknown{_close(b, names)}" for b in unknown)
    return hints, "correct the name, give the NAIF number, or load the kernel that names it (NAIF_BODY_NAME)"


def _close(name: str, names: list[str]) -> str:
    close = difflib.get_close_matches(name.upper(), [n for n in names if not n.isdigit()], n=3)
    return f" (close: {', '.join(dict.fromkeys(close))})" if close else ""


def _missing_variable(detail: str) -> tuple[str, str] | None:
    for pattern, remedy in VARIABLE_REMEDIES:
        found = re.search(rf"\b{pattern}\b", detail)
        if found:
            return f"{found[0]} is not in the loaded kernels", remedy.format(*found.groups())
    return None

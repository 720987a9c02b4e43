"""What the numbers of a segment must be for SPICE to find its way among them, for every type that SPICE knows.

SPICE takes counts, sizes and addresses out of a segment without a look at them: a changed one makes it read beyond a
record or beyond its own memory, and the process ends. So the bookkeeping of every type is held against the segment's
size here, before SPICE sees the file; what a type does not keep within bounds by itself is bounded.

Types of one family share one description: packets with a table of epochs; equal steps; Chebyshev records; difference
lines; pieces ("mini-segments") of any family; and SPICE's "generic segments", whose last words tell where all is.

Source: NAIF, SPK, CK, PCK and DAF Required Reading; bounds of the readers' own memory from NAIF's include files
(spk*.inc, ck*.inc, sgparam.inc of N0067).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from opnav_workbench.arrays import FloatArray

__all__ = ["KNOWN_TYPES", "layout_fault"]

UNIT_TOLERANCE = 1e-2  # quaternion norm; writers differ in rounding, damage shows far beyond this
STEP_TOLERANCE_S = 1.0  # Chebyshev record midpoints against the even spacing that the segment promises
DIRECTORY_STEP = 100  # of every so many epochs one stands in a directory
LARGEST_RECORD = {"SPK": 197, "PCK": 129, "CK": 197}  # words that a reader's memory takes, but for its count
MOST_POINTS = 28  # of an interpolation: degree 27
DIFFERENCES = 15  # of a difference line of SPK type 1
MOST_DIFFERENCES = 25  # of SPK type 21
META_WORDS = 17  # of a generic segment
CK_CHEBYSHEV_WORDS = 143  # of a packet of CK type 4: 7 polynomials of 20 coefficients, and their head
CK_COUNTS_BASE = 128  # in which a packet of CK type 4 keeps its seven numbers of coefficients in one word

BAD = "its bookkeeping contradicts its size or itself"
Layout = Callable[["_Segment"], bool]


@dataclass(frozen=True, slots=True)
class _Segment:
    """The numbers of a segment, and the times (et or ticks) that it says it covers."""

    kind: str
    values: FloatArray
    begin: float
    end: float
    rates: bool = False  # of a CK, as its summary says

    def tail(self, count: int) -> tuple[int, ...] | None:
        """Return the last words as whole numbers, None where one is none or the segment is shorter."""
        return _tail(self.values, count)


def _tail(values: FloatArray, count: int) -> tuple[int, ...] | None:
    words = values[-count:] if len(values) >= count else np.array([np.nan])
    whole = (words % 1 == 0) & (np.abs(words) < 2**53)
    return tuple(int(w) for w in words) if whole.all() else None


def layout_fault(
    kind: str, data_type: int, values: FloatArray, span: tuple[float, float], *, rates: bool = False
) -> str:
    """Return what is wrong with the numbers of a segment, or nothing.

    Parameters
    ----------
    kind : {"SPK", "CK", "PCK"}
    data_type
        As the segment's summary has it.
    values
        All numbers of the segment.
    span
        First and last time of the summary: et; of a CK ticks.
    rates
        Whether the summary of a CK says that there are angular rates.
    """
    layout = LAYOUTS.get((kind, data_type))
    if layout is None:
        return f"type {data_type}, of which SPICE knows nothing"
    return "" if layout(_Segment(kind, values, *span, rates)) else BAD


def _directory(count: int) -> int:
    return (count - 1) // DIRECTORY_STEP


def _rising(times: FloatArray) -> bool:
    return bool((np.diff(times) > 0).all())


def _table(values: FloatArray, count: int) -> bool:
    """Epochs and their directory: every 100th of them, in old types what lies between it and the next."""
    epochs, directory = values[:count], values[count:]
    marks = epochs[DIRECTORY_STEP - 1 :: DIRECTORY_STEP][: len(directory)]
    following = np.append(epochs, epochs[-1])[DIRECTORY_STEP::DIRECTORY_STEP][: len(directory)]
    return _rising(epochs) and bool(((marks <= directory) & (directory <= following)).all())


# ---- SPK and PCK.


def _chebyshev(per_record: int, components: int, trailing: int) -> Layout:
    """Equal records of Chebyshev coefficients; the last two words are size and count of the records."""

    def holds(segment: _Segment) -> bool:
        values, tail = segment.values, segment.tail(2)
        if tail is None or len(values) < trailing:
            return False
        size, count = tail
        fits = count >= 1 and size * count + trailing == len(values)
        sizes = per_record + components <= size <= LARGEST_RECORD[segment.kind]
        if not (fits and sizes and (size - per_record) % components == 0):
            return False
        return trailing != 4 or _even_records(values, size, count)

    return holds


def _even_records(values: FloatArray, size: int, count: int) -> bool:
    start, step = values[-4:-2]
    midpoints, radii = values[:-4].reshape(count, size)[:, :2].T
    expected = start + step * (np.arange(count) + 0.5)
    return bool(step > 0 and (np.abs(midpoints - expected) < STEP_TOLERANCE_S).all() and (radii > 0).all())


def _chebyshev_velocity(segment: _Segment) -> bool:
    """Types 20: records, then units of angle or distance and of time, start (two words), step, size, count."""
    positive = len(segment.values) > 7 and bool((segment.values[[-7, -6, -3]] > 0).all())
    return positive and _chebyshev(3, 3, 7)(segment)


def _difference_lines(segment: _Segment, most: int, trailing: int) -> bool:
    """SPK types 1 and 21: lines of differences, their last times, every 100th of them, (size,) count."""
    values, tail = segment.values, segment.tail(trailing)
    count = 0 if tail is None else tail[-1]
    width = 4 * most + 11
    # As NAIF's own readers count it, unlike in other types, a full hundred has its entry.
    directory = count // DIRECTORY_STEP
    if count < 1 or (width + 1) * count + directory + trailing != len(values):
        return False
    lines = values[: width * count].reshape(count, width)
    epochs = values[width * count : -trailing]
    orders = lines[:, -4:]
    whole = (orders % 1 == 0).all() and (orders[:, 0] >= 1).all() and (orders[:, 1:] >= 0).all()
    bounded = whole and (orders[:, 0] <= most + 1).all() and (orders[:, 1:] <= most).all()
    return bool(bounded and _table(epochs, count) and epochs[count - 1] >= segment.end)


def _type_1(segment: _Segment) -> bool:
    return _difference_lines(segment, DIFFERENCES, 1)


def _type_21(segment: _Segment) -> bool:
    tail = segment.tail(2)
    return tail is not None and 1 <= tail[0] <= MOST_DIFFERENCES and _difference_lines(segment, tail[0], 2)


def _states(segment: _Segment) -> int:
    """Return the number of states of a table with epochs and two more words, 0 where it contradicts the size."""
    values, tail = segment.values, segment.tail(1)
    count = 0 if tail is None else tail[0]
    if count < 1 or 7 * count + _directory(count) + 2 != len(values):
        return 0
    return count if _table(values[6 * count : -2], count) else 0


def _type_5(segment: _Segment) -> bool:
    """States, epochs, directory, GM, count."""
    return _states(segment) > 0 and bool(segment.values[-2] > 0)


def _interpolated(most_points: int) -> Layout:
    """SPK types 9 and 13: states, epochs, directory, number of points less one, count."""

    def holds(segment: _Segment) -> bool:
        count, tail = _states(segment), segment.tail(2)
        return tail is not None and 1 <= tail[0] + 1 <= min(most_points, count)

    return holds


def _even_states(most_points: int) -> Layout:
    """SPK types 8 and 12: states, first epoch, step, number of points less one, count."""

    def holds(segment: _Segment) -> bool:
        values, tail = segment.values, segment.tail(2)
        if tail is None or tail[1] < 1 or 6 * tail[1] + 4 != len(values) or not values[-3] > 0:
            return False
        return 1 <= tail[0] + 1 <= min(most_points, tail[1])

    return holds


def _constants(count: int) -> Layout:
    """SPK types 15 and 17: a fixed number of elements."""
    return lambda segment: len(segment.values) == count


@dataclass(frozen=True, slots=True)
class _Packets:
    """Packets with epochs and their directory, in pieces or whole: words of a packet by subtype, points of a fit."""

    sizes: Mapping[int, int]
    most_points: Mapping[int, int]

    def fit(self, values: FloatArray, subtype: int, points: int, count: int, trailing: int) -> bool:
        """Tell whether packets, epochs and directory fill all but the `trailing` last of some words."""
        if subtype not in self.sizes or count < 1 or not 1 <= points <= self.most_points[subtype]:
            return False
        size = self.sizes[subtype]
        if (size + 1) * count + _directory(count) + trailing != len(values):
            return False
        return _table(values[size * count : len(values) - trailing], count)


# By subtype: 0 and 2 are Hermite's (values and derivatives), 1 and 3 Lagrange's.
SPK_18 = _Packets({0: 12, 1: 6}, {0: 14, 1: 28})
SPK_19 = _Packets({0: 12, 1: 6, 2: 6}, {0: 14, 1: 28, 2: 14})
CK_PACKETS = _Packets({0: 8, 1: 4, 2: 14, 3: 7}, {0: 12, 1: 24, 2: 12, 3: 24})


def _type_18(segment: _Segment) -> bool:
    """One piece alone."""
    return _piece(segment.values, SPK_18, 3)


def _pieces(packets: _Packets, trailing: int) -> Layout:
    """SPK type 19 and CK type 6: pieces, their bounds, every 100th of them, their addresses, a flag, their number."""

    def holds(segment: _Segment) -> bool:
        values, tail = segment.values, segment.tail(2)
        if tail is None or tail[1] < 1 or 2 * (tail[1] + 1) + tail[1] // DIRECTORY_STEP + 2 > len(values):
            return False
        count = tail[1]
        addresses = values[-3 - count : -2]
        last = len(values) - 2 * (count + 1) - count // DIRECTORY_STEP - 2 + 1
        whole = (addresses % 1 == 0).all() and _rising(addresses)
        if not (whole and addresses[0] == 1 and addresses[-1] == last):
            return False
        bounds = values[last - 1 : -3 - count]
        if not _table(bounds, count + 1) or not bounds[0] <= segment.begin <= segment.end <= bounds[-1]:
            return False
        starts = [int(a) - 1 for a in addresses]
        return all(_piece(values[a:b], packets, trailing) for a, b in pairwise(starts))

    return holds


def _piece(values: FloatArray, packets: _Packets, trailing: int) -> bool:
    """Packets, epochs, directory, (rate,) subtype, points, count."""
    tail = _tail(values, 3)
    if tail is None:
        return False
    subtype, points, count = tail
    return packets.fit(values, subtype, points, count, trailing) and (trailing == 3 or values[-4] > 0)


# ---- Generic segments: constants, packets, reference values and a directory of packets, by their last words.


@dataclass(frozen=True, slots=True)
class _Generic:
    """The last words of a generic segment: where constants, reference values and packets are, and how large."""

    constants: int
    packets: int
    packet_base: int
    packet_words: int  # of the largest
    packet_offset: int  # words that stand before each packet
    packet_addresses: FloatArray
    references: FloatArray


def _generic(segment: _Segment) -> _Generic | None:
    tail = segment.tail(META_WORDS)
    if tail is None or tail[-1] != META_WORDS or min(tail) < 0:
        return None
    room = len(segment.values) - META_WORDS
    areas = {name: tail[2 * i : 2 * i + 2] for i, name in enumerate(("constants", "directory"))}
    kind, areas["references"], areas["addresses"] = tail[4], tail[5:7], tail[7:9]
    address_kind, areas["packets"], areas["reserved"] = tail[9], tail[10:12], tail[12:14]
    if any(base + count > room for base, count in areas.values()) or kind > 4 or address_kind > 1:
        return None
    (first, number), (base, count) = areas["references"], areas["addresses"]
    values = segment.values
    return _Generic(
        areas["constants"][1], areas["packets"][1], areas["packets"][0], tail[14], tail[15],
        values[base : base + count], values[first : first + number],
    )  # fmt: skip


def _generic_packets(constants: int, words: tuple[int, int]) -> Layout:
    """SPK types 10 and 14: so many constants, packets of one size with a reference epoch each."""

    def holds(segment: _Segment) -> bool:
        found = _generic(segment)
        if found is None or found.constants != constants or not words[0] <= found.packet_words <= words[1]:
            return False
        width = found.packet_words + found.packet_offset
        last = found.packet_base + found.packets * width
        fits = found.packets >= 1 and last <= len(segment.values) - META_WORDS
        # A reference epoch ends or begins a packet; some writers add one behind the last.
        epochs = found.references
        return fits and len(epochs) - found.packets in (0, 1) and _rising(epochs)

    return holds


def _ck_chebyshev(segment: _Segment) -> bool:
    """CK type 4: packets of any size by their directory; each says how many coefficients its polynomials have."""
    found = _generic(segment)
    if found is None or found.packets < 1 or len(found.references) != found.packets:
        return False
    addresses, offset = found.packet_addresses, found.packet_offset
    if len(addresses) != found.packets + 1 or (addresses % 1 != 0).any() or not _rising(addresses):
        return False
    room, base = len(segment.values) - META_WORDS, found.packet_base
    if addresses[0] < 1 + offset or base + addresses[-1] - 1 - offset > room or not _rising(found.references):
        return False
    starts = [base + int(a) - 1 for a in addresses]
    return all(_ck_packet(segment.values[a : b - offset]) for a, b in pairwise(starts))


def _ck_packet(packet: FloatArray) -> bool:
    if not 3 <= len(packet) <= CK_CHEBYSHEV_WORDS or packet[2] % 1 or not 0 <= packet[2] < CK_COUNTS_BASE**7:
        return False
    counts, rest = [], int(packet[2])
    for _ in range(7):
        rest, count = divmod(rest, CK_COUNTS_BASE)
        counts.append(count)
    return bool(packet[1] > 0) and 3 + sum(counts) == len(packet)


# ---- CK.


def _unit(packets: FloatArray) -> bool:
    norms = np.linalg.norm(packets[:, :4], axis=1)
    return bool((np.abs(norms - 1.0) < UNIT_TOLERANCE).all())


def _pointings(segment: _Segment) -> bool:
    """CK type 1: quaternions (with rates or not), ticks, directory, count."""
    values, tail = segment.values, segment.tail(1)
    count, width = 0 if tail is None else tail[0], 7 if segment.rates else 4
    if count < 1 or (width + 1) * count + _directory(count) + 1 != len(values):
        return False
    packets = values[: width * count].reshape(count, width)
    return _unit(packets) and _table(values[width * count : -1], count)


def _spins(segment: _Segment) -> bool:
    """CK type 2: quaternions with rates and seconds a tick, starts, ends, directory; the size tells the count."""
    values = segment.values
    count = (DIRECTORY_STEP * (len(values) + 1)) // (10 * DIRECTORY_STEP + 1)
    if count < 1 or 10 * count + _directory(count) != len(values):
        return False
    packets = values[: 8 * count].reshape(count, 8)
    starts, ends = values[8 * count : 9 * count], values[9 * count : 10 * count]
    ordered = bool((ends >= starts).all() and (starts[1:] >= ends[:-1]).all())
    return _unit(packets) and ordered and _table(np.r_[starts, values[10 * count :]], count)


def _linear_pointings(segment: _Segment) -> bool:
    """CK type 3: n quaternions (with rates or not), n ticks, directory, interval starts, directory, two counts."""
    values, tail = segment.values, segment.tail(2)
    if tail is None or min(tail) < 1:
        return False
    intervals, count = tail
    width, epochs = 7 if segment.rates else 4, count + _directory(count)
    if width * count + epochs + intervals + _directory(intervals) + 2 != len(values):
        return False
    packets, rest = values[: width * count].reshape(count, width), values[width * count : -2]
    starts = rest[epochs:]
    return _unit(packets) and _table(rest[:epochs], count) and _intervals(starts, intervals, rest[:count])


def _intervals(starts: FloatArray, count: int, ticks: FloatArray) -> bool:
    """Starts of intervals and their directory: ticks of the table, the first of them its first."""
    return _table(starts, count) and starts[0] == ticks[0] and bool(np.isin(starts[:count], ticks).all())


def _interpolated_pointings(segment: _Segment) -> bool:
    """CK type 5: packets, ticks, directory, interval starts, directory, seconds a tick, subtype, points, two counts."""
    values, tail = segment.values, segment.tail(4)
    if tail is None or min(tail) < 0 or tail[2] < 1:
        return False
    subtype, points, intervals, count = tail
    behind = intervals + _directory(intervals) + 5
    if behind >= len(values) or not values[-5] > 0:
        return False
    if not CK_PACKETS.fit(values, subtype, points, count, behind):
        return False
    ticks = values[CK_PACKETS.sizes[subtype] * count :][:count]
    return _intervals(values[-behind:-5], intervals, ticks)


LAYOUTS: Mapping[tuple[str, int], Layout] = {
    ("SPK", 1): _type_1,
    ("SPK", 2): _chebyshev(2, 3, 4),
    ("SPK", 3): _chebyshev(2, 6, 4),
    ("SPK", 5): _type_5,
    ("SPK", 8): _even_states(MOST_POINTS),
    ("SPK", 9): _interpolated(MOST_POINTS),
    ("SPK", 10): _generic_packets(8, (14, 14)),
    ("SPK", 12): _even_states(MOST_POINTS // 2),
    ("SPK", 13): _interpolated(MOST_POINTS // 2),
    ("SPK", 14): _generic_packets(1, (8, 8 + 6 * 18)),
    ("SPK", 15): _constants(16),
    ("SPK", 17): _constants(12),
    ("SPK", 18): _type_18,
    ("SPK", 19): _pieces(SPK_19, 3),
    ("SPK", 20): _chebyshev_velocity,
    ("SPK", 21): _type_21,
    ("PCK", 2): _chebyshev(2, 3, 4),
    ("PCK", 3): _chebyshev(2, 6, 4),
    ("PCK", 20): _chebyshev_velocity,
    ("CK", 1): _pointings,
    ("CK", 2): _spins,
    ("CK", 3): _linear_pointings,
    ("CK", 4): _ck_chebyshev,
    ("CK", 5): _interpolated_pointings,
    ("CK", 6): _pieces(CK_PACKETS, 4),
}
KNOWN_TYPES = tuple(LAYOUTS)

"""Every type of segment that SPICE writes is read; none whose bookkeeping is changed ends the process."""

import struct

import numpy as np
import pytest
import segment_files
from segment_files import WRITERS, evaluate, write_segment

from opnav_workbench.errors import KernelError
from opnav_workbench.kernels.files import read_segments
from opnav_workbench.kernels.segment_layouts import KNOWN_TYPES
from opnav_workbench.supervised import TrialError, tried

pytestmark = pytest.mark.usefixtures("empty_pool")
RECORD = 1024
ANSWER_S = 20.0  # an evaluation takes milliseconds
ODD = np.array(
    [0, 1, -1, 2, 7, 100, 99, 128, 1e3, 1e5, 2.0**31, 1e9, -1e9, 0.5, 1e29, 300, 27, 28, 29, 16, 15, -5]
)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("segments")
    return {key: write_segment(folder, *key) for key in WRITERS}


@pytest.mark.parametrize("key", WRITERS, ids=lambda key: f"{key[0]}-{key[1]}")
def test_what_spice_writes_is_whole_and_answers(written, key):
    (segment,) = read_segments(written[key], key[0])
    assert segment.data_type(key[0]) == key[1]
    assert evaluate(written[key]) == 42


def test_all_types_but_two_are_written_here():
    """PCK types 3 and 20 have no writer; their layout is that of SPK types 3 and 20."""
    assert set(KNOWN_TYPES) - set(WRITERS) == {("PCK", 3), ("PCK", 20)}


def test_a_type_that_nobody_knows(written, tmp_path):
    data = bytearray(written["SPK", 8].read_bytes())
    summary = (struct.unpack_from("<i", data, 76)[0] - 1) * RECORD + 24
    struct.pack_into("<i", data, summary + 16 + 12, 77)
    path = tmp_path / "unknown.bsp"
    path.write_bytes(data)
    with pytest.raises(KernelError, match="type 77, of which SPICE knows nothing"):
        read_segments(path, "SPK")


@pytest.mark.parametrize(("offset", "words"), [(80, "names 9 as the last record"), (0, "summary record")])
def test_the_chain_of_summaries_holds_from_its_end(written, tmp_path, offset, words):
    """SPICE looks through the summaries from the last to the first."""
    data = bytearray(written["SPK", 8].read_bytes())
    if offset:
        struct.pack_into("<i", data, offset, 9)
    else:
        struct.pack_into("<d", data, (struct.unpack_from("<i", data, 76)[0] - 1) * RECORD + 8, 7.0)
    path = tmp_path / "chain.bsp"
    path.write_bytes(data)
    with pytest.raises(KernelError, match=words):
        read_segments(path, "SPK")


def mutated(whole: bytes, words: slice, rng: np.random.Generator) -> bytes:
    """Change one or two things: bookkeeping at a segment's end, any number of it, a bit, the summary, the span."""
    data = bytearray(whole)
    numbers = np.frombuffer(data, "f8")
    summary = (struct.unpack_from("<i", data, 76)[0] - 1) * RECORD
    last = words.stop - 1 - rng.integers(0, min(20, words.stop - words.start))
    for way in rng.integers(0, 6, rng.integers(1, 3)):
        if way == 0:
            numbers[last] = rng.choice(ODD)
        elif way == 1:
            numbers[rng.integers(words.start, words.stop)] = rng.choice(ODD)
        elif way == 2:
            data[rng.integers(0, len(data))] ^= 1 << rng.integers(0, 8)
        elif way == 3:
            odd = (0, 1, 2, 3, 5, 9, 13, 18, 19, 21, 100, 2**31 - 1, -1, 384, 385, 400, 500)
            struct.pack_into("<i", data, summary + 4 * rng.integers(0, 20), int(rng.choice(odd)))
        elif way == 4:
            numbers[last] += rng.choice([1, -1, 100, -2])
        else:
            begin, end = struct.unpack_from("<2d", data, summary + 24)
            wider = rng.choice([0.0, 1.0, 500.0, 1e9], 2)
            struct.pack_into("<2d", data, summary + 24, begin - wider[0], end + wider[1])
    return bytes(data)


def answers(path):
    """Tell whether SPICE, in a process that may end, comes back from all that a kernel claims to cover."""
    try:
        tried(f"{segment_files.__file__}:evaluate", str(path), seconds=ANSWER_S)
    except TrialError:
        return False
    return True


def deaths(written, folder, count, rng):
    """Return the mutants that passed our look and ended, or hung, a process that asked SPICE for what they hold."""
    found, passed = [], 0
    for (kind, data_type), source in written.items():
        whole = source.read_bytes()
        (segment,) = read_segments(source, kind)
        for number in range(count):
            path = folder / source.name
            path.write_bytes(mutated(whole, segment.words, rng))
            try:
                read_segments(path, kind)
            except KernelError:
                continue
            passed += 1
            if not answers(path):
                found.append((kind, data_type, number))
    return found, passed


def test_no_mutant_ends_the_process(written, tmp_path, fuzz):
    count = -(-fuzz.count(15 * len(WRITERS)) // len(WRITERS))
    found, passed = deaths(written, tmp_path, count, fuzz.random("segments"))
    assert passed > 0
    assert found == []

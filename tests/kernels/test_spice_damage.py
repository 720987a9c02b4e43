"""Files that are no whole kernels: refused before SPICE sees them, for it would often load them silently."""

import shutil
import struct

import numpy as np
import pytest
import spiceypy
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from opnav_workbench.errors import KernelError
from opnav_workbench.kernels import KernelSet
from opnav_workbench.kernels.files import read_segments

pytestmark = pytest.mark.usefixtures("empty_pool")
RECORD = 1024
KINDS = {".bsp": "SPK", ".bc": "CK"}
SHARED = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=60)


def refused(path, pattern="."):
    with pytest.raises(KernelError, match=pattern) as caught:
        KernelSet(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert spiceypy.ktotal("ALL") == 0


@pytest.mark.parametrize("suffix", [".bsp", ".bc"])
def test_segments_are_those_that_spice_sees(toy, suffix):
    path = toy.path(suffix)
    handle = spiceypy.dafopr(str(path))
    expected = []
    spiceypy.dafbfs(handle)
    while spiceypy.daffna():
        doubles, integers = spiceypy.dafus(spiceypy.dafgs(5), 2, 6)
        expected.append((tuple(doubles), tuple(integers)))
    spiceypy.dafcls(handle)
    assert [(s.doubles, s.integers) for s in read_segments(path, KINDS[suffix])] == expected


@pytest.mark.parametrize("suffix", [".bsp", ".bc"])
@pytest.mark.parametrize("kept", [0.0, 0.02, 0.2, 0.5, 0.9, "last record", "last word"])
def test_truncated_binary_kernels(toy, tmp_path, suffix, kept):
    whole = toy.path(suffix).read_bytes()
    segments = read_segments(toy.path(suffix), KINDS[suffix])
    used = max(s.words.stop for s in segments) * 8  # the last record may be filled with zeros
    size = {"last record": len(whole) - RECORD, "last word": used - 8}.get(kept) or int(used * kept)
    path = tmp_path / f"cut{suffix}"
    path.write_bytes(whole[:size])
    refused(path)


@pytest.mark.parametrize("suffix", [".bsp", ".bc"])
@pytest.mark.parametrize(
    ("offset", "what"),
    [(8, "summary size"), (76, "first record"), (84, "free address"), (700, "transfer check"), (720, "transfer check"),
     (RECORD * 2, "next record"), (RECORD * 2 + 16, "summary count"), (RECORD * 2 + 24, "start time"),
     (RECORD * 2 + 56, "first word")],
)  # fmt: skip
def test_damaged_structure(toy, tmp_path, suffix, offset, what):
    data = bytearray(toy.path(suffix).read_bytes())
    comment_records = struct.unpack_from("<i", data, 76)[0] - 2
    if offset >= RECORD * 2:  # in the first summary record, wherever it stands
        offset += (comment_records - 1) * RECORD
    data[offset : offset + 8] = b"\xff" * 8
    path = tmp_path / f"damaged{suffix}"
    path.write_bytes(data)
    refused(path, "is not a whole kernel: .*; fetch or build it again")


@given(data=st.data())
@SHARED
def test_random_bytes_over_the_numbers_are_seen_where_they_break_something(toy, tmp_path, data):
    """256 random bytes anywhere in the segments never load unnoticed.

    Of 32 numbers with random exponents all are plausible once in 10^8 times; of 8 numbers, once in 100.
    """
    suffix = data.draw(st.sampled_from([".bsp", ".bc"]))
    whole = bytearray(toy.path(suffix).read_bytes())
    segments = read_segments(toy.path(suffix), KINDS[suffix])
    first, last = min(s.words.start for s in segments), max(s.words.stop for s in segments)
    word = data.draw(st.integers(first, last - 32))
    noise = np.random.default_rng(data.draw(st.integers(0, 10_000)))
    whole[word * 8 : word * 8 + 256] = noise.bytes(256)
    path = tmp_path / f"noise{suffix}"
    path.write_bytes(whole)
    refused(path)


@pytest.mark.parametrize(
    ("suffix", "index", "value", "what"),
    [(".bsp", -1, 151.0, "count"), (".bsp", -153, np.nan, "epoch"), (".bsp", -153, 1e4, "epoch out of order"),
     (".bc", -1, 241.0, "count"), (".bc", 0, 3.0, "quaternion")],
)  # fmt: skip
def test_numbers_that_contradict_each_other(toy, tmp_path, suffix, index, value, what):
    data = bytearray(toy.path(suffix).read_bytes())
    where = read_segments(toy.path(suffix), KINDS[suffix])[0].words
    word = where.start + index if index >= 0 else where.stop + index
    struct.pack_into("<d", data, word * 8, value)
    path = tmp_path / f"changed{suffix}"
    path.write_bytes(data)
    refused(path, "segment 1 of")


def test_chebyshev_segments_are_checked(tmp_path):
    path = tmp_path / "cheby.bsp"
    handle = spiceypy.spkopn(str(path), "cheby", 0)
    coefficients = np.arange(3 * 4 * 3, dtype=float)
    spiceypy.spkw02(handle, 5, 0, "J2000", 0.0, 300.0, "five", 100.0, 3, 3, coefficients, 0.0)
    spiceypy.spkcls(handle)
    (segment,) = read_segments(path, "SPK")
    assert KernelSet(path).kernels()[0].kind == "SPK"
    data = bytearray(path.read_bytes())
    struct.pack_into("<d", data, segment.words.start * 8, 999.0)  # midpoint of the first record
    path.write_bytes(data)
    refused(path, "bookkeeping")


def test_big_endian_kernels_load(toy, tmp_path):
    """The other byte order is whole, too; made here by swapping an SPK word by word."""
    data = bytearray(toy.path(".bsp").read_bytes())
    first_summary = struct.unpack_from("<i", data, 76)[0]
    _swap(data, 8, 4, 2)
    _swap(data, 76, 4, 3)
    data[88:96] = b"BIG-IEEE"
    base = (first_summary - 1) * RECORD
    _swap(data, base, 8, 3)
    for i in range(3):
        _swap(data, base + 24 + 40 * i, 8, 2)
        _swap(data, base + 40 + 40 * i, 4, 6)
    _swap(data, base + 2 * RECORD, 8, (len(data) - base - 2 * RECORD) // 8)
    path = tmp_path / "big.bsp"
    path.write_bytes(data)
    with KernelSet([toy.lsk, path]):
        position, _ = spiceypy.spkgps(-999, 10.0, "J2000", 0)
    np.testing.assert_allclose(position, toy.craft_km(10.0), rtol=0, atol=1e-9)


def _swap(data, offset, size, count):
    for i in range(offset, offset + size * count, size):
        data[i : i + size] = data[i : i + size][::-1]


def test_text_posing_as_a_kernel(tmp_path):
    for name, text in {
        "notes.bsp": "these are notes\n",
        "error.tf": "<!DOCTYPE html>\n<html>404 not found</html>\n",
        "pointer.bc": "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 12\n",
        "empty.tls": "",
    }.items():
        path = tmp_path / name
        path.write_text(text)
        refused(path, f"not a SPICE kernel: it starts with '{text[:5]}")


def test_binaries_posing_as_kernels(tmp_path):
    path = tmp_path / "random.bc"
    path.write_bytes(np.random.default_rng(1).bytes(5000))
    refused(path, "not a SPICE kernel")
    path.write_bytes(b"KPL/FK\n\\begindata\nA = 1\n\x00\x00\x00\\begintext\n")
    refused(path, "zero bytes within text")


def test_transfer_format_and_text_mode_transfers_are_told(toy, tmp_path):
    path = tmp_path / "transfer.bsp"
    path.write_text("DAFETF NAIF DAF ENCODED TRANSFER FILE\n'DAF/SPK '\n")
    refused(path, "transfer format")
    path.write_bytes(toy.path(".bsp").read_bytes().replace(b"\r\n", b"\n", 1) + b"\0")
    refused(path, "text-mode transfer")


def test_a_cut_shape_kernel(tmp_path):
    path = tmp_path / "cut.bds"
    path.write_bytes(b"DAS/DSK " + bytes(2000))
    refused(path, "not a whole kernel")


def test_a_file_that_may_not_be_read(toy, tmp_path, monkeypatch):
    path = tmp_path / "locked.tf"
    shutil.copy(toy.path(".tf"), path)

    def locked(*_args, **_kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pathlib.Path.open", locked)
    refused(path, "Permission denied; check its permissions")


def test_a_file_repaired_in_place_is_looked_at_again(toy, tmp_path):
    path = tmp_path / "again.bsp"
    whole = toy.path(".bsp").read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    refused(path)
    path.write_bytes(whole)
    assert KernelSet(path).kernels()[0].kind == "SPK"

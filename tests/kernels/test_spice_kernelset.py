"""Opening and closing kernels: what was loaded before is loaded afterwards, whatever happened in between."""

import os
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import spiceypy
from numpy.testing import assert_allclose

from opnav_workbench.errors import KernelError
from opnav_workbench.files import sha256_of
from opnav_workbench.kernels import KernelSet, et_from_utc, state, utc_from_et

pytestmark = pytest.mark.usefixtures("empty_pool")


def loaded():
    return [spiceypy.kdata(i, "ALL")[:3] for i in range(spiceypy.ktotal("ALL"))]


def test_a_set_is_active_inside_its_block_only(toy):
    kernels = KernelSet(toy.files)
    assert KernelSet.active() is None
    with kernels as opened:
        assert opened is kernels
        assert KernelSet.active() is kernels
        assert [row[0] for row in loaded()] == [str(p) for p in toy.files]
    assert KernelSet.active() is None


def test_what_others_had_loaded_comes_back_with_its_variables(toy):
    spiceypy.furnsh([str(toy.lsk), str(toy.path(".tpc"))])
    spiceypy.pdpool("BODY2999999_RADII", [3.0, 2.0, 1.0])  # overrides the file
    spiceypy.pcpool("SET_BY_HAND", ["a", "b"])
    spiceypy.dvpool("BODY2999999_PM")
    before = loaded()
    with KernelSet(toy.without(".tpc")):
        assert len(loaded()) == len(toy.files) - 1
        assert not spiceypy.expool("BODY2999999_RADII")
        assert not spiceypy.expool("SET_BY_HAND")
    assert loaded() == before
    assert spiceypy.gdpool("BODY2999999_RADII", 0, 3).tolist() == [3.0, 2.0, 1.0]
    assert spiceypy.gcpool("SET_BY_HAND", 0, 3) == ["a", "b"]
    assert not spiceypy.expool("BODY2999999_PM")
    spiceypy.kclear()


def test_metakernels_of_others_come_back_as_metakernels(toy, tmp_path, monkeypatch):
    monkeypatch.chdir(toy.folder)
    (toy.folder / "theirs.mk").write_text("KPL/MK\n\\begindata\nKERNELS_TO_LOAD = ( 'naif.tls' 'toy.tf' )\n")
    spiceypy.furnsh("theirs.mk")
    before = loaded()
    assert len(before) == 3
    with KernelSet(toy.path(".tpc").absolute()):
        pass
    assert loaded() == before

    # With another working folder the relative names lead nowhere, so the files come back by absolute paths.
    with KernelSet(toy.path(".tpc").absolute()):
        os.chdir(tmp_path)
    assert [row[0] for row in loaded()] == [str(toy.folder / "naif.tls"), str(toy.folder / "toy.tf")]
    spiceypy.kclear()
    (toy.folder / "theirs.mk").unlink()


def test_exceptions_restore_too(toy):
    spiceypy.furnsh(str(toy.lsk))
    before = loaded()
    with pytest.raises(ZeroDivisionError), KernelSet(toy.files):
        _ = 1 / 0
    assert loaded() == before
    assert KernelSet.active() is None
    spiceypy.kclear()


def test_a_failing_load_leaves_everything_as_it_was(toy, tmp_path):
    spiceypy.furnsh(str(toy.lsk))
    before = loaded()
    bad = tmp_path / "bad.tf"
    bad.write_text("KPL/FK\n\\begindata\nA 1 2\n\\begintext\n")
    with pytest.raises(KernelError, match=r"bad\.tf.*correct that line"), KernelSet([toy.path(".tpc"), bad]):
        pass
    assert loaded() == before
    assert KernelSet.active() is None
    spiceypy.kclear()


def test_sets_nest(toy):
    with KernelSet(toy.files) as outer:
        with KernelSet([toy.lsk]) as inner:
            assert KernelSet.active() is inner
            assert len(loaded()) == 1
            assert utc_from_et(0.0) == "2000-01-01T11:58:55.816"
        assert KernelSet.active() is outer
        assert_allclose(state("TOYBODY", 10.0, 0).position_km, toy.body_km(10.0), rtol=0, atol=1e-9)


def test_the_same_set_opens_twice(toy):
    kernels = KernelSet(toy.files)
    with kernels:
        with kernels:
            assert len(loaded()) == len(toy.files)
        assert KernelSet.active() is kernels
        assert len(loaded()) == len(toy.files)
    assert KernelSet.active() is None


def test_closing_out_of_order_still_gives_back_what_was_first(toy):
    spiceypy.furnsh(str(toy.lsk))
    before = loaded()
    first, second = KernelSet(toy.files), KernelSet([toy.path(".tpc")])
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    assert KernelSet.active() is second
    assert [row[0] for row in loaded()] == [str(toy.path(".tpc"))]
    second.__exit__(None, None, None)
    assert KernelSet.active() is None
    assert loaded() == before
    spiceypy.kclear()


def test_closing_a_set_that_is_not_open_says_so(toy):
    with pytest.raises(KernelError, match="not open"):
        KernelSet(toy.files).__exit__(None, None, None)


def test_extra_kernels_load_last_and_win(toy, tmp_path):
    patch = tmp_path / "patch.tpc"
    patch.write_text("KPL/PCK\n\\begindata\nBODY2999999_RADII = ( 33 22 11 )\n\\begintext\n")
    with KernelSet(toy.files, extra=[patch]) as kernels:
        assert spiceypy.gdpool("BODY2999999_RADII", 0, 3).tolist() == [33.0, 22.0, 11.0]
    assert kernels.kernels()[-1].path == patch


def test_kernel_files_tell_kind_and_checksum(toy, tmp_path):
    kernels = KernelSet(toy.files).kernels()
    assert [k.kind for k in kernels] == ["LSK", "SCLK", "FK", "PCK", "IK", "SPK", "CK"]
    assert [k.sha256 for k in kernels] == [sha256_of(p) for p in toy.files]

    copy = tmp_path / "copy.tpc"
    copy.write_bytes(toy.path(".tpc").read_bytes())
    (kernel,) = KernelSet(copy).kernels()
    first = kernel.sha256
    copy.write_bytes(copy.read_bytes() + b"\n")
    assert kernel.sha256 == sha256_of(copy) != first


def test_threads_share_one_open_set(toy):
    """CSPICE is not thread-safe and ctypes lets go of the GIL: without the lock this fails or crashes."""

    def error_km(et):
        return np.abs(
            state("TOYBODY", et, "TOYCRAFT").position_km - (toy.body_km(et) - toy.craft_km(et))
        ).max()

    def roundtrip_s(et):
        return abs(et_from_utc(utc_from_et(et, 6)) - et)

    times = np.linspace(-900.0, 900.0, 2000)
    with KernelSet(toy.files), ThreadPoolExecutor(8) as threads:
        errors_km = list(threads.map(error_km, times, chunksize=10))
        errors_s = list(threads.map(roundtrip_s, times[:500], chunksize=10))
    assert max(errors_km) < 1e-8
    assert max(errors_s) < 2e-6


def test_another_thread_may_open_the_same_kernels_but_no_others(toy):
    def open_and_ask(files):
        with KernelSet(files) as kernels:
            return KernelSet.active() is kernels, len(loaded())

    with ThreadPoolExecutor(1) as thread:
        with KernelSet(toy.files) as outer:
            assert thread.submit(open_and_ask, toy.files).result() == (True, len(toy.files))
            assert KernelSet.active() is outer
            with pytest.raises(KernelError, match="another thread has other kernels open"):
                thread.submit(open_and_ask, [toy.lsk]).result()
            assert len(loaded()) == len(toy.files)
        assert thread.submit(open_and_ask, [toy.lsk]).result() == (True, 1)


def test_kernels_stay_while_the_joining_thread_needs_them(toy):
    joined, first_closed, seen = threading.Event(), threading.Event(), []

    def join():
        with KernelSet(toy.files):
            joined.set()
            first_closed.wait(10.0)
            seen.append(len(loaded()))

    thread = threading.Thread(target=join)
    with KernelSet(toy.files):
        thread.start()
        assert joined.wait(10.0)
    first_closed.set()
    thread.join(10.0)
    assert seen == [len(toy.files)]
    assert loaded() == []


def test_a_set_left_open_by_a_finished_thread_blocks_nobody(toy):
    left = KernelSet(toy.files)
    thread = threading.Thread(target=left.__enter__)
    thread.start()
    thread.join(10.0)
    with KernelSet([toy.lsk]):
        assert len(loaded()) == 1
    left.__exit__(None, None, None)
    assert loaded() == []


def test_a_kernel_removed_meanwhile_is_told_and_the_rest_comes_back(toy, tmp_path):
    gone = Path(tmp_path, "gone.tf")
    gone.write_text("KPL/FK\n\\begindata\nGONE = 1\n\\begintext\n")
    spiceypy.furnsh([str(gone), str(toy.lsk)])
    kernels = KernelSet(toy.files).__enter__()
    gone.unlink()
    with pytest.raises(KernelError, match=r"restoring the kernels.*gone\.tf"):
        kernels.__exit__(None, None, None)
    assert [row[0] for row in loaded()] == [str(toy.lsk)]
    assert KernelSet.active() is None
    spiceypy.kclear()

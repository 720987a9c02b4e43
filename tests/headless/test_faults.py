"""What went wrong with a picture, told from what its notebook says of it."""

import errno
import os
import sys

import pytest
from IPython.core.ultratb import FormattedTB

from opnav_workbench.errors import ImageError
from opnav_workbench.headless.faults import FAULTS, fault_of_report
from opnav_workbench.image import KeywordMap, read_image


def reported(raising):
    """The report of a cell that raises, its traceback as the kernel formats it."""
    try:
        raising()
    except Exception as error:
        kind, value, trace = sys.exc_info()
        text = FormattedTB(mode="Context").structured_traceback(kind, value, trace)
        return {
            "ok": False,
            "kind": "cell",
            "ename": type(error).__name__,
            "evalue": str(error),
            "traceback": list(text),
        }
    raise AssertionError("nothing was raised")


@pytest.mark.parametrize("number", [errno.ESTALE, errno.EIO, errno.ENOENT, errno.ENOSPC, errno.EMFILE])
def test_what_the_system_refuses_is_passing_in_whatever_words(tmp_path, monkeypatch, number):
    def refuse(_path):
        raise OSError(number, os.strerror(number))

    path = tmp_path / "a.fit"
    path.write_bytes(b"SIMPLE  =")
    monkeypatch.setattr(type(path), "read_bytes", refuse)
    report = reported(lambda: read_image(path, KeywordMap(exposure_s="EXPTIME")))
    assert report["ename"] == "ImageError"
    assert fault_of_report(report, "notebook.ipynb")[0] == "machine"


def test_a_machine_without_memory_is_passing(tmp_path, monkeypatch):
    def full(*_, **__):
        raise MemoryError

    path = tmp_path / "a.fit"
    path.write_bytes(b"SIMPLE  =")
    monkeypatch.setattr("astropy.io.fits.open", full)
    assert (
        fault_of_report(reported(lambda: read_image(path, KeywordMap(exposure_s="EXPTIME"))), "n")[0]
        == "machine"
    )
    assert fault_of_report(reported(full), "n")[0] == "machine"


def test_a_damaged_picture_stays_damaged(tmp_path):
    path = tmp_path / "a.fit"
    path.write_bytes(b"SIMPLE  =")
    report = reported(lambda: read_image(path, KeywordMap(exposure_s="EXPTIME")))
    fault, reason = fault_of_report(report, "notebook.ipynb")
    assert (fault, reason) == ("picture", report["evalue"])
    (tmp_path / "b.fit").write_bytes(b"\x1f\x8b\x08 no gzip")
    report = reported(lambda: read_image(tmp_path / "b.fit", KeywordMap(exposure_s="EXPTIME")))
    assert fault_of_report(report, "notebook.ipynb")[0] == "picture"


def test_a_defect_is_the_notebooks():
    def defect():
        raise ValueError("no such thing")

    fault, reason = fault_of_report(reported(defect), "notebook.ipynb")
    assert (fault, reason) == ("notebook", "a cell raised ValueError: no such thing (see notebook.ipynb)")


def test_every_policy_is_said():
    assert set(FAULTS) == {"", "picture", "notebook", "limit", "machine"}
    assert {p.again_next_night for p in FAULTS.values()} == {"changed", "raised", "always"}
    assert issubclass(ImageError, Exception)

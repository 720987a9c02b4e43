"""A process that may end: a crash, a hang, a bomb and an error cost one line, and the next question is answered."""

import os
import time

import pytest

from opnav_workbench import supervised
from opnav_workbench.supervised import TrialError, tried

DEEDS = """
import os, time
def well(path): open(path, "a").write("x")
def crash(): os.abort()
def hang(): time.sleep(1000)
def bomb(): bytearray(1 << 40)
def wrong(): raise ValueError("no\\nshape")
def chatter(): print("noise"); os.write(1, b"more noise")
"""


@pytest.fixture
def deeds(tmp_path, monkeypatch):
    (tmp_path / "deeds.py").write_text(DEEDS)
    return f"{tmp_path / 'deeds.py'}"


@pytest.mark.parametrize(
    ("name", "words"),
    [("crash", r"ends the process that reads it \(SIGABRT\)"), ("hang", "takes more than 2 s"),
     ("bomb", "more memory than there is"), ("wrong", "ValueError: no shape")],
)  # fmt: skip
def test_what_goes_wrong_is_one_line(deeds, tmp_path, name, words):
    with pytest.raises(TrialError, match=words):
        tried(f"{deeds}:{name}", seconds=2.0)
    tried(f"{deeds}:chatter")
    tried(f"{deeds}:well", str(tmp_path / "done"))
    assert (tmp_path / "done").read_text() == "x"


def test_one_process_serves_all_and_ends_with_its_starter(deeds, tmp_path):
    tried(f"{deeds}:chatter")
    first = supervised._CHILD._process
    began = time.monotonic()
    for _ in range(100):
        tried(f"{deeds}:chatter")
    assert supervised._CHILD._process is first
    assert time.monotonic() - began < 5.0  # 100 starts take far longer
    supervised._CHILD.close()
    with pytest.raises(ProcessLookupError):
        os.kill(first.pid, 0)

"""Files: JSON read with a clear word on what is wrong, and digests that depend on values alone."""

import hashlib
import os
from pathlib import Path

import numpy as np
import pytest

from opnav_workbench.errors import SessionError
from opnav_workbench.files import digest, files_named, read_json, write_json, write_text


def test_json_comes_back_and_what_is_no_number_is_none(tmp_path):
    write_json(tmp_path / "a.json", {"center": np.array([1.0, np.nan])})
    assert read_json(tmp_path / "a.json", "write it again.") == {"center": [1.0, None]}
    (tmp_path / "b.json").write_text('{"sigma": NaN, "limit": Infinity}')  # as other programs write it
    assert read_json(tmp_path / "b.json", "write it again.") == {"sigma": None, "limit": None}


@pytest.mark.parametrize("content", [None, b'{"cut', b"[1, 2]", b"\xff\xfe{}"])
def test_what_is_no_mapping_is_told_in_one_line_with_the_advice(tmp_path: Path, content):
    path = tmp_path / "damaged.json"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(SessionError, match=r"damaged\.json cannot be read .*; write it again\.$") as caught:
        read_json(path, "write it again.")
    assert "\n" not in str(caught.value)


def test_a_digest_depends_on_the_values_alone():
    """Digests are stored (journal.jsonl, archives): their bytes are not to change."""
    values = {"b": [1, 2.5, None], "a": "text"}
    stored = hashlib.sha256(b'{"a": "text", "b": [1, 2.5, null]}').hexdigest()
    assert digest(values) == stored
    assert digest({"a": "text", "b": (1, np.float64(2.5), float("nan"))}) == stored
    assert digest({"a": "text", "b": [1, 2.5, 0.0]}) != stored


def test_files_of_a_name_but_not_in_hidden_folders(tmp_path):
    """What a night keeps in its attic is no result of the run."""
    for folder in ("b", "a/deep", ".attic/a", "a/.attic"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "result.json").touch()
    found = files_named(tmp_path, "result.json")
    assert [path.parent.relative_to(tmp_path).as_posix() for path in found] == ["a/deep", "b"]
    assert len(files_named(tmp_path / ".attic", "result.json", "session.json")) == 1  # asked for by its name


def test_a_device_is_never_replaced(tmp_path):
    """As root, a file renamed over ``/dev/null`` would have been the end of it for everybody."""
    (tmp_path / "null").symlink_to(os.devnull)
    os.mkfifo(tmp_path / "pipe")
    for name in ("null", "pipe"):
        before = (tmp_path / name).lstat()
        with pytest.raises(SessionError, match=r"is a pipe or device, no file; give a file's name"):
            write_text(tmp_path / name, "text")
        assert (tmp_path / name).lstat().st_ino == before.st_ino
    assert sorted(p.name for p in tmp_path.iterdir()) == ["null", "pipe"]

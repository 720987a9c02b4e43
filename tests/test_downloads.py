"""Downloads against a local server with faults: cuts, silence, wrong bytes, wrong sizes, redirects, a full disk."""

import errno
import hashlib
import http.server
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from opnav_workbench.downloads import _WebRedirects, download
from opnav_workbench.errors import DownloadError

CONTENT = bytes(range(256)) * 1500  # 384 000 bytes: several chunks
SHA256 = hashlib.sha256(CONTENT).hexdigest()
HALF = len(CONTENT) // 2
SILENCE_S = 3.0


@dataclass
class Server:
    """A file server that misbehaves as told, for one answer or for all."""

    url: str
    content: bytes = CONTENT
    etag: str | None = '"v1"'
    ranges: bool = True
    length: bool = True
    faults: list[str] = field(default_factory=list)  # one an answer; the last one stays
    asked: list[dict[str, str]] = field(default_factory=list)
    closing: threading.Event = field(default_factory=threading.Event)

    def fault(self) -> str:
        if not self.faults:
            return ""
        return self.faults.pop(0) if len(self.faults) > 1 else self.faults[0]


class _Handler(http.server.BaseHTTPRequestHandler):
    state: Server

    def log_message(self, *_):
        pass

    def do_GET(self):
        state, fault = self.state, self.state.fault()
        state.asked.append(dict(self.headers))
        if fault.isdecimal():
            self.send_error(int(fault))
            return
        if fault.startswith("redirect:"):
            self.send_response(302)
            self.send_header("Location", fault.removeprefix("redirect:"))
            self.end_headers()
            return
        if fault == "silent":
            state.closing.wait(SILENCE_S)
            return
        self._send(fault)

    def _send(self, fault: str):
        state, start = self.state, 0
        wanted = self.headers.get("Range")
        if wanted and state.ranges and self.headers.get("If-Range", state.etag) == state.etag:
            start = int(wanted.removeprefix("bytes=").removesuffix("-"))
        if start >= len(state.content):
            self.send_response(416)
            self.send_header("Content-Range", f"bytes */{len(state.content)}")
            self.end_headers()
            return
        self.send_response(206 if start else 200)
        if start:
            self.send_header("Content-Range", f"bytes {start}-{len(state.content) - 1}/{len(state.content)}")
        body = state.content[start:]
        if state.length:
            self.send_header("Content-Length", str(len(body)))
        if state.etag:
            self.send_header("ETag", state.etag)
        self.end_headers()
        if fault == "cut":
            self.wfile.write(body[: len(body) // 2])
        elif fault == "drip":
            for i in range(20):
                self.wfile.write(body[i : i + 1])
                self.wfile.flush()
                time.sleep(0.06)
        else:
            self.wfile.write(body)


@pytest.fixture
def server(monkeypatch):
    monkeypatch.setattr("opnav_workbench.downloads.PAUSE_S", 0.0)
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    handler = type("Handler", (_Handler,), {})
    httpd = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    httpd.daemon_threads = False  # joined at the end: no socket outlives its test
    httpd.handle_error = lambda *_: None  # a client that leaves early is part of the game
    state = Server(f"http://127.0.0.1:{httpd.server_port}/data/file.bin")
    handler.state = state
    thread = threading.Thread(target=httpd.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield state
    state.closing.set()
    httpd.shutdown()
    thread.join()
    httpd.server_close()


def _names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def test_a_file_arrives_whole_and_alone(server, tmp_path):
    seen = []
    path = download(
        server.url, tmp_path / "new" / "file.bin", size=len(CONTENT), sha256=SHA256,
        progress=lambda there, total: seen.append((there, total)),
    )  # fmt: skip
    assert path.read_bytes() == CONTENT
    assert _names(path.parent) == ["file.bin"]
    assert seen[0] == (0, len(CONTENT))
    assert seen[-1] == (len(CONTENT), len(CONTENT))
    assert [there for there, _ in seen] == sorted(there for there, _ in seen)
    assert server.asked[0]["User-Agent"].startswith("opnav_workbench/")


def test_a_cut_connection_is_resumed_in_the_same_call(server, tmp_path):
    server.faults = ["cut", ""]
    download(server.url, tmp_path / "file.bin", sha256=SHA256)
    assert (tmp_path / "file.bin").read_bytes() == CONTENT
    assert [a.get("Range") for a in server.asked] == [None, f"bytes={HALF}-"]


def test_what_arrived_before_a_failure_is_used_by_the_next_call(server, tmp_path):
    server.faults = ["cut"]
    with pytest.raises(DownloadError, match=rf"cut after {HALF} of .* {HALF} bytes are kept"):
        download(server.url, tmp_path / "file.bin", retries=0)
    assert _names(tmp_path) == ["file.bin.part", "file.bin.part.json"]
    server.faults = []
    seen = []
    download(server.url, tmp_path / "file.bin", progress=lambda there, _: seen.append(there))
    assert seen[0] == HALF  # nothing twice
    assert (tmp_path / "file.bin").read_bytes() == CONTENT
    assert _names(tmp_path) == ["file.bin"]


def test_a_cut_in_every_answer_halves_what_is_missing_until_attempts_run_out(server, tmp_path):
    server.faults = ["cut"]
    with pytest.raises(DownloadError, match="3 attempts"):
        download(server.url, tmp_path / "file.bin", retries=2)
    assert len(server.asked) == 3
    assert (tmp_path / "file.bin.part").stat().st_size == len(CONTENT) * 7 // 8


def test_a_file_that_changed_meanwhile_comes_whole(server, tmp_path):
    server.faults = ["cut"]
    with pytest.raises(DownloadError):
        download(server.url, tmp_path / "file.bin", retries=0)
    server.faults, server.etag, server.content = [], '"v2"', CONTENT[::-1]
    download(server.url, tmp_path / "file.bin")
    assert (tmp_path / "file.bin").read_bytes() == CONTENT[::-1]


def test_without_mark_and_digest_nothing_is_resumed(server, tmp_path):
    (tmp_path / "file.bin.part").write_bytes(b"from somewhere else")
    download(server.url, tmp_path / "file.bin")
    assert (tmp_path / "file.bin").read_bytes() == CONTENT
    assert "Range" not in server.asked[0]


def test_a_part_of_another_version_is_found_by_the_digest_and_replaced(server, tmp_path):
    (tmp_path / "file.bin.part").write_bytes(b"x" * 1000)
    download(server.url, tmp_path / "file.bin", size=len(CONTENT), sha256=SHA256)
    assert (tmp_path / "file.bin").read_bytes() == CONTENT
    assert [a.get("Range") for a in server.asked] == ["bytes=1000-", None]


def test_a_server_without_ranges_starts_over(server, tmp_path):
    server.ranges = False
    (tmp_path / "file.bin.part").write_bytes(CONTENT[:HALF])
    download(server.url, tmp_path / "file.bin", sha256=SHA256)
    assert (tmp_path / "file.bin").read_bytes() == CONTENT
    assert server.asked[0]["Range"] == f"bytes={HALF}-"


def test_a_part_that_is_the_whole_file_needs_no_body(server, tmp_path):
    (tmp_path / "file.bin.part").write_bytes(CONTENT)
    download(server.url, tmp_path / "file.bin", sha256=SHA256)
    assert (tmp_path / "file.bin").read_bytes() == CONTENT
    assert len(server.asked) == 1


def test_a_wrong_digest_leaves_nothing(server, tmp_path):
    old = tmp_path / "file.bin"
    old.write_bytes(b"older")
    with pytest.raises(DownloadError, match=f"its SHA-256 is {SHA256}, expected is {'0' * 64}"):
        download(server.url, old, sha256="0" * 64)
    assert old.read_bytes() == b"older"
    assert _names(tmp_path) == ["file.bin"]


@pytest.mark.parametrize(("length", "words"), [(True, "expected"), (False, "larger than")])
def test_a_file_larger_than_said(server, tmp_path, length, words):
    server.length = length
    with pytest.raises(DownloadError, match=words):
        download(server.url, tmp_path / "file.bin", size=len(CONTENT) - 100_000)
    assert _names(tmp_path) == []


def test_a_file_smaller_than_said(server, tmp_path):
    with pytest.raises(DownloadError, match=f"has {len(CONTENT)} bytes, {len(CONTENT) + 1} are expected"):
        download(server.url, tmp_path / "file.bin", size=len(CONTENT) + 1)
    assert _names(tmp_path) == []


@pytest.mark.parametrize(
    ("status", "words", "attempts"), [("404", "404.*moved", 1), ("403", "403.*account", 1), ("503", "503", 3)]
)
def test_refusals(server, tmp_path, status, words, attempts):
    server.faults = [status]
    with pytest.raises(DownloadError, match=words) as caught:
        download(server.url, tmp_path / "file.bin", retries=2)
    assert server.url in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(server.asked) == attempts
    assert _names(tmp_path) == []


def test_a_passing_failure_passes(server, tmp_path):
    server.faults = ["503", ""]
    assert download(server.url, tmp_path / "file.bin", sha256=SHA256).is_file()


def test_a_silent_server_is_given_up(server, tmp_path):
    server.faults = ["silent"]
    begin = time.monotonic()
    with pytest.raises(DownloadError, match=r"no answer for 0\.2 s"):
        download(server.url, tmp_path / "file.bin", timeout_s=0.2, retries=1)
    assert time.monotonic() - begin < SILENCE_S
    assert len(server.asked) == 2


def test_a_dripping_server_is_given_up_and_its_bytes_kept(server, tmp_path):
    server.faults = ["drip"]
    with pytest.raises(DownloadError, match=r"only \d+ bytes came in 0\.3 s"):
        download(server.url, tmp_path / "file.bin", timeout_s=0.3, retries=0)
    part = (tmp_path / "file.bin.part").read_bytes()
    assert 0 < len(part) < 20
    assert part == CONTENT[: len(part)]


def test_nobody_listens(tmp_path, monkeypatch):
    monkeypatch.setattr("opnav_workbench.downloads.PAUSE_S", 0.0)
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    with pytest.raises(DownloadError, match=r"the connection to 127\.0\.0\.1:1 failed"):
        download("http://127.0.0.1:1/file.bin", tmp_path / "file.bin", retries=1)


def test_redirects_are_followed_but_stay_on_the_web(server, tmp_path):
    server.faults = [f"redirect:{server.url}2", ""]
    assert download(server.url, tmp_path / "a.bin", sha256=SHA256).read_bytes() == CONTENT
    for address, words in (("file:///etc/passwd", "not allowed"), ("ftp://127.0.0.1/x", "no web address")):
        server.faults = [f"redirect:{address}"]
        with pytest.raises(DownloadError, match=words):
            download(server.url, tmp_path / "b.bin")
    assert _names(tmp_path) == ["a.bin"]


def test_no_redirect_from_https_to_http():
    import urllib.request

    request = urllib.request.Request("https://a.example/file")
    with pytest.raises(DownloadError, match="not encrypted"):
        _WebRedirects().redirect_request(request, None, 302, "", {}, "http://a.example/file")


@pytest.mark.parametrize(
    "url", ["file:///etc/passwd", "ftp://a.example/x", "data:,x", "kernels/x.bsp", "http://"]
)
def test_only_web_addresses(url, tmp_path):
    with pytest.raises(DownloadError, match="no web address"):
        download(url, tmp_path / "file.bin")
    assert _names(tmp_path) == []


def test_a_full_disk(server, tmp_path, monkeypatch):
    really_open = Path.open

    def full_after_half(path, mode="r", **options):
        stream = really_open(path, mode, **options)
        if path.suffix == ".part" and "b" in mode and mode != "rb":
            return _Full(stream)
        return stream

    monkeypatch.setattr(Path, "open", full_after_half)
    with pytest.raises(DownloadError, match=r"cannot write .*file\.bin: the disk is full"):
        download(server.url, tmp_path / "file.bin", sha256=SHA256)
    monkeypatch.undo()
    assert _names(tmp_path) == ["file.bin.part", "file.bin.part.json"]
    kept = (tmp_path / "file.bin.part").read_bytes()
    assert kept
    assert kept == CONTENT[: len(kept)]


class _Full:
    """A stream on a disk that fills up at half of the file."""

    def __init__(self, stream):
        self.stream = stream

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stream.close()

    def __getattr__(self, name):
        return getattr(self.stream, name)

    def write(self, data):
        if self.stream.tell() + len(data) > HALF:
            raise OSError(errno.ENOSPC, "No space left on device")
        return self.stream.write(data)


def test_too_little_room_is_told_before_anything_is_written(server, tmp_path, monkeypatch):
    usage = type("Usage", (), {"free": 1000})
    monkeypatch.setattr("opnav_workbench.downloads.shutil.disk_usage", lambda _: usage)
    with pytest.raises(DownloadError, match=f"needs {len(CONTENT)} more bytes, .* has 1000 free"):
        download(server.url, tmp_path / "file.bin")
    assert _names(tmp_path) == []


def test_a_folder_that_cannot_be_made(server, tmp_path):
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(DownloadError, match="cannot write"):
        download(server.url, tmp_path / "taken" / "file.bin")


def test_a_check_decides_before_the_file_gets_its_name(server, tmp_path):
    def refuse(path: Path) -> None:
        assert path.read_bytes() == CONTENT
        raise DownloadError("not what it should be")

    with pytest.raises(DownloadError, match="not what"):
        download(server.url, tmp_path / "file.bin", check=refuse)
    assert _names(tmp_path) == []

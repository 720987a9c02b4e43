"""Manifests and templates of the package, and flight kernels fetched by them from a pretended archive."""

import hashlib
import json
import re
from pathlib import Path

import pytest
import spiceypy
import yaml

from opnav_workbench.errors import DownloadError, KernelError, MissionError
from opnav_workbench.kernels import (
    KERNEL_KINDS,
    KernelSet,
    check_kernels,
    fetch_kernels,
    kernels_folder,
    load_manifest,
    manifest_missions,
    match_kinds,
)
from opnav_workbench.kernels.manifest import filled_template
from opnav_workbench.resources import kernels_meta_dir

ARCHIVE = "https://archive.example/kernels/"
KIND_OF = {".tls": "LSK", ".tsc": "SCLK", ".tpc": "PCK", ".tf": "FK", ".ti": "IK", ".bc": "CK"}


class Archive:
    """Answers requests from a folder, as `urllib.request.OpenerDirector` would."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.asked: list[str] = []

    def open(self, request, timeout=None):
        self.asked.append(request.full_url)
        return _Answer((self.folder / request.full_url.removeprefix(ARCHIVE)).read_bytes())


class _Answer:
    status = 200

    def __init__(self, data: bytes) -> None:
        self.data, self.headers = data, {"Content-Length": str(len(data))}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def read1(self, n):
        chunk, self.data = self.data[:n], self.data[n:]
        return chunk


@pytest.fixture
def archive(toy) -> Archive:
    return Archive(toy.folder)


@pytest.fixture
def manifest(toy, tmp_path) -> Path:
    """A manifest of the toy mission: digests known, but for the SPK's."""
    kernels = []
    for path in toy.files:
        kind = KIND_OF.get(path.suffix, "spacecraft SPK")
        known = kind != "spacecraft SPK"
        kernels.append({
            "kind": kind, "file": f"{kind.split()[-1].lower()}/{path.name}", "url": ARCHIVE + path.name,
            "size": path.stat().st_size if known else None,
            "sha256": hashlib.sha256(path.read_bytes()).hexdigest() if known else None, "purpose": "test",
        })  # fmt: skip
    folder = tmp_path / "meta"
    folder.mkdir()
    (folder / "flight.tm.template").write_text(
        (kernels_meta_dir() / "generic" / "flight.tm.template").read_text()
    )
    content = {
        "mission": "toy", "description": "toy", "metakernel": "toy.tm", "template": "flight.tm.template",
        "kernels": kernels,
    }  # fmt: skip
    path = folder / "manifest.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return path


def _edited(manifest: Path, **changes) -> Path:
    content = yaml.safe_load(manifest.read_text())
    content["kernels"][0].update(changes)
    manifest.write_text(yaml.safe_dump(content))
    return manifest


# -- those of the package ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mission", manifest_missions())
def test_manifests_of_the_package(mission):
    manifest, path = load_manifest(mission)
    assert manifest.mission == path.parent.name == mission
    for kernel in manifest.kernels:
        assert kernel.url.startswith("https://naif.jpl.nasa.gov/pub/naif/")
        assert kernel.url.rpartition("/")[2] == Path(kernel.file).name
        assert Path(kernel.file).parent.name == kernel.kind.split()[-1].lower()
        assert (kernel.size is None) == (kernel.sha256 is None)
        assert kernel.purpose
    template = (path.parent / manifest.template).read_text(encoding="ascii")
    assert max(map(len, filled_template(template, manifest.kernels).splitlines())) <= 132


@pytest.mark.parametrize("mission", ["new_horizons", "osiris_rex"])
def test_a_mission_has_all_eight_kinds(mission):
    assert {kernel.kind for kernel in load_manifest(mission)[0].kernels} == set(KERNEL_KINDS)


def test_every_mission_has_a_manifest_and_a_template():
    assert {"generic", "new_horizons", "osiris_rex", "dawn", "voyager1"} <= set(manifest_missions())
    for mission in manifest_missions():
        assert (kernels_meta_dir() / mission / "flight.tm.template").is_file()


@pytest.mark.realdata
def test_digests_are_those_of_the_copies_at_hand(data_dir):
    """Sizes and digests in the manifests against copies of the files; no copy, no test of it."""
    checked = 0
    for mission in manifest_missions():
        for kernel in load_manifest(mission)[0].kernels:
            copy = data_dir / "spice" / "generic" / Path(kernel.file).name
            if kernel.sha256 and copy.is_file():
                assert hashlib.sha256(copy.read_bytes()).hexdigest() == kernel.sha256, kernel.file
                assert copy.stat().st_size == kernel.size
                checked += 1
    assert checked >= 10


def test_the_known_digest_of_the_leap_seconds_is_that_of_the_packaged_ones():
    from opnav_workbench.kernels import packaged_leap_seconds

    with packaged_leap_seconds() as lsk:
        data = lsk.read_bytes()
    assert load_manifest("generic")[0].kernels[0].sha256 == hashlib.sha256(data).hexdigest()


# -- schema --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"file": "../outside.tls"}, "plain name"), ({"file": "/etc/x.tls"}, "plain name"),
        ({"file": "a b.tls"}, "plain name"), ({"url": "file:///etc/passwd"}, "no web address"),
        ({"url": "ftp://a/b"}, "no web address"), ({"sha256": "abc"}, "sha256"), ({"size": 0}, "size"),
        ({"kind": "SPK"}, "kind"), ({"file": "sclk/toy.tsc"}, "listed twice"), ({"sizes": 3}, "did you mean size"),
    ],
)  # fmt: skip
def test_a_wrong_manifest_is_one_line_with_field_and_file(manifest, changes, words):
    with pytest.raises(MissionError, match=words) as caught:
        load_manifest(_edited(manifest, **changes))
    assert "\n" not in str(caught.value)
    assert str(manifest) in str(caught.value)


def test_unknown_missions_and_kinds_get_a_hint():
    with pytest.raises(MissionError, match="Did you mean new_horizons"):
        load_manifest("new_horizon")
    with pytest.raises(MissionError, match=r"generic, .*new_horizons, osiris_rex"):
        load_manifest("voyager/x")
    with pytest.raises(KernelError, match="no kind of kernel"):
        match_kinds("SPKK")
    with pytest.raises(KernelError, match=r"generic lists no CK; it lists LSK, PCK, target SPK"):
        load_manifest("generic")[0].of_kinds(("CK",))


# -- fetching ------------------------------------------------------------------------------------------------------


def test_fetched_kernels_are_whole_and_their_metakernel_loads(manifest, archive, toy, tmp_path, empty_pool):
    fetched = fetch_kernels(manifest, tmp_path / "k", opener=archive)
    assert fetched.metakernel == tmp_path / "k" / "toy.tm"
    assert [k.kernel.kind for k in fetched.kernels if k.trusted] == ["spacecraft SPK"]
    assert not any(k.already_present for k in fetched.kernels)
    for item, source in zip(fetched.kernels, toy.files, strict=True):
        assert item.path.read_bytes() == source.read_bytes()
        assert item.size == source.stat().st_size
    with KernelSet(fetched.metakernel) as kernels:
        assert [k.kind for k in kernels.kernels()] == ["META", "LSK", "SCLK", "PCK", "FK", "IK", "SPK", "CK"]
    assert check_kernels(fetched.metakernel, 25.0).ok
    assert not list((tmp_path / "k").rglob("*.part*"))


def test_the_metakernel_works_for_spice_itself_from_inside_its_folder(
    manifest, archive, tmp_path, empty_pool, monkeypatch
):
    fetched = fetch_kernels(manifest, tmp_path / "k", opener=archive)
    text = fetched.metakernel.read_text()
    assert "# " not in text
    assert "{" not in text
    monkeypatch.chdir(fetched.folder)
    spiceypy.furnsh("toy.tm")
    assert spiceypy.ktotal("ALL") == 8
    spiceypy.kclear()


def test_what_is_here_is_verified_and_not_fetched_again(manifest, archive, tmp_path):
    fetch_kernels(manifest, tmp_path / "k", opener=archive)
    first = len(archive.asked)
    again = fetch_kernels(manifest, tmp_path / "k", opener=archive)
    assert len(archive.asked) == first
    assert all(k.already_present and not k.trusted for k in again.kernels)


def test_the_first_digest_counts_ever_after(manifest, archive, toy, tmp_path):
    fetch_kernels(manifest, tmp_path / "k", opener=archive)
    lock = json.loads((tmp_path / "k" / "manifest.lock.json").read_text())
    spk = toy.path(".bsp").read_bytes()
    assert lock["kernels"]["spk/toy.bsp"] == {
        "sha256": hashlib.sha256(spk).hexdigest(), "size": len(spk), "url": ARCHIVE + "toy.bsp"
    }  # fmt: skip
    local = tmp_path / "k" / "spk" / "toy.bsp"
    local.write_bytes(spk[:-8] + b"\x01" * 8)
    with pytest.raises(
        KernelError, match=r"toy\.bsp is not the kernel that it should be.*delete it and fetch"
    ):
        fetch_kernels(manifest, tmp_path / "k", opener=archive)
    local.unlink()
    archive.folder = tmp_path / "changed"
    archive.folder.mkdir()
    (archive.folder / "toy.bsp").write_bytes(spk[:-8] + b"\x01" * 8)
    with pytest.raises(DownloadError, match="SHA-256"):
        fetch_kernels(manifest, tmp_path / "k", kinds=("spacecraft SPK",), opener=archive)
    assert not local.exists()


def test_only_some_kinds_and_a_metakernel_of_what_is_there(manifest, archive, tmp_path, empty_pool):
    fetched = fetch_kernels(manifest, tmp_path / "k", kinds=("LSK", "FK"), opener=archive)
    assert [k.kernel.kind for k in fetched.kernels] == ["LSK", "FK"]
    with KernelSet(fetched.metakernel) as kernels:
        assert [k.kind for k in kernels.kernels()] == ["META", "LSK", "FK"]
    fetched = fetch_kernels(manifest, tmp_path / "k", kinds=("IK",), opener=archive)
    with KernelSet(fetched.metakernel) as kernels:
        assert [k.kind for k in kernels.kernels()] == ["META", "LSK", "FK", "IK"]


@pytest.mark.parametrize(
    ("content", "words"),
    [(b"<html>not found</html>", "no kernel, and was thrown away"), (b"KPL/PCK\n\\begindata\nA=1\n", "kind PCK, not SPK")],
)  # fmt: skip
def test_a_page_in_place_of_a_kernel_is_not_trusted(manifest, archive, tmp_path, content, words):
    archive.folder = tmp_path / "bad"
    archive.folder.mkdir()
    (archive.folder / "toy.bsp").write_bytes(content)
    with pytest.raises(KernelError, match=words):
        fetch_kernels(manifest, tmp_path / "k", kinds=("spacecraft SPK",), opener=archive)
    assert sorted(p.name for p in (tmp_path / "k").rglob("*")) == ["spk"]


def test_a_failure_keeps_what_was_fetched_before(manifest, archive, toy, tmp_path):
    _edited(manifest, sha256="0" * 64)
    content = yaml.safe_load(manifest.read_text())
    content["kernels"].append(content["kernels"].pop(0))
    manifest.write_text(yaml.safe_dump(content))
    with pytest.raises(DownloadError):
        fetch_kernels(manifest, tmp_path / "k", opener=archive)
    lock = json.loads((tmp_path / "k" / "manifest.lock.json").read_text())
    assert len(lock["kernels"]) == len(toy.files) - 1


def test_a_damaged_lock_file_and_a_folder_that_is_a_file(manifest, archive, tmp_path):
    (tmp_path / "k").mkdir()
    (tmp_path / "k" / "manifest.lock.json").write_text("{")
    with pytest.raises(KernelError, match="is damaged"):
        fetch_kernels(manifest, tmp_path / "k", opener=archive)
    (tmp_path / "file").write_text("")
    with pytest.raises(KernelError, match="cannot write into"):
        fetch_kernels(manifest, tmp_path / "file", opener=archive)
    assert archive.asked == []


def test_fetched_kernels_have_a_name(monkeypatch, tmp_path, toy, archive, manifest, empty_pool):
    monkeypatch.setenv("OPNAV_CACHE", str(tmp_path / "cache"))
    with pytest.raises(KernelError, match="run: opnav kernels fetch new_horizons"):
        KernelSet("new_horizons/flight")
    text = re.sub(r"^mission: toy$", "mission: new_horizons", manifest.read_text(), flags=re.MULTILINE)
    manifest.write_text(text.replace("toy.tm\n", "new_horizons_flight.tm\n"))
    fetched = fetch_kernels(manifest, opener=archive)
    assert fetched.folder == kernels_folder("new_horizons")
    assert KernelSet("new_horizons/flight").paths[0] == fetched.metakernel


def test_a_template_without_a_place(manifest, archive, tmp_path):
    (manifest.parent / "flight.tm.template").write_text("KPL/MK\n{LSK}\n")
    with pytest.raises(KernelError, match=r"no line \{SCLK\}"):
        fetch_kernels(manifest, tmp_path / "k", opener=archive)

"""From names, metakernels, lists and folders to kernel files; and scenarios built once into the cache."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
import spiceypy

from opnav_workbench import resources
from opnav_workbench.errors import KernelError
from opnav_workbench.kernels import KernelSet, kernel_set, known_names
from opnav_workbench.kernels.files import KernelFile

pytestmark = pytest.mark.usefixtures("empty_pool")


def metakernel(path: Path, *kernels: str, more: str = "") -> Path:
    listed = "\n".join(f"'{k}'" for k in kernels)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"KPL/MK\n\n\\begindata\n{more}\nKERNELS_TO_LOAD = (\n{listed}\n)\n\\begintext\n")
    return path


def text_kernel(path: Path, variable: str = "X", value: float = 1.0) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"KPL/FK\n\\begindata\n{variable} = {value}\n\\begintext\n")
    return path


def paths(kernels: KernelSet) -> list[Path]:
    return [k.path for k in kernels.kernels()]


@pytest.fixture
def names_folder(tmp_path, monkeypatch):
    """An empty kernels_meta and an empty cache."""
    folder = tmp_path / "kernels_meta"
    folder.mkdir()
    monkeypatch.setattr(kernel_set, "kernels_meta_dir", lambda: folder)
    monkeypatch.setenv(resources.CACHE_VARIABLE, str(tmp_path / "cache"))
    return folder


# ---------- metakernels


def test_relative_paths_count_from_the_metakernels_own_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    kernel = text_kernel(tmp_path / "m" / "data" / "a.tf")
    meta = metakernel(
        tmp_path / "m" / "all.tm", "$D/a.tf", more="PATH_VALUES = ('data')\nPATH_SYMBOLS = ('D')"
    )
    with KernelSet(meta) as kernels:
        assert paths(kernels) == [meta, kernel]
        assert [k.kind for k in kernels.kernels()] == ["META", "FK"]
        assert spiceypy.gdpool("X", 0, 1) == [1.0]


def test_a_file_in_the_working_folder_comes_first_as_in_spice(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    beside = text_kernel(tmp_path / "m" / "a.tf", value=1.0)
    meta = metakernel(tmp_path / "m" / "all.tm", "./a.tf")
    assert paths(KernelSet("m/all.tm")) == [meta, beside]
    here = text_kernel(tmp_path / "a.tf", value=2.0)
    assert paths(KernelSet("m/all.tm")) == [meta, here]
    spiceypy.furnsh(str(meta))  # what SPICE itself takes
    assert spiceypy.gdpool("X", 0, 1) == [2.0]
    spiceypy.kclear()


def test_long_paths_continue_in_the_next_string(tmp_path):
    kernel = text_kernel(tmp_path / "a_rather_long_folder_name" / "a_rather_long_kernel_name.tf")
    meta = metakernel(tmp_path / "m.tm", "a_rather_long_folder_+", "name/a_rather_+", "long_kernel_name.tf")
    assert paths(KernelSet(meta)) == [meta, kernel]


def test_the_longest_symbol_wins_and_an_unknown_one_is_named(tmp_path):
    kernel = text_kernel(tmp_path / "right" / "a.tf")
    symbols = "PATH_VALUES = ('wrong' 'right')\nPATH_SYMBOLS = ('K' 'KK')"
    assert paths(KernelSet(metakernel(tmp_path / "m.tm", "$KK/a.tf", more=symbols)))[1] == kernel
    with pytest.raises(KernelError, match=r"symbol \$NOPE"):
        KernelSet(metakernel(tmp_path / "n.tm", "$NOPE/a.tf", more=symbols))
    with pytest.raises(KernelError, match="1 PATH_VALUES for 2 PATH_SYMBOLS"):
        KernelSet(metakernel(tmp_path / "o.tm", "a.tf", more="PATH_VALUES = ('a')\nPATH_SYMBOLS = ('A' 'B')"))


def test_other_assignments_of_a_metakernel_count_and_its_list_is_put_away(tmp_path):
    text_kernel(tmp_path / "a.tf", value=5.0)
    with KernelSet(metakernel(tmp_path / "m.tm", "a.tf", more="OWN = 7\nX = 4")):
        assert spiceypy.gdpool("OWN", 0, 1) == [7.0]
        assert spiceypy.gdpool("X", 0, 1) == [5.0]  # what is listed loads later and wins, as in SPICE
        assert not spiceypy.expool("KERNELS_TO_LOAD")
    assert not spiceypy.expool("OWN")


def test_any_text_kernel_may_list_kernels(tmp_path):
    inner = text_kernel(tmp_path / "a.tf")
    outer = tmp_path / "b.tpc"
    outer.write_text("Lists a kernel.\n\n\\begindata\n  KERNELS_TO_LOAD += 'a.tf'\n\\begintext\n")
    assert paths(KernelSet(outer)) == [outer, inner]
    comment = tmp_path / "c.tf"
    comment.write_text("KPL/FK\nKERNELS_TO_LOAD = ('never')\n\\begindata\nY = 1\n\\begintext\n")
    assert [k.kind for k in KernelSet(comment).kernels()] == ["FK"]


def test_metakernels_may_list_metakernels_but_not_themselves(tmp_path):
    kernel = text_kernel(tmp_path / "a.tf")
    inner = metakernel(tmp_path / "inner.tm", "a.tf")
    outer = metakernel(tmp_path / "outer.tm", "inner.tm")
    assert paths(KernelSet(outer)) == [outer, inner, kernel]
    metakernel(inner, "outer.tm")
    with pytest.raises(KernelError, match="lists itself"):
        KernelSet(outer)


def test_all_missing_files_are_named_before_anything_is_loaded(tmp_path, toy):
    meta = metakernel(tmp_path / "m.tm", "one.bsp", "two.bc")
    spiceypy.furnsh(str(toy.lsk))
    with pytest.raises(KernelError) as caught:
        KernelSet([meta, toy.lsk, tmp_path / "three.tf"])
    message = str(caught.value)
    assert "3 kernels are missing" in message
    assert all(name in message for name in ("one.bsp (listed in m.tm)", "two.bc", "three.tf"))
    assert "\n" not in message
    assert spiceypy.ktotal("ALL") == 1
    spiceypy.kclear()


def test_reading_a_metakernel_leaves_the_pool_alone(tmp_path, toy):
    text_kernel(tmp_path / "a.tf")
    meta = metakernel(tmp_path / "m.tm", "a.tf", more="X = 9")
    with KernelSet(toy.files):
        spiceypy.pdpool("X", [3.0])
        KernelSet(meta)
        assert spiceypy.gdpool("X", 0, 1) == [3.0]
        assert spiceypy.ktotal("ALL") == len(toy.files)


@pytest.mark.parametrize("value", ["NaN", "inf", "abc", "1.2.3"])
def test_a_word_in_the_place_of_a_number_is_told_with_its_line(tmp_path, value):
    path = tmp_path / "camera.ti"
    path.write_text(f"KPL/IK\n\\begindata\nINS-98301_FOCAL_LENGTH = {value}\n\\begintext\n")
    with (
        pytest.raises(KernelError, match=r"malformed.*line 3 .*camera\.ti.*correct that line"),
        KernelSet(path),
    ):
        pass


def test_a_malformed_metakernel_is_one_clear_line(tmp_path):
    meta = tmp_path / "m.tm"
    meta.write_text("KPL/MK\n\\begindata\nKERNELS_TO_LOAD ( 'a.tf' )\nKERNELS_TO_LOAD = 'b.tf'\n")
    with pytest.raises(KernelError, match=r"m\.tm.*malformed.*correct that line") as caught:
        KernelSet(meta)
    assert "\n" not in str(caught.value)


# ---------- paths, lists, folders


@pytest.mark.parametrize("in_metakernel", [False, True])
def test_paths_too_long_for_spice_are_refused_clearly(tmp_path, in_metakernel):
    deep = tmp_path.joinpath(*["d" * 60] * 5)
    kernel = text_kernel(deep / "a.tf")
    source = metakernel(tmp_path / "m.tm", *_pieces(str(kernel))) if in_metakernel else kernel
    with pytest.raises(KernelError, match=r"has \d+ bytes, SPICE takes 255"):
        KernelSet(source)


def _pieces(text):
    parts = [text[i : i + 60] for i in range(0, len(text), 60)]
    return [*(f"{p}+" for p in parts[:-1]), parts[-1]]


def test_lists_keep_their_order(toy):
    turned = list(reversed(toy.files))
    assert paths(KernelSet(turned)) == turned
    assert paths(KernelSet(map(str, turned))) == turned


def test_a_folder_loads_in_the_order_of_kinds_then_names(toy, tmp_path):
    for i, path in enumerate(reversed(toy.files)):
        (tmp_path / f"{i}{path.suffix}").write_bytes(path.read_bytes())
    text_kernel(tmp_path / "0.tf")
    (tmp_path / "notes.txt").write_text("no kernel")
    (tmp_path / "label.lbl").write_text("PDS_VERSION_ID = PDS3")
    metakernel(tmp_path / "all.tm", "nowhere.bsp")  # left out: its files would stand here
    with KernelSet(tmp_path) as kernels:
        kinds = [k.kind for k in kernels.kernels()]
        assert kinds == ["LSK", "SCLK", "PCK", "FK", "FK", "IK", "SPK", "CK"]
        assert [k.path.name for k in kernels.kernels() if k.kind == "FK"] == ["0.tf", "4.tf"]


def test_a_folder_without_kernels_says_what_it_holds(tmp_path):
    (tmp_path / "spk").mkdir()
    with pytest.raises(KernelError, match=r"no kernels in the folder .*; folders within: spk"):
        KernelSet(tmp_path)


def test_no_source_is_refused():
    with pytest.raises(KernelError, match="no kernel given"):
        KernelSet([])


def test_kinds_come_from_content_and_only_then_from_the_suffix(tmp_path, toy):
    odd = tmp_path / "spk.tf"
    odd.write_bytes(toy.path(".bsp").read_bytes())
    assert KernelSet(odd).kernels() == (KernelFile(odd, "SPK"),)
    bare = tmp_path / "bare.ti"
    bare.write_text("\\begindata\nINS-1_X = 1\n\\begintext\n")
    assert KernelSet(bare).kernels()[0].kind == "IK"


# ---------- names


def test_a_misspelt_name_suggests_and_lists(names_folder):
    metakernel(names_folder / "new_horizons" / "pluto_approach.tm")
    metakernel(names_folder / "osiris_rex" / "arrival.tm")
    with pytest.raises(KernelError) as caught:
        KernelSet("new_horizons/pluto_aproach")
    message = str(caught.value)
    assert "did you mean new_horizons/pluto_approach?" in message
    assert "osiris_rex/arrival" in message


def test_a_name_is_a_metakernel_whose_own_folder_comes_first(names_folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    own = text_kernel(names_folder / "mission" / "a.tf", value=1.0)
    text_kernel(tmp_path / "a.tf", value=2.0)
    metakernel(names_folder / "mission" / "one.tm", "a.tf")
    assert paths(KernelSet("mission/one"))[1] == own


def test_only_metakernels_and_scenarios_are_names(names_folder):
    metakernel(names_folder / "m" / "real.tm")
    (names_folder / "m" / "mission.yaml").write_text("name: m\ncameras: {}\n")
    (names_folder / "m" / "cameras").mkdir()
    (names_folder / "m" / "cameras" / "c.yaml").write_text("trajectories: []\n")
    (names_folder / "m" / "rehearsal.yaml").write_text("mission: m\ntrajectories: []\n")
    assert known_names() == ("m/real", "m/rehearsal")


def test_the_names_that_the_package_brings_are_known():
    assert "new_horizons/pluto_approach" in known_names()
    assert resources.kernels_meta_dir().is_dir()


# ---------- scenarios


@pytest.fixture
def scenario(names_folder, monkeypatch):
    """A scenario whose builder writes one kernel and counts its calls."""
    (names_folder / "m").mkdir()
    path = names_folder / "m" / "one.yaml"
    path.write_text("trajectories: []\n")
    calls = []

    def build(source, out):
        calls.append(Path(out))
        text_kernel(Path(out) / "a.tf")
        return metakernel(Path(out) / "one.tm", "$K/a.tf", more="PATH_VALUES=('.')\nPATH_SYMBOLS=('K')")

    monkeypatch.setattr("opnav_workbench.kernels.making.make.make_kernels", build)
    return path, calls


def test_a_scenario_is_built_once_and_again_when_it_changes(scenario, monkeypatch):
    path, calls = scenario
    for _ in range(3):
        with KernelSet("m/one") as kernels:
            assert [k.kind for k in kernels.kernels()] == ["META", "FK"]
    assert len(calls) == 1
    folder = kernels.kernels()[0].path.parent
    assert folder.parent == resources.cache_root() / "kernels"
    assert folder.name.startswith("m_one-")
    assert not calls[0].exists()  # built elsewhere and renamed

    path.write_text("trajectories: [] # changed\n")
    assert KernelSet("m/one").kernels()[0].path.parent != folder
    monkeypatch.setattr("opnav_workbench.kernels.kernel_set.__version__", "9.9.9")
    KernelSet("m/one")
    assert len(calls) == 3


def test_a_build_that_fails_leaves_nothing(scenario, monkeypatch):
    def fail(source, out):
        text_kernel(Path(out) / "half.tf")
        raise KernelError("no such body")

    good = kernel_set.make.make_kernels
    monkeypatch.setattr("opnav_workbench.kernels.making.make.make_kernels", fail)
    with pytest.raises(KernelError, match="no such body"):
        KernelSet("m/one")
    assert list((resources.cache_root() / "kernels").iterdir()) == []
    monkeypatch.setattr("opnav_workbench.kernels.making.make.make_kernels", good)
    assert len(KernelSet("m/one").kernels()) == 2


def test_leftovers_of_a_killed_build_are_ignored_and_removed_after_a_day(scenario):
    root = resources.cache_root() / "kernels"
    old, young = root / f"{kernel_set.BUILDING}m_one-old", root / f"{kernel_set.BUILDING}m_one-young"
    for folder in (old, young):
        text_kernel(folder / "half.tf")
    day_ago = time.time() - kernel_set.STALE_BUILD_S - 60.0
    os.utime(old, (day_ago, day_ago))
    assert len(KernelSet("m/one").kernels()) == 2
    assert not old.exists()
    assert young.exists()


def test_of_two_builders_the_first_wins(scenario, monkeypatch):
    build, calls = kernel_set.make.make_kernels, []

    def slow(source, out):
        if not calls:  # another process builds the same while this one is at work
            calls.append(out)
            KernelSet("m/one")
        return build(source, out)

    monkeypatch.setattr("opnav_workbench.kernels.making.make.make_kernels", slow)
    assert len(KernelSet("m/one").kernels()) == 2
    (kept,) = (resources.cache_root() / "kernels").iterdir()
    assert sorted(p.name for p in kept.iterdir()) == ["a.tf", "one.tm"]


def test_a_cache_that_cannot_be_written_names_the_remedy(scenario, monkeypatch, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    monkeypatch.setenv(resources.CACHE_VARIABLE, str(blocked))
    with pytest.raises(KernelError, match="name another cache folder in OPNAV_CACHE"):
        KernelSet("m/one")


def test_a_cache_without_its_metakernel_says_what_to_delete(scenario):
    folder = KernelSet("m/one").kernels()[0].path.parent
    (folder / "one.tm").unlink()
    with pytest.raises(KernelError, match=r"holds no metakernel; delete that folder"):
        KernelSet("m/one")


def test_without_the_variable_the_users_cache_is_taken(monkeypatch):
    monkeypatch.delenv(resources.CACHE_VARIABLE, raising=False)
    assert "opnav_workbench" in str(resources.cache_root())


@pytest.mark.slow
def test_processes_that_build_the_packages_scenario_at_once_agree(tmp_path):
    code = (
        "from opnav_workbench.kernels import KernelSet\n"
        "with KernelSet('new_horizons/pluto_approach') as k:\n"
        "    print([x.sha256 for x in k.kernels()], k.covers_attitude('NH_LORRI', 489000000.0))\n"
    )
    environment = os.environ | {resources.CACHE_VARIABLE: str(tmp_path)}
    runs = [
        subprocess.Popen([sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    outputs = {run.communicate(timeout=120)[0] for run in runs}
    assert len(outputs) == 1
    assert "True" in outputs.pop()
    assert len(list((tmp_path / "kernels").iterdir())) == 1

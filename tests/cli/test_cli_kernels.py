"""``opnav kernels``: what its commands print, write, and exit with."""

import functools
import hashlib
import http.server
import re
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from opnav_workbench.cli.kernels import kernels_app
from opnav_workbench.cli.terminal import EXIT_PARTLY
from opnav_workbench.errors import KernelError, MissionError
from opnav_workbench.kernels import KernelSet, check_kernels, known_names, packaged_leap_seconds
from opnav_workbench.report.kernel_coverage import coverage_figure
from opnav_workbench.resources import kernels_meta_dir

WIDE = {"COLUMNS": "200", "NO_COLOR": "1", "TERM": "dumb"}
NARROW = WIDE | {"COLUMNS": "80"}
NAME = "new_horizons/pluto_opnav"  # one day: 2015-04-09
COMMANDS = ("list", "check", "fetch", "make", "brief", "geometry", "make-ck", "make-isd")
FLIGHT = ("naif0012.tls", "new_horizons_1454.tsc", "pck00011.tpc", "nh_v220.tf", "nh_ralph_v100u.ti")
SEES = ("--mission", "new_horizons")


def _run(*arguments: object, env=WIDE):
    answer = CliRunner().invoke(kernels_app, [str(a) for a in arguments], env=env)
    if answer.exception is not None and not isinstance(answer.exception, SystemExit):
        raise answer.exception
    return answer


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """The kernels of one day, made by the program."""
    folder = tmp_path_factory.mktemp("made")
    answer = _run("make", NAME, "--out", folder, "--actual")
    assert answer.exit_code == 0
    assert str(folder / "pluto_opnav_actual.tm") in answer.output
    return folder


# -- help and list -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_with_an_example(command):
    answer = _run(command, "--help")
    assert answer.exit_code == 0
    assert re.search(rf"Example\s+opnav kernels {command}", answer.output)


def test_list_names_sets_spans_and_manifests(monkeypatch, tmp_path):
    monkeypatch.setenv("OPNAV_CACHE", str(tmp_path))
    text = _run("list").output
    assert all(name in text for name in known_names())
    assert re.search(rf"{NAME}\s+2015-04-09\s+2015-04-10\s+New Horizons.*built on first use", text)
    assert re.search(r"generic/flight\s+4\s+0\s", text)


# -- check ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_check_of_a_time_that_is_served(made):
    answer = _run("check", made / "pluto_opnav.tm", "--time", "2015-04-09T12:00:00", *SEES)
    assert answer.exit_code == 0, answer.output
    for kind in ("LSK", "SCLK", "PCK", "FK", "IK", "target SPK", "spacecraft SPK", "CK"):
        assert re.search(rf"^{kind}\s+\S", answer.output, re.MULTILINE), kind
    assert re.search(r"CK\s+NH_SPACECRAFT\s+2015-04-09 .*┃.*yes", answer.output)
    assert "All eight kinds are there, and 2015-04-09 12:00:00 UTC is served." in answer.output


def test_check_of_a_gap_names_it_and_exits_3(made):
    answer = _run("check", made / "pluto_opnav.tm", "--time", "2015-04-12T00:00:00", *SEES)
    assert answer.exit_code == EXIT_PARTLY
    assert re.search(r"CK\s+NH_SPACECRAFT.*no\b", answer.output)
    assert re.search(r"missing CK of NH_SPACECRAFT: ends at 2015-04-\S+ UTC; load a CK", answer.output)
    assert "All eight kinds" not in answer.output


def test_check_of_a_missing_kind_exits_3(made):
    files = [p for p in sorted(made.glob("*")) if p.suffix not in (".tm", ".ti") and "actual" not in p.stem]
    answer = _run("check", *files)
    assert answer.exit_code == EXIT_PARTLY
    assert re.search(r"^IK\s+missing", answer.output, re.MULTILINE)
    assert "missing IK: none; add the instrument kernel" in answer.output


def test_check_fits_a_narrow_terminal(made):
    answer = _run("check", made / "pluto_opnav.tm", "--time", "2015-04-09T12:00:00", env=NARROW)
    table = [line for line in answer.output.splitlines() if line.startswith(("kind", "spacecraft", "target"))]
    assert max(map(len, table)) <= 80
    assert "2015-04-09" in answer.output
    assert re.search(r"NH_SPACECRAFT\s+2015-", answer.output)  # not folded


def test_check_names_overlaps_and_the_winner(made):
    answer = _run("check", made / "pluto_opnav.tm", made / "pluto_opnav_actual.bc")
    assert re.search(r"overlap CK of NH_SPACECRAFT: 2015-04-09 .* pluto_opnav_actual\.bc wins", answer.output)


@pytest.mark.slow
def test_check_draws(made, tmp_path):
    png = tmp_path / "coverage.png"
    arguments = ("check", made / "pluto_opnav.tm", "--time", "2015-04-09T12:00:00", "--picture", png)
    answer = _run(*arguments)
    assert answer.exit_code == 0
    assert f"Written: {png}" in answer.output
    assert png.read_bytes().startswith(b"\x89PNG")
    assert len(png.read_bytes()) > 10_000
    first = png.read_bytes()
    _run(*arguments)
    assert png.read_bytes() == first


def test_a_gap_too_short_for_the_picture_is_drawn_all_the_same(made):
    found = check_kernels([made / "pluto_opnav.tm"])
    attitude = next(row for row in found.rows if row.kind == "CK")
    begin = float(attitude.windows_et[0, 0])
    gap = np.array([[begin + 3600.0, begin + 3601.0]])  # a second, of a day
    rows = tuple(replace(row, gaps_et=gap) if row is attitude else row for row in found.rows)
    with packaged_leap_seconds() as lsk, KernelSet(lsk):
        (axes,) = coverage_figure(replace(found, rows=rows)).axes
    white = [
        c for c in axes.collections if len(c.get_facecolor()) and c.get_facecolor()[0].tolist() == [1.0] * 4
    ]
    drawn = [path.get_extents() for collection in white for path in collection.get_paths()]
    start, stop = found.plot_span_et()
    assert [box.x0 for box in drawn] == pytest.approx([begin + 3600.0])
    assert drawn[0].width >= 0.001 * (stop - start)


def test_check_of_bad_input(made, tmp_path):
    with pytest.raises(KernelError, match="did you mean new_horizons/pluto_opnav"):
        _run("check", "new_horizons/pluto_opnaw")
    with pytest.raises(KernelError, match="UTC time 'noon'"):
        _run("check", made / "pluto_opnav.tm", "--time", "noon")
    with pytest.raises(MissionError, match="Did you mean new_horizons"):
        _run("check", made / "pluto_opnav.tm", "--mission", "new_horizon")


@pytest.mark.realdata
def test_check_of_flight_kernels_with_a_gap(data_dir):
    """The MVIC slice: the picture of 2015-06-03T04:07, and the light of Pluto 4.4 h before; nothing between."""
    generic = [data_dir / "spice" / "generic" / name for name in FLIGHT]
    files = [*generic, data_dir / "spice" / "slices" / "mpf_0295610274_0x539_sci"]
    asked = ("--targets", "PLUTO", "--camera", "NH_RALPH_MVIC_FT")
    served = _run("check", *files, "--time", "2015-06-03T04:07:03", *asked)
    assert served.exit_code == 0, served.output
    assert re.search(
        r"gap\s+CK of NH_SPACECRAFT: 2015-06-02 23:40:37 to 2015-06-03 04:02:39 \(4\.4 h\)", served.output
    )
    assert _run("check", *files, "--time", "3/0295610463:00000", *asked).exit_code == 0
    gap = _run("check", *files, "--time", "2015-06-03T02:00:00", *asked)
    assert gap.exit_code == EXIT_PARTLY
    assert re.search(r"missing CK of NH_SPACECRAFT: gap from 2015-06-02T23:40:36\.546 UTC", gap.output)


# -- make ----------------------------------------------------------------------------------------------------------


def test_make_tells_what_it_wrote(tmp_path):
    answer = _run("make", kernels_meta_dir() / f"{NAME}.yaml", "--out", tmp_path / "k")
    assert answer.exit_code == 0
    assert re.search(r"SPK\s+pluto_opnav_spacecraft\.bsp\s+\S+ \S+\s+NEW HORIZONS, 2015-04", answer.output)
    assert re.search(r"CK\s+pluto_opnav_predicted\.bc\s.*NH_SPACECRAFT, 2015-04-09", answer.output)
    assert "actual" not in answer.output
    assert KernelSet(tmp_path / "k" / "pluto_opnav.tm").paths


def test_make_goes_to_kernels_by_default(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _run("make", NAME)
    assert (tmp_path / "kernels" / "pluto_opnav" / "pluto_opnav.tm").is_file()


def test_make_a_dsk_of_a_shape(tmp_path):
    shape = tmp_path / "rock.obj"
    corners = ("1 1 1", "1 -1 -1", "-1 1 -1", "-1 -1 1")
    faces = ("1 2 3", "1 4 2", "1 3 4", "2 4 3")
    shape.write_text("\n".join([*(f"v {c}" for c in corners), *(f"f {f}" for f in faces)]) + "\n")
    answer = _run("make", shape, "--body", "PLUTO", "--frame", "IAU_PLUTO", "--unit", "m")
    assert re.search(r"DSK\s+rock\.bds\s.*PLUTO, surface 1, 4 vertices, 4 plates", answer.output)
    assert (tmp_path / "rock.bds").is_file()
    with pytest.raises(KernelError, match="say --body"):
        _run("make", shape, "--body", "PLUTO")
    with pytest.raises(KernelError, match="IAU_NOWHERE"):
        _run("make", shape, "--body", "PLUTO", "--frame", "IAU_NOWHERE", "--out", tmp_path / "x.bds")
    assert not (tmp_path / "x.bds").exists()


def test_make_of_bad_input(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(KernelError, match="cannot write"):
        _run("make", NAME, "--out", tmp_path / "file")
    with pytest.raises(MissionError, match=r"none\.yaml"):
        _run("make", tmp_path / "none.yaml", "--out", tmp_path / "k")
    assert not (tmp_path / "k").exists()


# -- brief ---------------------------------------------------------------------------------------------------------


def test_brief_of_a_ck_beside_its_clock(made):
    text = _run("brief", made / "pluto_opnav_predicted.bc", made / "pluto_opnav.tsc").output
    assert re.search(r"\(?-98000\)?\s+J2000\s+3\s+2015-04-09 \S+\s+2015-04-09 \S+\s+with rates", text)
    assert re.search(r"SCLK01_COEFFICIENTS_98\s+\d+", text)
    assert "tick " in _run("brief", made / "pluto_opnav_predicted.bc").output
    assert "NH_SPACECRAFT" in _run("brief", made / "pluto_opnav_predicted.bc", "--kernels", NAME).output


def test_brief_of_a_metakernel_marks_files_that_are_not_there(tmp_path):
    path = tmp_path / "a.tm"
    path.write_text("KPL/MK\n\\begindata\nKERNELS_TO_LOAD = ( 'none.bsp' )\n")
    assert re.search(r"none\.bsp\s+not there", _run("brief", path).output)


# -- fetch ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def archive(tmp_path, monkeypatch):
    """A manifest of leap seconds, and a local server that keeps them."""
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    monkeypatch.setenv("OPNAV_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("opnav_workbench.downloads.PAUSE_S", 0.0)
    folder = tmp_path / "served"
    folder.mkdir()
    with packaged_leap_seconds() as lsk:
        (folder / "naif.tls").write_bytes(lsk.read_bytes())

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=folder))
    server.daemon_threads = False
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    url = f"http://127.0.0.1:{server.server_port}/"
    digest = hashlib.sha256((folder / "naif.tls").read_bytes()).hexdigest()
    kernels = [
        {"kind": "LSK", "file": "lsk/naif.tls", "url": f"{url}naif.tls", "size": 5257, "sha256": digest, "purpose": "x"},
        {"kind": "LSK", "file": "lsk/again.tls", "url": f"{url}naif.tls", "size": None, "sha256": None, "purpose": "x"},
        {"kind": "PCK", "file": "pck/gone.tpc", "url": f"{url}gone.tpc", "size": None, "sha256": None, "purpose": "x"},
    ]  # fmt: skip
    path = tmp_path / "manifest.yaml"
    content = {
        "mission": "toy",
        "description": "toy",
        "metakernel": "toy.tm",
        "template": "t",
        "kernels": kernels,
    }
    path.write_text(yaml.safe_dump(content))
    (tmp_path / "t").write_text((kernels_meta_dir() / "generic" / "flight.tm.template").read_text())
    yield path
    server.shutdown()
    thread.join()
    server.server_close()


def test_fetch_says_what_is_verified_and_what_is_trusted(archive, tmp_path):
    text = _run("fetch", archive, "--only", "lsk", "--into", tmp_path / "k").output
    assert re.search(r"LSK\s+lsk/naif\.tls\s+5\.3 kB\s+fetched, verified", text)
    assert re.search(r"LSK\s+lsk/again\.tls\s+5\.3 kB\s+fetched, trusted, first time", text)
    assert "1 of them has no published digest" in text
    assert f"opnav kernels check {tmp_path / 'k' / 'toy.tm'}" in text
    again = _run("fetch", archive, "--only", "LSK", "--into", tmp_path / "k").output
    assert len(re.findall("was here, verified", again)) == 2
    assert "trusted" not in again


def test_fetch_of_a_file_that_is_gone_is_one_error(archive, tmp_path):
    from opnav_workbench.errors import DownloadError

    with pytest.raises(DownloadError, match=r"gone\.tpc: the server answers 404"):
        _run("fetch", archive, "--into", tmp_path / "k")
    assert (tmp_path / "k" / "lsk" / "naif.tls").is_file()
    assert not (tmp_path / "k" / "pck" / "gone.tpc").exists()


def test_fetch_of_bad_input(tmp_path):
    with pytest.raises(MissionError, match="Did you mean osiris_rex"):
        _run("fetch", "osiris-rexx")
    with pytest.raises(KernelError, match="no kind of kernel"):
        _run("fetch", "generic", "--only", "SPICE")
    with pytest.raises(KernelError, match="lists no CK"):
        _run("fetch", "generic", "--only", "CK", "--into", tmp_path / "k")
    assert not (tmp_path / "k").exists()


def test_make_of_an_unknown_name_lists_the_names(tmp_path):
    with pytest.raises(KernelError, match=r"no kernels named 'pluto_opnv'.*new_horizons/pluto_opnav"):
        _run("make", "pluto_opnv", "--out", tmp_path / "none")
    with pytest.raises(KernelError, match=r"no kernels at \S+/gone: no such file or folder; [^:]*$"):
        _run("check", tmp_path / "gone")
    assert not (tmp_path / "none").exists()

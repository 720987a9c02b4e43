"""Bad input: one clear line each, the right exit status, and the other pictures of the call still processed."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from typer.testing import CliRunner

from opnav_workbench.cli.program import main
from opnav_workbench.kernels import KernelSet
from opnav_workbench.rehearsal import DEMO_KERNELS


@pytest.fixture
def good_picture(demo_truths) -> Path:
    return demo_truths[0].picture


def _run(capsys, monkeypatch, *arguments: object) -> tuple[int, str, str]:
    """Run the program as a shell would; return exit status, standard output and standard error."""
    monkeypatch.setattr("sys.argv", ["opnav", *map(str, arguments)])
    monkeypatch.setenv("COLUMNS", "200")
    with pytest.raises(SystemExit) as stop:
        main()
    captured = capsys.readouterr()
    return int(stop.value.code or 0), captured.out, captured.err


def _failure_lines(text: str) -> list[str]:
    return [line for line in text.splitlines() if line.startswith(("failed:", "error:"))]


def _truncated(good: Path, bad: Path) -> None:
    bad.write_bytes(good.read_bytes()[: 2880 * 20])


def _text(good: Path, bad: Path) -> None:
    bad.write_text("this is not a picture\n")


def _all_nan(good: Path, bad: Path) -> None:
    with fits.open(good) as hdus:
        fits.PrimaryHDU(np.full_like(hdus[0].data, np.nan), hdus[0].header).writeto(bad)


def _no_time(good: Path, bad: Path) -> None:
    with fits.open(good) as hdus:
        header = hdus[0].header.copy()
        for key in ("SPCSCET", "SPCUTCAL", "SPCSCLK"):
            header.remove(key)
        fits.PrimaryHDU(hdus[0].data, header).writeto(bad)


def _long_ago(good: Path, bad: Path) -> None:
    """A time that the spacecraft's kernels cover only in part: outside the CK, or outside everything."""
    with fits.open(good) as hdus:
        header = hdus[0].header.copy()
        header["SPCSCET"] = header["SPCSCET"] + 5.0 * 86400.0
        for key in ("SPCUTCAL", "SPCSCLK"):  # which tell the true time, and would be taken
            header.remove(key)
        fits.PrimaryHDU(hdus[0].data, header).writeto(bad)


CASES = {
    "truncated": (_truncated, r"truncat|short|bytes"),
    "text": (_text, r"not a .*(FITS|picture)|neither"),
    "nan": (_all_nan, r"finite|NaN"),
    "no_time": (_no_time, r"time|SCLK|clock"),
    "outside_ck": (_long_ago, r"attitude|CK"),
}


def test_one_clear_line_each_and_the_others_are_kept(good_picture, tmp_path, capsys, monkeypatch):
    bad, out = {case: tmp_path / f"{case}.fit" for case in CASES}, tmp_path / "run"
    for case, (spoil, _) in CASES.items():
        spoil(good_picture, bad[case])
    status, _, err = _run(
        capsys,
        monkeypatch,
        "process",
        *bad.values(),
        good_picture,
        "--mission",
        "new_horizons",
        "--kernels",
        DEMO_KERNELS,
        "--out",
        out,
    )
    assert status == 3
    assert "Traceback" not in err
    good = json.loads((out / good_picture.stem / "result.json").read_text())
    assert good["status"] == "ok"
    for (case, (_, pattern)), line in zip(CASES.items(), _failure_lines(err), strict=True):
        assert f"{case}.fit" in line
        assert re.search(pattern, line.replace(case, ""), re.IGNORECASE), line
        spoiled = json.loads((out / case / "result.json").read_text())
        assert spoiled["status"] == "failed", case
        assert spoiled["messages"], case


def test_missing_sclk_kernel(good_picture, tmp_path, capsys, monkeypatch):
    """A kernel set with a CK but without the clock that times it."""
    with KernelSet(DEMO_KERNELS) as kernels:
        rest = [k.path for k in kernels.kernels() if k.kind not in ("SCLK", "META")]
    folder = tmp_path / "kernels"
    folder.mkdir()
    for path in rest:
        (folder / path.name).write_bytes(path.read_bytes())
    status, _, err = _run(
        capsys,
        monkeypatch,
        "process",
        good_picture,
        "--mission",
        "new_horizons",
        "--kernels",
        folder,
        "--out",
        tmp_path / "run",
    )
    (line,) = _failure_lines(err)
    assert status == 3
    assert "SCLK" in line


@pytest.mark.parametrize(
    ("options", "pattern"),
    [
        (("--mission", "new_horizon"), "new_horizons"),
        (("--mission", "new_horizons", "--kernels", "nowhere.tm"), "nowhere.tm"),
        (("--mission", "new_horizons", "--catalog", "tycho9"), "bundled"),
        (("--mission", "new_horizons", "--decisions", "none.yaml"), "none.yaml"),
    ],
)
def test_bad_usage_exits_2_or_3_with_one_line(options, pattern, good_picture, tmp_path, capsys, monkeypatch):
    status, _, err = _run(capsys, monkeypatch, "process", good_picture, *options, "--out", tmp_path)
    (line,) = _failure_lines(err)
    assert status in (2, 3)
    assert re.search(pattern, line), line


def test_empty_star_field(good_picture, tmp_path, capsys, monkeypatch):
    """A catalog with no star near the field: the picture fails, says so, and keeps its a priori pointing."""
    empty = tmp_path / "far.npz"
    np.savez(empty, ra_deg=np.array([10.0]), dec_deg=np.array([80.0]), mag=np.array([5.0]))
    status, _, err = _run(
        capsys,
        monkeypatch,
        "process",
        good_picture,
        "--mission",
        "new_horizons",
        "--catalog",
        f"npz:{empty}",
        "--out",
        tmp_path / "run",
    )
    (line,) = _failure_lines(err)
    assert status == 3
    assert "no star" in line
    result = json.loads((tmp_path / "run" / good_picture.stem / "result.json").read_text())
    assert result["status"] == "failed"
    assert result["pointing"] is None


def test_help_shows_an_example():
    from opnav_workbench.cli import app

    for command in ("demo", "process", "doctor"):
        answer = CliRunner().invoke(app, [command, "--help"])
        assert answer.exit_code == 0
        assert f"opnav {command}" in answer.output

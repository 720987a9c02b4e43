"""``opnav lab``: the notebook's parameters, clear errors, a server that starts and stops cleanly."""

import json
import os
import signal
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from opnav_workbench.cli import lab_server
from opnav_workbench.cli.lab import LabParameters, lab, put_notebook
from opnav_workbench.errors import SessionError
from opnav_workbench.processing import Processing
from opnav_workbench.processing.queue_file import AnalystQueue, QueuedImage, write_queue

PARAMETERS = LabParameters(("/data/a.fit",), Processing(mission="new_horizons"))


def parameters_of(folder, *more):
    cells = json.loads((folder / "workbench.ipynb").read_text())["cells"]
    tagged = {tag: "".join(cell["source"]) for cell in cells for tag in cell["metadata"].get("tags", ())}
    assert [c["metadata"].get("tags") for c in cells].count(["injected-parameters"]) == 1
    values = {}
    exec(tagged["parameters"], values)
    exec(tagged["injected-parameters"], values)
    return {name: values[name] for name in ("images", "mission", "kernels", "catalog", "out", *more)}


def test_notebook_gets_its_parameters_and_keeps_the_analysts_cells(tmp_path):
    path = put_notebook(tmp_path / "run", PARAMETERS)
    notebook = json.loads(path.read_text())
    notebook["cells"].append({"cell_type": "markdown", "id": "mine", "metadata": {}, "source": ["my note"]})
    path.write_text(json.dumps(notebook))
    how = Processing(mission="new_horizons", kernels="k.tm", catalog="npz:c.npz")
    put_notebook(tmp_path / "run", LabParameters(('/x/"odd".fit',), how))
    assert parameters_of(tmp_path / "run") == {
        "images": ['/x/"odd".fit'], "mission": "new_horizons", "kernels": "k.tm", "catalog": "npz:c.npz", "out": ".",
    }  # fmt: skip
    assert "my note" in path.read_text()


def test_damaged_notebook_is_refused(tmp_path):
    (tmp_path / "workbench.ipynb").write_text('{"cells": []}')
    with pytest.raises(SessionError, match=r"no cell tagged 'parameters'; move it away"):
        put_notebook(tmp_path, PARAMETERS)


@pytest.fixture
def served(monkeypatch):
    """Notebooks that would be served."""
    shown = []
    monkeypatch.setattr(
        "opnav_workbench.cli.lab._serve", lambda notebook, console, **how: shown.append(notebook)
    )
    return shown


def run(**given):
    defaults = {
        "images": None,
        "mission": None,
        "kernels": None,
        "catalog": None,
        "queue": None,
        "demo": False,
    }
    lab(**(defaults | {"out": None, "browser": False, "port": 0} | given))


def test_pictures_are_opened_from_anywhere(tmp_path, monkeypatch, served):
    monkeypatch.chdir(tmp_path)
    Path("a.fit").touch()
    run(images=[Path("a.fit")], mission="new_horizons", out=Path("run"))
    assert served == [tmp_path / "run" / "workbench.ipynb"]
    assert parameters_of(tmp_path / "run")["images"] == [str(tmp_path / "a.fit")]
    assert parameters_of(tmp_path / "run")["kernels"] is None


def test_queue_of_a_night(tmp_path, served, capsys):
    pictures = [tmp_path / place / "lor_1.fit" for place in ("b", "gone")]
    pictures[0].parent.mkdir()
    pictures[0].touch()
    waiting = tuple(QueuedImage(str(p), f"{p.parent.name}_lor_1", "partial", ("no stars",)) for p in pictures)
    kernels = "new_horizons/pluto_opnav"
    how = Processing(mission="new_horizons", kernels=kernels, targets=("PLUTO", "CHARON"))
    write_queue(tmp_path, AnalystQueue(waiting, how))
    run(queue=tmp_path)
    found = parameters_of(tmp_path, "folders", "targets")
    assert (found["images"], found["mission"]) == ([str(pictures[0])], "new_horizons")
    assert found["kernels"] == kernels
    assert (found["folders"], found["targets"]) == (["b_lor_1"], ["PLUTO", "CHARON"])
    assert "gone/lor_1.fit: it is not there any more" in capsys.readouterr().out.replace("\n", "")
    pictures[0].unlink()
    with pytest.raises(SessionError, match="none of the pictures that wait"):
        run(queue=tmp_path)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "give pictures, or --queue DIR, or --demo"),
        ({"images": [Path("a.fit")], "demo": True}, "exactly one of them"),
        ({"images": [Path("a.fit")]}, "--mission is missing"),
        ({"images": [Path("a.fit")], "mission": "new_horizons"}, "there is no picture a.fit"),
        ({"queue": Path("nowhere")}, "there is no folder nowhere"),
    ],
)
def test_bad_input_is_one_line(given, message, tmp_path, monkeypatch, served):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SessionError, match=message):
        run(**given)
    assert not served
    assert not list(tmp_path.iterdir())


def test_taken_port_is_told(tmp_path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        with pytest.raises(SessionError, match=rf"port {port} is taken; choose another"):
            lab_server.LabServer(tmp_path / "workbench.ipynb", port)


@pytest.mark.slow
def test_server_that_does_not_start_says_why(tmp_path):
    server = lab_server.LabServer(tmp_path / "workbench.ipynb", options=["--ServerApp.ip=256.0.0.1"])
    with pytest.raises(SessionError, match=r"JupyterLab did not start"), server:
        pass


@pytest.mark.slow
def test_ctrl_c_stops_everything(tmp_path):
    """The program as a person runs it: address on the screen, then Ctrl-C."""
    for name in ("lorri_4x4.fit", "mvic_framing.fit"):  # as if simulated before
        (tmp_path / "pictures").mkdir(exist_ok=True)
        (tmp_path / "pictures" / name).touch()
    code = "import typer; from opnav_workbench.cli.lab import lab; typer.run(lab)"
    isolated = {f"JUPYTER_{name}_DIR": str(tmp_path / name) for name in ("CONFIG", "DATA", "RUNTIME")}
    program = subprocess.Popen(
        [sys.executable, "-c", code, "--demo", "--no-browser", "--out", str(tmp_path)],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=os.environ | isolated,
    )  # fmt: skip
    try:
        address = program.stdout.readline().split()[-1]
        base, token = address.split("/lab/")[0], address.split("token=")[1]
        assert "/tree/workbench.ipynb?" in address
        with urllib.request.urlopen(
            f"{base}/api/contents/workbench.ipynb?token={token}", timeout=5
        ) as answer:
            assert answer.status == 200
        program.send_signal(signal.SIGINT)
        rest, _ = program.communicate(timeout=120)
    finally:
        program.kill()
        program.wait()
    assert "JupyterLab has stopped." in rest
    assert "Traceback" not in rest
    with pytest.raises(OSError, match=r"refused|reset"):
        urllib.request.urlopen(f"{base}/api", timeout=2)

"""A notebook that stands in for the processing, so that what happens around it can be tested in seconds."""

import sys
from pathlib import Path

import nbformat
import pytest

from opnav_workbench.resources import notebooks_dir

sys.path.insert(0, str(Path(__file__).parent))  # the exams beside the tests

# What happens to a picture is written in its file.
PROCESSING = """
import hashlib, json, os, pathlib, time
text = pathlib.Path(image).read_text()
time.sleep(0.3)
if text.startswith("sleep"):
    time.sleep(60)
if text.startswith("memory"):
    hog = bytearray(600_000_000)
    time.sleep(60)
if text.startswith("raise"):
    raise ValueError("no such thing")
if text.startswith("crash"):
    os._exit(9)
if text.startswith("once"):
    tried = pathlib.Path(image + ".tried")
    if not tried.exists():
        tried.touch()
        os._exit(9)
pathlib.Path(out, "result.json").write_text(json.dumps({
    "image": pathlib.Path(image).name, "mission": mission, "status": "ok", "messages": [],
    "sha256": hashlib.sha256(text.encode()).hexdigest(), "bodies": [], "stars": [], "pointing": None}))
"""


@pytest.fixture(scope="session")
def stand_in(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A notebook with the parameters of the real one that does what the picture's text says."""
    real = nbformat.read(notebooks_dir() / "process_image.ipynb", 4)
    parameters = next(cell for cell in real.cells if "parameters" in cell.metadata.get("tags", []))
    real.cells = [parameters, nbformat.v4.new_code_cell(PROCESSING, id="work")]
    path = tmp_path_factory.mktemp("notebook") / "stand_in.ipynb"
    nbformat.write(real, path)
    return path

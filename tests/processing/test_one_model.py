"""One way to say what shall be done with a picture: the same options, whichever way they come, give the same model."""

import inspect
import json
import re
import shlex
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from opnav_workbench.cli import app
from opnav_workbench.cli.lab import LabParameters, lab, put_notebook
from opnav_workbench.cli.nightly import nightly
from opnav_workbench.cli.ort import solve
from opnav_workbench.cli.process import process
from opnav_workbench.cli.program import main
from opnav_workbench.errors import SessionError
from opnav_workbench.headless.inputs import NightInputs
from opnav_workbench.headless.night import plan_night
from opnav_workbench.headless.night_spec import NightSpec, load_night
from opnav_workbench.kernels import KernelPart
from opnav_workbench.processing import PictureJob, Processing, notebook_parameters, picture_job
from opnav_workbench.processing.model import targets_text
from opnav_workbench.processing.queue_file import AnalystQueue, QueuedImage, read_queue, write_queue
from opnav_workbench.resources import notebooks_dir
from opnav_workbench.session import BODY_METHODS, Settings
from opnav_workbench.workbench.parameters import workbench_job

# Each option as a person types it, beside the mission.
TYPED = {
    "nothing": {},
    "kernels": {"kernels": "new_horizons/pluto_opnav"},
    "catalog": {"catalog": "bundled+bundled"},
    "targets": {"targets": "PLUTO, CHARON"},
    "targets with methods": {"targets": "PLUTO:limb_scan,CHARON"},
    "no targets": {"targets": "none"},
    "method": {"method": "ellipse"},
    "target_stars": {"target_stars": "/data/stars.yaml"},
    "shapes": {"shapes": "PLUTO:/data/pluto.obj:m"},
    "landmarks": {"landmarks": "PLUTO:/data/pluto.npz"},
    "decisions": {"decisions": "/data/decisions.yaml"},
    "attitude": {"attitude": "header"},
    "initial": {"initial": "cross_correlation"},
    "centers": {"centers": "psf_fit"},
    "model": {"model": "image_plane"},
    "settings": {"settings": "max_shift_px=200,max_stars=50"},
    "all": {
        "kernels": "new_horizons/pluto_opnav",
        "targets": "CHARON:unresolved,PLUTO",
        "method": "limb_scan",
        "target_stars": "/data/stars.yaml",
        "shapes": "PLUTO:/data/pluto.obj:m,CHARON:/data/charon.plt",
        "landmarks": "PLUTO:/data/pluto.npz,CHARON:/data/charon.npz",
        "decisions": "/data/decisions.yaml",
        "attitude": "kernels",
        "initial": "cross_correlation",
        "centers": "matched_filter",
        "model": "image_plane",
        "settings": "search_radius_px=3",
    },
}
MISSION = {"mission": "new_horizons"}


class Caught(Exception):
    """Carries what a command was about to do."""


def catcher(index):
    """Return a function that raises its argument."""

    def catch(*arguments, **options):
        raise Caught(options.get("how") or arguments[index])

    return catch


@dataclass
class Package:
    """As much of a rehearsal's package as says how its pictures are processed."""

    mission: str = "new_horizons"
    metakernel: Path = Path("new_horizons/pluto_opnav")
    catalog: str = "bundled"
    targets: tuple[str, ...] | None = None
    name: str = "a rehearsal"
    pictures: tuple = ()
    orbit: None = None


@pytest.fixture(autouse=True)
def caught(monkeypatch, tmp_path):
    """Nothing is processed: what commands would do is caught."""
    monkeypatch.chdir(tmp_path)
    Path("a.fit").touch()
    monkeypatch.setattr("opnav_workbench.cli.process.process_images", catcher(1))
    monkeypatch.setattr("opnav_workbench.cli.nightly.plan_night", catcher(0))
    monkeypatch.setattr("opnav_workbench.cli.ort.process_package", catcher(0))
    monkeypatch.setattr("opnav_workbench.cli.ort.open_rehearsal", lambda _: Package())
    monkeypatch.setattr("opnav_workbench.cli.lab._serve", lambda *_, **__: None)
    monkeypatch.setattr(Processing, "opened", lambda self: None)  # the files named above are not there


def typed_words(typed):
    return [word for name, value in typed.items() for word in ("--" + name.replace("_", "-"), value)]


def by_command(*words):
    answer = CliRunner().invoke(app, [str(word) for word in words])
    if not isinstance(answer.exception, Caught):
        raise answer.exception or AssertionError(answer.output)
    return answer.exception.args[0].plain


def by_process(typed):
    return by_command("process", "a.fit", *typed_words(typed))


def by_nightly(typed):
    return by_command("nightly", "a.fit", *typed_words(typed))


def by_night_file(typed):
    Path("night.yaml").write_text(yaml.safe_dump({"images": ["a.fit"], **typed}))
    return by_command("nightly", "night.yaml")


def by_options_over_a_night_file(typed):
    other = {"mission": "other", "model": "euler", "centers": "least_squares", "catalog": "bundled"}
    Path("night.yaml").write_text(yaml.safe_dump({"images": ["a.fit"], **other}))
    return by_command("nightly", "night.yaml", *typed_words(typed))


def by_night_file_written(typed):
    said = NightSpec.checked({"images": ["a.fit"], **typed}).said()
    Path("night.yaml").write_text(yaml.safe_dump(said))
    return load_night("night.yaml").plain


def cells_of(notebook):
    """The values that a notebook's parameters cells leave."""
    values = {}
    for cell in json.loads(Path(notebook).read_text())["cells"]:
        if {"parameters", "injected-parameters"} & set(cell["metadata"].get("tags", ())):
            exec("".join(cell["source"]), values)
    return values


def by_lab(typed):
    answer = CliRunner().invoke(app, ["lab", "a.fit", "--out", "lab", *typed_words(typed)])
    if answer.exception:
        raise answer.exception
    return workbench_job(cells_of("lab/workbench.ipynb")).plain


def by_queue(typed):
    how = Processing.checked(typed)
    write_queue(".", AnalystQueue((QueuedImage("a.fit", "a", "partial"),), how))
    return read_queue(".").how


def by_lab_with_a_queue(typed):
    by_queue({**typed, "model": "euler"})  # an option outranks the file
    more = ["--model", typed["model"]] if "model" in typed else []
    answer = CliRunner().invoke(app, ["lab", "--queue", ".", *more])
    if answer.exception:
        raise answer.exception
    return workbench_job(cells_of("workbench.ipynb")).plain


def by_picture_notebook(typed):
    return picture_job({"image": "a.fit", **typed}).plain


def by_workbench_notebook(typed):
    return workbench_job({"images": "a.fit", **typed}).plain


def by_ort_solve(typed):
    of_the_package = {"mission": "new_horizons", "kernels": "new_horizons/pluto_opnav"}
    rest = {name: value for name, value in typed.items() if name not in of_the_package}
    found = by_command("ort", "solve", "ort", *typed_words(rest))
    assert found.kernels == of_the_package["kernels"]
    return found.changed(kernels=typed.get("kernels"))


ROUTES = (
    by_process,
    by_nightly,
    by_night_file,
    by_options_over_a_night_file,
    by_night_file_written,
    by_lab,
    by_queue,
    by_lab_with_a_queue,
    by_picture_notebook,
    by_workbench_notebook,
    by_ort_solve,
)


@pytest.mark.parametrize("route", ROUTES)
@pytest.mark.parametrize("case", TYPED)
def test_the_same_options_give_the_same_model(case, route):
    typed = MISSION | TYPED[case]
    assert route(typed) == Processing.checked(typed)


def test_every_field_is_tried():
    assert {name for typed in TYPED.values() for name in typed} | {"mission", "methods"} == set(
        Processing.model_fields
    )


@pytest.mark.parametrize("command", [nightly, lab, solve])
def test_commands_have_the_same_options_with_the_same_help(command):
    of_process, own = (inspect.signature(c, eval_str=True).parameters for c in (process, command))
    settled = {"mission", "kernels"} if command is solve else set()
    for name in set(Processing.model_fields) - {"methods"} - settled:
        (mine,), (theirs,) = own[name].annotation.__metadata__, of_process[name].annotation.__metadata__
        assert (mine.help, mine.param_decls, mine.show_default) == (
            theirs.help,
            theirs.param_decls,
            theirs.show_default,
        )
    assert not settled & set(own)


# -- any model, there and back -------------------------------------------------------------------------------------

NAMES = st.text("ABCXYZ019_", min_size=1, max_size=6).filter(lambda name: name.casefold() != "none")
METHODS = st.sampled_from(BODY_METHODS)
USUAL = Settings().to_dict()
SETTINGS = st.fixed_dictionaries(
    {},
    optional={
        name: st.integers(1, 1000) if isinstance(value, int) else st.floats(0.0, 1e4)
        for name, value in USUAL.items()
    },
)


@st.composite
def models(draw):
    def choice(name):
        return draw(st.sampled_from(Processing.model_fields[name].annotation.__args__))

    def text(*words):
        return draw(st.sampled_from([None, *words]))

    return Processing(
        mission=draw(st.sampled_from(["new_horizons", "/missions/mine.yaml"])),
        kernels=text("flight.tm", "new_horizons/pluto_opnav"),
        catalog=draw(st.sampled_from(["bundled", "npz:a b.npz"])),
        targets=draw(st.none() | st.lists(NAMES, unique=True, max_size=3).map(tuple)),
        methods=draw(st.dictionaries(NAMES, METHODS, max_size=2)),
        target_stars=text("s.yaml"),
        decisions=text("d.yaml"),
        settings=draw(SETTINGS),
        **{name: choice(name) for name in ("method", "attitude", "initial", "centers", "model")},
    )


@settings(max_examples=150, deadline=None)
@given(models())
def test_any_model_survives_notebooks_queue_and_yaml(how):
    parameters = json.loads(json.dumps(notebook_parameters(how)))
    assert picture_job({"image": "a.fit", **parameters}).plain == how
    assert workbench_job(parameters).plain == how
    assert Processing.checked(yaml.safe_load(yaml.safe_dump(how.said()))) == how
    source = LabParameters(("/a.fit",), how).source()
    values = {}
    exec(source, values)
    assert workbench_job(values).plain == how


@settings(max_examples=50, deadline=None)
@given(how=models())
def test_any_model_survives_the_queue_file(how, tmp_path_factory):
    folder = tmp_path_factory.getbasetemp()
    write_queue(folder, AnalystQueue((), how))
    assert read_queue(folder).how == how


@settings(max_examples=50, deadline=None)
@given(st.lists(NAMES, unique=True, max_size=4), st.data())
def test_targets_and_methods_as_text(names, data):
    methods = {name: data.draw(METHODS | st.none()) for name in names}
    text = ", ".join(f"{n}:{m}" if m else n for n, m in methods.items()) or "none"
    how = Processing(mission="m", targets=text)
    assert how.targets == tuple(names)
    assert how.methods == {name: method for name, method in methods.items() if method}
    assert Processing(mission="m", targets=targets_text(how.targets)).targets == how.targets


def test_older_queues_are_read_and_new_ones_are_the_same_where_nothing_new_is_said():
    older = {
        "images": [{"image": "/a.fit", "folder": "a", "status": "partial", "reasons": ["no stars"]}],
        "mission": "new_horizons", "kernels": "", "catalog": "bundled", "targets": ["PLUTO"], "schema": 1,
    }  # fmt: skip
    Path("queue.json").write_text(json.dumps(older))
    queue = read_queue(".")
    assert queue.how == Processing(mission="new_horizons", targets=("PLUTO",))
    assert json.dumps(queue.to_dict(), default=list) == json.dumps(older)
    Path("queue.json").write_text(json.dumps(older | {"targets": []}))
    assert read_queue(".").how.targets is None


# -- what is wrong is one line with its remedy ---------------------------------------------------------------------

WRONG = (
    (("--targets", "PLUTO:eye"), "targets: PLUTO: unknown method 'eye'; choose one of auto, "),
    (("--targets", ":ellipse"), "targets: ':ellipse' names no target; write NAME or NAME:METHOD"),
    (("--targets", "A:ellipse,A:auto"), "targets: A is given two methods, ellipse and auto; keep one"),
    (("--method", "guess"), "method: unknown method 'guess'; choose one of auto, "),
    (("--model", "eulr"), "model: unknown pointing model 'eulr'; choose one of euler, image_plane"),
    (("--attitude", "sky"), "attitude: unknown attitude source 'sky'; choose one of auto, kernels, header"),
    (("--centers", "eye"), "centers: unknown method of star centers 'eye'; choose one of least_squares"),
    (("--settings", "reach=3"), "settings: unknown setting reach; settings are "),
    (("--settings", "max_stars=many"), "settings: max_stars is 'many'; give a number"),
)


@pytest.mark.parametrize("command", ["process a.fit", "nightly a.fit", "lab a.fit", "ort solve ort"])
@pytest.mark.parametrize(("words", "said"), WRONG)
def test_a_wrong_option_is_one_line_and_exit_status_2(command, words, said, monkeypatch, capsys):
    mission = () if command.startswith("ort") else ("-m", "new_horizons")
    monkeypatch.setattr("sys.argv", ["opnav", *command.split(), *mission, *words])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 2
    assert capsys.readouterr().err.startswith(f"error: options: {said}")


def test_wrong_values_in_files_and_notebooks_name_their_field():
    Path("night.yaml").write_text("images: [a.fit]\nmission: new_horizons\ntargets: [PLUTO:eye]\n")
    with pytest.raises(SessionError, match=r"night\.yaml: line 3: targets.*: PLUTO: unknown method 'eye'"):
        load_night("night.yaml")
    Path("night.yaml").write_text(
        "images: [a.fit]\nmission: new_horizons\ntargets: [PLUTO:ellipse]\nmethods: {PLUTO: auto}\n"
    )
    with pytest.raises(SessionError, match="PLUTO is given two methods, ellipse and auto"):
        load_night("night.yaml")
    with pytest.raises(SessionError, match=r"notebook parameters: methods: A: unknown method 'eye'"):
        picture_job({"image": "a.fit", "mission": "new_horizons", "methods": {"A": "eye"}})
    with pytest.raises(SessionError, match=r"decision: unknown field, did you mean decisions"):
        workbench_job({"decision": "d.yaml"})


# -- notebooks -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("job_of", [picture_job, workbench_job])
def test_a_cell_may_be_run_again(job_of):
    """Later cells have left their own names by then: a session, a dictionary, a list."""
    namespace = {"image": "a.fit", "mission": "new_horizons", "job_of": job_of, "Path": Path}
    if job_of is workbench_job:
        namespace["images"] = [namespace.pop("image")]
    namespace["job"] = first = job_of(namespace)
    namespace |= {"result": {"status": "ok"}, "note": "seen", "stack": object(), "Processing": Processing}
    namespace["model"] = "image_plane"
    assert job_of(namespace) == first.changed(model="image_plane")


def test_what_a_startup_file_left_is_no_parameter():
    """IPython's start-up files run before the first cell, and what they make stands in no cell."""
    cells = [
        "",
        "image = 'a.fit'\nmission = 'new_horizons'",
        "%ls",
        "import math as m\nmodel: str = 'image_plane'",
    ]
    namespace = {
        "In": cells,
        "Out": {},
        "np": {"some": "thing"},
        "seed": 7,
        "image": "a.fit",
        "mission": "new_horizons",
    }
    namespace |= {"model": "image_plane", "catalog": object()}
    assert picture_job(namespace).plain == Processing(mission="new_horizons", model="image_plane")
    with pytest.raises(SessionError, match="katalog"):
        picture_job(namespace | {"In": [*cells, "katalog = 'bundled'"], "katalog": "bundled"})


def test_the_command_in_the_notebooks_heading_gives_still_pictures():
    cells = json.loads((notebooks_dir() / "process_image.ipynb").read_text())["cells"]
    (command,) = re.findall(r"```\n(papermill .*)\n```", "".join(cells[0]["source"]))
    words = shlex.split(command)
    assert Path(words[1]).name == "process_image.ipynb"
    parameters = {
        name: value
        for flag, name, value in zip(words[3::3], words[4::3], words[5::3], strict=True)
        if flag == "-p"
    }
    notebook = cells_of(
        notebooks_dir() / "process_image.ipynb"
    )  # what the command leaves as it is counts, too
    assert not picture_job(notebook | parameters).interactive


def test_lab_writes_no_more_than_is_said(tmp_path):
    put_notebook(tmp_path / "lab", LabParameters(("/a.fit",), Processing(mission="new_horizons")))
    cells = json.loads((tmp_path / "lab" / "workbench.ipynb").read_text())["cells"]
    (source,) = ["".join(c["source"]) for c in cells if c["metadata"].get("tags") == ["injected-parameters"]]
    assert [line.split(" = ")[0] for line in source.splitlines() if " = " in line] == [
        "images", "mission", "kernels", "catalog", "out",
    ]  # fmt: skip


def test_notebooks_have_a_parameter_for_every_field():
    from opnav_workbench.resources import notebooks_dir
    from opnav_workbench.workbench.parameters import NotebookParameters

    for name, model in (("process_image", PictureJob), ("workbench", NotebookParameters)):
        values = cells_of(notebooks_dir() / f"{name}.ipynb")
        assert set(model.model_fields) == {n for n in values if not n.startswith("_")}


# -- nights that are done ------------------------------------------------------------------------------------------

NIGHT = """
images: [a.fit]
mission: new_horizons
kernels: new_horizons/pluto_opnav
targets: [PLUTO, CHARON]
methods: {PLUTO: limb_scan}
decisions: d.yaml
attitude: header
model: image_plane
centers: psf_fit
time_limit_s: 100
"""
# A snapshot: what is done stays done as long as the way to say what it was done with does.
FINGERPRINT = "946c4fa4d3efb9851c98df18a7cb01604e69574c235b2344b6301d258cdf1e8c"


def test_the_fingerprint_is_made_as_before():
    """Contents of catalogs, kernels and mission files count since version 0.2; before, a new one was not noticed."""
    parts = (
        KernelPart("a.tls", "1f"),
        KernelPart("a.bsp", "2e", 0.0, 10.0),
        KernelPart("b.bsp", "3d", 1e6, 2e6),
    )
    inputs = NightInputs({"version": "0.2", "model": '"euler"'}, parts)
    assert inputs.fingerprint("4c", 5.0) == FINGERPRINT
    renamed = NightInputs(inputs.common, (*(replace(part, name="c") for part in parts[:2]),))
    assert renamed.fingerprint("4c", 5.0) == FINGERPRINT


def fingerprint(spec):
    (picture,) = plan_night(spec, "out").pictures
    return picture.fingerprint


def test_what_a_night_did_stays_done(tmp_path, monkeypatch):
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    Path("a.fit").write_text("a picture")
    Path("d.yaml").write_text("images: {}\n")
    Path("night.yaml").write_text(NIGHT)
    spec, plain = load_night("night.yaml"), NightSpec(images=("a.fit",), mission="new_horizons")
    ours, plains = fingerprint(spec), fingerprint(plain)
    # The same said in another way is the same, wherever it stands; what is new is not.
    again = NightSpec.checked({**dict(spec), "targets": "PLUTO:limb_scan,CHARON", "methods": {}})
    assert fingerprint(again) == ours
    Path("d.yaml").rename("e.yaml")
    assert fingerprint(again.changed(decisions="e.yaml")) == ours
    for changed in ({"method": "ellipse"}, {"settings": {"max_stars": 9}}, {"catalog": "bundled+bundled"}):
        assert fingerprint(plain.changed(**changed)) != plains

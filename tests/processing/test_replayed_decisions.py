"""An analyst's session, written as decisions and carried out headless: the same result, bit for bit."""

import json
from dataclasses import replace
from datetime import datetime

import pytest
import yaml

from opnav_workbench.errors import SessionError
from opnav_workbench.kernels import KernelSet
from opnav_workbench.processing import Processing, open_picture, process_image, run_policy
from opnav_workbench.rehearsal import DEMO_KERNELS
from opnav_workbench.session import ImageSession, Settings
from opnav_workbench.session.decisions import Decisions, load_decisions, write_decisions

HOW = Processing(mission="new_horizons", targets=())
POLICY = HOW.opened()


@pytest.fixture(scope="module")
def picture(demo_truths):
    return demo_truths[1].picture


@pytest.fixture(scope="module")
def analysed(picture) -> ImageSession:
    """A session as an analyst leaves it: detours, second thoughts and all."""
    with KernelSet(DEMO_KERNELS):
        session = ImageSession.open(picture, "new_horizons", settings=Settings(min_snr=6.0, max_stars=250))
        session.predict()
        session.add_target("PLUTO")
        session.nudge(3.0, -2.0)
        session.nudge(1.0, 1.0, 0.01)
        session.undo()
        session.find_stars(initial="cross_correlation")
        used = [str(star) for star in session.state.a_priori.id[session.state.mask("used")]]
        session.reject_stars(used[:3], "smeared")
        session.accept_stars([used[1]], "fine after all")
        session.repoint()
        session.reject_stars([used[4]], "blended")
        session.undo()
        session.find_stars()
        session.place_star(used[5], session.state.centers.pixel_line[_row(session, used[5])].round())
        session.refit_stars([used[6]], final="matched_filter", search_radius_px=3.0)
        session.repoint(model="image_plane")
        session.set_circle("PLUTO", (2500.0, 64.0), 4.0)
        session.clear_circle("PLUTO")
        session.set_circle("CHARON", (2510.0, 60.0), 2.5)
        session.choose_scans("PLUTO", [3, 1, 2], "even")
        session.find_body("PLUTO", "least_squares")
        session.find_body("CHARON", search_radius_px=6.0)
        session.undo()
        session.redo()
        session.find_bodies(["PLUTO", "CHARON"])
        session.skip_target("NIX", "too faint to be seen")
        session.observables()
        session.note("a clean picture: no stray light")
        return session


def _row(session, star):
    return session.state.a_priori.id.tolist().index(star)


def _bytes(folder):
    return (folder / "result.json").read_bytes()


@pytest.mark.slow
def test_the_analysts_session_comes_out_bit_identical_headless(analysed, picture, tmp_path):
    file = write_decisions(tmp_path / "decisions.yaml", Decisions.from_session(analysed, who="M. Jones"))
    decided = replace(POLICY, decisions=load_decisions(file))
    words = []
    with KernelSet(DEMO_KERNELS):
        analysed.save(tmp_path / "interactive")
        outcome = process_image(picture, decided, tmp_path / "headless", words.append)
    assert outcome.error == ""
    assert _bytes(outcome.folder) == _bytes(tmp_path / "interactive")
    table = "observables.ecsv"
    assert (outcome.folder / table).read_bytes() == (tmp_path / "interactive" / table).read_bytes()
    assert words == ["reading", "repeating the analyst's session", "writing"]
    again = ImageSession.resume(outcome.folder)
    assert [e.step for e in again.standing] == [e.step for e in analysed.standing]


def test_the_file_says_what_was_decided_why_by_whom_and_when(analysed, tmp_path):
    analysed.write_decisions(tmp_path / "d.yaml", who="M. Jones")
    data = yaml.safe_load((tmp_path / "d.yaml").read_text())
    ((key, entry),) = data["images"].items()
    assert key == analysed.context.picture.sha256
    assert (entry["name"], entry["who"]) == ("mvic_framing.fit", "M. Jones")
    assert datetime.fromisoformat(entry["when"]).tzinfo is not None
    assert entry["settings"] == {"min_snr": 6.0, "max_stars": 250}
    assert [item["reason"] for item in entry["reject"]] == ["smeared"] * 3
    assert entry["accept"][0]["reason"] == "fine after all"
    assert entry["circles"][-1] == {"body": "CHARON", "pixel": 2510.0, "line": 60.0, "radius_px": 2.5} | {
        "at": entry["circles"][-1]["at"]
    }
    assert entry["scans"][0]["numbers"] == [1, 2, 3]
    assert entry["methods"][0]["method"] == "least_squares"
    assert entry["notes"][0]["text"] == "a clean picture: no stray light"
    assert len(entry["nudge"]) == 1  # the second was taken back
    assert "row" not in json.dumps(entry)  # stars by name, never by number
    assert max(item["at"] for items in entry.values() if isinstance(items, list) for item in items) == len(
        analysed.standing
    )


def test_decisions_survive_their_file(analysed, tmp_path):
    decisions = Decisions.from_session(analysed)
    assert load_decisions(write_decisions(tmp_path / "d.yaml", decisions)) == decisions


def test_several_pictures_share_a_file(analysed, demo_truths, tmp_path):
    other = ImageSession.open(demo_truths[0].picture, "new_horizons")
    other.predict()
    other.note("the other one")
    path = analysed.write_decisions(tmp_path / "d.yaml")
    other.write_decisions(path)
    other.note("second thoughts")
    other.write_decisions(path)
    images = load_decisions(path).images
    assert set(images) == {analysed.context.picture.sha256, other.context.picture.sha256}
    assert [n.text for n in images[other.context.picture.sha256].notes] == [
        "the other one",
        "second thoughts",
    ]


@pytest.mark.slow
def test_what_a_person_adds_to_a_recorded_session_is_carried_out_too(analysed, picture, tmp_path):
    """A rejection without a place in the order is made when the stars are first found."""
    path = analysed.write_decisions(tmp_path / "d.yaml")
    data = yaml.safe_load(path.read_text())
    entry = next(iter(data["images"].values()))
    star = str(analysed.state.a_priori.id[analysed.state.mask("used")][-1])
    entry["reject"].append({"star": star, "reason": "added by hand"})
    path.write_text(yaml.safe_dump(data))
    with KernelSet(DEMO_KERNELS):
        outcome = process_image(picture, replace(POLICY, decisions=load_decisions(path)), tmp_path)
    row = next(s for s in outcome.result["stars"] if s["id"] == star)
    assert row["reason"] == "by the analyst: added by hand"
    assert outcome.result["pointing"]["n_stars"] == analysed.state.pointing.n_stars - 1


@pytest.mark.slow
def test_hand_written_decisions_guide_the_automatic_policy(picture, tmp_path):
    with KernelSet(DEMO_KERNELS):
        session = open_picture(picture, POLICY)
        run_policy(session, POLICY)
        star = str(session.state.a_priori.id[session.state.mask("used")][0])
        place = [float(v) for v in session.state.centers.pixel_line[_row(session, star)]]
        text = f"""
images:
  mvic_framing.fit:
    nudge:
    - {{pixel: 2.0, line: -1.0}}
    place:
    - {{star: "{star}", pixel: {place[0]:.1f}, line: {place[1]:.1f}}}
    methods:
    - {{body: PLUTO, method: unresolved, search_radius_px: 8.0}}
    - {{body: CHARON, method: least_squares}}
    notes:
    - {{text: by hand}}
"""
        (tmp_path / "d.yaml").write_text(text)
        decided = replace(POLICY, decisions=load_decisions(tmp_path / "d.yaml"))
        result = process_image(picture, decided, tmp_path / "run").result
    assert result["identification"]["search"] == "by hand"
    assert {body["name"]: body["method"] for body in result["bodies"]} == {
        "PLUTO": "unresolved",
        "CHARON": "least_squares",
    }
    assert result["provenance"]["placed_stars"][0]["star"] == star
    assert result["provenance"]["notes"] == ["by hand"]
    assert result["pointing"]["n_stars"] == 15


@pytest.mark.slow
def test_a_session_opened_otherwise_is_told_in_one_line(analysed, picture, tmp_path):
    decisions = Decisions.from_session(analysed)
    outcome = process_image(picture, replace(POLICY, decisions=decisions), tmp_path)  # without the kernels
    assert outcome.failed
    assert "a priori attitude of the kernels, this run has that of the header" in outcome.error
    assert "\n" not in outcome.error


# -- files with mistakes -------------------------------------------------------------------------------------------

SHA = "a" * 64


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (
            "reject:\n    - {star: HIP 1}\n    - {stra: HIP 2}",
            r"line 5: images\.\w+\.reject\.1\.star: this field is",
        ),
        (
            "circles:\n    - {body: PLUTO, pixel: 1.0}",
            r"line 4: images\.\w+\.circles\.0: give pixel, line and radius_px",
        ),
        (
            "circles:\n    - {body: P, pixel: 1, line: 2, radius_px: -3}",
            r"line 4: images\.\w+\.circles\.0\.radius_px",
        ),
        ("scans:\n    - {body: PLUTO, numbers: [1, x]}", r"line 4: images\.\w+\.scans\.0\.numbers\.1"),
        (
            "methods:\n    - {body: PLUTO, method: eye}",
            r"line 4: images\.\w+\.methods\.0\.method: .*limb_scan",
        ),
        ("settings: {min_sn: 5}", r"line 3: images\.\w+\.settings: .*unknown setting min_sn"),
        ("steps:\n    - {at: 1, step: dance}", r"line 4: images\.\w+\.steps\.0\.step: .*find_stars"),
        ("who: [a]", r"line 3: images\.\w+\.who"),
        (
            "notes:\n    - {text: a, at: 2}\n    steps:\n    - {at: 2, step: predict}",
            r"at: 2 stands in notes and in steps",
        ),
        ("place:\n    - {star: HIP 1, pixel: .nan, line: 1}", r"line 4: images\.\w+\.place\.0\.pixel"),
    ],
)
def test_a_mistake_is_told_with_line_and_field(tmp_path, lines, said):
    path = tmp_path / "d.yaml"
    path.write_text(f"images:\n  {SHA}:\n    {lines}\n")
    with pytest.raises(SessionError, match=said) as caught:
        load_decisions(path)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_a_star_that_is_not_there_is_told_with_its_line(picture, tmp_path):
    path = tmp_path / "d.yaml"
    path.write_text("images:\n  mvic_framing.fit:\n    reject:\n    - {star: HIP 0, reason: typo}\n")
    outcome = process_image(picture, replace(POLICY, decisions=load_decisions(path)), tmp_path)
    assert outcome.failed
    assert "d.yaml: line 4: images.mvic_framing.fit.reject.0: no star HIP 0" in outcome.error


# -- the policy on an open session ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_policy_keeps_what_was_decided_in_an_open_session(picture):
    with KernelSet(DEMO_KERNELS):
        session = ImageSession.open(picture, "new_horizons")
        session.predict()
        session.find_stars()
        star = str(session.state.a_priori.id[session.state.mask("used")][0])
        session.reject_stars([star], "odd")
        assert run_policy(session, HOW.changed(targets=None).opened())
    assert session.state.decisions[star] == ("rejected", "odd")
    assert session.state.pointing.n_stars == 14
    assert {body.name for body in session.state.bodies} == {"PLUTO", "CHARON"}


@pytest.mark.slow
def test_the_policy_can_be_cancelled_between_steps(picture):
    words = []
    with KernelSet(DEMO_KERNELS):
        session = ImageSession.open(picture, "new_horizons")
        done = run_policy(session, POLICY, words.append, lambda: len(words) == 2)
    assert not done
    assert words == ["predicting", "finding stars"]
    assert [entry.step for entry in session.standing] == ["predict", "find_stars"]


@pytest.mark.slow
def test_methods_for_all_bodies_and_for_one(picture):
    how = HOW.changed(targets="PLUTO,CHARON:least_squares", method="unresolved")
    policy = how.opened()
    with KernelSet(DEMO_KERNELS):
        session = open_picture(picture, policy)
        run_policy(session, policy)
    assert {b.name: b.method for b in session.state.bodies} == {
        "PLUTO": "unresolved",
        "CHARON": "least_squares",
    }
    with pytest.raises(SessionError, match="limb_scan"):
        HOW.changed(method="eye")

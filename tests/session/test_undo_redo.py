"""Undo and redo over everything, and replaying whatever came out of it."""

import json
from collections.abc import Callable

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from opnav_workbench.errors import SessionError
from opnav_workbench.files import json_text
from opnav_workbench.kernels import KernelSet
from opnav_workbench.rehearsal import DEMO_KERNELS
from opnav_workbench.session import Decisions, ImageSession


def _result(session: ImageSession) -> str:
    """The result as text; kernels stand in it only while they are loaded."""
    result = session.result()
    del result["provenance"]["kernels"]
    return json_text(result)


def test_redo_takes_undone_steps_again_to_the_very_same_states(opened):
    states = [opened.state]
    for step in (opened.predict, opened.find_stars, opened.repoint):
        step()
        states.append(opened.state)
    for _ in range(3):
        opened.undo()
    assert (opened.can_undo, opened.can_redo) == (False, True)
    assert [entry.step for entry in opened.undone] == ["predict", "find_stars", "repoint"]
    for step, state in zip(("predict", "find_stars", "repoint"), states[1:], strict=True):
        assert opened.redo().step == step
        assert opened.state is state
    assert (opened.can_undo, opened.can_redo) == (True, False)
    with pytest.raises(SessionError, match="nothing to redo"):
        opened.redo()


def test_a_new_step_clears_what_could_be_redone_but_not_the_journal(opened):
    opened.predict()
    opened.note("first")
    opened.undo()
    opened.note("second")
    assert not opened.can_redo
    assert [entry.step for entry in opened.journal] == ["predict", "note", "undo", "note"]
    assert [entry.step for entry in opened.standing] == ["predict", "note"]
    assert opened.state.user_notes == ("second",)


@pytest.mark.slow
def test_what_was_undone_can_be_redone_after_resuming(opened, tmp_path):
    opened.predict()
    opened.find_stars()
    opened.repoint()
    whole = _result(opened)
    opened.undo()
    opened.undo()
    opened.save(tmp_path)
    resumed = ImageSession.resume(tmp_path)
    assert [entry.step for entry in resumed.undone] == ["find_stars", "repoint"]
    resumed.redo()
    resumed.redo()
    assert _result(resumed) == whole


def test_states_that_were_dropped_to_save_memory_are_made_again(opened, monkeypatch):
    monkeypatch.setattr("opnav_workbench.session.history.KEPT_STATES", 2)
    opened.predict()
    opened.find_stars()
    found = _result(opened)
    opened.repoint()
    for number in range(4):
        opened.note(f"note {number}")
    for _ in range(5):
        opened.undo()
    assert _result(opened) == found


def test_a_journal_that_redoes_too_much_is_damaged(opened, tmp_path):
    opened.predict()
    opened.save(tmp_path)
    path = tmp_path / "session.json"
    data = json.loads(path.read_text())
    data["journal"].append({"step": "redo", "parameters": {"step": "predict"}})
    path.write_text(json.dumps(data))
    with pytest.raises(SessionError, match="redoes more than was done"):
        ImageSession.resume(tmp_path)


# -- any sequence ------------------------------------------------------------------------------------------------


def _star(session: ImageSession, number: int) -> str:
    stars = session.state.a_priori
    return "HIP 0" if stars is None else str(stars.id[number % len(stars)])


Act = Callable[[ImageSession, int], object]
ACTS: dict[str, Act] = {
    "predict": lambda s, _: s.predict(),
    "find_stars": lambda s, n: s.find_stars(final=("least_squares", "matched_filter")[n % 2]),
    "repoint": lambda s, n: s.repoint(("euler", "image_plane")[n % 2]),
    "reject": lambda s, n: s.reject_stars([_star(s, n)], "odd"),
    "accept": lambda s, n: s.accept_stars([_star(s, n)]),
    "nudge": lambda s, n: s.nudge(n % 3 - 1.0, 0.5, 0.01),
    "place": lambda s, n: s.place_star(_star(s, n), (100.0 + n, 80.0)),
    "refit": lambda s, n: s.refit_stars([_star(s, n)], final="matched_filter"),
    "circle": lambda s, n: s.set_circle("PLUTO", (120.0 + n, 100.0), 2.0),
    "scans": lambda s, n: s.choose_scans("PLUTO", None if n % 2 else [n, n + 1]),
    "find_body": lambda s, n: s.find_body(("PLUTO", "CHARON")[n % 2]),
    "target": lambda s, n: s.add_target(("PLUTO", "CHARON")[n % 2]),
    "skip": lambda s, n: s.skip_target("NIX", f"no ephemeris {n}"),
    "observables": lambda s, _: s.observables(),
    "note": lambda s, n: s.note(f"note {n}"),
    "undo": lambda s, _: s.undo(),
    "redo": lambda s, _: s.redo(),
}
sequences = st.lists(
    st.tuples(st.sampled_from([*ACTS, "undo", "redo", "undo", "redo"]), st.integers(0, 20)), max_size=14
)


@pytest.fixture(scope="module")
def untouched(demo_truths) -> ImageSession:
    """The LORRI demo picture, opened once: sessions of its own are made of what it read."""
    with KernelSet(DEMO_KERNELS):
        return ImageSession.open(demo_truths[0].picture, "new_horizons")


@pytest.mark.slow
@settings(
    max_examples=12,
    deadline=None,
    derandomize=True,
    phases=[Phase.generate],
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(sequence=sequences)
def test_any_sequence_of_steps_replays_to_the_same_result(untouched, tmp_path_factory, sequence):
    """Undo gives back the state before, redo the one after; autosave and decisions lead to the same bits again."""
    folder = tmp_path_factory.mktemp("any")
    with KernelSet(DEMO_KERNELS):
        session = ImageSession(untouched.context, untouched.source, untouched.inputs)
        session.autosave(folder)
        # Every state on the way to the present one, and those that redo leads to
        line, at = [session.state], 0
        for name, number in [("predict", 0), ("find_stars", 0), *sequence]:
            present = session.state
            try:
                ACTS[name](session, number)
            except SessionError:
                assert session.state is present  # a step that cannot be taken changes nothing
                continue
            if name in ("undo", "redo"):
                at += 1 if name == "redo" else -1
            elif session.state is not present:
                line, at = [*line[: at + 1], session.state], at + 1
            assert session.state is line[at]
            assert (session.can_undo, session.can_redo) == (at > 0, at + 1 < len(line))
        decided = ImageSession(untouched.context, untouched.source, untouched.inputs)
        Decisions.from_session(session).apply(decided)
        assert _result(decided) == _result(session)
    resumed = ImageSession.resume(folder)
    assert resumed.journal == session.journal
    assert resumed.standing == session.standing
    assert resumed.undone == session.undone
    assert _result(resumed) == _result(session)
    assert resumed.resume_note == ""

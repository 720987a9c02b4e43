"""What the workbench may be given: a session, several, a list of images, a campaign."""

import json

import pytest
from astropy.io import fits

from opnav_workbench.campaign import Campaign
from opnav_workbench.constants import DAY_S
from opnav_workbench.errors import SelectionPending, SessionError
from opnav_workbench.session import ImageSession
from opnav_workbench.workbench import image_queue
from opnav_workbench.workbench.app import queue_of
from opnav_workbench.workbench.image_queue import ImageQueue


@pytest.fixture
def session(kernels, demo_truths):
    opened = ImageSession.open(demo_truths[0].picture, "new_horizons")
    opened.predict()
    opened.find_stars()
    return opened


def test_sessions_and_lists(session):
    assert queue_of(session).session is session
    assert queue_of([session]).session is session
    queue = ImageQueue.of_sessions([session])
    assert queue_of(queue) is queue


def test_a_session_keeps_its_folder_when_another_picture_of_its_name_comes(tmp_path):
    for place in ("a", "b"):
        (tmp_path / place).mkdir()
        (tmp_path / place / "x.fit").write_text(place)
    out = tmp_path / "out"
    (out / "x").mkdir(parents=True)
    held = {"schema": 1, "image": str(tmp_path / "a" / "x.fit"), "sha256": "", "journal": []}
    (out / "x" / "session.json").write_text(json.dumps(held))
    queue = ImageQueue.of_images([tmp_path / "a" / "x.fit", tmp_path / "b" / "x.fit"], "new_horizons", out)
    assert [item.folder.name for item in queue.items] == ["x", "b_x"]


def test_gate_names_the_image(session):
    with pytest.raises(SelectionPending, match=r"^lorri_4x4\.fit: 4 stars wait to be accepted or rejected"):
        queue_of(session).require("stars_confirmed")
    session.accept_stars([box.id for box in session.star_boxes()])
    queue_of(session).require("stars_confirmed")


def test_campaign_offers_what_needs_an_analyst(session, tmp_path):
    session.save(tmp_path / "lorri_4x4")  # no pointing: it needs one
    with Campaign(tmp_path / "campaign", create=True) as campaign:
        with pytest.raises(SessionError, match="no image of this campaign can be resumed"):
            queue_of(campaign)
        campaign.ingest(tmp_path / "lorri_4x4")
        queue = queue_of(campaign)
    assert [item.name for item in queue.items] == ["lorri_4x4"]
    assert queue.session.state.mask("used").sum() == 4
    assert queue.session.folder == (tmp_path / "lorri_4x4").resolve()


@pytest.fixture
def four(kernels, demo_truths, tmp_path):
    """The same picture four times under four names, with room for one of them in memory beside those near."""
    paths = [tmp_path / f"{name}.fit" for name in "abcd"]
    for path in paths:
        path.write_bytes(demo_truths[0].picture.read_bytes())
    return ImageQueue.of_images(paths, "new_horizons", tmp_path / "out")


def test_far_images_are_closed_and_resume_as_they_were(four, monkeypatch):
    monkeypatch.setattr(image_queue, "KEPT_PIXELS", 256 * 256)
    first = four.session
    first.find_stars()
    star = first.state.a_priori.id[0]
    first.reject_stars([star], "test")
    journal = [entry.to_dict() for entry in first.journal]
    four.go(1)
    assert four.session is not first
    assert four.close_far() == []  # a neighbor stays
    four.go(3)
    _ = four.session
    assert [item.name for item in four.close_far()] == ["a.fit", "b.fit"]
    assert [item.status for item in four.items] == ["stars", "open", "new", "open"]
    assert all(item.thumbnail.startswith(b"\x89PNG") for item in (four.items[0], four.items[3]))
    four.go(0)
    again = four.session
    assert again is not first
    assert [entry.to_dict() for entry in again.journal] == journal
    assert again.state.decisions[star] == ("rejected", "test")
    assert again.can_undo


def test_a_contradicted_header_stands_in_its_row_opened_and_closed(four, tmp_path, monkeypatch, hands_on):
    path = tmp_path / "a.fit"
    fits.setval(path, "SPCSCET", value=fits.getval(path, "SPCSCET") - DAY_S)
    assert four.items[0].status_words == "not opened"
    (doubt,) = four.session.state.contradictions
    monkeypatch.setattr(image_queue, "KEPT_PIXELS", 1)
    for closed in (False, True):
        assert (four.items[0].session is None) == closed
        assert (four.items[0].status_words, four.items[0].doubts) == ("opened, header contradicted", (doubt,))
        four.go(3)
        four.words = "contradicted"
        assert four.listed() == [0, 3]  # with the one at hand
        four.words = ""
        _ = four.session
        four.close_far()
    row = hands_on(path, tmp_path / "b.fit").controller.regions()["queue"]
    assert row.count("header contradicted") == 2  # its words and its title, and none of the good one
    assert "SPCSCET and SPCUTCAL differ by -86400.000 s" in row


def test_what_is_not_on_disk_is_never_closed(four, monkeypatch, session, tmp_path):
    monkeypatch.setattr(image_queue, "KEPT_PIXELS", 0)
    first = four.session
    (first.folder / "journal.jsonl").unlink()
    (first.folder / "journal.jsonl").mkdir()  # it cannot be written any more
    with pytest.raises(SessionError):
        first.note("kept in memory")
    four.go(3)
    assert four.close_far() == []
    assert four.items[0].session is first
    given = ImageQueue.of_sessions([session, session], tmp_path / "own")
    list(given.sessions())
    assert all(item.session is session for item in given.items)  # whoever gave it holds it


def test_list_is_chosen_by_words_and_status_and_ordered(four):
    four.session.find_stars()
    four.items[2].error = "broken"
    assert four.listed() == [0, 1, 2, 3]
    four.words = "not opened"
    assert four.listed() == [0, 1, 3]  # the one at hand stays in sight
    assert four.step(+1) == 1
    assert four.neighbors() == [1]
    four.words, four.shown_kind = "", "failed"
    assert four.listed() == [0, 2]
    assert four.step(+1) == 2
    four.shown_kind, four.order = "all", "by status"
    assert four.listed() == [1, 3, 0, 2]
    assert (four.step(+1), four.step(-1), four.neighbors()) == (2, 3, [2, 3])

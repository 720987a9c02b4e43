"""What the workbench may be given: a session, several, a list of images, a campaign."""

import json

import pytest

from opnav_workbench.campaign import Campaign
from opnav_workbench.errors import SelectionPending, SessionError
from opnav_workbench.session import ImageSession
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

"""A night whose short exposures have no star: they take the pointing of the long ones, whichever comes first."""

import json
import sys
from pathlib import Path

import pytest

from opnav_workbench.campaign import Campaign
from opnav_workbench.headless.night import Night, plan_night, run_night
from opnav_workbench.headless.night_spec import NightSpec
from opnav_workbench.headless.night_workers import LocalPool
from opnav_workbench.session import ImageSession

sys.path.insert(0, str(Path(__file__).parents[1] / "processing"))
from pair_pictures import KERNELS, SETTINGS, pair_pictures

pytestmark = pytest.mark.slow

TIMES = {"long": ("2015-07-12T08:46:47", 0.1), "short": ("2015-07-12T08:46:57", 0.001)}


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """One with stars, and ten seconds later one without."""
    return pair_pictures(tmp_path_factory.mktemp("pair"), TIMES, seed=8, shift_px=(-5.2, 6.3))


def night_of(pictures, names, out, settings=SETTINGS):
    spec = NightSpec(
        images=tuple(str(pictures[name].picture) for name in names),
        mission="new_horizons",
        kernels=KERNELS,
        targets="PLUTO",
        settings=settings,
    )
    made = Night(plan_night(spec, out))
    run_night(made, LocalPool(1))
    return made


def result(out, name):
    return json.loads((out / name / "result.json").read_text())


def test_a_picture_without_stars_waits_for_its_neighbor_from_night_to_night(pictures, tmp_path):
    out = tmp_path / "out"
    assert night_of(pictures, ["short"], out).notes == []
    assert result(out, "short")["status"] != "ok"
    late = night_of(pictures, ["short", "long"], out)
    assert [picture.state for picture in late.plan.pictures] == ["new", "done"]  # by path: long, short
    assert late.notes == []
    short = result(out, "short")
    assert (short["status"], short["pointing"]["model"], short["pointing"]["n_stars"]) == ("ok", "carried", 0)
    (pluto,) = short["bodies"]
    true = pictures["short"].bodies["PLUTO"]
    assert max(abs(pluto["observed"] - true)) < 0.2
    with Campaign(late.archive) as archive:
        statuses = {str(row["image"]): str(row["status"]) for row in archive.images()}
    assert statuses == {"long.fit": "ok", "short.fit": "ok"}
    # What a night made by carrying is its own: it is done, neither an analyst's nor to be done again.
    again = night_of(pictures, ["short", "long"], out)
    assert {picture.state for picture in again.plan.pictures} == {"done"}
    assert result(out, "short") == short
    assert not list((out / ".attic").rglob("*"))  # what a night wrote is nobody's to keep


def test_an_analysts_picture_gives_and_takes_none(pictures, tmp_path):
    out = tmp_path / "out"
    night_of(pictures, ["long", "short"], out, settings="lost_detections=0")
    session = ImageSession.resume(out / "short")
    session.predict()
    session.save(out / "short")
    before = result(out, "short")
    night_of(pictures, ["long", "short"], out)
    assert result(out, "short") == before
    assert before["status"] != "ok"

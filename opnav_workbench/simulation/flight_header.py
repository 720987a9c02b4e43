"""Headers as the mission writes them: cards from a template, then whatever the mission's keyword map asks for.

A template is a YAML file ``headers/*.yaml`` beside the mission file. It lists groups of cards ``[keyword, value,
comment]``; a value ``=name`` is a quantity of `opnav_workbench.simulation.flight_quantities`, and a group with `when`
is written only into pictures whose header (or processing `level`) has those values.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from pydantic import Field

from opnav_workbench.errors import MissionError
from opnav_workbench.geometry import quaternion_from_matrix
from opnav_workbench.image import KeywordMap
from opnav_workbench.simulation.detector_values import DetectorValues, Level
from opnav_workbench.simulation.flight_quantities import (
    FlightRecord,
    mid_exposure_sclk,
    quantities,
    sun_state,
    utc_text,
)
from opnav_workbench.spice.scenario_parts import Strict
from opnav_workbench.yaml_file import read_model

__all__ = ["Card", "flight_cards"]

FOLDER = "headers"
QUANTITY = "="  # a value that begins so is a quantity's name
UNKNOWN_GEOMETRY = "PREDICT"

Value = str | bool | int | float


@dataclass(frozen=True, slots=True)
class Card:
    """One header card."""

    keyword: str
    value: Value
    comment: str = ""


class _Group(Strict):
    when: dict[str, Value] = Field(default_factory=dict)
    cards: tuple[tuple[str, Value, str], ...]


class _Template(Strict):
    groups: tuple[_Group, ...]


def flight_cards(record: FlightRecord, values: DetectorValues, level: Level) -> tuple[Card, ...]:
    """Return the cards of a picture, in order, each keyword once.

    Parameters
    ----------
    record : FlightRecord
    values : DetectorValues
        Gain, read noise and bias of the exposure.
    level : {"raw", "calibrated"}

    Raises
    ------
    MissionError
        A template that breaks the schema or names an unknown quantity.
    """
    cards: dict[str, Card] = {}
    for card in (*_from_template(record, values, level), *_from_keywords(record)):
        cards.setdefault(card.keyword, card)
    for keyword, value in record.identity.items():
        known = cards.get(keyword)
        cards[keyword] = Card(keyword, value, "" if known is None else known.comment)
    cards["SIMULATE"] = Card("SIMULATE", value=True, comment="Simulated picture")
    return tuple(cards.values())


def _from_template(record: FlightRecord, values: DetectorValues, level: Level) -> Iterator[Card]:
    templates = sorted((record.mission.path.parent / FOLDER).glob("*.yaml"))
    if not templates:
        return
    known = quantities(record, values, level)
    missing = KeywordMap(**record.mission.keywords).missing_values[0]
    told = {"level": level, **record.identity}
    for path in templates:
        template = _template(path, path.stat().st_mtime_ns)
        for group in template.groups:
            if all(_same(told.get(keyword), value) for keyword, value in group.when.items()):
                yield from (_card(card, known, missing, path.name) for card in group.cards)


@lru_cache(maxsize=16)
def _template(path: Path, _changed_ns: int) -> _Template:
    """Read a template once for all pictures, again when the file has changed."""
    return read_model(path, _Template, "header template", MissionError)


def _card(card: tuple[str, Value, str], known: Mapping[str, Any], missing: float, file: str) -> Card:
    keyword, value, comment = card
    if not (isinstance(value, str) and value.startswith(QUANTITY)):
        return Card(keyword, value, comment)
    name = value.removeprefix(QUANTITY)
    if name not in known:
        raise MissionError(
            f"header template {file}: {keyword}: unknown quantity {name!r}; known are {sorted(known)}."
        )
    found = known[name]
    return Card(keyword, missing if found is None else found, comment)


def _same(found: Any, wanted: Value) -> bool:
    return str(found).strip().casefold() == str(wanted).strip().casefold()


def _from_keywords(record: FlightRecord) -> Iterator[Card]:
    """Yield time, exposure, pointing and trajectory under the mission's own keywords."""
    names = KeywordMap(**record.mission.keywords)
    stamp = record.et - (0.5 * record.exposure_s if names.time_reference == "start" else 0.0)
    single = (
        (names.exposure_s, record.exposure_s / names.exposure_scale),
        (names.et, stamp),
        (names.utc, utc_text(stamp)),
        (names.sclk, mid_exposure_sclk(record)),
        (names.target, record.target),
        (names.geometry_quality, UNKNOWN_GEOMETRY),
        (names.bits, record.camera.bits),
        ("RADESYS", "ICRS"),
    )
    yield from (
        Card(keyword, value) for keyword, value in single if keyword is not None and value is not None
    )
    attitude, sun = record.camera_from_j2000, sun_state(record)
    turned = attitude.T if names.quaternion_sense == "camera_to_j2000" else attitude
    for keywords, vector in (
        (names.quaternion, quaternion_from_matrix(turned)),
        (names.sun_position, None if sun is None else sun.position_km),
        (names.sun_velocity, None if sun is None else sun.velocity_km_s),
    ):
        if keywords is not None and vector is not None:
            yield from (Card(k, v) for k, v in zip(keywords, vector.tolist(), strict=True))

"""The briefing of a rehearsal: what the team is told, as Markdown and as one HTML page that opens anywhere, offline.

Both come from the same few sections, and these from what ``ort.yaml`` tells and from the predicted kernels alone.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from html import escape
from pathlib import Path

import numpy as np

from opnav_workbench.camera import Camera
from opnav_workbench.files import write_text
from opnav_workbench.kernels import et_from_utc
from opnav_workbench.mission import Mission
from opnav_workbench.rehearsal.package import (
    BRIEFING_FILE,
    BRIEFING_PAGE_FILE,
    BPlaneContent,
    OrtContent,
    PictureContent,
)
from opnav_workbench.scene.states import body_target

__all__ = ["BriefingSection", "as_html", "as_markdown", "write_briefing"]


# ---- Sections of a briefing as Markdown and as one HTML file that opens anywhere, offline.

STYLE = """\
:root { color-scheme: light dark; --ink: #1b2330; --soft: #5a6577; --line: #d5dbe4; --paper: #ffffff; --box: #f3f5f8; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e6eaf0; --soft: #9aa7ba; --line: #39434f; --paper: #14191f; --box: #1e252d; }
}
body { margin: 0; background: var(--paper); color: var(--ink); font: 16px/1.5 system-ui, sans-serif; }
main { max-width: 62rem; margin: 0 auto; padding: 2rem 1.25rem 4rem; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.15rem; margin: 2.2rem 0 .5rem; border-bottom: 1px solid var(--line); padding-bottom: .25rem; }
p.lead { color: var(--soft); margin: 0; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: left; vertical-align: top; padding: .35rem .9rem .35rem 0; border-bottom: 1px solid var(--line); }
th { color: var(--soft); font-weight: 600; }
pre { background: var(--box); padding: .7rem .9rem; overflow-x: auto; border-radius: .35rem; }
@media print { main { padding: 0; max-width: none; } pre { white-space: pre-wrap; } }
"""


@dataclass(frozen=True, slots=True)
class BriefingSection:
    """A part of the briefing: a heading with paragraphs, items, a table or commands.

    Attributes
    ----------
    head
        Of the table's columns.
    rows : tuple of tuples of str
    """

    heading: str
    paragraphs: tuple[str, ...] = ()
    items: tuple[str, ...] = ()
    head: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    commands: tuple[str, ...] = ()


def as_markdown(title: str, lead: str, parts: Sequence[BriefingSection]) -> str:
    """Return the briefing as Markdown.

    Examples
    --------
    >>> print(as_markdown("Night 1", "a test", [BriefingSection("Deliver", items=("centers",))]))
    # Night 1
    <BLANKLINE>
    a test
    <BLANKLINE>
    ## Deliver
    <BLANKLINE>
    - centers
    <BLANKLINE>
    """
    blocks = [f"# {title}", lead, *(block for part in parts for block in _markdown_blocks(part))]
    return "\n\n".join(blocks) + "\n"


def _markdown_blocks(part: BriefingSection) -> Iterator[str]:
    yield f"## {part.heading}"
    yield from part.paragraphs
    if part.items:
        yield "\n".join(f"- {item}" for item in part.items)
    if part.rows:
        yield "\n".join(_markdown_row(row) for row in (part.head, ("---",) * len(part.head), *part.rows))
    if part.commands:
        yield "\n".join(f"    {command}" for command in part.commands)


def _markdown_row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def as_html(title: str, lead: str, parts: Sequence[BriefingSection]) -> str:
    """Return the briefing as HTML without a reference to the network."""
    body = "\n".join(block for part in parts for block in _html_blocks(part))
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<main>\n"
        f'<h1>{escape(title)}</h1>\n<p class="lead">{escape(lead)}</p>\n{body}\n</main>\n</body>\n</html>\n'
    )


def _html_blocks(part: BriefingSection) -> Iterator[str]:
    yield f"<h2>{escape(part.heading)}</h2>"
    yield from (f"<p>{escape(paragraph)}</p>" for paragraph in part.paragraphs)
    if part.items:
        yield "<ul>" + "".join(f"<li>{escape(item)}</li>" for item in part.items) + "</ul>"
    if part.rows:
        rows = "\n".join(_html_row(row, "td") for row in part.rows)
        yield f'<div class="wide"><table>\n{_html_row(part.head, "th")}\n{rows}\n</table></div>'
    yield from (f"<pre>{escape(command)}</pre>" for command in part.commands)


def _html_row(cells: Sequence[str], tag: str) -> str:
    return f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in cells)}</tr>"


# ---- The briefing of a rehearsal: what the team is told, as text and as a page, from the same few sections.

NEAR_KM = 1e4  # distances are told in km below
POSSIBLE = (
    "Ephemerides: the target system's or the spacecraft's own may be wrong, and with it B-plane point and time of flight.",
    "Attitudes may be off by far more than the camera's a priori error.",
    "A surface may have an albedo that nobody knows; the mission file holds a uniform one.",
    "The camera's focal length or distortion may have changed since its calibration.",
    "Images may be lost or damaged, and a storm of cosmic rays may have hit the detector.",
)
POSSIBLE_IN_ORBIT = (
    "The spacecraft's place and velocity relative to the body may be wrong.",
    "The body's pole, prime meridian and spin may be wrong, and so may the map: its size, heights and places.",
    "The body may fill a picture so that it shows no star, or be saturated in one that shows stars.",
)
DELIVER_IN_ORBIT = (
    "For each picture: its pointing (of stars, carried, or of landmarks) with covariance, and the stars and landmarks used.",
    "Place and velocity of the spacecraft, pole, prime meridian and spin of the body, size of the map, with covariance.",
    "Where the spacecraft will be at the time of the prediction, with covariance.",
    "A list of pictures that were not used, and why; anything seen that was not predicted.",
)
DELIVER = (
    "For each picture: camera pointing with covariance, the stars used, the centers of all targets with covariance.",
    "An estimate of the parameters above with covariance, and what of it the pictures do not determine.",
    "B.T, B.R and linearised time of flight with covariance, and the time of closest approach.",
    "A list of pictures that were not used, and why; anything seen that was not predicted.",
)


def write_briefing(
    folder: Path, content: OrtContent, mission: Mission, cameras: Mapping[str, Camera]
) -> None:
    """Write ``briefing.md`` and ``briefing.html``; inside the active predicted kernels.

    Raises
    ------
    KernelError
        A target that the kernels do not know.
    SessionError
        The folder cannot be written.
    """
    parts = briefing_sections(content, mission, cameras)
    lead = f"Operational readiness test · mission {mission.name} · {content.name}"
    write_text(folder / BRIEFING_FILE, as_markdown(content.title, lead, parts))
    write_text(folder / BRIEFING_PAGE_FILE, as_html(content.title, lead, parts))


def briefing_sections(
    content: OrtContent, mission: Mission, cameras: Mapping[str, Camera]
) -> tuple[BriefingSection, ...]:
    """Return the parts of the briefing, in order; `cameras` by picture."""
    return (
        BriefingSection("Situation", (content.description,)),
        _orbit_section(content) if content.b_plane is None else _flyby_section(content, content.b_plane),
        _picture_section(content, mission, cameras),
        _parameter_section(content),
        BriefingSection(
            "What may be different from the prediction",
            items=POSSIBLE if content.orbit is None else (*POSSIBLE_IN_ORBIT, *POSSIBLE[1:]),
        ),
        BriefingSection(
            "Deliver",
            (
                f"By {_shown(content.due_utc)} UTC, from the pictures and the predicted kernels of this package alone.",
            ),
            (*(DELIVER if content.orbit is None else DELIVER_IN_ORBIT), *content.deliver),
        ),
        _file_section(content),
    )


def _orbit_section(content: OrtContent) -> BriefingSection:
    orbit = content.orbit
    assert orbit is not None  # a rehearsal is of a flyby or in orbit
    rows = (
        ("Body", f"{orbit.body}, GM {orbit.gm_km3_s2:.5g} km^3/s^2"),
        (
            "Distance from its center",
            f"{orbit.distance_km:,.2f} km at the epoch, {_shown(content.epoch_utc)} UTC",
        ),
        (
            "Pole, prime meridian (1 sigma)",
            f"{orbit.pole_sigma_deg:g} deg, {orbit.meridian_sigma_deg:g} deg at the epoch",
        ),
        ("Spin rate (1 sigma)", f"{orbit.spin_sigma:g} of it"),
        ("Size of the map along each axis (1 sigma)", f"{orbit.map_sigma:g} of it"),
        ("Map", f"{orbit.maplets} (landmarks), {orbit.shape} (shape): opnav landmarks show {orbit.maplets}"),
        ("Prediction asked for", f"place relative to {orbit.body} at {_shown(orbit.predict_utc)} UTC"),
    )
    return BriefingSection("Orbit and body as believed", head=("Quantity", "Value"), rows=rows)


def _flyby_section(content: OrtContent, plane: BPlaneContent) -> BriefingSection:
    rows = (
        ("Body", plane.body),
        ("Closest approach", f"{_shown(plane.closest_utc)} UTC, {plane.closest_km:,.0f} km from its center"),
        ("Speed at infinity", f"{plane.v_infinity_km_s:.3f} km/s"),
        (
            "B.T, B.R",
            f"{plane.b_dot_t_km:,.1f} km, {plane.b_dot_r_km:,.1f} km (T from the pole: {plane.pole})",
        ),
        ("Time of flight from the epoch", f"{plane.time_of_flight_s:,.1f} s, linearised"),
        ("Epoch", f"{_shown(content.epoch_utc)} UTC"),
    )
    return BriefingSection("Flyby as predicted", head=("Quantity", "Value"), rows=rows)


def _picture_section(content: OrtContent, mission: Mission, cameras: Mapping[str, Camera]) -> BriefingSection:
    seen = "Targets: distance, diameter, phase as predicted"
    head = ("Picture", "UTC, mid-exposure", "Camera", "Exposure", seen, "Received")
    rows = tuple(
        (
            picture.name,
            _shown(picture.utc),
            picture.camera,
            f"{picture.exposure_s:g} s",
            "; ".join(_targets(picture, mission, cameras[picture.name])),
            "yes" if picture.received else "no",
        )
        for picture in content.pictures
    )
    lost = sum(not picture.received for picture in content.pictures)
    words = f"{len(content.pictures)} pictures were commanded" + (
        f"; {lost} of them did not arrive." if lost else "."
    )
    return BriefingSection("Pictures", (words,), head=head, rows=rows)


def _targets(picture: PictureContent, mission: Mission, camera: Camera) -> Iterator[str]:
    et = et_from_utc(picture.utc)
    for name in picture.targets:
        target = body_target(name, mission.spacecraft_id, et)
        size = ""
        if target.radii_km is not None:
            size = f", {2.0 * np.max(target.radii_km) / target.range_km / camera.pixel_scale_rad:.1f} px"
        phase = ""
        if target.sun_position_km is not None:
            cosine = -target.direction @ target.sun_position_km / np.linalg.norm(target.sun_position_km)
            phase = f", {np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))):.0f}°"
        yield f"{name} {_distance(target.range_km)}{size}{phase}"


def _distance(range_km: float) -> str:
    return f"{range_km / 1e6:.2f} million km" if range_km >= NEAR_KM else f"{range_km:,.2f} km"


def _parameter_section(content: OrtContent) -> BriefingSection:
    units = {"position": "km", "velocity": "km/s"}
    rows = []
    for name, sigma in content.parameters.items():
        kind = name.partition(":")[0]
        each = ", ".join(f"{s:g}" for s in (sigma if isinstance(sigma, tuple) else (sigma,) * 3))
        rows.append((name, f"{each} {units[kind.rpartition('_')[2]]}"))
    words = (
        f"Corrections, true minus predicted, at {_shown(content.epoch_utc)} UTC along the J2000 axes. Before the pictures "
        "they are known as follows."
    )
    return BriefingSection(
        "To estimate", (words,), head=("Parameter", "A priori sigma (x, y, z)"), rows=tuple(rows)
    )


def _file_section(content: OrtContent) -> BriefingSection:
    mission = content.mission
    words = (
        f"Mission file: {mission}; star catalog: {content.catalog}; reference body: {content.reference_body}. The headers "
        "hold the predicted attitude and trajectory, as the kernels do. ort.yaml has the checksums of all files; the truth "
        "is sealed."
    )
    orbit = content.orbit
    maps = (
        ""
        if orbit is None
        else f"--landmarks {orbit.body}:{orbit.maplets} --shapes {orbit.body}:{orbit.shape} "
    )
    process = (
        f"opnav process pictures/*.fit --mission {mission} --kernels {content.kernels} --catalog {content.catalog} "
        f"--targets {','.join(content.targets)} {maps}--out ../run"
    )
    commands = (process, "opnav ort solve . --out ../run")
    return BriefingSection("Files and tools", (words,), commands=commands)


def _shown(utc: str) -> str:
    """Return a time as people read it, to the second."""
    return datetime.fromisoformat(utc).isoformat(sep=" ", timespec="seconds")

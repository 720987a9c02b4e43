"""The briefing of a rehearsal: what the team is told, as text and as a page, from the same few sections.

It is written from what ``ort.yaml`` tells and from the predicted kernels alone.
"""

from collections.abc import Iterator, Mapping
from datetime import datetime
from pathlib import Path

import numpy as np

from opnav_workbench.camera import Camera
from opnav_workbench.files import write_text
from opnav_workbench.mission import Mission
from opnav_workbench.rehearsal.ort_briefing_page import Section, as_page, as_text
from opnav_workbench.rehearsal.ort_package_file import OrtContent, PictureContent
from opnav_workbench.scene.targets import body_target
from opnav_workbench.spice import et_from_utc

__all__ = ["sections", "write_briefing"]

TEXT, PAGE = "briefing.md", "briefing.html"
POSSIBLE = (
    "Ephemerides: the target system's or the spacecraft's own may be wrong, and with it B-plane point and time of flight.",
    "Attitudes may be off by far more than the camera's a priori error.",
    "A surface may have an albedo that nobody knows; the mission file holds a uniform one.",
    "The camera's focal length or distortion may have changed since its calibration.",
    "Images may be lost or damaged, and a storm of cosmic rays may have hit the detector.",
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
    parts = sections(content, mission, cameras)
    lead = f"Operational readiness test · mission {mission.name} · {content.name}"
    write_text(folder / TEXT, as_text(content.title, lead, parts))
    write_text(folder / PAGE, as_page(content.title, lead, parts))


def sections(content: OrtContent, mission: Mission, cameras: Mapping[str, Camera]) -> tuple[Section, ...]:
    """Return the parts of the briefing, in order; `cameras` by picture."""
    return (
        Section("Situation", (content.description,)),
        _flyby(content),
        _pictures(content, mission, cameras),
        _parameters(content),
        Section("What may be different from the prediction", items=POSSIBLE),
        Section(
            "Deliver",
            (
                f"By {_shown(content.due_utc)} UTC, from the pictures and the predicted kernels of this package alone.",
            ),
            (*DELIVER, *content.deliver),
        ),
        _files(content),
    )


def _flyby(content: OrtContent) -> Section:
    plane = content.b_plane
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
    return Section("Flyby as predicted", head=("Quantity", "Value"), rows=rows)


def _pictures(content: OrtContent, mission: Mission, cameras: Mapping[str, Camera]) -> Section:
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
    return Section("Pictures", (words,), head=head, rows=rows)


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
        yield f"{name} {target.range_km / 1e6:.2f} million km{size}{phase}"


def _parameters(content: OrtContent) -> Section:
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
    return Section("To estimate", (words,), head=("Parameter", "A priori sigma (x, y, z)"), rows=tuple(rows))


def _files(content: OrtContent) -> Section:
    mission = content.mission
    words = (
        f"Mission file: {mission}; star catalog: {content.catalog}; reference body: {content.reference_body}. The headers "
        "hold the predicted attitude and trajectory, as the kernels do. ort.yaml has the checksums of all files; the truth "
        "is sealed."
    )
    process = (
        f"opnav process pictures/*.fit --mission {mission} --kernels {content.kernels} --catalog {content.catalog} "
        f"--targets {','.join(content.targets)} --out ../run"
    )
    commands = (process, "opnav ort solve . --out ../run")
    return Section("Files and tools", (words,), commands=commands)


def _shown(utc: str) -> str:
    """Return a time as people read it, to the second."""
    return datetime.fromisoformat(utc).isoformat(sep=" ", timespec="seconds")

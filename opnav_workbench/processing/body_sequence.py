"""A body from the pictures of an approach: pointing from stars, outlines and landmarks, one batch, and the files it leaves.

Files   BODY.tpc       PCK with radii, pole and prime meridian: it corrects kernels that are loaded before it, and so every
                       model of the body's disk
        BODY.yaml      what the mission file may say of how well the figure is known (``target_surfaces``)
        BODY_albedo.fits   the albedo map that the pictures show, with its sigma; BODY.yaml names it
        BODY.json      everything that came out, with covariances
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from opnav_workbench.errors import EstimationError, KernelError, OpNavError
from opnav_workbench.estimation import Transition, kepler, straight_line
from opnav_workbench.estimation.body import (
    BodyKnowledge,
    BodyRotation,
    BodySolution,
    SequencePicture,
    SurfaceMap,
    albedo_from_pictures,
    solve_body_from_pictures,
)
from opnav_workbench.files import make_folder, write_json, write_text
from opnav_workbench.format_versions import stamped
from opnav_workbench.kernels import (
    KernelSet,
    body_attitude,
    body_gm_km3_s2,
    body_id,
    body_periodic_terms,
    state,
)
from opnav_workbench.processing.automatic import LANDMARKS_FROM_PX, open_picture, solve_stars
from opnav_workbench.processing.model import OpenedProcessing, Processing
from opnav_workbench.render import LunarLambert
from opnav_workbench.session import ImageSession
from opnav_workbench.session.body_models import body_picture, scene_names
from opnav_workbench.session.pointing import attitude_covariance, pointing_doubt
from opnav_workbench.session.state import BodyRequest
from opnav_workbench.version import __version__

__all__ = ["BodyFromPictures", "body_json", "knowledge_of", "solve_body_of", "write_body"]

Say = Callable[[str, str], None]


@dataclass(frozen=True, slots=True)
class BodyFromPictures:
    """A body as a sequence of pictures tells it, and the pictures that told nothing.

    Attributes
    ----------
    left_out : tuple of (str, str)
        Picture and reason.
    periodic_terms : mapping of str to int
        Of the believed rotation, which the written PCK takes out.
    surface
        Its albedo map; None where it was not asked for, or no picture shows enough.
    """

    body: str
    body_id: int
    solution: BodySolution
    left_out: tuple[tuple[str, str], ...]
    periodic_terms: Mapping[str, int] = field(default_factory=dict)
    surface: SurfaceMap | None = None


def knowledge_of(opened: OpenedProcessing, body: str, given: Mapping[str, float | None]) -> BodyKnowledge:
    """Return what is believed of a body: what was given, else what the mission says of its figure.

    Raises
    ------
    EstimationError
        A value that is no standard deviation.
    """
    surface = opened.mission.target_surfaces.get(body)
    said = {} if surface is None else {"size_sigma": surface.size_sigma, "axes_sigma": surface.axes_sigma}
    known = {one.name for one in fields(BodyKnowledge)}
    values = {**said, **{name: value for name, value in given.items() if value is not None}}
    return BodyKnowledge(
        **{name: value for name, value in values.items() if name in known and value is not None}
    )


def solve_body_of(
    images: str | Path | Sequence[str | Path],
    body: str,
    *,
    sigmas: Mapping[str, float | None] | None = None,
    passes: int = 3,
    albedo: bool = True,
    out: str | Path | None = None,
    say: Say = lambda _name, _words: None,
    **how: Any,
) -> BodyFromPictures:
    """Solve for a body's size, axes, pole, spin and center of figure from pictures, as ``opnav body solve`` does.

    Parameters
    ----------
    images
        Pictures of one approach, of any size and phase; each needs its stars, or an attitude whose sigma the camera states.
    body
        SPICE name; kernels give its ephemeris, radii and rotation as believed.
    sigmas : mapping of str to float, optional
        What is believed before, by the fields of `opnav_workbench.estimation.body.BodyKnowledge`.
    passes
        How often outlines are read, each time with the body that came out.
    albedo
        Whether the body's albedo map is made as well.
    out
        Folder for the files; None: nothing is written.
    say
        Called with a picture's name and a few words.
    **how
        As of `opnav_workbench.process`: mission, kernels, catalog, landmarks, ...

    Raises
    ------
    OpNavError
        An option that is not allowed, kernels that do not orient the body, or pictures that show too little.

    Examples
    --------
    ``found = solve_body_of(pictures, "BENNU", mission="osiris_rex", kernels="approach.tm", out="bennu")``, then
    ``found.solution.radii_km``, ``found.solution.words``, and ``opnav process --kernels`` with ``bennu/BENNU.tpc`` loaded
    last.
    """
    paths = [Path(image) for image in ([images] if isinstance(images, str | Path) else images)]
    options = Processing.checked({**how, "targets": (body,)})
    opened = options.opened()
    with options.kernel_set():
        if KernelSet.active() is None:
            raise EstimationError("a body is solved against its ephemeris: give kernels (--kernels).")
        pictures, left_out = _pictures(paths, body, opened, say)
        if not pictures:
            why = "; ".join(f"{name}: {reason}" for name, reason in left_out[:2])
            raise EstimationError(f"none of {len(paths)} pictures can be used ({why}).")
        pictures.sort(key=lambda one: one.et)
        epoch = 0.5 * (pictures[0].et + pictures[-1].et)
        rotation = BodyRotation.from_attitudes(lambda et: body_attitude(body, et), epoch)
        transition = _transition(body, opened.mission.spacecraft_id, epoch)
        solution = solve_body_from_pictures(
            pictures,
            body,
            rotation,
            knowledge_of(opened, body, sigmas or {}),
            transition=transition,
            passes=passes,
            say=say,
        )
        surface = None
        if albedo:
            say(body, "drawing its albedo map")
            surface = _surface(pictures, body, solution, transition)
        found = BodyFromPictures(
            body, body_id(body), solution, tuple(left_out), body_periodic_terms(body), surface
        )
    if out is not None:
        write_body(found, out)
    return found


def _surface(
    pictures: Sequence[SequencePicture], body: str, solution: BodySolution, transition: Transition
) -> SurfaceMap | None:
    try:
        return albedo_from_pictures(pictures, body, solution, transition=transition)
    except EstimationError:  # all of them are small: nothing but the map is missing
        return None


def _pictures(
    paths: Sequence[Path], body: str, opened: OpenedProcessing, say: Say
) -> tuple[list[SequencePicture], list[tuple[str, str]]]:
    pictures, left_out = [], []
    for path in paths:
        say(path.name, "solving the pointing")
        try:
            pictures.append(_picture(path, body, opened))
        except OpNavError as error:
            left_out.append((path.name, str(error)))
    return pictures, left_out


def _picture(path: Path, body: str, opened: OpenedProcessing) -> SequencePicture:
    """Return a picture with its pointing solved; the session ends here.

    Raises
    ------
    OpNavError
        It cannot be read, its field is not identified for sure, or the body cannot be drawn.
    """
    session = open_picture(path, opened)
    session.predict()
    session.add_target(body)
    solve_stars(session, opened)
    if session.state.pointing is not None and (doubt := pointing_doubt(session.state)):
        raise EstimationError(f"its pointing is not to be trusted: {doubt}.")
    maplets = opened.how.landmarks.get(body)
    if maplets is not None and session.predict_body(body).diameter_px > LANDMARKS_FROM_PX:
        session.find_landmarks(body, maplets)
    return _of_session(session, body)


def _of_session(session: ImageSession, body: str) -> SequencePicture:
    context, inputs, now = session.context, session.inputs, session.state
    scene = scene_names(inputs, now, BodyRequest(body, "disk"))
    landmarks = next((one for one in now.landmarks if one.centers.body == body), None)
    covariance = attitude_covariance(context, now)
    return SequencePicture(
        context.picture.name,
        inputs.et,
        body_picture(context, inputs, now, (body,), scene),
        covariance,
        landmarks,
    )


def _transition(body: str, spacecraft: int, epoch_et: float) -> Transition:
    """Return how a correction grows: about a body of known mass as gravity has it, else on a straight line."""
    try:
        gm = body_gm_km3_s2(body)
        relative = state(spacecraft, epoch_et, body)
    except KernelError:
        return straight_line
    return (
        straight_line
        if gm == 0.0
        else kepler(np.concatenate([relative.position_km, relative.velocity_km_s]), gm)
    )


# ---- What is written.


def write_body(found: BodyFromPictures, out: str | Path) -> tuple[Path, ...]:
    """Write PCK, lines for the mission file, everything as JSON, and the map; files of an older solution are replaced.

    Raises
    ------
    OpNavError
        The folder cannot be written.
    """
    folder = make_folder(out)
    stem = found.body.replace(" ", "_")
    pck, lines, report = (folder / f"{stem}{suffix}" for suffix in (".tpc", ".yaml", ".json"))
    albedo = folder / f"{stem}_albedo.fits"
    found.solution.write_pck(pck, found.body_id, found.periodic_terms)
    size, axes = (float(f"{value:.3g}") for value in found.solution.figure_sigmas)
    surface: dict[str, Any] = {"size_sigma": size, "axes_sigma": axes}
    if found.surface is None:
        albedo.unlink(missing_ok=True)
    else:
        found.surface.write(albedo)
        surface["albedo_map"] = {"file": str(albedo.resolve())}
        if (weight := _lunar_weight(found.surface)) is not None:
            surface["law"] = {"law": "lunar_lambert", "lunar_weight": weight}
    write_text(lines, yaml.safe_dump({"target_surfaces": {found.body: surface}}))
    write_json(report, stamped("body", body_json(found)))
    return (pck, lines, report) if found.surface is None else (pck, lines, report, albedo)


def _lunar_weight(surface: SurfaceMap) -> float | None:
    """Return the share of Lommel-Seeliger's law that pictures agree on; None under a law of another kind."""
    weight = surface.law.lunar_weight if isinstance(surface.law, LunarLambert) else None
    return None if weight is None or isinstance(weight, tuple) else round(float(weight), 3)


def body_json(found: BodyFromPictures) -> dict[str, Any]:
    """Return everything that came out as plain values; angles in degrees where a person reads."""
    s = found.solution
    return {
        "version": __version__,
        "body": found.body,
        "body_id": found.body_id,
        "epoch_et": s.epoch_et,
        "radii_km": s.radii_km,
        "radii_sigma_km": s.radii_sigma_km,
        "a_priori_radii_km": s.a_priori_radii_km,
        "pole_ra_deg": np.degrees(s.rotation.pole_ra_rad),
        "pole_dec_deg": np.degrees(s.rotation.pole_dec_rad),
        "pole_sigma_deg": np.degrees(s.pole_sigma_rad),
        "prime_meridian_deg": s.rotation.pck_terms()[2],
        "phase_sigma_deg": np.degrees(s.phase_sigma_rad),
        "spin_rate_rad_s": s.rotation.rate_rad_s,
        "spin_sigma_rad_s": s.spin_sigma_rad_s,
        "center_of_figure_km": s.offset_km,
        "center_of_figure_sigma_km": s.offset_sigma_km,
        "state_correction": s.state.state,
        "covariance": s.covariance,
        "a_priori_covariance": s.a_priori_covariance,
        "images": [
            {"image": name, "attitude_correction_rad": eps, "attitude_covariance_rad2": covariance}
            for name, eps, covariance in zip(s.images, s.state.attitudes, s.attitude_covariances, strict=True)
        ],
        "residuals": [
            {"image": r.image, "kind": r.kind, "residual_px": r.residual_px, "sigmas": r.sigmas, "used": r.used,
             "reason": r.reason}
            for r in s.residuals
        ],
        "excess_px": s.excess_px,
        "chi2": s.chi2,
        "degrees_of_freedom": s.degrees_of_freedom,
        "converged": s.converged,
        "observability": list(s.words),
        "messages": list(s.messages),
        "left_out": [{"image": name, "reason": reason} for name, reason in found.left_out],
        "albedo_map": None if found.surface is None else _surface_json(found.surface),
    }  # fmt: skip


def _surface_json(surface: SurfaceMap) -> dict[str, Any]:
    values = surface.albedo.values
    return {
        "lines": len(values),
        "seen_share": surface.seen_share,
        "absolute": surface.absolute,
        "lunar_weight": _lunar_weight(surface),
        "darkest": float(values.min()),
        "brightest": float(values.max()),
        "gains": [
            {"image": name, "gain": float(gain)}
            for name, gain in zip(surface.images, surface.gains, strict=True)
        ],
    }

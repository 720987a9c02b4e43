"""The automatic policy: what is done with a picture that nobody looks at.

The steps are the same `ImageSession` methods that an analyst's clicks call: predict - find stars - decisions - repoint,
then once more around the solved pointing (which finds the faint stars that the first, wider search missed), then every
target, the largest first, and the observables.  A session that an analyst has recorded is taken again as it was instead.
A point that is not where it was searched is looked for farther out: its ephemeris may be off by more than anybody announced.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from opnav_workbench.bodies import BodyCenter
from opnav_workbench.catalog import read_star_list
from opnav_workbench.errors import OpNavError
from opnav_workbench.files import sha256_of
from opnav_workbench.kernels import KernelSet
from opnav_workbench.lazy_names import module_on_demand
from opnav_workbench.paths import is_file
from opnav_workbench.processing.model import OpenedProcessing
from opnav_workbench.scene import BodyPrediction
from opnav_workbench.session import ImageSession, Settings

if TYPE_CHECKING:
    from opnav_workbench.bodies import subarray
else:  # a picture of stars needs nothing that finds bodies
    subarray = module_on_demand("opnav_workbench.bodies.subarray")

__all__ = [
    "Progress",
    "find_targets",
    "open_or_resume",
    "open_picture",
    "run_policy",
    "silent",
    "solve_stars",
]

Progress = Callable[[str], None]
LANDMARKS_FROM_PX = 40.0  # a smaller disk has no patch of a template's size that is not its limb


def silent(_words: str) -> None:
    """Say nothing."""


# ---- The automatic policy for one picture: the same `ImageSession` methods that an analyst's clicks call.


def open_picture(image: str | Path, opened: OpenedProcessing) -> ImageSession:
    """Open a picture as the policy says, with the settings of its recorded decisions where there are any.

    Raises
    ------
    OpNavError
        As `ImageSession.open`.
    """
    return ImageSession.open(image, opened.mission, **_opening(image, opened))


def open_or_resume(image: str | Path, folder: str | Path, opened: OpenedProcessing) -> ImageSession:
    """Continue the session of a picture that `folder` holds, else open the picture; every step is saved there.

    Raises
    ------
    OpNavError
        As `ImageSession.open_or_resume`.
    """
    return ImageSession.open_or_resume(folder, image, opened.mission, **_opening(image, opened))


def _opening(image: str | Path, opened: OpenedProcessing) -> dict[str, Any]:
    settings, by_hand = opened.settings, False
    if opened.decisions.images and is_file(image):
        sha256 = sha256_of(image)
        by_hand = opened.decisions.describe_bodies(Path(image), sha256)
        recorded = opened.decisions.recorded(sha256)
        if recorded is not None:
            settings = Settings.from_dict(Settings().to_dict() | recorded.settings)
    return {
        "catalog": opened.how.catalog,
        "opened_catalog": opened.catalog,
        "target_stars": opened.how.target_stars,
        "attitude": opened.how.attitude,
        "shapes": opened.how.shape_files,
        "settings": settings,
        "by_hand": by_hand,
    }


def run_policy(
    session: ImageSession,
    opened: OpenedProcessing,
    say: Progress = silent,
    cancelled: Callable[[], bool] = lambda: False,
) -> bool:
    """Carry out the policy on an open session, as a night's run does; what the analyst decided in it stays decided.

    Parameters
    ----------
    say : callable
        Called with a few words before each step, for progress.
    cancelled
        Asked between steps; once it says True, what is done stands and the rest is left.

    Returns
    -------
    bool
        Whether all of it was done.

    Raises
    ------
    OpNavError
        A step cannot be carried out.
    """
    if not session.standing and opened.decisions.recorded(session.context.picture.sha256) is not None:
        say("repeating the analyst's session")
        opened.decisions.apply(session)
        return True
    for words, step in _steps(session, opened):
        if cancelled():
            return False
        say(words)
        step()
    return True


def _steps(session: ImageSession, opened: OpenedProcessing) -> Iterator[tuple[str, Callable[[], object]]]:
    """Yield the policy's steps with their words; later ones depend on what earlier ones found."""
    yield "predicting", session.predict
    targets = _add_targets(session, opened)
    if session.inputs.without_sky:  # no star is where anybody could look for it
        yield "taking decisions", lambda: opened.decisions.apply(session)
    else:
        yield "finding stars", lambda: _identify(session, opened)
        yield "solving the pointing", lambda: _repoint_twice(session, opened)
    yield from _target_steps(session, opened, targets)


def find_targets(session: ImageSession, opened: OpenedProcessing) -> None:
    """Find the targets of a session with a new pointing, the largest first, and compute the observables.

    Landmarks that agree on a pose stay: they were drawn from that pose, and are judged with the new pointing already.
    """
    for _, step in _target_steps(session, opened, session.state.targets):
        step()


def _target_steps(
    session: ImageSession, opened: OpenedProcessing, targets: Sequence[str]
) -> Iterator[tuple[str, Callable[[], object]]]:
    for name in _largest_first(session, opened, targets):
        if _fills_picture(session, opened, name):
            continue
        yield f"finding {name}", lambda name=name: _find_target(session, opened, name)  # type: ignore[misc]
    posed = {one.centers.body for one in session.state.landmarks if one.pose is not None}
    for name in (n for n in _with_landmarks(session, opened, targets) if n not in posed):
        yield f"finding landmarks of {name}", lambda name=name: _find_landmarks(session, opened, name)  # type: ignore[misc]
    yield "computing observables", session.compute_observables


def _with_landmarks(session: ImageSession, opened: OpenedProcessing, targets: Sequence[str]) -> list[str]:
    """Return the bodies whose landmarks are to be looked for: those with maplets, wide enough to show any."""
    known = opened.mission.target_surfaces
    named = [n for n in targets if n in opened.how.landmarks or (n in known and known[n].maplets is not None)]
    return [n for n in named if session.predict_body(n).diameter_px > LANDMARKS_FROM_PX]


def _fills_picture(session: ImageSession, opened: OpenedProcessing, name: str) -> bool:
    """Whether a body is wider than the picture and has maplets: its landmarks tell more than what shows of its limb."""
    camera = session.context.camera
    if not _with_landmarks(session, opened, [name]):
        return False
    return session.predict_body(name).diameter_px > max(camera.n_pixel, camera.n_line)


def _find_landmarks(session: ImageSession, opened: OpenedProcessing, name: str) -> None:
    session.find_landmarks(name, opened.how.landmarks.get(name))
    opened.decisions.apply_landmarks(session, name)


def solve_stars(session: ImageSession, opened: OpenedProcessing) -> None:
    """Find the predicted stars and solve the pointing, then once more around the solved pointing."""
    _identify(session, opened)
    _repoint_twice(session, opened)


def _identify(session: ImageSession, opened: OpenedProcessing) -> None:
    opened.decisions.apply_field(session)
    session.find_stars(opened.how.initial, opened.how.centers)
    if session.search_sky_where_lost():
        session.find_stars(opened.how.initial, opened.how.centers)
    opened.decisions.apply(session)


def _repoint_twice(session: ImageSession, opened: OpenedProcessing) -> None:
    if session.state.centers is not None:
        session.repoint(opened.how.model)
    if session.state.pointing is not None:
        session.find_stars(opened.how.initial, opened.how.centers)
        session.repoint(opened.how.model)


def _add_targets(session: ImageSession, opened: OpenedProcessing) -> list[str]:
    """Take the targets into the scene; one that nothing is known of costs the picture neither stars nor pointing."""
    opened.decisions.apply_bodies(session)
    known = []
    for name in dict.fromkeys((*_wanted_targets(opened), *opened.decisions.bodies_of(session))):
        try:
            session.add_target(name)
            known.append(name)
        except OpNavError as error:
            session.skip_target(name, str(error))
    return known


def _wanted_targets(opened: OpenedProcessing) -> list[str]:
    if opened.how.targets is not None:
        return list(opened.how.targets)
    return [
        *_named_stars(opened),
        *(opened.mission.default_targets if KernelSet.active() is not None else ()),
    ]


def _named_stars(opened: OpenedProcessing) -> list[str]:
    """Return the stars of a list that was given for this processing: they are meant as targets."""
    path = opened.how.target_stars
    return [] if path is None else [str(name) for name in read_star_list(path).id]


def _largest_first(session: ImageSession, opened: OpenedProcessing, targets: Sequence[str]) -> list[str]:
    """Return the targets to look for, the largest first: what it is off by is expected of the others.

    A target that nobody asked for by name is not looked for where it cannot be seen.
    """
    wanted = dict.fromkeys(targets) if opened.how.targets is not None else dict.fromkeys(_named_stars(opened))
    wanted |= dict.fromkeys(opened.decisions.bodies_of(session))
    predicted = {name: session.predict_body(name) for name in targets}
    seen = [name for name in targets if name in wanted or _may_be_on_detector(session, predicted[name])]
    return sorted(seen, key=lambda name: -np.nan_to_num(predicted[name].diameter_px))


def _may_be_on_detector(session: ImageSession, body: BodyPrediction) -> bool:
    """Whether some of a body may be on the detector; before the pointing is solved, that is not known."""
    if session.state.pointing is None:
        return True
    radius = float(np.nan_to_num(0.5 * body.diameter_px))
    return bool(
        session.context.camera.on_detector(body.pixel_line, radius + subarray.search_radius(radius, None))
    )


def _find_target(session: ImageSession, opened: OpenedProcessing, name: str) -> None:
    decided = opened.decisions.methods_of(session, name)
    method = opened.how.methods.get(name, opened.how.method)
    for options in decided or ({"method": method},):
        session.find_body(name, **options)
    if not decided and session.state.pointing is not None:
        search_point_farther(session, name, method)


# ---- A second, wider look for a point whose ephemeris is farther off than anybody announced.

# It may be mistaken for a star: so far out it counts only if it is as clear and as bright as it should be.
POINT_SEARCHES_PX = (10.0, 30.0)
POINT_SNR = 10.0


def search_point_farther(session: ImageSession, name: str, method: str) -> None:
    """Look farther out for a point of known brightness; what does not fit is taken back."""
    missed = _last_center(session, name)
    known = session.inputs.targets[name].magnitude is not None
    if missed.method != "unresolved" or missed.status != "not_detected" or not known:
        return
    for radius_px in POINT_SEARCHES_PX:
        session.find_body(name, method, radius_px)
        found = _last_center(session, name)
        if found.status == "ok" and found.snr >= POINT_SNR:
            return
        session.undo()


def _last_center(session: ImageSession, name: str) -> BodyCenter:
    return next(body for body in reversed(session.state.bodies) if body.name == name)

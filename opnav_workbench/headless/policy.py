"""The automatic policy for one picture: the same `ImageSession` methods that an analyst's clicks call.

predict - find stars - decisions - repoint, then once more around the solved pointing (which finds the faint stars that
the first, wider search missed), then every target, the largest first, and the observables.  A session that an analyst has
recorded is taken again as it was instead.  What is done is always saved.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from opnav_workbench.bodycenters.subarray import search_radius
from opnav_workbench.catalog import Catalog, open_catalog
from opnav_workbench.errors import OpNavError, SessionError
from opnav_workbench.files import sha256_of
from opnav_workbench.headless.decisions import Decisions
from opnav_workbench.headless.wider_search import search_wider
from opnav_workbench.mission import Mission
from opnav_workbench.pointing.models import MODELS
from opnav_workbench.scene import BodyPrediction
from opnav_workbench.session import ATTITUDE_SOURCES, BODY_METHODS, ImageSession, Settings
from opnav_workbench.spice import KernelSet

__all__ = ["Policy", "Say", "open_picture", "quiet", "run_policy", "solve_stars"]

Say = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Policy:
    """How pictures are processed without a person.

    Attributes
    ----------
    mission : Mission
    catalog : str
    targets : sequence of str or None
        None takes the mission's default targets where kernels are loaded, and none without.
    method : str
        How bodies are found; ``auto`` takes what suits each.
    methods : mapping of str to str
        The same for single bodies, by name.
    target_stars : Path or None
    attitude : {"auto", "kernels", "header"}
    model : {"euler", "image_plane"}
    initial, final : str
        Star centerfinders.
    decisions : Decisions
    settings : Settings
    """

    mission: Mission
    catalog: str = "bundled"
    targets: Sequence[str] | None = None
    method: str = "auto"
    methods: Mapping[str, str] = field(default_factory=dict)
    target_stars: Path | None = None
    attitude: str = "auto"
    model: str = "euler"
    initial: str = "matched_filter"
    final: str = "least_squares"
    decisions: Decisions = field(default_factory=Decisions)
    settings: Settings = field(default_factory=Settings)
    opened_catalog: Catalog = field(init=False, repr=False)  # once for all pictures

    def __post_init__(self) -> None:
        """Refuse at once what would fail for every picture."""
        if self.model not in MODELS:
            raise SessionError(f"unknown pointing model {self.model!r}; choose one of {', '.join(MODELS)}.")
        if self.attitude not in ATTITUDE_SOURCES:
            raise SessionError(
                f"unknown attitude source {self.attitude!r}; choose one of {', '.join(ATTITUDE_SOURCES)}."
            )
        unknown = sorted({self.method, *self.methods.values()} - set(BODY_METHODS))
        if unknown:
            raise SessionError(
                f"unknown body method {', '.join(unknown)}; choose one of {', '.join(BODY_METHODS)}."
            )
        object.__setattr__(self, "opened_catalog", open_catalog(self.catalog))


def quiet(_words: str) -> None:
    """Say nothing."""


def open_picture(image: str | Path, policy: Policy) -> ImageSession:
    """Open a picture as the policy says, with the settings of its recorded decisions where there are any.

    Raises
    ------
    OpNavError
        As `ImageSession.open`.
    """
    settings = policy.settings
    if policy.decisions.images and Path(image).is_file():
        recorded = policy.decisions.recorded(sha256_of(image))
        if recorded is not None:
            settings = Settings.from_dict(Settings().to_dict() | recorded.settings)
    return ImageSession.open(
        image,
        policy.mission,
        catalog=policy.catalog,
        opened_catalog=policy.opened_catalog,
        target_stars=policy.target_stars,
        attitude=policy.attitude,
        settings=settings,
    )


def run_policy(
    session: ImageSession, policy: Policy, say: Say = quiet, cancelled: Callable[[], bool] = lambda: False
) -> bool:
    """Carry out the policy on an open session, as a night's run does; what the analyst decided in it stays decided.

    Parameters
    ----------
    session : ImageSession
    policy : Policy
    say : callable
        Called with a few words before each step, for progress.
    cancelled : callable
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
    if not session.standing and policy.decisions.recorded(session.context.frame.sha256) is not None:
        say("repeating the analyst's session")
        policy.decisions.apply(session)
        return True
    for words, step in _steps(session, policy):
        if cancelled():
            return False
        say(words)
        step()
    return True


def _steps(session: ImageSession, policy: Policy) -> Iterator[tuple[str, Callable[[], object]]]:
    """Yield the policy's steps with their words; later ones depend on what earlier ones found."""
    yield "predicting", session.predict
    targets = _add_targets(session, policy)
    yield "finding stars", lambda: _identify(session, policy)
    yield "solving the pointing", lambda: _repoint_twice(session, policy)
    for name in _in_order(session, policy, targets):
        yield f"finding {name}", lambda name=name: _find(session, policy, name)  # type: ignore[misc]
    yield "computing observables", session.observables


def solve_stars(session: ImageSession, policy: Policy) -> None:
    """Find the predicted stars and solve the pointing, then once more around the solved pointing."""
    _identify(session, policy)
    _repoint_twice(session, policy)


def _identify(session: ImageSession, policy: Policy) -> None:
    policy.decisions.apply_field(session)
    session.find_stars(policy.initial, policy.final)
    policy.decisions.apply(session)


def _repoint_twice(session: ImageSession, policy: Policy) -> None:
    if session.state.centers is not None:
        session.repoint(policy.model)
    if session.state.pointing is not None:
        session.find_stars(policy.initial, policy.final)
        session.repoint(policy.model)


def _add_targets(session: ImageSession, policy: Policy) -> list[str]:
    """Take the targets into the scene; one that nothing is known of costs the picture neither stars nor pointing."""
    known = []
    for name in dict.fromkeys((*_targets(policy), *policy.decisions.bodies_of(session))):
        try:
            session.add_target(name)
            known.append(name)
        except OpNavError as error:
            session.skip_target(name, str(error))
    return known


def _targets(policy: Policy) -> list[str]:
    if policy.targets is not None:
        return list(policy.targets)
    return list(policy.mission.default_targets) if KernelSet.active() is not None else []


def _in_order(session: ImageSession, policy: Policy, targets: Sequence[str]) -> list[str]:
    """Return the targets to look for, the largest first: what it is off by is expected of the others.

    A target that nobody asked for by name is not looked for where it cannot be seen.
    """
    wanted = dict.fromkeys(targets) if policy.targets is not None else {}
    wanted |= dict.fromkeys(policy.decisions.bodies_of(session))
    predicted = {name: session.predict_body(name) for name in targets}
    seen = [name for name in targets if name in wanted or _in_sight(session, predicted[name])]
    return sorted(seen, key=lambda name: -np.nan_to_num(predicted[name].diameter_px))


def _in_sight(session: ImageSession, body: BodyPrediction) -> bool:
    """Whether some of a body may be on the detector; before the pointing is solved, that is not known."""
    if session.state.pointing is None:
        return True
    radius = float(np.nan_to_num(0.5 * body.diameter_px))
    return bool(session.context.camera.on_detector(body.pixel_line, radius + search_radius(radius, None)))


def _find(session: ImageSession, policy: Policy, name: str) -> None:
    decided = policy.decisions.methods_of(session, name)
    method = policy.methods.get(name, policy.method)
    for options in decided or ({"method": method},):
        session.find_body(name, **options)
    if not decided and session.state.pointing is not None:
        search_wider(session, name, method)

"""The tab of the landmarks: patch beside drawing beside correlation, each accepted or rejected by one key; and its page.

Marks over the picture: a cross where a landmark was measured, as its status has it. The pose is solved anew by the session
with every decision.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.errors import SessionError
from opnav_workbench.landmarks import LandmarkPatch, LandmarkSolution
from opnav_workbench.session.state import landmark_name
from opnav_workbench.templating import png_url
from opnav_workbench.workbench.actions import LANDMARK_MENU, LANDMARK_REASONS, Action, ActionRegistry
from opnav_workbench.workbench.markup import PagePicture, render
from opnav_workbench.workbench.stretch import gray_png
from opnav_workbench.workbench.tabs import Handler, PageEvent, StepRunner, Tab, next_of
from opnav_workbench.workbench.viewer import Layer

__all__ = ["LandmarksTab"]


# ---- The page: one landmark large, its neighbors small, numbers and pose.

LARGE_PX, SMALL_PX = 132, 44
CARDS_PER_PAGE = 18  # drawn when they are looked at
SIGNS = {"accepted": "✓", "rejected": "✗", "": "?"}
STATUS_WORDS = {"accepted": "in the pose", "rejected": "not in the pose", "not_found": "not found"}


@dataclass(frozen=True, slots=True)
class LandmarkCard:
    """A landmark as the page shows it: its row of the solution, what the analyst decided, and its pictures once drawn."""

    id: str
    status: str
    reason: str
    decision: str
    numbers: tuple[tuple[str, str], ...]
    correlation: float
    patch: LandmarkPatch | None

    @property
    def sign(self) -> str:
        """Sign of the decision."""
        return SIGNS[self.decision]

    @property
    def state(self) -> str:
        """Its status in words."""
        return STATUS_WORDS[self.status]

    @property
    def hint(self) -> str:
        """One line on it."""
        return f"{self.id}: {self.decision or 'undecided'}; {self.state}{f'; {self.reason}' if self.reason else ''}"

    def pictures(self, size_px: int) -> list[tuple[str, PagePicture]]:
        """Return patch, drawing and correlation by name; the first two in one stretch."""
        patch = self.patch
        if patch is None:
            return []
        both = np.concatenate([patch.data_dn.ravel(), patch.model_dn.ravel()])
        finite = both[np.isfinite(both)]
        low, high = np.percentile(finite, (1.0, 99.5)) if finite.size else (0.0, 1.0)
        pngs = (
            gray_png(patch.data_dn, float(low), float(high), "linear"),
            gray_png(patch.model_dn, float(low), float(high), "linear"),
            gray_png(np.maximum(patch.correlation, 0.0), 0.0, 1.0, "linear"),
        )
        names = ("patch", "drawn", "correlation")
        return [
            (name, PagePicture(png_url(png), size_px, size_px)) for name, png in zip(names, pngs, strict=True)
        ]


@dataclass(frozen=True, slots=True)
class LandmarkPage:
    """Everything that the page of the landmarks shows (templates/landmarks.html).

    Attributes
    ----------
    bodies
        Name, and whether its landmarks were found.
    cards
        Those on the page; `focus` is one of them.
    pose
        One line for each fact of the pose, or why there is none.
    """

    bodies: tuple[tuple[str, bool], ...]
    chosen: str
    cards: tuple[LandmarkCard, ...]
    focus: LandmarkCard | None
    first: int
    n_all: int
    n_accepted: int
    n_rejected: int
    order: str
    pose: tuple[str, ...]
    reasons_open: bool
    reasons: tuple[Action, ...]


def pose_lines(solution: LandmarkSolution) -> tuple[str, ...]:
    """Return what the landmarks say of the camera, in words; or why they say nothing."""
    pose, n = solution.pose, len(solution.centers)
    held = f"{int(solution.accepted.sum())} of {n} landmarks in the pose"
    unseen = "; ".join(f"{count} {why}" for why, count in solution.centers.not_searched.items())
    rest = (f"not looked for: {unseen}",) if unseen else ()
    said = [one for one in solution.messages if not one.endswith(f"accepted on {solution.centers.body}")]
    if pose is None:
        return (f"{held}: no pose. {' '.join(said)}".strip(), *rest)
    sigma = np.sqrt(np.trace(pose.position_covariance_km2))
    moved = float(np.linalg.norm(pose.position_shift_km))
    turned = np.degrees(np.linalg.norm(pose.attitude_shift_rad)) * 3600.0
    return (
        f"{held}, rms {pose.rms_px:.3f} px",
        f"camera {moved:.4g} km from where it was believed, ± {sigma:.2g} km; turned {turned:.3g}″",
        *said,
        *rest,
    )


# ---- The tab.

LAYER = "landmarks"
CROSS_PX = 4.0  # half a mark's size
MIN_RING_PX = 8.0
CLICK_RADIUS_PX = 10.0
ORDERS = ("as found", "correlation", "residual")
STYLES = {"accepted": "used", "rejected": "rejected", "not_found": "unused"}


class LandmarksTab(Tab):
    """The tab of the landmarks."""

    name = "landmarks"
    clicks_look = True

    def __init__(self, runner: StepRunner, registry: ActionRegistry) -> None:
        super().__init__(runner, registry)
        self.body = self.focus_id = ""
        self.order = ORDERS[0]
        self._drawn: tuple[object, dict[str, LandmarkPatch]] = (None, {})  # of which measurements

    # -- what stands ---------------------------------------------------------------------------------------------

    @property
    def names(self) -> list[str]:
        """Bodies expected in the picture, and those whose maplets the mission names."""
        session = self.runner.session
        mapped = (name for name, one in session.context.mission.target_surfaces.items() if one.maplets)
        return list(dict.fromkeys((*session.state.targets, *session.inputs.targets, *mapped)))

    @property
    def chosen(self) -> str:
        """The body at hand: the one chosen, else the first whose landmarks were found, else the first; empty without any."""
        if self.body in self.names:
            return self.body
        found = [solution.centers.body for solution in self.runner.session.state.landmarks]
        return next(iter([*found, *self.names]), "")

    @property
    def solution(self) -> LandmarkSolution | None:
        """What was found of the body at hand."""
        landmarks = self.runner.session.state.landmarks
        return next((one for one in landmarks if one.centers.body == self.chosen), None)

    def _rows(self, solution: LandmarkSolution) -> list[int]:
        """Rows in the order chosen."""
        centers = solution.centers
        keys: dict[str, FloatArray] = {
            "correlation": np.where(np.isfinite(centers.correlation), centers.correlation, 2.0),
            "residual": -np.nan_to_num(_off(solution)),
        }
        if self.order not in keys:
            return list(range(len(centers)))
        return [int(row) for row in np.argsort(keys[self.order], kind="stable")]

    @property
    def ids(self) -> list[str]:
        """Landmarks in the order chosen."""
        solution = self.solution
        return [] if solution is None else [str(solution.centers.id[row]) for row in self._rows(solution)]

    @property
    def focused(self) -> str:
        """The landmark under decision; empty without any."""
        ids = self.ids
        return self.focus_id if self.focus_id in ids else next(iter(ids), "")

    def _decision(self, identity: str) -> str:
        decisions = self.runner.session.state.landmark_decisions
        return decisions.get(landmark_name(self.chosen, identity), ("", ""))[0]

    def _patches(self, ids: Sequence[str]) -> dict[str, LandmarkPatch]:
        """Patches of some landmarks, drawn once for what was measured: decisions move the pose by less than is seen."""
        solution, session = self.solution, self.runner.session
        if solution is None:
            return {}
        measured = (self.chosen, solution.centers.observed_px.tobytes())
        if self._drawn[0] != measured:
            self._drawn = (measured, {})
        missing = [identity for identity in ids if identity not in self._drawn[1]]
        for patch in session.landmark_patches(self.chosen, missing) if missing else ():
            self._drawn[1][patch.id] = patch
        return self._drawn[1]

    # -- the page ------------------------------------------------------------------------------------------------

    def html(self) -> str:
        """Return the page."""
        return render("landmarks.html", page=self._page(), actions=self.registry)

    def _page(self) -> LandmarkPage:
        solution, ids, focus = self.solution, self.ids, self.focused
        found = {one.centers.body for one in self.runner.session.state.landmarks}
        first = ids.index(focus) // CARDS_PER_PAGE * CARDS_PER_PAGE if focus else 0
        shown = ids[first : first + CARDS_PER_PAGE]
        patches = self._patches(shown)
        cards = (
            () if solution is None else tuple(self._card(solution, one, patches.get(one)) for one in shown)
        )
        verdicts = [self._decision(one) for one in ids]
        return LandmarkPage(
            bodies=tuple((name, name in found) for name in self.names),
            chosen=self.chosen,
            cards=cards,
            focus=next((card for card in cards if card.id == focus), None),
            first=first,
            n_all=len(ids),
            n_accepted=verdicts.count("accepted"),
            n_rejected=verdicts.count("rejected"),
            order=self.order,
            pose=() if solution is None else pose_lines(solution),
            reasons_open=self.runner.menu == LANDMARK_MENU,
            reasons=tuple(action for action in self.registry if action.where == LANDMARK_MENU),
        )

    def _card(self, solution: LandmarkSolution, identity: str, patch: LandmarkPatch | None) -> LandmarkCard:
        centers = solution.centers
        row = centers.id.tolist().index(identity)
        off = _residuals(solution)[row]
        sigma = np.sqrt(np.diag(solution.covariance_px2[row]))
        numbers = [("correlation", f"{centers.correlation[row]:.2f}")]
        if np.isfinite(off).all():
            numbers += [
                ("O − C", f"{off[0]:+.2f} px, {off[1]:+.2f} lines"),
                ("sigma", f"{sigma[0]:.2f}, {sigma[1]:.2f} px"),
            ]
        numbers.append(
            ("seen, lit at", f"{centers.emission_deg[row]:.0f}°, {centers.incidence_deg[row]:.0f}°")
        )
        status, reason = solution.status[row], solution.reason[row]
        return LandmarkCard(
            identity,
            status,
            reason,
            self._decision(identity),
            tuple(numbers),
            float(centers.correlation[row]),
            patch,
        )

    # -- the picture ---------------------------------------------------------------------------------------------

    def draw(self) -> None:
        """Mark every landmark of the body at hand, and ring the one under decision."""
        viewer, solution, focus = self.runner.viewer, self.solution, self.focused
        viewer.circle(None)
        if solution is None:
            viewer.layer(LAYER, Layer())
            viewer.focus(None)
            return
        segments: list[tuple[float, float, float, float]] = []
        styles: list[str] = []
        for (pixel, line), status in zip(_places(solution).tolist(), solution.status, strict=True):
            segments += [
                (pixel - CROSS_PX, line, pixel + CROSS_PX, line),
                (pixel, line - CROSS_PX, pixel, line + CROSS_PX),
            ]
            styles += 2 * [STYLES[status]]
        viewer.layer(LAYER, Layer(segments, styles))
        at = _places(solution)[solution.centers.id.tolist().index(focus)]
        viewer.focus(at, max(0.5 * solution.centers.window_px, MIN_RING_PX))

    def look(self) -> None:
        """Bring the landmark under decision into the middle."""
        solution, focus = self.solution, self.focused
        if solution is not None and focus:
            self.runner.viewer.look(_places(solution)[solution.centers.id.tolist().index(focus)])

    def tapped(self, pixel: float, line: float) -> None:
        """Go to the landmark that was clicked."""
        solution = self.solution
        if solution is None:
            return
        distance = np.hypot(*(_places(solution) - (pixel, line)).T)
        nearest = int(np.argmin(distance))
        if distance[nearest] <= CLICK_RADIUS_PX:
            self._go_to(str(solution.centers.id[nearest]))
            self.runner.status.say(f"{self.focus_id}: A accepts, R rejects.")

    # -- actions -------------------------------------------------------------------------------------------------

    def handlers(self) -> dict[str, Handler]:
        """Return what it does, by action name."""
        reasons = {
            f"landmark_reason_{number}": self._reason(reason)
            for number, reason in enumerate(LANDMARK_REASONS, 1)
        }
        return reasons | {
            "find_landmarks": lambda _: self.find(),
            "landmark_body": self._choose_body,
            "accept_landmark": lambda _: self._accept(),
            "reject_landmark": lambda _: self._ask_reason(),
            "next_landmark": lambda _: self._go(+1),
            "previous_landmark": lambda _: self._go(-1),
            "next_open_landmark": lambda _: self._go_open(),
            "sort_landmarks": lambda _: self._next_order(),
            "landmark": lambda event: self._go_to(str(event["arg"])),
        }

    def find(self) -> None:
        """Find the landmarks of the body at hand."""
        body = self.chosen
        if not body:
            raise SessionError("no body is expected in this picture; add one in the tab of the bodies.")
        self.runner.run(
            f"finding landmarks of {body}",
            lambda: self.runner.session.find_landmarks(body),
            self._summary,
        )

    def _summary(self) -> str:
        solution = self.solution
        return "" if solution is None else f"{self.chosen}: {pose_lines(solution)[0]}."

    def _choose_body(self, event: PageEvent) -> None:
        names = self.names
        if event.get("arg") in names:
            self.body = str(event["arg"])
        elif names:
            self.body = names[(names.index(self.chosen) + 1) % len(names)]

    def _focus_or_raise(self) -> str:
        if not self.focused:
            raise SessionError("no landmark was found yet: F finds them.")
        return self.focused

    def _accept(self) -> None:
        one, body = self._focus_or_raise(), self.chosen
        self.runner.run(
            "deciding",
            lambda: self.runner.session.accept_landmarks(body, [one]),
            lambda: self._gone_on(one, "accepted"),
        )

    def _ask_reason(self) -> None:
        self._focus_or_raise()
        self.runner.menu = "" if self.runner.menu == LANDMARK_MENU else LANDMARK_MENU

    def _reason(self, reason: str) -> Handler:
        return lambda _: self._reject(reason)

    def _reject(self, reason: str) -> None:
        one, body = self._focus_or_raise(), self.chosen
        self.runner.menu = ""
        self.runner.run(
            "deciding",
            lambda: self.runner.session.reject_landmarks(body, [one], reason),
            lambda: self._gone_on(one, f"rejected ({reason})"),
        )

    def _gone_on(self, one: str, decision: str) -> str:
        self.focus_id = one
        left = self._open()
        self._go_open(quiet=True)
        return f"{one} {decision}; {len(left)} undecided. {self._summary()}"

    def _open(self) -> list[str]:
        """Undecided landmarks that were measured, in the order chosen."""
        solution = self.solution
        if solution is None:
            return []
        status = dict(zip(solution.centers.id.tolist(), solution.status, strict=True))
        return [one for one in self.ids if status[one] != "not_found" and not self._decision(one)]

    def _go(self, step: int) -> None:
        ids = self.ids
        if ids:
            self._go_to(ids[(ids.index(self.focused) + step) % len(ids)])

    def _go_to(self, one: str) -> None:
        self.focus_id, self.runner.menu = one, ""

    def _go_open(self, *, quiet: bool = False) -> None:
        ids, left = self.ids, set(self._open())
        following = next_of(ids, self.focused, left) if ids else None
        if following is not None:
            self._go_to(following)
        elif not quiet:
            self.runner.status.say("no landmark is undecided.")

    def _next_order(self) -> None:
        self.order = ORDERS[(ORDERS.index(self.order) + 1) % len(ORDERS)]
        self.runner.status.say(f"landmarks by {self.order}.")


def _places(solution: LandmarkSolution) -> FloatArray:
    """Where each is seen (n, 2) px, predicted where it is not."""
    centers = solution.centers
    return np.where(np.isfinite(centers.observed_px), centers.observed_px, centers.predicted_px)


def _residuals(solution: LandmarkSolution) -> FloatArray:
    """Observed minus expected (n, 2) px: with the solved pose where there is one."""
    return solution.centers.residual_px if solution.pose is None else solution.pose.post_fit_px


def _off(solution: LandmarkSolution) -> FloatArray:
    return np.asarray(np.hypot(*_residuals(solution).T))

"""The tab of the pointing: its solution, the residuals, two stars marked by hand, and the nudge of the whole field.

Two marked stars are the way back for a picture whose field nothing has identified; their names may be left out. The table
of iterations is the paper's Table 2.
"""

from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from opnav_workbench.constants import ARCSEC_PER_RAD
from opnav_workbench.errors import SessionError
from opnav_workbench.session import ImageSession
from opnav_workbench.stars.pointing import PointingSolution
from opnav_workbench.stars.pointing.attitude_steps import POINTING_MODELS
from opnav_workbench.workbench.actions import NUDGE, TWO_STARS, ActionRegistry
from opnav_workbench.workbench.field_depth import field_depth
from opnav_workbench.workbench.markup import render
from opnav_workbench.workbench.plots import residual_plots, star_residuals, vector_plot
from opnav_workbench.workbench.recent import Recent
from opnav_workbench.workbench.tabs import ARROW_STEPS, Handler, PageEvent, StepRunner, Tab
from opnav_workbench.workbench.viewer import Layer

__all__ = ["PointingTab", "TwoStarMarks"]


# ---- Two stars marked by hand: the way back for a picture whose field nothing has identified.

CROSS_PX = 6.0


@dataclass(frozen=True, slots=True)
class TwoStarMarks:
    """The marks so far, and the names if the analyst knows them; immutable.

    Attributes
    ----------
    places : tuple of (pixel, line)
    ids : (str, str)
        Catalog ids, empty where not known.
    """

    places: tuple[tuple[float, float], ...] = ()
    ids: tuple[str, str] = ("", "")

    @property
    def complete(self) -> bool:
        """Whether both stars are marked."""
        return len(self.places) == 2

    def marked(self, pixel: float, line: float) -> "TwoStarMarks":
        """Return the marks with one more; a third begins again."""
        kept = () if self.complete else self.places
        return TwoStarMarks((*kept, (pixel, line)), self.ids)

    def back(self) -> "TwoStarMarks":
        """Return the marks without the last."""
        return TwoStarMarks(self.places[:-1], self.ids)

    def named(self, which: int, star: str) -> "TwoStarMarks":
        """Return the marks with the name of the first (0) or second (1) star."""
        names = list(self.ids)
        names[which] = star.strip()
        return TwoStarMarks(self.places, (names[0], names[1]))

    def names(self) -> list[str] | None:
        """Return both names, or None where the stars are to be found among the catalog's.

        Raises
        ------
        SessionError
            Only one star is named.
        """
        given = [star for star in self.ids if star]
        if len(given) == 1:
            raise SessionError(f"only {given[0]} is named; name both stars, or neither.")
        return given or None

    @property
    def prompt(self) -> str:
        """What to do next."""
        if self.complete:
            return "two stars are marked: Solve, or name them first if they cannot be told from others."
        return f"click the {'second' if self.places else 'first'} star in the picture."

    def layer(self) -> Layer:
        """Return crosses and numbers for the picture."""
        segments, labels = [], []
        for number, (pixel, line) in enumerate(self.places, 1):
            segments += [
                (pixel - CROSS_PX, line, pixel + CROSS_PX, line),
                (pixel, line - CROSS_PX, pixel, line + CROSS_PX),
            ]
            labels.append((pixel + CROSS_PX, line - CROSS_PX, f"star {number}"))
        return Layer(segments, ["focus"] * len(segments), labels)


# ---- The tab of the pointing.

TURN_DEG = 0.05  # of one key press: a quarter of a wrong header twist
FAR_STEP_PX = 10.0
LISTED_STARS = 60  # names offered while typing
NUDGE_PROMPT = "arrow keys move the field 1 px, with Shift 10 px; < and > turn it; F finds the stars."
RESIDUAL_PLOT_PX, VECTOR_PLOT_PX = (216, 160), 440
MODEL_WORDS = {"euler": "three angles", "image_plane": "image plane"}


class PointingTab(Tab):
    """The tab of the pointing."""

    name = "pointing"

    def __init__(self, runner: StepRunner, registry: ActionRegistry) -> None:
        super().__init__(runner, registry)
        self.marks = TwoStarMarks()
        self._plotted: Recent[Markup | None] = Recent()

    def handlers(self) -> dict[str, Handler]:
        """Return what it does, by action name."""
        nudges: dict[str, Handler] = {}
        for side, (across, down) in ARROW_STEPS.items():
            nudges[f"nudge_{side}"] = self._nudging(across, down)
            nudges[f"nudge_far_{side}"] = self._nudging(FAR_STEP_PX * across, FAR_STEP_PX * down)
        return nudges | {
            "turn_left": self._nudging(0.0, 0.0, -TURN_DEG),
            "turn_right": self._nudging(0.0, 0.0, TURN_DEG),
            "find_again": lambda _: self._find(),
            "search_sky": lambda _: self._search_sky(),
            "repoint_here": lambda _: self.runner.repoint(),
            "model": lambda _: self._next_model(),
            "two_star": lambda _: self._mark_tool(),
            "two_star_name": self._name,
            "two_star_solve": lambda _: self._solve_marked(),
            "nudge": lambda _: self.runner.toggle_tool(NUDGE, NUDGE_PROMPT),
        }

    def on_enter(self) -> None:
        """Forget marks that belong to another image."""
        if self.runner.tool != TWO_STARS:
            self.marks = TwoStarMarks()

    def draw(self) -> None:
        """Draw the two marks."""
        self.runner.viewer.focus(None)
        self.runner.viewer.layer(
            "two stars", self.marks.layer() if self.runner.tool == TWO_STARS else Layer()
        )

    def html(self) -> str:
        """Return the page."""
        session, tool = self.runner.session, self.runner.tool
        stars = session.state.a_priori
        listed = () if stars is None else stars.id[np.argsort(stars.mag)][:LISTED_STARS].tolist()
        return render(
            "pointing.html",
            actions=self.registry,
            searched=session.state.centers is not None,
            model=MODEL_WORDS[self.runner.model],
            nudging=tool == NUDGE,
            arrows=list(zip(ARROW_STEPS, "←→↑↓", strict=True)),
            field=self._field_line(),
            depth=field_depth(session),
            marking=tool == TWO_STARS,
            marks=self.marks,
            listed=listed,
            solution=solution_shown(session.state.pointing, session.state.contradictions),
            plots=self._plots(session),
        )

    def _plots(self, session: ImageSession) -> Markup | None:
        """Return the plots of the residuals, drawn once for residuals that stay as they are; None without a star in use."""
        rows = star_residuals(session)

        def drawn() -> Markup | None:
            residuals = residual_plots(rows, RESIDUAL_PLOT_PX)
            shown = {"residuals": residuals, "vectors": vector_plot(rows, VECTOR_PLOT_PX)}
            return None if residuals is None else render("pointing_plots.html", **shown)

        return self._plotted.of((rows,), drawn)

    def _field_line(self) -> str:
        found = self.runner.session.state.star_field
        if found is None:
            return "the field lies at its a priori place"
        return (
            f"field moved {found.shift_px[0]:+.1f} px, {found.shift_px[1]:+.1f} lines, "
            f"{np.degrees(found.twist_rad):+.2f}° from its a priori place"
        )

    # -- actions -----------------------------------------------------------------------------------------------

    def _find(self) -> None:
        self.runner.tool = ""
        self.runner.find_stars()

    def _search_sky(self) -> None:
        """Find the field wherever it is on the sky; what the pointing said until now is put aside."""
        self.runner.tool = ""
        session = self.runner.session

        def work() -> None:
            session.search_sky()
            if session.state.star_field is not None or session.state.pointing is not None:
                session.predict()
            session.find_stars(self.runner.search.method, search_radius_px=self.runner.search.radius_px)

        def found() -> str:
            return f"{self._field_line()}; {self.runner.found_line()}"

        self.runner.run("searching the whole sky", work, found)

    def _next_model(self) -> None:
        models = list(POINTING_MODELS)
        self.runner.model = models[(models.index(self.runner.model) + 1) % len(models)]
        if self.runner.session.state.pointing is not None:
            self.runner.repoint()
        else:
            self.runner.status.say(f"model: {MODEL_WORDS[self.runner.model]}")

    def _nudging(self, across: float, down: float, turn_deg: float = 0.0) -> Handler:
        def nudge(_: PageEvent) -> None:
            session = self.runner.session
            self.runner.run("nudging", lambda: session.nudge(across, down, turn_deg), self._field_line)

        return nudge

    def _mark_tool(self) -> None:
        self.marks = TwoStarMarks()
        self.runner.toggle_tool(TWO_STARS, self.marks.prompt)

    def _name(self, event: PageEvent) -> None:
        self.marks = self.marks.named(int(event["arg"]), str(event["value"]))

    def _solve_marked(self) -> None:
        marks = self.marks
        if not marks.complete:
            raise SessionError(marks.prompt)
        session, names = self.runner.session, marks.names()

        def work() -> None:
            session.two_star_pointing(marks.places, names, "marked in the picture")
            session.find_stars()
            self.runner.tool = ""

        self.runner.run(
            "solving from two stars", work, lambda: f"{self._field_line()}; P solves the pointing."
        )

    def tapped(self, pixel: float, line: float) -> None:
        """Mark a star."""
        if self.runner.tool == TWO_STARS:
            self.marks = self.marks.marked(pixel, line)
            self.runner.status.say(self.marks.prompt)

    def drop_unfinished(self) -> bool:
        """Take back the last mark."""
        if self.runner.tool != TWO_STARS or not self.marks.places:
            return False
        self.marks = self.marks.back()
        return True


@dataclass(frozen=True, slots=True)
class SolutionShown:
    """The solution as the page shows it: one line, its messages, and its iterations (the paper's Table 2).

    Attributes
    ----------
    rows : list of (name, pixel, line, twist)
        Each iteration and the sum; px, lines, deg.
    """

    line: str
    messages: tuple[str, ...]
    rows: list[tuple[str, float, float, float]]


def solution_shown(
    pointing: PointingSolution | None, contradictions: tuple[str, ...] = ()
) -> SolutionShown | None:
    """Return the solution, and what contradicts it in the header, as the page shows it; None where the a priori stands."""
    if pointing is None:
        return None
    sigma = ARCSEC_PER_RAD * np.sqrt(np.diag(pointing.covariance_rad2))
    line = (
        f"RA {np.degrees(pointing.ra_rad):.5f}°, Dec {np.degrees(pointing.dec_rad):+.5f}°, "
        f"twist {np.degrees(pointing.twist_rad):.4f}°; sigma about the camera's x, y, z "
        f"{sigma[0]:.2g}, {sigma[1]:.2g}, {sigma[2]:.2g} arcsec; {pointing.rests_on}"
    )
    moves = [(i.delta_pixel, i.delta_line, i.delta_twist_rad) for i in pointing.iterations]
    total = (pointing.delta_pixel, pointing.delta_line, pointing.delta_twist_rad)
    named = [*((str(number), move) for number, move in enumerate(moves, 1)), ("sum", total)]
    rows = [(name, pixel, lines, float(np.degrees(twist))) for name, (pixel, lines, twist) in named]
    return SolutionShown(line, (*contradictions, *pointing.messages), rows)

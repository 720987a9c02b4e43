"""The tab of the pointing: its solution, the residuals, two stars marked by hand, and the nudge of the whole field.

Two marked stars are the way back for a picture whose field nothing has identified; their names may be left out. The table
of iterations is the paper's Table 2.
"""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.constants import ARCSEC_PER_RAD
from opnav_workbench.errors import SessionError
from opnav_workbench.stars.pointing import PointingSolution
from opnav_workbench.stars.pointing.attitude_steps import POINTING_MODELS
from opnav_workbench.workbench.actions import ActionRegistry
from opnav_workbench.workbench.markup import text
from opnav_workbench.workbench.plots import residual_plots, star_residuals, vector_plot
from opnav_workbench.workbench.tabs import ARROW_STEPS, Handler, PageEvent, StepRunner, Tab
from opnav_workbench.workbench.viewer import Layer

__all__ = ["PointingTab", "TwoStarMarks"]


# ---- Two stars marked by hand: the way back for a frame whose field nothing has identified.

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


# ---- The tab of the pointing: its solution, the residuals, two stars marked by hand, and the nudge of the ...

TURN_DEG = 0.05  # of one key press: a quarter of a wrong header twist
FAR_STEP_PX = 10.0
LISTED_STARS = 60  # names offered while typing
MODEL_WORDS = {"euler": "three angles", "image_plane": "image plane"}


class PointingTab(Tab):
    """The tab of the pointing."""

    name = "pointing"

    def __init__(self, bench: StepRunner, registry: ActionRegistry) -> None:
        super().__init__(bench, registry)
        self.marks = TwoStarMarks()

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
            "repoint_here": lambda _: self.bench.repoint(),
            "model": lambda _: self._next_model(),
            "two_star": lambda _: self._mark_tool(),
            "two_star_name": self._name,
            "two_star_solve": lambda _: self._solve_marked(),
            "nudge": lambda _: self._nudge_tool(),
        }

    def entered(self) -> None:
        """Forget marks that belong to another image."""
        if self.bench.tool != "two_star":
            self.marks = TwoStarMarks()

    def draw(self) -> None:
        """Draw the two marks."""
        self.bench.viewer.focus(None)
        self.bench.viewer.layer("two stars", self.marks.layer() if self.bench.tool == "two_star" else Layer())

    def html(self) -> str:
        """Return the page."""
        session = self.bench.session
        rows = star_residuals(session)
        tools = (
            self.button("find_again")
            + self.button("repoint_here", enabled=session.state.centers is not None)
            + self.button("model", label=f"Model: {MODEL_WORDS[self.bench.model]}")
            + self.button("nudge", on=self.bench.tool == "nudge")
            + self.button("two_star", on=self.bench.tool == "two_star")
        )
        return (
            f'<div class="page pointing"><div class="tools">{tools}</div>{self._tool_html()}'
            f"{solution_html(session.state.pointing)}{residual_plots(rows, (216, 160), y_label='')}"
            f"{vector_plot(rows, 440)}</div>"
        )

    def _tool_html(self) -> str:
        if self.bench.tool == "nudge":
            keys = "".join(
                self.button(f"nudge_{side}", label=arrow)
                for side, arrow in zip(ARROW_STEPS, "←→↑↓", strict=True)
            )
            turns = self.button("turn_left", label="−0.05°") + self.button("turn_right", label="+0.05°")
            return (
                f'<div class="tool"><b>Nudge</b> {keys}{turns}<span>{text(self._field_line())}</span></div>'
            )
        if self.bench.tool != "two_star":
            return ""
        stars = self.bench.session.state.a_priori
        listed = [] if stars is None else stars.id[np.argsort(stars.mag)][:LISTED_STARS].tolist()
        options = "".join(f'<option value="{text(star)}">' for star in listed)
        fields = "".join(
            f'<input data-act="two_star_name" data-arg="{which}" list="opnav-stars" size="14" '
            f'placeholder="name of star {which + 1}" value="{text(self.marks.ids[which])}">'
            for which in (0, 1)
        )
        solve = (
            '<button type="button" data-act="two_star_solve">Solve</button>' if self.marks.complete else ""
        )
        return (
            f'<div class="tool"><b>Two stars</b> <span>{text(self.marks.prompt)}</span>'
            f'<datalist id="opnav-stars">{options}</datalist><span class="join">{fields}</span>{solve}</div>'
        )

    def _field_line(self) -> str:
        found = self.bench.session.state.star_field
        if found is None:
            return "the field lies at its a priori place"
        return (
            f"field moved {found.shift_px[0]:+.1f} px, {found.shift_px[1]:+.1f} lines, "
            f"{np.degrees(found.twist_rad):+.2f}° from its a priori place"
        )

    # -- actions -----------------------------------------------------------------------------------------------

    def _find(self) -> None:
        self.bench.tool = ""
        session = self.bench.session

        def said() -> str:
            used = int(session.state.mask("used").sum())
            return f"{used} stars found. {' '.join(session.state.notes.get('stars', ()))}".strip()

        self.bench.run("finding stars", session.find_stars, said)

    def _next_model(self) -> None:
        models = list(POINTING_MODELS)
        self.bench.model = models[(models.index(self.bench.model) + 1) % len(models)]
        if self.bench.session.state.pointing is not None:
            self.bench.repoint()
        else:
            self.bench.status.say(f"model: {MODEL_WORDS[self.bench.model]}")

    def _nudge_tool(self) -> None:
        self.bench.tool = "" if self.bench.tool == "nudge" else "nudge"
        if self.bench.tool:
            self.bench.status.say(
                "arrow keys move the field 1 px, with Shift 10 px; < and > turn it; F finds the stars."
            )

    def _nudging(self, across: float, down: float, turn_deg: float = 0.0) -> Handler:
        def nudge(_: PageEvent) -> None:
            session = self.bench.session
            self.bench.run("nudging", lambda: session.nudge(across, down, turn_deg), self._field_line)

        return nudge

    def _mark_tool(self) -> None:
        self.bench.tool = "" if self.bench.tool == "two_star" else "two_star"
        self.marks = TwoStarMarks()
        if self.bench.tool:
            self.bench.status.say(self.marks.prompt)

    def _name(self, event: PageEvent) -> None:
        self.marks = self.marks.named(int(event["arg"]), str(event["value"]))

    def _solve_marked(self) -> None:
        marks = self.marks
        if not marks.complete:
            raise SessionError(marks.prompt)
        session, names = self.bench.session, marks.names()

        def work() -> None:
            session.two_star_pointing(marks.places, names, "marked in the picture")
            session.find_stars()
            self.bench.tool = ""

        self.bench.run(
            "solving from two stars", work, lambda: f"{self._field_line()}; P solves the pointing."
        )

    def tapped(self, pixel: float, line: float) -> None:
        """Mark a star."""
        if self.bench.tool == "two_star":
            self.marks = self.marks.marked(pixel, line)
            self.bench.status.say(self.marks.prompt)

    def abandon(self) -> bool:
        """Take back the last mark."""
        if self.bench.tool != "two_star" or not self.marks.places:
            return False
        self.marks = self.marks.back()
        return True


def solution_html(pointing: PointingSolution | None) -> str:
    """Return the solution and its iterations as a table (the paper's Table 2)."""
    if pointing is None:
        return '<p class="hint">No pointing is solved: the a priori one stands.</p>'
    sigma = ARCSEC_PER_RAD * np.sqrt(np.diag(pointing.covariance_rad2))
    head = (
        f'<p class="solution">RA {np.degrees(pointing.ra_rad):.5f}°, Dec {np.degrees(pointing.dec_rad):+.5f}°, '
        f"twist {np.degrees(pointing.twist_rad):.4f}°; sigma about the camera's x, y, z "
        f"{sigma[0]:.2g}, {sigma[1]:.2g}, {sigma[2]:.2g} arcsec; {pointing.n_stars} stars, rms {pointing.rms_px:.3f} px</p>"
    )
    said = "".join(f'<p class="hint">{text(message)}</p>' for message in pointing.messages)
    steps = [
        (i.delta_pixel, i.delta_line, i.delta_twist_rad, str(n)) for n, i in enumerate(pointing.iterations, 1)
    ]
    total = (pointing.delta_pixel, pointing.delta_line, pointing.delta_twist_rad, "sum")
    rows = "".join(
        f"<tr><td>{name}</td><td>{pixel:+.4f}</td><td>{line:+.4f}</td><td>{np.degrees(twist):+.5f}</td></tr>"
        for pixel, line, twist, name in [*steps, total]
    )
    return (
        f"{head}{said}<table><thead><tr><th>iteration</th><th>pixel</th><th>line</th><th>twist, deg</th></tr></thead>"
        f"<tbody>{rows}</tbody></table>"
    )

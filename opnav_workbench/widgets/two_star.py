"""Two stars marked by hand: the way back for a frame whose field nothing has identified."""

from dataclasses import dataclass

from opnav_workbench.errors import SessionError
from opnav_workbench.widgets.workbench_viewer import Layer

__all__ = ["TwoStarMarks"]

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

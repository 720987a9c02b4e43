"""The part of `ImageSession` that deals with stars and the pointing."""

import time
from collections.abc import Sequence

from opnav_workbench.errors import SessionError
from opnav_workbench.scene import StarPrediction
from opnav_workbench.session.core import SessionCore
from opnav_workbench.session.marking import all_stars, unknown_stars
from opnav_workbench.session.nudging import reach_px
from opnav_workbench.session.star_boxes import StarBox, star_boxes

__all__ = ["StarMethods"]


def _names(ids: Sequence[str]) -> list[str]:
    # A single name is a sequence too, of letters; nobody means those.
    return [ids] if isinstance(ids, str) else [str(star) for star in ids]


class StarMethods(SessionCore):
    """Steps with stars: predict, find, decide, move the field, repoint."""

    def predict(self) -> StarPrediction:
        """Predict catalog stars around the a priori field; drops what was found before, but no decision."""
        self._step("predict", {})
        assert self.state.a_priori is not None
        return self.state.a_priori

    def find_stars(
        self,
        initial: str = "matched_filter",
        final: str = "least_squares",
        search_radius_px: float | None = None,
    ) -> None:
        """Identify the field and fit the star centers; with a solved pointing the search is around it.

        A field that is not identified for sure within the limits of the a priori pointing is searched farther out
        (see `Settings`), in a cone of the catalog that grows with it.

        Parameters
        ----------
        initial : {"matched_filter", "cross_correlation"}
        final : {"least_squares", "psf_fit", "matched_filter", "cross_correlation"}
            ``psf_fit`` takes the camera's own PSF, such as one of ``opnav calibrate psf``.
        search_radius_px : float, optional
            How far from its expected place a star may lie; default from the settings.
        """
        parameters = {"initial": initial, "final": final, "search_radius_px": search_radius_px}
        with self.lock:
            began = time.perf_counter()
            state = self._history.tried("find_stars", parameters)
            if (state.star_field is None or not state.star_field.sure) and self._widen():
                state = self._history.tried("find_stars", parameters)
            self._record("find_stars", parameters, state, cost_s=time.perf_counter() - began)

    def refit_stars(
        self,
        ids: Sequence[str] | None = None,
        *,
        initial: str = "matched_filter",
        final: str = "least_squares",
        search_radius_px: float | None = None,
        template: str | None = None,
    ) -> None:
        """Fit some stars again at once, or all, without identifying the field again.

        Parameters
        ----------
        ids : sequence of str, optional
            Catalog ids; None: all.
        initial, final, search_radius_px
            As in `find_stars`.
        template : str, optional
            The star whose image is the template of the matched filter; by default a well-exposed one.

        Raises
        ------
        SessionError
            No stars are found yet, an unknown star or method.
        """
        parameters = {
            "ids": None if ids is None else _names(ids),
            "initial": initial,
            "final": final,
            "search_radius_px": search_radius_px,
            "template": template,
        }
        self._step("refit_stars", parameters)

    def place_star(self, star_id: str, pixel_line: Sequence[float]) -> None:
        """Fit a catalog star where the analyst sees it, and accept it.

        Parameters
        ----------
        star_id : str
            A predicted star, or any other of the catalog around the field.
        pixel_line : (float, float)
            Where it is seen; the fit looks within a few pixels.

        Raises
        ------
        SessionError
            No stars are predicted yet, an unknown star, or a place off the detector.
        """
        place = [float(value) for value in pixel_line]
        if len(place) != 2:
            raise SessionError(f"a place is (pixel, line), got {place}.")
        self._step("place_star", {"id": str(star_id), "place": place})

    def reject_stars(self, ids: Sequence[str], reason: str) -> None:
        """Reject stars by catalog id; the reason stands in the journal and in the result.

        Raises
        ------
        SessionError
            No stars are predicted yet, or there is no star of that id.
        """
        self._step("reject_stars", {"ids": _names(ids), "reason": reason}, reason)

    def accept_stars(self, ids: Sequence[str], reason: str = "") -> None:
        """Accept stars by catalog id, outranking any automatic rejection; raises as `reject_stars`."""
        self._step("accept_stars", {"ids": _names(ids), "reason": reason}, reason)

    def star_boxes(self, ids: Sequence[str] | None = None) -> tuple[StarBox, ...]:
        """Return what a person looks at to judge the stars: data, model and residual around each.

        Parameters
        ----------
        ids : sequence of str, optional
            By default all stars expected on the detector, in the order of `state.a_priori`.

        Raises
        ------
        SessionError
            No stars are predicted yet, or there is no star of that id.
        """
        return star_boxes(self.context, self.inputs, self.state, None if ids is None else _names(ids))

    # -- the field ---------------------------------------------------------------------------------------------

    def two_star_pointing(
        self, places: Sequence[Sequence[float]], ids: Sequence[str] | None = None, reason: str = ""
    ) -> None:
        """Solve shift and twist of the field from two stars that the analyst marks; go on with `find_stars`.

        Parameters
        ----------
        places : two (pixel, line)
            Marked places; each means the nearest detection, or itself where there is none.
        ids : two str, optional
            Catalog ids of the marked stars; without them they are looked for among the stars around the field, any
            twist.
        reason : str
            For the journal.

        Raises
        ------
        SessionError, CenterfindingError
            No stars are predicted yet, an id is unknown, the places do not fit the stars' separation, or stars that
            are not named cannot be told from others.
        """
        marks = [[float(value) for value in place] for place in places]
        names = None if ids is None else [str(star) for star in ids]
        if len(marks) != 2 or (names is not None and len(set(names)) != 2):
            raise SessionError(f"two stars must be marked, got {len(marks)} places and ids {names}.")
        with self.lock:
            if names is None or unknown_stars(self.inputs, names):
                self._widen()
            self._step("two_star_pointing", {"places": marks, "ids": names}, reason)

    def nudge(self, delta_pixel: float, delta_line: float, delta_twist_deg: float = 0.0) -> None:
        """Move the predicted field by hand; nudges add up, and `find_stars` then searches there.

        Centers and pointing found before are dropped.

        Parameters
        ----------
        delta_pixel, delta_line : float
            How far the field moves on the detector, px.
        delta_twist_deg : float
            How far it turns about the boresight, from +pixel toward +line.

        Raises
        ------
        SessionError
            No stars are predicted yet, or the field would leave what the camera model covers.
        """
        parameters = {
            "delta_pixel": float(delta_pixel),
            "delta_line": float(delta_line),
            "delta_twist_deg": float(delta_twist_deg),
        }
        with self.lock:
            if (
                reach_px(self.context, self.inputs, self.state, parameters)
                > self.context.settings.max_shift_px
            ):
                self._widen()
            self._step("nudge", parameters)

    def repoint(self, model: str = "euler", *, a_priori: bool = False, reason: str = "") -> None:
        """Solve the camera attitude from the stars in use.

        Parameters
        ----------
        model : {"euler", "image_plane"}
        a_priori : bool
            Take the a priori attitude as a measurement too, with the camera's ``attitude_sigma``; where the field was
            found far from it, it does not count.
        reason : str
            For the journal.
        """
        self._step("repoint", {"model": model} | ({"a_priori": True} if a_priori else {}), reason)

    def known_stars(self) -> tuple[str, ...]:
        """Return the ids of all catalog stars at hand, predicted in the picture or not."""
        return tuple(all_stars(self.inputs).id.tolist())

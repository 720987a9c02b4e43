"""The part of `ImageSession` that deals with target bodies and their observables."""

from collections.abc import Sequence
from typing import Any

from astropy.table import QTable

from opnav_workbench.errors import OpNavError, SessionError
from opnav_workbench.observables import observables_table
from opnav_workbench.scene import BodyPrediction, predict_body
from opnav_workbench.session.body_finding import shown_target
from opnav_workbench.session.core import SessionCore
from opnav_workbench.spice import KernelSet

__all__ = ["BodyMethods"]

PLACE = 2  # numbers of a place


class BodyMethods(SessionCore):
    """Steps with bodies: expect, circle, find, choose scans, observables."""

    def add_target(self, name: str) -> None:
        """Take a body or target star into the predicted scene, so that identification expects it there.

        Bodies found before are found again with its light and shadow.

        Parameters
        ----------
        name : str
            SPICE body name, or a star of the target list.

        Raises
        ------
        KernelError
            Neither kernels nor the star list know it.
        """
        with self.lock:
            self._gather_target(name)
            if name not in self.state.targets:
                self._step("add_target", {"name": name})

    def predict_body(self, name: str) -> BodyPrediction:
        """Return where and how large a target is expected with the best known pointing; no step of the session.

        Raises
        ------
        KernelError
            Neither kernels nor the star list know it.
        """
        with self.lock:
            self._gather_target(name)
        target = shown_target(self.context, self.inputs, name)
        return predict_body(target, self.inputs.observer, self.context.camera, self.camera_from_j2000)

    def skip_target(self, name: str, reason: str) -> None:
        """Record that a requested target is left out, and why; the result's status then is ``partial``."""
        self._step("skip_target", {"name": name, "reason": reason}, reason)

    def find_body(
        self,
        name: str,
        method: str = "auto",
        search_radius_px: float | None = None,
        *,
        circle: Sequence[float] | None = None,
        scans: Sequence[int] | None = None,
        solve_range: bool = False,
    ) -> None:
        """Find a body's center.

        Parameters
        ----------
        name : str
            SPICE body name, or a star of the target list.
        method : {"auto", "unresolved", "cross_correlation", "least_squares", "limb_scan", "ellipse"}
            ``auto`` takes what suits the body's size and what is known of its surface.
        search_radius_px : float, optional
            How far from its expected place it may be; default from the predicted uncertainty and its size.
        circle : (pixel, line, radius), optional
            Where it is seen, for this search; default the analyst's circle (`set_circle`), else the predicted one.
        scans : sequence of int, optional
            Numbers of the limb scans to use; default the analyst's choice (`choose_scans`), else automatic.
        solve_range : bool
            Solve for the range (apparent size), too, where the method can.
        """
        parameters: dict[str, Any] = {
            "name": name,
            "method": method,
            "search_radius_px": search_radius_px,
        }
        if circle is not None:
            parameters["circle"] = _circle(circle)
        if scans is not None:
            parameters["scans"] = [int(number) for number in scans]
        if solve_range:
            parameters["solve_range"] = True
        with self.lock:
            self._gather_target(name)
            self._step("find_body", parameters | self._scene())

    def find_bodies(self, names: Sequence[str], method: str = "least_squares") -> None:
        """Find several bodies at once, with the correlation of their centers.

        Parameters
        ----------
        names : sequence of str
        method : {"least_squares"}
        """
        if isinstance(names, str) or len(set(names)) < 2:
            raise SessionError(f"name two bodies or more, got {names!r}.")
        with self.lock:
            for name in names:
                self._gather_target(name)
            self._step("find_bodies", {"names": [str(n) for n in names], "method": method} | self._scene())

    def set_circle(self, name: str, center_px: Sequence[float], radius_px: float) -> None:
        """Say where a body is seen, and how large: every method for extended bodies starts from there.

        Parameters
        ----------
        name : str
        center_px : (float, float)
            (pixel, line); it may lie off the detector.
        radius_px : float
        """
        pixel, line, radius = _circle([*center_px, radius_px])
        with self.lock:
            self._gather_target(name)
            self._step("set_circle", {"name": name, "center_px": [pixel, line], "radius_px": radius})

    def clear_circle(self, name: str) -> None:
        """Forget the circle of a body: the predicted one counts again.

        Raises
        ------
        SessionError
            It has none.
        """
        if name not in self.state.circles:
            raise SessionError(f"{name} has no circle to clear; set_circle() gives it one.")
        self._step("clear_circle", {"name": name})

    def choose_scans(self, name: str, numbers: Sequence[int] | None, reason: str = "") -> None:
        """Choose the limb scans of a body by their numbers; a limb-scan center that stands is made anew.

        Parameters
        ----------
        name : str
        numbers : sequence of int or None
            None: automatic again.
        reason : str
            For the journal and the decisions.
        """
        chosen = None if numbers is None else sorted({int(number) for number in numbers})
        with self.lock:
            self._gather_target(name)
            self._step("choose_scans", {"name": name, "numbers": chosen, "reason": reason}, reason)

    def observables(self) -> QTable:
        """Compute the observables of all bodies found so far.

        Returns
        -------
        astropy.table.QTable
            One row a body and method: O, C, O-C, sigmas, partials, with units and descriptions.
        """
        self._step("observables", {})
        return observables_table(self.state.observables)

    def _scene(self) -> dict[str, Any]:
        """Name the mission's bodies that may hide, shade or outshine the one that is looked for."""
        names = []
        for name in self.context.mission.default_targets:
            if name not in self.inputs.targets and KernelSet.active() is not None:
                try:
                    self._gather_target(name)
                except OpNavError:
                    continue  # nothing is known of it: it is not in the scene
            if name in self.inputs.targets:
                names.append(name)
        return {"scene": names} if names else {}


def _circle(values: Sequence[float]) -> list[float]:
    numbers = [float(value) for value in values]
    if len(numbers) != PLACE + 1:
        raise SessionError(f"a circle is (pixel, line, radius), got {numbers}.")
    return numbers

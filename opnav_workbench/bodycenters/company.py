"""Several bodies in one picture: whom to search in which order, whom to fit together, whose pixels to leave out."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.bodycenters.circle import Circle
from opnav_workbench.bodycenters.cutout import Cutout, cut_out
from opnav_workbench.bodycenters.expectation import Expectation, Found, expect, find_place, reach_px
from opnav_workbench.bodycenters.model_picture import model_picture
from opnav_workbench.bodycenters.picture import BodyPicture
from opnav_workbench.bodycenters.results import BodyCenter
from opnav_workbench.bodycenters.subarray import PSF_REACH, RIM_PX

__all__ = ["Company", "Search", "find_company", "fit_pixels"]

NEIGHBOUR_ERROR_PX = 2.0  # of a neighbour's place, once the picture's common shift is known


@dataclass(frozen=True, slots=True)
class Search:
    """How bodies are to be searched."""

    method: str
    circles: Mapping[str, Circle]
    solve_range: bool = False
    search_radius_px: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Company:
    """Bodies that were found, and what became of the others.

    Attributes
    ----------
    found : mapping of str to Found
    missed : mapping of str to BodyCenter
        Those without a center, and why.
    overlapping : mapping of str to (2,) array
        Bodies that were not asked for and touch one that was found, at their likely places.
    apart : mapping of str to (2,) array
        Others in the scene, at their likely places.
    """

    found: Mapping[str, Found]
    missed: Mapping[str, BodyCenter]
    overlapping: Mapping[str, FloatArray]
    apart: Mapping[str, FloatArray]


def find_company(picture: BodyPicture, names: Sequence[str], search: Search) -> Company:
    """Find bodies, the largest first: its shift against the prediction is expected of the others too."""
    expected: dict[str, Expectation] = {}
    missed: dict[str, BodyCenter] = {}
    for name in names:
        answer = expect(picture, name, search.method, search.circles.get(name), search.search_radius_px)
        if isinstance(answer, BodyCenter):
            missed[name] = answer
        else:
            expected[name] = answer
    found: dict[str, Found] = {}
    shift = np.zeros(2)
    for name in sorted(expected, key=lambda name: -expected[name].radius_px):
        task = expected[name]
        if found and name not in search.circles:
            task = replace(task, center_px=task.center_px + shift)
        light = _light_of(picture, found.values()) if found else None
        result = find_place(picture, task, search.method, solve_range=search.solve_range, subtract_dn=light)
        if isinstance(result, BodyCenter):
            missed[name] = result
            continue
        if not found:
            shift = result.place.center_px - picture.center_px(name)
        found[name] = result
    others = {
        model.target.name: picture.center_px(model.target.name) + shift
        for model in picture.models
        if model.target.name not in names
    }
    touching = _touching(picture, found, others)
    return Company(
        found,
        missed,
        {name: place for name, place in others.items() if name in touching},
        {name: place for name, place in others.items() if name not in touching},
    )


def _light_of(picture: BodyPicture, found: Iterable[Found]) -> FloatArray:
    window = (0, 0, picture.camera.n_pixel, picture.camera.n_line)
    light = np.zeros((window[3], window[2]))
    for body in found:
        name = body.expectation.name
        scale = body.place.scale
        light += scale * model_picture(picture, window, {name: body.place.center_px}, only=(name,))
    return light


def _spread_px(picture: BodyPicture) -> float:
    return PSF_REACH * float(np.max(picture.psf.sigma_px))


def _touching(picture: BodyPicture, found: Mapping[str, Found], others: Mapping[str, FloatArray]) -> set[str]:
    """Return which of the others hide a body that was found, or mix their light with it."""
    touching = set()
    for name, place in others.items():
        for body in found.values():
            apart = float(np.hypot(*(place - body.place.center_px)))
            reach = reach_px(picture, name) + body.expectation.radius_px + 2.0 * _spread_px(picture)
            if apart < reach + NEIGHBOUR_ERROR_PX:
                touching.add(name)
    return touching


def fit_pixels(picture: BodyPicture, company: Company) -> Cutout | None:
    """Return the pixels about the bodies that are fitted together, without those of other bodies; None: there are none."""
    spread = _spread_px(picture)
    circles = [
        (body.place.center_px, _final_reach(body) + spread + RIM_PX) for body in company.found.values()
    ]
    circles += [
        (place, reach_px(picture, name) + spread + RIM_PX) for name, place in company.overlapping.items()
    ]
    size = np.array([picture.camera.n_pixel, picture.camera.n_line])
    low = np.stack([center - reach for center, reach in circles]).min(axis=0)
    high = np.stack([center + reach for center, reach in circles]).max(axis=0)
    first = np.clip(np.floor(low), 0, size).astype(int)
    last = np.clip(np.ceil(high), -1, size - 1).astype(int)
    count = np.maximum(last - first + 1, 0)
    if np.min(count) < 1:
        return None
    cutout = cut_out(picture, (int(first[0]), int(first[1]), int(count[0]), int(count[1])))
    line, pixel = np.ogrid[: cutout.use.shape[0], : cutout.use.shape[1]]

    def near(center: FloatArray, reach: float, *, square: bool) -> BoolArray:
        across, down = np.abs(pixel + first[0] - center[0]), np.abs(line + first[1] - center[1])
        return np.asarray(np.maximum(across, down) <= reach if square else np.hypot(across, down) <= reach)

    use = np.zeros(cutout.use.shape, dtype=bool)
    for center, reach in circles:
        use |= near(center, reach, square=True)
    for name, place in company.apart.items():
        if np.isfinite(place).all():
            use &= ~near(place, reach_px(picture, name) + spread + NEIGHBOUR_ERROR_PX, square=False)
    return replace(cutout, use=cutout.use & use)


def _final_reach(body: Found) -> float:
    """Return how far from its center a body may reach: an analyst's circle or its image may be the larger."""
    ratio = body.expectation.circle_ratio
    return body.expectation.radius_px * max(ratio if np.isfinite(ratio) else 1.0, body.size_ratio, 1.0)

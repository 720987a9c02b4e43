"""Which bodies a picture shows, where and of what figure; which of them are fitted together, and to which pixels.

Flow   the largest body first -> its place, its disk (`opnav_workbench.bodies.disk.measurement`) -> its shift against the
       prediction is expected of the others too -> others that touch what was found, to be rendered along -> groups whose
       pixels touch -> their pixels
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse.csgraph import connected_components

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.bodies.disk.columns import FIGURE
from opnav_workbench.bodies.disk.measurement import (
    ALIKE_SIGMAS,
    MeasuredDisk,
    disk_at,
    placed_body,
    sigmas_apart,
    with_true_sky,
)
from opnav_workbench.bodies.neighbours import likely_place, near_bodies
from opnav_workbench.bodies.picture import BodyPicture, Circle, model_picture, standing_at
from opnav_workbench.bodies.place import BodyPlace
from opnav_workbench.bodies.residuals import surface_excess
from opnav_workbench.bodies.results import BodyCenter, BodyFlag
from opnav_workbench.bodies.scene_fit import SceneFit, SceneState
from opnav_workbench.bodies.strained import strained_picture
from opnav_workbench.bodies.subarray import Cutout, choose_subarray, cut_out, edge_reach, outline_radius_px

__all__ = [
    "DetectedScene",
    "FoundBody",
    "SearchRequest",
    "detect_bodies",
    "fit_figures",
    "fit_pixels",
    "groups_in_contact",
    "start_state",
]


# ---- A body that is there.

SATURATED_SHARE = 0.9  # of the bright part of a body: what is left shows no edge
BRIGHT_SHARE = 0.3  # of the peak: pixels that count as the body


@dataclass(frozen=True, slots=True)
class SearchRequest:
    """How bodies are looked for.

    Attributes
    ----------
    known_surfaces
        Bodies whose model is truer than the likelihood of their disk.
    """

    method: str
    circles: Mapping[str, Circle] = field(default_factory=dict)
    search_radius_px: float | None = None
    known_surfaces: Collection[str] = ()


@dataclass(frozen=True, slots=True, eq=False)
class FoundBody:
    """Where a body stands, and of what figure.

    Attributes
    ----------
    circle, search_px
        Where it was looked for; None: at its predicted place, anywhere.
    disk
        The likelihood of its disk; in its stead why there is none, or None for a known surface.
    of_disk
        Whether it is rendered with size and axes of its disk, instead of its model's.
    """

    name: str
    circle: Circle | None
    search_px: float | None
    place: BodyPlace
    disk: MeasuredDisk | BodyCenter | None
    of_disk: bool = False

    @property
    def measured(self) -> MeasuredDisk | None:
        """Its disk, where that could be measured."""
        return self.disk if isinstance(self.disk, MeasuredDisk) else None

    @property
    def center_px(self) -> FloatArray:
        """Its center (2,), as far as is known before its light is fitted."""
        return self.place.center_px if self.measured is None else self.measured.fit.center_px

    @property
    def is_another(self) -> bool:
        """Whether its disk speaks against size or axes of the model."""
        if self.measured is None:
            return False
        fit = self.measured.fit
        covariance = fit.excess * fit.solution.covariance[np.ix_(FIGURE, FIGURE)]
        beyond = np.array([fit.shape.log_size, *fit.shape.strain[:2]])
        return sigmas_apart(beyond, covariance) > ALIKE_SIGMAS

    @property
    def seen_log_size(self) -> tuple[float, float]:
        """Logarithm of the size of its image over the model's, and its sigma."""
        if self.measured is None:
            return float(np.log(self.place.seen_ratio)), self.place.seen_sigma
        return self.measured.log_size


def _found_body(
    picture: BodyPicture, name: str, circle: Circle | None, search: SearchRequest
) -> FoundBody | BodyCenter:
    """Find a body and measure its disk, or say why it is not seen."""
    search_px = search.search_radius_px
    place = placed_body(picture, name, search.method, circle, search_px)
    if isinstance(place, BodyCenter):
        return place
    share = _saturated_share(picture, name, place)
    if share > SATURATED_SHARE:
        message = f"{100 * share:.0f} % of it is saturated; take a shorter exposure"
        return BodyCenter.without_center(
            name, search.method, "saturated", message, flags=int(BodyFlag.OVEREXPOSED)
        )
    if name in search.known_surfaces:
        return FoundBody(name, circle, search_px, place, None)
    disk = disk_at(picture, place, name, search.method, circle, search_px)
    return FoundBody(name, circle, search_px, place, disk)


def _saturated_share(picture: BodyPicture, name: str, place: BodyPlace) -> float:
    """Return the share of a body's bright part that is saturated."""
    radius = outline_radius_px(picture, name) * place.size_ratio
    part = choose_subarray(picture, name, Circle(place.center_px, radius))
    if part.empty or not picture.overexposed[part.slices].any():
        return 0.0
    light = model_picture(
        picture, part.window, {name: place.center_px}, range_scale=1.0 / place.size_ratio, only=(name,)
    )
    bright = light > BRIGHT_SHARE * light.max()
    return float(picture.overexposed[part.slices][bright].mean()) if bright.any() else 0.0


# ---- Several bodies in one picture.


@dataclass(frozen=True, slots=True, eq=False)
class DetectedScene:
    """Bodies that were found, and what became of the others.

    Attributes
    ----------
    picture
        With its sky made sure of, and bodies strained that are rendered as their disks are.
    missed
        Those without a center, and why.
    overlapping : mapping of str to (2,) array
        Bodies that were not asked for and touch one that was found, at their likely places.
    apart : mapping of str to (2,) array
        Others in the scene, at their likely places.
    """

    picture: BodyPicture
    found: Mapping[str, FoundBody]
    missed: Mapping[str, BodyCenter]
    overlapping: Mapping[str, FloatArray]
    apart: Mapping[str, FloatArray]

    def as_seen(self, names: Collection[str]) -> "DetectedScene":
        """Return the scene with some of its bodies as large as their disks, and of the same axes."""
        picture, found = self.picture, dict(self.found)
        for name in names:
            disk = found[name].measured
            if disk is not None:
                picture = strained_picture(picture, name, disk.fit.shape.strain)
                found[name] = replace(found[name], of_disk=True)
        return replace(self, picture=picture, found=found)


def fit_figures(
    detected: DetectedScene, fit: Callable[[DetectedScene], SceneFit]
) -> tuple[DetectedScene, SceneFit]:
    """Return a scene and its fit, bodies with the figures of their disks where the picture needs others than the models'.

    Light that its model explains needs none, whatever a disk of few pixels says. Of light that none explains the limb is
    the better judge: law and albedo may well be those of another figure.
    """
    first = fit(detected)
    light = [scale * each for scale, each in zip(first.state.scales, first.light.each, strict=True)]
    other = [
        name
        for (name, body), own in zip(detected.found.items(), light[: len(detected.found)], strict=True)
        if body.is_another and surface_excess(first.residual_dn, first.weight, own).significant
    ]
    if not other:
        return detected, first
    seen = detected.as_seen(other)
    return seen, fit(seen)


def detect_bodies(picture: BodyPicture, names: Sequence[str], search: SearchRequest) -> DetectedScene:
    """Find bodies, the largest first: its shift against the prediction is expected of the others too."""
    found: dict[str, FoundBody] = {}
    missed: dict[str, BodyCenter] = {}
    seen, shift = with_true_sky(picture), np.zeros(2)
    scene = [model.target.name for model in picture.models]
    for name in sorted(names, key=lambda name: -outline_radius_px(picture, name)):
        circle = search.circles.get(name)
        standing = {other: body.center_px for other, body in found.items()}
        expected = {other: likely_place(picture, other, shift) for other in scene} if found else {}
        body = _found_body(standing_at(seen, expected | standing, standing), name, circle, search)
        if isinstance(body, BodyCenter):
            missed[name] = body
            continue
        if not found:
            shift = body.center_px - picture.center_px(name)
        found[name] = body
    touching = {
        name: place
        for body in found.values()
        for name, place in near_bodies(picture, body.name, body.center_px).items()
        if name not in names
    }
    apart = {
        name: likely_place(picture, name, shift)
        for name in scene
        if name not in names and name not in touching
    }
    return DetectedScene(seen, found, missed, touching, apart)


def start_state(detected: DetectedScene, *, solve_range: bool = False) -> SceneState:
    """Return the scene that a fit begins from: places as they were found, sizes where they are not the models'."""
    found = detected.found.values()
    n = len(detected.overlapping)
    sizes = [body.seen_log_size[0] if body.of_disk or solve_range else 0.0 for body in found]
    return SceneState(
        (*detected.found, *detected.overlapping),
        np.array([*(body.center_px for body in found), *detected.overlapping.values()]),
        -np.array([*sizes, *[0.0] * n]),
        np.ones(len(detected.found) + n),
    )


def fit_pixels(detected: DetectedScene) -> Cutout | None:
    """Return the pixels about the bodies that are fitted together, without those of other bodies; None: there are none."""
    picture = detected.picture
    circles = list(_fit_circles(detected).values())
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
    for name, place in detected.apart.items():
        if np.isfinite(place).all():
            use &= ~near(place, outline_radius_px(picture, name) + edge_reach(picture), square=False)
    return replace(cutout, use=cutout.use & use)


def _fit_circles(detected: DetectedScene) -> dict[str, tuple[FloatArray, float]]:
    """Return center (2,) and reach, px, of what is fitted of each body."""
    picture, about = detected.picture, edge_reach(detected.picture)
    circles = {
        name: (
            body.center_px,
            outline_radius_px(picture, name) * max(np.exp(body.seen_log_size[0]), 1.0) + about,
        )
        for name, body in detected.found.items()
    }
    for name, place in detected.overlapping.items():
        circles[name] = place, outline_radius_px(picture, name) + about
    return circles


def groups_in_contact(detected: DetectedScene) -> list[DetectedScene]:
    """Return a scene for each group of bodies whose pixels touch, with the others apart from it.

    What does not share a pixel shares nothing: a joint fit of all would cost the square of their number, or more.
    """
    circles = _fit_circles(detected)
    places = np.reshape([center for center, _ in circles.values()], (-1, 2))
    reach = np.array([far for _, far in circles.values()])
    apart = np.abs(places[:, None] - places).max(axis=2)
    count, group = connected_components(apart <= reach[:, None] + reach, directed=False)
    names = list(circles)

    def members(index: int) -> DetectedScene:
        own = {name for name, k in zip(names, group, strict=True) if k == index}
        others = {name: center for name, (center, _) in circles.items() if name not in own}
        return DetectedScene(
            detected.picture,
            {name: body for name, body in detected.found.items() if name in own},
            {},
            {name: place for name, place in detected.overlapping.items() if name in own},
            {**detected.apart, **others},
        )

    return [members(index) for index in range(count)]

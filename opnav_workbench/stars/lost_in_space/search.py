"""From detections to the attitude, with none to begin with: triangles of the brightest, looked up, proposed, weighed.

Triangles of detections are looked up in the index, those of the brightest first; each catalog triangle with the same code,
and the same angle within what the focal length may be off, proposes an attitude, if that brings a fourth star to a
detection. The proposals that bring most stars nearest to detections are refined and weighed (`verification`). If none is
sure, the same is tried with what noise does to faint stars' centers, then with the picture mirrored: a sure answer to that
says that picture and camera file do not belong together.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from opnav_workbench.arrays import FloatArray, IntArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import unit
from opnav_workbench.stars.detection import Detections
from opnav_workbench.stars.flags import StarFlag
from opnav_workbench.stars.lost_in_space.patterns import ORDERS, STARS, code_of, named_orders, pairs
from opnav_workbench.stars.lost_in_space.sky_index import BANDS, TOO_CLOSE, Band, SkyIndex
from opnav_workbench.stars.lost_in_space.verification import (
    MIN_STARS,
    Plane,
    Proposal,
    Verdict,
    judge,
    promising,
)

__all__ = ["FOCAL_ERROR", "LostAnswer", "no_patterns", "right_handed_axes", "solve_lost"]

FOCAL_ERROR = 0.05  # of the camera file's focal length
MAX_DETECTIONS = 100  # that a proposal is compared with, brightest
# Sigmas of a detection's center, px, for the reach of codes, and among how many detections patterns are looked for, one more
# round each where no answer is sure. The second pass is for noisy pictures of few stars; where there are more than sixteen
# detections, enough of their many triangles are as good as the first asks for.
Passes = tuple[tuple[float, tuple[int, ...]], ...]
PASSES: Passes = ((0.15, (8, 12, 16, 20, 25, 30)), (0.45, (8, 12, 16)))
# A camera file that mirrors pictures does so with all of them: it is seen in those whose patterns are found soon.
MIRRORED_PASSES: Passes = ((0.15, (8, 12, 16)),)
REACH_SIGMAS = 3.0
CODE_NOISE = 1.4  # of a code, in a center's sigmas over the length of AB
SLACK = 0.02  # of the longest side, by which noise may change the order of two sides
MIN_ANGLE_PX = 100.0  # of a triangle: noise leaves too little of smaller ones
PATTERN_REACH = 4.0  # widest pattern of the n-th detection, in widths of the picture over sqrt(n)
MAX_ASPECT = 6.0  # of a detector: a star's neighbors stand all around it
WIDEST = 2.0  # tangent from the boresight: farther out a plane stretches the sky beyond the cells of its map
WIDE_FIELD = 0.3  # what an error of the focal length does to a code off the boresight, over tan^2
# Proposals of a round that are compared with all of the picture: those that bring most of the stars around to detections.
# Chance brings one; there are more such proposals only where there are many detections, and with many stars among these
# the true one brings several.
MOST_COMPARED = 250
MOST_JUDGED = (
    6  # proposals weighed in a round: the true one is among the first three where four stars or more fit
)
STARS_IN_FIELD = 120.0  # brighter than those of a band, in the mean picture: its triangles are too small then


@dataclass(frozen=True, slots=True, eq=False)
class LostAnswer:
    """Where the picture looks.

    Attributes
    ----------
    camera_from_j2000 : (3, 3) array or None
        None where no answer is sure, or the picture is mirrored.
    focal_scale
        By what the camera file's focal length is to be multiplied.
    focal_sigma
        Its 1 sigma.
    log_odds
        Against chance; -inf where nothing was found.
    n_stars
        Catalog stars that have a detection.
    mirrored : (3, 3) array or None
        The attitude that the camera would have, were its line axis the other way round; None where it is not so.
    message
        What was found, in one line.
    """

    camera_from_j2000: FloatArray | None
    focal_scale: float
    focal_sigma: float
    log_odds: float
    n_stars: int
    mirrored: FloatArray | None
    message: str

    def __post_init__(self) -> None:
        freeze_arrays(self)


def solve_lost(
    index: SkyIndex,
    detections: Detections,
    camera: Camera,
    *,
    focal_error: float = FOCAL_ERROR,
    try_mirrored: bool = True,
) -> LostAnswer:
    """Find the attitude of a picture, any place and twist, with nothing known but the camera.

    Parameters
    ----------
    index
        Patterns of a catalog (`sky_index.index_of_stars`).
    detections
        What stands in the picture, stars or not.
    camera
        Its distortion and detector are taken as they are.
    focal_error
        Largest relative error of its focal length.
    try_mirrored
        Whether to look for the picture's mirror image, too.

    Returns
    -------
    LostAnswer
        Stars are compared by their catalog directions: the attitude is that of the apparent sky to half a minute of
        arc of aberration, for a picture's stars to be identified with.
    """
    if (why := no_patterns(camera)) is not None:
        return _no_answer(f"{why}.")
    plane = _plane(detections, camera, focal_error)
    if len(plane.places) < MIN_STARS:
        return _no_answer(f"{len(plane.places)} detections are too few; {MIN_STARS} are the least.")
    verdict = _search(index, plane, PASSES)
    if verdict is not None:
        return _answer(camera, verdict)
    verdict = _search(index, _flipped(plane), MIRRORED_PASSES) if try_mirrored else None
    if verdict is not None:
        return _mirrored_answer(camera, verdict)
    return _no_answer(
        f"no pattern of the {len(plane.places)} brightest detections is one of the catalog for sure."
    )


def no_patterns(camera: Camera) -> str | None:
    """Return why pictures of a camera hold no patterns of neighboring stars; None where they do."""
    if max(camera.n_pixel, camera.n_line) <= MAX_ASPECT * min(camera.n_pixel, camera.n_line):
        return None
    return f"a strip of {camera.n_pixel} x {camera.n_line} pixels holds no patterns of neighboring stars"


# ---- What is looked up: the picture without distortion.


def _plane(detections: Detections, camera: Camera, focal_error: float) -> Plane:
    """Return the detections that may be stars, brightest first, those sharper than stars left out."""
    order = np.argsort(-detections.flux_dn, kind="stable")
    star_like = (detections.flags[order] & StarFlag.COSMIC_RAY) == 0
    order = order[star_like] if star_like.sum() >= MIN_STARS else order
    focal = camera.unproject(detections.pixel_line[order].reshape(-1, 2)) @ camera.focal_from_camera.T
    corners = _corners(camera)
    with np.errstate(invalid="ignore"):
        beside = np.abs(focal[:, :2]) > focal[:, 2:] * np.abs(corners).max(axis=0)
    outside = beside.any(axis=1) & (np.abs(corners).max() >= WIDEST)
    kept = np.flatnonzero(np.isfinite(focal).all(axis=1) & ~outside)[:MAX_DETECTIONS]
    focal, flux = focal[kept], detections.flux_dn[order[kept]]
    saturated = (detections.flags[order[kept]] & StarFlag.SATURATED) > 0
    mag = np.where(saturated | (flux <= 0.0), np.nan, -2.5 * np.log10(np.maximum(flux, np.finfo(float).tiny)))
    plane = Plane(focal[:, :2] / focal[:, 2:], mag, camera.pixel_scale_rad, corners, focal_error)
    # A detector read out mirrored has axes of the other hand: its sky is that of the camera's frame.
    return plane if np.linalg.det(camera.focal_from_camera) > 0.0 else _flipped(plane)


def _corners(camera: Camera) -> FloatArray:
    """Return the detector's corners in the plane; of a fisheye those of what a plane can hold of its sky."""
    right, top = camera.n_pixel - 0.5, camera.n_line - 0.5
    x, y = camera.center_pixel_line
    rim = np.array(
        [[-0.5, -0.5], [right, -0.5], [right, top], [-0.5, top], [-0.5, y], [x, -0.5], [right, y], [x, top]]
    )
    seen = camera.unproject(rim) @ camera.focal_from_camera.T
    plane = seen[:, :2] / seen[:, 2:]
    if np.abs(plane).max() < WIDEST:  # nan: it is not
        return plane[:4]
    low, high = np.fmax(plane[[4, 5], [0, 1]], -WIDEST), np.fmin(plane[[6, 7], [0, 1]], WIDEST)
    return np.array([low, [high[0], low[1]], high, [low[0], high[1]]])


def _flipped(plane: Plane) -> Plane:
    flip = np.array([1.0, -1.0])
    return replace(plane, places=plane.places * flip, corners=plane.corners * flip)


# ---- Looking up.


def _search(index: SkyIndex, plane: Plane, passes: Passes) -> Verdict | None:
    """Return the first sure verdict."""
    for bands in _bands(index, plane):
        for sigma_px, rounds in passes:
            for sets in _rounds(plane, rounds):
                rotations, scales = _proposals(index, plane, bands, sets, sigma_px)
                if len(scales) == 0:
                    continue
                for row in promising(index, plane, rotations, scales, MOST_JUDGED):
                    verdict = judge(index, plane, Proposal(rotations[row], float(scales[row])))
                    if verdict is not None and verdict.sure:
                        return verdict
    return None


def _bands(index: SkyIndex, plane: Plane) -> Iterator[list[Band]]:
    """Yield the bands whose stars are not too many for a picture of this width; in a cluster all may be bright.

    First all that are made already; then, one by one, those that take seconds to make, which most pictures never ask for.
    """
    part = plane.area_px2 * plane.scale_rad**2 / (4.0 * np.pi * index.coverage)
    fitting = [
        number
        for number, rule in enumerate(BANDS)
        if rule.first < len(index) and rule.first * part < STARS_IN_FIELD
    ]
    at_hand = [number for number in fitting if index.is_made(number)]
    yield [index.band(number) for number in at_hand]
    for number in fitting:
        if number not in at_hand:
            yield [index.band(number)]


def _rounds(plane: Plane, rounds: tuple[int, ...]) -> Iterator[IntArray]:
    """Yield sets of three detections (q > 0, 3), those of brighter ones first, without those too wide or too small."""
    width = np.sqrt(plane.area_px2)
    apart = np.linalg.norm(plane.places[:, None] - plane.places, axis=2) / plane.scale_rad
    before = 0
    for wanted in rounds:
        count = min(wanted, len(plane.places))
        new = [
            np.column_stack([sets := pairs(last), np.full(len(sets), last)])
            for last in range(max(before, STARS - 1), count)
        ]
        before = count
        if not new:
            return
        sets = np.concatenate(new)
        sides = np.stack([apart[sets[:, i], sets[:, j]] for i, j in combinations(range(STARS), 2)])
        widest = sides.max(axis=0)
        reach = PATTERN_REACH * width / np.sqrt(sets[:, -1] + 1.0)
        good = (widest > MIN_ANGLE_PX) & (widest < reach) & (sides.min(axis=0) > TOO_CLOSE * widest)
        if good.any():
            yield sets[good]


def _proposals(
    index: SkyIndex, plane: Plane, bands: list[Band], sets: IntArray, sigma_px: float
) -> tuple[FloatArray, FloatArray]:
    """Return rotations (c, 3, 3) and scales (c,) from catalog triangles that are like three detections, a fourth beside."""
    rays = unit(np.column_stack([plane.places, np.ones(len(plane.places))]))
    rows, orders = named_orders(rays[sets], SLACK)
    sets = np.take_along_axis(sets[rows], ORDERS[orders], axis=1)
    codes, angle = code_of(rays[sets])
    wide = WIDE_FIELD * np.tan(plane.reach_rad) ** 2 * plane.focal_error
    reach = REACH_SIGMAS * CODE_NOISE * sigma_px * plane.scale_rad / angle + wide
    rotations, scales, hits = [np.empty((0, 3, 3))], [np.empty(0)], [np.empty(0, np.int64)]
    for band in bands:
        row, members, number = band.patterns_near(codes, angle, reach, 1.2 * plane.focal_error)
        stars = index.vectors.take(members, axis=0).astype(np.float64)
        found, _ = code_of(stars)
        good = np.flatnonzero((np.abs(found - codes[row]) < reach[row, None]).all(axis=1))
        row, stars, members = row[good], stars.take(good, axis=0), members.take(good, axis=0)
        rotation, scale = _attitudes(plane, sets[row], stars)
        around = band.around.take(number[good], axis=0).astype(np.int64)
        proven, brought = _with_fourth(index, plane, rotation, scale, sets[row], members, around)
        rotations.append(rotation[proven])
        scales.append(scale[proven])
        hits.append(brought)
    best = np.argsort(-np.concatenate(hits), kind="stable")[:MOST_COMPARED]
    return np.concatenate(rotations)[best], np.concatenate(scales)[best]


def _attitudes(plane: Plane, seen: IntArray, stars: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return rotations (c, 3, 3) and scales (c,) that take three stars (c, 3, 3) onto three detections (c, 3).

    The scale is that of A and B, the middle of these fits, and half of what the directions to C differ by is turned away.
    """
    places = plane.places[seen]
    scale = np.ones(len(seen))
    wanted = np.linalg.norm(stars[:, 0] - stars[:, 1], axis=1)
    for _ in range(3):
        rays = unit(
            np.concatenate([places[:, :2] * scale[:, None, None], np.ones((len(seen), 2, 1))], axis=2)
        )
        scale = scale * wanted / np.linalg.norm(rays[:, 0] - rays[:, 1], axis=1)
    rays = unit(np.concatenate([places[:, :2] * scale[:, None, None], np.ones((len(seen), 2, 1))], axis=2))
    return np.swapaxes(_frames(rays), 1, 2) @ _frames(stars), scale


def _frames(two: FloatArray) -> FloatArray:
    """Return right-handed axes (c, 3, 3) in rows: half-way between two directions, from one to the other, and across."""
    middle, along = unit(two[:, 0] + two[:, 1]), two[:, 1] - two[:, 0]
    # The index's vectors are of single precision, not quite of one length.
    along = unit(along - np.einsum("ci,ci->c", along, middle)[:, None] * middle)
    return np.stack([middle, along, np.cross(middle, along)], axis=1)


def _with_fourth(
    index: SkyIndex,
    plane: Plane,
    rotations: FloatArray,
    scales: FloatArray,
    seen: IntArray,
    members: IntArray,
    near: IntArray,
) -> tuple[IntArray, IntArray]:
    """Return which proposals, from detections and stars (c, 3), bring other stars `near` (c, k) to others, and how many."""
    found = plane.fourths.near(index.vectors.take(near, axis=0), plane.fourths.axes(rotations, scales))
    rows, ones = np.nonzero(found >= 0)
    hit, star = found[rows, ones], near[rows, ones]
    # Where two detections stand side by side, a star of the triangle may be at the other.
    good = (hit[:, None] != seen.take(rows, axis=0)).all(axis=1)
    good &= (star[:, None] != members.take(rows, axis=0)).all(axis=1)
    return np.unique(rows[good], return_counts=True)


# ---- What is told.


def right_handed_axes(camera: Camera) -> FloatArray:
    """Return the focal axes (3, 3) from the camera's frame; of a detector read out mirrored, with line reversed."""
    focal = camera.focal_from_camera
    return focal if np.linalg.det(focal) > 0.0 else focal * np.array([[1.0], [-1.0], [1.0]])


def _attitude(camera: Camera, rotation: FloatArray) -> FloatArray:
    """Return camera from J2000, from the rotation to the plane's right-handed axes."""
    return np.asarray(right_handed_axes(camera).T @ rotation)


def _answer(camera: Camera, verdict: Verdict) -> LostAnswer:
    n, fit = len(verdict.stars), f"within {verdict.scatter_px:.1f} px"
    message = f"{n} stars fit {fit}, e^{verdict.log_odds:.0f} to 1 against chance"
    return LostAnswer(
        _attitude(camera, verdict.proposal.rotation), *_focal(verdict), verdict.log_odds, n, None, message
    )


def _mirrored_answer(camera: Camera, verdict: Verdict) -> LostAnswer:
    n = len(verdict.stars)
    message = f"{n} stars fit the picture's mirror image, e^{verdict.log_odds:.0f} to 1 against chance"
    attitude = _attitude(camera, verdict.proposal.rotation)
    return LostAnswer(None, *_focal(verdict), verdict.log_odds, n, attitude, message)


def _focal(verdict: Verdict) -> tuple[float, float]:
    scale = 1.0 / verdict.proposal.scale
    return scale, scale * verdict.scale_sigma


def _no_answer(why: str) -> LostAnswer:
    return LostAnswer(None, 1.0, float("nan"), float("-inf"), 0, None, why)

"""Lines of right ascension and declination over the picture, with labels."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import radec_from_unit, unit_from_radec

__all__ = ["SkyGrid", "sky_grid"]

# Steps that people read, deg: whole degrees, minutes and seconds of arc.
STEPS_DEG = np.array(
    [
        30,
        20,
        10,
        5,
        2,
        1,
        0.5,
        1 / 3,
        1 / 6,
        1 / 12,
        1 / 30,
        1 / 60,
        1 / 120,
        1 / 180,
        1 / 360,
        1 / 720,
        1 / 3600,
    ]
)
LINES_WANTED = 4.0  # across the picture's longer side, at least
SAMPLES = 64  # points along a line
LABEL_ROOM = (0.06, 0.86)  # shares of the picture where a label begins, so that none is cut by the edge
NEAR_POLE_DEG = 85.0  # beyond it lines of RA crowd together


@dataclass(frozen=True, slots=True)
class SkyGrid:
    """Grid lines, each (n, 2) px; labels, and where each stands (pixel, line)."""

    lines_px: list[FloatArray]
    labels: list[str]
    places_px: list[FloatArray]


def sky_grid(camera: Camera, camera_from_j2000: FloatArray) -> SkyGrid:
    """Return the grid of a picture at an attitude."""
    ra, dec = _outline_deg(camera, camera_from_j2000)
    center = 0.5 * (dec.min() + dec.max())
    extent = dec.max() - dec.min()
    step = _step(max(extent, 1e-6))
    grid = SkyGrid([], [], [])
    for value in _multiples(dec.min(), dec.max(), step):
        around = np.linspace(ra.min(), ra.max(), SAMPLES)
        _add(grid, camera, camera_from_j2000, around, np.full(SAMPLES, value), _dec_text(value, step))
    if abs(center) < NEAR_POLE_DEG:
        step_ra = _step(extent / np.cos(np.radians(center)))
        for value in _multiples(ra.min(), ra.max(), step_ra):
            along = np.linspace(dec.min(), dec.max(), SAMPLES)
            _add(
                grid,
                camera,
                camera_from_j2000,
                np.full(SAMPLES, value),
                along,
                _ra_text(value % 360.0, step_ra),
            )
    return grid


def _outline_deg(camera: Camera, camera_from_j2000: FloatArray) -> tuple[FloatArray, FloatArray]:
    """RA and Dec over the detector's whole area, deg; RA continuous across 0."""
    axes = [np.linspace(-0.5, n - 0.5, 17) for n in (camera.n_pixel, camera.n_line)]
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    ra, dec = radec_from_unit(camera.unproject(points) @ camera_from_j2000)
    middle = ra[len(ra) // 2]
    return np.degrees(middle + (ra - middle + np.pi) % (2.0 * np.pi) - np.pi), np.degrees(dec)


def _step(extent_deg: float) -> float:
    fine = STEPS_DEG[extent_deg / LINES_WANTED * 1.0001 >= STEPS_DEG]
    return float(fine[0] if len(fine) else STEPS_DEG[-1])


def _multiples(low: float, high: float, step: float) -> FloatArray:
    return step * np.arange(np.ceil(low / step), np.floor(high / step) + 1.0)


def _add(
    grid: SkyGrid, camera: Camera, attitude: FloatArray, ra_deg: FloatArray, dec_deg: FloatArray, text: str
) -> None:
    places = camera.project(unit_from_radec(np.radians(ra_deg), np.radians(dec_deg)) @ attitude.T)
    on = camera.on_detector(places)
    if on.sum() < 2:
        return
    grid.lines_px.append(
        np.where(on[:, None] | np.roll(on, 1)[:, None] | np.roll(on, -1)[:, None], places, np.nan)
    )
    size = np.array([camera.n_pixel, camera.n_line])
    room = np.flatnonzero(((places > LABEL_ROOM[0] * size) & (places < LABEL_ROOM[1] * size)).all(axis=1))
    if len(room):
        grid.labels.append(text)
        grid.places_px.append(places[room[len(room) // 12]])


def _dec_text(value: float, step: float) -> str:
    sign = "−" if value < -1e-9 else "+"
    return sign + _text(abs(value), step, "°", "′", "″")


def _ra_text(value: float, step: float) -> str:
    return _text(value, step, "°", "′", "″")


def _text(value: float, step: float, unit: str, minute: str, second: str) -> str:
    seconds = round(value * 3600.0)
    whole, minutes, rest = seconds // 3600, seconds // 60 % 60, seconds % 60
    if step >= 1.0:
        return f"{whole}{unit}"
    if step >= 1.0 / 60.0:
        return f"{whole}{unit}{minutes:02d}{minute}"
    return f"{whole}{unit}{minutes:02d}{minute}{rest:02d}{second}"

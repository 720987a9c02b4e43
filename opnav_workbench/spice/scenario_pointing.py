"""The pointing plan in a scenario file; calendar times are UTC.

A window holds the camera on targets or on a fixed direction; a pattern (mosaic, list of offsets, scan) moves it
about that. How the flown attitude differs from the plan stands under `actual`::

    pointing:
      instrument: NAVCAM
      windows:
      - {start: 2031-03-01T01:00:00, end: 2031-03-01T02:00:00, track: [ROCK], twist_deg: 30}
      - start: 2031-03-01T03:00:00
        end: 2031-03-01T03:30:00
        track: [ROCK]
        mosaic: {columns: 3, rows: 2, overlap: 0.1, dwell_s: 60, slew_s: 30}
      - {start: ..., end: ..., ra_deg: 200, dec_deg: -40, scan: {rate_deg_s: 0.01, position_angle_deg: 90}}
      actual:
        shift_px: [14.3, -9.6]
        twist_deg: 0.06
        drift_px_h: [0.2, 0.0]
        jitter: [{axis: line, frequency_hz: 2.5, amplitude_px: 0.3}]
        spectra: [{axis: pixel, unit: urad, psd: [[0.1, 4.0], [10, 0.02]], rms: 1.5}]
        jitter_windows: [{start: 2031-03-01T01:30:00, end: 2031-03-01T01:30:20}]
        seed: 1
"""

from collections.abc import Iterable
from itertools import pairwise
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, NonNegativeInt, PositiveFloat, PositiveInt, model_validator

from opnav_workbench.spice.scenario_parts import BodyName, BodyRef, Span, Strict, Utc

__all__ = [
    "AttitudeError",
    "JitterLine",
    "JitterSpectrum",
    "Mosaic",
    "OffsetList",
    "Pointing",
    "Scan",
    "Window",
]

MOST_PLACES = 10_000  # of a mosaic; more is a misprint
MICRO = 1e-6

Pair = tuple[float, float]  # pixel, line
Fraction = Annotated[float, Field(ge=0.0, lt=1.0)]
Axis = Literal["pixel", "line", "twist"]


class Dwells(Strict):
    """Places held one after the other from the window's start; the last one until the window's end."""

    dwell_s: PositiveFloat
    slew_s: PositiveFloat

    def duration_s(self, places: int) -> float:
        """Return how long so many places and the slews between them take."""
        return places * self.dwell_s + (places - 1) * self.slew_s


class Mosaic(Dwells):
    """A grid of fields around the aim, row by row."""

    columns: PositiveInt  # along pixel
    rows: PositiveInt  # along line
    overlap: Fraction = 0.0  # of the detector's width and height
    order: Literal["snake", "raster"] = "snake"  # there and back, or each row from its start

    @model_validator(mode="after")
    def _not_too_many(self) -> Self:
        if self.count > MOST_PLACES:
            raise ValueError(f"{self.columns} x {self.rows} places; {MOST_PLACES} at most")
        return self

    @property
    def count(self) -> int:
        """Number of places."""
        return self.columns * self.rows

    def places_px(self, n_pixel: int, n_line: int) -> Iterable[Pair]:
        """Return where the aim is put, px from the boresight, in order."""
        steps = (1.0 - self.overlap) * n_pixel, (1.0 - self.overlap) * n_line
        for row in range(self.rows):
            back = self.order == "snake" and row % 2 == 1
            for column in reversed(range(self.columns)) if back else range(self.columns):
                yield (
                    (column - (self.columns - 1) / 2) * steps[0],
                    (row - (self.rows - 1) / 2) * steps[1],
                )


class OffsetList(Dwells):
    """Fields at given offsets: where the aim is put, px from the boresight, one after the other."""

    list_px: Annotated[tuple[Pair, ...], Field(min_length=1, max_length=MOST_PLACES)]

    @property
    def count(self) -> int:
        """Number of places."""
        return len(self.list_px)

    def places_px(self, _n_pixel: int, _n_line: int) -> Iterable[Pair]:
        """Return the list."""
        return self.list_px


class Scan(Strict):
    """A turn at an even rate along a great circle, through the whole window.

    Either what is aimed at moves along `direction` (pixel, line) on the detector, or the boresight moves toward
    `position_angle_deg` (east of J2000 north, at the scan's start) on the sky.
    """

    rate_deg_s: PositiveFloat
    direction: Pair | None = None
    position_angle_deg: float | None = None
    start_px: Pair = (0.0, 0.0)  # where the aim is at the start

    @model_validator(mode="after")
    def _one_direction(self) -> Self:
        if (self.direction is None) == (self.position_angle_deg is None):
            raise ValueError("give either direction (on the detector) or position_angle_deg (on the sky)")
        if self.direction is not None and not np.any(self.direction):
            raise ValueError("direction [0, 0] points nowhere")
        return self


class Window(Strict):
    """A time during which the camera is held on something: targets, or a fixed direction."""

    start: Utc
    end: Utc
    step_s: PositiveFloat | None = None  # between attitudes; none: as close as `tolerance_rad` needs
    tolerance_rad: PositiveFloat = (
        1e-9  # error of even turns between the attitudes, while no slew is under way
    )
    track: tuple[BodyRef, ...] = ()  # several: the middle of their directions
    ra_deg: float | None = None
    dec_deg: Annotated[float, Field(ge=-90.0, le=90.0)] | None = None
    twist_deg: float = 0.0  # position angle of increasing line, east of J2000 north
    offset_px: Pair = (0.0, 0.0)  # pixel, line of what is tracked, from the boresight
    mosaic: Mosaic | None = None
    offsets: OffsetList | None = None
    scan: Scan | None = None

    @model_validator(mode="after")
    def _one_aim(self) -> Self:
        if self.end <= self.start:
            raise ValueError(f"end {self.end.isoformat()} is not after start {self.start.isoformat()}")
        fixed = self.ra_deg is not None and self.dec_deg is not None
        if fixed == bool(self.track) or (self.ra_deg is None) != (self.dec_deg is None):
            raise ValueError("give either track or both of ra_deg and dec_deg")
        return self

    @model_validator(mode="after")
    def _one_pattern(self) -> Self:
        if sum(p is not None for p in (self.mosaic, self.offsets, self.scan)) > 1:
            raise ValueError("give one of mosaic, offsets and scan")
        dwells, length = self.dwells, (self.end - self.start).total_seconds()
        if dwells is not None and dwells.duration_s(dwells.count) > length:
            raise ValueError(
                f"{dwells.count} places need {dwells.duration_s(dwells.count):g} s, the window has {length:g} s"
            )
        return self

    @property
    def dwells(self) -> Mosaic | OffsetList | None:
        """The pattern of places, if there is one."""
        return self.mosaic if self.mosaic is not None else self.offsets


class JitterLine(Strict):
    """One sine of the jitter: ``amplitude * cos(2 pi frequency t + phase)``, t from the span's start."""

    axis: Axis
    frequency_hz: PositiveFloat
    amplitude_px: PositiveFloat | None = None  # not for twist
    amplitude_urad: PositiveFloat | None = None
    phase_deg: float | None = None  # none: drawn from the seed

    @model_validator(mode="after")
    def _one_amplitude(self) -> Self:
        if (self.amplitude_px is None) == (self.amplitude_urad is None):
            raise ValueError("give either amplitude_px or amplitude_urad")
        if self.axis == "twist" and self.amplitude_px is not None:
            raise ValueError("a twist has no pixels; give amplitude_urad")
        return self

    def amplitude_rad(self, pixel_scale_rad: float) -> float:
        """Return the amplitude as an angle."""
        if self.amplitude_px is not None:
            return self.amplitude_px * pixel_scale_rad
        assert self.amplitude_urad is not None
        return self.amplitude_urad * MICRO


class JitterSpectrum(Strict):
    """Jitter by its one-sided power spectral density, as many sines of random phase."""

    axis: Axis
    unit: Literal["px", "urad"]
    psd: Annotated[tuple[tuple[PositiveFloat, PositiveFloat], ...], Field(min_length=2)]  # Hz, unit^2/Hz
    rms: PositiveFloat | None = None  # scales the whole to this, in `unit`
    terms: Annotated[int, Field(ge=1, le=4096)] = 64

    @model_validator(mode="after")
    def _increasing(self) -> Self:
        if any(b[0] <= a[0] for a, b in pairwise(self.psd)):
            raise ValueError("psd: the frequencies must increase")
        if self.axis == "twist" and self.unit == "px":
            raise ValueError("a twist has no pixels; give urad")
        return self

    def unit_rad(self, pixel_scale_rad: float) -> float:
        """Return the angle of one `unit`."""
        return pixel_scale_rad if self.unit == "px" else MICRO


class AttitudeError(Strict):
    """How the flown attitude differs from the predicted one; see `delta_pixel, delta_line, delta_twist`."""

    shift_px: Pair = (0.0, 0.0)  # where the boresight's sky moves on the detector
    twist_deg: float = 0.0
    drift_px_h: Pair = (0.0, 0.0)  # growth of the shift per hour since the span's start
    drift_twist_deg_h: float = 0.0
    jitter: tuple[JitterLine, ...] = ()
    spectra: tuple[JitterSpectrum, ...] = ()
    jitter_windows: tuple[
        Span, ...
    ] = ()  # jitter, and attitudes close enough for it, in these only; none: always
    jitter_tolerance_px: PositiveFloat = (
        1e-3  # error of even turns between attitudes: below any center's error
    )
    fade_s: Annotated[float, Field(ge=0.01)] = (
        1.0  # within which jitter swells before such a window, and dies after it
    )
    seed: NonNegativeInt = 0

    @property
    def drifts(self) -> bool:
        """Whether the error grows with time."""
        return any((*self.drift_px_h, self.drift_twist_deg_h))

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for i, (before, after) in enumerate(pairwise(self.jitter_windows)):
            if (after.start - before.end).total_seconds() <= 2.0 * self.fade_s:
                raise ValueError(
                    f"jitter_windows.{i + 1}: starts less than {2.0 * self.fade_s:g} s (twice fade_s) after the "
                    "end of the one before; put them in order, or join them"
                )
        return self


class Pointing(Strict):
    """The plan for one camera; what carries it follows."""

    instrument: BodyName
    windows: Annotated[tuple[Window, ...], Field(min_length=1)]
    actual: AttitudeError | None = None

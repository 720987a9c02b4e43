"""Charge in the pixels, effect by effect: photon noise, frame-transfer smear, cosmic rays, blooming.

Each is a function of arrays of electrons ``[line, pixel]``; `opnav_workbench.simulation.detector` puts them in
their order.

**Photon noise.** A generator of Poisson numbers takes more or fewer random numbers as the mean asks, so that one
more star would change the noise of all pixels after it. Here one normal deviate a pixel is turned into the count of
the same probability: pictures of one seed have the same noise wherever their light is the same, and their
difference shows what differs. Source: M. B. Giles (2016), "Algorithm 955: approximation of the inverse Poisson
cumulative distribution function", ACM Trans. Math. Softw. 42(1), 7, doi:10.1145/2699466 (its expansion Q_N about
the normal quantile).

**Frame transfer**, where no shutter stops the light while the charge moves along its columns.

Forward   After the exposure each row moves, one row every ``transfer_s / n_line``, out over the line that it is read
          `toward`, and gathers the light of all rows between. Before the exposure the rows that come in, one every
          ``scrub_s / n_line``, have gathered the light of all rows on the other side. With s the electrons of the
          exposure itself, a = transfer_s / (n_line exposure_s) and b = scrub_s / (n_line exposure_s), toward line 0

              r_i = s_i + a sum(s_k, k < i) + b sum(s_k, k > i)

Backward  With S_i the sum up to line i and T the whole one, S_i = g S_(i-1) + (r_i - b T) / (1 - b),
          g = 1 - (a - b) / (1 - b): a recursion that is linear in r and T, and T = S_(n-1) closes it.

A star's smear thus has transfer_s / exposure_s of its electrons, evenly over its column when both times are equal
(and then r = (1 - a) s + a T).

**Cosmic rays** are straight tracks of charge, isotropic, through the layer of silicon that collects it. The flux
through a surface from direction (zenith angle theta) goes as cos(theta), so that sin^2(theta) is uniform; a track
of a layer of depth d is d tan(theta) long on the detector, and its path in silicon is d / cos(theta).

**Blooming.** Charge above the full well spills along its column, half up and half down, until pixels take it. With
excess u_i and room r_i of the pixels of a column, the charge that flows past pixel i is ``c_i = max(0, c_(i-1) +
u_i - r_i)``, whose solution is a cumulative sum less its running minimum (D. V. Lindley, 1952,
doi:10.1017/S0305004100027638): no loop over pixels.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.errors import CameraError
from opnav_workbench.simulation.effects import CosmicRays

__all__ = ["ChargeTransfer", "CosmicRayHits", "bloom", "draw_cosmic_rays", "poisson_counts"]


# ---- Photon counts that follow Poisson's law, each pixel with a random number of its own.

# Mean from which the expansion is good: fewer than one count in a thousand then differs (by 1) from the exact quantile.
SMALL_MEAN = 10.0
MOST_COUNTS = 120  # of a mean below SMALL_MEAN: the probability of more is below 1e-80


def poisson_counts(mean: ArrayLike, rng: np.random.Generator) -> FloatArray:
    """Draw one count per element.

    Parameters
    ----------
    mean : array_like
        Expected counts; negative ones count as 0.
    rng
        Gives one normal deviate per element, whatever the mean.

    Returns
    -------
    array
        Whole numbers, of the shape of `mean`.

    Examples
    --------
    >>> poisson_counts([0.0, 4.0, 400.0], np.random.default_rng(1))
    array([  0.,   6., 406.])
    """
    expected = np.asarray(mean, dtype=np.float64)
    deviate = rng.standard_normal(expected.shape)
    counts = np.zeros_like(expected)
    for some, quantile in (
        (expected >= SMALL_MEAN, _count_by_expansion),
        ((expected > 0.0) & (expected < SMALL_MEAN), _count_by_inversion),
    ):
        if some.all():
            return quantile(expected, deviate)
        if some.any():
            counts[some] = quantile(expected[some], deviate[some])
    return counts


def _count_by_expansion(mean: FloatArray, w: FloatArray) -> FloatArray:
    """Giles' asymptotic expansion of the quantile of deviates `w`, to terms in 1/mean."""
    root = np.sqrt(mean)
    w2 = w * w
    quantile = mean + root * w + (1.0 / 3.0 + w2 / 6.0) - w * (1.0 / 36.0 + w2 / 72.0) / root
    quantile += (-8.0 / 405.0 + w2 * (7.0 / 810.0 + w2 / 270.0)) / mean
    return np.maximum(np.floor(quantile), 0.0)


def _count_by_inversion(mean: FloatArray, w: FloatArray) -> FloatArray:
    """Smallest counts whose cumulative probability reaches that of deviates `w`, by summing the terms."""
    counts, means = np.zeros(mean.size), mean.ravel()
    term = np.exp(-means)
    rest = ndtr(w).ravel() - term
    open_ = np.flatnonzero(rest > 0.0)
    term, rest, means = term[open_], rest[open_], means[open_]
    for k in range(1, MOST_COUNTS):
        if len(open_) == 0:
            break
        counts[open_] = k
        term *= means / k
        rest -= term
        on = rest > 0.0
        open_, term, rest, means = open_[on], term[on], rest[on], means[on]
    return counts.reshape(mean.shape)


# ---- Smear of a frame-transfer detector without shutter.


@dataclass(frozen=True, slots=True)
class ChargeTransfer:
    """Times and direction of the charge transfer, relative to the exposure.

    Attributes
    ----------
    after
        Transfer time of all lines after the exposure, over the exposure time.
    before
        The same of the clearing before it.
    toward_first
        Whether the rows leave over line 0 (else over the last one).

    Raises
    ------
    CameraError
        A line of clearing takes as long as the exposure, which cannot be undone.
    """

    after: float
    before: float
    toward_first: bool = True

    @classmethod
    def of(
        cls, transfer_s: float, scrub_s: float, exposure_s: float, *, toward_first: bool = True
    ) -> "ChargeTransfer":
        """Return the transfer of an exposure."""
        return cls(transfer_s / exposure_s, scrub_s / exposure_s, toward_first)

    def smear(self, electrons: FloatArray) -> FloatArray:
        """Return what the transfers add to the expected electrons (n_line, n_pixel) of an exposure."""
        a, b = self._per_line(electrons)
        if a == b:
            return np.asarray(a * (electrons.sum(axis=0) - electrons))
        rows = electrons if self.toward_first else electrons[::-1]
        through = np.cumsum(rows, axis=0)
        added = a * (through - rows) + b * (through[-1] - through)
        return np.asarray(added if self.toward_first else added[::-1])

    def remove(self, smeared: FloatArray) -> FloatArray:
        """Return the electrons (n_line, n_pixel) of the exposure, given those with smear: what calibration does."""
        from scipy.signal import lfilter  # noqa: PLC0415  a third of a second, for unequal times only

        a, b = self._per_line(smeared)
        if a == b:
            total = smeared.sum(axis=0) / (1.0 - a + a * len(smeared))
            return np.asarray((smeared - a * total) / (1.0 - a))
        rows = smeared if self.toward_first else smeared[::-1]
        growth = 1.0 - (a - b) / (1.0 - b)
        filtered = np.asarray(lfilter([1.0], [1.0, -growth], rows, axis=0)) / (1.0 - b)
        of_total = np.asarray(lfilter([1.0], [1.0, -growth], np.full(len(rows), b))) / (1.0 - b)
        total = filtered[-1] / (1.0 + of_total[-1])
        through = filtered - of_total[:, None] * total
        exposed = np.diff(through, axis=0, prepend=0.0)
        return np.asarray(exposed if self.toward_first else exposed[::-1])

    def _per_line(self, electrons: FloatArray) -> tuple[float, float]:
        lines = len(electrons)
        a, b = self.after / lines, self.before / lines
        if not (a < 1.0 and b < 1.0):
            raise CameraError(
                f"frame transfer: a line moves in {max(a, b):.3g} exposure times; give a longer exposure or a "
                "shorter transfer_s."
            )
        return a, b


# ---- Cosmic rays: straight tracks of charge, isotropic, through the layer of silicon that collects it.

DEEP_SPACE_PER_CM2_S = 4.0  # galactic protons and nuclei near solar minimum, through a surface
TRACK_STEP_PX = 0.2  # a track is laid down in steps of this length
MM_PER_CM, UM_PER_MM = 10.0, 1000.0


@dataclass(frozen=True, slots=True, eq=False)
class CosmicRayHits:
    """The particles that hit the detector.

    Attributes
    ----------
    start_px, end_px : (n, 2) arrays
        Ends of the tracks on the detector, (pixel, line).
    electrons : (n,) array
        Charge of each, whole numbers, whether it falls on the detector or beside it.
    """

    start_px: FloatArray
    end_px: FloatArray
    electrons: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.electrons)

    @property
    def length_px(self) -> FloatArray:
        """Lengths of the tracks (n,)."""
        return np.asarray(np.hypot(*(self.end_px - self.start_px).T))

    @classmethod
    def none(cls) -> "CosmicRayHits":
        """Return no hits."""
        return cls(np.empty((0, 2)), np.empty((0, 2)), np.empty(0))

    def charge(self, shape: tuple[int, int]) -> FloatArray:
        """Return the electrons (n_line, n_pixel) that the tracks leave."""
        count = np.maximum(1, np.ceil(self.length_px / TRACK_STEP_PX).astype(np.int64))
        track = np.repeat(np.arange(len(self)), count)
        step = np.arange(len(track)) - np.repeat(np.cumsum(count) - count, count)
        along = ((step + 0.5) / count[track])[:, None]
        places = np.rint(self.start_px[track] + along * (self.end_px - self.start_px)[track]).astype(np.int64)
        size = np.array(shape[::-1])
        inside = ((places >= 0) & (places < size)).all(axis=1)
        pixel, line = places[inside].T
        share = (self.electrons / count)[track][inside]
        summed = np.bincount(line * shape[1] + pixel, weights=share, minlength=shape[0] * shape[1])
        return np.asarray(np.rint(summed.reshape(shape)))


def draw_cosmic_rays(
    settings: CosmicRays, camera: Camera, open_s: float, rng: np.random.Generator
) -> CosmicRayHits:
    """Draw the particles of a picture.

    Parameters
    ----------
    camera
        Its pixel size turns rates per area into rates per pixel, and tracks into pixels.
    open_s
        Time during which charge lies on the detector.
    """
    pixel_mm = 1.0 / np.sqrt(abs(np.linalg.det(camera.pixel_from_mm)))
    rate = settings.rate_per_px_s
    if rate is None:
        per_area = settings.rate_per_cm2_s
        per_area = DEEP_SPACE_PER_CM2_S if per_area is None else per_area
        rate = per_area * (pixel_mm / MM_PER_CM) ** 2
    n = int(rng.poisson(rate * camera.n_pixel * camera.n_line * open_s))
    uniform = rng.random((n, 4))
    start = uniform[:, :2] * [camera.n_pixel, camera.n_line] - 0.5
    cosine = np.sqrt(1.0 - uniform[:, 2])  # sin^2(theta) is uniform
    path_px = settings.depth_um / UM_PER_MM / pixel_mm / cosine
    path_px = np.minimum(path_px, settings.longest_px)
    azimuth = 2.0 * np.pi * uniform[:, 3]
    length = path_px * np.sqrt(1.0 - cosine**2)
    end = start + length[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    loss = settings.electrons_per_um * np.exp(settings.spread * rng.standard_normal(n))
    return CosmicRayHits(start, end, np.rint(loss * path_px * pixel_mm * UM_PER_MM))


# ---- Blooming: charge above the full well spills along its column, half up and half down.


def bloom(electrons: FloatArray, full_well_e: float, *, spill: bool = True) -> FloatArray:
    """Limit the charge of every pixel to the full well.

    Parameters
    ----------
    electrons : (n_line, n_pixel) array
    spill
        Whether the excess flows along the column (line axis); else a drain takes it.

    Returns
    -------
    (n_line, n_pixel) array
        Charge is conserved but for what flows over the ends of a column.

    Examples
    --------
    >>> column = np.array([[0.0], [10.0], [170.0], [0.0], [0.0]])
    >>> bloom(column, 100.0).ravel()
    array([  0.,  45., 100.,  35.,   0.])
    """
    held = np.minimum(electrons, full_well_e)
    columns = np.flatnonzero((electrons > full_well_e).any(axis=0)) if spill else np.empty(0, dtype=np.int64)
    if len(columns) == 0:
        return held
    excess = (electrons - held)[:, columns]
    down = np.floor(0.5 * excess)
    filled = _spill(held[:, columns], down, full_well_e)
    held[:, columns] = _spill(filled[::-1], (excess - down)[::-1], full_well_e)[::-1]
    return held


def _spill(held: FloatArray, excess: FloatArray, full_well_e: float) -> FloatArray:
    """Let the excess flow toward higher lines and fill what room it finds."""
    balance = np.cumsum(excess - (full_well_e - held), axis=0)
    passing = balance - np.minimum(np.minimum.accumulate(balance, axis=0), 0.0)
    arriving = np.zeros_like(passing)
    arriving[1:] = passing[:-1]
    return held + (arriving + excess - passing)

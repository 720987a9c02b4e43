"""What a team delivers at the end of a rehearsal: corrections of states and the flyby, each with its covariance.

Its file is checked field by field: a team may write it with programs of its own. The flyby is the one that the
package's predicted kernels have; corrections of it lie in the axes of its B-plane.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import compress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays, symmetric
from opnav_workbench.errors import EstimationError, SessionError
from opnav_workbench.estimation import (
    BPlane,
    CommonErrorEstimate,
    Estimate,
    FilterEstimate,
    b_plane,
    b_plane_partials,
    estimate_with_common_errors,
    straight_line,
)
from opnav_workbench.estimation.parameters import (
    parameter_count,
    parse_groups,
    relative_state,
    relative_state_matrix,
)
from opnav_workbench.files import json_value, text_of, write_json
from opnav_workbench.kernels import KernelSet, et_from_utc, state
from opnav_workbench.mission import load_mission
from opnav_workbench.observables import Observable
from opnav_workbench.rehearsal.filtering import FilterOptions, filter_residual_row, filter_rows
from opnav_workbench.rehearsal.results import (
    PictureResult,
    chosen_observables,
    noise_covariances_px2,
    picture_results,
    star_turns_rad,
)
from opnav_workbench.version import __version__

if TYPE_CHECKING:
    from opnav_workbench.rehearsal.package import OrtPackage

__all__ = [
    "DISK_SIGMA_PX",
    "SOLUTION_FILE",
    "OrtSolution",
    "PredictedFlyby",
    "predicted_flyby",
    "solve_rehearsal",
]


# ---- The file of a rehearsal's solution, checked field by field.

# Shapes of arrays; n: number of parameters.
ARRAY_SHAPES: dict[str, tuple[int | str, ...]] = {
    "correction": ("n",),
    "sigma_before": ("n",),
    "covariance": ("n", "n"),
    "b_plane_before": (3,),
    "b_plane_after": (3,),
    "b_plane_covariance_before": (3, 3),
    "b_plane_covariance": (3, 3),
}
COVARIANCES = ("covariance", "b_plane_covariance")
NUMBER_FIELDS = ("chi2_before", "chi2_after", "probability")
TEXT_FIELDS = ("words", "left_out", "messages")
OPTIONAL_FIELDS = ("residuals", "pictures", "filter", "made_by", *TEXT_FIELDS)


def checked_numbers(content: Any, what: str, name: str = "") -> None:
    """Refuse a number that is not finite, anywhere in nested values.

    Raises
    ------
    SessionError
        It is named.

    Examples
    --------
    >>> checked_numbers({"sigma": [1.0, float("nan")]}, "solution.json")
    Traceback (most recent call last):
    ...
    opnav_workbench.errors.SessionError: solution.json: sigma is nan; a solution holds finite numbers only.
    """
    if isinstance(content, Mapping):
        for key, value in content.items():
            checked_numbers(value, what, str(key))
    elif isinstance(content, np.ndarray):
        checked_numbers(content.tolist(), what, name)
    elif isinstance(content, list | tuple):
        for value in content:
            checked_numbers(value, what, name)
    elif isinstance(content, float) and not math.isfinite(content):
        raise SessionError(f"{what}: {name} is {content}; a solution holds finite numbers only.")


def write_solution_file(path: str | Path, schema: str, fields: Mapping[str, Any]) -> None:
    """Write the fields of a solution as JSON, whole or not at all.

    Raises
    ------
    SessionError
        A number of it is not finite, or the file cannot be written.
    """
    content = {"schema": schema, **fields}
    checked_numbers(content, str(path))
    write_json(path, content)


def read_solution_file(
    path: str | Path,
    schema: str,
    what: str,
    checked_fields: Callable[[Mapping[str, Any]], dict[str, Any]],
) -> dict[str, Any]:
    """Return the fields of a solution file; `what` it is of stands in the message of another's.

    Raises
    ------
    SessionError
        It cannot be read, is of another schema, lacks a field, or holds numbers that cannot be meant.
    """
    try:
        content = json_value(text_of(path))
    except (OSError, ValueError) as error:
        raise SessionError(f"no solution can be read from {path}: {error}. Run opnav ort solve.") from error
    if not isinstance(content, dict) or content.pop("schema", None) != schema:
        raise SessionError(f"{path} is no solution of {what} (schema {schema}).")
    checked_numbers(content, str(path))
    try:
        return checked_fields(content)
    except KeyError as error:
        raise SessionError(f"{path} lacks {error.args[0]}; run opnav ort solve again.") from error
    except (TypeError, ValueError, EstimationError) as error:
        raise SessionError(f"{path}: {error}") from error


def _checked_fields(content: Mapping[str, Any]) -> dict[str, Any]:
    parameters = tuple(content["parameters"])
    n = parameter_count(parse_groups(parameters))
    fields: dict[str, Any] = {
        "parameters": parameters,
        "degrees_of_freedom": int(content["degrees_of_freedom"]),
        **{name: str(content[name]) for name in ("package", "epoch_utc", "b_plane_body")},
        **{name: float(content[name]) for name in NUMBER_FIELDS},
    }
    for name, shape in ARRAY_SHAPES.items():
        fields[name] = checked_array(
            name, content[name], tuple(n if size == "n" else int(size) for size in shape)
        )
    for name in OPTIONAL_FIELDS:
        if name in content:
            fields[name] = (
                tuple(content[name]) if isinstance(content[name], Sequence | list) else content[name]
            )
    if "made_by" in content:
        fields["made_by"] = str(content["made_by"])
    for name, default in (("disk_sigma_px", 0.0), ("common_share", 0.0), ("error_size", 1.0)):
        fields[name] = float(content.get(name, default))
    fields["history"] = tuple(_cutoff_from_row(row) for row in content.get("history", ()))
    fields["residuals"] = tuple(_residual_from_row(row) for row in content.get("residuals", ()))
    return fields


def checked_array(name: str, value: Any, shape: tuple[int, ...]) -> Any:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}; expected {shape}")
    if name in COVARIANCES and not (
        np.allclose(array, array.T, rtol=1e-9, atol=0.0) and (np.diag(array) > 0.0).all()
    ):
        raise ValueError(f"{name} is no covariance: it must be symmetric with a positive diagonal")
    return array


def _cutoff_from_row(row: Mapping[str, Any]) -> dict[str, Any]:
    shapes = {"b_plane": (3,), "covariance": (3, 3)}
    told = {"picture": str(row["picture"]), "et": float(row["et"]), "pictures": int(row["pictures"])}
    return told | {name: checked_array(name, row[name], shape) for name, shape in shapes.items()}


def _residual_from_row(row: Mapping[str, Any]) -> dict[str, Any]:
    arrays = {name: np.asarray(row[name], float) for name in ("before", "after", "covariance")}
    return dict(row) | arrays


# ---- The flyby of a rehearsal as its predicted kernels have it.


@dataclass(frozen=True, slots=True, eq=False)
class PredictedFlyby:
    """The predicted flyby.

    Attributes
    ----------
    body
        Of the B-plane.
    epoch_et
        Of the state and of the estimated corrections, TDB seconds past J2000.
    state : (6,) array
        Spacecraft relative to the body, J2000, geometric, km and km/s.
    plane
        Of that state.
    """

    body: str
    epoch_et: float
    epoch_utc: str
    state: FloatArray
    gm_km3_s2: float
    pole: str
    plane: BPlane

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def encounter_et(self) -> float:
        """Return the predicted linearised time of arrival, TDB seconds past J2000."""
        return self.epoch_et + float(self.b_plane_values[2])

    @property
    def b_plane_values(self) -> FloatArray:
        """Return (B.T, B.R, linearised time after the epoch), km and s."""
        return self.plane.in_axes_of(self.plane)

    def corrected(self, correction: ArrayLike) -> FloatArray:
        """Return the same of the state with a correction (6,), in the axes of the predicted flyby."""
        state = self.state + np.asarray(correction, float)
        return b_plane(state[:3], state[3:], self.gm_km3_s2, self.pole).in_axes_of(self.plane)

    def covariance(self, correction: ArrayLike, covariance: ArrayLike) -> FloatArray:
        """Map a covariance (6, 6) of the corrected state to (B.T, B.R, time), (3, 3) km^2, km s, s^2."""
        state = self.state + np.asarray(correction, float)
        partials = b_plane_partials(state[:3], state[3:], self.gm_km3_s2, self.pole)
        return symmetric(partials @ np.asarray(covariance, float) @ partials.T)


def predicted_flyby(package: "OrtPackage") -> PredictedFlyby:
    """Return the flyby that a package's own kernels predict.

    Raises
    ------
    KernelError
        The kernels do not hold spacecraft or body at the epoch.
    EstimationError
        There is no flyby.
    """
    if package.b_plane is None:
        raise EstimationError(f"{package.name} is a rehearsal in orbit: it has no flyby.")
    body = package.b_plane.body
    spacecraft = load_mission(package.mission).spacecraft_id
    with KernelSet(package.metakernel):
        epoch = et_from_utc(package.epoch_utc)
        found = state(spacecraft, epoch, body)
    relative = np.concatenate([found.position_km, found.velocity_km_s])
    plane = b_plane(relative[:3], relative[3:], package.b_plane.gm_km3_s2, package.b_plane.pole)
    return PredictedFlyby(
        body, epoch, package.epoch_utc, relative, package.b_plane.gm_km3_s2, package.b_plane.pole, plane
    )


# ---- What a team delivers at the end of a rehearsal.

SOLUTION_FILE = "solution.json"
SCHEMA = "opnav_ort_solution_1"
# The most that a team need add to the sigmas of disks whose centerfinder says nothing of albedo and law. Measured on limb
# scans of Pluto, 67 to 179 px wide, without perturbations: six mottled maps (reflectance 0.2 to 0.8) 0.022 px rms, 0.065 px
# at most, which is 3 of their sigmas in the mean; Lambert's law where a flatter one is expected 0.03 to 0.085 px, always on
# the same side. The paper's Table 3 has 0.03 and 0.12 arcsec, 0.03 and 0.12 px. The method `disk` has them in its own sigma.
DISK_SIGMA_PX = 0.05
MOST_CUTOFFS = 12  # a second of processor time each
# Excess centering error of stars that a calibrated camera stays below.
EXCESS_PX = 0.05
# A fit as bad as this or worse comes by chance once in a thousand rehearsals.
LEAST_PROBABILITY = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class OrtSolution:
    """The solution of a rehearsal; arrays are read-only.

    Attributes
    ----------
    package
        Name of the rehearsal.
    epoch_utc
        Of the corrected states.
    parameters
        Groups, as `estimation.estimate` names them.
    correction, sigma_before : (n,) arrays
        True minus predicted as estimated, and its a priori sigma; km, km/s, J2000.
    covariance : (n, n) array
    b_plane_before, b_plane_after : (3,) arrays
        B.T, B.R (km) and linearised time of flight (s after the epoch), in the axes of the predicted flyby.
    b_plane_covariance_before, b_plane_covariance : (3, 3) arrays
    chi2_before, chi2_after, probability
        Of the measurements' fit.
    residuals
        ``image, body, kind, et, before, after, covariance, sigmas, used, reason`` of every measurement; of a filter, where
        ``after`` is smoothed, ``predicted`` and ``predicted_sigmas`` before it took the picture in as well.
    words
        What the pictures determine, best first.
    pictures
        SHA-256 of the files that it rests on, by picture and file.
    disk_sigma_px
        Added (in squares) to the sigmas of the centers of disks.
    common_share, error_size
        Of the centers' errors beyond noise, what the measurements take to be the same in all pictures, and how large they
        take them to be over what is stated.
    history
        The flyby by time of data cutoff, in order of time: ``picture, et, pictures, b_plane, covariance``; the last picture
        counted, its time, how many are counted, B.T, B.R (km) and time of flight (s), and their covariance.
    filter
        Of a solution by the filter: what it allowed for, names and units of its parameters, a row a picture with what was
        predicted, filtered and smoothed of them, and its edits. Empty: by the batch.
    """

    package: str
    epoch_utc: str
    parameters: tuple[str, ...]
    correction: FloatArray
    sigma_before: FloatArray
    covariance: FloatArray
    b_plane_body: str
    b_plane_before: FloatArray
    b_plane_after: FloatArray
    b_plane_covariance_before: FloatArray
    b_plane_covariance: FloatArray
    chi2_before: float
    chi2_after: float
    degrees_of_freedom: int
    probability: float
    residuals: tuple[Mapping[str, Any], ...] = ()
    words: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    messages: tuple[str, ...] = ()
    pictures: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    made_by: str = f"opnav_workbench {__version__}"
    disk_sigma_px: float = 0.0
    common_share: float = 0.0
    error_size: float = 1.0
    history: tuple[Mapping[str, Any], ...] = ()
    filter: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def labels(self) -> tuple[str, ...]:
        """Return the names of the parameters (n,)."""
        return tuple(label for group in parse_groups(self.parameters) for label in group.labels)

    @property
    def units(self) -> tuple[str, ...]:
        """Return their units (n,)."""
        return tuple(group.unit for group in parse_groups(self.parameters) for _ in range(group.size))

    @property
    def sigma(self) -> FloatArray:
        """Return the standard deviations (n,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def b_plane_sigma(self) -> FloatArray:
        """Return the standard deviations of B.T, B.R (km) and time (s)."""
        return np.asarray(np.sqrt(np.diag(self.b_plane_covariance)))

    @property
    def b_plane_sigma_before(self) -> FloatArray:
        """Return the same before the pictures were taken."""
        return np.asarray(np.sqrt(np.diag(self.b_plane_covariance_before)))

    @property
    def b_plane_shift(self) -> FloatArray:
        """Return what the correction moves: (B.T, B.R, time), km and s."""
        return np.asarray(self.b_plane_after - self.b_plane_before)

    def write(self, path: str | Path) -> None:
        """Write it as JSON, whole or not at all.

        Raises
        ------
        SessionError
            A number of it is not finite, or the file cannot be written.
        """
        write_solution_file(path, SCHEMA, {name: getattr(self, name) for name in self.__slots__})

    @classmethod
    def read(cls, path: str | Path) -> "OrtSolution":
        """Read what `write` wrote, or what a team filled in by hand after its layout.

        Raises
        ------
        SessionError
            It cannot be read, lacks a field, or holds numbers of the wrong shape, or a matrix that is no covariance.
        """
        return cls(**read_solution_file(path, SCHEMA, "a rehearsal", _checked_fields))


def solve_rehearsal(
    package: "OrtPackage",
    results: str | Path,
    *,
    disk_sigma_px: float = 0.0,
    history: bool = False,
    filtered: FilterOptions | None = None,
) -> OrtSolution:
    """Estimate a package's parameters from what a team found in its pictures.

    Parameters
    ----------
    results
        Folder of the pictures' folders, each with ``result.json`` and ``observables.ecsv``.
    disk_sigma_px
        Added (in squares) to the sigmas of the centers of disks, for surfaces of which a centerfinder says nothing.
    history
        Solve after every picture as well (of many, after a dozen of them), for the flyby by time of data cutoff.
    filtered
        Solve picture by picture in the square-root filter, with what it allows for; None: in one batch.

    Raises
    ------
    SessionError
        The folder or a file in it cannot be read.
    EstimationError
        No picture gives a center, or the centers contradict each other.
    """
    pictures = picture_results((p.name for p in package.pictures), results)
    observables, left_out = chosen_observables(pictures, disk_sigma_px)
    flyby = predicted_flyby(package)
    noise, turns = noise_covariances_px2(pictures, observables), star_turns_rad(pictures)
    options = None if filtered is None else filtered.keywords(package, flyby.state, flyby.encounter_et)
    common = _solved(package, flyby, observables, noise, turns, options)
    found = common.independent
    fit = found if common.filtered is None else common.filtered
    after, after_covariance = common.relative_state(flyby.body)
    before_covariance = _a_priori_covariance(found)
    relative = relative_state_matrix(found.groups, len(found.correction), flyby.body)
    return OrtSolution(
        package=package.name,
        epoch_utc=package.epoch_utc,
        parameters=tuple(package.parameters),
        correction=common.correction,
        sigma_before=np.sqrt(np.diag(before_covariance)),
        covariance=common.covariance,
        b_plane_body=flyby.body,
        b_plane_before=flyby.b_plane_values,
        b_plane_after=flyby.corrected(after),
        b_plane_covariance_before=flyby.covariance(np.zeros(6), relative @ before_covariance @ relative.T),
        b_plane_covariance=flyby.covariance(after, after_covariance),
        chi2_before=found.chi2_before,
        chi2_after=found.chi2_after if common.filtered is None else common.filtered.chi2,
        degrees_of_freedom=fit.degrees_of_freedom,
        probability=fit.probability,
        residuals=_residual_rows(common),
        words=tuple(d.words for d in found.directions),
        left_out=left_out,
        messages=(*_camera_message(pictures), *_messages(fit, common.size)),
        pictures={p.name: p.sha256 for p in pictures if p.sha256},
        disk_sigma_px=disk_sigma_px,
        common_share=common.share,
        error_size=common.size,
        history=_history(package, flyby, observables, noise, turns, common) if history else (),
        filter={} if filtered is None or common.filtered is None else filter_rows(common.filtered, filtered),
    )


def _solved(
    package: "OrtPackage",
    flyby: PredictedFlyby,
    observables: Sequence[Observable],
    noise: Sequence[FloatArray | None],
    turns: Mapping[str, Mapping[str, FloatArray]],
    options: Mapping[str, Any] | None,
) -> CommonErrorEstimate:
    return estimate_with_common_errors(
        observables,
        noise,
        tuple(package.parameters),
        epoch_et=flyby.epoch_et,
        a_priori=dict(package.parameters),
        target_transition=straight_line,
        spacecraft_transition=straight_line,
        filter_options=options,
        star_turns_rad=turns,
    )


def _history(
    package: "OrtPackage",
    flyby: PredictedFlyby,
    observables: Sequence[Observable],
    noise: Sequence[FloatArray | None],
    turns: Mapping[str, Mapping[str, FloatArray]],
    common: CommonErrorEstimate,
) -> tuple[dict[str, Any], ...]:
    """Return the flyby as known after each picture: as the filter passes it, or solved anew by the batch."""
    times = sorted({(o.et, o.image) for o in observables})
    known = list(common.steps)
    if common.filtered is None:
        chosen = np.linspace(0, len(times) - 1, min(len(times), MOST_CUTOFFS)).round().astype(int)
        for et, image in (times[k] for k in np.unique(chosen).tolist()):
            counted = [(o.et, o.image) <= (et, image) for o in observables]
            with suppress(EstimationError):  # they contradict each other, or do not determine it yet
                so_far = list(compress(observables, counted)), list(compress(noise, counted))
                found = _solved(package, flyby, *so_far, turns, None)
                known.append((image, et, found.correction, found.covariance))
    rows = []
    for image, et, correction, covariance in known:
        after, of_after = relative_state(common.independent.groups, correction, covariance, flyby.body)
        rows.append(
            {
                "picture": Path(image).stem,
                "et": float(et),
                "pictures": 1 + times.index((et, image)),
                "b_plane": flyby.corrected(after),
                "covariance": flyby.covariance(after, of_after),
            }
        )
    return tuple(rows)


def _a_priori_covariance(found: Estimate) -> FloatArray:
    rows = found.a_priori_rows
    return symmetric(np.asarray(np.linalg.inv(rows.T @ rows), dtype=np.float64))


def _residual_rows(common: CommonErrorEstimate) -> tuple[dict[str, Any], ...]:
    if common.filtered is not None:
        return tuple(filter_residual_row(r) for r in common.filtered.residuals)
    return tuple(
        {name: getattr(r, name) for name in r.__slots__} | {"after": after}
        for r, after in zip(common.independent.residuals, common.after, strict=True)
    )


def _camera_message(pictures: Sequence[PictureResult]) -> tuple[str, ...]:
    """Warn of star residuals that no noise explains: a camera error is common to all pictures, and not in the sigmas."""
    excess = [float(p.result["pointing"].get("excess_sigma_px") or 0.0) for p in pictures if p.solved]
    large = [value for value in excess if value > EXCESS_PX]
    if 2 * len(large) <= len(excess) or not large:
        return ()
    words = (
        f"stars of {len(large)} of {len(excess)} pictures are off by {np.median(large):.2f} px more than their noise: the "
        "camera may not be as calibrated; what is common to all pictures is not in these sigmas (see opnav calibrate)"
    )
    return (words,)


def _messages(found: Estimate | FilterEstimate, size: float) -> tuple[str, ...]:
    messages = list(found.messages)
    counted = f"their errors beyond noise count {size:.2g} times what is stated"
    chi2 = found.chi2 if isinstance(found, FilterEstimate) else found.chi2_after
    if found.probability < LEAST_PROBABILITY:
        messages.append(
            f"chi-squared {chi2:.1f} for {found.degrees_of_freedom} degrees of freedom (probability "
            f"{found.probability:.1g}): the centers' sigmas are too small ({counted}), or something is wrong that is not "
            "estimated"
        )
    if found.probability > 1.0 - LEAST_PROBABILITY:
        messages.append(
            f"chi-squared {chi2:.1f} for {found.degrees_of_freedom} degrees of freedom: the centers agree "
            f"better than their sigmas say: {counted}"
        )
    messages += [
        f"{r.body} in {r.image}: {r.kind} not used, {r.reason}" for r in found.residuals if not r.used
    ]
    return tuple(messages)

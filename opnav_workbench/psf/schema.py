"""PSFs in YAML files, such as under ``psf: {model: ...}`` of a camera file."""

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, Field, PositiveFloat, PositiveInt, model_validator

from opnav_workbench.errors import CameraError
from opnav_workbench.psf.empirical import EmpiricalPsf
from opnav_workbench.psf.gaussian import FieldPsf, GaussianPsf, GridShape, PolynomialShape
from opnav_workbench.psf.protocol import Psf
from opnav_workbench.psf.tabulated import MoffatPsf
from opnav_workbench.psf.trailed import TrailedPsf
from opnav_workbench.yaml_file import StrictModel, check_model

__all__ = ["AnyPsf", "psf_from_mapping"]

Row = tuple[float, ...]
Rows = tuple[Row, ...]


class _Gaussian(StrictModel):
    """Either one width, or two and the angle of the wider one from +pixel toward +line."""

    model: Literal["gaussian"]
    sigma_px: PositiveFloat | None = None
    sigma_major_px: PositiveFloat | None = None
    sigma_minor_px: PositiveFloat | None = None
    angle_deg: float = 0.0

    @model_validator(mode="after")
    def _one_or_two(self) -> "_Gaussian":
        both = self.sigma_major_px is not None and self.sigma_minor_px is not None
        neither = self.sigma_major_px is None and self.sigma_minor_px is None
        if not (both if self.sigma_px is None else neither):
            raise ValueError("give sigma_px, or sigma_major_px and sigma_minor_px")
        return self

    def build(self, _folder: Path) -> Psf:
        major = self.sigma_px or self.sigma_major_px or 0.0
        return GaussianPsf(major, self.sigma_minor_px or major, float(np.radians(self.angle_deg)))


class _Moffat(StrictModel):
    model: Literal["moffat"]
    fwhm_px: PositiveFloat
    beta: Annotated[float, Field(gt=1.0)]
    cut_share: Annotated[float, Field(gt=0.0, lt=1.0)] = 1e-3

    def build(self, _folder: Path) -> Psf:
        return MoffatPsf(self.fwhm_px, self.beta, self.cut_share)


class _Empirical(StrictModel):
    """The file that `EmpiricalPsf.save` wrote, or the samples themselves."""

    model: Literal["empirical"]
    file: str | None = None
    samples: Rows | None = None
    oversampling: PositiveInt | None = None

    @model_validator(mode="after")
    def _file_or_samples(self) -> "_Empirical":
        given = self.samples is not None and self.oversampling is not None
        none = self.samples is None and self.oversampling is None
        if not (given if self.file is None else none):
            raise ValueError("give file, or samples and oversampling")
        return self

    def build(self, folder: Path) -> Psf:
        if self.file is not None:
            return EmpiricalPsf.load(folder / self.file)
        rows = self.samples or ()
        if len({len(row) for row in rows}) != 1:
            raise CameraError("PSF samples: rows of different lengths; give a square with an odd side.")
        return EmpiricalPsf(np.array(rows), self.oversampling or 1)


class _Polynomial(StrictModel):
    sigma_px: Row
    e1: Row = (0.0,)
    e2: Row = (0.0,)


class _Grid(StrictModel):
    pixel: Row
    line: Row
    sigma_px: Rows
    e1: Rows | None = None
    e2: Rows | None = None


class _Field(StrictModel):
    model: Literal["field"]
    n_pixel: PositiveInt
    n_line: PositiveInt
    polynomial: _Polynomial | None = None
    grid: _Grid | None = None

    @model_validator(mode="after")
    def _one_of_both(self) -> "_Field":
        if (self.polynomial is None) == (self.grid is None):
            raise ValueError("give polynomial or grid")
        return self

    def build(self, _folder: Path) -> Psf:
        size = (self.n_pixel, self.n_line)
        if self.polynomial is not None:
            return FieldPsf(PolynomialShape(size, **_arrays(self.polynomial)))
        assert self.grid is not None
        return FieldPsf(GridShape(size, **_arrays(self.grid)))


class _Trailed(StrictModel):
    model: Literal["trailed"]
    psf: "AnyPsf"
    offsets_px: tuple[tuple[float, float], ...]
    weights: Row | None = None  # equal

    def build(self, folder: Path) -> Psf:
        offsets = np.array(self.offsets_px, dtype=np.float64).reshape(-1, 2)
        weights = np.ones(len(offsets)) if self.weights is None else np.array(self.weights)
        return TrailedPsf(self.psf.build(folder), offsets, weights)


AnyPsf = Annotated[_Gaussian | _Moffat | _Empirical | _Field | _Trailed, Field(discriminator="model")]


class _Wrapped(StrictModel):
    psf: AnyPsf


def psf_from_mapping(mapping: Mapping[str, Any], folder: str | PathLike[str] = ".") -> Psf:
    """Build a PSF from a mapping such as a YAML file holds.

    Parameters
    ----------
    mapping
        ``model`` is gaussian, moffat, empirical, field or trailed; the rest are the model's parameters.
    folder : path-like
        What the file name of a template is relative to.

    Raises
    ------
    CameraError
        An unknown model, field or value; the message names it.

    Examples
    --------
    >>> psf_from_mapping({"model": "moffat", "fwhm_px": 2.0, "beta": 3.5})
    MoffatPsf(fwhm_px=2.0, beta=3.5, cut_share=0.001)
    >>> psf_from_mapping({"model": "gaussian", "sigma": 0.8})
    Traceback (most recent call last):
    opnav_workbench.errors.CameraError: PSF: psf.sigma: unknown field, did you mean sigma_px?
    """
    return check_model({"psf": dict(mapping)}, _Wrapped, "PSF", CameraError).psf.build(Path(folder))


def _arrays(part: BaseModel) -> dict[str, Any]:
    """Return the fields of a model as arrays; rows of different lengths are refused."""
    arrays: dict[str, Any] = {}
    for name in type(part).model_fields:
        value = getattr(part, name)
        try:
            arrays[name] = None if value is None else np.array(value, dtype=np.float64)
        except ValueError as error:
            raise CameraError(f"PSF field: {name} has rows of different lengths.") from error
    return arrays

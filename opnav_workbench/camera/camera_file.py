"""Camera files: their schema, and the fields of a `Camera` that they give.

One file describes one camera in one readout mode; the schema says what each field is called, its unit and what values it
may take. The files under ``kernels_meta/<mission>/cameras`` are the examples. A number that nobody knows is null.
"""

from os import PathLike
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args

import numpy as np
from pydantic import BaseModel, BeforeValidator, Field, PositiveFloat, PositiveInt

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera.distortion import (
    BrownDistortion,
    Distortion,
    ForwardSipDistortion,
    LegendreDistortion,
    NoDistortion,
    OwenDistortion,
    SipDistortion,
)
from opnav_workbench.camera.lens_models import (
    CahvorDistortion,
    FisheyeDistortion,
    RadialDistortion,
    RationalDistortion,
    TaylorDistortion,
)
from opnav_workbench.camera.origins import Origin
from opnav_workbench.camera.priors import AttitudeSigma, ExposureLimits, PsfPrior
from opnav_workbench.camera.reseau import Reseau
from opnav_workbench.camera.rows import RowTiming
from opnav_workbench.errors import CameraError
from opnav_workbench.photometry import Bandpass, ColorResponse
from opnav_workbench.psf import EffectivePsf
from opnav_workbench.psf.schema import AnyPsf
from opnav_workbench.yaml_file import Pair, StrictModel, Vector3, read_model

__all__ = ["DETECTOR", "LENS_NAMES", "NAMES", "OPTICS", "ZERO_POINT", "CameraFile", "camera_fields"]


# ---- The schema of camera files: what each field is called, its unit, and what values it may take.

NotNegative = Annotated[float, Field(ge=0.0)]
Share = Annotated[float, Field(ge=0.0, lt=1.0)]
Terms = Annotated[tuple[float, ...], Field(min_length=20, max_length=20)]
TaylorTerms = Annotated[tuple[float, ...], Field(min_length=10, max_length=10)]
QuadraticTerms = Annotated[tuple[float, ...], Field(min_length=6, max_length=6)]


def _powers(value: Any) -> Any:
    """Turn SIP keys ``3_0`` into (3, 0)."""
    if not isinstance(value, dict):
        return value
    return {tuple(str(key).split("_")): coefficient for key, coefficient in value.items()}


SipTerms = Annotated[dict[tuple[int, int], float], BeforeValidator(_powers)]


class _Lens(StrictModel):
    """A distortion: its coefficients have the names that they have in its model."""

    lens: ClassVar[type[Distortion]]

    def build(self, focal_mm: float, _pixel_from_mm: FloatArray) -> Distortion:
        return self.lens(**self._terms(focal_mm))

    def _terms(self, _focal_mm: float) -> dict[str, Any]:
        return self.model_dump(exclude={"model"})


class _LensOfFocalLength(_Lens):
    """A distortion that counts in focal lengths."""

    def _terms(self, focal_mm: float) -> dict[str, Any]:
        return {"focal_mm": focal_mm, **super()._terms(focal_mm)}


class _NoDistortion(_Lens):
    lens = NoDistortion
    model: Literal["none"]


class _Owen(_Lens):
    lens = OwenDistortion
    model: Literal["owen"]
    e1_per_mm: float = 0.0
    e2_per_mm2: float = 0.0
    e3_per_mm3: float = 0.0
    e4_per_mm4: float = 0.0
    e5_per_mm: float = 0.0
    e6_per_mm: float = 0.0


class _Brown(_LensOfFocalLength):
    """OpenCV's coefficients, dimensionless."""

    lens = BrownDistortion
    model: Literal["brown"]
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    s1: float = 0.0
    s2: float = 0.0
    s3: float = 0.0
    s4: float = 0.0


class _Sip(_Lens):
    """Coefficients of u^p v^q keyed ``p_q``, px^(1 - p - q)."""

    lens = SipDistortion
    model: Literal["sip"]
    ap: SipTerms
    bp: SipTerms

    def build(self, _focal_mm: float, pixel_from_mm: FloatArray) -> Distortion:
        return SipDistortion.from_coefficients(pixel_from_mm, self.ap, self.bp)


class _ForwardSip(_Lens):
    """Coefficients of u^p v^q keyed ``p_q``, px^(1 - p - q)."""

    lens = ForwardSipDistortion
    model: Literal["sip_forward"]
    a: SipTerms
    b: SipTerms

    def build(self, _focal_mm: float, pixel_from_mm: FloatArray) -> Distortion:
        return ForwardSipDistortion.from_coefficients(pixel_from_mm, self.a, self.b)


class _Legendre(_Lens):
    lens = LegendreDistortion
    model: Literal["legendre"]
    half_size_mm: Pair
    x_coefficients: Terms
    y_coefficients: Terms


class _Radial(_Lens):
    """As ISIS has it: ideal = distorted (1 - k0 - k1 r^2 - ...), r mm as measured."""

    lens = RadialDistortion
    model: Literal["radial"]
    k0: float = 0.0
    k1_per_mm2: float = 0.0
    k2_per_mm4: float = 0.0
    k3_per_mm6: float = 0.0


class _Taylor(_Lens):
    """Coefficients of 1, x, y, x^2, x y, y^2, x^3, x^2 y, x y^2, y^3 (mm), distorted from ideal."""

    lens = TaylorDistortion
    model: Literal["taylor"]
    x_coefficients: TaylorTerms
    y_coefficients: TaylorTerms


class _Rational(_Lens):
    """Coefficients of x^2, x y, y^2, x, y, 1 (mm), ideal from distorted."""

    lens = RationalDistortion
    model: Literal["rational"]
    x_numerator: QuadraticTerms
    y_numerator: QuadraticTerms
    denominator: QuadraticTerms


class _Fisheye(_LensOfFocalLength):
    """Kannala-Brandt: OpenCV's coefficients of the angle."""

    lens = FisheyeDistortion
    model: Literal["fisheye"]
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0


class _Cahvor(_LensOfFocalLength):
    """The O and R of CAHVOR and CAHVORE; `axis` in focal axes (pixel, line, boresight)."""

    lens = CahvorDistortion
    model: Literal["cahvor"]
    axis: Vector3 = (0.0, 0.0, 1.0)
    r0: float = 0.0
    r1: float = 0.0
    r2: float = 0.0
    linearity: Annotated[float, Field(ge=-1.0, le=1.0)] = 1.0


AnyDistortion = Annotated[
    _NoDistortion
    | _Owen
    | _Brown
    | _Sip
    | _ForwardSip
    | _Legendre
    | _Radial
    | _Taylor
    | _Rational
    | _Fisheye
    | _Cahvor,
    Field(discriminator="model"),
]


LENS_NAMES: dict[type[Distortion], str] = {
    schema.lens: get_args(schema.model_fields["model"].annotation)[0]
    for schema in get_args(get_args(AnyDistortion)[0])
}


class _Optics(StrictModel):
    focal_length_mm: PositiveFloat
    aperture_m: PositiveFloat | None = None
    obscuration: Share = 0.0
    pixel_from_mm: tuple[Pair, Pair]
    focal_from_camera: tuple[Vector3, Vector3, Vector3]
    distortion: AnyDistortion


MOST_LINES = 16_384  # along an edge: no camera that navigates has half as many


class _Rows(StrictModel):
    """Lines that are not exposed together; the picture's time is that of its middle line.

    `line_time_s` goes from a line to the next one, and is negative where the last line comes first. `detector_line`, of a
    line scanner, is the detector's line (as the picture counts lines) that every line of the picture comes from;
    without it the shutter rolls. Through `tdi_lines` of a scanner the charge follows the scan (time delay and integration).
    """

    line_time_s: float
    detector_line: float | None = None
    tdi_lines: PositiveInt = 1

    def build(self) -> RowTiming:
        return RowTiming(self.line_time_s, self.detector_line, self.tdi_lines)


class _Reseau(StrictModel):
    """Marks on the faceplate of a vidicon, of a camera whose pictures are raw: each picture's distortion is fitted to them.

    `marks_px`: about where they stand in a picture, pixel and line; `ideal_mm`: where they stand on the focal plane.
    """

    marks_px: tuple[Pair, ...]
    ideal_mm: tuple[Pair, ...]

    def build(self) -> Reseau:
        return Reseau(np.array(self.marks_px), np.array(self.ideal_mm))


class _Detector(StrictModel):
    n_pixel: Annotated[int, Field(ge=1, le=MOST_LINES)]
    n_line: Annotated[int, Field(ge=1, le=MOST_LINES)]
    center_pixel_line: Pair
    bits: Annotated[int, Field(ge=1, le=32)] | None = None
    gain_e_per_dn: PositiveFloat | None = None
    read_noise_dn: NotNegative | None = None
    saturation_dn: PositiveFloat | None = None
    bias_dn: NotNegative | None = None
    full_well_e: PositiveFloat | None = None
    dark_current_e_s: NotNegative | None = None
    frame_transfer_s: NotNegative | None = None
    prnu: Share | None = None
    hot_pixel_fraction: Share | None = None
    dead_pixel_fraction: Share | None = None
    exposure_min_s: NotNegative | None = None
    exposure_max_s: PositiveFloat | None = None
    rows: _Rows | None = None
    reseau: _Reseau | None = None

    def exposure_limits(self) -> ExposureLimits | None:
        if self.exposure_min_s is None or self.exposure_max_s is None:
            return None
        return ExposureLimits(self.exposure_min_s, self.exposure_max_s)


class _Bandpass(StrictModel):
    """A curve of electrons per photon; with a peak, the curve gives its shape only."""

    wavelength_nm: Annotated[tuple[float, ...], Field(min_length=2)]
    response: Annotated[tuple[NotNegative, ...], Field(min_length=2)]
    peak: Annotated[float, Field(gt=0.0, le=1.0)] | None = None

    def build(self) -> Bandpass:
        curve = Bandpass(np.array(self.wavelength_nm), np.array(self.response))
        return curve if self.peak is None else curve.scaled_to(self.peak)


class _Color(StrictModel):
    slope_mag_per_bv: float
    sigma_mag: PositiveFloat
    reference_b_v: float = 0.0
    curvature_mag_per_bv2: float = 0.0

    def build(self) -> ColorResponse:
        return ColorResponse(**self.model_dump())


class _Photometry(StrictModel):
    zero_point_mag: float | None = None
    zero_point_b_v: float = 0.0
    bandpass: _Bandpass | None = None
    color: _Color | None = None


class _Psf(StrictModel):
    """``effective`` names the file that `EffectivePsf.save` wrote: what pictures say of light within a pixel."""

    sigma_px: PositiveFloat
    sigma_sigma_px: PositiveFloat
    model: AnyPsf | None = None
    effective: str | None = None


class _Attitude(StrictModel):
    cross_px: PositiveFloat
    twist_deg: PositiveFloat


class _Origin(StrictModel):
    field: str
    how: Literal["known", "derived", "guessed"]
    text: str


# Fields of a `Camera` that stand in its file as they are, part by part.
NAMES = ("name", "frame", "instrument_id", "source", "confirmed_by")
OPTICS = ("focal_length_mm", "aperture_m", "obscuration", "pixel_from_mm", "focal_from_camera")
DETECTOR = (
    "n_pixel", "n_line", "center_pixel_line", "bits", "gain_e_per_dn", "read_noise_dn", "saturation_dn", "bias_dn",
    "full_well_e", "dark_current_e_s", "frame_transfer_s", "prnu", "hot_pixel_fraction", "dead_pixel_fraction",
)  # fmt: skip
ZERO_POINT = ("zero_point_mag", "zero_point_b_v")


class CameraFile(StrictModel):
    """One camera in one readout mode, as a YAML file describes it.

    `confirmed_by` says which pictures or labels have shown that it is right; `origins` which values were known, derived or
    guessed, where a program wrote the file.
    """

    name: str
    frame: str
    instrument_id: int
    source: str
    confirmed_by: str = ""
    origins: tuple[_Origin, ...] = ()
    optics: _Optics
    detector: _Detector
    psf: _Psf
    photometry: _Photometry = _Photometry()
    attitude_sigma: _Attitude

    def fields(self, folder: Path) -> dict[str, Any]:
        """Return the fields of `opnav_workbench.camera.Camera`; file names are relative to `folder`."""
        photometry = self.photometry
        optics, detector = self.optics, self.detector
        matrix = np.array(optics.pixel_from_mm)
        copied: tuple[tuple[BaseModel, tuple[str, ...]], ...] = (
            (self, NAMES),
            (optics, OPTICS),
            (detector, DETECTOR),
            (photometry, ZERO_POINT),
        )
        values = {name: getattr(part, name) for part, names in copied for name in names}
        return values | {
            "distortion": optics.distortion.build(optics.focal_length_mm, matrix),
            "psf": PsfPrior(self.psf.sigma_px, self.psf.sigma_sigma_px),
            "psf_shape": None if self.psf.model is None else self.psf.model.build(folder),
            "effective_psf": None
            if self.psf.effective is None
            else EffectivePsf.load(folder / self.psf.effective),
            "bandpass": None if photometry.bandpass is None else photometry.bandpass.build(),
            "color_response": None if photometry.color is None else photometry.color.build(),
            "attitude_sigma": AttitudeSigma(self.attitude_sigma.cross_px, self.attitude_sigma.twist_deg),
            "exposure_limits": detector.exposure_limits(),
            "rows": None if detector.rows is None else detector.rows.build(),
            "reseau": None if detector.reseau is None else detector.reseau.build(),
            "origins": tuple(Origin(o.field, o.how, o.text) for o in self.origins),
        }


# ---- Camera files.


def camera_fields(path: str | PathLike[str]) -> dict[str, Any]:
    """Return the fields of `opnav_workbench.camera.Camera` that a camera file gives.

    Raises
    ------
    CameraError
        The file cannot be read or breaks the schema.
    """
    file = read_model(path, CameraFile, "camera file", CameraError)
    try:
        return file.fields(Path(path).parent)
    except CameraError as error:
        raise CameraError(f"camera file {path}: {error}") from error

"""A camera in one readout: a window of its detector, pixels binned; one camera file then serves all modes."""

from dataclasses import replace

import numpy as np

from opnav_workbench.camera.model import Camera
from opnav_workbench.camera.priors import AttitudeSigma, PsfPrior
from opnav_workbench.errors import CameraError

__all__ = ["read_out"]


def read_out(
    camera: Camera,
    *,
    binning: tuple[int, int] = (1, 1),
    first: tuple[int, int] = (0, 0),
    size: tuple[int, int] | None = None,
    line_time_s: float | None = None,
) -> Camera:
    """Return the camera as its pictures of a window and a binning show the sky.

    Parameters
    ----------
    binning
        Pixels of the detector in one of the picture, along pixel and line.
    first
        Pixel and line of the detector, counted from 0, at which the window begins.
    size
        Pixels and lines of the picture; without, to the detector's end. A scan may have any number of lines.
    line_time_s
        From a line of the picture to the next one, of a camera with `rows`; without, its file's times the binning.

    Raises
    ------
    CameraError
        The window lies off the detector.

    Examples
    --------
    >>> from opnav_workbench.resources import kernels_meta_dir
    >>> whole = Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml")
    >>> half = read_out(whole, binning=(2, 2))
    >>> half.n_pixel, half.center_pixel_line.tolist()
    (512, [255.5, 255.5])
    """
    if line_time_s is not None and camera.rows is None:
        raise CameraError(
            f"{camera.name}: its file has no rows, but a header tells the time from line to line."
        )
    if (
        line_time_s is None
        and binning == (1, 1)
        and first == (0, 0)
        and size in (None, (camera.n_pixel, camera.n_line))
    ):
        return camera
    detector, step, start = (np.array(v) for v in ((camera.n_pixel, camera.n_line), binning, first))
    if camera.scans and size is not None:
        detector[1] = max(detector[1], start[1] + step[1] * size[1])
    count = (detector - start) // np.maximum(step, 1) if size is None else np.array(size)
    if not (
        (step >= 1).all()
        and (start >= 0).all()
        and (count >= 1).all()
        and (start + step * count <= detector).all()
    ):
        raise CameraError(
            f"{camera.name}: a window of {count.tolist()} pixels of {list(binning)} from {list(first)} on is not on its "
            f"detector of {detector.tolist()}."
        )
    together = float(np.sqrt(step.prod()))
    psf, sigma = camera.psf, camera.attitude_sigma
    rows = camera.rows
    if rows is not None:
        line = rows.detector_line
        there = None if line is None else float((line - start[1] + 0.5) / step[1] - 0.5)
        each_s = rows.line_time_s * float(step[1])
        line_s = each_s if line_time_s is None else float(np.copysign(line_time_s, each_s))
        rows = replace(rows, line_time_s=line_s, detector_line=there)
    return replace(
        camera,
        rows=rows,
        reseau=None,  # whose marks are told for whole pictures
        n_pixel=int(count[0]),
        n_line=int(count[1]),
        center_pixel_line=(camera.center_pixel_line - start + 0.5) / step - 0.5,
        pixel_from_mm=camera.pixel_from_mm / step[:, None],
        psf=PsfPrior(psf.sigma_px / together, psf.sigma_sigma_px / together),
        psf_shape=camera.psf_shape if together == 1.0 else None,
        effective_psf=camera.effective_psf if together == 1.0 else None,
        attitude_sigma=AttitudeSigma(sigma.cross_px / together, sigma.twist_deg),
    )

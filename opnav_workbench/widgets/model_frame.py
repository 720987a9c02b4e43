"""The whole frame as the session's solutions explain it: background, fitted stars, fitted bodies."""

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.session import ImageSession

__all__ = ["difference_frame", "model_frame"]


def model_frame(session: ImageSession) -> FloatArray:
    """Return the modelled picture (n_line, n_pixel), DN.

    A star's model counts in its own box, a body's in its sub-array; where boxes overlap each pixel takes the larger
    star, because each box holds its star alone.
    """
    model = np.zeros_like(session.context.signal_dn)
    if session.state.a_priori is not None and session.state.centers is not None:
        for box in session.star_boxes():
            _lay(model, box.first_px, box.model_dn)
    for body in session.state.bodies:
        if body.pictures is not None:
            _lay(model, body.pictures.window[:2], body.pictures.model_dn)
    return model + session.context.background.level_dn


def difference_frame(session: ImageSession) -> FloatArray:
    """Return picture minus model (n_line, n_pixel), DN; nan in bad pixels."""
    frame = session.context.frame
    return np.where(frame.bad, np.nan, frame.image_dn - model_frame(session))


def _lay(model: FloatArray, first_px: tuple[int, int], part: FloatArray) -> None:
    pixel, line = first_px
    rows = np.arange(line, line + part.shape[0])
    columns = np.arange(pixel, pixel + part.shape[1])
    ok_rows = (rows >= 0) & (rows < model.shape[0])
    ok_columns = (columns >= 0) & (columns < model.shape[1])
    there = np.ix_(rows[ok_rows], columns[ok_columns])
    values = part[np.ix_(ok_rows, ok_columns)]
    model[there] = np.fmax(model[there], np.nan_to_num(values))

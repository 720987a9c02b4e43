"""The attitude from the stars alone: where header and kernels are silent, not to be asked, or proven wrong.

At opening (`open_inputs`) it is the a priori attitude, where there is no other. Later (`lost_field`) it is a place to look
at: where detections enough match nothing around the a priori pointing, the whole sky is searched. Both are good to some
pixels; what is in the picture is then identified and fitted as ever.

A picture that only its mirror image makes a star field of, or one of another scale, does not belong to its camera file:
that is said, and nothing is solved with the wrong camera.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from opnav_workbench.camera import Camera
from opnav_workbench.catalog import Catalog, open_catalog
from opnav_workbench.errors import CatalogError, SessionError
from opnav_workbench.lazy_names import module_on_demand
from opnav_workbench.session.context import Context, with_focal_scale
from opnav_workbench.session.inputs import (
    Inputs,
    InputSource,
    LostField,
    NoAttitudeError,
    NoAttitudeKernelError,
    collect_inputs,
    with_sweep,
)
from opnav_workbench.session.orientation import CAMERA_FILE, mirrored_words
from opnav_workbench.session.star_field import star_detections
from opnav_workbench.stars import StarFlag

if TYPE_CHECKING:
    from opnav_workbench.stars import lost_in_space
else:  # most pictures know roughly where they look
    lost_in_space = module_on_demand("opnav_workbench.stars.lost_in_space")

__all__ = ["asked_field", "lost_field", "open_inputs"]

FOCAL_PX = (
    1.0  # what another focal length may move a star at the picture's edge, and a camera file still be right
)
FOCAL_SIGMAS = 3.0
WITHOUT_SKY = "Bodies are measured without any attitude, in the picture alone, with --attitude unknown."


def open_inputs(
    context: Context, source: InputSource, catalog: Catalog | None = None
) -> tuple[Context, Inputs]:
    """Collect the inputs, the attitude from the stars where nothing else tells it.

    Where they tell another focal length than the camera file, the context returned has it (``focal_scale`` of its
    settings).

    Raises
    ------
    OpNavError
        As `inputs.collect_inputs`; where the stars do not tell the attitude, either, why not.
    """
    try:
        inputs = collect_inputs(context, source, catalog)
    except (NoAttitudeError, NoAttitudeKernelError) as silent:
        if context.camera.scans:
            raise  # without its motion a line scan is no picture of the sky
        catalog = catalog or open_catalog(source.catalog)
        answer = _searched(context, catalog)
        if (answer is None or answer.camera_from_j2000 is None) and source.by_hand:
            return context, collect_inputs(context, replace(source, attitude="unknown"), catalog)
        if answer is None or answer.camera_from_j2000 is None:
            raise type(silent)(f"{silent} {_why_not(context, answer)} {WITHOUT_SKY}") from silent
        context, said = _with_focal_length(context, answer)
        lost = LostField(answer.camera_from_j2000, f"no a priori attitude: {answer.message}{said}")
        inputs = collect_inputs(context, source, catalog, lost)
    return with_sweep(context, inputs.sweep), inputs


def lost_field(
    context: Context,
    source: InputSource,
    inputs: Inputs,
    catalog: Catalog | None = None,
    *,
    patient: bool = False,
) -> LostField | None:
    """Return where on the sky the picture was taken, or why it is no picture of this camera; None where nobody knows.

    Nobody waits for the index of a deep catalog who has not asked (attitude ``none``, `asked_field`): it is then left.
    A `patient` caller does, half a minute for two million stars, once; he then asks only where others did not look.
    """
    try:
        catalog = catalog or open_catalog(source.catalog)
        at_hand = lost_in_space.is_index_at_hand(catalog, context.camera)
        wanted = at_hand if not patient else not at_hand and lost_in_space.is_index_made_soon(catalog)
        answer = _searched(context, catalog) if wanted else None
    except CatalogError:  # not on this machine, or no catalog of the whole sky
        return None
    return _field_of(context, inputs, answer)


def asked_field(
    context: Context, source: InputSource, inputs: Inputs, catalog: Catalog | None = None
) -> LostField:
    """Return the same for somebody who asks and waits for it.

    Raises
    ------
    SessionError
        The stars do not tell it: why.
    CatalogError
        The catalog is not on this machine, or has not the whole sky.
    """
    answer = _searched(context, catalog or open_catalog(source.catalog))
    found = _field_of(context, inputs, answer)
    if found is None:
        raise SessionError(_why_not(context, answer))
    return found


def _field_of(
    context: Context, inputs: Inputs, answer: "lost_in_space.LostAnswer | None"
) -> LostField | None:
    if answer is None:
        return None
    a_priori = inputs.a_priori_camera_from_j2000
    if answer.mirrored is not None:
        how = mirrored_words(context.camera, a_priori, answer.mirrored)
        return LostField(None, f"the picture is mirrored {how}: {answer.message}; {CAMERA_FILE}")
    if answer.camera_from_j2000 is None:
        return None
    if _another_focal_length(context.camera, answer):
        scale = context.settings.focal_scale * answer.focal_scale
        off = f"the focal length is {100.0 * (answer.focal_scale - 1.0):+.2f} % off the camera file's"
        return LostField(
            None,
            f"{off}: {answer.message}; calibrate the camera, or take attitude and focal length from the stars "
            f"(--attitude none, or Settings(focal_scale={scale:.5f}))",
        )
    return LostField(answer.camera_from_j2000, answer.message)


def _searched(context: Context, catalog: Catalog) -> "lost_in_space.LostAnswer | None":
    """Search the whole sky, if detections enough may be stars, and the detector is no strip."""
    detections = star_detections(context)
    star_like = int(np.count_nonzero((detections.flags & StarFlag.COSMIC_RAY) == 0))
    least = context.settings.lost_detections
    if least <= 0 or star_like < least or lost_in_space.no_patterns(context.camera) is not None:
        return None
    return lost_in_space.solve_lost(lost_in_space.index_of_catalog(catalog), detections, context.camera)


def _why_not(context: Context, answer: "lost_in_space.LostAnswer | None") -> str:
    if answer is None and (why := lost_in_space.no_patterns(context.camera)) is not None:
        return f"The stars alone do not tell it: {why}."
    if answer is None:
        least = context.settings.lost_detections
        return (
            f"From the stars alone it is found with {least} detections or more, which this picture has not."
        )
    if answer.mirrored is not None:
        how = "along line, or along pixel and turned by 180 deg"
        return f"The picture is mirrored ({how}): {answer.message}; {CAMERA_FILE}."
    return f"The stars do not tell it: {answer.message}"


# ---- A camera file of another focal length.


def _another_focal_length(camera: Camera, answer: "lost_in_space.LostAnswer") -> bool:
    off = abs(answer.focal_scale - 1.0)
    edge_px = camera.half_diagonal_rad / camera.pixel_scale_rad
    return off * edge_px > FOCAL_PX and off > FOCAL_SIGMAS * answer.focal_sigma


def _with_focal_length(context: Context, answer: "lost_in_space.LostAnswer") -> tuple[Context, str]:
    if not _another_focal_length(context.camera, answer):
        return context, ""
    camera = with_focal_scale(context.camera, answer.focal_scale)
    settings = replace(context.settings, focal_scale=context.settings.focal_scale * answer.focal_scale)
    said = (
        f"; the focal length is taken as {camera.focal_length_mm:.2f} mm, {100.0 * (answer.focal_scale - 1.0):+.2f} % off "
        "the camera file's: calibrate the camera"
    )
    return replace(context, camera=camera, settings=settings), said

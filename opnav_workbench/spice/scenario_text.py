"""The text kernels of a scenario: clock, frames, cameras and bodies as pool variables."""

from typing import Any

from opnav_workbench.spice import assignments as to
from opnav_workbench.spice.distortion_keywords import distortion_keywords
from opnav_workbench.spice.epochs import et_from_tdb, utc_to_et
from opnav_workbench.spice.scenario import Scenario
from opnav_workbench.spice.scenario_parts import Body, Spacecraft

__all__ = ["clock_values", "frame_values", "instrument_values", "pck_values"]


def clock_values(scenario: Scenario) -> dict[str, Any]:
    """Return the SCLK variables; needs an active `KernelSet` with an LSK where the clock has a start."""
    clock = scenario.clock
    correlation = [(tick, et_from_tdb(time), rate) for tick, time, rate in clock.correlation]
    if clock.start is not None:
        correlation = [(0, utc_to_et(clock.start), 1.0)]
    return to.sclk_assignments(
        clock.id,
        correlation,
        subcounts=clock.subcounts,
        counts=clock.counts,
        partitions=clock.partitions,
        time_system=clock.time_system,
        delimiter=clock.delimiter,
    )


def frame_values(scenario: Scenario) -> dict[str, Any]:
    """Return the FK variables: names, the bus frame, mounted frames and body-fixed ones."""
    craft, clock_id = scenario.spacecraft, scenario.clock.id
    things: tuple[Spacecraft | Body, ...] = (craft, *scenario.bodies)
    named = [(name, thing.id) for thing in things for name in (*thing.aliases, thing.name)]
    values = to.name_assignments(named) | to.bus_frame_assignments(
        craft.frame.name, craft.frame.id, craft.id, clock_id
    )
    for frame in scenario.frames:
        values |= to.camera_frame_assignments(frame.name, frame.id, craft.id, frame.relative_to, frame.matrix)
    for body in scenario.bodies:
        if body.frame is not None:
            values |= to.body_frame_assignments(body.frame.name, body.frame.id, body.id)
    return values


def instrument_values(scenario: Scenario) -> dict[str, Any]:
    """Return the IK variables of all cameras."""
    values = to.name_assignments((i.name, i.id) for i in scenario.instruments)
    for camera in scenario.instruments:
        values |= to.instrument_assignments(
            camera.id,
            camera.frame,
            focal_length_mm=camera.focal_length_mm,
            pixel_size_um=camera.pixel_size_um,
            n_pixel=camera.n_pixel,
            n_line=camera.n_line,
            center_pixel_line=camera.center_pixel_line,
            focal_from_camera=camera.focal_from_camera,
            fov_half_angles_deg=camera.fov_half_angles_deg,
            keywords=distortion_keywords(camera) | dict(camera.keywords),
        )
    return values


def pck_values(scenario: Scenario) -> dict[str, Any]:
    """Return the PCK variables of all bodies."""
    values: dict[str, Any] = {}
    for body in scenario.bodies:
        values |= to.pck_assignments(
            body.id,
            radii_km=body.radii_km or (),
            gm_km3_s2=body.gm_km3_s2,
            pole_ra_deg=body.pole_ra_deg,
            pole_dec_deg=body.pole_dec_deg,
            prime_meridian_deg=body.prime_meridian_deg,
        )
    return values

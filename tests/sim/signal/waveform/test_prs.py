"""NR DL PRS against TS 38.211, worked out a second time, bit by bit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isac_arena.validation.signal.waveform import mixed_radix_offset, prs_slot_bit_by_bit, shift_register_bits
from sim.signal.waveform.prs import (
    COMB_LENGTHS,
    COMB_OFFSETS,
    PrsConfig,
    gold_sequence,
    prs_c_init,
    prs_comb_pass,
    prs_slot,
    prs_subcarriers,
    prs_symbols,
    subcarrier_frequency_hz,
)

PAIRS = [(comb, length) for comb, lengths in COMB_LENGTHS.items() for length in lengths]


@given(st.integers(0, 2**31 - 1), st.integers(1, 200))
def test_gold_sequence_equals_the_shift_registers(c_init: int, length: int) -> None:
    assert gold_sequence(c_init, length).tolist() == shift_register_bits(c_init, length)


def test_gold_sequence_with_printed_registers() -> None:
    """Clause 5.2.1 as printed, on lists: a third time, without shifts."""
    x1, x2 = [1] + [0] * 30, [(1234567 >> i) & 1 for i in range(31)]
    for n in range(1700):
        x1.append((x1[n + 3] + x1[n]) % 2)
        x2.append((x2[n + 3] + x2[n + 2] + x2[n + 1] + x2[n]) % 2)
    expected = [(x1[n + 1600] + x2[n + 1600]) % 2 for n in range(100)]
    assert gold_sequence(1234567, 100).tolist() == expected


def test_c_init_by_hand() -> None:
    # ID 1030 = 1 * 1024 + 6: 2^22 * 1 + 2^10 * (14 * 3 + 5 + 1) * (2 * 6 + 1) + 6
    assert prs_c_init(1030, slot=3, symbol=5) == 2**22 + 1024 * 48 * 13 + 6
    assert prs_c_init(4095, slot=319, symbol=13) < 2**31


def test_comb_offsets_follow_their_rule() -> None:
    for comb, offsets in COMB_OFFSETS.items():
        assert list(offsets) == [mixed_radix_offset(comb, symbol) for symbol in range(12)]


@pytest.mark.parametrize(("comb", "length"), PAIRS)
def test_whole_slot_element_by_element(comb: int, length: int) -> None:
    config = PrsConfig(
        n_rb=24, comb=comb, numerology=2, rb_offset=7, re_offset=comb - 1, first_symbol=14 - length,
        n_symbols=length, carrier_rb=40,
    )  # fmt: skip
    grid = prs_slot(config, 3001, 11)
    assert grid.shape == (14, 480)
    np.testing.assert_allclose(grid, prs_slot_bit_by_bit(config, 3001, 11), atol=1e-15)
    assert np.count_nonzero(grid) == length * 24 * 12 // comb


def test_slots_with_the_extended_prefix_have_twelve_symbols() -> None:
    config = PrsConfig(n_rb=24, comb=12, numerology=2, cyclic_prefix="extended")
    grid = prs_slot(config, 77, 5)
    assert grid.shape == (12, 288)
    np.testing.assert_allclose(grid, prs_slot_bit_by_bit(config, 77, 5), atol=1e-15)
    assert prs_c_init(6, slot=5, symbol=4, symbols_per_slot=12) == 1024 * (12 * 5 + 4 + 1) * 13 + 6
    assert config.symbol_s == pytest.approx(1.25 / 60e3)
    with pytest.raises(ValueError, match="first_symbol = 1: allowed is 0 to 0, so that 12 symbols"):
        PrsConfig(comb=12, first_symbol=1, numerology=2, cyclic_prefix="extended")
    with pytest.raises(ValueError, match="numerology = 3: allowed is numerology 2 alone"):
        PrsConfig(cyclic_prefix="extended")


def test_rb_offset_starts_inside_the_sequence_of_point_a() -> None:
    whole = prs_symbols(PrsConfig(n_rb=36, comb=6), 9, 0)
    part = prs_symbols(PrsConfig(n_rb=24, comb=6, rb_offset=10), 9, 0)
    np.testing.assert_array_equal(part, whole[20:68])


@pytest.mark.parametrize(("comb", "length"), PAIRS)
def test_a_resource_sounds_every_subcarrier_equally_often(comb: int, length: int) -> None:
    config = PrsConfig(n_rb=24, comb=comb, re_offset=comb - 1, first_symbol=1, n_symbols=length)
    used = np.concatenate([prs_subcarriers(config, symbol) for symbol in config.symbols])
    assert sorted(used.tolist()) == sorted(list(range(24 * 12)) * (length // comb))


def test_comb_pass_takes_each_pilot_from_the_first_symbol_that_has_it() -> None:
    config = PrsConfig(n_rb=24, comb=4, rb_offset=4, first_symbol=2, n_symbols=12)
    grid = prs_slot(config, 12, 3)[2:6, 48:]
    np.testing.assert_array_equal(prs_comb_pass(config, 12, 3), grid.sum(axis=0))
    assert (np.count_nonzero(grid, axis=0) == 1).all()


def test_default_occupies_380_mhz_around_the_carrier() -> None:
    config = PrsConfig()
    frequency = subcarrier_frequency_hz(config, prs_subcarriers(config))
    assert config.n_subcarriers * config.subcarrier_spacing_hz == 380.16e6
    assert len(frequency) == 1584
    assert frequency[0] == -190.08e6
    np.testing.assert_allclose(np.diff(frequency), 240e3)


def test_frequencies_count_from_the_middle_of_the_carrier() -> None:
    config = PrsConfig(n_rb=24, numerology=2, rb_offset=76, carrier_rb=100)
    frequency = subcarrier_frequency_hz(config, prs_subcarriers(config))
    assert frequency[0] == (76 - 50) * 12 * 60e3


@pytest.mark.parametrize(
    ("field", "value"),
    [("comb", 3), ("n_rb", 0), ("n_rb", 30), ("re_offset", 2), ("first_symbol", 14), ("numerology", 9)],
)
def test_bad_resources_name_field_and_value(field: str, value: int) -> None:
    with pytest.raises(ValueError, match=rf"PrsConfig.{field} = {value}: allowed"):
        PrsConfig(**{field: value})


@pytest.mark.parametrize(("comb", "length"), [(2, 1), (4, 2), (4, 6), (6, 2), (6, 4), (12, 4), (12, 6), (2, 14)])
def test_pairs_that_the_standard_forbids(comb: int, length: int) -> None:
    with pytest.raises(ValueError, match=rf"PrsConfig.n_symbols = {length}: .* comb {comb} .*7\.4\.1\.7\.3"):
        PrsConfig(comb=comb, n_symbols=length)


def test_a_resource_stays_within_slot_and_carrier() -> None:
    with pytest.raises(ValueError, match=r"first_symbol = 3: allowed is 0 to 2, so that 12 symbols"):
        PrsConfig(comb=12, first_symbol=3)
    with pytest.raises(ValueError, match=r"rb_offset \+ n_rb = 274: allowed is up to carrier_rb = 264"):
        PrsConfig(rb_offset=10, carrier_rb=264)
    with pytest.raises(ValueError, match="at most 275 RB"):
        PrsConfig(rb_offset=20)


def test_bad_sequence_id_and_symbol() -> None:
    with pytest.raises(ValueError, match="sequence_id = 4096"):
        prs_c_init(4096, 0, 0)
    with pytest.raises(ValueError, match="symbol = 2"):
        prs_subcarriers(PrsConfig(), symbol=2)

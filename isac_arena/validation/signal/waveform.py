"""Waveform, arrays and link budget against the standard's formulas, closed forms and the measured hall."""

from itertools import product

import numpy as np

from isac_arena.validation.measurement import Measurement, at_least, at_most
from isac_arena.validation.scenarios.paths import free_space
from scenes.config import load_scene, scene_path
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import ComplexArray, FloatArray
from sim.config import ArrayConfig, SimulationConfig, WaveformConfig
from sim.propagation.paths import empty_paths
from sim.signal.arrays.array import upa_positions_m
from sim.signal.arrays.codebook import steered_codebook
from sim.signal.link import Link, make_link
from sim.signal.link_budget import LinkBudget, converter_share, link_budget, peak_gain_dbi
from sim.signal.noise import add_noise
from sim.signal.waveform.config import ScheduleConfig
from sim.signal.waveform.ofdm import cp_lengths, demodulate, modulate, sample_rate_hz
from sim.signal.waveform.prs import COMB_LENGTHS, SYMBOLS_PER_SLOT, CyclicPrefix, PrsConfig, prs_slot
from sim.simulate import observe
from sim.truth import Truth

CARRIER_HZ = 60e9
NUMEROLOGIES: tuple[tuple[int, CyclicPrefix], ...] = ((2, "normal"), (2, "extended"), (3, "normal"))
BOLTZMANN_J_K = 1.380649e-23
MEASURED_LOS_DBM, MEASURED_SLOPE_DB = -13.0, -19.4  # at 1 m and per decade, Campus Arena
MEASURED_WEAKEST_DBM = -53.0
TX_TURNS_DEG = [-75.0, -45.0, -15.0, 15.0, 45.0, 75.0]
RX_TURNS_DEG = [-165.0, -135.0, -105.0, *TX_TURNS_DEG, 105.0, 135.0, 165.0]


def check_prs(seed: int, quick: bool) -> list[Measurement]:
    """PRS grids against a second derivation of TS 38.211 clauses 5.2.1 and 7.4.1.7, element by element."""
    rng = np.random.default_rng(seed)
    pairs = [(comb, length) for comb, lengths in COMB_LENGTHS.items() for length in lengths]
    wrong = 0
    for (comb, length), (numerology, prefix) in product(pairs[:: 3 if quick else 1], NUMEROLOGIES):
        limits = (40, comb, SYMBOLS_PER_SLOT[prefix] + 1 - length)
        rb_offset, re_offset, first_symbol = (int(rng.integers(limit)) for limit in limits)
        config = PrsConfig(
            n_rb=24, comb=comb, numerology=numerology, rb_offset=rb_offset, re_offset=re_offset,
            n_symbols=length, carrier_rb=66, cyclic_prefix=prefix, first_symbol=first_symbol,
        )  # fmt: skip
        sequence_id, slot = int(rng.integers(4096)), int(rng.integers(config.slots_per_frame))
        expected = prs_slot_bit_by_bit(config, sequence_id, slot)
        wrong += int((np.abs(prs_slot(config, sequence_id, slot) - expected) > 1e-12).sum())
    return [
        at_most("signal.prs.wrong_elements", wrong, 0, "the standard fixes every element"),
        *_correlations(rng),
    ]


def check_ofdm(seed: int, quick: bool) -> list[Measurement]:
    """Grids to time-domain samples and back, and the length of half a subframe."""
    rng = np.random.default_rng(seed)
    worst, drift = 0.0, 0.0
    for numerology, prefix in NUMEROLOGIES:
        n_symbols = SYMBOLS_PER_SLOT[prefix]
        for slot in range(0, 2**numerology, 4 if quick else 1):
            prefixes = cp_lengths(numerology, slot, 4096, prefix)
            grid = rng.standard_normal((n_symbols, 3168, 2), np.float32).view(np.complex64)[..., 0]
            for early in (0, int(prefixes.min()) // 2):
                back = demodulate(modulate(grid, prefixes), 3168, prefixes, early=early)
                worst = max(worst, float(np.abs(back - grid).max() / np.abs(grid).max()))
        slots = [cp_lengths(numerology, slot, 4096, prefix) for slot in range(2**numerology)]
        symbols = np.concatenate(slots) + 4096
        halves = symbols.reshape(2, -1).sum(axis=1) / sample_rate_hz(numerology)
        drift = max(drift, float(np.abs(halves / 0.5e-3 - 1).max()))
    return [
        at_most("signal.ofdm.round_trip", worst, 1e-5, "relative, single precision"),
        at_most("signal.ofdm.half_subframe", drift, 1e-12, "0.5 ms, TS 38.211 clause 4.3.1"),
    ]


def check_arrays(seed: int, quick: bool) -> list[Measurement]:
    """Broadside gain of the 4 x 16 array of TR 38.901 elements: 10 log10(64) + 8 dBi."""
    position_m = upa_positions_m(4, 16, CARRIER_HZ)
    book = steered_codebook(position_m, CARRIER_HZ, panel_azimuth_rad=[0.0], beams_per_panel=1, sector_rad=1.0)
    gain_dbi = peak_gain_dbi(book)
    error_db = abs(gain_dbi - 8.0 - 18.06)
    return [
        at_least("signal.array.broadside_gain", gain_dbi, 26.06, "18.06 dB + 8 dBi", "dBi"),
        at_most("signal.array.broadside_error", error_db, 0.005, "two decimals of 18.06 dB", "dB"),
    ]


def check_noise(seed: int, quick: bool) -> list[Measurement]:
    """Noise variance of every RX beam against k T0 B F times the squared norm of its weights."""
    arrays = ArrayConfig(codebook="campus_63", taper="taylor", phase_bits=3)
    config = SimulationConfig(scene="-", tx_array=ArrayConfig(beams_per_panel=8), rx_array=arrays)
    link = make_link(config)
    rng = np.random.default_rng(seed)
    power = np.zeros(len(link.rx_codebook))
    blocks = 16 if quick else 64
    for _ in range(blocks):
        noise = add_noise(np.zeros((8, len(power), 1584), np.complex64), link.noise_power_mw, rng)
        power += (noise.real.astype(float) ** 2 + noise.imag.astype(float) ** 2).mean(axis=(0, 2)) / blocks
    bandwidth_hz = 1584 * 120e3
    expected = BOLTZMANN_J_K * 290 * bandwidth_hz * 1e3 * 10 ** (config.link.noise_figure_db / 10)
    norm = (np.abs(link.rx_codebook.weights) ** 2).sum(axis=1)
    worst = float(np.abs(power / (expected * norm) - 1).max())
    reason = "relative, worst beam; the spread of the estimate itself is 0.2 % (quick) or 0.1 %"
    return [at_most("signal.noise.variance", worst, 0.01, reason)]


def check_schedule(seed: int, quick: bool) -> list[Measurement]:
    """Noise of a whole stop whose receiver combines three of four repetitions, the second one muted."""
    schedule = ScheduleConfig(period_slots=160, repetitions=4, muting_2=[1, 0, 1, 1])
    config = SimulationConfig(
        scene="box_room", seed=seed, waveform=WaveformConfig(schedule=schedule), rx_array=ArrayConfig()
    )
    link, scene = make_link(config), load_scene(scene_path(config.scene), CARRIER_HZ)
    silence = empty_paths(["none"])
    stops = range(4 if quick else 16)
    sweeps = (observe(config, link, scene, Truth(silence, scene.tx, stop, 0.0)) for stop in stops)
    power = np.mean([(np.abs(sweep.samples) ** 2).mean(axis=(0, 2), dtype=float) for sweep in sweeps], axis=0)
    single_mw = BOLTZMANN_J_K * 290 * 1584 * 120e3 * 1e3 * 10 ** (config.link.noise_figure_db / 10)
    worst = float(np.abs(3 * power / single_mw - 1).max())
    reason = "against a third of kTBF, worst beam; the estimate itself spreads by 0.2 % (quick) or 0.1 %"
    return [at_most("signal.schedule.noise", worst, 0.01, reason)]


def check_link_budget(seed: int, quick: bool) -> list[Measurement]:
    """Line of sight and weakest path of the Campus Arena, with the beams as measured.

    The TX power stands for the -13 dBm at 1 m; the level along the walk and the weakest path are not fitted.
    """
    config = SimulationConfig(
        scene="campus_arena",
        tx_array=ArrayConfig(codebook="campus_63", sector_deg=30.0, panel_azimuth_deg=TX_TURNS_DEG),
        rx_array=ArrayConfig(codebook="campus_63", sector_deg=30.0, panel_azimuth_deg=RX_TURNS_DEG),
    )
    scene = load_scene(scene_path(config.scene), CARRIER_HZ)
    link = make_link(config)
    truths = [Truth(free_space(scene.tx, rx), rx, stop, 0.0) for stop, rx in enumerate(scene.stops)]
    budget = link_budget(truths, link, scene.tx, config.link, converter_share(config.waveform))
    measured_dbm = MEASURED_LOS_DBM + MEASURED_SLOPE_DB * np.log10(budget.distance_m)
    level_db = np.sqrt(((budget.los_dbm - measured_dbm) ** 2).mean())
    weakest_db = abs(budget.weakest_dbm - MEASURED_WEAKEST_DBM)
    range_db = abs(float(budget.dynamic_range_db[budget.distance_m < 6.0].mean()) - 25.0)
    level = "rms over the stops; the measured line itself scatters by 0.65 dB"
    usable = "at the stops nearer than 6 m, against 25 dB below the line of sight"
    by_hand = "EIRP and free space at the wavelength, boresight to boresight"
    key = "signal.link"
    return [
        at_most(f"{key}.los_level", level_db, 1.5, level, "dB"),
        at_most(f"{key}.weakest_path", weakest_db, 2.0, "against -53 dBm; a third of an effective bit", "dB"),
        at_most(f"{key}.dynamic_range", range_db, 2.0, usable, "dB"),
        at_most(f"{key}.budget_by_hand", _hand_error_db(budget, link), 0.01, by_hand, "dB"),
    ]


def prs_slot_bit_by_bit(config: PrsConfig, sequence_id: int, slot: int) -> ComplexArray:
    """The grid of `prs_slot` from the clauses as printed: registers bit by bit, k' from its digits."""
    per_slot = 12 if config.cyclic_prefix == "extended" else 14
    grid = np.zeros((per_slot, 12 * config.n_carrier_rb), complex)
    comb = config.comb
    for symbol in config.symbols:
        high, low = divmod(sequence_id, 1024)
        c_init = (2**22 * high + 2**10 * (per_slot * slot + symbol + 1) * (2 * low + 1) + low) % 2**31
        shift = (config.re_offset + mixed_radix_offset(comb, symbol - config.first_symbol)) % comb
        first, last = 12 * config.rb_offset // comb, 12 * (config.rb_offset + config.n_rb) // comb
        bits = shift_register_bits(c_init, 2 * last)
        for m in range(first, last):
            real, imaginary = 1 - 2 * bits[2 * m], 1 - 2 * bits[2 * m + 1]
            grid[symbol, m * comb + shift] = complex(real, imaginary) / np.sqrt(2)
    return grid


def mixed_radix_offset(comb: int, symbol: int) -> int:
    """Offset k' of TS 38.211 Table 7.4.1.7.3-1 by its rule: each symbol halves the widest gap."""
    within = symbol % comb
    if comb == 12:
        return 6 * (within % 2) + 3 * (within // 2 % 2) + within // 4
    return comb // 2 * (within % 2) + within // 2


def shift_register_bits(c_init: int, length: int) -> list[int]:
    """TS 38.211 clause 5.2.1 with two integers as shift registers, one bit at a time."""
    x1, x2, bits = 1, c_init, []
    for n in range(1600 + length):
        if n >= 1600:
            bits.append((x1 ^ x2) & 1)
        x1 = x1 >> 1 | ((x1 >> 3 ^ x1) & 1) << 30
        x2 = x2 >> 1 | ((x2 >> 3 ^ x2 >> 2 ^ x2 >> 1 ^ x2) & 1) << 30
    return bits


def _correlations(rng: np.random.Generator) -> list[Measurement]:
    """Delay response of the PRS away from its peak, and products between the combs of a symbol."""
    aliased, shared = 0.0, 0.0
    for comb in COMB_LENGTHS:
        grids = np.stack([
            prs_slot(PrsConfig(n_rb=264, comb=comb, re_offset=offset), int(rng.integers(4096)), 7)
            for offset in range(comb)
        ])  # fmt: skip
        gram = np.einsum("aln,bln->abl", grids, grids.conj())[..., :comb]
        shared = max(shared, float(np.abs(gram[~np.eye(comb, dtype=bool)]).max()))
        correlation: FloatArray = np.abs(np.fft.ifft(np.abs(grids[0, 0]) ** 2))
        one_period = correlation[: len(correlation) // comb] / correlation[0]
        aliased = max(aliased, float(one_period[1:].max()))
    return [
        at_most("signal.prs.autocorrelation", aliased, 1e-12, "zero except for rounding"),
        at_most("signal.prs.comb_products", shared, 0, "combs share no resource element"),
    ]


def _hand_error_db(budget: LinkBudget, link: Link) -> float:
    """Budget line at 1 m (EIRP + RX gain - free-space loss) against 3 + 26.0618 + 26.0618 - 68.01 dB."""
    loss_db = 20 * np.log10(4 * np.pi * link.carrier_hz / SPEED_OF_LIGHT_M_S)
    line_dbm = budget.eirp_dbm + budget.rx_gain_dbi - loss_db
    return float(abs(line_dbm - (3.0 + 2 * (8.0 + 18.0618) - 68.0107)))

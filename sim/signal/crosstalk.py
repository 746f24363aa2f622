"""What one TX adds to the samples of another's sweep where their PRS resources meet.

A TX is heard in a sample where it sends on the same resource elements: in the same slot and symbol (in the same
turn where there is no schedule) and with the same comb offset there. The receiver then has the channel of the
other TX times the other's pilot, which it divides by the pilot that it expects.
"""

import numpy as np

from scenes.record import BoolArray, ComplexArray, IntArray
from sim.config import SimulationConfig
from sim.signal.waveform.occasions import beam_turns, measured_slots, resource_offsets, sweep_occasions
from sim.signal.waveform.prs import SUBCARRIERS_PER_RB, prs_subcarriers, prs_symbols
from sim.signal.waveform.schedule import is_sent


def meeting_symbols(own: SimulationConfig, other: SimulationConfig) -> list[int]:
    """The symbols of a slot that a sweep measures and in which the other TX sends on the same subcarriers."""
    ours, theirs = own.waveform.prs, other.waveform.prs
    measured = ours.symbols if own.waveform.combine_symbols else [ours.first_symbol]
    return [
        symbol
        for symbol in measured
        if symbol in theirs.symbols
        and np.array_equal(prs_subcarriers(ours, symbol), prs_subcarriers(theirs, symbol))
    ]


def meeting_beams(
    own: SimulationConfig, other: SimulationConfig, n_own: int, n_other: int, n_rx: int
) -> BoolArray:
    """Whether the other TX sends a beam while a beam pair is measured.

    (repetition, tx_beam, rx_beam, beam of the other TX).
    """
    schedule, theirs = own.waveform.schedule, other.waveform.schedule
    if schedule is None or theirs is None:
        turns = [beam_turns(each.waveform.scan_order, n) for each, n in ((own, n_own), (other, n_other))]
        together = (turns[0][:, None] == turns[1]) & (own.turn == other.turn)
        return np.broadcast_to(together[None, :, None], (1, n_own, n_rx, n_other))
    slot = measured_slots(own.waveform, n_own, n_rx)
    offsets = resource_offsets(theirs, n_other)[beam_turns(other.waveform.scan_order, n_other)]
    sent = [is_sent(theirs.of_resource(other.waveform.numerology, int(offset)), slot) for offset in offsets]
    return np.stack(sent, axis=-1)


def do_meet(own: SimulationConfig, other: SimulationConfig, n_own: int, n_other: int, n_rx: int) -> bool:
    """Whether a TX is heard in any sample of the sweep of another."""
    return bool(meeting_symbols(own, other)) and bool(meeting_beams(own, other, n_own, n_other, n_rx).any())


def share_all_elements(own: SimulationConfig, other: SimulationConfig, n_own: int, n_rx: int) -> bool:
    """Whether two sweeps are measured on the same resource elements at all times, and so have the same noise."""
    ours, theirs = own.waveform, other.waveform
    same = ours.prs == theirs.prs and own.turn == other.turn
    if not same or ours.schedule is None or theirs.schedule is None:
        return same
    slots = [measured_slots(each, n_own, n_rx) for each in (ours, theirs)]
    return np.array_equal(slots[0], slots[1])


def crosstalk(
    own: SimulationConfig, other: SimulationConfig, pilot: ComplexArray, channel: ComplexArray, repetition: int
) -> ComplexArray:
    """What the other TX adds to the noiseless samples (tx_beam, rx_beam, subcarrier) of one repetition of a sweep.

    `pilot` (tx_beam, subcarrier) is that of the sweep, `channel` (beam of the other, rx_beam, subcarrier) that of
    the other TX with its transmit power. The pilots of all repetitions count as those of the first one, as for
    the sweep's own signal.
    """
    n_own, (n_other, n_rx, _) = len(pilot), channel.shape
    meet = meeting_beams(own, other, n_own, n_other, n_rx)[repetition]
    slots = [sweep_occasions(each.waveform, n, n_rx).slot for each, n in ((own, n_own), (other, n_other))]
    added = np.zeros((n_own, n_rx, channel.shape[2]), np.complex64)
    for beam, partner in zip(*np.nonzero(meet.any(axis=1)), strict=True):
        slot = int(slots[0][repetition, beam])
        theirs = slot if own.waveform.schedule is not None else int(slots[1][0, partner])
        ratio = _pilot_ratio(own, other, (int(beam), slot), (int(partner), theirs))
        heard = meet[beam, :, partner, None] * channel[partner]
        added[beam] += (heard * (pilot[beam] * ratio)).astype(np.complex64)
    return added


def _pilot_ratio(
    own: SimulationConfig, other: SimulationConfig, beam: tuple[int, int], partner: tuple[int, int]
) -> ComplexArray:
    """Mean over the measured symbols of the other's pilot over the expected one (subcarrier,).

    `beam` and `partner` are the number and the slot of a beam of either TX.
    """
    prs, combined = own.waveform.prs, own.waveform.combine_symbols
    symbols = meeting_symbols(own, other)

    def sequence(of: SimulationConfig, sent: tuple[int, int], symbol: int) -> ComplexArray:
        return prs_symbols(of.waveform.prs, (of.waveform.sequence_id + sent[0]) % 4096, sent[1], symbol)

    def ratio(symbol: int) -> ComplexArray:
        return np.asarray(sequence(other, partner, symbol) * sequence(own, beam, symbol).conj())

    if not combined:
        return ratio(symbols[0])
    total = np.zeros(prs.n_subcarriers, complex)
    for symbol in symbols:
        total[_sounded(own, symbol)] += ratio(symbol)
    return np.asarray(total * (prs.comb / prs.length))


def _sounded(config: SimulationConfig, symbol: int) -> IntArray:
    """Subcarriers of the band, counted from its first, that a symbol sounds."""
    prs = config.waveform.prs
    return prs_subcarriers(prs, symbol) - prs.rb_offset * SUBCARRIERS_PER_RB

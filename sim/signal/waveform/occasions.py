"""Times of the measurements of all beam pairs in a sweep.

Without a schedule, the beam pairs follow each other without gaps, as in a measurement with no other signals. With
a schedule, the TX beams are the resources of a PRS resource set. The receiver keeps one RX beam for one instance
of the set, in which every TX beam has its repetitions, and combines them. It knows the schedule and skips muted
symbols: muted instances cost air time, muted repetitions cost combining gain, and no beam pair is missing.

The time of a beam pair is always a time of its TX beam plus one of its RX beam, in every scan order.
"""

from dataclasses import dataclass

import numpy as np

from scenes.record import FloatArray, IntArray, Record, array
from sim.config import WaveformConfig
from sim.signal.waveform.config import ScanOrder, ScheduleConfig
from sim.signal.waveform.schedule import sent_slots


@dataclass(frozen=True)
class Occasions(Record):
    """The measurement times of every beam pair, for all repetitions that the receiver combines."""

    time_s: FloatArray = array(
        "repetition", "tx_beam", "rx_beam", unit="s", doc="start of the PRS since the first of the sweep"
    )
    slot: IntArray = array("repetition", "tx_beam", dtype=int, doc="slot of the frame, at the first RX beam")
    air_time_s: float = array(unit="s", doc="duration of the sweep")

    @property
    def repetitions(self) -> int:
        """Number of measurements that are combined into one sample."""
        return self.size("repetition")


def sweep_occasions(waveform: WaveformConfig, n_tx: int, n_rx: int) -> Occasions:
    """The occasions of a sweep over `n_tx` x `n_rx` beams.

    Raises `ValueError` if the beams do not fit into the period of the schedule, or everything is muted.
    """
    prs, schedule = waveform.prs, waveform.schedule
    tx_turn, rx_turn = (beam_turns(waveform.scan_order, n) for n in (n_tx, n_rx))
    if schedule is None:
        pair_s = prs.symbol_s * (prs.length if waveform.combine_symbols else 1)
        return Occasions(
            time_s=pair_s * (n_rx * tx_turn[:, None] + rx_turn)[None].astype(float),
            slot=tx_turn[None] % prs.slots_per_frame,
            air_time_s=pair_s * n_tx * n_rx,
        )
    slot = measured_slots(waveform, n_tx, n_rx)
    slot_s = 1e-3 / 2**prs.numerology
    return Occasions(
        time_s=slot_s * (slot - slot.min()),
        slot=slot[:, :, rx_turn.argmin()] % prs.slots_per_frame,
        air_time_s=slot_s * float(np.ptp(slot) + 1),
    )


def beam_turns(order: ScanOrder, n_beams: int) -> IntArray:
    """The turn (beam,) of every beam of one end in a sweep.

    Interleaved takes about every sqrt(n)-th beam, then those after them; random is one order for all campaigns.
    """
    beam = np.arange(n_beams)
    if order == "linear":
        return beam
    if order == "random":
        return np.random.default_rng(n_beams).permutation(n_beams)
    stride = max(1, round(np.sqrt(n_beams)))
    return np.argsort(np.lexsort((beam, beam % stride)))


def measured_slots(waveform: WaveformConfig, n_tx: int, n_rx: int) -> IntArray:
    """Slots (repetition, tx_beam, rx_beam), from the start of frame 0, in which a schedule has every beam pair.

    Raises as `sweep_occasions` does.
    """
    schedule, prs = waveform.schedule, waveform.prs
    assert schedule is not None
    tx_turn, rx_turn = (beam_turns(waveform.scan_order, n) for n in (n_tx, n_rx))
    offset = resource_offsets(schedule, n_tx)[tx_turn]
    sent = sent_slots(schedule.of_resource(prs.numerology), n_rx)  # (instance, repetition) of the first TX beam
    first = sent[rx_turn]
    return np.asarray(first.T[:, None, :] + offset[:, None])


def measurements_per_sample(waveform: WaveformConfig) -> float:
    """Number of measurements of a subcarrier that are averaged in a sample: repetitions x comb passes."""
    passes = waveform.prs.length / waveform.prs.comb if waveform.combine_symbols else 1.0
    if waveform.schedule is None:
        return passes
    sent = sent_slots(waveform.schedule.of_resource(waveform.prs.numerology), 1)
    return passes * float(sent.shape[1])


def slot_of_beam(waveform: WaveformConfig, n_tx: int, tx_beam: int) -> int:
    """Slot of the frame in which one of `n_tx` TX beams first sends its PRS; `ValueError` for another beam."""
    if not 0 <= tx_beam < n_tx:
        raise ValueError(f"tx_beam = {tx_beam}: allowed is 0 to {n_tx - 1}")
    return int(sweep_occasions(waveform, n_tx, 1).slot[0, tx_beam])


def resource_span(schedule: ScheduleConfig, n_tx: int) -> int:
    """Slots from the first of a resource set of `n_tx` beams to its last, the last included."""
    return int(resource_offsets(schedule, n_tx).max()) + (schedule.repetitions - 1) * schedule.gap_slots + 1


def resource_offsets(schedule: ScheduleConfig, n_tx: int) -> IntArray:
    """First slot (tx_beam,) of every beam within the period; no two beams share a slot.

    Groups of as many beams as the gap has slots are interleaved. Raises `ValueError` if the period is too short,
    or an offset is above 511, the maximum of TS 38.214 clause 5.1.6.5.
    """
    gap, repetitions = schedule.gap_slots, schedule.repetitions
    beam = np.arange(n_tx)
    offset = beam // gap * gap * repetitions + beam % gap
    needed = int(offset.max()) + (repetitions - 1) * gap + 1
    if needed > schedule.period_slots or offset.max() > 511:
        raise ValueError(
            f"waveform.schedule.period_slots = {schedule.period_slots}: {n_tx} TX beams with repetitions ="
            f" {repetitions} at gap_slots = {gap} take {needed} slots, allowed are {schedule.period_slots} and"
            " offsets up to 511 (TS 38.214 5.1.6.5)"
        )
    return np.asarray(offset)

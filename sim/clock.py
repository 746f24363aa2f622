"""The clock of a campaign: when each stop, sweep and symbol happens."""

from dataclasses import dataclass

import numpy as np

from scenes.motion.collisions import check_motion
from scenes.record import FloatArray, Record, array
from scenes.scene import Scene
from scenes.walks.trajectory import stop_times_s
from sim.config import SimulationConfig
from sim.observation import BeamClock
from sim.signal.link import make_codebook
from sim.signal.waveform.occasions import sweep_occasions


@dataclass(frozen=True)
class CampaignClock(Record):
    """Times of a campaign, which starts with the sweep of its first stop.

    The pose and the paths of a stop are those at the middle symbol of its sweep.
    """

    middle_s: FloatArray = array("stop", unit="s", doc="middle symbol of the sweep of every stop")
    symbol_s: FloatArray = array(
        "repetition", "tx_beam", "rx_beam", unit="s", doc="first symbol of every beam pair after the middle one"
    )
    sweep_s: float = array(unit="s", doc="duration of a sweep")

    @property
    def order_s(self) -> FloatArray:
        """The times (symbol,) of all beam pairs in order."""
        return np.unique(self.symbol_s)


def beam_clock(config: SimulationConfig, clock: CampaignClock) -> BeamClock:
    """The times of the beams of a sweep, relative to its middle symbol."""
    prs = config.waveform.prs
    mean_s = clock.symbol_s.mean(axis=0)
    if config.waveform.combine_symbols:
        mean_s = mean_s + (prs.length - 1) / 2 * prs.symbol_s
    return BeamClock(tx_s=mean_s.mean(axis=1), rx_s=mean_s.mean(axis=0) - mean_s.mean())


def campaign_clock(config: SimulationConfig, scene: Scene) -> CampaignClock:
    """The clock of a campaign from its PRS schedule and its walk.

    Raises `ValueError` where the beams do not fit into the schedule, or the receiver is at a stop before the sweep
    of the one before has ended.
    """
    carrier_hz = config.waveform.carrier_ghz * 1e9
    n_tx, n_rx = (len(make_codebook(each, carrier_hz)) for each in (config.tx_array, config.rx_array))
    occasions = sweep_occasions(config.waveform, n_tx, n_rx)
    order_s = np.unique(occasions.time_s)
    middle_s = order_s[len(order_s) // 2]
    start_s = stop_times_s(scene.walk, occasions.air_time_s) - occasions.air_time_s / 2
    return CampaignClock(start_s + middle_s, occasions.time_s - middle_s, occasions.air_time_s)


def checked_clock(config: SimulationConfig, scene: Scene) -> CampaignClock:
    """The clock of a campaign whose world moves.

    Raises `ValueError` as `campaign_clock` does, where something drives through something else, and with the paths
    of a DeepMIMO scenario, which cannot move.
    """
    if config.propagation.deepmimo is not None:
        raise ValueError(
            f"propagation.deepmimo = {config.propagation.deepmimo}: its paths cannot move, as the scene does"
        )
    clock = campaign_clock(config, scene)
    check_motion(scene, clock.sweep_s)
    return clock

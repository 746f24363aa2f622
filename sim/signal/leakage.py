"""What a monostatic node hears of itself: the direct way from its sending panel to its receiving one."""

from dataclasses import replace

import numpy as np

from scenes.record import FloatArray
from scenes.scene import Scene
from sim.config import SimulationConfig
from sim.propagation.paths import Paths
from sim.signal.link import best_beam_power_dbm, make_link
from sim.truth import Truth


def with_leakage(config: SimulationConfig, scene: Scene, truth: Truth) -> Truth:
    """The truth with its line of sight, from panel to panel, at the isolation of the settings.

    In the best beam pair it arrives `isolation_db` below the power sent; other pairs follow the patterns of the
    beams. Panels side by side couple by their near fields, which far-field patterns understate: so the level is
    stated, not computed.
    """
    link = make_link(config)
    is_los = truth.paths.is_los
    if not is_los.any():
        name = scene.tx_name
        raise ValueError(f"links: something stands between the panels of '{name}', change its panel_offset_m")
    found_dbm = best_beam_power_dbm(truth.paths.take("path", is_los), link, scene.tx, truth.rx_pose)[0]
    wanted_dbm = config.link.tx_power_dbm - config.role.isolation_db
    factor = 10 ** ((wanted_dbm - found_dbm) / 20)
    motion = truth.motion
    if motion is not None:
        motion = replace(motion, states=_scaled(motion.states, factor))
    return replace(truth, paths=_scaled(truth.paths, factor), motion=motion)


def _scaled(paths: Paths, factor: float) -> Paths:
    gain: FloatArray = np.where(paths.is_los, factor, 1.0)
    return replace(paths, gain=paths.gain * gain)

"""Equation (1): beam-swept OFDM samples of a set of paths, without noise."""

from __future__ import annotations

import numpy as np

from scenes.pose import Pose
from scenes.record import ComplexArray, FloatArray
from sim.codebook import Codebook, beam_response
from sim.paths import Paths


def beam_channel(
    paths: Paths,
    *,
    tx_codebook: Codebook,
    rx_codebook: Codebook,
    tx_pose: Pose,
    rx_pose: Pose,
    frequency_offset_hz: FloatArray,
    clock_bias_s: float,
) -> ComplexArray:
    """Channel (tx_beam, rx_beam, subcarrier) in complex64: sum_i xi_i G_TX G_RX exp(-j 2 pi f (tau_i + bias)).

    The path gain holds the carrier phase, so only the offset from the carrier turns with delay here. A few
    thousand paths are handled as one matrix product per TX beam: nothing of size paths x samples is made.
    """
    tx_response = beam_response(
        tx_codebook, paths.aod_azimuth_rad - tx_pose.heading_rad, paths.aod_elevation_rad
    )
    rx_response = beam_response(
        rx_codebook, paths.aoa_azimuth_rad - rx_pose.heading_rad, paths.aoa_elevation_rad
    ).astype(np.complex64)
    delay_s = paths.delay_s + clock_bias_s
    waves = np.exp(-2j * np.pi * delay_s[:, None] * frequency_offset_hz).astype(np.complex64)
    channel = np.empty((len(tx_codebook), len(rx_codebook), len(frequency_offset_hz)), np.complex64)
    for beam, response in enumerate(tx_response):
        amplitude = (paths.gain * response).astype(np.complex64)
        np.matmul(rx_response * amplitude, waves, out=channel[beam])
    return channel

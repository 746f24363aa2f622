"""The strongest paths of a stop by the designed arrays: where the joint calibration of both arrays starts."""

from dataclasses import replace

import numpy as np

from estimation.channel.auto import fit_auto
from estimation.channel.calibration.normal import StopModel, StopSamples
from estimation.channel.config import MaximumLikelihoodConfig
from sim.observation import BeamSweep

DELAY_UNIT_S = 1e-9  # of changes of delays


def strong_paths(sweep: BeamSweep, config: MaximumLikelihoodConfig) -> tuple[StopSamples, StopModel] | None:
    """The samples of a stop in the space of its strongest paths, and a model of it by them.

    None if the phases of its beam pairs are lost, or if it has no paths. Paths that are marked as weak count too:
    what belongs to errors of the arrays gives way to them.
    """
    found = fit_auto(replace(sweep, clock=None), config)
    fit, shape = found.fit, sweep.samples.shape[:2]
    if found.mode == "incoherent" or not len(fit):
        return None
    wave = np.exp(-2j * np.pi * fit.delay_s[:, None] * sweep.frequency_offset_hz)
    slope = -2j * np.pi * DELAY_UNIT_S * sweep.frequency_offset_hz * wave
    basis = np.linalg.qr(np.concatenate([wave, slope]).T)[0]
    symbols = found.steady.prs_symbol.conj()
    turned = zip(found.steady.samples, symbols, strict=True)
    errors = found.pair_errors
    excess, variance = (
        (np.zeros(shape), np.zeros(shape)) if errors is None else (errors.excess, errors.phase_variance)
    )
    stop = StopSamples(
        sample=np.stack([(samples * symbol) @ basis.conj() for samples, symbol in turned]),
        wave=wave @ basis.conj(),
        slope=slope @ basis.conj(),
        weight=1 / (sweep.noise_power_mw * (1 + excess)),
        phase_variance=variance,
    )
    model = StopModel(
        gain=fit.amplitude * np.exp(1j * fit.phase_rad),
        delay_change=np.zeros(len(fit)),
        aod_rad=fit.aod_rad,
        aoa_rad=fit.aoa_rad,
        phase_rad=np.zeros(shape),
    )
    return stop, model

"""Power of the background that no path explains: over delay, and over delay in the direction of a path."""

import numpy as np

from estimation.channel.model.compress import CompressedSweep
from estimation.channel.model.path_model import PathParameters, responses
from scenes.record import ComplexArray, FloatArray

SMOOTHING_BINS = 2  # to either side, for the background's power over delay
NOISE_STD = 5.0  # deviation of a smoothed bin's power up to which it counts as noise
KEPT_SHARE = 0.95  # of the directions, from the weakest up, that the background is estimated from
AROUND_BINS = 24  # to either side of a path, for the background in its direction
OWN_BINS = 2  # to either side, filled by the path itself
NOTABLE = 1.7  # least background in a direction that counts: noise alone exceeds it once in 250 times


def background_over_delay(residual: ComplexArray) -> FloatArray:
    """Smoothed power (bin,) of the residual (tx_rank, rx_rank, bin) of the paths; 1 if noise explains it.

    The strongest directions are left out: power only there, such as of unresolved paths, is no dense background.
    The mean of an exponential variable below its quantile p is 1 + (1 - p) log(1 - p) / p.
    """
    directions = np.sort(np.square(np.abs(residual)).reshape(-1, residual.shape[2]), axis=0)
    n_kept = max(1, int(np.ceil(KEPT_SHARE * len(directions))))
    share = n_kept / len(directions)
    expected = 1 + (1 - share) * np.log(1 - share) / share if share < 1 else 1.0
    power = directions[:n_kept].mean(axis=0, dtype=float) / expected
    width = 2 * SMOOTHING_BINS + 1
    smooth = np.convolve(np.pad(power, SMOOTHING_BINS, mode="edge"), np.ones(width) / width, "valid")
    n_cells = residual.shape[0] * residual.shape[1] * width
    return np.where(smooth > 1 + NOISE_STD / np.sqrt(n_cells), smooth, 1.0)


def background_along(sweep: CompressedSweep, residual_parts: FloatArray, paths: PathParameters) -> FloatArray:
    """Noise power (path,) about paths in the output of their directions' matched filters; 1 if noise explains it.

    It is the median over the delays around a path, so a few other paths there do not count. `residual_parts`
    (part, tx_rank, rx_rank, bin) is without the paths.
    """
    at = responses(sweep, paths)
    tx, rx = at.tx[:, 0], at.rx[:, 0]
    energy = np.square(np.abs(tx)).sum(axis=1) * np.square(np.abs(rx)).sum(axis=1)
    beams = (tx.conj()[:, :, None] * rx.conj()[:, None]).reshape(len(paths), tx.shape[1] * rx.shape[1])
    samples = (residual_parts[0] + 1j * residual_parts[1]).reshape(beams.shape[1], -1)
    power = np.square(np.abs(beams.astype(np.complex64) @ samples)) / energy[:, None]
    offset_bins = np.abs(sweep.position - paths.delay_bins[:, None])
    beside = (offset_bins > OWN_BINS) & (offset_bins <= AROUND_BINS)
    factor = np.ones(len(paths))
    for path in np.flatnonzero(beside.sum(axis=1) >= AROUND_BINS):
        factor[path] = np.median(power[path, beside[path]]) / np.log(2)
    return np.where(factor > NOTABLE, factor, 1.0)

"""Power over delay of the background that no path explains."""

import numpy as np

from scenes.record import ComplexArray, FloatArray

SMOOTHING_BINS = 2  # to either side, for the background's power over delay
NOISE_STD = 5.0  # deviation of a smoothed bin's power up to which it counts as noise
KEPT_SHARE = 0.95  # of the directions, from the weakest up, that the background is estimated from


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

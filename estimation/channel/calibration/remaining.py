"""What self-calibration leaves: smaller errors of elements, and a pointing offset.

All directions share the offset, so no path of any stop shows it.
"""

from dataclasses import replace

import numpy as np

from estimation.channel.calibration.record import Calibration
from estimation.channel.coherent.plan import nominal_manifold
from estimation.channel.config import ChannelConfig
from estimation.channel.correlation import PointingErrors
from estimation.channel.record import MIN_PARAMETERS, ChannelEstimate
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import ComplexArray, FloatArray
from sim.signal.arrays.codebook import Codebook

DIGITS = 7  # of positions in m, up to which elements are in one column
LEAST_COSINE = 0.1  # of a direction to the plane of its panel, where a sine still tells it


def likelihood_settings(config: ChannelConfig, calibration: Calibration) -> ChannelConfig:
    """The settings for calibrated arrays: what is left of their errors is no more than what was found."""
    if not calibration.n_paths:
        return config
    ends = (calibration.tx_codebook, calibration.tx_element), (calibration.rx_codebook, calibration.rx_element)
    found = float(np.mean([error_power(codebook, element) for codebook, element in ends]))
    settings = config.maximum_likelihood
    most = settings.model_copy(update={"max_element_error": min(found, settings.max_element_error)})
    return config.model_copy(update={"maximum_likelihood": most})


def with_pointing_errors(estimate: ChannelEstimate, calibration: Calibration) -> ChannelEstimate:
    """The estimate with the uncertain pointing of both arrays in the covariances of its directions.

    The phases of independent errors of elements have a linear part over the aperture, which turns all directions
    (`without_gauge` leaves it out). Its variance follows from the learned errors of the elements.
    """
    if not len(estimate) or not calibration.n_paths:
        return estimate
    pointing = np.zeros_like(estimate.covariance)
    ends = (
        (calibration.tx_codebook, calibration.tx_element, estimate.aod_azimuth_rad, estimate.aod_elevation_rad, 0),
        (calibration.rx_codebook, calibration.rx_element, estimate.aoa_azimuth_rad, estimate.aoa_elevation_rad, 1),
    )
    for codebook, element, azimuth_rad, elevation_rad, end in ends:
        added = direction_covariance(codebook, sine_variance(codebook, element), azimuth_rad, elevation_rad)
        place = [1 + end, MIN_PARAMETERS + end] if estimate.size("parameter") > MIN_PARAMETERS else [1 + end]
        pointing[:, np.array(place)[:, None], place] = added[:, : len(place), : len(place)]
    return replace(estimate, covariance=estimate.covariance + pointing, pointing=PointingErrors(pointing))


def sine_variance(codebook: Codebook, element: ComplexArray) -> FloatArray:
    """Variance of the offset of the sines of directions along the rows and the columns of a panel, (2,).

    It is that of the slope of independent phases by least squares. An array without extent has no such slope.
    """
    position = codebook.element_position_m[:, 1:] - codebook.element_position_m[:, 1:].mean(axis=0)
    spread = np.square(2 * np.pi * codebook.carrier_hz / SPEED_OF_LIGHT_M_S * position).sum(axis=0)
    phase_variance = error_power(codebook, element) / 2
    return np.asarray(np.divide(phase_variance, spread, out=np.zeros(2), where=spread > 0))


def error_power(codebook: Codebook, element: ComplexArray) -> float:
    """Power of the error of an element over its own, from learned factors (element,).

    Beams that do not resolve elevation show the mean of every column alone.
    """
    shown = float(np.mean(np.square(np.abs(element - 1))))
    if nominal_manifold(codebook).n_angles == 2:
        return shown
    n_columns = len(np.unique(codebook.element_position_m[:, 1].round(DIGITS)))
    return shown * len(element) / n_columns


def direction_covariance(
    codebook: Codebook, variance: FloatArray, azimuth_rad: FloatArray, elevation_rad: FloatArray
) -> FloatArray:
    """Covariance (direction, 2, 2) of azimuth and elevation by errors of the sines of this `variance` (2,).

    Where the elevation is NaN, the azimuth is taken as horizontal, and the elevation stays unknown.
    """
    manifold = nominal_manifold(codebook)
    level = np.nan_to_num(elevation_rad)
    angles = np.stack([azimuth_rad, level], axis=1)[:, : manifold.n_angles]
    panel = manifold.best_panel_rad(angles)
    local = azimuth_rad - panel
    cosine = np.maximum(np.abs(np.cos(local) * np.cos(level)), LEAST_COSINE)
    slope = np.zeros((len(azimuth_rad), 2, 2))  # of azimuth and elevation over both sines
    slope[:, 1, 1] = 1 / np.maximum(np.cos(level), LEAST_COSINE)
    slope[:, 0, 0] = 1 / cosine
    slope[:, 0, 1] = np.sin(local) * np.sin(level) * slope[:, 1, 1] / cosine
    return np.asarray((slope * variance) @ slope.swapaxes(1, 2))

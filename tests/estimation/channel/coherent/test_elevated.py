"""A path above the horizon on two panels is one path, and two paths at the horizon remain two."""

import numpy as np
import pytest
from scipy.stats import chi2

from estimation.channel.coherent.elevated import merge_elevated_images
from estimation.channel.coherent.paths import compress_stop, fit_coherent
from estimation.channel.coherent.raised import PathRaiser
from estimation.channel.coherent.refine import Reference, refine_paths
from estimation.channel.fit import PathFit
from estimation.channel.model.apparent import apparent_angles, cone_angles
from estimation.channel.model.manifold import Manifold
from estimation.channel.model.path_model import PathParameters
from scenes.record import FloatArray
from sim.config import ArrayConfig
from sim.observation import BeamSweep
from sim.signal.arrays.codebook import beam_response
from sim.signal.link import make_codebook
from tests.estimation.channel.plain_sweeps import PANELS, plain_link, plain_paths, plain_sweep

LINK = plain_link(rx=PANELS)
AZIMUTH_DEG, ELEVATION_DEG = -50.0, 40.0  # on the edge of the panels at -90 and 0 deg
N_TRIALS = 40


def _cone() -> float:
    return float(
        apparent_angles(LINK.rx_codebook, Manifold(LINK.rx_codebook), *np.deg2rad([AZIMUTH_DEG, ELEVATION_DEG]))[
            0
        ][0, 0]
    )


def _one_above(rng: np.random.Generator, snr_db: float = 30.0) -> BeamSweep:
    """The sweep of one path from above, and of another at the horizon."""
    aod, aoa = [[20.0, 0.0], [-10.0, 0.0]], [[AZIMUTH_DEG, ELEVATION_DEG], [100.0, 0.0]]
    return plain_sweep(LINK, plain_paths(LINK, [200.0, 400.0], aod, aoa, snr_db, phase=[1.0, 0.0]), rng)


def _two_level(rng: np.random.Generator, phase: float) -> BeamSweep:
    """The sweep of two paths at the horizon, where the two panels show the one from above."""
    cones = [
        cone_angles(*np.deg2rad([[AZIMUTH_DEG], [ELEVATION_DEG]]), np.deg2rad([panel]))[0][0]
        for panel in (-90.0, 0.0)
    ]
    paths = plain_paths(LINK, [200.0, 200.0], [20.0, 20.0], np.rad2deg(cones), [30.0, 27.0], phase=[0.0, phase])
    return plain_sweep(LINK, paths, rng)


@pytest.mark.parametrize("snr_db", [20.0, 30.0, 50.0])
def test_one_path_above_the_horizon_is_one(snr_db: float) -> None:
    """At 50 dB a model of horizontal paths needs more than two."""
    fit = fit_coherent(_one_above(np.random.default_rng(1), snr_db))
    assert len(fit) == 2
    assert np.allclose(np.rad2deg(fit.aoa_rad[:, 0]), [np.rad2deg(_cone()), 100.0], atol=1.5)
    assert np.allclose(fit.snr_db, snr_db, atol=1.5)


def test_a_model_of_the_horizon_alone_needs_two() -> None:
    stop = compress_stop(
        _one_above(np.random.default_rng(1)), None, *map(Manifold, (LINK.tx_codebook, LINK.rx_codebook))
    )
    assert not isinstance(stop, PathFit)
    bins = 1e-9 / stop.compressed.bin_s
    aoa = np.deg2rad([[-72.4, 0.0], [-36.0, 0.0], [100.0, 0.0]])
    start = PathParameters(
        bins * np.array([200.0, 200.0, 400.0]), np.deg2rad([[20.0], [20.0], [-10.0]]), aoa, np.ones(3, complex)
    )
    reference = Reference(stop.compressed, start.take(slice(0)))
    level = refine_paths(reference, start, 30)
    assert (
        level.explained - refine_paths(reference, start.take(np.array([0, 2])), 30).explained
        > 10 * stop.window.level
    )
    one = merge_elevated_images(reference, level, stop.window.level_at, 30)
    assert len(one.paths) == 2
    assert np.isclose(abs(np.rad2deg(one.paths.aoa_rad[:, 1]).max()), ELEVATION_DEG, atol=2.0)
    assert one.explained > level.explained - stop.window.level
    assert merge_elevated_images(reference, one, stop.window.level_at, 30) is one


@pytest.mark.parametrize("phase", [-2.0, 1.0, 3.0])
def test_two_paths_at_the_horizon_remain_two(phase: float) -> None:
    assert len(fit_coherent(_two_level(np.random.default_rng(2), phase))) == 2


def test_the_covariance_of_the_cone_angle_holds() -> None:
    rng = np.random.default_rng(3)
    nees: list[FloatArray] = []
    for _ in range(N_TRIALS):
        fit = fit_coherent(_one_above(rng, 25.0))
        place = np.array([fit.delay_s[0], fit.aod_rad[0, 0], fit.aoa_rad[0, 0]])
        error = place - [200e-9, np.deg2rad(20.0), _cone()]
        nees.append(error @ np.linalg.solve(fit.covariance[0], error))
    assert np.mean(nees) / 3 == pytest.approx(1, abs=4 * np.sqrt(2 / 3 / N_TRIALS))
    assert np.mean(np.array(nees) < chi2.ppf(0.95, 3)) > 0.85


def test_the_model_of_hidden_elevations_is_that_of_the_beams_up_to_a_gain() -> None:
    rng = np.random.default_rng(4)
    azimuth, elevation = rng.uniform(-3, 3, 30), rng.uniform(-0.6, 0.6, 30)
    manifold = Manifold(LINK.rx_codebook).with_hidden_elevation()
    assert (manifold.n_angles, manifold.hides_elevation) == (2, True)
    model = manifold.response(np.stack([azimuth, elevation], axis=1))
    true = beam_response(LINK.rx_codebook, azimuth, elevation).T
    likeness = (
        np.abs((model.conj() * true).sum(axis=1)) / np.linalg.norm(model, axis=1) / np.linalg.norm(true, axis=1)
    )
    assert np.allclose(likeness, 1, atol=1e-6)


@pytest.mark.parametrize(
    "array",
    [
        ArrayConfig(),
        ArrayConfig(beam_elevation_deg=[0.0, 15.0], panel_azimuth_deg=[0.0, 90.0]),
        ArrayConfig(panel_azimuth_deg=[0.0, 90.0], panel_tilt_deg=[10.0]),
    ],
)
def test_one_panel_and_beams_that_resolve_elevation_hide_none(array: ArrayConfig) -> None:
    manifold = Manifold(make_codebook(array, 60e9))
    assert manifold.with_hidden_elevation() is manifold


def test_a_cone_is_in_front_and_its_slopes_are_limits_of_differences() -> None:
    azimuth, elevation, boresight = np.deg2rad([[-103.7, 20.0, 170.0], [0.0, 30.0, -20.0], [0.0, 10.0, 180.0]])
    cone, slopes = cone_angles(azimuth, elevation, boresight)
    assert np.rad2deg(cone[0]) == pytest.approx(-76.3)
    step = 1e-6
    for axis, change in enumerate(((step, 0.0), (0.0, step))):
        more = cone_angles(azimuth + change[0], elevation + change[1], boresight)[0]
        less = cone_angles(azimuth - change[0], elevation - change[1], boresight)[0]
        assert np.allclose((more - less) / (2 * step), slopes[:, axis], atol=1e-8)


@pytest.mark.parametrize("elevation_deg", [12.0, 30.0])
def test_a_horizontal_path_on_the_edge_of_two_panels_is_raised(elevation_deg: float) -> None:
    """At the horizon the likelihood has no slope over elevation: steps alone stay there."""
    aod, aoa = [[20.0, 0.0], [-10.0, 0.0]], [[AZIMUTH_DEG, elevation_deg], [100.0, 0.0]]
    sweep = plain_sweep(LINK, plain_paths(LINK, [200.0, 400.0], aod, aoa, 40.0), np.random.default_rng(5))
    stop = compress_stop(sweep, None, None, None)
    assert not isinstance(stop, PathFit)
    delay = 1e-9 * np.array([200.0, 400.0]) / stop.compressed.bin_s
    level = np.deg2rad([[AZIMUTH_DEG, 0.0], [100.0, 0.0]])
    start = PathParameters(delay, np.deg2rad([[20.0], [-10.0]]), level, np.ones(2, complex))
    flat = refine_paths(Reference(stop.compressed, start.take(slice(0))), start, 30)
    assert (flat.paths.aoa_rad[:, 1] == 0).all()
    reference = Reference(stop.compressed, flat.paths)
    raised = PathRaiser()(reference, flat, stop.window.level / 2, 30)
    assert abs(np.rad2deg(raised.paths.aoa_rad[0, 1])) == pytest.approx(elevation_deg, abs=2.0)
    assert raised.paths.aoa_rad[1, 1] == 0
    assert raised.explained > flat.explained + stop.window.level

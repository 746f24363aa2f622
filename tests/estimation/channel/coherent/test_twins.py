"""Beams at two elevations respond alike in several directions: what is likely in a hall decides between them."""

import numpy as np
import pytest

from estimation.channel.coherent.paths import fit_coherent
from estimation.channel.coherent.plan import nominal_manifold
from estimation.channel.coherent.refine import Reference, refine_paths, solve_at
from estimation.channel.coherent.search import direction_grid
from estimation.channel.coherent.twins import TwinChooser
from estimation.channel.model.alike import twins_on_cone
from estimation.channel.model.compress import beam_span
from estimation.channel.model.direction_prior import direction_log_prior
from estimation.channel.model.manifold import CELL
from estimation.channel.model.path_model import PathParameters, no_paths
from scenes.pose import wrap_angle
from sim.config import ArrayConfig
from tests.estimation.channel.plain_sweeps import PANELS, compressed, plain_link, plain_paths, plain_sweep

TWO_LEVELS = {"columns": 8, "beams_per_panel": 8, "beam_elevation_deg": [-10.0, 10.0]}
TX = ArrayConfig(**TWO_LEVELS, sector_deg=120.0)
RX = ArrayConfig(**TWO_LEVELS, sector_deg=90.0, panel_azimuth_deg=[-180.0, -90.0, 0.0, 90.0])
LINK = plain_link(tx=TX, rx=RX)


def test_twins_respond_alike_and_are_elsewhere() -> None:
    manifold = beam_span(nominal_manifold(LINK.tx_codebook)).manifold
    grid = direction_grid(manifold, 2.0)
    assert grid.twin.shape[1] > 1
    direction, twin = grid.angle_rad[:, None], grid.angle_rad[grid.twin]
    response = manifold.response(grid.angle_rad)
    unit = response / np.linalg.norm(response, axis=1, keepdims=True)
    coherence = np.abs(np.einsum("db,dtb->dt", unit.conj(), unit[grid.twin]))
    assert coherence.min() >= 0.5
    rate = np.sqrt(np.einsum("daa->da", manifold.metric(grid.angle_rad)))
    apart = (np.abs(wrap_angle(twin - direction)) * rate[:, None]).max(axis=2)
    is_twin = grid.twin != np.arange(len(grid.twin))[:, None]
    assert is_twin.any() and apart[is_twin].min() > 0.3 * CELL


def test_beams_at_one_elevation_have_no_twins_inside_their_sector() -> None:
    manifold = beam_span(nominal_manifold(plain_link(rx=PANELS).rx_codebook)).manifold
    assert direction_grid(manifold, 2.0).twin.shape[1] == 1


@pytest.mark.parametrize("elevation_deg", [-18.0, -6.0, 4.0, 12.0, 18.0, 28.0])
@pytest.mark.parametrize("snr_db", [30.0, 60.0])
def test_one_path_is_found_at_its_own_elevation(elevation_deg: float, snr_db: float) -> None:
    """At departure the other directions of the same ratio are as likely by the samples."""
    aod, aoa = [[12.0, -elevation_deg]], [[100.0, elevation_deg]]
    sweep = plain_sweep(LINK, plain_paths(LINK, [200.0], aod, aoa, snr_db), np.random.default_rng(3))
    fit = fit_coherent(sweep)
    assert len(fit) == 1
    np.testing.assert_allclose(np.rad2deg(fit.aod_rad), aod, atol=2.5 if snr_db < 50 else 0.5)
    np.testing.assert_allclose(np.rad2deg(fit.aoa_rad), aoa, atol=2.5 if snr_db < 50 else 0.5)


def test_a_path_moves_to_its_twin_beyond_a_fold() -> None:
    """The two directions are less than a resolution cell apart, and the ratio of gains has its extreme between."""
    steeper = ArrayConfig(columns=8, beams_per_panel=8, beam_elevation_deg=[-12.0, 12.0], sector_deg=120.0)
    link, place = plain_link(tx=steeper, rx=RX), ([[-3.0, 33.0]], [[100.0, 33.0]])
    sweep = compressed(plain_sweep(link, plain_paths(link, [200.0], *place, 60.0), np.random.default_rng(3)))
    aod, aoa = np.deg2rad(place[0]), np.deg2rad(place[1])
    twins = twins_on_cone(sweep.tx, aod, 0.99)[0]
    steep = twins[np.argmax(twins[:, 1])]
    apart = np.abs(steep - aod[0]) * np.minimum(sweep.tx.rates(aod)[0], sweep.tx.rates(steep[None])[0])
    assert np.rad2deg(steep[1]) > 45.0 and apart.max() < CELL
    nothing = Reference(sweep, no_paths(sweep))
    wrong = PathParameters(np.array([200e-9 / sweep.bin_s]), steep[None], aoa, np.ones(1, complex))
    found = refine_paths(nothing, wrong, 30)
    assert np.rad2deg(found.paths.aod_rad[0, 1]) > 45.0
    reference = Reference(sweep, found.paths)
    grids = direction_grid(sweep.tx, 2.0), direction_grid(sweep.rx, 2.0)
    chosen = TwinChooser(grids)(reference, solve_at(reference, found.paths), 10)
    np.testing.assert_allclose(np.rad2deg(chosen.paths.aod_rad), place[0], atol=0.5)


def test_the_prior_prefers_equal_low_elevations_in_front() -> None:
    sweep = compressed(plain_sweep(LINK, plain_paths(LINK, [200.0], [[0.0, 0.0]], [[0.0, 0.0]], 30.0)))
    aod = np.deg2rad([[10.0, 5.0], [10.0, 45.0], [170.0, 5.0], [10.0, 45.0]])
    aoa = np.deg2rad([[50.0, -5.0], [50.0, -5.0], [50.0, -5.0], [50.0, -45.0]])
    prior = direction_log_prior(sweep.tx, sweep.rx, aod, aoa)
    assert (prior[0] > prior[1:]).all()
    assert prior[3] > prior[1]  # equal at both ends


def test_a_mirror_image_at_the_panel_has_the_same_phases() -> None:
    manifold = nominal_manifold(LINK.tx_codebook)
    behind = np.deg2rad([[130.0, 10.0], [-100.0, -5.0]])
    mirror = manifold.mirrored(behind)
    np.testing.assert_allclose(np.rad2deg(mirror), [[50.0, 10.0], [-80.0, -5.0]])
    assert manifold.is_behind(behind).all() and not manifold.is_behind(mirror).any()
    one, other = manifold.response(behind), manifold.response(mirror)
    coherence = (
        np.abs((one.conj() * other).sum(axis=1)) / np.linalg.norm(one, axis=1) / np.linalg.norm(other, axis=1)
    )
    np.testing.assert_allclose(coherence, 1.0)

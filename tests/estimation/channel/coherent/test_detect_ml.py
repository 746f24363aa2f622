from dataclasses import replace

import numpy as np
import pytest

from estimation.channel.coherent.plan import SearchPlan, delay_window, nominal_manifold, search_plan
from estimation.channel.coherent.search import SpectrumSearch, without_side_lobes
from estimation.channel.config import MaximumLikelihoodConfig
from estimation.channel.model.compress import DelayCube, compress
from estimation.channel.model.path_model import PathParameters, response_energies, responses
from sim.config import ArrayConfig
from sim.observation import BeamSweep
from sim.signal.link import make_codebook
from tests.estimation.channel.plain_sweeps import no_plain_paths, plain_link, plain_paths, plain_sweep

SMALL = plain_link()

PANELS = ArrayConfig(columns=4, beams_per_panel=5, sector_deg=90.0, panel_azimuth_deg=[-180.0, -90.0, 0.0, 90.0])
ELEVATION = ArrayConfig(columns=4, beams_per_panel=5, beam_elevation_deg=[-15.0, 15.0])


def _plan(sweep: BeamSweep) -> SearchPlan:
    return search_plan(
        nominal_manifold(sweep.tx_codebook),
        nominal_manifold(sweep.rx_codebook),
        tuple(sweep.noise_power_mw.tolist()),
        2.0,
    )


def _cube(sweep: BeamSweep) -> tuple[DelayCube, SearchPlan]:
    plan = _plan(sweep)
    return compress(sweep, plan.tx, plan.rx), plan


def test_plans_are_made_once_per_pair_of_codebooks() -> None:
    sweep = plain_sweep(SMALL, plain_paths(SMALL, 200.0, 5.0, 0.0, 20.0))
    same = replace(sweep, tx_codebook=replace(sweep.tx_codebook), stop=4)
    assert _plan(sweep) is _plan(same)
    other = make_codebook(PANELS, 60e9)
    assert nominal_manifold(other) is not nominal_manifold(sweep.tx_codebook)


@pytest.mark.parametrize("rx", [None, PANELS, ELEVATION])
def test_strongest_peak_is_near_the_path(rx: ArrayConfig | None) -> None:
    """The loss of a path between grid points is less than the search allows for."""
    link = plain_link(rx=rx)
    for delay_ns, aod_deg, aoa_deg in ((200.0, 10.0, -17.0), (217.0, -31.0, 5.0)):
        paths = plain_paths(link, delay_ns, aod_deg, aoa_deg, 30.0)
        cube, plan = _cube(plain_sweep(link, paths))
        sweep = cube.window(np.arange(-5, 40))
        search = SpectrumSearch(sweep, plan.grids, 2)
        peaks = search.peaks(sweep.parts, 10.0)
        found = search.paths(peaks.take(slice(0, 1)))
        assert abs(found.delay_bins[0] * sweep.bin_s - 1e-9 * delay_ns) <= sweep.bin_s / 2
        energy = response_energies(responses(sweep, found))[0]
        assert np.isclose(abs(peaks.value[0]) ** 2, abs(found.amplitude[0]) ** 2 * energy, rtol=0.02)
        total = (sweep.parts**2).sum()
        assert 0.5 * total < abs(peaks.value[0]) ** 2 <= 1.001 * total


@pytest.mark.parametrize("ends", [(None, PANELS), (ELEVATION, None), (None, ELEVATION)])
def test_peaks_are_those_of_the_spectrum_written_out(ends: tuple[ArrayConfig | None, ArrayConfig | None]) -> None:
    """In either order of the products, and with a share of the largest where few delays are computed."""
    link = plain_link(*ends)
    paths = plain_paths(link, [200.0, 320.0], [10.0, -5.0], [-17.0, 12.0], [40.0, 28.0], phase=[0.0, 2.0])
    cube, plan = _cube(plain_sweep(link, paths, np.random.default_rng(1)))
    sweep = cube.window(np.arange(-5, 40))
    search = SpectrumSearch(sweep, plan.grids, 2)
    tx, rx = (grid.matched for grid in plan.grids)
    fine = search._delay_filtered(sweep.parts)
    power = np.square(np.abs(np.einsum("am,bn,mnd->abd", tx, rx, fine)))
    for share in (0.0, 0.1, 0.5):
        peaks = search.peaks(sweep.parts, 20.0, share)
        place = np.rint((peaks.delay_bins - sweep.position[0]) * 2).astype(int)
        np.testing.assert_allclose(np.square(np.abs(peaks.value)), power[peaks.tx, peaks.rx, place], rtol=1e-4)
        least = max(20.0, share**2 * power.max())
        expected = {
            (i, j, d)
            for i, j, d in np.argwhere(power >= least)
            if power[plan.grids[0].neighbour[i][:, None], plan.grids[1].neighbour[j], d].max() <= power[i, j, d]
            and power[i, j, max(0, d - 1) : d + 2].max() <= power[i, j, d]
        }
        assert {*zip(peaks.tx, peaks.rx, place, strict=True)} == expected


def test_side_lobes_of_one_path_are_no_paths() -> None:
    cube, plan = _cube(plain_sweep(SMALL, plain_paths(SMALL, 217.0, 13.0, -17.0, 50.0)))
    sweep = cube.window(np.arange(-5, 60))
    search = SpectrumSearch(sweep, plan.grids, 2)
    peaks = search.peaks(sweep.parts, 10.0)
    assert len(peaks) > 50
    assert len(without_side_lobes(peaks, plan.grids, 1.4, 40)) == 1


def test_separate_paths_are_taken_in_one_batch() -> None:
    paths = plain_paths(SMALL, [200.0, 400.0, 700.0], [0.0, 30.0, -30.0], [0.0, -30.0, 20.0], [40.0, 35.0, 30.0])
    cube, plan = _cube(plain_sweep(SMALL, paths))
    sweep = cube.window(np.arange(-5, 60))
    search = SpectrumSearch(sweep, plan.grids, 2)
    batch = search.paths(without_side_lobes(search.peaks(sweep.parts, 10.0), plan.grids, 1.4, 40))
    assert np.abs(np.sort(batch.delay_bins) * sweep.bin_s - paths.delay_s).max() < sweep.bin_s


def test_window_follows_the_strongest_path() -> None:
    """132 RB: a period of 8.3 us, of which the window is a part; a late path adds the bins around it."""
    link = plain_link(n_rb=132)
    paths = plain_paths(link, [-60.0, 5000.0], [0.0, 20.0], [0.0, -10.0], [40.0, 30.0])
    cube, plan = _cube(plain_sweep(link, paths, np.random.default_rng(1)))
    window = delay_window(cube, plan, MaximumLikelihoodConfig())
    assert window is not None
    bins = paths.delay_s / cube.bin_s
    assert window.first < bins[0] < window.last
    assert len(window.position) < cube.n_bins / 2
    assert np.abs(window.position - bins[1]).min() < 1
    assert window.level < window.late_level
    places = PathParameters(bins, paths.aod_rad, paths.aoa_rad, paths.amplitude)
    assert np.allclose(window.level_at(places), [window.level, window.late_level])


def test_noise_alone_has_no_window() -> None:
    link = plain_link()
    nothing = no_plain_paths(link)
    cube, plan = _cube(plain_sweep(link, nothing, np.random.default_rng(2)))
    assert delay_window(cube, plan, MaximumLikelihoodConfig(false_alarm_probability=1e-6)) is None


def test_expected_delays_need_less_power_than_others() -> None:
    """A path at 4 us is missed, but found if the first path is expected at 4 us."""
    link = plain_link(n_rb=132)
    hits = {}
    for name, expected in (("near", (-200.0, 1000.0)), ("late", (3500.0, 4500.0))):
        config = MaximumLikelihoodConfig(expected_delay_ns=expected)
        found = []
        for seed in range(20):
            sweep = plain_sweep(link, plain_paths(link, 4000.0, 0.0, 0.0, 7.0), np.random.default_rng(seed))
            found.append(delay_window(*_cube(sweep), config) is not None)
        hits[name] = sum(found)
    assert hits["late"] > hits["near"]


def test_expected_delays_must_ascend() -> None:
    with pytest.raises(ValueError, match="below the second"):
        MaximumLikelihoodConfig(expected_delay_ns=(10.0, 5.0))

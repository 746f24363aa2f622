from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from isac_arena.campaign.measured import MeasuredCampaign
from isac_arena.insight.twin.offsets import leave_one_out, other_half, sight_offsets, straight_residuals
from isac_arena.insight.twin.power import fit_power
from isac_arena.insight.twin.record import HeadingSource
from isac_arena.insight.twin.scores import object_residuals, twin_metrics
from isac_arena.insight.twin.twin import make_twin
from isac_arena.report.figures.twin import twin_map_figure, twin_residual_figure
from isac_arena.report.style import png_bytes
from tests.isac_arena.insight.twin.made_twin import (
    DELAY_OFFSET_S,
    FLOOR_DBM,
    GAINS_DB,
    N_STOPS,
    REFERENCE_DBM,
    SESSION_STOP,
    TX_OFFSET_RAD,
    make,
    with_weak_path,
)


@pytest.fixture(scope="module")
def made():
    return make(np.random.default_rng(1))


def twin_of(made, campaign=None):
    campaign = campaign or made.campaign
    return make_twin(campaign, made.scene, {"one_bounce": made.simulated})


def values(twin, scene):
    return {metric.key: metric.value for metric in twin_metrics(twin, scene.kinds)}


def test_offsets_of_an_exact_measurement_are_found(made):
    offsets = sight_offsets(made.campaign, leave_one_out(N_STOPS))
    assert offsets.session.tolist() == [0] * SESSION_STOP + [1] * (N_STOPS - SESSION_STOP)
    assert_allclose(offsets.delay_s, DELAY_OFFSET_S, atol=1e-15)
    assert_allclose(offsets.aod_rad, -TX_OFFSET_RAD[offsets.session], atol=1e-12)
    assert_allclose(offsets.aoa_rad, -made.heading_error_rad, atol=1e-12)
    assert (offsets.heading_source == HeadingSource.LINE_OF_SIGHT).all()


def test_an_exact_measurement_is_explained_wholly(made):
    twin = twin_of(made, with_weak_path(made, FLOOR_DBM))
    paths = twin.models["one_bounce"].paths
    made_up = paths.delay_residual_s.size - sum(len(one) for one in made.simulated)
    assert made_up == N_STOPS == (~paths.is_explained & ~paths.is_los).sum()
    known = paths.is_explained
    assert_allclose(paths.delay_residual_s[known], 0, atol=1e-14)
    assert_allclose(paths.aod_residual_rad[known], 0, atol=1e-10)
    assert_allclose(paths.aoa_residual_rad[known & ~paths.is_los], 0, atol=1e-10)
    # The line of sight that the reference power is from stands a little over the floor itself.
    assert_allclose(paths.power_residual_db[known], 0, atol=0.02)
    score = values(twin, made.scene)
    n_single = paths.is_single_bounce.sum()
    assert score["twin.one_bounce.explained.narrow"] == pytest.approx((n_single - N_STOPS) / n_single)
    assert score["twin.los_agreement.stops"] == score["twin.stops"] == N_STOPS
    assert score["twin.one_bounce.chance"] < 0.05


def test_the_path_that_gives_the_heading_is_compared_with_other_stops(made):
    stop, truths = 4, list(made.campaign.truths)
    los = int(np.argmax(truths[stop].is_los))
    truths[stop] = replace(truths[stop], is_los=np.zeros(len(truths[stop].is_los), bool))
    campaign = MeasuredCampaign(made.campaign.tx, made.campaign.channel, tuple(truths))
    offsets = sight_offsets(campaign, leave_one_out(N_STOPS))
    assert offsets.heading_source[stop] == HeadingSource.STRAIGHT
    assert offsets.heading_path[stop] == los
    others = np.delete(made.heading_error_rad, stop)
    assert offsets.other_aoa_rad[stop] == pytest.approx(-np.median(others))
    paths = twin_of(made, campaign).models["one_bounce"].paths
    row = np.flatnonzero((paths.stop == stop) & (paths.path == los))[0]
    expected = np.median(others) - made.heading_error_rad[stop]
    if abs(expected) <= np.deg2rad(3):
        assert paths.aoa_residual_rad[row] == pytest.approx(expected)
    else:
        assert not paths.is_explained[row]


def test_a_stop_without_any_straight_path_takes_the_heading_of_the_others():
    made = make(np.random.default_rng(2), blind=(3,))
    offsets = sight_offsets(made.campaign, leave_one_out(N_STOPS))
    assert offsets.heading_source[3] == HeadingSource.OTHER_STOPS
    assert offsets.heading_path[3] == -1
    assert offsets.aoa_rad[3] == pytest.approx(-np.median(np.delete(made.heading_error_rad, 3)))
    assert values(twin_of(made), made.scene)["twin.los_agreement.stops"] == N_STOPS - 1


def test_offsets_never_look_at_reflections_nor_at_the_clock_and_departure_of_their_own_stop(made):
    others = leave_one_out(N_STOPS)
    before = sight_offsets(made.campaign, others)
    channel = list(made.campaign.channel)
    moved = ~channel[5].is_los
    channel[5] = replace(channel[5], aod_azimuth_rad=channel[5].aod_azimuth_rad + 0.01 * moved)
    channel[7] = replace(channel[7], delay_s=channel[7].delay_s + 0.9e-9)
    after = sight_offsets(MeasuredCampaign(made.campaign.tx, tuple(channel), made.campaign.truths), others)
    for name in ("aod_rad", "aoa_rad"):
        assert_allclose(getattr(after, name), getattr(before, name), atol=1e-12)
    assert after.delay_s[7] == pytest.approx(before.delay_s[7], abs=1e-16)


def test_shares_fall_where_the_measurement_leaves_the_gate(made):
    channel = tuple(
        replace(one, aod_azimuth_rad=one.aod_azimuth_rad + np.deg2rad(2.5) * ~one.is_los)
        for one in made.campaign.channel
    )
    score = values(twin_of(made, replace(made.campaign, channel=channel)), made.scene)
    assert score["twin.one_bounce.explained.narrow"] < 0.05
    assert score["twin.one_bounce.explained.wide"] > 0.95
    # The other half of the stops gives the shift of the reflections.
    assert score["twin.one_bounce.calibrated.explained.narrow"] > 0.95


def test_gains_of_objects_are_learned_on_the_other_half():
    made = make(np.random.default_rng(3), gains=GAINS_DB)
    score = values(twin_of(made, with_weak_path(made, FLOOR_DBM)), made.scene)
    assert score["twin.one_bounce.power.pillar.median_db"] == pytest.approx(GAINS_DB["pillar"], abs=0.3)
    assert score["twin.one_bounce.power.single_bounce.rms_db"] > 1
    assert score["twin.one_bounce.calibrated.power.pillar.rms_db"] < 0.2
    assert score["twin.one_bounce.calibrated.power.single_bounce.rms_db"] < 0.5


def test_reference_and_floor_come_from_other_stops_only(made):
    campaign = with_weak_path(made, FLOOR_DBM)
    before = fit_power(campaign, made.simulated, other_half(N_STOPS))
    assert_allclose(before.reference_dbm, REFERENCE_DBM, atol=0.01)
    assert_allclose(before.floor_dbm, FLOOR_DBM)
    channel = list(campaign.channel)
    channel[4] = replace(channel[4], power_dbm=channel[4].power_dbm - 30)
    after = fit_power(replace(campaign, channel=tuple(channel)), made.simulated, other_half(N_STOPS))
    even = np.arange(N_STOPS) % 2 == 0
    assert_allclose(after.floor_dbm[even], before.floor_dbm[even])
    assert_allclose(after.floor_dbm[~even], FLOOR_DBM - 30)


def test_noise_shows_as_residuals():
    made = make(np.random.default_rng(4), noise=(0.2e-9, np.deg2rad(0.3)))
    twin = twin_of(made)
    score = values(twin, made.scene)
    assert score["twin.one_bounce.explained.wide"] > 0.95
    assert 0.15 < score["twin.one_bounce.delay.rms_ns"] < 0.3
    assert 0.2 < score["twin.one_bounce.aod.rms_deg"] < 0.5
    rows = object_residuals(twin.models["one_bounce"].paths)
    counts = [row.n for row in rows]
    assert counts == sorted(counts, reverse=True)
    paths = twin.models["one_bounce"].paths
    assert sum(counts) == (paths.is_explained & paths.is_single_bounce).sum()


def test_too_few_lines_of_sight_are_named():
    made = make(np.random.default_rng(5), blind=range(1, N_STOPS))
    with pytest.raises(ValueError, match=r"stop 0: 1 labelled lines of sight in 12 stops are too few"):
        twin_of(made)


def test_another_number_of_stops_is_refused(made):
    with pytest.raises(ValueError, match=r"simulated\['one_bounce'\]: 11 stops, the campaign has 12"):
        make_twin(made.campaign, made.scene, {"one_bounce": made.simulated[:-1]})


def test_the_straight_line_has_no_residual_but_the_offsets(made):
    residual = straight_residuals(made.campaign, 0)[made.campaign.truths[0].is_los][0]
    assert_allclose(residual, [DELAY_OFFSET_S, -TX_OFFSET_RAD[0], -made.heading_error_rad[0]], atol=1e-12)


def test_figures_are_drawn_with_and_without_explained_paths(made):
    model = twin_of(made).models["one_bounce"]
    twin = replace(twin_of(made), models={"one_bounce": model, "three_bounces": model})
    none = np.full(len(model.paths.stop), -1)
    nothing = replace(
        model.paths, simulated=none, simulated_narrow=none, object=np.full(len(none), ""),
        delay_residual_s=none * np.nan, predicted_dbm=none * np.nan,
    )  # fmt: skip
    empty = replace(twin, models={name: replace(model, paths=nothing) for name in twin.models})
    for one in (twin, empty):
        for figure in (twin_map_figure(made.scene, one, "three_bounces"), twin_residual_figure(made.scene, one)):
            assert png_bytes(figure).startswith(b"\x89PNG")

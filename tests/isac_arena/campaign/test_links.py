"""Campaigns that state their links, from the scene to the report: uplink, and nodes that hear nodes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from estimation.channel.record import EstimateStatus, empty_estimate
from estimation.slam.record import SolveStatus
from isac_arena.campaign.campaign import Campaign, load_campaign
from isac_arena.campaign.plan import plan_run
from isac_arena.campaign.stages import reopen, run_campaign
from isac_arena.campaign.stored import stored_results, stored_truths
from isac_arena.cli.main import app
from isac_arena.validation.multistatic.arenas import draw_arena
from isac_arena.validation.multistatic.links import linked_run
from isac_arena.verification.campaign import recomputed_campaign
from scenes.pose import wrap_angle
from sim.signal.link import make_link
from sim.transmitters import refuse_several_tx

pytestmark = pytest.mark.whole  # whole commands: `.ci/run` runs them after the quick tests

SMALL = {
    "tx_array.beams_per_panel": 16,
    "rx_array.beams_per_panel": 12,
    "waveform.n_rb": 132,
    "propagation": {"diffuse_samples": 0, "max_bounces": 1, "diffraction": False},
    "channel.method": "power",
}
NODES = ("south_west", "north_east")


def mixed() -> Campaign:
    """Two nodes that hear each other, and one that hears itself and an uplink."""
    links = [
        {"tx": "aisle", "rx": list(NODES)},
        {"tx": "south_west", "rx": ["aisle", "south_west"]},
        {"tx": "north_east", "rx": "south_west"},
    ]
    return load_campaign(
        {"name": "mixed", "scene": "pillar_hall", "links": links}, **SMALL, **{"scene.walks.aisle.n_stops": 3}
    )


def test_an_uplink_campaign_finds_what_walks() -> None:
    """Paths are those of the real link; maps and poses are those of what walks, at the bound of the downlink."""
    up = load_campaign("box_room_uplink", **{**SMALL, "waveform.n_rb": 264})
    down = load_campaign("box_room", **{**SMALL, "waveform.n_rb": 264})
    run, other = up.chain(), down.chain()
    truths = list(run.truths())
    scores, expected = run.scores(), other.scores()
    for truth, one in zip(truths, run.channel(truths), strict=True):
        los = int(np.argmax(one.is_los))
        error = wrap_angle(one.aod_azimuth_rad[los] + truth.stop_pose.heading_rad - truth.paths.aod_azimuth_rad[0])
        assert abs(error) < np.deg2rad(1.0)
    assert scores.value("slam.solved_share") == 1
    assert scores.value("slam.position.rmse_m") < 0.1 and scores.value("mapping.ip_to_surface.median_m") < 0.05
    bounds = [each.value("slam.position.bound_m") for each in (scores, expected)]
    assert bounds[0] == pytest.approx(bounds[1], rel=1e-3)


def test_a_campaign_of_all_kinds_of_links(tmp_path: Path) -> None:
    loaded, out = mixed(), tmp_path / "mixed"
    plan = plan_run(loaded.config, loaded.scene, make_link(loaded.config)).does
    assert "SLAM of every stop but the 1 at fixed nodes alone" in plan or "at fixed nodes together" in plan
    assert "uplink aisle-south_west, aisle-north_east; node to node north_east-south_west; monostatic" in plan
    assert run_campaign(loaded, out, keep_sweeps=True) == []
    store = reopen(out)
    truths, results = list(stored_truths(store, 4)), stored_results(store, 4)
    assert [(truth.stop, truth.tx) for truth in truths] == [
        *((stop, tx) for stop in range(3) for tx in (0, 1, 2)), (3, 3), (3, 4)
    ]  # fmt: skip
    assert [set(one.tx) for one in results.channel] == [{0, 1, 2}] * 3 + [{3, 4}]
    for one in (results.mapping, results.slam):
        assert set(one.ips.tx[one.ips.stop == 3]) == {3, 4} and set(one.ips.tx[one.ips.stop < 3]) == {0, 1, 2}
    poses = results.slam.poses
    assert poses.status.tolist()[3] == SolveStatus.GIVEN and (poses.status[:3] != SolveStatus.GIVEN).all()
    assert np.isfinite(poses.tx_clock_bias_s[:3, :3]).all() and poses.tx_clock_bias_s[3, 3] == 0
    given = results.mapping.ips.take("ip", results.mapping.ips.stop == 3)
    kept = results.slam.ips.take("ip", results.slam.ips.stop == 3)
    np.testing.assert_array_equal(given.position_m, kept.position_m)
    table = store.score_tables()
    assert table is not None and len(table.poses.stop) == 4
    found = recomputed_campaign(out, 0.4, 0)
    assert {each.difference for each in found} == {0.0} and not any(each.reason for each in found)
    page = (out / "report.html").read_text()
    assert "TX south_west-south_west" in page and (out / "figures" / "by_tx.png").is_file()
    for command in (
        ("view", "--no-open"),
        ("export", "--format", "glb", "--stop", "3"),
        ("export", "--format", "tum"),
    ):
        done = CliRunner().invoke(app, [command[0], str(out), *command[1:]])
        assert done.exit_code == 0, done.output
    refused = CliRunner().invoke(app, ["export", str(out), "--format", "mat"])
    assert "links: arena export --format mat takes TX and a walk" in str(refused.exception)


def test_a_node_that_sees_nothing_leaves_the_contours_of_the_others() -> None:
    loaded, places = draw_arena(np.random.default_rng([2, 1, 32]), 3, 1)
    scene = replace(loaded.scene, other_txs={one.name: one.pose for one in places})
    run = linked_run(loaded.config, scene, [(one.name, one.name) for one in places])
    truths = list(run.truths())
    channel = list(run.channel(truths))
    channel[2] = empty_estimate(channel[2].stop, "auto", EstimateStatus.NO_PATHS, "nothing exceeds the noise")
    found = run.maps(channel, run.surveyed_receiver(truths))["mapping"].contours
    assert np.isfinite(found.aod_offset_rad).tolist() == [True, True, False]


def test_nodes_alone_are_not_asked_for_their_poses() -> None:
    run = load_campaign("monostatic", **SMALL).chain()
    scores = run.scores()
    with pytest.raises(ValueError, match=r"links: arena link takes TX and a walk, name them by tx and walk"):
        refuse_several_tx(run.config, run.scene, "arena link")
    assert scores.value("slam.stops") == 0 and np.isnan(scores.value("slam.position.rmse_m"))
    assert scores.value("mapping.ip_to_surface.median_m") < 0.1
    for name in ("ip_to_surface.median_m", "objects_found"):
        assert scores.value(f"slam.{name}") == scores.value(f"mapping.{name}")


def test_some_stops_of_a_campaign_with_links_have_maps_too() -> None:
    run = mixed().chain([0])  # the last links have no stop
    truths = list(run.truths())
    assert len({truth.tx for truth in truths}) < len(run.links)
    assert run.surveyed_receiver(truths).tx_clock_bias_s.shape == (1, len(run.links))
    assert np.isfinite(run.scores().value("mapping.ip_to_surface.median_m"))

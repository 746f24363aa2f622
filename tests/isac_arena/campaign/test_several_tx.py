"""A campaign with two TX from the scene to the report: files, records, scores and what the report says of each."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

from isac_arena.campaign.campaign import Campaign, load_campaign
from isac_arena.campaign.stages import reopen, run_campaign
from isac_arena.campaign.stored import stored_results, stored_truths
from isac_arena.cli.main import app
from isac_arena.exchange.mat import read_layout
from isac_arena.user_functions.config import with_functions
from isac_arena.verification.campaign import recomputed_campaign
from sim.propagation.deepmimo.folder import read_deepmimo

pytestmark = pytest.mark.whole  # whole commands: `.ci/run` runs them after the quick tests

NAMES = ("south_west", "north_east")


@pytest.fixture(scope="module")
def loaded() -> Campaign:
    return load_campaign(
        "pillar_hall_two",
        **{
            "tx_array.beams_per_panel": 16,
            "rx_array.beams_per_panel": 12,
            "waveform.n_rb": 132,
            "propagation": {"diffuse_samples": 0, "max_bounces": 1, "diffraction": False},
            "channel.method": "power",
            "scene.walks.aisle.n_stops": 4,
        },
    )


def test_a_campaign_of_two_tx(loaded: Campaign, tmp_path: Path) -> None:
    out = tmp_path / "two"
    assert run_campaign(loaded, out, keep_sweeps=True) == []
    for folder in ("truth", "sweep", "channel"):
        names = sorted(file.name for file in (out / folder).glob("*.nc"))
        assert names == sorted(f"stop_{stop:03d}_{name}.nc" for stop in range(4) for name in NAMES)
    store = reopen(out)
    truths, results = list(stored_truths(store, 4)), stored_results(store, 4)
    assert [(truth.stop, truth.tx) for truth in truths] == [(stop, tx) for stop in range(4) for tx in range(2)]
    assert all(set(one.tx) == {0, 1} for one in results.channel)
    memory = list(loaded.chain().channel(truths))
    for one, other in zip(results.channel, memory, strict=True):
        np.testing.assert_array_equal(one.plane_parameters, other.plane_parameters)
    clock_s = np.array([truth.clock_bias_s for truth in truths]).reshape(4, 2)
    np.testing.assert_allclose(results.mapping.poses.tx_clock_bias_s, clock_s)
    assert set(results.mapping.ips.tx) == {0, 1}
    page = (out / "report.html").read_text()
    assert all(f"TX {name}" in page and "significant paths detected" in page for name in NAMES)
    assert (out / "figures" / "by_tx.png").is_file()
    found = recomputed_campaign(out, 0.25, 0)
    assert {each.difference for each in found} == {0.0} and not any(each.reason for each in found)
    table = store.score_tables()
    assert table is not None and set(table.paths.tx) == {0, 1} and len(table.poses.stop) == 4
    for file_format in ("mat", "deepmimo", "glb", "geojson"):
        done = CliRunner().invoke(app, ["export", str(out), "--format", file_format])
        assert done.exit_code == 0, done.output
    scene = loaded.scene
    for tx, name in enumerate(NAMES):
        measured = read_layout(out / "export" / f"pillar_hall_two_{name}.mat", scene.txs[name])
        np.testing.assert_allclose(measured.tx.position_m[:2], scene.txs[name].position_m[:2])
        for estimate, one in zip(results.channel, measured.stops, strict=True):
            np.testing.assert_allclose(one.power_dbm, estimate.power_dbm[estimate.tx == tx])
        scenario = read_deepmimo(out / "export" / f"pillar_hall_two_{name}")
        np.testing.assert_allclose(scenario.tx_position_m, scene.txs[name].position_m)
    rays = trimesh.load_scene(out / "export" / "stop_000.glb").geometry
    assert {f"{name} line of sight 1" for name in NAMES} <= set(rays)
    done = CliRunner().invoke(app, ["view", str(out), "--no-open"])
    assert done.exit_code == 0, done.output
    assert f'"text":["{NAMES[0]}","{NAMES[1]}"]' in (out / "view.html").read_text()


def test_functions_that_know_one_tx_are_refused(loaded: Campaign) -> None:
    own = Campaign(with_functions(loaded.config, {"slam": "my:own"}), loaded.scene, loaded.source)
    with pytest.raises(ValueError, match=r"functions.slam: takes the paths of one TX"):
        _ = own.chain().links

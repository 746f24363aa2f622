"""`arena validate heights`: its campaigns are what the README tells users to write, and its rows can fail."""

import tomllib
from pathlib import Path

import numpy as np

import isac_arena as ia
from isac_arena.validation.chain.statistics import ChainStops
from isac_arena.validation.heights import ELEVATED, LEVEL, HeightsRun, heights_rows

README = Path(__file__).resolve().parents[3] / "README.md"


def test_the_elevations_are_those_of_the_readme():
    blocks = [part.partition("```")[0] for part in README.read_text(encoding="utf-8").split("```toml\n")[1:]]
    (block,) = (tomllib.loads(block) for block in blocks if "beam_elevation_deg" in block)
    level = ia.load_campaign(
        LEVEL, **{f"{table}.{name}": v for table in block for name, v in block[table].items()}
    )
    elevated = ia.load_campaign(ELEVATED, **{"channel.method": level.config.channel.method})
    assert level.config.model_dump(exclude={"name"}) == elevated.config.model_dump(exclude={"name"})


def test_the_hall_has_unequal_heights_meshes_and_a_floor_plan():
    scene = ia.load_campaign(LEVEL).scene
    assert scene.tx.position_m[2] == 2.6 and {stop.position_m[2] for stop in scene.stops} == {1.2}
    assert [mesh.name for mesh in scene.clutter] == ["drum", "cart"]
    assert sum(item.material.name == "glass" for item in scene.objects) == 2


def test_rows_are_those_of_the_stops_and_of_failed_runs():
    def stops(error_m):
        some = np.asarray(error_m, float)
        solved = np.isfinite(some)
        return ChainStops(some, 0 * some + 1e-3, 0 * some + 0.1, some, solved, solved, ~solved)

    runs = [
        HeightsRun(LEVEL, "power", stops([0.03, 0.04])),
        HeightsRun(LEVEL, "auto", stops([0.06, np.nan])),
        HeightsRun(ELEVATED, "auto", None, "no mesh"),
    ]
    rows = {row.key: row for row in heights_rows(runs)}
    assert rows["heights.workshop.power.position.rmse_m"].value == np.sqrt((0.03**2 + 0.04**2) / 2)
    met = {key: row.met for key, row in rows.items()}
    assert met == {
        "heights.failed_runs": False,
        "heights.workshop.power.solved": True,
        "heights.workshop.power.position.rmse_m": True,
        "heights.workshop.auto.solved": False,
        "heights.workshop.auto.position.rmse_m": False,
    }
    assert "workshop_elevations with auto: no mesh" in rows["heights.failed_runs"].reason

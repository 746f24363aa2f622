"""The plan of a run tells what is doubtful and refuses what cannot work, before the first stop."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import isac_arena as ia
from isac_arena.campaign.plan import LEAST_BIAS_M, plan_run
from isac_arena.campaign.summary import TraceCounts
from isac_arena.user_functions.config import with_functions
from tests.command_line import failure

ROOM = tomllib.loads((Path(__file__).resolve().parents[3] / "scenes/library/box_room.toml").read_text())
FEW = {"n_rb": 24, "comb": 12}


def doubts(scene: dict[str, Any] | None = None, **changes: Any) -> list[str]:
    campaign = ia.load_campaign("box_room", scene=scene, **changes)
    return list(plan_run(campaign.config, campaign.scene, campaign.link).doubts)


def test_equal_heights_are_told_nothing_about() -> None:
    told = doubts()
    assert len(told) == 2 and "from box: at most an edge" in told[0]  # 1.2 m high, under the beams at 1.5 m
    assert told[1].startswith("4 stops of a walk hardly check one another") and "more stops" in told[1]
    told = doubts(contours={"min_samples": 5})
    assert "4 stops: an object reflects to each stop once, and clusters need 5 close points" in told[2]
    assert (
        "mine:follow (functions.tracker) is not called"
        in doubts(**{"functions.tracker.function": "mine:follow"})[0]
    )


def test_unequal_heights_with_horizontal_beams() -> None:
    tx = {"position_m": [1.5, 4.0, 2.6], "heading_deg": 0.0}
    high = {**ROOM, "tx": tx, "walk": {**ROOM["walk"], "height_m": 1.2}}
    told = doubts(high, heights={"use": False})
    distance_m = np.linalg.norm(np.linspace([4.0, 2.0], [8.5, 2.0], 4) - [1.5, 4.0], axis=1)
    excess_m = np.median(np.hypot(distance_m, 1.4) - distance_m)
    assert excess_m > LEAST_BIAS_M and f"about {excess_m:.2g} m off" in told[0] and "1.4 m in height" in told[0]
    assert "heights.use = false" in told[0]
    assert "above or below the line of sight of stop 0, 1: it arrives up to 36 dB too weak" in told[1]
    told = doubts(high)
    assert "above or below the line of sight" in told[0] and "m off" not in told[0]
    assert "slam.method = 'reference'" in doubts(high, slam={"method": "reference"})[0]
    own = ia.load_campaign("box_room", scene=high)
    guessed = with_functions(own.config, {"channel": "mine:guess"})
    assert "used only where mine:guess gives cone angles" in plan_run(guessed, own.scene, own.link).doubts[0]
    near = {**ROOM, "tx": {**tx, "position_m": [1.5, 4.0, 1.8]}, "walk": {**ROOM["walk"], "height_m": 1.2}}
    assert not any("above or below" in line for line in doubts(near))
    beams = {"beam_elevation_deg": [-10.0, 10.0]}
    told = doubts({**ROOM, "tx": tx}, tx_array=beams, channel={"method": "coherent"})
    assert not any("height" in line for line in told)


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        (
            {"scale": 300.0, "position_m": [60.0, 0.0, 0.0]},
            "mesh cart is 90 m large, all else 10.3 m: scale = 300 is",
        ),
        ({"position_m": [40.0, 2.0, 0.0]}, "mesh cart lies outside of all else"),
        ({"position_m": [5.1, 5.5, 0.3]}, "mesh cart overlaps pillar: move one of them"),
        ({"position_m": [10.0, 2.0, 0.3]}, "mesh cart overlaps wall_east: move one of them"),
        ({"position_m": [4.0, 3.0, 0.3]}, None),
        (
            {"scale": 0.004},
            "mesh cart is 1.6 mm large, too small for an echo: scale = 0.004 is given; a file in metres",
        ),
    ],
)
def test_meshes_in_another_unit_or_elsewhere_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: dict[str, Any], wanted: str | None
) -> None:
    monkeypatch.chdir(tmp_path)
    trimesh.creation.box((0.3, 0.2, 0.4)).export("cart.stl")
    mesh = {"name": "cart", "file": "cart.stl", "material": "metal"} | change
    told = [one for one in doubts({**ROOM, "meshes": [mesh]}) if "mesh cart " in one and "facet" not in one]
    assert [one[: len(wanted or "")] for one in told] == ([wanted] if wanted else [])


def test_a_mesh_of_millimetres_without_a_scale_is_told_what_to_give(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    trimesh.creation.box((0.0012, 0.0005, 0.001)).export("cart.stl")
    mesh = {"name": "cart", "file": "cart.stl", "material": "metal", "position_m": [4.0, 3.0, 0.3]}
    assert any(
        "mesh cart is 1.2 mm large, too small for an echo: scale = 1000 makes it 1.2 m" in one
        for one in doubts({**ROOM, "meshes": [mesh]})
    )


def test_lines_of_a_floor_plan_that_become_one_wall_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    plan = {"file": "walls.csv", "material": "metal", "z_max_m": 2.0}
    head, lines = "x0_m,y0_m,x1_m,y1_m\n", ["7,3,8,3\n", "8,3,9,3\n", "7,7,7,7.5\n"]
    for kept, wanted in ((lines, ("floor plan walls.csv: 3 lines make 2 walls",)), (lines[::2], ())):
        Path("walls.csv").write_text(head + "".join(kept))
        campaign = ia.load_campaign("box_room", scene={**ROOM, "floorplans": [plan]})
        found = plan_run(campaign.config, campaign.scene, campaign.link).notices
        assert tuple(one.split(",")[0] for one in found) == wanted


def test_places_in_another_unit_are_told() -> None:
    def told(**changes: Any) -> list[str]:
        return [one for one in doubts({**ROOM, **changes}) if "in metres" in one or "bounds_m" in one]

    assert not told()
    tall = [item | {"z_max_m": 5.5} if item["name"] == "pillar" else item for item in ROOM["objects"]]
    [high] = told(objects=tall)
    assert high.startswith("up to 2.5 m out of bounds_m, floor or ceiling: pillar; check their units")
    room = {name: value for name, value in ROOM.items() if name != "bounds_m"}
    far = {"type": "rectangle", "x_m": [0.0, 10000.0], "y_m": [-0.15, 0.0]}
    objects = [item | {"contour": far} if item["name"] == "wall_south" else item for item in room["objects"]]
    campaign = ia.load_campaign("box_room", scene={**room, "objects": objects})
    [long] = [one for one in plan_run(campaign.config, campaign.scene, campaign.link).doubts if "in metres" in one]
    assert long.startswith("TX and walk span 7.0 m, the objects 10000.1 m: are some in millimetres?")


def test_elevations_that_the_method_ignores_are_refused(tmp_path: Path) -> None:
    text = 'name = "x"\nscene = "box_room"\n[channel]\nmethod = "power"\n[rx_array]\n'
    for field in ("beam_elevation_deg = [-10.0, 10.0]", "panel_tilt_deg = [0.0, 20.0, 0.0, 0.0]"):
        (tmp_path / "x.toml").write_text(f"{text}{field}\n")
        message = failure("run", "x.toml", "--out", "out", cwd=tmp_path)
        assert "channel.method = 'power': estimates no elevation, but rx_array has beams at several" in message
        assert not (tmp_path / "out").exists()


def test_a_receiver_behind_the_beams_and_one_that_nothing_reaches() -> None:
    turned = {**ROOM["tx"], "heading_deg": 150.0}
    assert any(
        "the beams do not cover the line of sight of stop 0, 1, 2, 3" in line
        for line in doubts({**ROOM, "tx": turned})
    )
    cell = {"name": "cell", "kind": "wall", "material": "metal", "z_max_m": 3.0}
    corners = [[8.0, 1.5], [9.0, 1.5], [9.0, 2.5], [8.0, 2.5], [8.0, 1.5]]
    cell["contour"] = {"type": "polyline", "points_m": corners}
    planes = {name: {**ROOM[name]} for name in ("floor", "ceiling")}
    told = doubts({**ROOM, **planes, "objects": [*ROOM["objects"], cell]}, propagation={"max_bounces": 0})
    assert any("no line of sight and no single reflection reaches stop 3" in line for line in told)


def test_a_mesh_that_does_not_reflect_and_one_that_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    trimesh.creation.box((0.01, 1.0, 0.5)).export("board.ply")
    mesh = {"file": "board.ply", "material": "metal", "position_m": [9.0, 3.0, 1.5]}
    for tilt_deg, is_told in ((0.0, False), (40.0, True)):
        told = doubts({**ROOM, "meshes": [{**mesh, "rotation_deg": [0.0, tilt_deg, 0.0]}]})
        assert any("no flat facet of mesh board" in line for line in told) == is_told


def test_cells_coarser_than_objects_and_leaps() -> None:
    assert any(
        "m long, these are far smaller and look like points: pillar" in line for line in doubts(waveform=FEW)
    )
    drops = {"type": "drops", "n_stops": 12, "seed": 1, "height_m": 1.5}
    walk = {
        "type": "poses",
        "poses": [[2.5, 2.0, 1.5, 0.0], [2.6, 2.0, 1.5, 0.0], [2.7, 2.0, 1.5, 0.0], [9.0, 7.0, 1.5, 0.0]],
    }
    said = "the stops do not follow one another"
    assert any(said in line for line in doubts({**ROOM, "walk": walk}, trajectory={"method": "smooth"}))
    for alone in (drops, walk):
        assert not any(said in line for line in doubts({**ROOM, "walk": alone}))


def test_a_weak_line_of_sight_costs_the_power_method_more_than_the_default() -> None:
    tx = {"position_m": [1.5, 4.0, 2.6], "heading_deg": 0.0}
    high = {**ROOM, "tx": tx, "walk": {**ROOM["walk"], "height_m": 1.2}}
    assert "'auto' still places such stops to centimetres or better" in doubts(high)[0]
    assert "may be lost or decimetres off" in doubts(high, channel={"method": "power"})[0]


def test_paths_of_the_ray_tracer_alone_are_counted_in_good_english() -> None:
    one, two = (TraceCounts(n_compared=40 + n, n_extra=n).lines[0] for n in (1, 2))
    assert one.endswith("found them all; 1 path of these kinds that the ray tracer alone found is left out")
    assert two.endswith("2 paths of these kinds that the ray tracer alone found are left out")

"""Links of a campaign: who sends to whom, what is refused, paths the other way, leakage and echoes of a node."""

from dataclasses import replace

import numpy as np
import pytest

from scenes.config import load_scene
from scenes.contours.smooth import Circle
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.scene import Scene
from sim.clock import campaign_clock
from sim.config import LinkKind, PropagationConfig, SimulationConfig
from sim.links import panel_beside, tx_links, with_link_stops
from sim.propagation.paths import BounceKind
from sim.signal.hardware.apply_impairments import impaired_codebooks, with_surveyed_pose
from sim.signal.link import best_beam_power_dbm, make_link
from sim.simulate import clock_biases_s, observe, simulate_truth

SMALL = {"rows": 2, "columns": 4, "beams_per_panel": 6, "sector_deg": 140.0}
ALL_ROUND = {**SMALL, "panel_azimuth_deg": [-180.0, -90.0, 0.0, 90.0], "sector_deg": 90.0}


def room() -> Scene:
    scene = load_scene("box_room")
    return replace(scene, tx_name="a", other_txs={"b": Pose(np.array([8.0, 6.5, 1.5]), -2.4)})


def config_of(links: list[dict], **changes: object) -> SimulationConfig:
    return SimulationConfig.model_validate(
        {
            "scene": "-",
            "links": links,
            "waveform": {"n_rb": 24, "comb": 4},
            "tx_array": SMALL,
            "rx_array": ALL_ROUND,
            "propagation": PropagationConfig(diffuse_samples=0, max_bounces=2, diffraction=False),
            **changes,
        }
    )


def links_of(links: list[dict], scene: Scene | None = None, **changes: object) -> tuple:
    config = config_of(links, **changes)
    return tx_links(config, with_link_stops(config, scene or room()))


def truth_of(link, stop: int):
    return next(simulate_truth(link.config, link.scene, [stop]))


def test_downlinks_have_the_bits_of_a_campaign_that_names_its_tx() -> None:
    config = config_of([]).model_copy(update={"tx": ["a", "b"]})
    for plain, stated in zip(tx_links(config, room()), links_of([{"tx": ["a", "b"], "rx": "walk"}]), strict=True):
        assert stated.stops == plain.stops and stated.config.role == plain.config.role
        np.testing.assert_array_equal(clock_biases_s(stated.config, 4), clock_biases_s(plain.config, 4))
        one, other = (
            observe(each.config, make_link(each.config), each.scene, truth_of(each, 1)) for each in (plain, stated)
        )
        np.testing.assert_array_equal(one.samples, other.samples)


def test_an_uplink_is_its_downlink_the_other_way() -> None:
    """Equal gains and delays, ends exchanged; without noise the samples are the transposed ones."""
    hardware = {"element_gain_std_db": 0.5, "element_phase_std_deg": 5.0, "tx_pointing_offset_deg": 2.0}
    down, up = links_of([{"tx": "b", "rx": "walk"}, {"tx": "walk", "rx": "b"}], impairments=hardware)
    assert up.config.role.kind == LinkKind.UPLINK and up.scene.tx_name == "b"
    assert up.config.tx_array == down.config.rx_array and up.config.end_arrays == down.config.end_arrays
    there, back = truth_of(down, 2), truth_of(up, 2)
    np.testing.assert_array_equal(back.paths.aoa_azimuth_rad, there.paths.aod_azimuth_rad)
    np.testing.assert_array_equal(back.paths.gain, there.paths.gain)
    assert back.clock_bias_s == -there.clock_bias_s and back.stop_pose is not back.rx_pose
    double = np.flatnonzero(there.paths.n_interactions == 2)
    np.testing.assert_array_equal(back.paths.vertex_m[double, 0], there.paths.vertex_m[double, 1])
    assert (back.paths.bounce_kind[there.paths.is_los] == BounceKind.NONE).all()
    again = back.from_node
    for name in ("aod_azimuth_rad", "aoa_elevation_rad", "vertex_m", "bounce_object"):
        np.testing.assert_array_equal(getattr(again.paths, name), getattr(there.paths, name))
    built = [impaired_codebooks(each.config, make_link(each.config)) for each in (down, up)]
    for one, other in zip(
        built[0], built[1][::-1], strict=True
    ):  # a device has one array, whichever way it is used
        np.testing.assert_array_equal(one.weights, other.weights)
    quiet = {"noise_figure_db": 0.0, "tx_power_dbm": 60.0}
    down, up = links_of([{"tx": "b", "rx": "walk"}, {"tx": "walk", "rx": "b"}], impairments=hardware, link=quiet)
    no_bias = {"clock_bias_s": 0.0}
    sent, heard = (
        observe(each.config, make_link(each.config), each.scene, replace(truth_of(each, 2), **no_bias))
        for each in (down, up)
    )
    channel = sent.samples / sent.prs_symbol[:, None], heard.samples / heard.prs_symbol[:, None]
    same = np.abs(sent.frequency_offset_hz[:, None] - heard.frequency_offset_hz).argmin(axis=0)
    turned = channel[0].transpose(1, 0, 2)[..., same]
    assert np.abs(turned - channel[1]).max() < 0.05 * np.abs(turned).max()
    assert np.isnan(heard.tx_pose.position_m).all()
    survey = up.config.impairments.model_copy(update={"rx_placement_std_m": 0.1})
    surveyed = with_surveyed_pose(up.config.model_copy(update={"impairments": survey}), back)
    assert surveyed.rx_pose is back.rx_pose and (surveyed.stop_pose.position_m != back.stop_pose.position_m).any()


def test_nodes_have_stops_and_clocks_of_their_own() -> None:
    links = links_of([{"tx": "all", "rx": ["walk", "a", "b"]}])
    assert [link.name for link in links] == ["a-walk", "a-a", "a-b", "b-walk", "b-a", "b-b"]
    assert [link.stops for link in links] == [
        range(4),
        range(4, 5),
        range(5, 6),
        range(4),
        range(4, 5),
        range(5, 6),
    ]
    assert {link.config.waveform.re_offset for link in links if link.name[0] == "a"} == {0}  # one signal for all
    clock = {link.name: clock_biases_s(link.config, 6) for link in links}
    assert (clock["a-a"] == 0).all() and (clock["b-b"] == 0).all()
    np.testing.assert_array_equal(clock["a-b"], -clock["b-a"])
    np.testing.assert_allclose(clock["a-walk"] - clock["b-walk"], clock["a-b"])
    stops = links[0].scene.stops
    for row, name in ((4, "a"), (5, "b")):
        beside = panel_beside(links[0].scene.txs[name], (0.0, 0.2, 0.0))
        np.testing.assert_array_equal(stops[row].position_m, beside.position_m)
        assert np.linalg.norm(beside.position_m - links[0].scene.txs[name].position_m) == pytest.approx(0.2)


def test_leakage_has_the_stated_isolation() -> None:
    [link] = links_of([{"tx": "a", "rx": "a", "isolation_db": 55.0}])
    truth = truth_of(link, 0)
    los = truth.paths.take("path", truth.paths.is_los)
    power_dbm = best_beam_power_dbm(los, make_link(link.config), link.scene.tx, truth.rx_pose)
    assert truth.clock_bias_s == 0 and los.length_m == pytest.approx(0.2)
    assert power_dbm == pytest.approx(link.config.link.tx_power_dbm - 55.0)


def test_echoes_of_walls_and_round_pillars_are_those_of_the_closed_form() -> None:
    """A wall at h echoes from sqrt(4 h^2 + d^2) for panels d apart along it; a circle from its near point."""
    offset_m = 0.1
    [link] = links_of([{"tx": "a", "rx": "a", "panel_offset_m": [0.0, offset_m, 0.0]}])
    truth = truth_of(link, 0)
    paths, scene = truth.paths, link.scene
    single = paths.take("path", paths.is_single_bounce & (paths.bounce_kind[:, 0] == BounceKind.SPECULAR))
    length_m = dict(zip(single.object_name[single.bounce_object[:, 0]].tolist(), single.length_m, strict=True))
    x, y, z = scene.tx.position_m
    west_m, south_m = 2 * x, 2 * y + offset_m  # heading 0: the second panel is to the north
    assert length_m["wall_west"] == pytest.approx(np.hypot(west_m, offset_m), abs=1e-9)
    assert length_m["wall_south"] == pytest.approx(south_m, abs=1e-9)
    assert length_m["floor"] == pytest.approx(np.hypot(2 * z, offset_m), abs=1e-9)
    circle = scene.object("pillar").contour
    assert isinstance(circle, Circle)
    center, radius = np.array(circle.center_m), circle.radius_m
    turn = np.linspace(0, 2 * np.pi, 2_000_001)
    rim = center + radius * np.column_stack([np.cos(turn), np.sin(turn)])
    legs = np.linalg.norm(rim - [x, y], axis=1) + np.linalg.norm(rim - truth.rx_pose.position_m[:2], axis=1)
    assert length_m["pillar"] == pytest.approx(legs.min(), abs=1e-9)
    away = np.arctan2(center[1] - y, center[0] - x)
    pillar = np.flatnonzero(single.object_name[single.bounce_object[:, 0]] == "pillar")[0]
    turned = np.abs([single.aod_azimuth_rad[pillar] - away, single.aoa_azimuth_rad[pillar] - away])
    assert turned.max() < offset_m / (legs.min() / 2)
    assert paths.delay_s.min() * SPEED_OF_LIGHT_M_S == pytest.approx(offset_m)


def test_a_node_hears_itself_again_and_again_in_a_world_that_moves() -> None:
    """Sweeps of one place at their times: leakage stays, a mover has the Doppler shift of both its ways."""
    entry = {"tx": "tx", "rx": "tx", "n_sweeps": 3, "sweep_interval_s": 0.5}
    [link] = links_of([entry], load_scene("moving_target"))
    clock = campaign_clock(link.config, link.scene)
    np.testing.assert_allclose(np.diff(clock.middle_s), 0.5)
    assert link.stops == range(3) and np.ptp([pose.position_m for pose in link.scene.stops], axis=0).max() == 0
    first, last = truth_of(link, 0), truth_of(link, 2)
    for truth in (first, last):
        assert truth.motion is not None
        states = truth.motion.states
        level_dbm = best_beam_power_dbm(
            states.take("path", states.is_los), make_link(link.config), link.scene.tx, truth.rx_pose
        )
        assert level_dbm == pytest.approx(link.config.link.tx_power_dbm - link.config.role.isolation_db)
        assert (truth.paths.rates.doppler_hz[truth.paths.is_los] == 0).all()
    single = first.paths.take("path", first.paths.n_interactions == 1)
    names = single.object_name[single.bounce_object[:, 0]]
    person = np.flatnonzero(names == "person")[0]
    still = np.isin(names, ["wall_south", "wall_east", "pillar"])
    wavelength_m = SPEED_OF_LIGHT_M_S / 60e9
    state = link.scene.movers["person"].at(float(clock.middle_s[0]))
    toward = single.vertex_m[person, 0] - link.scene.tx.position_m
    speed_m_s = state.velocity_m_s @ toward / np.linalg.norm(toward)
    assert np.abs(single.rates.doppler_hz[still]).max() < 1e-6
    assert single.rates.doppler_hz[person] == pytest.approx(-2 * speed_m_s / wavelength_m, rel=0.1, abs=5)


@pytest.mark.parametrize(
    ("links", "changes", "message"),
    [
        ([{"tx": "a", "rx": "nobody"}], {}, r"links\[0\].rx = 'nobody': is neither a TX nor a walk"),
        ([{"tx": "walk", "rx": "walk"}], {}, r"links\[0\]: 'walk' hears itself, but its place is known to no one"),
        ([{"tx": "a", "rx": "walk"}, {"tx": "all", "rx": "walk"}], {}, r"'a' to 'walk' is given twice"),
        ([{"tx": "a", "rx": "walk"}], {"tx": "a"}, r"tx = 'a': links name what sends and receives, leave it out"),
        ([{"tx": "a", "rx": "walk"}], {"transmitters": {"b": {"turn": 1}}}, r"transmitters.b: is no TX"),
        ([{"tx": "walk", "rx": "a"}], {"transmitters": {"walk": {"array": SMALL}}}, r"array: 'walk' walks, its"),
        ([{"tx": "a", "rx": "a", "panel_offset_m": [0.0, 0.0, 0.0]}], {}, r"panel_offset_m: 0 m long"),
        ([{"tx": "a", "rx": "a", "panel_offset_m": [-0.95, 3.0, 0.0]}], {}, r"panel_offset_m: 3.15 m long"),
    ],
)  # fmt: skip
def test_bad_links_are_refused(links: list[dict], changes: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        links_of(links, **changes)


def test_a_moving_scene_has_no_uplink() -> None:
    with pytest.raises(ValueError, match=r"links = \['walk-tx'\]: a scene in which something moves has one TX"):
        links_of([{"tx": "walk", "rx": "tx"}], load_scene("moving_target"))

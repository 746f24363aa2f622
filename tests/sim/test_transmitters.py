"""Several TX: their resources, what is refused, and what is heard where resources meet."""

from dataclasses import replace

import numpy as np
import pytest

from scenes.config import load_scene
from scenes.pose import Pose
from scenes.scene import Scene
from sim.config import ArrayConfig, PropagationConfig, SimulationConfig, WaveformConfig
from sim.links import TxLink, tx_links
from sim.signal.crosstalk import meeting_beams, meeting_symbols
from sim.signal.link import make_link
from sim.signal.waveform.config import ScheduleConfig
from sim.simulate import OtherTx, clean_samples, clock_biases_s, observe, simulate_truth

SMALL = ArrayConfig(rows=1, columns=4, beams_per_panel=3)
WIDE = ArrayConfig(rows=1, columns=2, beams_per_panel=2, panel_azimuth_deg=[0.0, 180.0])
SAME = {"re_offset": 0, "turn": 0}


def room(**others: Pose) -> Scene:
    scene = load_scene("box_room")
    far = {"b": Pose(np.array([1.0, 1.0, 1.5]), 0.6), "c": Pose(np.array([7.0, 1.0, 1.5]), 2.5)}
    return replace(scene, tx_name="a", other_txs=far | others)


def config_of(tx: object = "all", own: dict | None = None, **waveform: object) -> SimulationConfig:
    return SimulationConfig.model_validate(
        {
            "scene": "-",
            "tx": tx,
            "transmitters": own or {},
            "waveform": WaveformConfig(n_rb=24, **waveform),
            "tx_array": SMALL,
            "rx_array": WIDE,
            "propagation": PropagationConfig(diffuse_samples=0, max_bounces=1),
        }
    )


def sweeps(links: tuple[TxLink[SimulationConfig], ...], stop: int = 0) -> list:
    """The sweep of every TX with the others on the air."""
    every = [
        OtherTx(one.config, make_link(one.config), one.scene, next(simulate_truth(one.config, one.scene, [stop])))
        for one in links
    ]
    return [
        observe(one.config, one.link, one.scene, one.truth, [other for other in every if other is not one])
        for one in every
    ]


def test_resources_are_orthogonal_until_they_are_given() -> None:
    links = tx_links(config_of(comb=2), room())
    assert [(one.config.waveform.re_offset, one.config.turn) for one in links] == [(0, 0), (1, 0), (0, 1)]
    assert [one.config.waveform.sequence_id for one in links] == [0, 3, 6]
    assert [one.scene.tx_name for one in links] == ["a", "b", "c"]
    own = {"b": {"tx_power_dbm": 20.0, "array": {"beams_per_panel": 5}, "sequence_id": 7, **SAME}}
    second = tx_links(config_of(own=own), room())[1].config
    assert (second.link.tx_power_dbm, second.waveform.sequence_id, second.waveform.re_offset) == (20.0, 7, 0)
    assert second.tx_array.beams_per_panel == 5 and second.tx_array.columns == SMALL.columns


def test_one_tx_keeps_its_settings_and_its_samples() -> None:
    config, scene = config_of("a"), room()
    [link] = tx_links(config, scene)
    assert link.config is config and link.scene is scene
    [alone], both = sweeps((link,)), sweeps(tx_links(config_of(["a", "b"]), scene))
    np.testing.assert_array_equal(alone.samples, both[0].samples)
    clock = [clock_biases_s(one.config, 4) for one in tx_links(config_of(["a", "b"]), scene)]
    np.testing.assert_array_equal(clock[0], clock_biases_s(config, 4))
    assert np.ptp(clock[1] - clock[0]) < 1e-15 and abs(clock[1][0] - clock[0][0]) > 1e-12


@pytest.mark.parametrize("combine", [False, True])
def test_tx_that_collide_are_heard_in_the_same_samples(combine: bool) -> None:
    """Both sweeps hold H_a x_a + H_b x_b + noise; a combining receiver divides by its own pilots first."""
    links = tx_links(config_of(["a", "b"], {"a": SAME, "b": SAME}, combine_symbols=combine), room())
    first, second = sweeps(links)
    if not combine:
        np.testing.assert_allclose(first.samples, second.samples, atol=1e-6 * np.abs(first.samples).max())
    [own] = sweeps(links[:1])
    truth = next(simulate_truth(links[1].config, links[1].scene, [0]))
    link = make_link(links[1].config)
    books = link.tx_codebook, link.rx_codebook
    channel = clean_samples(links[1].config, link, links[1].scene, truth, books, 0)
    added = np.abs(first.samples - own.samples)
    np.testing.assert_allclose(added, np.sqrt(link.tx_power_mw) * np.abs(channel), atol=1e-5 * added.max())


def test_muting_takes_turns() -> None:
    schedule = ScheduleConfig(period_slots=32)
    muted = {"a": {**SAME, "muting_1": [1, 0]}, "b": {**SAME, "muting_1": [0, 1]}}
    for own, heard in (({"a": SAME, "b": SAME}, True), (muted, False)):
        one, other = (each.config for each in tx_links(config_of(["a", "b"], own, schedule=schedule), room()))
        assert meeting_symbols(one, other) == [0]
        assert meeting_beams(one, other, 3, 3, 4).any() == heard
    later = {"a": SAME, "b": {**SAME, "turn": 1}}
    one, other = (each.config for each in tx_links(config_of(["a", "b"], later, schedule=schedule), room()))
    assert other.waveform.schedule.offset_slots == 3 and not meeting_beams(one, other, 3, 3, 4).any()
    apart = {"a": SAME, "b": {**SAME, "first_symbol": 4}}
    one, other = (each.config for each in tx_links(config_of(["a", "b"], apart), room()))
    assert meeting_symbols(one, other) == []


@pytest.mark.parametrize(
    ("tx", "own", "message"),
    [
        (["a", "x"], {}, "tx = 'x': must be one of a, b, c, or 'all'"),
        (["a", "a"], {}, "'a' is given twice"),
        ("a", {"b": {}}, "transmitters.b: is no TX of the campaign"),
        ("all", {"b": {"re_offset": 7}}, "transmitters.b.waveform: re_offset = 7"),
        ("all", {"b": {"muting_1": [1, 0]}}, "needs the slots of a"),
    ],
)
def test_what_makes_no_sense_is_refused(tx: object, own: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message) as raised:
        tx_links(config_of(tx, own), room())
    assert "\n" not in str(raised.value)


def test_several_tx_stand_still() -> None:
    scene = room()
    walking = replace(scene, walk=replace(scene.walk, speed_m_s=1.0))
    with pytest.raises(ValueError, match="something moves has one TX"):
        tx_links(config_of(), walking)

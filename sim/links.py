"""The links of a campaign: who sends, who receives, and the settings and the scene of each.

A link has a fixed node, a TX of the scene, at which its paths are anchored, and stops. Without `links` every TX
sends to the walk. With them a node or the walk sends, and the walk or nodes receive: stops are then those of the
walks, and one for every node that hears other nodes or itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np

from scenes.pose import Pose
from scenes.record import FloatArray
from scenes.scene import Scene
from scenes.toml_config import naming_field
from scenes.walks.trajectory import RecordedWalk
from sim.config import ArrayConfig, LinkKind, LinkRole, SimulationConfig, StatedLinks
from sim.transmitters import ALL, chosen_tx, own_resources

C = TypeVar("C", bound=SimulationConfig)
LEAST_OFFSET_M, MOST_OFFSET_M = 0.01, 1.0  # between the panels of a monostatic node


@dataclass(frozen=True)
class TxLink(Generic[C]):
    """One link of a campaign: settings with the power, arrays and resources of its ends, and its scene and stops.

    The active TX of the scene is the fixed node, whichever end sends.
    """

    name: str
    config: C
    scene: Scene
    stops: range


@dataclass(frozen=True)
class _Stated:
    """One sender and one receiver of the campaign file."""

    tx: str
    rx: str
    kind: LinkKind
    entry: StatedLinks

    @property
    def node(self) -> str:
        """The fixed node."""
        return self.rx if self.kind == LinkKind.UPLINK else self.tx

    @property
    def at_stops(self) -> str:
        """What is at the stops: a walk, or a node."""
        return self.tx if self.kind == LinkKind.UPLINK else self.rx

    @property
    def name(self) -> str:
        """Name of its files and of its line in the report."""
        return f"{self.tx}-{self.rx}"


def tx_links(config: C, scene: Scene) -> tuple[TxLink[C], ...]:
    """The links of a campaign: one per TX in the order of the settings, or those of `links`.

    A campaign with one TX has one link with these settings and this scene.

    Raises `ValueError` as `sim.transmitters.chosen_tx`; where `links` name what the scene does not have, or a
    link twice; where `transmitters` names what does not send; where resources do not fit the waveform; for
    several links in a scene that moves or with the paths of a DeepMIMO scenario.
    """
    stated = _stated_links(config, scene)
    if not stated:
        names = chosen_tx(config, scene)
        stated = [
            _Stated(name, scene.walk_name, LinkKind.DOWNLINK, StatedLinks(tx=name, rx="-")) for name in names
        ]
    senders = list(dict.fromkeys(link.tx for link in stated))
    unused = sorted(set(config.transmitters) - set(senders))
    if unused:
        raise ValueError(f"transmitters.{unused[0]}: is no TX of the campaign, which has {', '.join(senders)}")
    if len(stated) == 1 and not config.transmitters and not config.links:
        return (TxLink(senders[0], config, scene, range(len(scene.stops))),)
    _refuse_in_some_scenes(config, scene, stated)
    resources = _resources(config, scene, senders)
    nodes = list(
        dict.fromkeys(node for link in stated for node in (link.node, link.at_stops) if node in scene.txs)
    )
    places = _places(scene, stated) if config.links else {scene.walk_name: range(len(scene.stops))}
    links: list[TxLink[C]] = []
    for number, link in enumerate(stated):
        turn, changes = resources[link.tx]
        role = LinkRole(
            number,
            turn,
            node=nodes.index(link.node),
            sender=senders.index(link.tx),
            receiver=None if link.kind.has_walk else nodes.index(link.rx),
            kind=link.kind,
            isolation_db=link.entry.isolation_db,
        )
        arrays = {"tx_array": _array(config, scene, link.tx), "rx_array": _array(config, scene, link.rx)}
        own = config.of_link(role, tx=link.node, **arrays, **changes)
        name = link.name if config.links else link.tx
        links.append(TxLink(name, own, scene.choose(link.node, scene.walk_name), places[link.at_stops]))
    return tuple(links)


def link_stops(config: SimulationConfig, scene: Scene) -> dict[str, range]:
    """The stops of every link of a campaign by its name; without `links` of every TX."""
    stated = _stated_links(config, scene)
    if not stated:
        return dict.fromkeys(chosen_tx(config, scene), range(len(scene.stops)))
    places = _places(scene, stated)
    return {link.name: places[link.at_stops] for link in stated}


def link_nodes(config: SimulationConfig, scene: Scene) -> dict[str, str]:
    """The fixed node of every link of a campaign by its name; without `links` each TX by its own."""
    stated = _stated_links(config, scene)
    return {link.name: link.node for link in stated} or {name: name for name in chosen_tx(config, scene)}


def uplink_names(config: SimulationConfig, scene: Scene) -> set[str]:
    """Names of the links whose fixed node receives what a walk sends."""
    return {link.name for link in _stated_links(config, scene) if link.kind == LinkKind.UPLINK}


def with_link_stops(config: SimulationConfig, scene: Scene) -> Scene:
    """The scene with the stops of `links` as its walk, and their first fixed node as its TX.

    Raises `ValueError` as `tx_links` does, and where the receiving panel of a node is not free.
    """
    stated = _stated_links(config, scene)
    if not stated:
        return scene
    places = _places(scene, stated)
    place = list(places)
    chosen = scene.choose(stated[0].node)
    if len(place) == 1 and place[0] in scene.walks:
        return chosen.choose(walk=place[0])
    parts = [_poses(scene, stated, name, len(stops)) for name, stops in places.items()]
    rates = [(walk.speed_m_s, walk.stop_interval_s) for name in place if (walk := scene.walks.get(name))]
    if any(any(rate) for rate in rates):
        raise ValueError(
            f"links: walk '{place[0]}' has speed_m_s or stop_interval_s, its links must be all there are"
        )
    walks = {name: scene.walks[name] for name in place if name in scene.walks}
    joined = RecordedWalk(
        np.concatenate([one[0] for one in parts]),
        np.concatenate([one[1] for one in parts]),
        stop_interval_s=max(link.entry.sweep_interval_s for link in stated),
    )
    with naming_field("links", ": "):
        return replace(chosen, walk=joined, walk_name=f"stops of {', '.join(place)}", other_walks=walks)


def _stated_links(config: SimulationConfig, scene: Scene) -> list[_Stated]:
    """Every sender with every receiver of `links`, in order."""
    found: list[_Stated] = []
    for number, entry in enumerate(config.links):
        where = f"links[{number}]"
        for tx in _named(f"{where}.tx", entry.tx, scene):
            for rx in _named(f"{where}.rx", entry.rx, scene):
                link = _Stated(tx, rx, _kind(where, tx, rx, scene), entry)
                if link.name in [one.name for one in found]:
                    raise ValueError(f"{where}: '{tx}' to '{rx}' is given twice, every link once is allowed")
                found.append(link)
        offset_m = float(np.linalg.norm(entry.panel_offset_m))
        if not LEAST_OFFSET_M <= offset_m <= MOST_OFFSET_M:
            allowed = f"must be within {LEAST_OFFSET_M:g} to {MOST_OFFSET_M:g} m"
            raise ValueError(f"{where}.panel_offset_m: {offset_m:.3g} m long, {allowed}")
    return found


def _named(field: str, names: str | list[str], scene: Scene) -> Sequence[str]:
    if names == ALL and ALL not in (*scene.txs, *scene.walks):
        return sorted(scene.txs)
    every = [names] if isinstance(names, str) else names
    for name in every:
        if (name in scene.txs) == (name in scene.walks):
            which = "is a TX and a walk" if name in scene.txs else "is neither a TX nor a walk"
            known = f"TX {', '.join(scene.txs)}; walks {', '.join(scene.walks)}; or '{ALL}' TX"
            raise ValueError(f"{field} = '{name}': {which} of the scene, which has {known}")
    return every


def _kind(where: str, tx: str, rx: str, scene: Scene) -> LinkKind:
    if tx in scene.walks and rx in scene.walks:
        what = "hears itself, but its place is known to no one" if tx == rx else f"sends to '{rx}', and both walk"
        raise ValueError(f"{where}: '{tx}' {what}; one end must be a TX of the scene: {', '.join(scene.txs)}")
    if tx == rx:
        return LinkKind.MONOSTATIC
    if tx in scene.walks:
        return LinkKind.UPLINK
    return LinkKind.DOWNLINK if rx in scene.walks else LinkKind.NODES


def _places(scene: Scene, stated: Sequence[_Stated]) -> dict[str, range]:
    """The stops of every walk, then of every node that receives from nodes."""
    names = dict.fromkeys(link.at_stops for link in stated)
    found: dict[str, range] = {}
    start = 0
    for name in sorted(names, key=lambda one: one in scene.txs):
        entries = [link.entry for link in stated if link.at_stops == name]
        count = max(one.n_sweeps for one in entries)
        if name in scene.walks:
            count = len(scene.walks[name].positions_m())
        found[name] = range(start, start + count)
        start += count
    return found


def _poses(scene: Scene, stated: Sequence[_Stated], name: str, count: int) -> tuple[FloatArray, FloatArray]:
    """Positions (stop, xyz) and headings (stop,) of a walk, or of the receiving panel of a node, `count` times."""
    if name in scene.walks:
        walk = scene.walks[name]
        return walk.positions_m(), walk.headings_rad()
    own = [link.entry for link in stated if link.kind == LinkKind.MONOSTATIC and link.rx == name]
    pose = panel_beside(scene.txs[name], own[0].panel_offset_m) if own else scene.txs[name]
    return np.tile(pose.position_m, (count, 1)), np.full(count, pose.heading_rad)


def panel_beside(pose: Pose, offset_m: Sequence[float]) -> Pose:
    """The pose of a panel at an offset (x ahead, y to the left, z up) from another of the same device."""
    x, y, z = offset_m
    cos, sin = np.cos(pose.heading_rad), np.sin(pose.heading_rad)
    return Pose(pose.position_m + np.array([cos * x - sin * y, sin * x + cos * y, z]), pose.heading_rad)


def _array(config: SimulationConfig, scene: Scene, device: str) -> ArrayConfig:
    """The array of a device: of a walk `rx_array`, of a node its own or `tx_array`."""
    own = config.transmitters.get(device)
    own_array = None if own is None else own.array
    if device not in scene.txs:
        if own_array is not None:
            raise ValueError(f"array: '{device}' walks, its array is rx_array, leave it out")
        return config.rx_array
    return own_array or config.tx_array


def _resources(
    config: SimulationConfig, scene: Scene, senders: Sequence[str]
) -> dict[str, tuple[int, dict[str, Any]]]:
    """Turn and settings of every sender; what is not given is orthogonal to those before."""
    found: dict[str, tuple[int, dict[str, Any]]] = {}
    sequence = config.waveform.sequence_id
    for number, name in enumerate(senders):
        with naming_field(f"transmitters.{name}"):
            turn, changes, n_beams = own_resources(config, name, _array(config, scene, name), number, sequence)
        sequence = (changes["waveform"].sequence_id + n_beams) % 4096
        found[name] = turn, changes
    return found


def _refuse_in_some_scenes(config: SimulationConfig, scene: Scene, stated: Sequence[_Stated]) -> None:
    if len(stated) == 1 and stated[0].kind == LinkKind.DOWNLINK:
        return
    field = "links" if config.links else "tx"
    names = [link.name if config.links else link.tx for link in stated]
    is_one = len(stated) == 1 and stated[0].kind == LinkKind.MONOSTATIC
    if scene.is_moving and not is_one:
        raise ValueError(f"{field} = {names}: a scene in which something moves has one TX")
    if config.propagation.deepmimo is not None:
        raise ValueError(f"{field} = {names}: a DeepMIMO scenario (propagation.deepmimo) has one TX")

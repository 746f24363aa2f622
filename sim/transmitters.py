"""The TX of a campaign: each has settings of its own, its PRS resources, and a link to the receiver."""

from collections import Counter
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from scenes.scene import Scene
from scenes.toml_config import naming_field, validate_config
from sim.config import SimulationConfig, TransmitterConfig, WaveformConfig
from sim.signal.link import make_codebook
from sim.signal.waveform.occasions import resource_span, sweep_occasions

ALL = "all"
C = TypeVar("C", bound=SimulationConfig)


@dataclass(frozen=True)
class TxLink(Generic[C]):
    """One TX of a campaign: the settings with its power, array and resources, and the scene with it in use."""

    name: str
    config: C
    scene: Scene


def chosen_tx(config: SimulationConfig, scene: Scene) -> tuple[str, ...]:
    """Names of the TX that a campaign uses: all of the scene for 'all', the active one where none is named.

    Raises `ValueError` where the scene has no TX of that name, or one is named twice.
    """
    if config.tx == ALL and ALL not in scene.txs:
        return tuple(scene.txs)
    names = [config.tx or scene.tx_name] if not isinstance(config.tx, list) else config.tx
    unknown = [name for name in names if name not in scene.txs]
    if unknown:
        raise ValueError(f"tx = '{unknown[0]}': must be one of {', '.join(scene.txs)}, or '{ALL}'")
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise ValueError(f"tx = {names}: '{twice[0]}' is given twice, every TX once is allowed")
    return tuple(names)


def refuse_several_tx(config: SimulationConfig, scene: Scene, what: str) -> None:
    """`ValueError` where a campaign has several TX and `what`, such as a command, knows only one."""
    names = chosen_tx(config, scene)
    if len(names) > 1:
        raise ValueError(f"tx = {list(names)}: {what} takes one TX, name one of them")


def first_tx(config: SimulationConfig) -> str | None:
    """The first TX that settings name, None for the first of the scene."""
    return config.tx[0] if isinstance(config.tx, list) else config.tx


def tx_links(config: C, scene: Scene) -> tuple[TxLink[C], ...]:
    """The links of a campaign, one per TX in the order of the settings.

    A campaign with one TX has one link with these settings and this scene.

    Raises `ValueError` as `chosen_tx`; where `transmitters` names a TX that is not used; where resources do not
    fit the waveform; and for several TX in a scene that moves or with the paths of a DeepMIMO scenario.
    """
    names = chosen_tx(config, scene)
    unused = sorted(set(config.transmitters) - set(names))
    if unused:
        raise ValueError(f"transmitters.{unused[0]}: is no TX of the campaign, which has {', '.join(names)}")
    if len(names) == 1 and not config.transmitters:
        return (TxLink(names[0], config, scene),)
    if len(names) > 1 and scene.is_moving:
        raise ValueError(f"tx = {list(names)}: a scene in which something moves has one TX")
    if len(names) > 1 and config.propagation.deepmimo is not None:
        raise ValueError(f"tx = {list(names)}: a DeepMIMO scenario (propagation.deepmimo) has one TX")
    links: list[TxLink[C]] = []
    sequence = config.waveform.sequence_id
    for number, name in enumerate(names):
        with naming_field(f"transmitters.{name}"):
            own, n_beams = _of_tx(config, name, number, sequence)
        sequence = (own.waveform.sequence_id + n_beams) % 4096
        links.append(TxLink(name, own, scene.choose(name, scene.walk_name)))
    return tuple(links)


def _of_tx(config: C, name: str, number: int, sequence: int) -> tuple[C, int]:
    """Settings and number of beams of one TX; a resource that is not given is orthogonal to those before."""
    own = config.transmitters.get(name, TransmitterConfig())
    waveform = config.waveform
    array = own.array or config.tx_array
    n_beams = len(make_codebook(array, waveform.carrier_ghz * 1e9))
    turn = number // waveform.comb if own.turn is None else own.turn
    changes: dict[str, Any] = {
        "sequence_id": sequence if own.sequence_id is None else own.sequence_id,
        "re_offset": (waveform.re_offset + number) % waveform.comb if own.re_offset is None else own.re_offset,
        "first_symbol": waveform.first_symbol if own.first_symbol is None else own.first_symbol,
    }
    muting = own.model_dump(include={"muting_1", "muting_2"}, exclude_none=True)
    if muting and waveform.schedule is None:
        raise ValueError(f"{next(iter(muting))}: needs the slots of a [waveform.schedule]")
    if waveform.schedule is not None:
        span = resource_span(waveform.schedule, n_beams)
        shifted = {"offset_slots": waveform.schedule.offset_slots + turn * span}
        schedule = waveform.schedule.model_dump() | muting | shifted
        changes["schedule"] = schedule
    waveform = validate_config(waveform.model_dump(exclude={"schedule"}) | changes, WaveformConfig, "waveform")
    sweep_occasions(waveform, n_beams, 1)
    power_dbm = config.link.tx_power_dbm if own.tx_power_dbm is None else own.tx_power_dbm
    link = config.link.model_copy(update={"tx_power_dbm": power_dbm})
    made = config.of_transmitter(number, turn, tx=name, tx_array=array, link=link, waveform=waveform)
    return made, n_beams

"""What sends in a campaign: which TX, and the PRS resources and the power of each."""

from collections import Counter
from typing import Any

from scenes.scene import Scene
from scenes.toml_config import validate_config
from sim.config import ArrayConfig, SimulationConfig, TransmitterConfig, WaveformConfig
from sim.signal.link import make_codebook
from sim.signal.waveform.occasions import resource_span, sweep_occasions

ALL = "all"


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
    refuse_links(config, what)
    names = chosen_tx(config, scene)
    if len(names) > 1:
        raise ValueError(f"tx = {list(names)}: {what} takes one TX, name one of them")


def refuse_links(config: SimulationConfig, what: str) -> None:
    """`ValueError` where a campaign states its links and `what`, such as a command, knows TX and a walk."""
    if config.links:
        raise ValueError(f"links: {what} takes TX and a walk, name them by tx and walk")


def first_tx(config: SimulationConfig) -> str | None:
    """The first TX that settings name, None for the first of the scene."""
    return config.tx[0] if isinstance(config.tx, list) else config.tx


def own_resources(
    config: SimulationConfig, name: str, array: ArrayConfig, number: int, sequence: int
) -> tuple[int, dict[str, Any], int]:
    """Turn, waveform and link settings, and number of beams of what sends `number`-th, with its array.

    A resource that is not given is orthogonal to those before. Raises `ValueError` where one does not fit.
    """
    own = config.transmitters.get(name, TransmitterConfig())
    waveform = config.waveform
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
    return turn, {"link": link, "waveform": waveform}, n_beams

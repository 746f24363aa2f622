"""`arena link`: the link budget of a campaign at each stop."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from isac_arena.cli.options import Campaign

if TYPE_CHECKING:
    from rich.table import Table

    from sim.config import SimulationConfig
    from sim.signal.link import Link
    from sim.signal.link_budget import LinkBudget


def link(campaign: Campaign) -> None:
    """Print the link budget of a campaign: received power of each stop, and noise levels."""
    from rich.console import Console  # noqa: PLC0415

    from isac_arena.campaign.campaign import load_campaign  # noqa: PLC0415
    from isac_arena.progress import tracked  # noqa: PLC0415
    from sim.signal.link_budget import converter_share, link_budget  # noqa: PLC0415
    from sim.simulate import simulate_truth  # noqa: PLC0415
    from sim.transmitters import refuse_several_tx  # noqa: PLC0415

    console = Console(highlight=False)
    loaded = load_campaign(campaign)
    config, scene = loaded.config, loaded.scene
    refuse_several_tx(config, scene, "arena link")
    propagation = config.propagation.model_copy(update={"diffuse_samples": 0})
    made, stops = loaded.link, range(len(scene.stops))
    traced = simulate_truth(config.model_copy(update={"propagation": propagation}), scene, stops)
    truths = tracked(console, traced, len(stops), "trace")
    budget = link_budget(truths, made, scene.tx, config.link, converter_share(config.waveform))
    for line in (*head(budget), sweep_line(config, made)):
        console.print(line)
    console.print(stop_table(budget))


def head(budget: LinkBudget) -> list[str]:
    """The lines that hold for every stop."""
    tx_power_dbm = budget.eirp_dbm - budget.tx_gain_dbi
    return [
        f"EIRP {budget.eirp_dbm:.1f} dBm: {tx_power_dbm:.1f} dBm, gain {budget.tx_gain_dbi:.1f} dBi;"
        f" RX gain {budget.rx_gain_dbi:.1f} dBi",
        f"noise per sample: thermal {budget.thermal_noise_dbm:.1f} dBm,"
        f" quantisation {budget.converter_noise_dbm:.1f} dBm (one gain for all stops, that of the strongest)",
        f"weakest path in a beam power map: {budget.weakest_dbm:.1f} dBm;"
        f" processing gain {budget.processing_gain_db:.1f} dB",
    ]


def sweep_line(config: SimulationConfig, link: Link) -> str:
    """Beam pairs, repetitions and air time of one sweep."""
    from sim.signal.waveform.occasions import sweep_occasions  # noqa: PLC0415

    n_tx, n_rx = len(link.tx_codebook), len(link.rx_codebook)
    occasions = sweep_occasions(config.waveform, n_tx, n_rx)
    combined = f", {occasions.repetitions} repetitions combined" if config.waveform.schedule else ""
    return f"sweep: {n_tx} x {n_rx} beam pairs{combined}, {1e3 * occasions.air_time_s:.1f} ms on the air"


def stop_table(budget: LinkBudget) -> Table:
    """One row per stop."""
    from rich.table import Table  # noqa: PLC0415

    heads = (
        "distance\nm",
        "LOS\ndBm",
        "bounce\ndBm",
        "noise\ndBm",
        "SNR\ndB",
        "dynamic\nrange dB",
        "side lobes\ndB",
    )
    table = Table(
        "stop", *heads, title="Link budget, best beam pairs",
        caption="bounce: strongest single one; SNR: strongest path, all subcarriers combined; dynamic range: LOS"
        " over the weakest path that shows in a beam power map; side lobes of the LOS: in one angle, in both",
    )  # fmt: skip
    for column in table.columns:
        column.justify = "right"
    columns = zip(
        budget.stop, budget.distance_m, budget.los_dbm, budget.single_bounce_dbm, budget.processed_snr_db,
        budget.dynamic_range_db, budget.cross_db, budget.off_cross_db, strict=True,
    )  # fmt: skip
    for stop, distance_m, los, bounce, snr, usable, cross, off_cross in columns:
        lobes = "-" if math.isnan(cross) else f"{cross:.1f}, {off_cross:.1f}"
        powers = _cell(los, "blocked"), _cell(bounce, "none"), f"{budget.thermal_noise_dbm:.1f}"
        ratios = _cell(snr, "none"), _cell(usable, "-"), lobes
        table.add_row(str(stop), f"{distance_m:.2f}", *powers, *ratios)
    return table


def _cell(value: float, otherwise: str) -> str:
    return f"{value:.1f}" if math.isfinite(value) else otherwise

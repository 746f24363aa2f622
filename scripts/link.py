"""`arena link`: the link budget of a campaign at each stop."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from scripts.campaign import Campaign

if TYPE_CHECKING:
    from rich.table import Table

    from sim.budget import LinkBudget


def link(campaign: Campaign) -> None:
    """Print the link budget of a campaign: what each stop receives, over which floors."""
    from rich.console import Console  # noqa: PLC0415
    from rich.progress import track  # noqa: PLC0415

    from scenes.config import load_scene  # noqa: PLC0415
    from scripts.campaign_file import load_campaign  # noqa: PLC0415
    from sim.budget import link_budget, occupied_share  # noqa: PLC0415
    from sim.campaign import simulate_truth  # noqa: PLC0415
    from sim.link import make_link  # noqa: PLC0415

    console = Console(highlight=False)
    config, scene_file = load_campaign(campaign)
    scene = load_scene(scene_file, config.waveform.carrier_ghz * 1e9)
    specular = config.model_copy(
        update={"propagation": config.propagation.model_copy(update={"diffuse_samples": 0})}
    )
    made = make_link(config)
    stops = range(len(scene.stops))
    truths = track(
        simulate_truth(specular, scene, stops), "trace", len(stops), console=console, transient=True
    )
    budget = link_budget(truths, made, scene.tx, config.link, occupied_share(config.waveform))
    for line in head(budget):
        console.print(line)
    console.print(stop_table(budget))


def head(budget: LinkBudget) -> list[str]:
    """What holds at every stop, a line each."""
    tx_power_dbm = budget.eirp_dbm - budget.tx_gain_dbi
    return [
        f"EIRP {budget.eirp_dbm:.1f} dBm: {tx_power_dbm:.1f} dBm, gain {budget.tx_gain_dbi:.1f} dBi;"
        f" RX gain {budget.rx_gain_dbi:.1f} dBi",
        f"noise per sample: thermal {budget.thermal_noise_dbm:.1f} dBm,"
        f" converter at fixed gain {budget.converter_noise_dbm:.1f} dBm",
        f"weakest path in a beam power map: {budget.weakest_dbm:.1f} dBm;"
        f" processing gain {budget.processing_gain_db:.1f} dB",
    ]


def stop_table(budget: LinkBudget) -> Table:
    """One row per stop."""
    from rich.table import Table  # noqa: PLC0415

    table = Table(
        "stop",
        "distance\nm",
        "LOS\ndBm",
        "bounce\ndBm",
        "noise\ndBm",
        "SNR\ndB",
        "range\ndB",
        "side lobes\ndB",
        title="Link budget, best beam pairs",
        caption="bounce: strongest single one; SNR: strongest path, all subcarriers combined; range: LOS over the"
        " weakest path in a beam power map; side lobes of the LOS: in one angle, in both",
    )
    for column in table.columns:
        column.justify = "right"
    columns = zip(
        budget.stop, budget.distance_m, budget.los_dbm, budget.single_bounce_dbm, budget.processed_snr_db,
        budget.dynamic_range_db, budget.cross_db, budget.off_cross_db, strict=True,
    )  # fmt: skip
    for stop, distance_m, los, bounce, snr, usable, cross, off_cross in columns:
        table.add_row(
            str(stop),
            f"{distance_m:.2f}",
            _cell(los, "blocked"),
            _cell(bounce, "none"),
            f"{budget.thermal_noise_dbm:.1f}",
            _cell(snr, "none"),
            _cell(usable, "-"),
            "-" if math.isnan(cross) else f"{cross:.1f}, {off_cross:.1f}",
        )
    return table


def _cell(value: float, otherwise: str) -> str:
    return f"{value:.1f}" if math.isfinite(value) else otherwise

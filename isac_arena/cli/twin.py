"""`arena twin`: the simulated paths of a measured hall beside the measured ones."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from isac_arena.cli.options import OutFolder

if TYPE_CHECKING:
    from rich.table import Table

    from isac_arena.campaign.directory import CampaignStore
    from isac_arena.campaign.measured import MeasuredCampaign
    from isac_arena.insight.twin.twin import Twin
    from isac_arena.scoring.metrics.metric import Metric
    from scenes.scene import Scene

COLUMNS = {
    "explained.wide": "wide\n%",
    "explained.narrow": "narrow\n%",
    "chance": "chance\n%",
    "delay.rms_ns": "delay\nns",
    "aod.rms_deg": "AoD\ndeg",
    "aoa.rms_deg": "AoA\ndeg",
    "power.pillar.median_db": "pillars\nmedian dB",
    "power.pillar.rms_db": "pillars\nrms dB",
    "power.single_bounce.rms_db": "all\nrms dB",
}


def twin(
    directory: Annotated[
        Path, typer.Argument(metavar="MEASURED_DIR", help="Measured campaign, made by 'arena import-paths'.")
    ],
    out: OutFolder,
) -> None:
    """Trace the scene of a measured campaign at its stops and report which measured paths that explains.

    Offsets of clock and headings come from lines of sight, calibrated gains from the other half of the stops.
    """
    from isac_arena.campaign import stages  # noqa: PLC0415

    store = stages.reopen(directory)
    if store.measured is None:
        raise ValueError(
            f"{directory}: holds a simulated campaign; a twin needs a measured one, made by 'arena import-paths'"
        )
    scene = store.scene
    campaign = _campaign(store, scene)
    made = _trace(campaign, scene, store.config.waveform.carrier_ghz * 1e9)
    metrics = _write(out, made, scene)
    stages.console.print(twin_table(made, metrics))
    stages.console.print(_sentence(made, metrics))
    stages.console.print(f"twin: {out / 'twin_map.png'}, twin_residuals.png, twin.json and twin_paths.csv")


def twin_table(made: Twin, metrics: tuple[Metric, ...]) -> Table:
    """A row per model of propagation, and one with what was calibrated on the other half of the stops."""
    from rich.box import SIMPLE  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415

    value = {metric.key: metric.value for metric in metrics}
    table = Table(
        "model", *COLUMNS.values(), title="Measured single bounces explained by simulated paths",
        caption="wide: 1.5 ns, 3 deg, 3 deg; narrow: 1 ns, 2 deg, 2 deg; one to one. Errors are rms"
        " within the wide gate. chance: by paths of far stops",
        box=SIMPLE, padding=0, show_edge=False,
    )  # fmt: skip
    for column in table.columns[1:]:
        column.justify, column.no_wrap = "right", True
    for name in made.models:
        for label, prefix in (
            (name.replace("_", " "), f"twin.{name}"),
            ("  calibrated", f"twin.{name}.calibrated"),
        ):
            cells = []
            for key, title in COLUMNS.items():
                number = value.get(f"{prefix}.{key}")
                scale = 100 if title.endswith("%") else 1
                cells.append("" if number is None else f"{scale * number:.{1 if scale == 100 else 2}f}")
            table.add_row(label, *cells)
    return table


def _campaign(store: CampaignStore, scene: Scene) -> MeasuredCampaign:
    from isac_arena.campaign import stored  # noqa: PLC0415
    from isac_arena.campaign.measured import MeasuredCampaign  # noqa: PLC0415

    n_stops = len(scene.stops)
    channel = tuple(estimate.channel for estimate in stored.channel_estimates(store, n_stops))
    return MeasuredCampaign(scene.tx, channel, tuple(stored.measured_truths(store, n_stops)))


def _trace(campaign: MeasuredCampaign, scene: Scene, carrier_hz: float) -> Twin:
    from isac_arena.campaign import stages  # noqa: PLC0415
    from isac_arena.insight.twin.twin import MODELS, make_twin, simulate_stops  # noqa: PLC0415
    from isac_arena.progress import tracked  # noqa: PLC0415

    simulated = {}
    for name, config in MODELS.items():
        stops = simulate_stops(scene, campaign, config, carrier_hz)
        title, n_stops = f"trace {name.replace('_', ' ')}", len(campaign.truths)
        simulated[name] = list(tracked(stages.console, stops, n_stops, title))
    return make_twin(campaign, scene, simulated)


def _write(out: Path, made: Twin, scene: Scene) -> tuple[Metric, ...]:
    """Write twin.json, twin_paths.csv and the two figures; the metrics."""
    from isac_arena.campaign.files import write_bytes, write_csv, write_json  # noqa: PLC0415
    from isac_arena.insight.twin.scores import object_residuals, twin_metrics  # noqa: PLC0415
    from isac_arena.report.figures.twin import twin_map_figure, twin_residual_figure  # noqa: PLC0415
    from isac_arena.report.style import png_bytes  # noqa: PLC0415
    from isac_arena.scoring.metrics.metric import to_json  # noqa: PLC0415

    metrics = twin_metrics(made, scene.kinds)
    content = {
        "metrics": to_json(metrics),
        "offsets": {spec.name: getattr(made.offsets, spec.name).tolist() for spec in fields(made.offsets)},
        "objects": {
            name: [row._asdict() for row in object_residuals(model.paths)] for name, model in made.models.items()
        },
    }
    write_json(out / "twin.json", _without_nan(content))
    write_csv(out / "twin_paths.csv", list(_path_rows(made)))
    last = list(made.models)[-1]
    write_bytes(out / "twin_map.png", png_bytes(twin_map_figure(scene, made, last)))
    write_bytes(out / "twin_residuals.png", png_bytes(twin_residual_figure(scene, made)))
    return metrics


def _path_rows(made: Twin) -> Iterator[dict[str, Any]]:
    """One row per model and measured path; unknown values are empty."""
    for name, model in made.models.items():
        for row in range(model.paths.size("path")):
            values: dict[str, Any] = {"model": name}
            for spec in fields(model.paths):
                value = getattr(model.paths, spec.name)[row].tolist()
                if spec.metadata["axes"] == ("path", "xy"):
                    stem = spec.name.removesuffix("_m")
                    values |= {f"{stem}_x_m": value[0], f"{stem}_y_m": value[1]}
                else:
                    values[spec.name] = value
            yield _without_nan(values)


def _without_nan(content: Any) -> Any:
    """The same with None for numbers that are not finite: JSON has none of them."""
    if isinstance(content, dict):
        return {key: _without_nan(value) for key, value in content.items()}
    if isinstance(content, list):
        return [_without_nan(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content


def _sentence(made: Twin, metrics: tuple[Metric, ...]) -> str:
    agreement = next(metric.value for metric in metrics if metric.key == "twin.los_agreement.stops")
    return f"line of sight: simulated and measured agree at {agreement:.0f} of {len(made.has_los)} stops"

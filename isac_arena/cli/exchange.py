"""`arena export`, `export-sigmf` and `import-...`: formats of other tools."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from isac_arena.cli.options import Directory, Out, with_clock


class ExportFormat(StrEnum):
    """File formats of a campaign."""

    mat = "mat"
    deepmimo = "deepmimo"
    tum = "tum"
    geojson = "geojson"
    glb = "glb"


@with_clock
def export(
    directory: Directory,
    file_format: Annotated[
        ExportFormat,
        typer.Option(
            "--format",
            help="mat: layout of the public measurement file; deepmimo: v4 scenario; tum: trajectories; "
            "geojson: contours; glb: scene with rays.",
        ),
    ],
    out: Annotated[Path | None, typer.Option(help="Folder to write to; DIRECTORY/export by default.")] = None,
    stop: Annotated[int, typer.Option(min=0, help="glb: the stop whose rays are drawn.")] = 0,
    max_paths: Annotated[
        int, typer.Option(min=1, help="deepmimo, glb: strongest paths of each stop that are kept.")
    ] = 25,
) -> None:
    """Write a campaign for MATLAB, DeepMIMO, trajectory tools, GIS tools or 3-D viewers.

    Of several TX mat and deepmimo write each by its name: NAME_TX.mat, a scenario NAME_TX.
    """
    from isac_arena.campaign import stages  # noqa: PLC0415
    from isac_arena.campaign.recording import recorded_additions  # noqa: PLC0415
    from isac_arena.exchange import formats as exchange  # noqa: PLC0415
    from sim.transmitters import refuse_links  # noqa: PLC0415

    store = stages.reopen(directory, reads=stages.SCORED)
    if file_format in (ExportFormat.mat, ExportFormat.deepmimo):
        refuse_links(store.config, f"arena export --format {file_format.value}")
    folder = out or directory / "export"
    with recorded_additions(directory):
        if file_format == ExportFormat.deepmimo:
            files = list(exchange.write_scenario(store, folder, max_paths))
        elif file_format == ExportFormat.glb:
            files = [exchange.write_glb(store, folder / f"stop_{stop:03d}.glb", stop, max_paths)]
        else:
            writers = {"mat": exchange.write_mat, "tum": exchange.write_tum, "geojson": exchange.write_geojson}
            files = list(writers[file_format.value](store, folder))
    for file in files:
        stages.console.print(f"{file_format.value}: {file}")


@with_clock
def export_sigmf(
    directory: Directory,
    stop: Annotated[int, typer.Option(min=0, help="Receiver stop.")],
    tx_beam: Annotated[int, typer.Option(min=0, help="TX beam.")],
    rx_beam: Annotated[int | None, typer.Option(min=0, help="RX beam; all of them by default.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder to write to; DIRECTORY/sigmf by default.")] = None,
) -> None:
    """Write the received samples of beam pairs as a SigMF recording, one annotated burst per pair."""
    from isac_arena.campaign import stages  # noqa: PLC0415
    from isac_arena.campaign.recording import recorded_additions  # noqa: PLC0415
    from isac_arena.campaign.shards import shard_name, stop_name  # noqa: PLC0415
    from isac_arena.exchange.sigmf_recording import write_sigmf  # noqa: PLC0415
    from sim.signal.link import make_link  # noqa: PLC0415
    from sim.signal.waveform.occasions import slot_of_beam  # noqa: PLC0415
    from sim.signal.waveform.ofdm import sample_rate_hz  # noqa: PLC0415
    from sim.signal.waveform.time_domain import received_samples  # noqa: PLC0415
    from sim.simulate import observe  # noqa: PLC0415
    from sim.transmitters import refuse_several_tx  # noqa: PLC0415

    names = (stop_name(stop), shard_name(stop))
    store = stages.reopen(directory, reads=[f"{kind}/{name}" for kind in stages.SAMPLES for name in names])
    refuse_several_tx(store.config, store.scene, "arena export-sigmf")
    sweep = store.sweep(stop)
    if sweep is None:
        scene, truth = store.scene, store.truth(stop)
        if truth is None:
            what = f"the truth of stop {stop} is missing or out of date"
            raise ValueError(f"{directory}: {what}; run 'arena generate'")
        sweep = observe(store.config, make_link(store.config), scene, truth)
    prs = store.config.waveform.prs
    slot = slot_of_beam(store.config.waveform, len(sweep.tx_codebook), tx_beam)
    beams = range(len(sweep.rx_codebook)) if rx_beam is None else [rx_beam]
    name = f"stop_{stop:03d}_tx_{tx_beam:03d}" + ("" if rx_beam is None else f"_rx_{rx_beam:03d}")
    with recorded_additions(directory):
        meta = write_sigmf(
            (out or directory / "sigmf") / name,
            [received_samples(sweep, prs, slot, tx_beam, beam) for beam in beams],
            [f"tx {tx_beam} rx {beam}" for beam in beams],
            sample_rate_hz=sample_rate_hz(prs.numerology),
            carrier_hz=sweep.carrier_hz,
            description=f"{store.config.name}, stop {stop}: PRS in sqrt(mW), one beam pair per capture",
        )
    stages.console.print(f"samples: {meta}")


Offset = Annotated[
    float, typer.Option(min=-180, max=180, help="Mounting offset added to the TX heading of the file.")
]
ClockSeed = Annotated[
    int | None,
    typer.Option(min=0, help="Add a clock bias: 10 m, then a random walk of 1 m per stop; none by default."),
]
SlamMethod = Annotated[str, typer.Option("--method", help="SLAM: statistical, or reference as published.")]
SceneFile = Annotated[str, typer.Option("--scene", help="Scene to score against: name or TOML file.")]


@with_clock
def import_paths(
    file: Annotated[
        Path, typer.Argument(help="Table of paths: .csv, .parquet, .mat, .nc or .h5; docs/exchange.md.")
    ],
    out: Out,
    scene: SceneFile,
    tx_offset_deg: Offset = 0.0,
    clock_seed: ClockSeed = None,
    method: SlamMethod = "statistical",
    delay_std_ns: Annotated[
        float, typer.Option(min=1e-3, max=1e3, help="Standard deviation of delays, where the file has none.")
    ] = 1.0,
    angle_std_deg: Annotated[
        float, typer.Option(min=1e-3, max=60, help="Standard deviation of azimuths, where the file has none.")
    ] = 1.0,
    los_power_dbm: Annotated[
        float | None,
        typer.Option(min=-300, max=300, help="Power of a line of sight of 1 m; by default the level is unknown."),
    ] = None,
    los_slope_db: Annotated[
        float, typer.Option(min=-60, max=0, help="With it: its change per decade of distance; free space.")
    ] = -20.0,
) -> None:
    """Import measured paths of any hall; then estimate, score and report work on the directory."""
    from estimation.slam.config import PathLoss, PathNoise  # noqa: PLC0415
    from isac_arena.campaign import stages  # noqa: PLC0415
    from isac_arena.exchange import measurement  # noqa: PLC0415

    noise = PathNoise(source="fixed", delay_std_ns=delay_std_ns, angle_std_deg=angle_std_deg)
    known = None if los_power_dbm is None else PathLoss(intercept_dbm=los_power_dbm, slope_db=los_slope_db)
    options = measurement.ImportOptions(tx_offset_deg, clock_seed, method, scene, noise, known)
    n_stops, lines = measurement.import_paths(file, out, options)
    for line in lines:
        stages.console.print(line, markup=False, soft_wrap=True)
    stages.console.print(f"{n_stops} stops imported; next: arena estimate {out}")


@with_clock
def import_mat(
    file: Annotated[Path, typer.Argument(help="MATLAB file of the measured campaign, of 30 or 45 stops.")],
    out: Out,
    tx_offset_deg: Offset = -1.6,
    clock_seed: ClockSeed = None,
    method: SlamMethod = "statistical",
    scene: SceneFile = "campus_arena",
) -> None:
    """Import the public measurement file, as import-paths does with the TX offset of that hall."""
    from isac_arena.campaign import stages  # noqa: PLC0415
    from isac_arena.exchange import measurement  # noqa: PLC0415

    n_stops = measurement.import_campaign(
        file, out, tx_offset_deg=tx_offset_deg, clock_seed=clock_seed, method=method, scene=scene
    )
    stages.console.print(f"{n_stops} stops imported; next: arena estimate {out}")


@with_clock
def import_iq(
    file: Annotated[
        Path, typer.Argument(help="Campaign file with a table \\[recording] that names SigMF, NPZ or HDF5 files.")
    ],
    out: Out,
) -> None:
    """Cut beam sweeps from recorded samples; then estimate, score and report work on the directory."""
    from isac_arena.campaign import stages  # noqa: PLC0415
    from isac_arena.exchange.iq.importing import import_iq as import_recording  # noqa: PLC0415

    found, doubts = import_recording(file, out)
    for stop, one in enumerate(found):
        stages.console.print(
            f"stop {stop}: starts at {1e6 * one.offset_s:.4g} us, carrier {one.cfo_hz:+.5g} Hz, sampling"
            f" {1e6 * one.drift:+.3g} ppm"
        )
    for line in doubts:
        stages.console.print(f"doubtful: {line}", soft_wrap=True, markup=False)
    stages.console.print(f"{len(found)} stops imported; next: arena estimate {out}")


@with_clock
def import_deepmimo(
    folder: Annotated[Path, typer.Argument(help="DeepMIMO v4 scenario folder.")],
    out: Annotated[Path, typer.Option(help="Folder for campaign.toml, scene.toml and what they name.")],
    stops: Annotated[
        int | None, typer.Option(min=1, help="Largest number of receivers, evenly over the set; all by default.")
    ] = None,
    tx_set: Annotated[int | None, typer.Option(help="TX set; the first by default.")] = None,
    tx: Annotated[int, typer.Option(min=0, help="TX within its set.")] = 0,
    rx_set: Annotated[int | None, typer.Option(help="RX set; the first by default.")] = None,
) -> None:
    """Make a campaign whose paths are those of a scenario; 'arena run' then sweeps beams over them."""
    from isac_arena.exchange.deepmimo import import_scenario  # noqa: PLC0415

    done = import_scenario(folder, out, n_stops=stops, tx_set=tx_set, tx=tx, rx_set=rx_set)
    typer.echo(
        f"{done.n_stops} of {done.n_receivers} receivers, {done.n_meshes} of {done.n_objects} objects; "
        f"next: arena run {out / 'campaign.toml'} --out DIR"
    )

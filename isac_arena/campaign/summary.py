"""Texts of a run for the terminal and the head of the report: main scores, and what was run."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import dataclass, fields
from importlib.metadata import PackageNotFoundError, version

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from isac_arena.campaign.chain.inputs import walk_settings
from isac_arena.campaign.config import CampaignConfig, methods
from isac_arena.campaign.plan import link_roles, slam_of
from isac_arena.progress import counted
from isac_arena.scoring.headline import HEADS, headline, score_text
from isac_arena.scoring.score import Scores
from isac_arena.user_functions.config import Stage
from scenes.inventory import scene_inventory
from scenes.scene import Scene
from sim.config import ArrayConfig
from sim.links import tx_links
from sim.propagation.motion.sweep import TRACES_OF_A_SWEEP
from sim.truth import Truth

OWN: dict[Stage, str] = {
    "mapping": "Mapping",
    "shapes": "Contours",
    "tracker": "Tracks",
}  # stages that are named only where they are a user's
LIBRARIES = ("isac-arena", "sionna-rt", "numpy", "scipy")


@dataclass(frozen=True)
class TraceCounts:
    """Tracing of a campaign: unscattered paths of the ray tracer against the exact ones, and sweeps that move."""

    n_compared: int = 0
    n_repaired: int = 0
    n_extra: int = 0
    n_moving: int = 0  # sweeps
    n_traced_again: int = 0  # of these, inside
    n_traces: int = 0  # of all of these
    phase_rad: float = 0.0  # largest error of the second order

    def __add__(self, other: TraceCounts) -> TraceCounts:
        sums = {each.name: getattr(self, each.name) + getattr(other, each.name) for each in fields(self)}
        return TraceCounts(**(sums | {"phase_rad": max(self.phase_rad, other.phase_rad)}))

    @property
    def lines(self) -> list[str]:
        """Lines for the terminal: none about what did not happen."""
        lines = []
        if self.n_compared:
            more = f"{counted(self.n_extra, 'path')} of these kinds that the ray tracer alone found"
            extra = f"; {more} {'is' if self.n_extra == 1 else 'are'} left out" if self.n_extra else ""
            n_exact = self.n_compared - self.n_extra
            added = f"{self.n_repaired} of them, which the ray tracer missed, are added"
            missed = added if self.n_repaired else "the ray tracer found them all"
            lines.append(f"lines of sight and reflections: {n_exact} by exact mirror images; {missed}{extra}")
        if self.n_moving:
            lines.append(
                f"motion: {self.n_moving} sweeps, {self.n_traced_again} of them traced again inside, "
                f"{self.n_traces / self.n_moving:.3g} times each sweep; "
                f"the second order errs by up to {np.rad2deg(self.phase_rad):.2g} deg times the relative gain"
            )
        return lines


def trace_counts(truth: Truth) -> TraceCounts:
    """What tracing a stop took."""
    planar = truth.n_planar_compared, truth.n_planar_repaired, truth.n_planar_extra
    motion = truth.motion
    if motion is None:
        return TraceCounts(*planar)
    again = int(motion.n_traces > TRACES_OF_A_SWEEP)
    return TraceCounts(*planar, 1, again, motion.n_traces, motion.second_order_phase_rad)


def score_table(scores: Scores) -> Table:
    """The main scores as a table for the terminal."""
    table = Table("Scores", *HEADS, box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for column in table.columns[1:-1]:
        column.justify, column.no_wrap = "right", True
    for label, cells, unit in headline(scores.metrics):
        table.add_row(label, *map(score_text, cells), unit)
    return table


def scene_summary(scene: Scene) -> str:
    """How many objects a scene has, and meshes where it has any."""
    meshes = f" and {len(scene.clutter)} mesh{'es' * (len(scene.clutter) > 1)}" if scene.clutter else ""
    return f"{len(scene.objects)} objects{meshes}"


def scene_table(scene: Scene) -> Table:
    """All objects and meshes of a scene as a table for the terminal, a row each with its extent in m."""
    parts = scene_inventory(scene)
    table = Table("object", "kind", "material", "x, m", "y, m", "z, m", "", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for row, name in enumerate(parts.object.tolist()):
        extents = (
            f"{low:.4g} to {high:.4g}" for low, high in zip(parts.low_m[row], parts.high_m[row], strict=True)
        )
        thin = "" if parts.is_closed[row] else "open" if parts.is_mesh[row] else "thin"
        about = ("mesh" * bool(parts.is_mesh[row]), thin, "moves" * bool(parts.is_moving[row]))
        table.add_row(
            name, str(parts.kind[row]), str(parts.material[row]), *extents, ", ".join(filter(None, about))
        )
    return table


def run_facts(
    config: CampaignConfig, scene: Scene, measured: str | None = None, failures: Sequence[str] = ()
) -> dict[str, str]:
    """What was run, for the head of the report; `measured` is the source of a measured campaign.

    `failures` says where functions of the user failed.
    """
    slam = f"every stop alone, {config.slam.method}"
    if trajectory := walk_settings(config, scene.walk.positions_m()):
        how = "stop by stop along the walk" if trajectory.method == "filter" else "all stops together"
        slam = f"{how}; every stop first alone, {config.slam.method}"
    used, functions = methods(config), config.functions.given
    slam = used["slam"] if "slam" in functions else slam
    if config.links:
        links = tx_links(config, scene)
        slam = f"{slam_of(config, scene, links)}; {link_roles(links)}"
    own = {OWN[stage]: used[stage] for stage in OWN if stage in functions}
    failed = {"Failed": "\n".join(failures)} if failures else {}
    versions = [f"Python {platform.python_version()}", *(f"{name} {_version(name)}" for name in LIBRARIES)]
    return {
        "Scene": f"{scene.name}, {scene_summary(scene)}, {len(scene.stops)} receiver stops",
        **(_signal_facts(config) if measured is None else {"Measurement": measured}),
        "SLAM": slam,
        **own,
        **failed,
        "Versions": ", ".join(versions),
    }


def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return "(not installed)"


def _array_facts(array: ArrayConfig) -> str:
    n = len(array.beam_elevation_deg)
    at = f" at each of {n} elevations" if n > 1 else ""
    panels = counted(len(array.panel_azimuth_deg), "panel")
    return f"{panels} of {array.rows} x {array.columns} elements and {array.beams_per_panel} beams{at}"


def _signal_facts(config: CampaignConfig) -> dict[str, str]:
    wave, tx, rx = config.waveform, config.tx_array, config.rx_array
    bandwidth_mhz = wave.n_rb * 12 * 15e-3 * 2**wave.numerology
    return {
        "Seed": str(config.seed),
        "Waveform": f"NR PRS at {wave.carrier_ghz:g} GHz, {bandwidth_mhz:.1f} MHz, comb {wave.comb}",
        "TX": _array_facts(tx),
        "RX": _array_facts(rx),
        "Link": f"{config.link.tx_power_dbm:g} dBm, noise figure {config.link.noise_figure_db:g} dB",
        "Channel estimator": methods(config)["channel"],
    }

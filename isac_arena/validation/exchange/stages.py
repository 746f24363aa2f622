"""Functions of users in place of stages of a made-up campaign: bad ones lose their own stage alone."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from estimation.channel.record import EstimateStatus
from isac_arena.campaign.campaign import load_campaign
from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.driver import CampaignRun
from isac_arena.campaign.results import MemoryResults
from isac_arena.scoring.stages.tracks import mover_states
from isac_arena.user_functions.config import STAGES, Stage, with_functions
from isac_arena.user_functions.errors import EstimatorError
from isac_arena.user_functions.room import close_rooms
from isac_arena.validation.exchange.functions import BODIES, COUNT, source
from isac_arena.validation.measurement import InfoTable, Measured, at_least
from isac_arena.validation.scenarios.perfect_campaign import MadeCampaign, make_campaign, make_moving_campaign
from sim.config import ArrayConfig, WaveformConfig

TEMPLATES = Path(__file__).resolve().parents[2] / "cli" / "templates"
FUNCTIONS: dict[Stage, str] = {
    "channel": "estimate",
    "mapping": "map_paths",
    "slam": "locate",
    "shapes": "outline",
    "tracker": "follow",
}
CALL_LIMIT_S, TEMPLATE_LIMIT_S = 1.0, 600.0
N_STOPS = 4
PILLAR_M_S = np.array([0.4, -0.2, 0.0])
MOVING: dict[str, Any] = {
    "waveform": {"comb": 12, "n_rb": 64},
    "tx_array": {"columns": 8, "beams_per_panel": 12},
    "rx_array": {"columns": 8, "beams_per_panel": 8},
    "channel.maximum_likelihood.max_paths": 12,
    "propagation": {"diffuse_samples": 0, "max_bounces": 1, "diffraction": False},
}  # of a room with a person and an AGV
MOST_M = 0.3  # error of a template: it is an example, no method
QUICK = ("raises", "dies", "hangs", "covariance", "writes", "overwrites", "class")


def check_stages(seed: int, quick: bool) -> Measured:
    """The function that `arena new estimator` writes for each stage: it runs in the chain, near the truth."""
    del seed, quick
    made, worked, rows = make_campaign(), [], []
    with _lab({f"of_{stage}": (TEMPLATES / f"{stage}.txt").read_text(encoding="utf-8") for stage in STAGES}):
        for stage in STAGES:
            told, error_m = _tracker() if stage == "tracker" else _template(made, stage)
            has_test = (TEMPLATES / f"test_{stage}.txt").is_file()
            worked.append(not told and error_m < MOST_M and has_test)
            rows.append((stage, error_m, told or "-"))
    table = InfoTable("Functions of `arena new estimator`", ("stage", "median error (m)", "failure"), tuple(rows))
    about = f"of {len(STAGES)}: template and test are there, it runs, median error below {MOST_M:g} m"
    return Measured([at_least("exchange.stages.replaced", sum(worked), len(STAGES), about)], (table,))


def check_bad_functions(seed: int, quick: bool) -> Measured:
    """Functions that fail: one line with stage and function, and the campaign goes on to its scores."""
    del seed
    frozen, moving, held, rows = make_campaign(), make_moving_campaign(PILLAR_M_S), [], []
    with _lab({"bad_lab_of_stages": source()}):
        for stage, bodies in BODIES.items():
            for name in bodies:
                if quick and name not in QUICK:
                    continue
                made = moving if stage == "tracker" else frozen
                line, went_on = _bad(made, stage, f"bad_lab_of_stages:{stage}_{name}")
                held.append(went_on)
                rows.append((stage, name, "yes" if went_on else "no", line[:110]))
    table = InfoTable("Functions that fail", ("stage", "function", "goes on", "line"), tuple(rows))
    bar = len(held) if quick else COUNT
    about = "raise, hang, wrong shapes, NaN, negative covariances, written input: one line, campaign goes on"
    return Measured([at_least("exchange.functions.gone_on", sum(held), bar, about)], (table,))


def _config(stage: Stage, name: str, limit_s: float) -> CampaignConfig:
    """A small campaign with a function in place of a stage."""
    array = ArrayConfig(rows=1, columns=8, beams_per_panel=8)
    config = CampaignConfig(
        name="made", scene="made", waveform=WaveformConfig(n_rb=24, comb=12), tx_array=array, rx_array=array
    )
    return with_functions(config, {stage: name}, limit_s)


def _template(made: MadeCampaign, stage: Stage) -> tuple[str, float]:
    """How the function of a template failed, and its median error in m."""
    failures: list[EstimatorError] = []
    config = _config(stage, f"of_{stage}:{FUNCTIONS[stage]}", TEMPLATE_LIMIT_S)
    run = CampaignRun(config, made.scene, paths=made.truths, on_failure=failures.append)
    if stage == "channel":
        wide = WaveformConfig(comb=12)
        run = replace(run, config=config.model_copy(update={"waveform": wide}), paths=made.truths[:N_STOPS])
        found = [(one, next(run.channel([one]))) for one in run.truths()]
        error = [abs(e.delay_s[0] - t.clock_bias_s - t.paths.delay_s[0]) for t, e in found if len(e)]
        return _line(failures), 299792458.0 * float(np.median(error))
    maps = run.maps(list(made.results.channel), made.results.mapping.poses)
    if stage == "slam":
        true_m = np.array([truth.rx_pose.position_m[:2] for truth in made.truths])
        return _line(failures), float(np.median(np.linalg.norm(maps["slam"].poses.position_m - true_m, axis=1)))
    mapped = maps["mapping"]
    places_m = mapped.ips.position_m[mapped.ips.is_inlier] if stage == "mapping" else mapped.contours.center_m
    distance_m = np.min([np.abs(one.contour.signed_distance(places_m)) for one in made.scene.objects], axis=0)
    return _line(failures), float(np.median(distance_m))


def _tracker() -> tuple[str, float]:
    """As `_template`, in a small room where two things move: the distance of the tracks to the nearest."""
    functions = {"tracker": {"function": f"of_tracker:{FUNCTIONS['tracker']}", "limit_s": TEMPLATE_LIMIT_S}}
    campaign = load_campaign("moving_target", functions=functions, **MOVING)
    run, failures = campaign.chain(), list[EstimatorError]()
    run = replace(run, on_failure=failures.append)
    truths = list(run.truths())
    tracks = run.maps(list(run.channel(truths)), run.surveyed_receiver(truths))["slam"].tracks
    if tracks is None:
        return _line(failures), np.inf
    movers = [item for item in campaign.scene.objects if item.motion is not None]
    true_m = mover_states(movers, tracks.survey.time_s)[:, tracks.stop][..., [0, 2]]
    return _line(failures), float(np.median(np.linalg.norm(tracks.position_m - true_m, axis=2).min(axis=0)))


def _line(failures: list[EstimatorError]) -> str:
    return str(failures[0]) if failures else ""


def _bad(made: MadeCampaign, stage: Stage, name: str) -> tuple[str, bool]:
    """The first line of a bad function, and whether the run named it and went on to its scores."""
    failures: list[EstimatorError] = []
    run = CampaignRun(
        _config(stage, name, CALL_LIMIT_S), made.scene, MemoryResults(), paths=made.truths[:N_STOPS],
        on_failure=failures.append,
    )  # fmt: skip
    if stage != "channel":
        run.results.estimates.update({one.stop: one for one in made.results.channel[:N_STOPS]})  # type: ignore[attr-defined]
    scores = run.scores()
    lines = [str(one) for one in failures]
    named = bool(lines) and all(line.startswith(f"{stage} = '{name}': ") and "\n" not in line for line in lines)
    status = [run.results.estimate(truth.stop) for truth in made.truths[:N_STOPS]]
    failed = sum(one is not None and one.status == EstimateStatus.FAILED for one in status)
    alone = (failed, len(lines)) == (1, 1) if stage == "channel" else failed == 0
    return (lines or [""])[0], named and alone and len(scores.metrics) > 0


@contextmanager
def _lab(modules: dict[str, str]) -> Iterator[None]:
    """Modules of a user in a folder on Python's path."""
    with TemporaryDirectory() as folder:
        for name, text in modules.items():
            (Path(folder) / f"{name}.py").write_text(text, encoding="utf-8")
        sys.path.insert(0, folder)
        try:
            yield
        finally:
            sys.path.remove(folder)
            close_rooms()

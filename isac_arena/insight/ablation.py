"""Ablation: one campaign with each hardware impairment alone, with all and with none."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from estimation.channel.calibration.self_calibration import calibration_rows, self_calibrate
from estimation.channel.estimate import ChannelEstimator
from estimation.channel.power_map import beam_power_map
from isac_arena.campaign.chain import channel_estimator, known_receiver, map_both, score_simulated
from isac_arena.campaign.config import CampaignConfig
from isac_arena.insight.ablation_ranking import ALL, EFFECTS, NONE, Ablation, ranked
from isac_arena.scoring.score import Scores
from scenes.scene import Scene
from sim.signal.hardware.apply_impairments import with_surveyed_pose
from sim.signal.hardware.config import ImpairmentsConfig
from sim.signal.link import Link, make_link
from sim.simulate import clock_biases_s, observe
from sim.truth import Truth


def variants(impairments: ImpairmentsConfig) -> dict[str, ImpairmentsConfig]:
    """Impairment settings by name: none, each that is on alone, all; `ValueError` where none is on."""
    names = impairments.switched_on
    if not names:
        raise ValueError("impairments: all are off, at least one must be on, as in campus_arena_hardware")
    return {
        NONE: ImpairmentsConfig(),
        **{name: impairments.only(name) for name in names},
        ALL: impairments,
    }


def score_variants(
    config: CampaignConfig, scene: Scene, truths: Sequence[Truth], done: Callable[[str], None] | None = None
) -> Ablation:
    """Run the campaign once per variant on the same paths and random numbers, and rank the variants.

    `truths` holds the traced paths of the stops; their clock biases are set per variant. `done` is told the name
    of every variant that is finished.
    """
    rows: dict[str, list[float]] = {}
    for name, impairments in variants(config.impairments).items():
        scores = run_variant(config.model_copy(update={"impairments": impairments}), scene, truths)
        rows[name] = [scores.value(key) for key in EFFECTS]
        if done is not None:
            done(name)
    return ranked(rows)


def run_variant(config: CampaignConfig, scene: Scene, paths_of_stops: Sequence[Truth]) -> Scores:
    """All scores of a campaign with the impairments of `config`, one sweep in memory at a time.

    Where the settings ask for self-calibration, both arrays are calibrated on sweeps with these impairments.
    """
    link = make_link(config)
    biases_s = clock_biases_s(config, len(scene.stops))
    truths = [replace(truth, clock_bias_s=float(biases_s[truth.stop])) for truth in paths_of_stops]
    estimator = _estimator(config, link, scene, truths)
    estimated = [
        (estimator(sweep), beam_power_map(sweep))
        for sweep in (observe(config, link, scene, truth) for truth in truths)
    ]
    channel = tuple(estimate for estimate, _ in estimated)
    receiver = known_receiver(with_surveyed_pose(config, truth) for truth in truths)
    power_maps = [power_map for _, power_map in estimated]
    results = map_both(config, channel, power_maps, scene.tx, receiver)
    return score_simulated(config, link, scene, truths, results)


def _estimator(config: CampaignConfig, link: Link, scene: Scene, truths: Sequence[Truth]) -> ChannelEstimator:
    """The channel estimator, with the arrays as calibrated on some of the sweeps where the settings ask for it."""
    settings = config.channel.self_calibration
    if settings is None:
        return channel_estimator(config)
    rows = calibration_rows(len(truths), settings)
    sweeps = (observe(config, link, scene, truths[row]) for row in rows)
    return channel_estimator(config, None, self_calibrate(sweeps, settings))

"""`arena validate scoring`: an error budget adds up, and another order moves no share out of its interval."""

from itertools import pairwise

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.shape.config import ContourConfig, ShapeConfig
from estimation.slam.config import TrajectoryConfig
from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.driver import CampaignRun
from isac_arena.insight.budget.attribution import attribute, signed_root
from isac_arena.insight.budget.chain import Chain, make_chain
from isac_arena.insight.budget.outcome import lit_objects
from isac_arena.insight.budget.record import OUTCOMES, Variants, attributions
from isac_arena.insight.budget.stages import STAGE_GROUPS, Groups, Stage, coalitions, orders
from isac_arena.scoring.config import Significance
from isac_arena.scoring.true_stop import true_stop
from isac_arena.validation.measurement import Measurement, at_most
from isac_arena.validation.monte_carlo import generators
from isac_arena.validation.scenarios.estimates import shift_estimate
from isac_arena.validation.scenarios.perfect_campaign import make_campaign, power_dbm
from scenes.record import concatenate

LIMITS = Significance(dynamic_range_db=28.0, noise_threshold_dbm=-150.0)
GROUPS: Groups = (("a", "b", "c"),)


def check_budget(seed: int, quick: bool) -> list[Measurement]:
    """A made campaign with noisy, missed and false paths, from its channel estimates to its contours.

    A quick run takes every second stop of one campaign.
    """
    rng = np.random.default_rng(seed)
    variants: Variants = {parts: [] for parts in coalitions(STAGE_GROUPS)}
    for _ in range(1 if quick else 8):
        chain = faulty_chain(rng, stop_every=2 if quick else 1)
        variants = {parts: [*done, chain.final_errors(parts)] for parts, done in variants.items()}
    found = attributions(variants, STAGE_GROUPS, np.random.default_rng(seed))
    rest = max(float(signed_root(one.rest)) for one in found.values())
    gap = max(abs(one.contribution.sum() + one.rest - one.total) / one.total for one in found.values())
    outside = sum(_swaps_outside(variants, outcome) for outcome in found)
    solver = variants[frozenset({Stage.DETECTION, Stage.GEOMETRY, Stage.ASSOCIATION})]
    pose_m = max(float(errors.pose_error_m.max()) for errors in solver)
    key, moved = "scoring.budget", "shares that another order moves out of their interval"
    return [
        at_most(f"{key}.all_oracle_error", rest, 1e-9, "error with truth in the place of every stage", "m"),
        at_most(f"{key}.gap", gap, 1e-12, "parts and rest less the total, over the total"),
        at_most(f"{key}.swaps_outside", outside, 0, moved),
        at_most(f"{key}.solver_error", pose_m, 1e-5, "largest pose error with true paths", "m"),
    ]


def check_attribution(seed: int, quick: bool) -> list[Measurement]:
    """Independent errors of known size: the shares are exact, and the intervals cover as often as stated."""
    runs, hits, worst = 100 if quick else 1000, 0, 0.0
    for rng in generators(seed, runs):
        term = dict(zip("abc", np.array([[6.0], [3.0], [1.0]]) * rng.chisquare(4, (3, 60)), strict=True))
        table = {
            met: np.sum([term[part] for part in "abc" if part not in met] or [np.zeros(60)], axis=0)
            for met in coalitions(GROUPS)
        }
        found = attribute(table, GROUPS, rng, 400)
        mean = np.array([term[part].mean() for part in "abc"])
        worst = max(worst, float(np.abs(found.contribution - mean).max()))
        hits += bool(found.low[0] <= 0.6 <= found.high[0])
    shortfall = 0.95 - hits / runs
    bar = 0.02 + 3 * np.sqrt(0.05 * 0.95 / runs)
    key, own = "scoring.attribution", "contribution less the mean of the part's own error"
    return [
        at_most(f"{key}.independent", worst, 1e-9, own),
        at_most(f"{key}.coverage_shortfall", shortfall, bar, "0.02 for 60 units, 3 standard deviations"),
    ]


def faulty_chain(rng: np.random.Generator, stop_every: int = 1) -> Chain:
    """The chain of the made campaign from estimates with errors of their stated size, some missed, some false."""
    made = make_campaign()
    truths = made.truths[::stop_every]
    stops = [true_stop(truth, made.scene.tx, power_dbm(truth), LIMITS, None) for truth in truths]
    name, shapes = made.scene.name, ShapeConfig(eps_m=1.5, min_samples=3)
    contours = ContourConfig(method="none")
    alone = TrajectoryConfig(method="single")  # the prior of a walk moves states off what true paths say
    config = CampaignConfig(name=name, scene=name, trajectory=alone, shapes=shapes, contours=contours)
    channel = [_faulty(estimate, rng) for estimate in made.results.channel[::stop_every]]
    run = CampaignRun(config, made.scene, stops=[truth.stop for truth in truths])
    return make_chain(run, stops, channel, lit_objects(made.scene, stops, 3))


def _faulty(estimate: ChannelEstimate, rng: np.random.Generator) -> ChannelEstimate:
    std = np.sqrt(np.diagonal(estimate.covariance, axis1=1, axis2=2))
    noisy = shift_estimate(estimate, std * rng.standard_normal(std.shape))
    one = noisy.take("path", [int(rng.integers(1, len(estimate)))])
    false = shift_estimate(one, [rng.uniform(5e-9, 20e-9), 0.0, 0.0])
    found = np.arange(len(estimate)) != rng.integers(1, len(estimate))
    both = concatenate([noisy.take("path", found), false], "path")
    return both.take("path", np.argsort(both.delay_s, kind="stable"))


def _swaps_outside(variants: Variants, outcome: str) -> int:
    """Shares that lie outside their interval in any admissible order."""
    name = OUTCOMES[outcome][0]
    mean = {
        parts: float(np.mean([np.square(getattr(errors, name)).mean() for errors in repeats]))
        for parts, repeats in variants.items()
    }
    found = attributions(variants, STAGE_GROUPS, np.random.default_rng(1))[outcome]
    outside = 0
    for order in orders(STAGE_GROUPS):
        met = [frozenset(order[:length]) for length in range(len(order) + 1)]
        for part, (before, after) in zip(order, pairwise(met), strict=True):
            share, index = (mean[before] - mean[after]) / found.total, found.part.index(part)
            outside += not found.low[index] - 1e-12 <= share <= found.high[index] + 1e-12
    return outside

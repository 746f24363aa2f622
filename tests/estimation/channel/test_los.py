"""The probability of the line of sight: limits that are known, and calibration under its own priors."""

import numpy as np
import pytest

from estimation.channel.config import LosConfig
from estimation.channel.los import (
    LosDirection,
    clock_log_likelihood,
    line_of_sight,
    los_probability,
    sight_log_prior,
)
from scenes.pose import SPEED_OF_LIGHT_M_S

LEVEL_DBM = -13.0
BIAS_S = 4e-8


def probability(
    lengths_m: list[float], loss_db: list[float], config: LosConfig | None = None, bias_s: float = BIAS_S
) -> np.ndarray:
    lengths = np.array(lengths_m, float)
    power = LEVEL_DBM - 20 * np.log10(lengths) - np.array(loss_db, float)
    return los_probability(lengths / SPEED_OF_LIGHT_M_S + bias_s, power, config or LosConfig())


def test_free_space_power_makes_a_line_of_sight_likely() -> None:
    assert probability([5], [0])[0] > 0.7
    assert probability([5, 9, 14], [0, 3, 8])[0] > 0.8


def test_a_later_path_that_is_too_strong_is_evidence_against_it() -> None:
    assert probability([5, 6], [15, 4])[0] < 0.1
    assert probability([5, 6], [0, 6])[0] > 0.7


def test_a_power_that_needs_an_incredible_clock_is_evidence_against_it() -> None:
    assert probability([5], [30])[0] < 0.2


def test_with_a_known_clock_power_is_compared_with_distance() -> None:
    synchronised = LosConfig(clock_std_ns=1.0)
    assert probability([5], [0], synchronised, bias_s=0.0)[0] > 0.95
    assert probability([5], [12], synchronised, bias_s=0.0)[0] < 0.05
    loose = LosConfig()
    assert probability([5], [12], loose, bias_s=0.0)[0] > 0.3  # the clock may be off as much


def test_a_known_direction_decides_if_powers_do_not() -> None:
    delay = np.array([2e-8, 4e-8])
    power = np.array([-40.0, -45.0])
    angles = np.array([[0.2, -0.4], [1.0, 1.0]])
    config = LosConfig()
    there, elsewhere = (
        los_probability(delay, power, config, angles_rad=angles, direction=LosDirection(aod, -0.4))
        for aod in (0.21, 0.6)
    )
    assert there[0] > 0.95
    assert elsewhere[0] < 0.01


def test_a_ghost_before_the_line_of_sight_is_not_chosen() -> None:
    found = probability([4, 5, 9], [25, 0, 10], LosConfig(clock_std_ns=1.0, ghost_share=0.1), bias_s=0.0)
    assert found.argmax() == 1
    assert found[1] > 0.5


def test_side_lobes_in_the_delay_cell_of_a_line_of_sight_do_not_hide_it() -> None:
    """Wrong beam patterns cause ghosts around the strongest path, some of them by chance a little before it."""
    lengths = np.array([4.99, 4.995, 4.998, 5.0, 5.01, 9.0])
    power = -13.0 - 20 * np.log10(lengths) - np.array([25, 30, 28, 0, 24, 10])
    delay = lengths / SPEED_OF_LIGHT_M_S + BIAS_S
    blind = los_probability(delay, power, LosConfig())
    found = los_probability(delay, power, LosConfig(), cell_s=2.6e-9)
    alone = los_probability(delay[[3, 5]], power[[3, 5]], LosConfig())
    assert blind[3] < 0.5
    assert found[[3, 5]].tolist() == alone.tolist()
    assert found[3] > 0.7
    assert (found[[0, 1, 2, 4]] == 0).all()


def test_an_equal_path_in_the_delay_cell_does_not_mask_it() -> None:
    delay = np.array([5.0, 5.2]) / SPEED_OF_LIGHT_M_S
    power = np.array([-27.0, -31.0])
    plain, found = (los_probability(delay, power, LosConfig(), cell_s=cell) for cell in (0.0, 2.6e-9))
    assert plain.tolist() == found.tolist()


def test_at_most_one_path_is_the_line_of_sight() -> None:
    assert probability([], []).shape == (0,)
    for seed in range(50):
        rng = np.random.default_rng(seed)
        found = probability(list(np.sort(rng.uniform(3, 30, 5))), list(rng.uniform(-3, 25, 5)))
        assert (found >= 0).all()
        assert found.sum() <= 1 + 1e-12
        assert line_of_sight(found).sum() <= 1


@pytest.mark.parametrize("clock_std_ns", [2.0, None])
def test_probabilities_are_calibrated(clock_std_ns: float | None) -> None:
    """Stops drawn from the model's own priors: of those of probability near p, a share p has a line of sight."""
    config = LosConfig(clock_std_ns=clock_std_ns)
    rng = np.random.default_rng(3)
    given, truth = [], []
    while len(given) < 1500:
        has_los = rng.random() > config.blocked_share
        bias_s = 1e-9 * (
            rng.normal(0, clock_std_ns) if clock_std_ns else rng.uniform(-1, 1) * config.max_clock_bias_ns
        )
        lengths = np.array([0.0, rng.uniform(1, 15)]) + rng.uniform(3, 15)
        own = rng.normal(0, config.tolerance_db) if has_los else _loss(rng, 12.0, 7.0)
        loss = [own, _loss(rng, config.least_loss_db, config.least_loss_std_db)]
        given.append(probability(list(lengths), loss, config, bias_s)[0])
        truth.append(has_los)
    chance, has_los = np.array(given), np.array(truth)
    for low, high in ((0.0, 0.4), (0.4, 0.7), (0.7, 0.9), (0.9, 1.0)):
        inside = (chance >= low) & (chance < high)
        if inside.sum() >= 60:
            std = np.sqrt(chance[inside].mean() * (1 - chance[inside].mean()) / inside.sum())
            assert abs(has_los[inside].mean() - chance[inside].mean()) < 3 * std + 0.05


def _loss(rng: np.random.Generator, mean_db: float, std_db: float, tolerance_db: float = 3.0) -> float:
    while True:
        loss = rng.normal(mean_db, std_db)
        if rng.random() < np.exp(-0.5 * (min(loss, 0.0) / tolerance_db) ** 2):
            return float(loss)


def test_only_the_first_paths_may_be_the_line_of_sight_and_none_beside_a_stronger_one() -> None:
    delay_s = 1e-9 * np.array([10.0, 10.5, 20.0, 30.0, 40.0])
    prior = sight_log_prior(delay_s, np.array([-60.0, -30.0, -40.0, -40.0, -40.0]), LosConfig(), 2e-9)
    assert np.isneginf(prior[[0, 4]]).all()
    assert (np.diff(prior[1:4]) < 0).all()


def test_the_power_of_a_line_of_sight_tells_the_clock_bias() -> None:
    config, length_m, loss_db = LosConfig(power_at_1m_dbm=LEVEL_DBM), np.array([6.0, 9.0]), np.array([2.0, 12.0])
    power_dbm = LEVEL_DBM - 20 * np.log10(length_m) - loss_db
    delay_s = length_m / SPEED_OF_LIGHT_M_S + BIAS_S
    bias_s = BIAS_S + np.linspace(-3e-8, 3e-8, 601)
    likelihood = clock_log_likelihood(
        delay_s, power_dbm, config, bias_s, log_prior=sight_log_prior(delay_s, power_dbm, config, 1e-9),
        sight_std_db=0.5, sight_loss_db=lambda length: np.full(length.shape, 2.0),
    )  # fmt: skip
    assert bias_s[likelihood.argmax()] == pytest.approx(BIAS_S, abs=2e-10)
    assert np.isneginf(likelihood[bias_s > delay_s[1]]).all()

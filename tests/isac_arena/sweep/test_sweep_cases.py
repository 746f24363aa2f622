import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isac_arena.sweep.cases import design_points, make_cases
from isac_arena.sweep.config import SweepConfig
from isac_arena.sweep.plan import make_plan
from isac_arena.sweep.store import open_sweep, plan_of_jobs, write_plan
from scenes.toml_config import ConfigError, load_config, validate_config
from tests.isac_arena.cli.sweep_files import write_sweep


def sweep(axes=(), **settings):
    document = {"name": "test", "base": "box_room", "axes": list(axes), **settings}
    return validate_config(document, SweepConfig, "sweep.toml")


def cases(config, repeats=(0,)):
    return list(make_cases("sweep.toml", config, design_points(config), repeats))


def test_a_grid_holds_every_combination_in_order():
    config = sweep([
        {"field": "waveform.n_rb", "values": [64, 128]},
        {"field": "link.tx_power_dbm", "low": 0.0, "high": 10.0, "count": 3},
    ])  # fmt: skip
    assert design_points(config) == [(n, p) for n in (64, 128) for p in (0.0, 5.0, 10.0)]
    made = cases(config, repeats=(0, 1))
    assert len(made) == 12
    assert [(c.config.waveform.n_rb, c.config.link.tx_power_dbm) for c in made[::2]] == design_points(config)
    assert [c.config.seed for c in made[:4]] == [1, 2, 1, 2]


def test_a_list_takes_values_side_by_side():
    axes = [
        {"field": "seed", "values": [1, 2, 3]},
        {"field": "link.tx_power_dbm", "low": 1.0, "high": 100.0, "count": 3, "log": True},
    ]
    points = design_points(sweep(axes, design="list"))
    assert [seed for seed, _ in points] == [1, 2, 3]
    np.testing.assert_allclose([power for _, power in points], [1, 10, 100])
    with pytest.raises(ConfigError, match="as many values on every axis"):
        design_points(sweep([axes[0], {"field": "waveform.n_rb", "values": [64]}], design="list"))


@given(st.integers(1, 40), st.integers(0, 5))
def test_a_latin_hypercube_has_one_point_in_every_slice(n, seed):
    axes = [
        {"field": "link.tx_power_dbm", "low": -10.0, "high": 10.0},
        {"field": "link.noise_figure_db", "low": 1.0, "high": 20.0, "log": True},
    ]
    config = sweep(axes, design="latin_hypercube", n_points=n, design_seed=seed)
    points = np.array(design_points(config))
    shares = np.stack([(points[:, 0] + 10) / 20, np.log(points[:, 1]) / np.log(20)], axis=1)
    for axis in range(2):
        assert sorted(np.minimum(np.floor(shares[:, axis] * n + 1e-9), n - 1).astype(int)) == list(range(n))
    np.testing.assert_array_equal(points, design_points(config))


def test_random_points_take_lists_and_whole_numbers():
    axes = [
        {"field": "waveform.comb", "values": [2, 4, 12]},
        {"field": "seed", "low": 1, "high": 9, "integer": True},
    ]
    points = design_points(sweep(axes, design="random", n_points=200))
    assert {comb for comb, _ in points} == {2, 4, 12}
    assert {type(seed) for _, seed in points} == {int}
    assert {seed for _, seed in points} == set(range(1, 10))


def test_scene_fields_change_the_scene_and_nothing_else():
    config = sweep([{"field": "scene.objects.pillar.contour.radius_m", "values": [0.3, 0.4]}])
    made = cases(config)
    documents = [tomllib.loads(case.scene.text) for case in made]
    radii = [
        next(item for item in document["objects"] if item["name"] == "pillar")["contour"]["radius_m"]
        for document in documents
    ]
    assert radii == [0.3, 0.4]
    for document in documents:
        next(item for item in document["objects"] if item["name"] == "pillar")["contour"].pop("radius_m")
    assert documents[0] == documents[1]


@pytest.mark.parametrize(("axis", "message"), [
    ({"field": "waveform.n_rbs", "values": [64]}, "waveform.n_rbs = 64: unknown key; did you mean n_rb"),
    ({"field": "waveform.n_rb", "values": ["many"]}, r'waveform.n_rb = "many"'),
    ({"field": "waveform.n_rb", "values": [64, 65]}, "n_rb = 65"),
    ({"field": "scene.objects.nobody.height_m", "values": [1]}, "there is no 'nobody'; allowed: "),
    ({"field": "seed.low", "values": [1]}, "'seed' is a value, not a table"),
])  # fmt: skip
def test_bad_axes_are_refused_in_one_line(axis, message):
    with pytest.raises(ConfigError, match=message) as caught:
        cases(sweep([axis]))
    assert str(caught.value).startswith("sweep.toml: case ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("axes", "settings", "message"), [
    ([{"field": "seed"}], {}, "give either values, or low and high"),
    ([{"field": "seed", "values": [1], "low": 1.0}], {}, "give either values"),
    ([{"field": "seed", "low": 2.0}], {}, "a range needs low and high"),
    ([{"field": "seed", "low": 2.0, "high": 1.0, "count": 3}], {}, "low must be below high"),
    ([{"field": "seed", "low": 0.0, "high": 1.0, "count": 3, "log": True}], {}, "above 0 where log"),
    ([{"field": "seed", "low": 0.0, "high": 1.0}], {}, "axes.seed.count"),
    ([{"field": "seed", "values": [1]}] * 2, {}, "'seed' is given twice"),
    ([], {"design": "random"}, "n_points = None"),
    ([], {"n_points": 3}, "n_points = 3"),
    ([], {"until": {"metric": "slam.position.rmse_m", "half_width": 0.1}}, "repeats = 1: must be at least 2"),
])  # fmt: skip
def test_sweep_files_that_make_no_sense_are_refused(axes, settings, message):
    with pytest.raises(ConfigError, match=message):
        sweep(axes, **settings)


def test_a_sweep_may_grow_and_knows_its_finished_cases(tmp_path: Path) -> None:
    write_sweep(tmp_path)
    file, out = tmp_path / "sweep.toml", tmp_path / "out"

    def opened(text: str) -> set[str]:
        file.write_text(text)
        config = load_config(file, SweepConfig)
        jobs = make_plan(str(file), config, out, range(config.repeats)).jobs
        keys = {job.key for job in jobs}
        open_sweep(out, config, (tmp_path / "small.toml").read_text(), keys)
        write_plan(out, plan_of_jobs(jobs))
        return keys

    first = opened(file.read_text())
    values = file.read_text().replace("values = [0.0, 20.0]", "values = [0.0, 10.0, 20.0]")
    more = opened(values)
    assert first < more and len(more) == 1.5 * len(first)
    axis = '[[axes]]\nfield = "link.noise_figure_db"\nvalues = [10.0, 4.0]\n'
    known = opened(values + axis)
    assert more < known
    for field, usual in (
        ("contour.radius_m", 0.3),
        ("z_min_m", 0.0),
    ):  # in the scene file; a default it leaves out
        axis += f'[[axes]]\nfield = "scene.objects.pillar.{field}"\nvalues = [{usual}, 0.4]\n'
        before, known = known, opened(values + axis)
        assert before < known and len(known) == 2 * len(before)
    with pytest.raises(ValueError, match=r"holds a sweep with other settings .*axes may grow"):
        opened(values)

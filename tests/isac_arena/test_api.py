"""The public API: signatures that stay, campaigns made in Python, and records as tables and pictures."""

import inspect
import re
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
import trimesh
import xarray as xr

import isac_arena as ia
from isac_arena.campaign.campaign import campaign_store
from isac_arena.scoring.chain import score_campaign
from isac_arena.scoring.config import Significance
from isac_arena.scoring.metrics.metric import Metric
from isac_arena.validation.scenarios.perfect_campaign import MadeCampaign
from scenes.config import SceneConfig
from scenes.objects.clutter import Clutter
from scenes.record import FloatArray
from scenes.scene import Scene
from scenes.tables import scene_tables
from scenes.toml_config import ConfigError

ROOT = Path(__file__).resolve().parents[2]

# The arguments that users write. What goes is deprecated first: CONTRIBUTING.md
SIGNATURES = {
    "load_campaign": "source, *, seed=None, scene=None, **changes",
    "estimate_channel": "sweep, method=None, config=None",
    "map_points": "campaign, channel, truths",
    "slam": "campaign, channel",
    "track": "campaign, channel, poses",
    "fit_contours": "campaign, channel, poses, points",
    "score": "campaign, truths, channel, mapping=None, slam=None",
    "run": "campaign, out, *, seed=None, estimator=None, keep_sweeps=False, workers=1",
    "open": "directory",
    "Campaign.trace": "self, stops=None",
    "Campaign.observe": "self, truth",
    "Campaign.estimate": "self, sweep",
    "Campaign.run": "self, stops=None, *, out=None",
    "Campaign.chain": "self, stops=None",
    "Paths.plot": "self, *arguments, **options",
    "Paths.to_xarray": "self",
    "Paths.to_dataframe": "self",
    "Scene.to_xarray": "self",
    "Scores.to_xarray": "self",
    "random_arena": "rng, difficulty=0.5, n_stops=10",
    "load_scene": "name_or_path, frequency_hz=60000000000.0",
}


@pytest.mark.parametrize(("name", "wanted"), SIGNATURES.items())
def test_public_signatures_stay(name: str, wanted: str) -> None:
    first, _, method = name.partition(".")
    function = getattr(getattr(ia, first), method) if method else getattr(ia, first)
    plain = [
        parameter.replace(annotation=inspect.Parameter.empty)
        for parameter in inspect.signature(function).parameters.values()
    ]
    assert str(inspect.Signature(plain)) == f"({wanted})"


def cuts_off_nothing(pixels: FloatArray) -> None:
    """The edges of a picture (row, column, rgba) are white: no legend and no label runs out of it."""
    assert all((edge[:, :3] == 1.0).all() for edge in (pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]))


@pytest.mark.whole
def test_ten_lines_of_the_readme(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    block = next(part for part in text.split("```python\n")[1:] if part.startswith("import isac_arena as ia"))
    lines = block.partition("```")[0].strip().splitlines()
    assert len([line for line in lines if line]) <= 10
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(compile("\n".join(lines), "README.md", "exec"), names)
    assert {"circle", "wall"} <= set(names["mapping"].contours.kind.tolist())
    assert names["scores"].value("mapping.ip_to_surface.median_m") < 0.05
    cuts_off_nothing(plt.imread(tmp_path / "contours.png"))
    plt.close("all")


def test_settings_change_by_tables_and_by_paths() -> None:
    base = ia.load_campaign("box_room")
    table = {"link": {"tx_power_dbm": -5.0}, "scene.objects.pillar.contour.radius_m": 0.4}
    changed = ia.load_campaign("box_room", seed=7, **table)
    assert changed.config.link.tx_power_dbm == -5.0 and changed.config.seed == 7
    assert changed.config.link.noise_figure_db == base.config.link.noise_figure_db
    assert changed.config.shapes == base.config.shapes
    assert changed.scene.object("pillar").contour.radius_m == 0.4  # type: ignore[attr-defined]
    with pytest.raises(ConfigError, match=r"^campaign box_room: link.tx_power = 1: .*did you mean tx_power"):
        ia.load_campaign("box_room", link={"tx_power": 1})
    with pytest.raises(ValueError, match=r"^scene\.walk\.nstops = 3: unknown key; did you mean n_stops\?$"):
        ia.load_campaign("box_room", **{"scene.walk.nstops": 3})


def same_scene(one: Scene, other: Scene) -> None:
    assert one.object_names == other.object_names and one.kinds == other.kinds
    for name in one.object_names:
        a, b = one.object(name), other.object(name)
        np.testing.assert_allclose(a.contour.vertices(0.01), b.contour.vertices(0.01), atol=1e-9)
        assert (a.z_min_m, a.z_max_m, a.material) == (b.z_min_m, b.z_max_m, b.material)
    assert (one.floor, one.ceiling) == (other.floor, other.ceiling)
    for pose, there in zip([one.tx, *one.stops], [other.tx, *other.stops], strict=True):
        np.testing.assert_allclose(pose.position_m, there.position_m, atol=1e-9)
        assert pose.heading_rad == pytest.approx(there.heading_rad, abs=1e-9)


@pytest.mark.parametrize("seed", range(100, 106))
def test_a_scene_made_in_python_becomes_a_scene_file(seed: int) -> None:
    scene = ia.random_arena(np.random.default_rng(seed), 0.6)
    tables = scene_tables(scene)
    assert {"itu": "concrete"}.items() <= tables["materials"]["concrete"].items()
    same_scene(SceneConfig.model_validate(tables).build(60e9), scene)


@pytest.mark.parametrize("stop", [-1, 4])
def test_a_stop_that_is_not_there_is_named(stop: int) -> None:
    with pytest.raises(ValueError, match=f"stops = {stop}: must be within 0 and 3"):
        ia.load_campaign("box_room").trace([0, stop])


@pytest.mark.parametrize(
    ("call", "wanted"),
    [
        (lambda one: one.trace(2), "stops = 2 is of type int: must be a list of int"),
        (lambda one: one.trace([True]), r"stops\[0\] = True is of type bool: must be int"),
        (lambda one: one.trace(np.array([0.0])), r"stops\[0\] = 0.0 is of type float64: must be int"),
        (lambda one: one.run([9]), "stops = 9: must be within 0 and 3"),
        (lambda one: one.scene.plot(ax=5), "ax = 5 is of type int: must be Axes or None"),
        (lambda one: one.scene.plot(view="4d"), "view = '4d': must be one of plan, 3d, delay"),
        (lambda one: ia.slam(one, []), r"channel = \[\]: must hold the estimate of one stop"),
        (lambda one: ia.run(one, "out", estimator=print), "estimator = ... is of type builtin_function_or_method"),
        (lambda one: ia.run(one, "out", workers=0), "workers = 0: must be 1 or more"),
        (lambda one: ia.run(one, "out", seed="x"), "seed = 'x' is of type str: must be int or None"),
        (lambda one: ia.random_arena(np.random.default_rng(1), n_stops="x"), "n_stops = 'x' is of type str"),
        (lambda one: ia.rectangle(1, 2), "x_m = 1 is of type int: must be a list of float"),
        (lambda one: ia.Circle("a", 1.0), "Circle.center_m = 'a': must be float64"),
        (lambda one: one.observe("x"), "truth = 'x' is of type str: must be Truth"),
        (lambda one: one.estimate(one), "sweep = ... is of type Campaign: must be BeamSweep"),
        (lambda one: ia.load_campaign(3), "source = 3 is of type int: must be str or Path"),
        (lambda one: ia.load_scene(3), "name_or_path = 3 is of type int"),
        (ia.estimate_channel, "sweep = ... is of type Campaign: must be BeamSweep"),
        (lambda one: ia.map_points(1, [], []), "campaign = 1 is of type int: must be Campaign"),
        (lambda one: ia.slam(one, [4]), r"channel\[0\] = 4 is of type int: must be ChannelEstimate"),
        (lambda one: ia.fit_contours(one, 4, 1, 2), "channel = 4 is of type int: must be a list of Chan"),
        (lambda one: ia.track(one, None, None), "channel = None is of type NoneType"),
        (lambda one: ia.score(one, 5, []), "truths = 5 is of type int: must be a list of Truth"),
        (lambda one: ia.run(None, "out"), "campaign = None is of type NoneType: must be Campaign or str or Path"),
        (lambda one: ia.open(5), "directory = 5 is of type int: must be str or Path"),
        (lambda one: ia.read_record(5, ia.Truth), "path = 5 is of type int"),
        (lambda one: ia.is_still(5), "estimate = 5 is of type int"),
        (lambda one: ia.known_receiver(5), "truths = 5 is of type int"),
        (lambda one: ia.make_link(5), "config = 5 is of type int"),
        (lambda one: ia.make_map(5, [], None), "config = 5 is of type int"),
        (lambda one: ia.observe(5, None, None, None), "config = 5 is of type int"),
        (lambda one: next(ia.simulate_truth(5, None, [])), "config = 5 is of type int"),
        (lambda one: ia.contours_of([1], None, None), r"outlines\[0\] = 1 is of type int: must be ObjectOut"),
        (lambda one: ia.random_arena(5), "rng = 5 is of type int: must be Generator"),
        (lambda one: ia.campaign_scene(5, "x"), "config = 5 is of type int"),
    ],
)
def test_an_argument_of_a_wrong_type_is_named(call: Callable[[ia.Campaign], Any], wanted: str) -> None:
    with pytest.raises(ValueError, match=f"^{wanted}"):
        call(ia.load_campaign("box_room"))


def test_the_method_of_a_campaign_holds() -> None:
    campaign = ia.load_campaign("box_room", channel={"method": "power"})
    [truth] = campaign.trace([0])
    sweep = campaign.observe(truth)
    estimate, ours = campaign.estimate(sweep), ia.estimate_channel(sweep, config=campaign.config.channel)
    assert estimate.method == "power"
    np.testing.assert_array_equal(estimate.delay_s, ours.delay_s)


def test_a_campaign_made_in_python_has_a_directory(tmp_path: Path) -> None:
    scene = ia.random_arena(np.random.default_rng(100), 0.2, n_stops=3)
    campaign = ia.load_campaign({"name": "mine", "scene": "-"}, scene=scene, waveform={"comb": 12})
    store = campaign_store(campaign, tmp_path / "out")
    store.open_for_writing()
    same_scene(store.scene, campaign.scene)
    room = tomllib.loads(ia.load_campaign("box_room").source.text)
    room["walk"] = {"type": "drops", "n_stops": 5, "seed": 3, "height_m": 1.5}
    dropped = ia.load_campaign("box_room", scene=room)
    assert len(dropped.stops) == 5 and dropped.config.shapes == ia.load_campaign("box_room").config.shapes
    with pytest.raises(ConfigError, match=r"scene: walk.step = 1"):
        ia.load_campaign("box_room", scene={**room, "walk": {**room["walk"], "step": 1}})


def test_a_record_in_xarray_is_what_its_file_holds(campaign: MadeCampaign, tmp_path: Path) -> None:
    store = campaign_store(ia.load_campaign("box_room"), tmp_path / "out")
    truth = campaign.truths[0]
    store.write_truth(truth)
    with xr.open_datatree(tmp_path / "out/truth/stop_000.nc", engine="h5netcdf") as stored:
        made = truth.to_xarray()
        assert set(made.children) == set(stored.children)
        paths = stored["paths"].dataset
        assert paths["is_los"].values.tolist() == truth.paths.is_los.tolist() and paths["is_los"].values.sum() == 1
        for name in paths.data_vars:
            if not str(name).startswith("gain_"):
                np.testing.assert_array_equal(paths[name].values, made["paths"][name].values)
                assert paths[name].attrs["units"] == made["paths"][name].attrs["units"]


def test_scores_in_xarray_have_all_metrics_and_their_tables(
    campaign: MadeCampaign, true_power: Callable[[ia.Truth], FloatArray]
) -> None:
    limits = Significance(noise_threshold_dbm=-150.0, dynamic_range_db=28.0)
    scores = score_campaign(
        campaign.scene, campaign.truths, campaign.results, true_power_dbm=true_power, significance=limits
    )
    made = scores.to_xarray()
    assert made["metric"].values.tolist() == [metric.key for metric in scores.metrics]
    position = made["value"].sel(metric="slam.position.rmse_m")
    assert float(position) == scores.value("slam.position.rmse_m")
    assert str(made["unit"].sel(metric="slam.position.rmse_m").values) == "m"
    errors = made["poses"]["position_error_m"]
    np.testing.assert_array_equal(errors.values, scores.tables.poses.position_error_m)
    assert "ips" in made["mapping"].children and "tracks" not in made.children


def test_a_scene_in_xarray_has_its_objects_meshes_corners_and_stops(campaign: MadeCampaign) -> None:
    box = trimesh.creation.box(bounds=[[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    mesh = Clutter("cart", "clutter", campaign.scene.objects[0].material, box.vertices, np.asarray(box.faces))
    scene = replace(campaign.scene, clutter=(mesh,))
    made = scene.to_xarray()
    assert made["object"].values.tolist() == [*scene.object_names, "cart"]
    assert made["is_mesh"].values.sum() == 1 and bool(made["is_closed"].sel(object="cart"))
    assert made["high_m"].sel(object="cart").values.tolist() == [1.0, 1.0, 1.0] and made["low_m"].units == "m"
    item = scene.object("wall_east")
    of_wall = made["corner_object"].values == scene.object_names.index("wall_east")
    np.testing.assert_allclose(made["corner_m"].values[of_wall], item.contour.vertices(1e-3))
    np.testing.assert_array_equal(made["stop_position_m"].values, [pose.position_m for pose in scene.stops])
    assert made["tx"].values.tolist() == list(scene.txs)
    table = scene.to_dataframe()
    assert table["object"].tolist() == made["object"].values.tolist() and table["low_z_m"].iloc[-1] == 0.0
    with pytest.raises(TypeError, match=r"Campaign holds no arrays of its own; its parts: .*link"):
        ia.load_campaign("box_room").to_xarray()


def test_stops_that_do_not_belong_together_are_named(campaign: MadeCampaign) -> None:
    room, channel, truths = ia.load_campaign("box_room"), campaign.results.channel[:2], campaign.truths
    poses, points = campaign.results.mapping.poses, campaign.results.mapping.ips
    for call in (
        lambda: ia.map_points(room, channel, truths[:1]),
        lambda: ia.map_points(room, channel, truths[1::-1]),
        lambda: ia.fit_contours(room, channel, poses, points),
        lambda: ia.track(room, channel, poses),
    ):
        with pytest.raises(ValueError, match=r"^(truths|poses): stops \[.*\]: must be those of .*: \[0, 1\]$"):
            call()


def test_an_unknown_score_names_similar_ones() -> None:
    scores = ia.Scores([Metric("slam.position.rmse_m", 0.1, "m", "lower")], None)  # type: ignore[arg-type]
    assert scores.value("slam.position.rmse_m") == 0.1
    with pytest.raises(KeyError, match=r"slam.position: no such metric; did you mean slam.position.rmse_m"):
        scores.value("slam.position")


def is_whole(axes: Any) -> None:
    """A picture shows something, and its edges cut off nothing."""
    assert axes.has_data()
    axes.figure.canvas.draw()
    cuts_off_nothing(np.asarray(axes.figure.canvas.buffer_rgba()) / 255)


def test_records_are_tables_texts_and_pictures(campaign: MadeCampaign, tmp_path: Path) -> None:
    truth, estimate, mapping = campaign.truths[0], campaign.results.channel[0], campaign.results.mapping
    table = truth.paths.to_dataframe()
    assert len(table) == len(truth.paths) and table["is_los"].sum() == 1
    points = mapping.ips.to_dataframe()
    np.testing.assert_array_equal(points[["position_x_m", "position_y_m"]], mapping.ips.position_m)
    with pytest.raises(TypeError, match="MapResult is no table; use to_xarray, or one of its parts: poses, ips"):
        mapping.to_dataframe()
    with pytest.raises(TypeError, match=r"FinishedRun is no table; its parts: .*truths, .*scores"):
        ia.FinishedRun(campaign_store(ia.load_campaign("box_room"), tmp_path)).to_dataframe()
    store = campaign_store(ia.load_campaign("box_room"), tmp_path / "out")
    store.open_for_writing()
    assert repr(ia.FinishedRun(store)) == f"FinishedRun('box_room' in {tmp_path / 'out'}, 4 stops: no scores yet)"
    for record in (truth, estimate, mapping, mapping.poses, mapping.ips, mapping.contours):
        assert repr(record).startswith(type(record).__name__) and len(repr(record)) < 500
        assert "state2" not in repr(record) and not re.search(r"\d{7}", repr(record))
        assert "<table" in record._repr_html_()
        is_whole(record.plot(scene=campaign.scene))
    for view in ("plan", "3d"):
        is_whole(campaign.scene.plot(view=view))
        is_whole(truth.plot(campaign.scene, view=view))
    is_whole(campaign.results.power_maps[0].plot())
    with pytest.raises(TypeError, match="Pose has no picture; these have"):
        truth.rx_pose.plot()
    plt.close("all")

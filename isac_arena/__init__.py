"""ISAC Arena: from a scene to scored object shapes. These are the public names.

>>> import isac_arena as ia
>>> campaign = ia.load_campaign("box_room")
>>> truths = campaign.trace([0, 1])
>>> estimates = [campaign.estimate(campaign.observe(truth)) for truth in truths]
>>> mapping = ia.fit_contours(campaign, estimates, *ia.map_points(campaign, estimates, truths))
>>> ia.score(campaign, truths, estimates, mapping).value("mapping.ip_to_surface.median_m") < 0.1
True

A name is imported when it is first used, so `import isac_arena` is fast. Read `api.py` first, and
`campaign/driver.py` for the method: the chain from truths to scores.

`campaign/`  settings, the chain and its files    `cli/`        the `arena` command
`scoring/`   estimates against the truth          `report/`     figures and pages
`insight/`   error budget, comparison, twin       `sweep/`      many campaigns
`exchange/`  formats of other tools               `validation/` checks and benches, each with its bar
"""

from importlib import import_module
from typing import Any

from isac_arena.own_packages import ROOT, check_own_packages

check_own_packages()
from scenes.display import HOMES as DISPLAY_HOMES  # noqa: E402  (only now surely ours)

HOMES = {
    "estimation.channel.estimate": ("estimate_channel",),
    "estimation.channel.record": ("ChannelEstimate",),
    "estimation.channel.still": ("is_still",),
    "estimation.shape.outline": ("ObjectOutline", "contours_of"),
    "estimation.shape.record": ("Contours", "Shapes"),
    "estimation.slam.record": ("IncidencePoints", "PoseEstimates"),
    "estimation.tracks.record": ("EchoSurvey", "Tracks"),
    "isac_arena.api": ("FinishedRun", "fit_contours", "map_points", "open", "run", "score", "slam", "track"),
    "isac_arena.campaign.campaign": ("Campaign", "load_campaign"),
    "isac_arena.campaign.chain.inputs": ("known_receiver",),
    "isac_arena.campaign.chain.maps": ("make_map",),
    "isac_arena.campaign.chain.memory": ("MemoryRun",),
    "isac_arena.campaign.config": ("CampaignConfig",),
    "isac_arena.campaign.directory": ("open_campaign",),
    "isac_arena.campaign.driver": ("CampaignRun",),
    "isac_arena.campaign.files": ("read_record",),
    "isac_arena.campaign.load": ("campaign_scene", "library_campaigns"),
    "isac_arena.campaign.results": ("MapResult",),
    "isac_arena.scoring.score": ("Scores",),
    "scenes.config": ("library_scenes", "load_scene"),
    "scenes.contours.polygons": ("Polygon", "Polyline", "RoundedPolygon", "rectangle"),
    "scenes.contours.smooth": ("Circle", "ClosedSpline", "Ellipse", "OpenSpline"),
    "scenes.objects.material": ("Material", "itu_material"),
    "scenes.pose": ("Pose",),
    "scenes.random_arena": ("random_arena",),
    "scenes.scene": ("HorizontalPlane", "Scene", "SceneObject"),
    "scenes.walks.trajectory": ("RecordedWalk", "Walk"),
    "sim.config": ("SimulationConfig",),
    "sim.observation": ("BeamSweep",),
    "sim.propagation.paths": ("Paths",),
    "sim.signal.arrays.codebook": ("Codebook",),
    "sim.signal.link": ("make_link",),
    "sim.simulate": ("observe", "simulate_truth"),
    "sim.truth": ("Truth",),
}
DISPLAY_HOMES.update(
    plot="isac_arena.report.records",
    html="isac_arena.report.records",
    to_xarray="isac_arena.exchange.frames",
    to_dataframe="isac_arena.exchange.frames",
)
OF_CAMPAIGNS = ("estimate", "plot", "trace")  # looked for here
MODULES = ("datasets",)  # of functions that belong together
_HOME_OF = {name: module for module, names in HOMES.items() for name in names}
__all__ = sorted([*_HOME_OF, *MODULES, "__version__"])  # noqa: PLE0605  (the stub lists them for type checkers)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        value = _version()
    elif name in MODULES:
        value = import_module(f"isac_arena.{name}")
    elif name in _HOME_OF:
        value = getattr(import_module(_HOME_OF[name]), name)
    else:
        hint = f"; write load_campaign(NAME).{name}()" if name in OF_CAMPAIGNS else ""
        raise AttributeError(f"module 'isac_arena' has no attribute '{name}'{hint}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def _version() -> str:
    """The version of the installed package; in a checkout that is not installed, that of its pyproject.toml."""
    from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415

    try:
        return version("isac-arena")
    except PackageNotFoundError:
        from scenes.toml_config import read_toml  # noqa: PLC0415

        return str(read_toml(ROOT / "pyproject.toml")["project"]["version"])

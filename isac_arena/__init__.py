"""ISAC Arena: from a scene to scored object shapes. These are the public names.

>>> from isac_arena import campaign_scene, estimate_channel, load_campaign, make_link, observe, simulate_truth
>>> config, scene_file = load_campaign("box_room")
>>> scene, link = campaign_scene(config, scene_file), make_link(config)
>>> truth = next(simulate_truth(config, scene, [0]))
>>> estimate = estimate_channel(observe(config, link, scene, truth), config=config.channel)

A name is imported when it is first used, so `import isac_arena` is fast. Read `campaign/driver.py` first for the
method: the chain from truths to scores.

`campaign/`  settings, the chain and its files    `cli/`        the `arena` command
`scoring/`   estimates against the truth          `report/`     figures and pages
`insight/`   error budget, comparison, twin       `sweep/`      many campaigns
`exchange/`  formats of other tools               `validation/` checks and benches, each with its bar
"""

from importlib import import_module
from typing import Any

from isac_arena.own_packages import ROOT, check_own_packages

check_own_packages()

HOMES = {
    "estimation.channel.estimate": ("estimate_channel",),
    "estimation.channel.record": ("ChannelEstimate",),
    "estimation.shape.record": ("Contours", "Shapes"),
    "estimation.slam.record": ("IncidencePoints", "PoseEstimates"),
    "isac_arena.campaign.chain": ("known_receiver", "make_map"),
    "isac_arena.campaign.config": ("CampaignConfig",),
    "isac_arena.campaign.directory": ("open_campaign",),
    "isac_arena.campaign.driver": ("CampaignRun",),
    "isac_arena.campaign.files": ("read_record",),
    "isac_arena.campaign.load": ("campaign_scene", "load_campaign"),
    "scenes.config": ("load_scene",),
    "scenes.pose": ("Pose",),
    "scenes.scene": ("Scene",),
    "sim.config": ("SimulationConfig",),
    "sim.observation": ("BeamSweep",),
    "sim.propagation.paths": ("Paths",),
    "sim.signal.link": ("make_link",),
    "sim.simulate": ("observe", "simulate_truth"),
    "sim.truth": ("Truth",),
}
_HOME_OF = {name: module for module, names in HOMES.items() for name in names}
__all__ = sorted([*_HOME_OF, "__version__"])  # noqa: PLE0605  (the stub lists them for type checkers)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        value = _version()
    elif name in _HOME_OF:
        value = getattr(import_module(_HOME_OF[name]), name)
    else:
        raise AttributeError(f"module 'isac_arena' has no attribute '{name}'")
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

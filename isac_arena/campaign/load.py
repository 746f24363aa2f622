"""Campaign files: found by library name or path, with the scene they name."""

from pathlib import Path
from typing import Any

from isac_arena.campaign.config import CampaignConfig, with_link_levels
from scenes.config import load_scene, scene_path
from scenes.scene import Scene
from scenes.toml_config import ConfigError, read_toml, validate_config

LIBRARY = Path(__file__).parent / "library"


def load_campaign(name_or_path: str, seed: int | None = None) -> tuple[CampaignConfig, Path]:
    """The settings of a campaign, with the seed replaced where one is given, and the file of its scene.

    Scene and beam weight files are looked up beside the campaign file that names them.

    Raises `ConfigError`, one line naming file, field, value and what is allowed.
    """
    path = campaign_path(name_or_path)
    config, scene_file = resolve_campaign(read_toml(path), path)
    return (config if seed is None else config.model_copy(update={"seed": seed})), scene_file


def resolve_campaign(document: dict[str, Any], path: Path) -> tuple[CampaignConfig, Path]:
    """The settings in the tables of a campaign file at `path`, and the file of its scene.

    Raises `ConfigError` as `load_campaign` does.
    """
    config = validate_config(document, CampaignConfig, str(path))
    for device in ("tx_array", "rx_array"):
        array = getattr(config, device)
        if array.weights_file is not None:
            file = str((path.parent / array.weights_file).resolve())
            config = config.model_copy(update={device: array.model_copy(update={"weights_file": file})})
    if config.propagation.deepmimo is not None:
        folder = str((path.parent / config.propagation.deepmimo).resolve())
        propagation = config.propagation.model_copy(update={"deepmimo": folder})
        config = config.model_copy(update={"propagation": propagation})
    config = with_link_levels(config)
    is_file = config.scene.endswith(".toml")
    return config, path.parent / config.scene if is_file else scene_path(config.scene)


def campaign_scene(config: CampaignConfig, scene_file: Path) -> Scene:
    """The scene of a campaign, materials at its carrier, with the TX and the walk that it names in use.

    Raises `ConfigError` where the scene file is wrong, `ValueError` where it has no TX or walk of that name.
    """
    return scene_in_use(scene_file, config.waveform.carrier_ghz, config.tx, config.walk)


def scene_in_use(scene_file: Path, carrier_ghz: float, tx: str | None, walk: str | None) -> Scene:
    """A scene, materials at a carrier, with a TX and a walk by name in use, or its first ones.

    Raises as `campaign_scene` does.
    """
    return load_scene(scene_file, carrier_ghz * 1e9).choose(tx or 0, walk or 0)


def campaign_path(name_or_path: str) -> Path:
    """The file of a campaign: a name of the library, or the path of a TOML file."""
    if name_or_path.endswith(".toml"):
        return Path(name_or_path)
    names = sorted(file.stem for file in LIBRARY.glob("*.toml"))
    if name_or_path not in names:
        known = ", ".join(names)
        raise ConfigError(f"campaign = '{name_or_path}': must be one of {known}, or the path of a .toml file")
    return LIBRARY / f"{name_or_path}.toml"

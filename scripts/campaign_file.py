"""Campaign files: found by library name or path, with the scene they name."""

from __future__ import annotations

from pathlib import Path

from estimation.config import CampaignConfig, with_link_levels
from scenes.config import scene_path
from scenes.toml_config import ConfigError, load_config

LIBRARY = Path(__file__).parent / "campaigns"


def load_campaign(name_or_path: str, seed: int | None = None) -> tuple[CampaignConfig, Path]:
    """The settings of a campaign, with the seed replaced where one is given, and the file of its scene.

    Scene and beam weight files are looked up beside the campaign file that names them.

    Raises `ConfigError`, one line naming file, field, value and what is allowed.
    """
    path = campaign_path(name_or_path)
    config = load_config(path, CampaignConfig)
    if seed is not None:
        config = config.model_copy(update={"seed": seed})
    for device in ("tx_array", "rx_array"):
        array = getattr(config, device)
        if array.weights_file is not None:
            file = str((path.parent / array.weights_file).resolve())
            config = config.model_copy(update={device: array.model_copy(update={"weights_file": file})})
    config = with_link_levels(config)
    is_file = config.scene.endswith(".toml")
    return config, path.parent / config.scene if is_file else scene_path(config.scene)


def campaign_path(name_or_path: str) -> Path:
    """The file of a campaign: a name of the library, or the path of a TOML file."""
    if name_or_path.endswith(".toml"):
        return Path(name_or_path)
    names = sorted(file.stem for file in LIBRARY.glob("*.toml"))
    if name_or_path not in names:
        known = ", ".join(names)
        raise ConfigError(f"campaign = '{name_or_path}': must be one of {known}, or the path of a .toml file")
    return LIBRARY / f"{name_or_path}.toml"

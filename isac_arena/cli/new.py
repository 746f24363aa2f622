"""`arena new`: commented files to start from. `arena settings`: what may stand in them."""

import sys
from enum import StrEnum
from importlib.machinery import PathFinder
from keyword import iskeyword
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from isac_arena.settings import SettingTable

TEMPLATES = Path(__file__).parent / "templates"
COMMENT_COLUMN = 38

app = typer.Typer(help="Commented files to start from: they run as they are.", no_args_is_help=True)

NewName = Annotated[str, typer.Argument(help="Name of the new file, without ending; written into this folder.")]


@app.command("campaign")
def new_campaign(
    name: NewName,
    scene: Annotated[str, typer.Option(help="Scene: library name, or path of a TOML file.")] = "box_room",
) -> None:
    """Write NAME.toml: a campaign with every setting, its default and what it does, as comments."""
    from isac_arena.settings import setting_tables  # noqa: PLC0415
    from scenes.config import load_scene  # noqa: PLC0415

    load_scene(scene)
    head = f"# `arena run {name}.toml --out out/{name}` runs this campaign. Remove a # to change a setting.\n"
    given = {"name": name, "scene": scene, "seed": 1}
    _write(name, ".toml", head + "".join(_table_text(table, given) for table in setting_tables("campaign")))


@app.command("scene")
def new_scene(
    name: NewName,
    random: Annotated[
        int | None, typer.Option(min=0, help="Seed of a random arena in place of the example.")
    ] = None,
    difficulty: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Random: from an empty room to a cluttered hall.")
    ] = 0.5,
    stops: Annotated[int, typer.Option(min=1, help="Random: stops of its walk.")] = 20,
) -> None:
    """Write NAME.toml: a scene to change, or a random arena with pillars, partitions and boxes."""
    if random is None:
        _write(name, ".toml", _template("scene.toml", name))
        return
    import numpy as np  # noqa: PLC0415
    import tomli_w  # noqa: PLC0415

    from scenes.random_arena import random_arena  # noqa: PLC0415
    from scenes.tables import scene_tables  # noqa: PLC0415

    arena = random_arena(np.random.default_rng(random), difficulty, stops)
    head = (
        f"# A random arena: seed {random}, difficulty {difficulty:g}. `arena scene show {name}.toml` draws it.\n"
    )
    _write(name, ".toml", head + tomli_w.dumps({**scene_tables(arena), "name": name}))


@app.command("sweep")
def new_sweep(name: NewName) -> None:
    """Write NAME.toml: a sweep over two fields."""
    _write(name, ".toml", _template("sweep.toml", name))


class NewStage(StrEnum):
    """Stages that a function of a user can replace."""

    channel = "channel"
    mapping = "mapping"
    slam = "slam"
    shapes = "shapes"
    tracker = "tracker"


@app.command("estimator")
def new_estimator(
    name: NewName,
    stage: Annotated[NewStage, typer.Option(help="The stage that it takes the place of.")] = NewStage.channel,
) -> None:
    """Write NAME.py, a function of your own in place of a stage, and test_NAME.py, which tests it."""
    if not name.isidentifier():
        raise ValueError(f"name = '{name}': must be a Python name: letters, digits and _, no digit first")
    if iskeyword(name) or name in sys.stdlib_module_names or _is_installed(name):
        raise ValueError(f"name = '{name}': must not hide a word or module of Python; choose another")
    _write(name, ".py", _template(f"{stage.value}.txt", name))
    _write(f"test_{name}", ".py", _template(f"test_{stage.value}.txt", name))


def settings(
    table: Annotated[
        str | None,
        typer.Argument(
            help="Kind of file (campaign, scene, sweep, dataset, recording), or one of its tables: channel.los."
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Write the whole page as Markdown to this file.")] = None,
) -> None:
    """List settings with default, unit, what is allowed and what they do."""
    from rich.console import Console  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415
    from rich.text import Text  # noqa: PLC0415

    from isac_arena.campaign.files import write_text  # noqa: PLC0415
    from isac_arena.settings import FILES, merged_tables, settings_page  # noqa: PLC0415

    console = Console(highlight=False)
    if out is not None:
        write_text(out, settings_page())
        console.print(f"settings: {out}")
        return
    files = [table] if table in FILES else list(FILES)
    shown = [one for file in files for one in merged_tables(file) if table in (None, file) or one.is_called(table)]
    if not shown:
        known = ", ".join(
            dict.fromkeys(name for file in FILES for one in merged_tables(file) for name in one.names)
        )
        raise ValueError(f"table = '{table}': must be {', '.join(FILES)} or one of {known}")
    for one in shown:
        rows = Table(
            "setting", "default", "unit", "allowed", "what it does", title=Text(one.title), title_justify="left"
        )
        for row in one.settings:
            rows.add_row(row.name, row.default, row.unit, row.allowed.replace("`", ""), row.meaning)
        console.print(rows)


def _is_installed(module: str) -> bool:
    """Whether Python finds a module outside the working folder, where files of a user may lie."""
    elsewhere = [folder for folder in sys.path if Path(folder).resolve() != Path.cwd()]
    return PathFinder.find_spec(module, elsewhere) is not None


def _table_text(table: "SettingTable", given: dict[str, object]) -> str:
    """A table of a commented file: what is given stands, all other fields are comments with their default."""
    lines = [""]
    if table.heading:
        lines.append(f"# {table.about}")
        lines.append(f"{'# ' if table.is_optional else ''}{table.heading}")
    for row in table.settings:
        value = given.get(row.name) if not table.heading else None
        shown = row.default if row.default != "none" else "..."
        line = f"# {row.name} = {shown}" if value is None else f"{row.name} = {_toml(value)}"
        unit = f" ({row.unit})" if row.unit != "-" else ""
        lines.append(f"{line:<{COMMENT_COLUMN}}  # {row.meaning}{unit}: {row.allowed.replace('`', '')}")
    return "\n".join(lines) + "\n"


def _toml(value: object) -> str:
    return f'"{value}"' if isinstance(value, str) else str(value)


def _template(file: str, name: str) -> str:
    return (TEMPLATES / file).read_text(encoding="utf-8").replace("NAME", name)


def _write(name: str, ending: str, text: str) -> None:
    """Write a new file into the working folder; `ValueError` where it exists."""
    from isac_arena.campaign.files import write_text  # noqa: PLC0415
    from scenes.names import checked_name  # noqa: PLC0415

    try:
        file = Path(f"{checked_name(name)}{ending}")
    except ValueError as error:
        raise ValueError(f"name = {name!r}: {error}") from error
    if file.exists():
        raise ValueError(f"{file}: is there already; choose another name")
    write_text(file, text)
    typer.echo(f"{file}: written")

"""Arguments and options that several commands share, each defined once."""

from pathlib import Path
from typing import Annotated

import typer

Campaign = Annotated[str, typer.Argument(help="Campaign name of the library, or path of a TOML file.")]
Directory = Annotated[Path, typer.Argument(help="Directory of a campaign.")]
Out = Annotated[Path, typer.Option(help="Directory of the campaign; made where missing.")]
OutFolder = Annotated[Path, typer.Option(help="Directory of the tables and figures; made where missing.")]
Seed = Annotated[int | None, typer.Option(min=0, max=2**63 - 1, help="Seed, in place of the file's.")]
RandomSeed = Annotated[int, typer.Option(min=0, help="Seed of all random numbers of this command.")]
Estimator = Annotated[
    str | None, typer.Option(help="Your channel estimator: package.module:function, BeamSweep to ChannelEstimate.")
]
KeepSweeps = Annotated[bool, typer.Option(help="Keep the samples of every stop (about 40 MB each).")]
Json = Annotated[Path | None, typer.Option("--json", help="Write the rows to this JSON file as well.")]
Quick = Annotated[bool, typer.Option("--quick", help="A subset that takes seconds.")]

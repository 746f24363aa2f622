"""Tables of `arena compare` on the terminal: differences of scores and of settings, for 80 columns or more."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from rich.box import SIMPLE
from rich.markup import escape
from rich.table import Table

from isac_arena.insight.comparison.difference import MIN_GROUPS
from isac_arena.insight.comparison.names import GROUPS, group_of, name_of
from isac_arena.scoring.words import legend

if TYPE_CHECKING:
    from isac_arena.insight.comparison.difference import PairedDifference
    from isac_arena.insight.comparison.runs import RunComparison
    from isac_arena.setting_differences import SettingDifference

COLORS = {"better": "green", "worse": "bold red", "different": "magenta", "same": "dim", "undecided": "dim"}
LONGEST_VALUE = 160
NAME_WIDTH = 18  # holds every heading and most names
COUNTS_WIDTH = 7  # of the numbers of pairs, which break into two lines


def difference_table(compared: RunComparison) -> Table:
    """One row for each quantity of a run, under a heading for each group of quantities."""
    paired = [one for one in compared.differences if one.n_pairs]
    chance = round(0.05 * len(paired))
    table = Table(
        "quantity", "A", "B", "B - A (95 % interval)", "n", "B is",
        title=f"Paired differences over {compared.n_stops} stops", caption_justify="left",
        caption="A, B: means over the pairs, of absolute errors (tables of scores have RMSE over all).\n"
        "n: pairs of stops, paths or objects that both runs have, and their numbers in A|B where these are"
        " larger: a run that finds fewer is compared where it does.\n"
        "Intervals: bootstrap over stops or objects. A difference counts where the signed-rank test rejects"
        f" as well; of {len(paired)} quantities about {chance} differ by chance.",
        box=SIMPLE, padding=0, show_edge=False,  # the box separates columns by a space
    )  # fmt: skip
    for index, column in enumerate(table.columns):
        column.overflow = "fold"
        column.no_wrap = 0 < index < 4
        column.justify = "right" if index in (1, 2, 4) else "left"
    table.columns[0].min_width = NAME_WIDTH
    table.columns[4].max_width = COUNTS_WIDTH
    group = ""
    for one in sorted(compared.differences, key=lambda one: list(GROUPS.values()).index(group_of(one.key))):
        if group_of(one.key) != group:
            group = group_of(one.key)
            table.add_row(f"[bold]{group}[/]")
        name = name_of(one.key)
        table.add_row(f"{name}, {one.unit}" if one.unit != "1" else name, *_cells(one))
    return table


def difference_words(compared: RunComparison) -> Iterator[str]:
    """A line for every word of `difference_table` that needs one."""
    if any(one.verdict == "too few" for one in compared.differences):
        what = "stops" if compared.n_stops < MIN_GROUPS else "stops or objects"
        yield f"too few: no verdict under {MIN_GROUPS} {what} that have the quantity in both runs"
    if any(one.verdict == "undecided" for one in compared.differences):
        yield "undecided: the interval holds 0, or the test does not reject"
    yield from legend(f"{group_of(one.key)}, {name_of(one.key)}" for one in compared.differences)


def method_table(first: Mapping[str, str], second: Mapping[str, str]) -> Table:
    """One row for each stage of the chain whose method differs: one of ours, or a function of the user."""
    table = Table(
        "stage", "A", "B", title="Methods that differ", box=SIMPLE, padding=(0, 1, 0, 0), show_edge=False
    )
    for column in table.columns:
        column.overflow = "fold"
    for stage, method in first.items():
        if method != second[stage]:
            table.add_row(stage, escape(_value(method)), escape(_value(second[stage])))
    return table


def setting_table(differences: Iterable[SettingDifference]) -> Table:
    """One row for each setting that differs between the runs."""
    table = Table(
        "setting", "A", "B", title="Settings that differ", box=SIMPLE, padding=(0, 1, 0, 0), show_edge=False
    )
    for column in table.columns:
        column.overflow = "fold"
    for one in differences:
        table.add_row(escape(one.field), escape(_value(one.first)), escape(_value(one.second)))
    return table


def _cells(one: PairedDifference) -> list[str]:
    color = COLORS.get(one.verdict)
    verdict = f"[{color}]{one.verdict}[/]" if color else one.verdict
    counts = "" if one.n_first == one.n_second == one.n_pairs else f" of {one.n_first}|{one.n_second}"
    interval = "" if math.isnan(one.low) else f" ({one.low:.2g}, {one.high:.2g})"
    change = "-" if math.isnan(one.difference) else f"{one.difference:+.2g}{interval}"
    values = _number(one.first), _number(one.second), change
    return [*values, f"{one.n_pairs}{counts}", verdict]


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3g}"


def _value(value: Any) -> str:
    text = "not set" if value is None else value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]} ..."

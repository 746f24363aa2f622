"""The error budget that `arena budget` wrote into a campaign directory, for the report page."""

from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ValidationError

BUDGET_FILE = Path("budget") / "budget.json"  # of a campaign directory


class BudgetRow(BaseModel):
    """One part of an error: its mean square, the signed root of the mean square, and its share.

    `objection` is the reason for missing shares. `effect` says whether the error falls or grows without the part.
    """

    outcome: str
    budget: Literal["stages", "physics"]
    part: str
    objection: str
    effect: Literal["falls", "grows", "none", "undecided", ""]
    share: float | None
    share_low: float | None
    share_high: float | None
    mean_square_m2: float | None
    rms_m: float | None


class BudgetFile(BaseModel):
    """The part of a budget file that the page uses."""

    campaign: str
    rows: list[BudgetRow]


def read_budget(directory: Path, campaign: str) -> list[dict[str, Any]] | None:
    """Rows of the budget in a campaign directory, None where there is none.

    Raises `ValueError` where the file is damaged, is no error budget, is the budget of another campaign, or is
    missing where a budget ended.
    """
    path = directory / BUDGET_FILE
    if not path.is_file():
        if path.with_name("manifest.json").is_file():
            raise ValueError(f"{path}: missing; run 'arena budget' again, or remove {path.parent}")
        return None
    try:
        found = BudgetFile.model_validate_json(path.read_text(encoding="utf-8"))
    except (ValidationError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).splitlines()[:2])
        raise ValueError(f"{path}: no error budget ({reason}); run 'arena budget' again") from error
    if found.campaign != campaign:
        raise ValueError(f"{path}: is the budget of '{found.campaign}', not of '{campaign}'; remove it")
    return [row.model_dump() for row in found.rows]

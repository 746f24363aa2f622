"""The quick checks of several stages meet their bars: what `arena validate NAME --quick` runs, times left out."""

from __future__ import annotations

import pytest

from isac_arena.cli.validate import MODULES, _checks
from isac_arena.validation.measurement import Measured

LONG = (
    "motion samples", "motion decision", "motion rates", "motion tracks", "propagation against shooting",
    "scoring bounds of campaigns",
)  # fmt: skip
CHECKS = [
    pytest.param(check, id=f"{name} {title}", marks=[pytest.mark.slow] * (f"{name} {title}" in LONG))
    for name in ("propagation", "signal", "scoring", "motion")
    for title, check in _checks(MODULES[name], "check_")
]


@pytest.mark.whole
@pytest.mark.parametrize("check", CHECKS)
def test_bars_are_met(check):
    found = check(1, True)
    rows = found.rows if isinstance(found, Measured) else found
    if not rows:
        # the data that it compares with are not at hand
        pytest.skip(str(found.tables[0].rows[0]) if isinstance(found, Measured) else "nothing in a quick run")
    judged = [row for row in rows if not row.key.endswith(".time")]  # other work on the machine changes times
    missed = [f"{row.key} = {row.value:.6g} {row.unit}, bar {row.bar:.6g}" for row in judged if not row.met]
    assert not missed

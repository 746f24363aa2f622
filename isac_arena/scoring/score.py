"""The scores of a campaign: its metrics, and the tables behind them. `chain.py` makes them."""

from dataclasses import dataclass
from difflib import get_close_matches

from isac_arena.scoring.doubts import score_doubts
from isac_arena.scoring.headline import HEADS, bound_note, headline, headline_text
from isac_arena.scoring.metrics.metric import Metric
from isac_arena.scoring.record import ScoreTables
from isac_arena.scoring.words import legend
from scenes.display import Displayed


@dataclass(frozen=True, repr=False)
class Scores(Displayed):
    """All metrics of a campaign, and the tables that they are computed from."""

    metrics: tuple[Metric, ...]
    tables: ScoreTables

    def __repr__(self) -> str:
        n_stops = self.tables.stops.size("stop")
        doubts = "".join(f"; doubtful: {doubt}" for doubt in self.doubts)
        return f"Scores({len(self.metrics)} metrics over {n_stops} stops; .to_dataframe() has them all{doubts})"

    def __str__(self) -> str:
        doubts = (f"doubtful: {doubt}" for doubt in self.doubts)
        return "\n".join([headline_text(self.metrics), *self.legend, *doubts])

    @property
    def legend(self) -> tuple[str, ...]:
        """The meaning of every word of the main scores, a line each, and what stops without a bound mean."""
        labels = [text for label, _, unit in headline(self.metrics) for text in (label, unit)]
        note = bound_note(self.tables.poses)
        return tuple(filter(None, [*legend([*labels, *HEADS, *self.doubts]), note]))

    @property
    def doubts(self) -> tuple[str, ...]:
        """What the scores say is far off, and what to do; empty where nothing is."""
        return score_doubts(self.metrics)

    def value(self, key: str) -> float:
        """Value of one metric; a `KeyError` where there is none of that key names similar ones."""
        values = {metric.key: metric.value for metric in self.metrics}
        if key not in values:
            close = get_close_matches(key, values, n=3)
            hint = f"did you mean {' or '.join(close)}?" if close else ".to_dataframe() has them all"
            raise KeyError(f"{key}: no such metric; {hint}")
        return values[key]

"""Words are explained where they are shown, from one source."""

from isac_arena.insight.comparison.names import NAMES
from isac_arena.report.page.tables import (
    ACCEPTED,
    CHANNEL_COUNTS,
    CHANNEL_ERRORS,
    CONTOURS,
    MAPS,
    POSES,
    SHAPES,
    score_titles,
)  # fmt: skip
from isac_arena.scoring.headline import HEADLINE, HEADS
from isac_arena.scoring.words import WORDS, explained, legend, words_in, words_page

TABLES = (ACCEPTED, CHANNEL_COUNTS, CHANNEL_ERRORS, CONTOURS, MAPS, POSES, SHAPES)


def test_a_word_has_its_meaning_as_a_title_and_all_else_is_escaped() -> None:
    assert explained("Weak & diffuse <b>") == f'<abbr title="{WORDS["weak"]}">Weak</abbr> &amp; diffuse &lt;b&gt;'
    assert explained("weakness") == "weakness"


def test_a_legend_explains_the_words_of_its_own_lines_too() -> None:
    words = ["bound", "false", "GOSPA"]  # a GOSPA is of missed and false members
    assert list(legend(word for word in ["GOSPA of the bounds"])) == [f"{word}: {WORDS[word]}" for word in words]


def test_the_words_of_the_first_table_have_a_legend() -> None:
    assert {"published", "bound", "separable", "false", "stated"} <= set(
        words_in([*HEADS, *(r.label for r in HEADLINE)])
    )


def test_every_word_is_one_of_tables_pages_or_progress() -> None:
    shown = [text for table in TABLES for pair in (*table.columns, *table.rows) for text in pair[:1]]
    elsewhere = {
        "doubtful",
        "dynamic range",  # of the line of "significant"
        "gate",
        "self-calibration",
        "incidence point",
        "lit extent",
        "ramp",  # of what an estimator says of a stop
        "weak",
        "single bounce",
        "cone angle",  # of tables of runs with horizontal beams
    }
    rows = [*score_titles().values(), *HEADS, *(row.label for row in HEADLINE), *NAMES.values()]
    found = {*words_in([*shown, *rows]), *elsewhere}
    assert found == set(WORDS)


def test_the_page_of_words_has_all() -> None:
    assert all(f"| {word} | {meaning} |" in words_page() for word, meaning in WORDS.items())

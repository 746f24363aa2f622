"""The style of figures leaves everything else as it was set."""

from matplotlib import rcParams

from isac_arena.report.style import STYLE, styled


def test_a_figure_puts_back_the_settings_of_the_style_and_no_others() -> None:
    # A notebook sets "interactive" while its first figure is made; a figure is shown only where it stays set.
    before = {name: rcParams[name] for name in STYLE}
    interactive = rcParams["interactive"]

    @styled()
    def draw() -> float:
        rcParams["interactive"] = not interactive
        return float(rcParams["axes.linewidth"])

    try:
        assert draw() == STYLE["axes.linewidth"]
        assert {name: rcParams[name] for name in STYLE} == before
        assert rcParams["interactive"] is not interactive
    finally:
        rcParams["interactive"] = interactive

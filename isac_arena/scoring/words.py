"""What the words of scores mean, in a line each: the one source for tables, pages and the documentation."""

import re
from collections.abc import Iterable, Iterator
from html import escape

WORDS = {
    "published": "the paper's method on the same paths: snapshot SLAM of each stop alone, which takes all heights "
    "as equal, and contours of clusters",
    "bound": "Cramér-Rao bound: least RMSE from the paths of each stop alone, over the stops that have one; using "
    "other stops can beat it",
    "stated": "what SLAM says itself of its errors, from its covariances: known without the truth",
    "doubtful": "position, heading or clock over 5 times its bound, in all or at half of the stops, a position "
    "behind the published method, paths over 5 times their bounds in the median or 50 times in RMS, powers with "
    "an RMSE over 3 dB, errors over 3 times the stated ones, 95 % regions that hold less than 88 % of the truth, "
    "stated errors over 1.4 times the true ones, lines of sight told right at 75 % of the stops or less, or false "
    "contours",
    "cone angle": "the azimuth that a path would have without elevation: all that horizontal beams see",
    "in plan": "by x and y alone, without the height",
    "significant": "not diffuse, above the noise and within the dynamic range of the estimator",
    "dynamic range": "how far below the strongest path the estimator looks for paths",
    "separable": "far enough from its neighbours in delay and angles that an estimator can tell it from them",
    "inseparable": "closer to stronger neighbours, in delay and angles, than an estimator can tell apart: counted "
    "apart, not as missed",
    "weak": "an estimate that matches no significant path, but that weak or diffuse true energy explains: judged "
    "by the truth, while is_weak of a channel estimate is a mark by the estimator",
    "false contour": "a ghost or a phantom",
    "false": "an estimate that no true path explains",
    "gate": "the largest errors at which an estimate still counts as a true path: 3 ns, 5 deg in each angle; as a "
    "unit, 1 is an error that large",
    "IoU": "area of the overlap over the area of the union: 1 is perfect, 0 is apart",
    "GOSPA": "distance of two sets: the errors of matched members, and a penalty for each missed or false one",
    "Hausdorff distance": "the largest distance from a point of either contour to the other contour",
    "modified Hausdorff distance": "the mean distance of two contours, of both directions the larger",
    "RMS": "root of the mean square: a few far values, ghosts among them, outweigh all others",
    "NEES": "squared error over its stated covariance, 1 a dimension where covariances are right",
    "across": "along the normal of the nearest true surface: that error is judged for points of weak paths too, "
    "which have no one true incidence point",
    "coverage": "share of the truth inside the stated 95 % interval: .95 where intervals are right, 1 where they "
    "are too wide",
    "seen": "the part of a contour near the incidence points that it was fitted to",
    "lit extent": "the part of an object where true single bounces met it on the walk",
    "ghost": "a contour or point most of whose paths come from no object by one bounce; floor and ceiling "
    "count as objects",
    "phantom": "a closed contour half of whose area or more no object covers",
    "purity": "share of the points that come from the most frequent object",
    "mixed": "of several objects: none has half of its points",
    "found": "its contour has 3 points of its own and lies within 0.5 m of half of the true incidence points",
    "single bounce": "a path of one reflection or one diffraction, at an edge or around what is round; a wall "
    "that it passes through is no bounce; significant ones of all stops are counted",
    "incidence point": "where a path that bounced once met a surface; its distance to the surface counts in plan, "
    "off floor or ceiling in height, and not where no height was estimated",
    "ramp": "phases that grow evenly from beam to beam, as a frequency offset makes them",
    "self-calibration": "gains and phases of both arrays, estimated from some stops before all else",
}
_KNOWN = re.compile(rf"\b({'|'.join(map(re.escape, WORDS))})(?=s?\b)", re.IGNORECASE)
_BY_NAME = {word.lower(): word for word in WORDS}


def words_in(texts: Iterable[str]) -> list[str]:
    """The known words in some texts, each once, in the order of `WORDS`."""
    found = {_BY_NAME[match.lower()] for text in texts for match in _KNOWN.findall(text)}
    return [word for word in WORDS if word in found]


def legend(texts: Iterable[str]) -> Iterator[str]:
    """A line for every known word in some texts, and for every one that these lines need."""
    texts, found = list(texts), list[str]()
    while (known := words_in([*texts, *(WORDS[word] for word in found)])) != found:
        found = known
    return (f"{word}: {WORDS[word]}" for word in found)


def explained(text: str) -> str:
    """A text as HTML whose known words have their meaning as a title."""
    html, end = [], 0
    for match in _KNOWN.finditer(text):
        meaning = escape(WORDS[_BY_NAME[match[0].lower()]])
        html += [escape(text[end : match.start()]), f'<abbr title="{meaning}">{escape(match[0])}</abbr>']
        end = match.end()
    return "".join([*html, escape(text[end:])])


def words_page() -> str:
    """The words as a Markdown table."""
    rows = "\n".join(f"| {word} | {meaning} |" for word, meaning in WORDS.items())
    about = "What tables, figures and pages mean by these words; [metrics](metrics.md) defines every score."
    return f"# Words\n\n{about}\n\n| word | meaning |\n|---|---|\n{rows}\n"

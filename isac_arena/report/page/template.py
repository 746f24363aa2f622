"""The frame of the report page, its script and its style sheet. The page loads nothing from elsewhere."""

from importlib.resources import files

SCRIPTS = (  # in this order
    "base", "state", "figure", "tables", "panzoom", "plan", "stop", "tracks", "object", "budget", "main",
)  # fmt: skip
STYLES = ("report", "figures")

PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src 'unsafe-inline'">
<title>$title</title>
<style>$style</style>
</head>
<body>
<header><h1>$title</h1><span id="theme-place" class="noprint"></span></header>
<nav>$contents</nav>
<div class="columns">
<div class="headline unit">$headline</div>
<div class="facts">$facts</div>
</div>
$words

<h2 id="explore">Explore</h2>
<noscript><p>The interactive plan needs JavaScript; the figures and tables below do not.</p></noscript>
<div id="instrument"></div>
<h2 id="channel">Channel estimation</h2>
<p>Every estimated path is assigned to at most one true path, within a gate on delay and angles. Only significant
true paths count: not diffuse, above the noise and within the estimator's dynamic range. A path that no estimator
could part from its neighbours is counted apart, not as missed. An unassigned estimate is weak or diffuse where
other true energy explains it, and false otherwise. Angles are compared as reported: azimuths, or of horizontal
beams cone angles: those off the boresight of the panel.</p>
<div class="columns unit">$channel_counts $channel_errors</div>
$channel_figures

<h2 id="maps">Mapping and SLAM</h2>
<p>Mapping uses the true pose and clock of the receiver; SLAM estimates them from the same paths. An object has
a cluster when at least half of the incidence points of one stem from it and enough of them are close to it.</p>
<div class="unit">$maps</div>
$map_figures

<h2 id="poses">Receiver state</h2>
<div class="unit">$poses</div>
$pose_figures

<h2 id="shapes">Object shapes</h2>
<p>Our contours are fitted to the delays and angles of the paths by the reflection law: walls, edges and pillars,
each with the probability of its class; ghosts are rejected. The published method fits one star-convex contour to
each cluster of incidence points, by a Gaussian process over the polar angle. A contour is seen near its incidence
points; elsewhere it follows from the model or the prior. The lit extent is the part of an object where true single
bounces met it on the walk.</p>
<div class="unit">$accepted</div>
<h3>Our contours</h3>
<div class="unit">$contours</div>
<div class="scroll">$contour_objects</div>
<details><summary>All objects and meshes of the scene, also those that no path meets</summary>
<div>$scene_objects</div>
</details>
<h3>Contours by the published method</h3>
<div class="unit">$shapes</div>
<div class="scroll">$shape_objects</div>
<div class="pairs">
$shape_figures
</div>

<h2 id="scores">All scores</h2>
<details>
<summary>Every measured score, without causes and kinds that do not occur;
scores.json holds all $n_scores keys</summary>
<div>$all_scores</div>
</details>
<script type="application/json" id="campaign">$campaign</script>
<script>$script</script>
</body>
</html>
"""


def script_text() -> str:
    """The script of the page: all parts in one function scope."""
    parts = "\n".join(_asset(f"{name}.js") for name in SCRIPTS)
    return f'(() => {{\n"use strict";\n{parts}}})();'


def style_text() -> str:
    """The style sheet of the page."""
    return "\n".join(_asset(f"{name}.css") for name in STYLES)


def _asset(name: str) -> str:
    return files("isac_arena.report.page").joinpath("assets", name).read_text(encoding="utf-8")

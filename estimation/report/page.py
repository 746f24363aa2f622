"""Frame and style sheet of the report page."""

STYLE_SHEET = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; color: #222; background: #fff;
  max-width: 68rem; margin: 0 auto; padding: 1.5rem 1.25rem 4rem; }
h1 { font-size: 1.7rem; margin: 0 0 .2rem; }
h2 { font-size: 1.25rem; margin: 2.6rem 0 .6rem; padding-bottom: .2rem; border-bottom: 2px solid #0072b2; }
p { max-width: 46rem; }
a { color: #0072b2; }
nav { margin: .2rem 0 1.4rem; color: #777; }
table { border-collapse: collapse; margin: .6rem 0 1.2rem; font-variant-numeric: tabular-nums; }
th, td { padding: .22rem .8rem .22rem 0; border-bottom: 1px solid #e3e3e3; text-align: right;
  vertical-align: top; }
th:first-child, td:first-child { text-align: left; }
th { font-weight: 600; border-bottom: 1.5px solid #999; }
td:last-child, th:last-child { padding-right: 0; }
.columns { display: flex; flex-wrap: wrap; gap: 0 3rem; align-items: flex-start; }
.headline table { font-size: 1.05rem; }
.headline td:nth-child(2) { font-weight: 600; }
.facts td { text-align: left; }
.facts thead { display: none; }
.unit td:last-child, .unit th:last-child { text-align: left; color: #666; padding-left: .1rem; }
figure { margin: 1.2rem 0 1.8rem; break-inside: avoid; }
figure img { max-width: 100%; height: auto; display: block; margin: 0 auto; }
figcaption { font-size: .87rem; color: #444; max-width: 52rem; margin: .4rem auto 0; }
.pairs { display: grid; grid-template-columns: repeat(auto-fit, minmax(29rem, 1fr)); gap: 0 1.6rem; }
code { font-size: .86rem; }
summary { cursor: pointer; color: #0072b2; }
@media (max-width: 36rem) { .pairs { grid-template-columns: 1fr; } body { font-size: 14px; } }
@media print { body { max-width: none; padding: 0; font-size: 10pt; } nav { display: none; }
  h2 { break-after: avoid; } tr { break-inside: avoid; } }
"""

PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>$style</style>
</head>
<body>
<h1>$title</h1>
<nav>$contents</nav>
<div class="columns">
<div class="headline unit">$headline</div>
<div class="facts">$facts</div>
</div>

<h2 id="channel">Channel estimation</h2>
<p>Every estimated path is assigned to at most one true path, within a gate on delay and angles. Only significant
true paths count: not diffuse, above the noise and within the estimator's dynamic range. An estimate that belongs
to none of them is weak or diffuse where other true energy explains it, and false where nothing does.</p>
<div class="columns unit">$channel_counts $channel_errors</div>
$channel_figures

<h2 id="maps">Mapping and SLAM</h2>
<p>Mapping knows the receiver's pose and clock; SLAM finds them from the same paths. An object counts as found when
at least half of a cluster's incidence points stem from it and enough of them lie close to it.</p>
<div class="unit">$maps</div>
$map_figures

<h2 id="poses">Receiver state</h2>
<div class="unit">$poses</div>
$pose_figures

<h2 id="shapes">Object shapes</h2>
<p>One star-convex contour per cluster, by a Gaussian process over the polar angle. A contour is seen within a few
degrees of a training angle; elsewhere the process has only its prior. The lit extent is where true single bounces
met the object during the walk.</p>
<div class="unit">$shapes</div>
$objects
<div class="pairs">
$shape_figures
</div>

<h2 id="scores">All scores</h2>
<details><summary>Every measured score; scores.json holds all $n_scores keys</summary>
<div>$all_scores</div>
</details>
</body>
</html>
"""

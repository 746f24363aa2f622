// The interactive part: controls, both maps, the stop and the object.

function option(value, label, chosen) {
  return html("option", { value, selected: chosen }, label);
}

function labelled(label, control) {
  return html("label", {}, html("span", {}, label), control);
}

function choice(name, words) {
  const buttons = CHOICES[name].map((value) => {
    const input = html("input", { type: "radio", name: `choose-${name}`, value, onchange: () => select({ [name]: value }) });
    return html("label", {}, input, html("span", {}, words[value]));
  });
  onChange(() => buttons.forEach((label) => { label.firstChild.checked = label.firstChild.value === state[name]; }));
  return html("div", { class: "choice", role: "radiogroup", "aria-label": name }, buttons);
}

function stopControl() {
  const list = html("select", { id: "pick-stop", onchange: () => select({ row: Number(list.value) }) },
    data.stops.stop.map((stop, row) => option(row, `${stop}${data.stops.los[row] ? " · true LOS" : ""}`)));
  const turn = (step) => () => select({ row: (state.row + step + data.stops.stop.length) % data.stops.stop.length });
  onChange(() => { list.value = state.row; });
  return html("span", { class: "joined" }, html("button", { type: "button", id: "stop-before", "aria-label": "Stop before", onclick: turn(-1) }, "‹"),
    list, html("button", { type: "button", id: "stop-after", "aria-label": "Next stop", onclick: turn(1) }, "›"), thinned());
}

/** What a long campaign leaves out. */
function thinned() {
  const shown = data.stops.stop.length;
  return shown < data.n_stops ? html("span", { class: "thinned" }, `${shown} of ${data.n_stops} stops are drawn; the scores are of all.`) : "";
}

function objectControl() {
  const list = html("select", { id: "pick-object", onchange: () => { select({ object: list.value }); focusObject(); } },
    option("", "none"), [...items.values()].map((item) => option(item.key, item.label)));
  onChange(() => { list.value = state.object; });
  return list;
}

/** Bring the chosen object into view. */
function focusObject() {
  const item = items.get(state.object);
  const points = item ? shownMaps().flatMap((mapName) => [
    ...contoursOf(mapName, item).flatMap((one) => pairs(one.xy)),
    ...pointsOf(mapName, item).map((index) => pairAt(data.maps[mapName].ips.xy, index)),
  ]) : [];
  if (points.length) showPoints(points);
  else resetView();
  redrawPlans();
}

function layerControl() {
  const boxes = Object.entries(LAYERS).filter(([name]) => data.has_truth || !OF_TRUTH.includes(name)).map(([name, label]) => {
    const input = html("input", { type: "checkbox", id: `layer-${name}`, onchange: () => {
      const hidden = new Set(state.hidden);
      if (input.checked) hidden.delete(name);
      else hidden.add(name);
      select({ hidden });
    } });
    onChange(() => { input.checked = !state.hidden.has(name); });
    return html("label", {}, input, html("span", {}, label));
  });
  return html("div", { class: "layers", role: "group", "aria-label": "Shown in the plan" }, boxes);
}

function themeControl() {
  const words = { auto: "Theme: as the system", light: "Theme: light", dark: "Theme: dark" };
  const order = Object.keys(words);
  let theme = "auto";
  const button = html("button", { type: "button", id: "theme", onclick: () => {
    theme = order[(order.indexOf(theme) + 1) % order.length];
    page.dataset.theme = theme;
    button.textContent = words[theme];
    for (const listener of listeners) listener();
  } }, words.auto);
  return button;
}

function legendEntries() {
  const kinds = new Set(data.true.flatMap((paths) => (paths ? paths.kind : [])));
  const line = (cls) => svg("svg", { class: "swatch wide", viewBox: "0 0 34 12", width: 34, height: 12, "aria-hidden": "true" },
    svg("path", { class: cls, d: "M2 6H32" }));
  const mark = (cls, shape) => swatch(cls, shape, 4);
  const entries = PATH_KINDS.filter((kind) => kinds.has(kind)).map((kind) => [line(`ray ${kindClass(kind)}`), `true, ${kind}`]);
  for (const status of Object.keys(STATUS).filter((one) => STATUS[one])) {
    entries.push([html("span", {}, line(`estimate ${status}`), swatch(`estimate-mark ${status}`, STATUS_GLYPHS[status])), `estimated, ${STATUS[status]}`]);
  }
  if (data.scene.clutter.length) entries.push([mark("clutter", "square"), "mesh"]);
  if (data.has_truth) entries.push([html("span", {}, swatch("true-mark", "circle", 6), swatch("true-mark missed", "circle", 6)), "true path, detected and missed"]);
  entries.push([mark("stop", "circle"), data.has_truth ? "true RX stop" : "surveyed RX stop"], [mark("found", "plus"), "RX by SLAM"], [mark("tx", "diamond"), "TX with boresight"]);
  const point = (shape, size, color) => swatch(`point ${shape}`, shape, size, pointStyle(shape, color));
  entries.push([html("span", {}, point("circle", 4, "var(--c0)"), point("square", 4, "var(--c1)")), "incidence point, a colour and mark for each object; large: of the stop"],
    [point("circle", 2.5, "var(--ghost)"), "incidence point of no contour"], [point("cross", 4, "var(--ghost)"), "incidence point of a ghost or phantom"]);
  entries.push([line("contour ours neutral"), "our contour"], [line("contour paper neutral"), "contour, published method"], [line("outline"), data.has_truth ? "true outline" : "surveyed outline"]);
  return entries.map(([sign, word]) => html("li", {}, sign, ` ${word}`));
}

function start() {
  const main = document.getElementById("instrument");
  const controls = html("form", { class: "controls noprint", onsubmit: (event) => event.preventDefault() },
    labelled("Stop", stopControl()), labelled("Object", objectControl()),
    choice("map", { both: "Both", mapping: "Mapping", slam: "SLAM" }),
    hasOurs ? choice("contours", { ours: "Our contours", paper: "Published method", both: "Both" }) : null,
    layerControl());
  const plans = html("div", { class: "pair plans" });
  const stopPanel = html("section", { id: "stop-panel", "aria-labelledby": "stop-title" });
  const objectPanel = html("section", { id: "object-panel", "aria-labelledby": "object-title" });
  const tracksPanel = html("section", { id: "tracks-panel" });
  const budgetPanel = html("section", { id: "budget-panel" });
  const hint = html("p", { class: "hint noprint" }, "Click a stop, a point or an object. Drag to move; Ctrl and the wheel, two fingers or the keys " +
    "+ − 0 and arrows zoom and move; the address of the page stores the selection.");
  document.getElementById("theme-place").append(themeControl());
  main.append(controls, plans, html("ul", { class: "legend" }, legendEntries()), hint, stopPanel, tracksPanel, objectPanel, budgetPanel);
  document.body.append(tip);
  readAddress();
  const made = Object.keys(MAPS).map((mapName) => makePlan(plans, mapName));
  onChange(() => made.forEach((plan, index) => { plan.element.hidden = !shownMaps().includes(Object.keys(MAPS)[index]); }));
  makeStopPanel(stopPanel);
  makeTracksPanel(tracksPanel);
  makeObjectPanel(objectPanel);
  makeBudgetPanel(budgetPanel);
  for (const listener of listeners) listener();
  if (state.object) focusObject();
  for (const picture of document.querySelectorAll("figure img")) {
    const button = html("button", { type: "button", onclick: () => save(picture.src, fileName(picture.closest("figure").id, "PNG")),
      "aria-label": `${picture.alt}: PNG` }, "PNG");
    picture.after(html("span", { class: "buttons noprint" }, "Save as ", button));
  }
  requestAnimationFrame(() => { page.dataset.ready = "yes"; }); // after the frame in which the figures draw
}
start();

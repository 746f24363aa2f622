// The floor plan of one map: scene, stops, paths of the stop, incidence points and contours.

const MANY_PATHS = 25; // the paths of a stop with more of them are paler
const STUB_M = 1.6; // length drawn of an estimated path with unknown incidence point
const SEVERAL_BOUNCES = ["two reflections", "three reflections"];
const planFigures = [];
const redrawPlans = () => planFigures.forEach((one) => one.redraw());

function makePlan(parent, mapName) {
  const tools = [
    ["+", "Zoom in", () => { view.zoom *= 1.4; }],
    ["−", "Zoom out", () => { view.zoom /= 1.4; }],
    ["⌂", "Show the whole scene", resetView],
    ["walk", "Show the walk", showWalk],
  ].map(([sign, label, act]) =>
    html("button", { type: "button", class: "sign", "aria-label": label, title: label, onclick: () => { act(); redrawPlans(); } }, sign));
  const plan = figure(parent, {
    name: `plan-${mapName}`,
    label: `Floor plan, ${MAPS[mapName]}`,
    height: (width) => Math.min((width * (north - south)) / (east - west), Math.max(0.75 * window.innerHeight, 320)),
    draw: (drawing, width, height) => drawPlan(drawing, mapName, width, height),
    tools,
  });
  plan.drawing.setAttribute("tabindex", "0");
  plan.drawing.classList.add("plan");
  plan.caption.append(html("b", {}, MAPS[mapName]));
  enablePanZoom(plan.drawing, redrawPlans);
  planFigures.push(plan);
  return plan;
}

function drawPlan(drawing, mapName, width, height) {
  const { scale, to } = projection(width, height);
  const sheet = { drawing, mapName, width, height, scale, to, hits: [] };
  sheet.project = (flat) => pairs(flat).map(to);
  sheet.add = (tag, attributes, ...children) => drawing.appendChild(svg(tag, attributes, ...children));
  drawGrid(sheet);
  drawScene(sheet);
  drawContours(sheet);
  drawPaths(sheet);
  if (!state.hidden.has("points")) drawPoints(sheet);
  drawStops(sheet);
  drawNames(sheet);
  return sheet.hits;
}

function drawGrid({ add, width, height, to }) {
  const back = projection(width, height).back;
  const [[x0, y1], [x1, y0]] = [back([0, 0]), back([width, height])];
  const across = nearestTicks(x0, x1, width / 90);
  const step = across.ticks[1] - across.ticks[0];
  const up = [];
  for (let k = Math.ceil(y0 / step); k * step <= y1; k += 1) up.push(k * step);
  const lines = [
    ...across.ticks.map((x) => `M${to([x, 0])[0].toFixed(1)} 0V${height}`),
    ...up.map((y) => `M0 ${to([0, y])[1].toFixed(1)}H${width}`),
  ];
  add("path", { class: "gridline", d: lines.join("") });
  const words = add("g", { class: "ticks halo" });
  for (const x of across.ticks.slice(1)) {
    words.append(svg("text", { x: to([x, 0])[0], y: height - 5, "text-anchor": "middle" }, shown(x, across.decimals)));
  }
  for (const y of up) words.append(svg("text", { x: 4, y: to([0, y])[1] + 4 }, shown(y, across.decimals)));
  words.append(svg("text", { x: 4, y: height - 5, class: "strong" }, "x, y in m"));
}

function drawScene({ add, project, to }) {
  const chosen = items.get(state.object)?.name;
  for (const mesh of data.scene.clutter) {
    for (const ring of mesh.rings) add("path", { class: "clutter", d: lineD(project(ring), true) });
  }
  for (const object of data.scene.objects) {
    const kind = `object ${object.closed ? "solid" : "sheet"} ${object.name === chosen ? "chosen" : ""}`;
    add("path", { class: kind, d: lineD(project(object.xy), object.closed) });
  }
  add("path", { class: "walk", d: lineD(project(data.scene.walk)) });
  for (const tx of data.scene.txs) {
    const [x, y] = to(tx.xy);
    const place = `translate(${x} ${y}) rotate(${-tx.heading_deg})`;
    add("path", { class: "tx-arrow", d: "M0 0H22M22 0l-7 -4.5M22 0l-7 4.5", transform: place });
    add("path", { class: "tx", d: glyphD("diamond", [x, y], 5) });
  }
}

/** The class of marks that fade because another object is selected. */
function fade(item) {
  return state.object && item?.key !== state.object ? "faint" : "";
}

function drawContours({ add, project, mapName }) {
  const all = shownContours(mapName);
  if (!state.hidden.has("band")) {
    for (const one of all) {
      const [outer, inner] = [project(one.outer), project(one.inner)];
      const d = one.closed ? lineD(outer, true) + lineD(inner.reverse(), true) : lineD([...outer, ...inner.reverse()], true);
      add("path", { class: `band ${fade(one.item)}`, d, style: `fill:${itemColor(one.item)}` });
    }
  }
  for (const one of all) {
    const kind = `contour ${one.source} ${fade(one.item)}`;
    add("path", { class: kind, d: lineD(project(one.xy), one.closed), style: `stroke:${itemColor(one.item)}` });
  }
}

function itemColor(item) {
  return item.ghost ? "var(--ghost)" : look(item.index).color;
}

/** Colour and mark of an incidence point. */
function pointLook(item) {
  if (!item) return { color: "var(--ghost)", shape: "circle" };
  return item.ghost ? { color: "var(--ghost)", shape: "cross" } : look(item.index);
}

function pointStyle(shape, color) {
  return shape === "cross" ? `stroke:${color};fill:none` : `fill:${color}`;
}

/** Draw the paths of the stop: true paths wide and pale, estimated paths thin. */
function drawPaths(sheet) {
  const { add, project, hits, to } = sheet;
  const row = state.row;
  const truth = data.true[row];
  if (truth && !state.hidden.has("true")) {
    truth.corners.forEach((corners, index) => {
      const isSeveral = SEVERAL_BOUNCES.includes(truth.kind[index]);
      if (isSeveral && state.hidden.has("several") && !samePath(`t${index}`)) return;
      const points = project([...data.scene.txs[truth.tx[index]].xy, ...corners, ...data.stops.xy.slice(2 * row, 2 * row + 2)]);
      const many = truth.path.length > MANY_PATHS ? "many" : "";
      const kind = `ray ${many} ${kindClass(truth.kind[index])} ${fadePath(`t${index}`)}`;
      add("path", { class: kind, d: lineD(points) });
      for (const corner of points.slice(1, -1)) {
        const text = `true path: ${truth.label[index]}${truth.detected[index] ? "" : ", missed"}`;
        hits.push({ x: corner[0], y: corner[1], text, pick: () => select({ path: `t${index}` }) });
      }
    });
  }
  if (!state.hidden.has("estimated")) {
    for (const one of estimatedLines(sheet.mapName, row)) {
      if (isHiddenEstimate(one.status, one.index)) continue;
      const points = one.points.map((point) => point && to(point));
      const d = one.stubs ? lineD(points.slice(0, 2)) + lineD(points.slice(2)) : lineD(points);
      add("path", { class: `estimate ${one.status} ${fadePath(`e${one.index}`)}`, d });
    }
  }
}

function kindClass(kind) {
  return `kind-${kind.replace(/ /g, "-")}`;
}

function samePath(key) {
  if (!state.path || key === state.path) return key === state.path;
  const [truth, estimated] = [data.true[state.row], data.estimated[state.row]];
  const trueOf = (name) =>
    name.startsWith("t") ? Number(name.slice(1)) : truth?.path.indexOf(estimated.true_path[Number(name.slice(1))]) ?? -1;
  return trueOf(key) >= 0 && trueOf(key) === trueOf(state.path);
}

/** Weak and diffuse estimates are many; they are shown where asked for, or selected. */
function isHiddenEstimate(status, index) {
  return status === "weak" && state.hidden.has("weak") && !samePath(`e${index}`);
}

function fadePath(key) {
  return state.path ? (samePath(key) ? "chosen" : "faint") : "";
}

/** Lines of the estimated paths in the plan: through the incidence point, or else short lines in both directions. */
function estimatedLines(mapName, row) {
  const map = data.maps[mapName];
  const paths = data.estimated[row];
  const pose = map.poses;
  const rx = pairAt(pose.xy, row);
  if (!rx) return [];
  const stop = data.stops.stop[row];
  const met = new Map();
  map.ips.stop.forEach((one, index) => {
    if (one === stop && map.ips.inlier[index]) met.set(map.ips.path[index], pairAt(map.ips.xy, index));
  });
  const along = ([x, y], degrees) => {
    const angle = (degrees * Math.PI) / 180;
    return [x + STUB_M * Math.cos(angle), y + STUB_M * Math.sin(angle)];
  };
  return paths.delay_ns.map((_, index) => {
    const tx = data.scene.txs[paths.tx[index]];
    const about = { index, status: paths.status[index] };
    if (paths.los[index]) return { ...about, points: [tx.xy, rx] };
    if (met.get(index)) return { ...about, points: [tx.xy, met.get(index), rx] };
    const [atNode, atStop] = tx.receives ? [paths.aoa_deg, paths.aod_deg] : [paths.aod_deg, paths.aoa_deg];
    const points = [tx.xy, along(tx.xy, tx.heading_deg + atNode[index]), rx,
      along(rx, pose.heading_deg[row] + atStop[index])];
    return { ...about, points, stubs: true };
  });
}

function drawPoints({ add, to, hits, mapName }) {
  const { ips } = data.maps[mapName];
  const item = items.get(state.object);
  if (item) add("path", { class: "support", d: supportD(mapName, item, to) });
  const groups = new Map();
  const stop = data.stops.stop[state.row];
  ips.stop.forEach((_, index) => {
    if (!ips.inlier[index]) return;
    const item = itemOfPoint(mapName, index);
    const place = to(pairAt(ips.xy, index));
    const isHere = ips.stop[index] === stop;
    const key = `${item?.key ?? ""} ${isHere}`;
    if (!groups.has(key)) groups.set(key, { item, isHere, places: [] });
    groups.get(key).places.push(place);
    const text = `IP of stop ${ips.stop[index]}, path ${ips.path[index]}: ${originOf(ips, index)}`;
    const pick = () => select({ row: data.stops.stop.indexOf(ips.stop[index]), path: `e${ips.path[index]}`,
      object: item?.key ?? state.object });
    hits.push({ x: place[0], y: place[1], text, pick });
  });
  for (const { item, isHere, places } of groups.values()) {
    const { color, shape } = pointLook(item);
    const size = (item ? 3 : 1.8) + (isHere ? 2.2 : 0);
    const d = places.map((place) => glyphD(shape, place, size)).join("");
    add("path", { class: `point ${shape} ${isHere ? "here" : ""} ${fade(item)}`, d, style: pointStyle(shape, color) });
  }
}

/** Lines from the points of an object to the positions of the receiver. */
function supportD(mapName, item, to) {
  const { ips, poses } = data.maps[mapName];
  return pointsOf(mapName, item).map((index) => {
    const stop = pairAt(poses.xy, data.stops.stop.indexOf(ips.stop[index]));
    return stop ? lineD([to(pairAt(ips.xy, index)), to(stop)]) : "";
  }).join("");
}

function drawStops({ add, to, hits, mapName }) {
  const truth = data.stops.stop.map((_, row) => to(pairAt(data.stops.xy, row)));
  if (mapName === "slam") {
    const found = data.stops.stop.map((_, row) => pairAt(data.maps.slam.poses.xy, row)).map((at) => at && to(at));
    add("path", { class: "tie", d: found.map((at, row) => (at ? lineD([truth[row], at]) : "")).join("") });
    add("path", { class: "found", d: found.map((at) => (at ? glyphD("plus", at, 4) : "")).join("") });
  }
  add("path", { class: "stop", d: truth.map((at) => glyphD("circle", at, 3)).join("") });
  add("path", { class: "stop-here", d: glyphD("circle", truth[state.row], 8) });
  const words = add("g", { class: "stop-names halo" });
  truth.forEach(([x, y], row) => {
    const text = `stop ${data.stops.stop[row]}${data.stops.los[row] ? ", line of sight" : ""}`;
    hits.push({ x, y, text, pick: () => select({ row }) });
    if (row % 5 === 0 || row === state.row) {
      words.append(svg("text", { x, y: y - (row === state.row ? 12 : 7), "text-anchor": "middle" }, data.stops.stop[row]));
    }
  });
}

/** Write the names of the objects in view, the selected one first, each where it covers no other one. */
function drawNames({ add, to, hits, width, height }) {
  const words = add("g", { class: "object-names halo" });
  const taken = [];
  const write = (text, places, kind) => {
    const half = 3.6 * text.length;
    const boxes = places.map(([middle, y]) => {
      const x = Math.max(Math.min(middle, width - half - 2), half + 2);
      return { x, y, sides: [x - half, y - 11, x + half, y + 3] };
    });
    const meets = (a, b) => a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];
    const free = boxes.find(({ sides }) => !taken.some((other) => meets(sides, other)));
    if (!free) return;
    taken.push(free.sides);
    words.append(svg("text", { x: free.x, y: free.y, "text-anchor": "middle", class: kind }, text));
  };
  for (const tx of data.scene.txs) {
    const [x, y] = to(tx.xy);
    write(tx.name, [[x, y - 9]], "strong");
  }
  const isChosen = (object) => object.name === state.object;
  const meshes = data.scene.clutter.map(({ name, rings }) => ({ name, closed: true, xy: rings.flat() }));
  for (const object of [...data.scene.objects, ...meshes].sort((a, b) => isChosen(b) - isChosen(a))) {
    const inside = pairs(object.xy).map(to).filter(([px, py]) => px > 0 && px < width && py > 0 && py < height);
    if (!inside.length) continue;
    const [xs, ys] = [inside.map(([px]) => px), inside.map(([, py]) => py)];
    const middle = [(Math.min(...xs) + Math.max(...xs)) / 2, (Math.min(...ys) + Math.max(...ys)) / 2];
    const pick = items.has(object.name) ? () => select({ object: object.name }) : null;
    if (object.closed || inside.length < 3) hits.push({ x: middle[0], y: middle[1], text: object.name, pick });
    if (state.hidden.has("names") && !isChosen(object)) continue;
    const [above, below] = [Math.max(Math.min(...ys) - 6, 12), Math.min(Math.max(...ys) + 14, height - 18)];
    const across = [middle[0], (Math.min(...xs) + 3 * Math.max(...xs)) / 4, (3 * Math.min(...xs) + Math.max(...xs)) / 4];
    const places = [above, below].flatMap((y) => across.map((x) => [x, y]));
    write(object.name, places, isChosen(object) ? "strong" : "");
  }
}

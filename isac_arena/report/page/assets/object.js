// One object: its true outline, its contours with bands, and the points that support them with their stops and paths.

const SCORE_WORDS = {
  iou: ["IoU", 2],
  hausdorff_m: ["Hausdorff, m", 3],
  seen_rmse_m: ["RMSE seen, m", 3],
  full_rmse_m: ["RMSE full, m", 3],
  coverage95: ["coverage", 2],
  extent_iou: ["extent IoU", 2],
};

function makeObjectPanel(parent) {
  const title = html("h3", { id: "object-title" });
  const hint = html("p", { id: "object-hint" }, "Select an object in the plan or above to see its contours, the points that support them, " +
    "and the stops and paths of these points.");
  const body = html("div", { id: "object-body" });
  const sides = html("div", { class: "pair" });
  const details = {};
  for (const [mapName, label] of Object.entries(MAPS)) {
    const side = html("div", { class: "side" });
    sides.append(side);
    const plot = figure(side, {
      name: `object-${mapName}`,
      label: `The object by ${mapName === "slam" ? "SLAM" : "mapping"}`,
      height: (width) => Math.min(0.8 * width, 460),
      draw: (drawing, width, height) => drawObject(drawing, mapName, width, height),
    });
    plot.caption.textContent = `${label}. Solid: our contour; dashed: published method; thin: true outline.`;
    details[mapName] = { side, plot, below: side.appendChild(html("div", { class: "below" })) };
  }
  body.append(sides);
  parent.append(title, hint, body);
  const update = () => {
    const item = items.get(state.object);
    title.textContent = item ? `Object ${item.label}` : "Objects";
    hint.hidden = Boolean(item);
    body.hidden = !item;
    for (const [mapName, { side, plot, below }] of Object.entries(details)) {
      side.hidden = !shownMaps().includes(mapName);
      below.replaceChildren(...(item && !side.hidden ? objectDetails(mapName, item) : []));
      plot.redraw();
    }
  };
  onChange(update);
  update();
}

/** Incidence points that support an object's contours, and those that stem from it. */
function pointsOf(mapName, item) {
  const { ips } = data.maps[mapName];
  const { contours, shapes } = item.rows[mapName];
  const found = [];
  ips.stop.forEach((_, index) => {
    const supports = contours.includes(ips.ours[index]) || shapes.includes(ips.paper[index]);
    const stems = ips.inlier[index] && item.name && ips.object[index] === item.name;
    if (supports || stems) found.push(index);
  });
  return found;
}

function contoursOf(mapName, item) {
  const map = data.maps[mapName];
  const { contours, shapes } = item.rows[mapName];
  return [
    ...contours.map((row) => ({ ...map.contours[row], source: "ours", word: `contour ${row}` })),
    ...shapes.map((row) => ({ ...map.shapes[row], source: "paper", word: `cluster ${row}` })),
  ];
}

function drawObject(drawing, mapName, width, height) {
  const item = items.get(state.object);
  if (!item) return [];
  const { ips } = data.maps[mapName];
  const [points, curves] = [pointsOf(mapName, item), contoursOf(mapName, item)];
  const whole = data.scene.objects.find((object) => object.name === item.name);
  const near = [...curves.flatMap((one) => pairs(one.xy)), ...points.map((index) => pairAt(ips.xy, index))];
  const corners = !near.length || (whole?.closed && sizeOf(whole.xy) < 3 * sizeOf(near.flat()))
    ? [...near, ...pairs(whole?.xy ?? [])] : near;
  if (!corners.length) return [];
  const box = { left: 52, top: 8, width: width - 62, height: height - 54 };
  const { sx, sy } = squareAxes(drawing, box, corners);
  const clip = `clip-${mapName}`;
  const { left: x, top: y, width: w, height: h } = box;
  drawing.append(svg("clipPath", { id: clip }, svg("rect", { x, y, width: w, height: h })));
  const sheet = drawing.appendChild(svg("g", { "clip-path": `url(#${clip})` }));
  const add = (kind, d, style) => sheet.append(svg("path", { class: kind, d, style: style ?? null }));
  const project = (flat) => pairs(flat).map(([px, py]) => [sx(px), sy(py)]);
  const color = itemColor(item);
  for (const one of curves) {
    const [outer, inner] = [project(one.outer), project(one.inner)];
    const d = one.closed ? lineD(outer, true) + lineD(inner.reverse(), true) : lineD([...outer, ...inner.reverse()], true);
    sheet.append(svg("path", { class: "band", d, style: `fill:${color}` }));
  }
  for (const object of data.scene.objects) {
    add(`outline ${object.name === item.name ? "" : "faint"}`, lineD(project(object.xy), object.closed));
  }
  for (const one of curves) add(`contour ${one.source}`, lineD(project(one.xy), one.closed), `stroke:${color}`);
  const hits = [];
  const { shape } = pointLook(item);
  for (const index of points) {
    const place = project(ips.xy.slice(2 * index, 2 * index + 2))[0];
    const isHere = ips.stop[index] === data.stops.stop[state.row];
    add(`ellipse ${isHere ? "here" : ""}`, ellipseD(ips, index, sx, sy));
    const style = shape === "cross" ? `stroke:${color};fill:none` : `fill:${color}`;
    add(`point ${shape} ${isHere ? "here" : ""}`, glyphD(shape, place, isHere ? 5.5 : 3.2), style);
    const row = data.stops.stop.indexOf(ips.stop[index]);
    hits.push({ x: place[0], y: place[1], text: `stop ${ips.stop[index]}, path ${ips.path[index]}: ${originOf(ips, index)}`,
      pick: () => select({ row, path: `e${ips.path[index]}` }) });
  }
  return hits;
}

/** The longer side of the bounding box of flat points. */
function sizeOf(flat) {
  const points = pairs(flat);
  const side = (values) => Math.max(...values) - Math.min(...values);
  return Math.max(side(points.map(([x]) => x)), side(points.map(([, y]) => y)));
}

/** Axes of equal scale around points [x, y]. */
function squareAxes(drawing, box, points) {
  const [xs, ys] = [points.map(([x]) => x), points.map(([, y]) => y)];
  const span = Math.max((Math.max(...xs) - Math.min(...xs)) / box.width, (Math.max(...ys) - Math.min(...ys)) / box.height, 0.2 / box.width);
  const about = (values, pixels) => {
    const middle = (Math.min(...values) + Math.max(...values)) / 2;
    return [middle - 0.62 * span * pixels, middle + 0.62 * span * pixels];
  };
  return axes(drawing, box, { x: about(xs, box.width), y: about(ys, box.height), xLabel: "x in m", yLabel: "y in m" });
}

/** The 95 % ellipse of an incidence point. */
function ellipseD(ips, index, sx, sy) {
  const radius = Math.sqrt(5.991); // chi-square of 2 degrees of freedom
  const [x, y] = pairAt(ips.xy, index);
  const angle = (ips.axis_deg[index] * Math.PI) / 180;
  const [a, b] = [radius * ips.std_m[2 * index], radius * ips.std_m[2 * index + 1]];
  const corners = Array.from({ length: 40 }, (_, k) => {
    const [c, s] = [a * Math.cos((k * Math.PI) / 20), b * Math.sin((k * Math.PI) / 20)];
    return [sx(x + c * Math.cos(angle) - s * Math.sin(angle)), sy(y + c * Math.sin(angle) + s * Math.cos(angle))];
  });
  return lineD(corners, true);
}

function objectDetails(mapName, item) {
  const curves = contoursOf(mapName, item);
  const points = pointsOf(mapName, item);
  const stops = new Set(points.map((index) => data.maps[mapName].ips.stop[index]));
  const seen = `${points.length} incidence points from ${stops.size} stops.`;
  const parts = [html("p", {}, curves.length ? seen : `No contour: ${points.length ? seen : "no incidence point stems from this object."}`)];
  for (const one of curves) if (one.probability?.some((p) => p !== null)) parts.push(classBars(one));
  if (curves.length) parts.push(scoreTable(mapName, curves));
  if (points.length) {
    const many = html("details", { open: points.length <= 12 }, html("summary", {}, `Points with stop, path and error`),
      html("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Incidence points" }, pointTable(mapName, points)));
    parts.push(many);
  }
  return parts;
}

function classBars(one) {
  const bars = one.classes.map((name, index) => {
    const share = one.probability[index] ?? 0;
    return html("div", { class: "bar-row" }, html("span", {}, name),
      html("span", { class: "bar", role: "img", "aria-label": `${name}: ${shown(100 * share, 0)} %` }, html("i", { style: `width:${100 * share}%` })),
      html("span", {}, `${shown(100 * share, 1)} %`));
  });
  const extent = `${shown(one.extent_m, 3)} ± ${shown(one.extent_std_m === null ? null : 1.96 * one.extent_std_m, 3)} m`;
  const what = one.closed ? "mean radius" : "lit length";
  return html("div", { class: "classes" }, html("p", {}, `Our ${one.word}: ${one.kind}, ${one.status}; ${what} ${extent}.`), bars);
}

function scoreTable(mapName, curves) {
  const words = Object.entries(SCORE_WORDS).filter(([name]) => curves.some((one) => one.scores[name] !== null));
  const heads = ["contour", "by", "points", "purity", ...words.map(([, [word]]) => word)];
  const rows = curves.map((one) => ({
    cells: [`${one.word}${one.called ? `, ${one.called}` : ""}`, one.source === "ours" ? "ours" : "published", `${one.n_ips}`, shown(one.purity, 2),
      ...words.map(([name, [, decimals]]) => shown(one.scores[name], decimals))],
  }));
  return html("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Scores of the contours" },
    table(`score-table-${mapName}`, heads, rows));
}

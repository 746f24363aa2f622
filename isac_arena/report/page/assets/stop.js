// One stop: its beam power map, its paths over delay and angle, their errors and the table of all paths.

const SHOWN_POWER_DB = 45;
const STATUS = data.has_truth
  ? { detected: "detected", weak: "weak or diffuse", false: "false" }
  : { detected: "labelled line of sight or single bounce", false: "labelled neither", weak: "" };
const TRUTH = data.has_truth ? "In truth" : "By its labels";
const POSE_BY = { LOS: "solved with a line of sight", NLOS: "from reflections alone", GIVEN: "given, of a fixed node" };
const STATUS_GLYPHS = { detected: "cross", weak: "plus", false: "tripod" };
const powerImages = new Map();

function makeStopPanel(parent) {
  const title = html("h3", { id: "stop-title" });
  const facts = html("p", { id: "stop-facts" });
  const figures = html("div", { class: "pair" });
  const table = html("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Paths of the stop" });
  const key = html("p", { class: "hint" }, "True paths by their interactions: S is a reflection, D scattering, X diffraction at an edge, R transmission " +
    "through a wall; #1 is the second of several equal paths. Δ: estimate minus truth.");
  parent.append(title, facts, figures, table, ...(data.has_truth ? [key] : []));
  if (data.power) {
    const power = figure(figures, {
      name: "power-map",
      label: "Beam power map of the stop",
      height: (width) => Math.min(0.62 * width + 40, 470),
      draw: drawPower,
    });
    const shared = data.power.n_pairs > data.power.tx_deg.length * data.power.rx_deg.length;
    const most = shared ? ", of pairs with the same two azimuths (beams at several elevations) that of the strongest" : "";
    power.caption.textContent = `Mean received power of every beam pair${most}. Rings: significant true paths, dashed where ` +
      "missed. Marks: estimated paths. Paths that differ only in delay coincide.";
    if (data.scene.txs.length > 1) power.caption.textContent += ` The power is that of ${data.scene.txs[0].name}, marks are of all TX.`;
  }
  for (const [angle, name] of [["aoa", "arrival"], ["aod", "departure"]]) {
    const scatter = figure(figures, {
      name: `delay-${angle}`,
      label: `Delay and ${data.angles[angle]} of ${name}`,
      height: (width) => Math.min(0.62 * width + 40, 470),
      draw: (drawing, width, height) => drawDelays(drawing, width, height, angle, name),
    });
    const tied = data.has_truth ? " A line connects an estimate to its true path." : "";
    scatter.caption.textContent = `Delay and ${data.angles[angle]} of ${name}.${tied}`;
  }
  if (data.has_truth) {
    const errors = figure(figures, {
      name: "residuals",
      label: "Errors of the detected paths over their standard deviations",
      height: (width) => Math.min(0.5 * width + 40, 400),
      draw: drawResiduals,
    });
    errors.caption.textContent = "Error over the standard deviation of the estimate. A consistent estimator has 95 % of the " +
      "errors between the dashed lines. Marks at the edge are outside the axis.";
  }
  const update = () => {
    title.textContent = `Stop ${data.stops.stop[state.row]}`;
    facts.textContent = stopFacts(state.row);
    table.replaceChildren(pathTable(state.row));
  };
  onChange(update);
  update();
}

function stopFacts(row) {
  const stops = data.stops;
  const estimated = data.estimated[row];
  const truth = data.true[row];
  const count = (status) => estimated.status.filter((one) => one === status).length;
  const words = [`${TRUTH}: ${stops.los[row] ? "a" : "no"} line of sight.`];
  if (truth) {
    const apart = truth.cause.filter((one) => one === "inseparable").length;
    const missed = truth.detected.filter((one) => !one).length - apart;
    words.push(`${truth.path.length} significant true paths, ${count("detected")} detected, ${missed} missed`
      + (apart ? `, ${apart} too close to others to tell apart (inseparable); ` : "; ")
      + `${count("weak")} weak or diffuse and ${count("false")} false estimates.`);
    if (count("weak") && state.hidden.has("weak")) words.push(`Those weak or diffuse are listed with "${LAYERS.weak}".`);
  } else {
    words.push(`${estimated.status.length} measured paths, ${count("detected")} labelled line of sight or single bounce.`);
  }
  const bound = (value, unit) => (value === null ? "" : ` (bound ${measured(value, unit)})`);
  if (stops.position_error_m[row] === null) words.push("SLAM found no pose.");
  else {
    const by = data.maps.slam.poses.status[row];
    const named = estimated.los.indexOf(true);
    const doubted = by === "NLOS" && named >= 0
      ? ` (SLAM does not trust path ${named}, which the channel estimate takes as the line of sight)` : "";
    words.push(`Pose by SLAM, ${POSE_BY[by]}${doubted}: position ${measured(stops.position_error_m[row], "m")} off`
      + `${bound(stops.position_bound_m[row], "m")}, heading ${measured(stops.heading_error_deg[row], "deg", true)}`
      + `${bound(stops.heading_bound_deg[row], "deg")}, clock ${measured(stops.clock_error_ns[row], "ns", true)}`
      + `${bound(stops.clock_bound_ns[row], "ns")}.`);
    if (stops.influential[row] >= 0) {
      words.push(`Path ${stops.influential[row]} holds it most: without that path the position moves by`
        + ` ${measured(stops.influence_m[row], "m")}.`);
    }
  }
  const fitted = data.scene.txs.length > 1 ? 0 : Number(/max_paths = (\d+) reached/.exec(estimated.reason)?.[1] ?? 0);
  if (fitted > estimated.status.length) {
    words.push(`${fitted} paths were fitted, ${estimated.status.length} of them are reported: those marked weak are left out.`);
  }
  if (estimated.reason) words.push(`Estimator: ${estimated.method}, ${estimated.reason}`
    + (/\bramp\b/.test(estimated.reason) ? ` (ramp: ${data.words.ramp}).` : "."));
  return words.join(" ");
}

/** Row of the true path of an estimate, -1 for none. */
function trueRow(row, index) {
  return data.true[row] ? data.true[row].path.indexOf(data.estimated[row].true_path[index]) : -1;
}

function pathName(key) {
  const row = state.row;
  const index = Number(key.slice(1));
  if (key.startsWith("t")) {
    const truth = data.true[row];
    return `true: ${truth.label[index]}${truth.detected[index] ? "" : `, missed${truth.cause[index] ? ` (${truth.cause[index]})` : ""}`}`;
  }
  const paths = data.estimated[row];
  const matched = trueRow(row, index);
  const cause = paths.cause[index] ? ` (${paths.cause[index]})` : "";
  return `path ${index}: ${STATUS[paths.status[index]]}${cause}${matched >= 0 ? `, ${data.true[row].label[matched]}` : ""}`;
}

/** Draw true and estimated paths at the positions `at(paths, index)`; returns the marks that react to the pointer. */
function drawMarks(drawing, at, kind) {
  const row = state.row;
  const hits = [];
  const enter = (paths, index, key, kinds, d) => {
    const place = at(paths, index);
    if (!place) return;
    drawing.append(svg("path", { class: `${kinds} ${kind} ${fadePath(key)}`, d: d(place) }));
    hits.push({ x: place[0], y: place[1], text: pathName(key), pick: () => select({ path: state.path === key ? "" : key }) });
  };
  const truth = data.true[row];
  truth?.path.forEach((_, index) => {
    enter(truth, index, `t${index}`, `true-mark ${truth.detected[index] ? "" : "missed"}`, (place) => glyphD("circle", place, 6.5));
  });
  const paths = data.estimated[row];
  paths.status.forEach((status, index) => {
    enter(paths, index, `e${index}`, `estimate-mark ${status}`, (place) => glyphD(STATUS_GLYPHS[status], place, 4.5));
  });
  return hits;
}

function drawPower(drawing, width, height) {
  const box = { left: 52, top: 8, width: width - 52 - 68, height: height - 54 };
  const { power } = data;
  const span = (values) => [values[0], values[values.length - 1]];
  const { sx, sy } = axes(drawing, box, {
    x: span(power.rx_deg), y: span(power.tx_deg), xLabel: "azimuth of arrival, RX frame, deg", yLabel: "azimuth of departure, TX frame, deg",
  });
  const place = { x: box.left, y: box.top, width: box.width, height: box.height };
  drawing.append(svg("image", { href: powerImage(state.row), ...place, preserveAspectRatio: "none", class: "pixels" }));
  drawBar(drawing, box);
  return drawMarks(drawing, (paths, index) => {
    const [x, y] = [sx(paths.aoa_deg[index]), sy(paths.aod_deg[index])];
    const inside = x >= box.left && x <= box.left + box.width && y >= box.top && y <= box.top + box.height;
    return inside ? [x, y] : null;
  }, "on-power");
}

/** The power map of a stop as an image; each pixel has the colour of the nearest beam pair. */
function powerImage(row) {
  if (powerImages.has(row)) return powerImages.get(row);
  const { rx_deg: rx, tx_deg: tx, step_db: step, colors } = data.power;
  const below = Uint8Array.from(atob(data.power.below[row]), (one) => one.charCodeAt(0));
  const canvas = html("canvas", { width: 2 * rx.length, height: 2 * tx.length });
  const context = canvas.getContext("2d");
  const picture = context.createImageData(canvas.width, canvas.height);
  const shades = colors.map((color) => [1, 3, 5].map((at) => parseInt(color.slice(at, at + 2), 16)));
  const nearest = (values, share) => {
    const value = values[0] + share * (values[values.length - 1] - values[0]);
    return values.reduce((best, one, index) => (Math.abs(one - value) < Math.abs(values[best] - value) ? index : best), 0);
  };
  const columns = Array.from({ length: canvas.width }, (_, i) => nearest(rx, (i + 0.5) / canvas.width));
  for (let j = 0; j < canvas.height; j += 1) {
    const line = nearest(tx, 1 - (j + 0.5) / canvas.height) * rx.length;
    columns.forEach((column, i) => {
      const level = 1 - Math.min((below[line + column] * step) / SHOWN_POWER_DB, 1);
      picture.data.set([...shades[Math.round(level * (shades.length - 1))], 255], 4 * (j * canvas.width + i));
    });
  }
  context.putImageData(picture, 0, 0);
  powerImages.set(row, canvas.toDataURL("image/png"));
  return powerImages.get(row);
}

function drawBar(drawing, box) {
  const left = box.left + box.width + 14;
  const { colors, top_dbm: tops } = data.power;
  const part = box.height / colors.length;
  colors.forEach((color, index) => {
    drawing.append(svg("rect", { x: left, y: box.top + box.height - (index + 1) * part, width: 12, height: part + 0.5, fill: color }));
  });
  const words = svg("g", { class: "ticks" });
  const top = tops[state.row];
  for (const down of [0, 15, 30, 45]) {
    const y = box.top + (box.height * down) / SHOWN_POWER_DB + 4;
    words.append(svg("text", { x: left + 16, y: Math.max(y, box.top + 8) }, shown(top - down, 0)));
  }
  const middle = box.top + box.height / 2;
  words.append(svg("text", { x: left + 50, y: middle, "text-anchor": "middle", transform: `rotate(-90 ${left + 50} ${middle})` }, "power in dBm"));
  drawing.append(words);
}

function drawDelays(drawing, width, height, angle, name) {
  const box = { left: 56, top: 8, width: width - 56 - 12, height: height - 54 };
  const row = state.row;
  const [truth, paths] = [data.true[row], data.estimated[row]];
  const delays = [...(truth?.delay_ns ?? []), ...paths.delay_ns];
  const low = Math.min(...delays, Infinity);
  const high = Math.max(...delays, -Infinity);
  const room = Math.max(0.05 * (high - low), 2);
  const x = delays.length ? [low - room, high + room] : [0, 100];
  const { sx, sy } = axes(drawing, box, {
    x, y: angle === "aoa" ? [-180, 180] : [-90, 90], xLabel: "delay with the clock bias, ns", yLabel: `${data.angles[angle]} of ${name}, deg`,
  });
  const at = (one, index) => [sx(one.delay_ns[index]), sy(one[`${angle}_deg`][index])];
  paths.status.forEach((_, index) => {
    const matched = trueRow(row, index);
    if (matched >= 0) drawing.append(svg("path", { class: "tie", d: lineD([at(truth, matched), at(paths, index)]) }));
  });
  return drawMarks(drawing, at, "");
}

function drawResiduals(drawing, width, height) {
  const paths = data.estimated[state.row];
  const detected = paths.status.map((_, index) => index).filter((index) => paths.delay_error_ns[index] !== null);
  const box = { left: 56, top: 8, width: width - 56 - 12, height: height - 54 };
  const limit = 6;
  const names = [["delay_error_ns", "delay_std_ns", "circle", "delay"], ["aod_error_deg", "aod_std_deg", "square", "AoD"],
    ["aoa_error_deg", "aoa_std_deg", "up", "AoA"]];
  const { sx, sy } = axes(drawing, box, {
    x: [-0.7, Math.max(paths.status.length - 0.3, 1)], y: [-limit, limit], xLabel: "path", yLabel: "error over its standard deviation",
  });
  for (const level of [-1.96, 1.96]) {
    drawing.append(svg("path", { class: "limit", d: `M${box.left} ${sy(level)}h${box.width}` }));
  }
  const hits = [];
  detected.forEach((index) => {
    names.forEach(([error, std, shape, word], part) => {
      const ratio = paths[error][index] / paths[std][index];
      const place = [sx(index + 0.22 * (part - 1)), sy(Math.max(-limit, Math.min(limit, ratio)))];
      drawing.append(svg("path", { class: `residual part-${part} ${fadePath(`e${index}`)}`, d: glyphD(shape, place, 4) }));
      hits.push({ x: place[0], y: place[1], text: `path ${index}, ${word}: ${shown(ratio, 2)} standard deviations`,
        pick: () => select({ path: `e${index}` }) });
    });
  });
  const legend = svg("g", { class: "ticks" });
  names.forEach(([, , shape, word], part) => {
    const place = [box.left + 14 + 74 * part, box.top + 12];
    legend.append(svg("path", { class: `residual part-${part}`, d: glyphD(shape, place, 4) }),
      svg("text", { x: place[0] + 9, y: place[1] + 4 }, word));
  });
  drawing.append(legend);
  return hits;
}

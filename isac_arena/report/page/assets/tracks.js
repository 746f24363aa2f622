// Movers: tracks and truth over time in the plan, and the Doppler shifts of the paths of the stop.

const TRAIL_S = 3; // of the truth behind a mover
const FRAME_MS = 60;
const LARGEST_MARK = 8;
const motion = { frame: 0, timer: 0 };

function makeTracksPanel(parent) {
  const world = data.tracks;
  if (!world) return;
  const last = world.frame_s.length - 1;
  const plan = [];
  const redraw = () => { for (const one of plan) one.redraw(); };
  const clock = html("output", { id: "track-time" });
  const slider = html("input", { type: "range", id: "track-slider", min: 0, max: last, step: 1, value: 0, "aria-label": "Time",
    oninput: () => show(Number(slider.value)) });
  const play = html("button", { type: "button", id: "track-play", onclick: () => (motion.timer ? stop() : start()) }, "Play");
  const show = (frame) => {
    motion.frame = Math.min(frame, last);
    slider.value = motion.frame;
    clock.textContent = `${shown(world.frame_s[motion.frame], 2)} s`;
    const row = rowAt(world.frame_s[motion.frame]);
    if (row !== state.row) select({ row });
    redraw();
  };
  const stop = () => {
    clearInterval(motion.timer);
    motion.timer = 0;
    play.textContent = "Play";
  };
  const start = () => {
    if (motion.frame === last) show(0);
    play.textContent = "Pause";
    motion.timer = setInterval(() => (motion.frame === last ? stop() : show(motion.frame + 1)), FRAME_MS);
  };
  const grid = html("div", { class: "pair" });
  parent.append(html("h3", { id: "tracks-title" }, "Movers"), grid);
  const made = figure(grid, { name: "tracks", label: "Tracks and movers over time",
    height: (width) => Math.min((width * (north - south)) / (east - west), Math.max(0.6 * window.innerHeight, 320)), draw: drawTracks });
  made.caption.textContent = "Rings: tracks with their velocity for a second, at the last stop before; crosses: their states at the stops. " +
    "Squares: true movers, with their way of the last seconds. Circle: receiver.";
  made.element.classList.add("whole");
  grid.append(html("div", { class: "player whole noprint" }, play, slider, clock));
  plan.push(made);
  for (const [name, label, yLabel, valueOf] of [
    ["range-doppler", "Delay and Doppler shift", "delay, ns", (paths) => paths.delay_ns],
    ["angle-doppler", "Azimuth of arrival and Doppler shift", "azimuth of arrival, deg", (paths) => paths.aoa_deg],
  ]) {
    const made = figure(grid, { name, label: `${label} of the paths of the stop`, height: (width) => Math.min(0.62 * width + 40, 470),
      draw: (drawing, width, height) => drawShifts(drawing, width, height, yLabel, valueOf) });
    made.caption.textContent = `${label} of the estimated paths; the larger, the stronger. Open: what stands; filled: movers, in the ` +
      "colours of their tracks, grey without one.";
  }
  onChange(() => {
    if (rowAt(world.frame_s[motion.frame]) === state.row) return;
    motion.frame = Math.max(world.frame_s.findIndex((time) => time >= world.time_s[state.row] - 1e-3), 0);
    slider.value = motion.frame;
    clock.textContent = `${shown(world.frame_s[motion.frame], 2)} s`;
  });
  motion.frame = Math.max(world.frame_s.findIndex((time) => time >= world.time_s[state.row] - 1e-3), 0);
  slider.value = motion.frame;
  clock.textContent = `${shown(world.frame_s[motion.frame], 2)} s`;
}

/** Row of the last stop at or before a time. */
function rowAt(time) {
  return Math.max(data.tracks.time_s.findLastIndex((one) => one <= time + 2e-3), 0);
}

function trackColor(index) {
  return index < 0 ? "var(--ghost)" : `var(--c${index % N_COLORS})`;
}

function drawTracks(drawing, width, height) {
  const world = data.tracks;
  const to = (() => {
    const scale = Math.min(width / (east - west), height / (north - south));
    return ([x, y]) => [width / 2 + (x - (west + east) / 2) * scale, height / 2 - (y - (south + north) / 2) * scale];
  })();
  const hits = [];
  const add = (tag, attributes) => drawing.appendChild(svg(tag, attributes));
  const moving = new Set(world.movers.map((mover) => mover.name));
  for (const object of data.scene.objects) {
    if (!moving.has(object.name)) add("path", { class: `object ${object.closed ? "solid" : "sheet"}`, d: lineD(pairs(object.xy).map(to), object.closed) });
  }
  add("path", { class: "walk", d: lineD(pairs(data.scene.walk).map(to)) });
  for (const tx of data.scene.txs) add("path", { class: "tx", d: glyphD("diamond", to(tx.xy), 5) });
  const now = world.frame_s[motion.frame];
  const rx = to(pairAt(world.rx, motion.frame));
  add("path", { class: "stop", d: glyphD("circle", rx, 4) });
  hits.push({ x: rx[0], y: rx[1], text: "receiver" });
  for (const mover of world.movers) {
    const first = Math.max(world.frame_s.findIndex((time) => time >= now - TRAIL_S), 0);
    const trail = pairs(mover.xy).slice(first, motion.frame + 1).map(to);
    add("path", { class: "mover-trail", d: lineD(trail) });
    const here = to(pairAt(mover.xy, motion.frame));
    add("path", { class: "mover", d: glyphD("square", here, 5) });
    hits.push({ x: here[0], y: here[1], text: mover.name });
  }
  const row = rowAt(now);
  world.tracks.forEach((track, index) => {
    const style = `stroke:${trackColor(index)}`;
    const past = track.row.map((one, place) => [one, place]).filter(([one]) => one <= row);
    if (!past.length) return;
    const points = past.map(([, place]) => to(pairAt(track.xy, place)));
    add("path", { class: "track-way", d: lineD(points), style });
    for (const point of points) add("path", { class: "track-state", d: glyphD("cross", point, 3), style });
    const [lastRow, place] = past[past.length - 1];
    if (lastRow !== row) return;
    const [x, y] = pairAt(track.xy, place);
    const [at, ahead] = [to([x, y]), to([x + track.velocity[2 * place], y + track.velocity[2 * place + 1]])];
    add("path", { class: "track-here", d: `${glyphD("circle", at, 8)}M${at[0]} ${at[1]}L${ahead[0]} ${ahead[1]}`, style });
    hits.push({ x: at[0], y: at[1], text: `track ${index}: ${shown(Math.hypot(track.velocity[2 * place], track.velocity[2 * place + 1]), 2)} m/s, `
      + `height ${shown(track.height_m[place], 2)} m, position known to ${measured(track.std_m[place], "m")}, `
      + `exists with ${shown(100 * track.existence[place], 0)} %` });
  });
  const words = add("g", { class: "object-names halo" });
  for (const mover of world.movers) {
    const [x, y] = to(pairAt(mover.xy, motion.frame));
    words.append(svg("text", { x, y: y - 11, "text-anchor": "middle" }, mover.name));
  }
  return hits;
}

function drawShifts(drawing, width, height, yLabel, valueOf) {
  const paths = data.estimated[state.row];
  const { doppler_hz: shift, still, track } = data.tracks.shifts[state.row];
  const known = shift.map((one, index) => index).filter((index) => shift[index] !== null);
  const box = { left: 58, top: 8, width: width - 70, height: height - 50 };
  if (!known.length) return [];
  const range = (values) => {
    const [low, high] = [Math.min(...values), Math.max(...values)];
    const room = 0.06 * (high - low) + 1;
    return [low - room, high + room];
  };
  const { sx, sy } = axes(drawing, box, { x: range(known.map((index) => shift[index])), y: range(known.map((index) => valueOf(paths)[index])),
    xLabel: "Doppler shift, Hz", yLabel });
  const top = Math.max(...known.map((index) => paths.power_dbm[index]));
  return known.map((index) => {
    const place = [sx(shift[index]), sy(valueOf(paths)[index])];
    const size = LARGEST_MARK * Math.max(1 - (top - paths.power_dbm[index]) / SHOWN_POWER_DB, 0.4);
    const color = trackColor(track[index]);
    drawing.append(svg("path", { class: still[index] ? "shift still" : "shift", d: glyphD("circle", place, size),
      style: still[index] ? "" : `fill:${color}` }));
    const whose = still[index] ? "stands" : track[index] < 0 ? "moves" : `track ${track[index]}`;
    return { x: place[0], y: place[1], text: `path ${index}: ${shown(shift[index], 0)} Hz, ${shown(paths.delay_ns[index], 1)} ns, ${whose}`,
      pick: () => select({ path: `e${index}` }) };
  });
}

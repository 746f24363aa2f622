// Tables of the selected stop and object; each row selects its path or point.

/** The meaning of the words in a text, for its title. */
function meanings(text) {
  return Object.entries(data.words).filter(([word]) => new RegExp(`\\b${word}`, "i").test(text))
    .map(([word, meaning]) => `${word}: ${meaning}`).join("\n") || null;
}

/** A table; `rows` are {cells, key, pick, chosen}. A row with `pick` has its first cell as a button. */
function table(id, heads, rows) {
  const body = rows.map(({ cells, pick, chosen, kind }) => {
    const first = pick
      ? html("button", { type: "button", class: "link", onclick: pick, "aria-pressed": String(Boolean(chosen)) }, cells[0])
      : cells[0];
    return html("tr", { class: `${chosen ? "chosen" : ""} ${kind ?? ""}` }, html("td", {}, first),
      cells.slice(1).map((cell) => html("td", {}, cell)));
  });
  return html("table", { id }, html("thead", {}, html("tr", {}, heads.map((head) => html("th", { scope: "col", title: meanings(head) }, head)))),
    html("tbody", {}, body));
}

/** A mark of the figures, for a table or a legend. */
function swatch(kinds, shape, r = 4.5, style = "") {
  return svg("svg", { class: "swatch", viewBox: "-8 -8 16 16", width: 16, height: 16, "aria-hidden": "true" },
    svg("path", { class: kinds, d: glyphD(shape, [0, 0], r), style }));
}

function pathTable(row) {
  const [paths, truth] = [data.estimated[row], data.true[row]];
  const cone = (key) => (data.angles[key] === "cone angle" ? " (cone angle)" : "");
  const [aod, aoa] = [`AoD${cone("aod")}, deg`, `AoA${cone("aoa")}, deg`];
  const heads = ["path", "status", data.has_truth ? "true path" : "object", "delay, ns", aod, aoa, "power, dBm"];
  if (data.has_truth) heads.push("Δ delay, ns", `Δ ${aod}`, `Δ ${aoa}`, "Δ power, dB", "NEES");
  const values = (one, index) => [shown(one.delay_ns[index], 2), shown(one.aod_deg[index], 2), shown(one.aoa_deg[index], 2),
    shown(one.power_dbm[index], 1)];
  const several = data.scene.txs.length > 1;
  if (several) heads.splice(2, 0, "TX");
  const txCells = (one, index) => (several ? [data.scene.txs[one.tx[index]].name] : []);
  const rows = [];
  paths.status.forEach((status, index) => {
    if (isHiddenEstimate(status, index)) return;
    const matched = trueRow(row, index);
    const cause = paths.cause[index] ? `: ${paths.cause[index]}` : "";
    const what = html("span", { title: meanings(STATUS[status]) }, swatch(`estimate-mark ${status}`, STATUS_GLYPHS[status]),
      ` ${STATUS[status]}${cause}${paths.los[index] ? " · taken as LOS by the channel estimate" : ""}`);
    const cells = [`${index}`, what, ...txCells(paths, index), matched >= 0 ? truth.label[matched] : paths.object[index] || "–", ...values(paths, index)];
    if (data.has_truth) {
      cells.push(shown(paths.delay_error_ns[index], 3), shown(paths.aod_error_deg[index], 3), shown(paths.aoa_error_deg[index], 3),
        shown(paths.power_error_db[index], 1), shown(paths.nees[index], 1));
    }
    rows.push(pathRow(cells, `e${index}`));
  });
  truth?.path.forEach((_, index) => {
    if (truth.detected[index]) return;
    const cause = truth.cause[index] ? `: ${truth.cause[index]}` : "";
    const what = html("span", {}, swatch("true-mark missed", "circle", 5.5), ` missed${cause}`);
    rows.push(pathRow([`true ${index}`, what, ...txCells(truth, index), truth.label[index], ...values(truth, index), ...Array(5).fill("–")], `t${index}`));
  });
  const made = table("path-table", heads, rows);
  made.classList.toggle("several", several);
  return made;
}

function pathRow(cells, key) {
  return { cells, chosen: samePath(key), pick: () => select({ path: state.path === key ? "" : key }) };
}

function pointTable(mapName, points) {
  const { ips } = data.maps[mapName];
  const heads = ["stop, path", "supports", "true object", "x, m", "y, m", "σ, cm", "to surface, cm", "to true IP, cm", "NEES"];
  const rows = points.map((index) => {
    const row = data.stops.stop.indexOf(ips.stop[index]);
    const path = `e${ips.path[index]}`;
    const [x, y] = pairAt(ips.xy, index);
    const supports = [ips.ours[index] >= 0 ? `contour ${ips.ours[index]}` : "", ips.paper[index] >= 0 ? `cluster ${ips.paper[index]}` : ""];
    const centi = (value) => shown(value === null ? null : 100 * value, 1);
    return {
      cells: [`${ips.stop[index]}, ${ips.path[index]}`, supports.filter(Boolean).join(", ") || "–",
        originOf(ips, index), shown(x, 2), shown(y, 2),
        `${centi(ips.std_m[2 * index])} × ${centi(ips.std_m[2 * index + 1])}`, centi(ips.surface_m[index]), centi(ips.error_m[index]),
        shown(ips.nees[index], 1)],
      chosen: row === state.row,
      pick: () => select({ row, path }),
    };
  });
  return table(`point-table-${mapName}`, heads, rows);
}

// The selection and the visible layers. The address of the page stores them: #stop=12&object=pillar_1&map=slam

const LAYERS = {
  true: "true paths",
  several: "also of several bounces",
  estimated: "estimated paths",
  weak: "also weak or diffuse",
  points: "incidence points",
  band: "95 % bands",
  names: "object names",
};
const OF_TRUTH = ["true", "several", "weak"]; // layers that a measurement does not have
const CHOICES = { map: ["both", "mapping", "slam"], contours: ["ours", "paper", "both"] };
const hasOurs = Object.values(data.maps).some((map) => map.contours.length);
const state = {
  row: 0, // of the stop
  path: "", // e3: the estimated path 3 of the stop, t5: its true path in row 5
  object: "",
  map: window.matchMedia("(max-width: 45rem)").matches ? "mapping" : "both",
  contours: hasOurs ? "ours" : "paper",
  hidden: new Set(["several", "weak"]), // they would hide the plan
};

/** Everything that can be selected as an object: true objects with paths or points, then contours without object. */
const items = findItems();

function findItems() {
  const found = new Map();
  const enter = (key, label, name, ghost = false) => {
    if (!found.has(key)) {
      const rows = { mapping: { contours: [], shapes: [] }, slam: { contours: [], shapes: [] } };
      found.set(key, { key, label, name, ghost, rows, index: found.size });
    }
    return found.get(key);
  };
  const seen = new Set(data.true.flatMap((paths) => (paths ? paths.object : [])));
  for (const map of Object.values(data.maps)) {
    for (const name of map.ips.object) seen.add(name);
    for (const one of [...map.contours, ...map.shapes]) seen.add(one.object);
  }
  for (const object of data.scene.objects) if (seen.has(object.name)) enter(object.name, object.name, object.name);
  for (const [mapName, map] of Object.entries(data.maps)) {
    for (const source of ["contours", "shapes"]) {
      map[source].forEach((one, row) => {
        const word = source === "contours" ? "contour" : "cluster";
        const what = one.called || one.object || "several objects";
        const title = `${mapName === "slam" ? "SLAM" : "mapping"} ${word} ${row}: ${what}`;
        const item = (one.ghost ? null : found.get(one.object)) ?? enter(`${mapName}-${word}-${row}`, title, "", one.ghost);
        item.rows[mapName][source].push(row);
        one.item = item;
      });
    }
  }
  return found;
}

/** The object of an incidence point according to the visible contours; null for none. */
function itemOfPoint(mapName, index) {
  const map = data.maps[mapName];
  const ours = state.contours !== "paper" ? map.contours[map.ips.ours[index]] : null;
  const paper = state.contours !== "ours" ? map.shapes[map.ips.paper[index]] : null;
  return (ours ?? paper)?.item ?? null;
}

/** The visible contours of a map, ours and the paper's, with their source. */
function shownContours(mapName) {
  const map = data.maps[mapName];
  return [
    ...(state.contours !== "ours" ? map.shapes.map((one) => ({ ...one, source: "paper" })) : []),
    ...(state.contours !== "paper" ? map.contours.map((one) => ({ ...one, source: "ours" })) : []),
  ];
}

function shownMaps() {
  return state.map === "both" ? Object.keys(MAPS) : [state.map];
}

const listeners = [];
function onChange(listener) {
  listeners.push(listener);
}

/** Change the selection; a new stop clears the selected path. */
function select(changes) {
  if ("row" in changes && changes.row !== state.row && !("path" in changes)) changes.path = "";
  Object.assign(state, changes);
  writeAddress();
  for (const listener of listeners) listener();
}

function writeAddress() {
  const parts = new URLSearchParams({ stop: data.stops.stop[state.row], map: state.map, contours: state.contours });
  if (state.object) parts.set("object", state.object);
  if (state.path) parts.set("path", state.path);
  parts.set("hide", [...state.hidden].join(","));
  try {
    history.replaceState(null, "", `#${parts}`);
  } catch {
    // Some browsers do not change the address of a local file; the page works without it.
  }
}

/** Apply the selection in the address of the page; unknown values change nothing. */
function readAddress() {
  if (!location.hash.includes("=")) return;
  const parts = new URLSearchParams(location.hash.slice(1));
  const row = data.stops.stop.indexOf(Number(parts.get("stop") ?? NaN));
  if (row >= 0) state.row = row;
  for (const [name, allowed] of Object.entries(CHOICES)) {
    if (allowed.includes(parts.get(name))) state[name] = parts.get(name);
  }
  state.object = items.has(parts.get("object")) ? parts.get("object") : "";
  state.path = /^[et]\d+$/.test(parts.get("path") ?? "") ? parts.get("path") : "";
  if (parts.has("hide")) state.hidden = new Set(parts.get("hide").split(",").filter((name) => name in LAYERS));
}
window.addEventListener("hashchange", () => {
  readAddress();
  for (const listener of listeners) listener();
});

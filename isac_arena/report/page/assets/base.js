// The data of the page, and functions for elements, marks and numbers that all other parts use.

const page = document.documentElement;
function noteError(text) {
  page.dataset.errors = page.dataset.errors ? `${page.dataset.errors}\n${text}` : text;
}
window.addEventListener("error", (event) => noteError(event.message));
window.addEventListener("unhandledrejection", (event) => noteError(String(event.reason)));

const data = JSON.parse(document.getElementById("campaign").textContent);
const MAPS = { mapping: "Mapping: receiver known", slam: "SLAM: receiver unknown" };
const N_COLORS = 6;
const PATH_KINDS = ["line of sight", "one reflection", "two reflections", "three reflections", "diffracted", "through walls"];
const GLYPHS = ["circle", "square", "up", "diamond", "down", "hexagon"];

function fill(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes ?? {})) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value !== null && value !== undefined && value !== false) {
      element.setAttribute(name, value === true ? "" : value);
    }
  }
  element.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return element;
}

/** An HTML element; attributes with the prefix `on` are event listeners. */
function html(tag, attributes, ...children) {
  return fill(document.createElement(tag), attributes, children);
}

const svgNamespace = (() => {
  const template = document.createElement("template");
  template.innerHTML = "<svg></svg>";
  return template.content.firstChild.namespaceURI;
})();

/** An SVG element. */
function svg(tag, attributes, ...children) {
  return fill(document.createElementNS(svgNamespace, tag), attributes, children);
}

/** Flat [x, y, x, y, ...] as a list of [x, y], without unknown points. */
function pairs(flat) {
  const points = [];
  for (let i = 0; i + 1 < flat.length; i += 2) if (flat[i] !== null) points.push([flat[i], flat[i + 1]]);
  return points;
}

/** Point `index` of flat [x, y, ...], or null where it is unknown. */
function pairAt(flat, index) {
  const x = flat[2 * index];
  return x === null || x === undefined ? null : [x, flat[2 * index + 1]];
}

function lineD(points, closed = false) {
  if (!points.length) return "";
  const steps = points.map(([x, y]) => `${x.toFixed(1)} ${y.toFixed(1)}`);
  return `M${steps.join("L")}${closed ? "Z" : ""}`;
}

/** Outline of a mark at a position, for the attribute `d` of a path. */
function glyphD(shape, [x, y], r) {
  const around = (corners) => lineD(corners.map(([dx, dy]) => [x + r * dx, y + r * dy]), true);
  switch (shape) {
    case "square": return around([[-0.85, -0.85], [0.85, -0.85], [0.85, 0.85], [-0.85, 0.85]]);
    case "diamond": return around([[0, -1.2], [1.2, 0], [0, 1.2], [-1.2, 0]]);
    case "up": return around([[0, -1.2], [1.1, 0.8], [-1.1, 0.8]]);
    case "down": return around([[0, 1.2], [1.1, -0.8], [-1.1, -0.8]]);
    case "hexagon": return around([[1, 0], [0.5, 0.9], [-0.5, 0.9], [-1, 0], [-0.5, -0.9], [0.5, -0.9]]);
    case "cross": return `M${x - r} ${y - r}l${2 * r} ${2 * r}m0 ${-2 * r}l${-2 * r} ${2 * r}`;
    case "plus": return `M${x - r} ${y}h${2 * r}M${x} ${y - r}v${2 * r}`;
    case "tripod": return `M${x} ${y}v${1.3 * r}M${x} ${y}l${-1.1 * r} ${-0.8 * r}M${x} ${y}l${1.1 * r} ${-0.8 * r}`;
    default: return `M${x - r} ${y}a${r} ${r} 0 1 0 ${2 * r} 0a${r} ${r} 0 1 0 ${-2 * r} 0z`;
  }
}

/** Colour and mark of the `index`-th object; the first 36 objects have different pairs. */
function look(index) {
  return {
    color: `var(--c${index % N_COLORS})`,
    shape: GLYPHS[(index + Math.floor(index / N_COLORS)) % GLYPHS.length],
  };
}

/** Where an incidence point comes from: its object, or why it has none. */
function originOf(ips, index) {
  return ips.object[index] || ips.cause[index] || "no single bounce";
}

/** A number with a fixed number of decimals and a typographic minus sign; a dash where it is unknown. */
function shown(value, decimals = 2, unit = "") {
  if (value === null || value === undefined) return "–";
  const text = value.toFixed(decimals).replace(/^-(0(\.0*)?)$/, "$1").replace("-", "−");
  return unit ? `${text} ${unit}` : text;
}

/** A length, angle or time with three significant digits in a suitable unit: 4.30 mm, 0.00420 deg, 21.3 ps. */
function measured(value, unit, signed = false) {
  if (value === null || value === undefined) return "–";
  const units = { m: [[1, 1, "m"], [1e-2, 1e-2, "cm"], [0, 1e-3, "mm"]], // from, step, name
    deg: [[0, 1, "deg"]], ns: [[0.1, 1, "ns"], [0, 1e-3, "ps"]] }[unit];
  const size = Math.abs(value);
  if (size < 1e-9) return `0 ${unit}`; // rounding of the computation
  const [, step, name] = units.find(([from]) => size >= 0.9995 * from);
  const digits = Math.max(2 - Math.floor(Math.log10((1.0005 * size) / step)), 0);
  const sign = signed && value > 0 ? "+" : "";
  return `${sign}${shown(value / step, Math.min(digits, 7))} ${name}`;
}

function nearestTicks(low, high, count) {
  const raw = (high - low) / Math.max(count, 1);
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= raw);
  const ticks = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k += 1) ticks.push(k * step);
  return { ticks, decimals: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
}

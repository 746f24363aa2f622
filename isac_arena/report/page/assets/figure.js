// Figures: a frame with caption and downloads, axes, and the tooltip of the mark under the pointer.

const PRINTED_WIDTH = 440; // in CSS pixels, so that text is readable in two columns on paper
let isPrinting = false;
window.addEventListener("beforeprint", () => { isPrinting = true; });
window.addEventListener("afterprint", () => { isPrinting = false; });

const tip = html("div", { class: "tip", role: "status", hidden: true });

function showTip(event, text) {
  tip.hidden = !text;
  if (!text) return;
  tip.textContent = text;
  const { innerWidth, innerHeight } = window;
  tip.style.left = `${Math.min(event.clientX + 14, innerWidth - tip.offsetWidth - 8)}px`;
  tip.style.top = `${Math.min(event.clientY + 14, innerHeight - tip.offsetHeight - 8)}px`;
}

/**
 * A figure that is drawn again when its size or the selection changes.
 *
 * `draw(drawing, width, height)` fills an empty SVG element and returns the marks that react to the pointer: a list
 * of {x, y, text, pick} in pixels.
 */
function figure(parent, { name, label, height, draw, tools = [] }) {
  const drawing = svg("svg", { role: "img", "aria-label": label, class: "drawing", id: `drawing-${name}` });
  const caption = html("figcaption", {});
  const buttons = ["SVG", "PNG"].map((kind) =>
    html("button", { type: "button", onclick: () => download(drawing, name, kind), "aria-label": `${label}: ${kind}` }, kind),
  );
  const frame = html("div", { class: "frame" }, drawing);
  const element = html("figure", { class: "chart", id: `figure-${name}` }, frame,
    html("div", { class: "under" }, caption, html("span", { class: "buttons noprint" }, tools, "Save as ", buttons)));
  parent.append(element);
  let hits = [];
  let queued = false;
  const render = () => {
    queued = false;
    if (!frame.clientWidth) return;
    const width = isPrinting ? PRINTED_WIDTH : Math.max(frame.clientWidth, 240);
    const tall = Math.round(height(width));
    drawing.replaceChildren();
    fill(drawing, { viewBox: `0 0 ${width} ${tall}`, width, height: tall }, []);
    hits = draw(drawing, width, tall) ?? [];
  };
  const redraw = () => {
    if (!queued) requestAnimationFrame(render);
    queued = true;
  };
  const hitAt = (event) => {
    const box = drawing.getBoundingClientRect();
    const scale = drawing.viewBox.baseVal.width / box.width;
    const at = [(event.clientX - box.left) * scale, (event.clientY - box.top) * scale];
    const reach = event.pointerType === "touch" ? 22 : 12;
    let best = null;
    let least = reach;
    for (const hit of hits) {
      const far = Math.hypot(hit.x - at[0], hit.y - at[1]);
      if (far < least) [best, least] = [hit, far];
    }
    return best;
  };
  drawing.addEventListener("pointermove", (event) => {
    const hit = event.buttons ? null : hitAt(event);
    drawing.classList.toggle("at", Boolean(hit?.pick));
    showTip(event, hit?.text);
  });
  drawing.addEventListener("pointerleave", (event) => showTip(event, ""));
  let pressed = [0, 0];
  drawing.addEventListener("pointerdown", (event) => { pressed = [event.clientX, event.clientY]; });
  drawing.addEventListener("click", (event) => {
    const dragged = Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) > 5;
    if (!dragged) hitAt(event)?.pick?.();
  });
  new ResizeObserver(redraw).observe(frame);
  onChange(redraw);
  for (const event of ["beforeprint", "afterprint"]) window.addEventListener(event, render);
  return { element, drawing, caption, redraw };
}

/** Axes with grid and labels around a box; returns the scales from values to pixels. */
function axes(drawing, box, { x, y, xLabel, yLabel, rows = true }) {
  const sx = (value) => box.left + ((value - x[0]) / (x[1] - x[0])) * box.width;
  const sy = (value) => box.top + box.height - ((value - y[0]) / (y[1] - y[0])) * box.height;
  const across = nearestTicks(x[0], x[1], box.width / 56);
  const up = rows ? nearestTicks(y[0], y[1], box.height / 45) : { ticks: [], decimals: 0 };
  const grid = svg("g", { class: "grid" });
  const words = svg("g", { class: "ticks" });
  for (const value of across.ticks) {
    grid.append(svg("path", { d: `M${sx(value)} ${box.top}v${box.height}` }));
    words.append(svg("text", { x: sx(value), y: box.top + box.height + 15, "text-anchor": "middle" },
      shown(value, across.decimals)));
  }
  for (const value of up.ticks) {
    grid.append(svg("path", { d: `M${box.left} ${sy(value)}h${box.width}` }));
    words.append(svg("text", { x: box.left - 6, y: sy(value) + 4, "text-anchor": "end" },
      shown(value, up.decimals)));
  }
  words.append(svg("text", { x: box.left + box.width / 2, y: box.top + box.height + 32, "text-anchor": "middle" }, xLabel));
  const middle = box.top + box.height / 2;
  words.append(svg("text", { x: 13, y: middle, "text-anchor": "middle", transform: `rotate(-90 13 ${middle})` }, yLabel));
  drawing.append(grid, words);
  return { sx, sy };
}

function fileName(name, kind) {
  return `${data.name}_${name}`.replace(/[^\w-]+/g, "_") + `.${kind.toLowerCase()}`;
}

function save(url, name) {
  const link = html("a", { href: url, download: name });
  document.body.append(link);
  link.click();
  link.remove();
}

const KEPT_STYLES = ["fill", "fill-opacity", "stroke", "stroke-width", "stroke-dasharray", "stroke-opacity",
  "stroke-linecap", "stroke-linejoin", "opacity", "font-family", "font-size", "font-weight", "text-anchor",
  "paint-order", "clip-path", "image-rendering"];

/** The drawing as a standalone file: its styles on the page are written into each element. */
function standalone(drawing) {
  const copy = drawing.cloneNode(true);
  const from = drawing.querySelectorAll("*");
  copy.querySelectorAll("*").forEach((element, index) => {
    const style = getComputedStyle(from[index]);
    const kept = KEPT_STYLES.map((name) => [name, style.getPropertyValue(name)]).filter(([, value]) => value);
    element.removeAttribute("class");
    element.setAttribute("style", kept.map(([name, value]) => `${name}:${value.replace(/"/g, "'")}`).join(";"));
  });
  const paper = getComputedStyle(document.body).backgroundColor;
  copy.prepend(svg("rect", { width: "100%", height: "100%", fill: paper }));
  copy.removeAttribute("class");
  return new XMLSerializer().serializeToString(copy);
}

function download(drawing, name, kind) {
  const text = standalone(drawing);
  if (kind === "SVG") {
    save(URL.createObjectURL(new Blob([text], { type: "image/svg+xml" })), fileName(name, kind));
    return;
  }
  const picture = new Image();
  picture.onload = () => {
    const canvas = html("canvas", { width: 2 * picture.width, height: 2 * picture.height });
    canvas.getContext("2d").drawImage(picture, 0, 0, canvas.width, canvas.height);
    save(canvas.toDataURL("image/png"), fileName(name, kind));
  };
  picture.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(text)}`;
}

// The visible part of the floor plan, common to both maps: the whole scene at first. Mouse, touch and keys move and
// zoom it.

const view = { x: 0, y: 0, zoom: 1 };
const [west, south, east, north] = data.scene.extent;
const ZOOM_LIMITS = [0.3, 60];
const MOST_FOCUS = 2.5;

function resetView() {
  Object.assign(view, { x: (west + east) / 2, y: (south + north) / 2, zoom: 1 });
}
function showWalk() {
  const [x0, y0, x1, y1] = data.scene.view;
  const zoom = Math.min((east - west) / (x1 - x0), (north - south) / (y1 - y0));
  Object.assign(view, { x: (x0 + x1) / 2, y: (y0 + y1) / 2, zoom });
}
resetView();

/** Pixels per metre of a drawing of this size, and the conversions between metres and pixels. */
function projection(width, height) {
  const scale = view.zoom * Math.min(width / (east - west), height / (north - south));
  return {
    scale,
    to: ([x, y]) => [width / 2 + (x - view.x) * scale, height / 2 - (y - view.y) * scale],
    back: ([px, py]) => [view.x + (px - width / 2) / scale, view.y - (py - height / 2) / scale],
  };
}

/** Centre the view on these points [x, y] with a margin, at a zoom of at most `MOST_FOCUS`. */
function showPoints(points, room = 1) {
  const xs = points.map(([x]) => x);
  const ys = points.map(([, y]) => y);
  const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  const fit = Math.min((east - west) / (x1 - x0 + 2 * room), (north - south) / (y1 - y0 + 2 * room));
  Object.assign(view, { x: (x0 + x1) / 2, y: (y0 + y1) / 2, zoom: Math.min(fit, MOST_FOCUS) });
}

/** Zoom by a factor about a fixed point (pixels of a drawing of this size). */
function zoomAt(factor, [px, py], width, height) {
  const before = projection(width, height).back([px, py]);
  view.zoom = Math.min(ZOOM_LIMITS[1], Math.max(ZOOM_LIMITS[0], view.zoom * factor));
  const after = projection(width, height).back([px, py]);
  view.x += before[0] - after[0];
  view.y += before[1] - after[1];
}

function moveBy(dx, dy, width, height) {
  const { scale } = projection(width, height);
  view.x -= dx / scale;
  view.y += dy / scale;
}

/** The mouse drags; on a touch screen two fingers move and zoom, and one finger scrolls the page. */
function enablePanZoom(drawing, redraw) {
  const pointers = new Map();
  const size = () => {
    const box = drawing.getBoundingClientRect();
    return [box.width, box.height, box.left, box.top];
  };
  const spread = () => {
    const [a, b] = [...pointers.values()];
    return { far: Math.hypot(a.x - b.x, a.y - b.y), x: (a.x + b.x) / 2, y: (a.y + b.y) / 2 };
  };
  drawing.addEventListener("pointerdown", (event) => {
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  });
  for (const end of ["pointerup", "pointercancel", "pointerleave"]) {
    drawing.addEventListener(end, (event) => pointers.delete(event.pointerId));
  }
  drawing.addEventListener("pointermove", (event) => {
    const last = pointers.get(event.pointerId);
    if (!last) return;
    const [width, height, left, top] = size();
    const here = { x: event.clientX, y: event.clientY };
    if (pointers.size === 2) {
      const before = spread();
      pointers.set(event.pointerId, here);
      const after = spread();
      zoomAt(after.far / Math.max(before.far, 1), [after.x - left, after.y - top], width, height);
      moveBy(after.x - before.x, after.y - before.y, width, height);
    } else if (event.pointerType !== "touch") {
      moveBy(here.x - last.x, here.y - last.y, width, height);
    } else return;
    pointers.set(event.pointerId, here);
    redraw();
  });
  drawing.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && document.activeElement !== drawing) return; // else the page scrolls
    event.preventDefault();
    const [width, height, left, top] = size();
    zoomAt(Math.exp(-event.deltaY / 400), [event.clientX - left, event.clientY - top], width, height);
    redraw();
  }, { passive: false });
  drawing.addEventListener("keydown", (event) => {
    const [width, height] = size();
    const step = 40;
    const moves = { ArrowLeft: [step, 0], ArrowRight: [-step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] };
    const zooms = { "+": 1.25, "=": 1.25, "-": 0.8 };
    if (event.key in moves) moveBy(...moves[event.key], width, height);
    else if (event.key in zooms) zoomAt(zooms[event.key], [width / 2, height / 2], width, height);
    else if (event.key === "0") resetView();
    else return;
    event.preventDefault();
    redraw();
  });
}

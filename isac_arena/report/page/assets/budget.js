// The error budget, if the campaign has one: waterfalls from the whole error down to the rest.

const OUTCOMES = { pose: "Receiver position", shape: "Contours, published method", contour: "Our contours" };
const BUDGETS = { stages: "truth in place of a stage", physics: "physics switched off" };
const LETTER_PIXELS = 6.8; // the widest of the texts beside the bars

function makeBudgetPanel(parent) {
  if (!data.budget) return;
  parent.append(html("h3", { id: "budget-title" }, "Error budget"), html("p", {}, "Decrease of the final error when truth replaces " +
    "a stage, or when a part of physics is switched off: shares of the mean square error with 95 % intervals, and " +
    "the root of each part's mean square. Pale: the interval contains zero, so the effect is undecided. Where " +
    "shares are meaningless, the parts are in cm²."));
  const grid = html("div", { class: "pair" });
  parent.append(grid);
  const groups = new Map();
  for (const row of data.budget) {
    const key = `${row.outcome}-${row.budget}`;
    groups.set(key, [...(groups.get(key) ?? []), row]);
  }
  for (const [key, rows] of groups) {
    const title = `${OUTCOMES[rows[0].outcome] ?? rows[0].outcome}: ${BUDGETS[rows[0].budget]}`;
    const made = figure(grid, {
      name: `budget-${key}`,
      label: `Error budget, ${title}`,
      height: () => 34 * rows.length + 46,
      draw: (drawing, width, height) => drawWaterfall(drawing, rows, width, height),
    });
    made.caption.append(html("b", {}, title), rows[0].objection ? `. No shares: ${rows[0].objection}.` : "");
  }
}

/** Draw rows from the whole error at the top, part by part, down to the rest. */
function drawWaterfall(drawing, rows, width, height) {
  const whole = rows.filter((row) => row.part === "all errors");
  const rest = rows.filter((row) => row.part === "rest");
  const parts = rows.filter((row) => !whole.includes(row) && !rest.includes(row));
  const lines = [...whole, ...parts, ...rest];
  const hasShares = !rows[0].objection;
  const percent = (share) => 100 * (share ?? 0);
  const size = (row) => (hasShares ? percent(row.share) : 1e4 * (row.mean_square_m2 ?? 0));
  const noteOf = (row) => `${parts.includes(row) && size(row) < 0 ? "grows " : ""}`
    + `${hasShares ? `${shown(Math.abs(percent(row.share)), 1)} %, ` : ""}${measured(Math.abs(row.rms_m ?? 0), "m")}`;
  const room = (words) => LETTER_PIXELS * Math.max(...words.map((word) => word.length)) + 16;
  const [left, right] = [room(lines.map((row) => row.part)), room(lines.map(noteOf))];
  const box = { left, top: 4, width: width - left - right, height: height - 44 };
  let level = size(whole[0]);
  const bars = lines.map((row) => {
    if (!parts.includes(row)) return { row, from: 0, to: size(row), kind: whole.includes(row) ? "whole" : "rest" };
    const sign = size(row) < 0 ? "grows" : "falls";
    const bar = { row, from: level, to: level - size(row), kind: `${sign} ${row.effect === "undecided" ? "undecided" : ""}` };
    level = bar.to;
    return bar;
  });
  const ends = bars.flatMap((bar) => [bar.from, bar.to]);
  const x = [Math.min(0, ...ends), Math.max(...ends, 1e-9)];
  const { sx } = axes(drawing, box, { x, y: [0, 1], rows: false, yLabel: "",
    xLabel: hasShares ? "share of the mean square error, %" : "mean square error, cm²" });
  const step = box.height / lines.length;
  const words = svg("g", { class: "ticks" });
  const hits = [];
  bars.forEach(({ row, from, to, kind }, index) => {
    const y = box.top + (index + 0.5) * step;
    const [low, high] = [Math.min(sx(from), sx(to)), Math.max(sx(from), sx(to))];
    drawing.append(svg("rect", { class: `budget ${kind}`, x: low, y: y - 0.3 * step, width: Math.max(high - low, 1), height: 0.6 * step }));
    if (row.share_low !== null && row.share_high !== null && kind !== "whole") {
      const at = (share) => Math.min(Math.max(sx(kind === "rest" ? percent(share) : from - percent(share)), box.left), box.left + box.width);
      drawing.append(svg("path", { class: "whisker", d: `M${at(row.share_low)} ${y}H${at(row.share_high)}` }));
    }
    words.append(svg("text", { x: box.left - 8, y: y + 4, "text-anchor": "end" }, row.part));
    const note = noteOf(row);
    words.append(svg("text", { x: width - 2, y: y + 4, "text-anchor": "end" }, note));
    const span = row.share_low === null ? "" : `; 95 %: ${shown(percent(row.share_low), 1)} to ${shown(percent(row.share_high), 1)} %`;
    const doubt = row.effect === "undecided" ? "; undecided" : "";
    hits.push({ x: (low + high) / 2, y, text: `${row.part}: ${note}${span}${doubt}` });
  });
  drawing.append(words);
  return hits;
}

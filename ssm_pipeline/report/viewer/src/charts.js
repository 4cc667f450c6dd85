// Line charts as SVG: bands of standard errors, values read by pointer or arrow keys into a table.

const NS = "http://www.w3.org/2000/svg";
const COLOURS = 8;
const DASHES = ["", "7 4", "2 3", "9 3 2 3", "12 4", "4 2"];
const STRIPE = 9; // length of one line's turn where several coincide
const W = 340, H = 220, LEFT = 46, RIGHT = 8, TOP = 8, BOTTOM = 34;
// Within a circle of radius 1.
const SHAPES = [
  "M1 0A1 1 0 1 1 -1 0A1 1 0 1 1 1 0Z",
  "M-.9 -.9H.9V.9H-.9Z",
  "M0 -1.2L1.1 .8H-1.1Z",
  "M0 -1.3L1.2 0L0 1.3L-1.2 0Z",
  "M0 1.2L1.1 -.8H-1.1Z",
];

export const svg = (name, attributes, text) => {
  const element = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  return element;
};
const html = (name, properties = {}, ...children) => {
  const element = Object.assign(document.createElement(name), properties);
  element.append(...children);
  return element;
};

/** Colour, dashes and marker of each name: no two are alike. A hollow marker: no network is used. */
export function styles(names, traits = {}) {
  return Object.fromEntries(
    names.map((name, i) => {
      const round = Math.floor(i / COLOURS);
      return [name, { colour: `var(--series-${(i % COLOURS) + 1})`, dash: DASHES[round % DASHES.length], shape: SHAPES[i % SHAPES.length], hollow: traits[name]?.network === false }];
    }),
  );
}

/** Round tick values that cover low … high. */
export function ticks(low, high, count) {
  const raw = (high - low || 1) / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((n) => n * power).find((n) => n >= raw);
  const out = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) out.push(i * step);
  return { values: out, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
}

/** Powers of ten within low … high; all of 1, 2, 5 where there are few. */
function logTicks(low, high) {
  const out = [];
  const steps = Math.log10(high / low) > 2 ? [1] : [1, 2, 5];
  for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power++) {
    for (const step of steps) if (step * 10 ** power >= low && step * 10 ** power <= high) out.push(step * 10 ** power);
  }
  return { values: out, digits: 0 };
}

/** Groups of lines that lie within a line's width of one another wherever both are drawn. */
function coinciding(lines, y) {
  const group = lines.map((_, i) => i);
  for (let i = 0; i < lines.length; i++) {
    for (let j = 0; j < i; j++) {
      const shared = lines[i].x.map((x, k) => [k, lines[j].x.indexOf(x)]).filter(([, m]) => m >= 0);
      const apart = shared.some(([k, m]) => Math.abs(y(lines[i].y[k]) - y(lines[j].y[m])) > 1.5);
      if (shared.length > 1 && !apart) group.forEach((g, n) => { if (g === group[i]) group[n] = group[j]; });
    }
  }
  return lines.map((_, i) => lines.map((_, j) => j).filter((j) => group[j] === group[i]));
}

/** A number with three significant digits, as people write it. */
const number = (value, digits) => (digits !== undefined ? value.toFixed(digits) : Math.abs(value) >= 100 ? value.toFixed(0) : Number(value.toPrecision(3)).toString()).replace("-", "−");

/**
 * A chart of lines [{ name, x, y, se }].
 * options: title, unit, xLabel, at(x) → text, log, lowerIsBetter (sorts the readout), style (name →
 * colour, …), main (the name drawn strongest), percent.
 */
export function lineChart(lines, options) {
  const { title, unit, xLabel, log = false, style, main } = options;
  const element = html("div", { className: "chart" }, html("h3", { textContent: title }));
  const xs = [...new Set(lines.flatMap((line) => line.x))].sort((a, b) => a - b);
  const error = (line, i) => line.se?.[i] ?? 0;
  const spread = lines.flatMap((line) => line.y.flatMap((v, i) => [v - error(line, i), v + error(line, i)])).filter((v) => !log || v > 0);
  let low = Math.min(...spread, options.from ?? Infinity), high = Math.max(...spread, options.to ?? -Infinity);
  if (log) {
    low /= 1.2;
    high *= 1.2;
  } else {
    const room = 0.06 * (high - low || Math.abs(high) || 1);
    low = low >= 0 ? Math.max(0, low - room) : low - room;
    high += room;
    if (options.percent) high = Math.min(high, 100);
  }
  const first = xs[0], last = xs.at(-1);
  const scaled = (v) => (log ? Math.log(v / low) / Math.log(high / low) : (v - low) / (high - low));
  const x = (m) => LEFT + ((W - LEFT - RIGHT) * (m - first)) / Math.max(last - first, 1e-9);
  const y = (v) => H - BOTTOM - (H - TOP - BOTTOM) * scaled(v);
  const chart = svg("svg", { viewBox: `0 0 ${W} ${H}`, tabindex: 0, role: "img", "aria-label": `${title}, ${unit}, by ${xLabel}. Press the left and right arrow keys to read values.` });
  const vertical = log ? logTicks(low, high) : ticks(low, high, 5);
  for (const value of vertical.values) {
    chart.append(svg("path", { class: "axis", d: `M${LEFT} ${y(value)}H${W - RIGHT}` }));
    chart.append(svg("text", { x: LEFT - 5, y: y(value) + 4, "text-anchor": "end" }, log ? number(value) : value.toFixed(vertical.digits)));
  }
  const whole = xs.every(Number.isInteger);
  const horizontal = ticks(first, last, 6);
  for (const m of horizontal.values.filter((v) => !whole || Number.isInteger(v))) {
    chart.append(svg("text", { x: x(m), y: H - BOTTOM + 15, "text-anchor": "middle" }, m.toFixed(whole ? 0 : horizontal.digits)));
  }
  chart.append(svg("text", { x: (LEFT + W - RIGHT) / 2, y: H - 3, "text-anchor": "middle" }, xLabel));

  const together = coinciding(lines, y);
  // The main line is drawn last, on top of the others.
  const drawn = lines.map((line, i) => i).sort((a, b) => (lines[a].name === main) - (lines[b].name === main));
  const groups = {};
  for (const i of drawn) {
    const line = lines[i], { colour, dash, shape, hollow } = style[line.name];
    const group = svg("g", { class: "line", "data-name": line.name });
    const corner = (sign) => line.x.map((m, k) => `${x(m)} ${y(line.y[k] + sign * error(line, k))}`);
    if (line.se?.some((se) => se)) group.append(svg("path", { class: "band", d: `M${[...corner(1), ...corner(-1).reverse()].join("L")}Z`, fill: colour }));
    const shared = together[i];
    const pattern = shared.length > 1 ? `${STRIPE} ${STRIPE * (shared.length - 1)}` : dash;
    const offset = shared.length > 1 ? -STRIPE * shared.indexOf(i) : 0;
    group.append(svg("path", { class: "curve", d: `M${corner(0).join("L")}`, stroke: colour, "stroke-width": line.name === main ? 3 : 1.75, "stroke-dasharray": pattern, "stroke-dashoffset": offset }));
    if (options.markers !== false || line.x.length === 1) {
      // Each line has its markers at other places than its neighbours: lines that coincide show all.
      const every = Math.min(line.x.length, Math.max(1, Math.min(6, lines.length)));
      for (let k = i % every; k < line.x.length; k += every) {
        group.append(svg("path", { d: shape, transform: `translate(${x(line.x[k])} ${y(line.y[k])}) scale(3.2)`, fill: hollow ? "var(--card)" : colour, stroke: colour, "stroke-width": 0.5 }));
      }
    }
    groups[line.name] = group;
    chart.append(group);
  }
  const cursor = svg("path", { class: "cursor", d: "" });
  chart.append(cursor);

  const caption = html("caption");
  caption.setAttribute("aria-live", "polite");
  const head = html("tr", {}, html("th", { scope: "col", textContent: options.nameOf ?? "Method" }), html("th", { scope: "col", className: "number", textContent: unit }));
  const body = html("tbody");
  const reading = html("table", { className: "reading" }, caption, html("thead", {}, head), body);
  const rows = lines.map((line) => {
    const { colour, dash, shape, hollow } = style[line.name];
    const sample = svg("svg", { viewBox: "0 0 26 10", "aria-hidden": "true" });
    sample.append(svg("path", { d: "M0 5H26", stroke: colour, "stroke-width": line.name === main ? 3 : 2, "stroke-dasharray": dash }), svg("path", { d: shape, transform: "translate(13 5) scale(3.4)", fill: hollow ? "var(--card)" : colour, stroke: colour, "stroke-width": 0.5 }));
    const button = html("button", { type: "button", title: "Show this line alone" }, sample, ` ${line.name}`);
    button.setAttribute("aria-pressed", "false");
    const value = html("td", { className: "number" });
    const row = html("tr", { className: line.name === main ? "main" : "" }, html("td", {}, button), value);
    button.addEventListener("click", () => options.choose?.(line.name));
    row.addEventListener("pointerenter", () => emphasise([line.name, ...chosen]));
    row.addEventListener("pointerleave", () => emphasise(chosen));
    return { line, row, value, button };
  });
  const single = html("p", { className: "reading" }); // one line needs no table
  single.setAttribute("aria-live", "polite");
  let chosen = [];
  function emphasise(names) {
    for (const [name, group] of Object.entries(groups)) {
      group.classList.toggle("faint", names.length > 0 && !names.includes(name));
      if (names.includes(name)) cursor.before(group);
    }
  }

  let at = xs.length - 1;
  function read(index) {
    at = Math.max(0, Math.min(xs.length - 1, index));
    cursor.setAttribute("d", `M${x(xs[at])} ${TOP}V${H - BOTTOM}`);
    const sign = options.lowerIsBetter === false ? -1 : 1;
    const found = rows.map((row) => {
      const i = row.line.x.indexOf(xs[at]);
      const known = i >= 0;
      const se = known && row.line.se?.[i] ? ` ± ${number(row.line.se[i], options.digits)}` : "";
      row.value.textContent = known ? `${number(row.line.y[i], options.digits)}${se}` : "–";
      return { ...row, sort: known ? sign * row.line.y[i] : Infinity };
    });
    if (options.sorted !== false) found.sort((a, b) => a.sort - b.sort);
    body.replaceChildren(...found.map((row) => row.row));
    caption.textContent = options.at(xs[at]);
    single.textContent = `${options.at(xs[at])}: ${rows[0].value.textContent} ${unit}`;
  }
  chart.addEventListener("pointermove", (event) => {
    const box = chart.getBoundingClientRect();
    const m = first + ((((event.clientX - box.left) / box.width) * W - LEFT) / (W - LEFT - RIGHT)) * (last - first);
    read(xs.reduce((best, value, i) => (Math.abs(value - m) < Math.abs(xs[best] - m) ? i : best), 0));
  });
  chart.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!step) return;
    event.preventDefault();
    read(at + step);
  });
  read(at);
  element.append(chart, lines.length > 1 ? reading : single);
  const sets = [...new Set(together.filter((set) => set.length > 1).map((set) => set.map((i) => lines[i].name).join(" = ")))];
  if (sets.length) element.append(html("p", { className: "note", textContent: `Striped lines coincide (${sets.join("; ")}).` }));
  return {
    element,
    choose(names) {
      chosen = names;
      emphasise(names);
      for (const { line, button } of rows) button.setAttribute("aria-pressed", String(names.includes(line.name)));
    },
  };
}

/** Charts side by side whose lines of one name are chosen together. make: (choose) → charts. */
export function showTogether(container, make) {
  const chosen = new Set();
  const charts = make((name) => {
    if (!chosen.delete(name)) chosen.add(name);
    for (const chart of charts) chart.choose?.([...chosen]);
  });
  container.replaceChildren(...charts.map((chart) => chart.element));
}

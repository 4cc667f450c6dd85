// Line charts as SVG: a line a method, standard-error bands, values read by pointer or arrow keys.

const NS = "http://www.w3.org/2000/svg";
const DASHES = ["", "7 4", "2 3", "9 3 2 3", "12 4", "4 2"];
const W = 340, H = 210, LEFT = 42, RIGHT = 8, TOP = 8, BOTTOM = 34;

const svg = (name, attributes, text) => {
  const element = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  return element;
};

/** Round tick values that cover low … high. */
function ticks(low, high, count) {
  const raw = (high - low || 1) / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((n) => n * power).find((n) => n >= raw);
  const out = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) out.push(i * step);
  return { values: out, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
}

/** A chart of lines [{ method, modes, value, se }] with its unit on the axis. */
export function lineChart(title, unit, lines, colourOf) {
  const element = Object.assign(document.createElement("div"), { className: "chart" });
  element.append(Object.assign(document.createElement("h3"), { textContent: title }));
  const modes = [...new Set(lines.flatMap((line) => line.modes))].sort((a, b) => a - b);
  const spread = lines.flatMap((line) => line.value.flatMap((v, i) => [v - (line.se[i] ?? 0), v + (line.se[i] ?? 0)]));
  let low = Math.min(...spread), high = Math.max(...spread);
  const room = 0.06 * (high - low || Math.abs(high) || 1);
  low = low >= 0 ? Math.max(0, low - room) : low - room;
  high += room;
  if (unit.includes("%")) high = Math.min(high, 100);
  const last = modes.at(-1);
  const x = (m) => LEFT + ((W - LEFT - RIGHT) * (m - modes[0])) / Math.max(last - modes[0], 1);
  const y = (v) => H - BOTTOM - ((H - TOP - BOTTOM) * (v - low)) / (high - low);
  const chart = svg("svg", { viewBox: `0 0 ${W} ${H}`, tabindex: 0, role: "img", "aria-label": `${title}, ${unit}, by number of modes` });
  const vertical = ticks(low, high, 5);
  for (const value of vertical.values) {
    chart.append(svg("path", { class: "axis", d: `M${LEFT} ${y(value)}H${W - RIGHT}` }));
    chart.append(svg("text", { x: LEFT - 5, y: y(value) + 4, "text-anchor": "end" }, value.toFixed(vertical.digits)));
  }
  for (const m of ticks(modes[0], last, 6).values.filter(Number.isInteger)) {
    chart.append(svg("text", { x: x(m), y: H - BOTTOM + 15, "text-anchor": "middle" }, m));
  }
  chart.append(svg("text", { x: (LEFT + W - RIGHT) / 2, y: H - 3, "text-anchor": "middle" }, "number of modes"));
  const keys = Object.assign(document.createElement("div"), { className: "keys" });
  lines.forEach((line) => {
    const { colour, dash } = colourOf(line.method);
    const upper = line.modes.map((m, i) => `${x(m)} ${y(line.value[i] + (line.se[i] ?? 0))}`);
    const lower = line.modes.map((m, i) => `${x(m)} ${y(line.value[i] - (line.se[i] ?? 0))}`).reverse();
    if (line.se.some((se) => se)) chart.append(svg("path", { d: `M${[...upper, ...lower].join("L")}Z`, fill: colour, opacity: 0.2 }));
    const points = line.modes.map((m, i) => `${x(m)} ${y(line.value[i])}`);
    chart.append(svg("path", { d: `M${points.join("L")}`, fill: "none", stroke: colour, "stroke-width": 2, "stroke-dasharray": dash, "stroke-linejoin": "round" }));
    if (points.length === 1) chart.append(svg("circle", { cx: x(line.modes[0]), cy: y(line.value[0]), r: 3, fill: colour }));
    const key = document.createElement("span");
    const sample = svg("svg", { viewBox: "0 0 26 8", "aria-hidden": "true" });
    sample.append(svg("path", { d: "M0 4H26", stroke: colour, "stroke-width": 2, "stroke-dasharray": dash }));
    key.append(sample, ` ${line.method}`);
    keys.append(key);
  });
  const cursor = svg("path", { class: "cursor", d: "" });
  chart.append(cursor);
  chart.append(svg("text", { x: LEFT - 34, y: TOP, "text-anchor": "start", dy: -4 }, ""));
  const reading = Object.assign(document.createElement("div"), { className: "reading" });
  reading.setAttribute("aria-live", "polite");
  let at = modes.length - 1;
  const read = (index) => {
    at = Math.max(0, Math.min(modes.length - 1, index));
    cursor.setAttribute("d", `M${x(modes[at])} ${TOP}V${H - BOTTOM}`);
    const values = lines.flatMap((line) => {
      const i = line.modes.indexOf(modes[at]);
      if (i < 0) return [];
      const error = line.se[i] ? ` ± ${line.se[i].toFixed(2)}` : "";
      return [`${line.method} ${line.value[i].toFixed(2)}${error} ${unit}`];
    });
    reading.textContent = `${modes[at]} mode${modes[at] === 1 ? "" : "s"}: ${values.join("; ")}`;
  };
  chart.addEventListener("pointermove", (event) => {
    const box = chart.getBoundingClientRect();
    const m = modes[0] + ((((event.clientX - box.left) / box.width) * W - LEFT) / (W - LEFT - RIGHT)) * (last - modes[0]);
    read(modes.reduce((best, value, i) => (Math.abs(value - m) < Math.abs(modes[best] - m) ? i : best), 0));
  });
  chart.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!step) return;
    event.preventDefault();
    read(at + step);
  });
  read(at);
  element.append(chart, keys, reading);
  return element;
}

const UNITS = { compactness: "% of variance", generalisation: "mm", specificity: "mm" };
const TITLES = { compactness: "Compactness (% of variance)", generalisation: "Generalisation (mm)", specificity: "Specificity (mm)" };

/** The three charts for one distance, into `container`. */
export function showCharts(container, curves, distance) {
  const methods = [...new Set(Object.values(curves.charts).flatMap((byDistance) => Object.values(byDistance).flat().map((line) => line.method)))];
  const colourOf = (method) => {
    const i = methods.indexOf(method);
    // Once round the colours, the dashes move on by one: no two lines are alike.
    return { colour: `var(--series-${(i % 6) + 1})`, dash: DASHES[(i + Math.floor(i / 6)) % DASHES.length] };
  };
  const charts = Object.entries(curves.charts).map(([name, byDistance]) => {
    const lines = name === "compactness" ? Object.values(byDistance)[0] : byDistance[distance];
    if (lines?.length) return lineChart(TITLES[name], UNITS[name], lines, colourOf);
    const missing = Object.assign(document.createElement("div"), { className: "chart" });
    missing.append(Object.assign(document.createElement("h3"), { textContent: TITLES[name] }), Object.assign(document.createElement("p"), { className: "note", textContent: "not computed in this run" }));
    return missing;
  });
  container.replaceChildren(...charts);
}

// Scores of the cases over a covariate: a number, or groups with their means.
import { svg, ticks } from "./charts.js";

const W = 340, H = 200, LEFT = 40, RIGHT = 10, TOP = 8, BOTTOM = 34;

/** covariate { name, values, groups (null for numbers) }, scores and names a case. */
export function scatterChart(covariate, scores, names, title) {
  const element = Object.assign(document.createElement("div"), { className: "chart" });
  element.append(Object.assign(document.createElement("h3"), { textContent: title }));
  const { groups } = covariate;
  const values = groups ? covariate.values.map((value) => groups.indexOf(value)) : covariate.values;
  const known = values.map((value, i) => i).filter((i) => values[i] !== null && scores[i] !== null);
  const xs = known.map((i) => values[i]);
  const low = groups ? -0.5 : Math.min(...xs), high = groups ? groups.length - 0.5 : Math.max(...xs);
  const reach = Math.max(1, ...known.map((i) => Math.abs(scores[i]))) * 1.08;
  const x = (v) => LEFT + ((W - LEFT - RIGHT) * (v - low)) / Math.max(high - low, 1e-9);
  const y = (v) => TOP + ((H - TOP - BOTTOM) * (reach - v)) / (2 * reach);
  const chart = svg("svg", { viewBox: `0 0 ${W} ${H}`, role: "img", "aria-label": `${title}: score of ${known.length} cases over ${covariate.name}` });
  for (const value of ticks(-reach, reach, 5).values) {
    chart.append(svg("path", { class: "axis", d: `M${LEFT} ${y(value)}H${W - RIGHT}` }), svg("text", { x: LEFT - 5, y: y(value) + 4, "text-anchor": "end" }, String(value).replace("-", "−")));
  }
  const marks = groups ? groups.map((name, i) => [i, name]) : ticks(low, high, 5).values.map((v) => [v, v]);
  for (const [at, text] of marks) chart.append(svg("text", { x: x(at), y: H - BOTTOM + 15, "text-anchor": "middle" }, text));
  chart.append(svg("text", { x: (LEFT + W - RIGHT) / 2, y: H - 3, "text-anchor": "middle" }, `${covariate.name}; score in SD`));
  // Cases of a group stand side by side, not on top of one another.
  const place = (i) => (groups ? values[i] + 0.24 * (((i * 0.618) % 1) - 0.5) * 2 : values[i]);
  for (const i of known) {
    const point = svg("circle", { cx: x(place(i)), cy: y(scores[i]), r: 3.2, class: "point", fill: groups ? `var(--series-${(values[i] % 8) + 1})` : "var(--series-1)" });
    point.append(svg("title", {}, `${names[i]}: ${covariate.values[i]}, ${scores[i].toFixed(2)} SD`));
    chart.append(point);
  }
  for (const [at] of groups ? marks : []) {
    const own = known.filter((i) => values[i] === at).map((i) => scores[i]);
    if (own.length) chart.append(svg("path", { class: "mean", d: `M${x(at - 0.32)} ${y(own.reduce((a, b) => a + b, 0) / own.length)}H${x(at + 0.32)}` }));
  }
  element.append(chart);
  return element;
}

// Conformal distortion along the chosen pair's path, as the evaluation measured it.
import { lineChart, showTogether, styles } from "./charts.js";

export function showDistortion(container, charts, index) {
  const chart = charts[index];
  container.hidden = !chart;
  if (!chart) return;
  const style = styles(chart.lines.map((line) => line.name));
  showTogether(container, (choose) => [
    lineChart(chart.lines, {
      title: "Conformal distortion", unit: "mean", xLabel: "pose time t", nameOf: "Path", digits: 3,
      style, choose, at: (t) => `at t = ${t.toFixed(2)}, shape time the same`,
    }),
  ]);
}

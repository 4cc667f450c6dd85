// The Training tab: losses, and the map watched while it trains.
import { lineChart, showTogether, styles } from "./charts.js";

export function showTraining(container, charts) {
  showTogether(container, (choose) =>
    charts.map(({ title, unit, log, lines }) =>
      lineChart(lines, {
        title, unit, log, style: styles(lines.map((line) => line.name)), choose, xLabel: "step", nameOf: "Curve", main: "total", markers: lines.length > 1, ...(log || lines.length > 1 ? {} : { from: 0 }),
        at: (step) => `at step ${Math.round(step)}`,
      }),
    ),
  );
}

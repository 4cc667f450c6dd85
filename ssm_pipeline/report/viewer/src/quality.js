// The charts of model quality: a line a method over the number of modes.
import { lineChart, showTogether, styles } from "./charts.js";

const CHARTS = {
  compactness: { title: "Compactness", unit: "% of variance", digits: 1, percent: true, lowerIsBetter: false },
  generalisation: { title: "Generalisation", unit: "mm", digits: 2 },
  specificity: { title: "Specificity", unit: "mm", digits: 2 },
};
export const FULL = "full";

/** The three charts for one distance, into `container`; only the method named, where one is. */
export function showQuality(container, study, distance, only) {
  const every = Object.values(study.curves.charts).flatMap((byDistance) => Object.values(byDistance).flat());
  const style = styles([...new Set(every.map((line) => line.method))], study.methods);
  showTogether(container, (choose) =>
    Object.entries(study.curves.charts).map(([name, byDistance]) => {
      const kept = name === "compactness" ? Object.values(byDistance)[0] : byDistance[distance];
      const lines = (kept ?? []).filter((line) => !only || line.method === only).map((line) => ({ name: line.method, x: line.modes, y: line.value, se: line.se }));
      const options = CHARTS[name];
      if (lines.length) {
        const at = (modes) => `with ${modes} mode${modes === 1 ? "" : "s"}`;
        return lineChart(lines, { ...options, xLabel: "number of modes", at, style, main: FULL, choose });
      }
      const missing = document.createElement("div");
      missing.className = "chart";
      missing.append(Object.assign(document.createElement("h3"), { textContent: options.title }), Object.assign(document.createElement("p"), { className: "note", textContent: "not computed in this run" }));
      return { element: missing };
    }),
  );
}

// Entry: reads the page's data and starts each tab when it is first opened.
import { legend } from "./colours.js";
import { showCompared, startCompare } from "./compare.js";
import { startCorrespondence } from "./correspondence.js";
import { block, readModel } from "./data.js";
import { startFit } from "./fit.js";
import { startInterpolation } from "./interpolation.js";
import { startModes } from "./modes.js";
import { FULL, showQuality } from "./quality.js";
import { offerTables } from "./save_table.js";
import { startTabs } from "./tabs.js";
import { showTraining } from "./training.js";

const study = JSON.parse(document.getElementById("description").textContent);
const once = (make) => {
  let value;
  return () => (value ??= make());
};
const model = once(() => readModel(block("block-model")));
const casesBlock = once(() => block("block-cases"));
const compareBlock = once(() => block("block-compare"));
const fitBlock = once(() => block("block-fit"));

/**
 * For tests and the curious, in the browser's console. A part appears when its tab has been opened.
 *   viewer.modes.positions()        Float32Array, 3 numbers a vertex, mm
 *   viewer.modes.scores()           the sliders' values, standard deviations
 *   viewer.modes.setScores([…])     set them all (missing ones are 0)
 *   viewer.modes.chooseCase(i)      show case i (null: none)
 *   viewer.modes.measures()         { volumeMl, areaCm2, extentsMm }
 *   viewer.modes.drawNow()          draw without waiting for the next frame
 *   viewer.interpolation.set(t, ts), .positions(), .distortion()
 *   viewer.correspondence.order()   the cases as shown
 *   viewer.fit.show(i), .patient(), .values("residual" | "radius")   the page of new patients
 *   viewer.compare.positions(), .shownShare()   comparisons
 *   viewer.study                    the page's description of the study
 */
window.viewer = { study };

for (const element of document.querySelectorAll(".legend[data-map]")) {
  legend(element, element.dataset.map, element.dataset.low, element.dataset.high);
}

offerTables(study.study);

const distances = Object.keys(study.curves?.distances ?? {}).filter((name) =>
  Object.values(study.curves.charts).some((byDistance) => byDistance[name]),
);

/** Start a 3D tab, or say in its place why there is no picture. */
const in3D = (name, start) => () => {
  if (document.createElement("canvas").getContext("webgl2")) {
    viewer[name] = start();
    return;
  }
  const note = document.createElement("p");
  note.textContent = "This browser cannot show 3D graphics: WebGL 2 is disabled or missing. The Overview and Quality tabs work without it.";
  document.getElementById(`panel-${name}`).prepend(note);
};

startTabs({
  compare() {
    showCompared(study.compare);
    in3D("compare", () => startCompare(study.compare, compareBlock))();
  },
  fit: in3D("fit", () => startFit(study, fitBlock)),
  overview() {
    showQuality(document.getElementById("overview-charts"), study, distances[0], study.methods[FULL] && FULL);
  },
  modes: in3D("modes", () => startModes(study, model(), casesBlock)),
  interpolation: study.paths?.length ? in3D("interpolation", () => startInterpolation(study)) : undefined,
  correspondence: in3D("correspondence", () => startCorrespondence(study, model(), casesBlock)),
  quality() {
    const select = document.getElementById("quality-distance");
    select.append(...distances.map((name) => new Option(study.curves.distances[name], name)));
    const show = () => showQuality(document.getElementById("quality-charts"), study, select.value);
    select.addEventListener("change", show);
    show();
  },
  training() {
    showTraining(document.getElementById("training-charts"), study.training);
  },
});

// The page of new patients: the surface over the model's fit, and where it lies among the cohort.
import { array } from "./data.js";
import { legend, lookup } from "./colours.js";
import { createStage } from "./stage.js";
import { ownNet, ownSurface, paint, paintedSurface, reach, removeFrom } from "./surface.js";

const $ = (id) => document.getElementById(id);
const signed = (value) => `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(2)}`;
const BONE = [0.69, 0.6, 0.46]; // linear light
const HIDDEN = [0.32, 0.33, 0.36]; // where nothing of the patient was seen
const PAINTS = {
  residual: { legend: "0 mm", caption: "Colour: distance from the model's reconstruction to the patient's surface, in mm." },
  radius: { legend: "0 mm", caption: "Colour: uncertainty. The patient's surface lies within this distance of 9 in 10 vertices, in mm." },
};

export function startFit(study, block) {
  const faces = new Uint32Array(array(block(), study.faces));
  const colours = lookup("sequential");
  let stage, chosen, reconstruction, own;

  function show(index) {
    chosen = study.patients[index];
    const points = array(block(), chosen.points);
    const surface = { points: array(block(), chosen.mesh.points), faces: new Uint32Array(array(block(), chosen.mesh.faces)) };
    if (!stage) {
      const radius = 1.05 * Math.max(...study.patients.map((p) => Math.max(reach(array(block(), p.points)), reach(array(block(), p.mesh.points)))));
      stage = createStage($("fit-stage"), radius, "The patient's surface and the model's reconstruction, in 3D");
    }
    if (reconstruction) removeFrom(stage.scene, reconstruction);
    reconstruction = paintedSurface(points, faces);
    stage.scene.add(reconstruction);
    chosen.surface = surface;
    if ($("fit-patient")) $("fit-patient").value = index;
    verdict();
    numbers();
    modes();
    draw();
  }

  function verdict() {
    const box = $("fit-verdict");
    box.className = chosen.flags.length ? "warning" : "fine";
    const title = document.createElement("b");
    title.textContent = chosen.flags.length ? "Not like the model's cases." : "Like the model's cases.";
    const name = Object.assign(document.createElement("span"), { textContent: ` ${chosen.id} `, title: chosen.wholeId });
    const lines = [...chosen.flags, ...chosen.remarks].map((text) => Object.assign(document.createElement("li"), { textContent: text }));
    const list = document.createElement("ul");
    list.append(...lines);
    box.replaceChildren(title, name, ...(lines.length ? [list] : []));
  }

  function numbers() {
    const readings = [["Distance patient–model, mean", `${chosen.meanMm} mm`], ["Distance patient–model, 95th percentile", `${chosen.hd95Mm} mm`], ["Surface observed", `${chosen.observedPercent} %`], ["Uncertainty, median", `${chosen.radiusMm} mm`]];
    $("fit-readouts").replaceChildren(...readings.map(([name, value]) => {
      const cell = document.createElement("div");
      cell.append(Object.assign(document.createElement("dt"), { textContent: name }), Object.assign(document.createElement("dd"), { textContent: value }));
      return cell;
    }));
    $("fit-judged").replaceChildren(...chosen.judged.map((j) => {
      const row = document.createElement("tr");
      row.className = j.isFlagged ? "striking" : "";
      const cells = [[j.name, ""], [j.value, "number"], [j.tail, "number"], [j.threshold, "number"]];
      row.append(...cells.map(([text, className]) => Object.assign(document.createElement("td"), { textContent: text, className })));
      return row;
    }));
  }

  function modes() {
    const at = (sd) => 50 + (50 * Math.max(-study.axisSd, Math.min(study.axisSd, sd))) / study.axisSd;
    $("fit-modes").replaceChildren(...chosen.scores.map((score, mode) => {
      const text = `${signed(score)} SD (${signed(chosen.low[mode])} to ${signed(chosen.high[mode])})`;
      const row = Object.assign(document.createElement("div"), { className: "axis-row" });
      row.append(Object.assign(document.createElement("span"), { textContent: `Mode ${mode + 1}` }));
      const line = Object.assign(document.createElement("div"), { className: "strip-line" });
      line.setAttribute("role", "img");
      line.setAttribute("aria-label", `Mode ${mode + 1}: ${text}`);
      for (const sd of [-2, 0, 2]) line.append(Object.assign(document.createElement("i"), { className: "grid", style: `left:${at(sd)}%` }));
      study.cohort.scores.forEach((scores, i) => line.append(Object.assign(document.createElement("i"), { className: "case", style: `left:${at(scores[mode])}%`, title: `${study.cohort.names[i]}: ${signed(scores[mode])} SD` })));
      const low = at(chosen.low[mode]), high = at(chosen.high[mode]);
      line.append(Object.assign(document.createElement("i"), { className: "span", style: `left:${low}%;width:${high - low}%` }));
      const off = Math.abs(score) > study.axisSd;
      line.append(Object.assign(document.createElement("i"), { className: off ? "patient off" : "patient", style: `left:${at(score)}%`, title: text }));
      row.append(line, Object.assign(document.createElement("output"), { textContent: text }));
      return row;
    }), scale(at));
  }

  function scale(at) {
    const row = Object.assign(document.createElement("div"), { className: "axis-row scale" });
    const line = Object.assign(document.createElement("div"), { className: "strip-line" });
    for (const sd of [-2, 0, 2]) line.append(Object.assign(document.createElement("span"), { textContent: `${String(sd).replace("-", "−")} SD`, style: `left:${at(sd)}%` }));
    row.append(document.createElement("span"), line, document.createElement("span"));
    return row;
  }

  function draw() {
    const kind = $("fit-paint").value, shown = $("fit-show").value;
    const values = PAINTS[kind] && array(block(), chosen[kind]);
    const observed = chosen.observed && array(block(), chosen.observed);
    const range = study.rangeMm[kind];
    paint(reconstruction, (v) => {
      if (kind === "residual" && observed && !observed[v]) return HIDDEN;
      if (!values) return BONE;
      const at = 3 * Math.max(0, Math.min(255, Math.round((255 * values[v]) / range)));
      return [colours[at], colours[at + 1], colours[at + 2]];
    });
    if (own) removeFrom(stage.scene, own);
    own = null;
    if (shown !== "reconstruction") {
      const { points, faces: triangles } = chosen.surface;
      own = shown === "both" ? ownNet(points, triangles) : ownSurface(points, triangles, 1);
      stage.scene.add(own);
    }
    reconstruction.visible = shown !== "patient";
    $("fit-legend").style.visibility = values ? "visible" : "hidden";
    if (values) legend($("fit-legend"), "sequential", "0 mm", `${range} mm or more`);
    const hidden = observed && kind === "residual" ? " Dark: the part that was not observed; the model completes it." : "";
    const overlay = own ? ` Green${shown === "both" ? " net" : ""}: the patient's own surface.` : "";
    $("fit-caption").textContent = `${PAINTS[kind]?.caption ?? "The model's reconstruction."}${hidden}${overlay} Shown in scanner orientation. Drag to rotate, scroll or pinch to zoom. On the keyboard, the arrow keys rotate and + and − zoom.`;
    stage.draw();
  }

  $("fit-paint").addEventListener("change", draw);
  $("fit-show").addEventListener("change", draw);
  $("fit-patient")?.addEventListener("change", (event) => show(Number(event.target.value)));
  for (const button of document.querySelectorAll("button[data-patient]")) {
    button.addEventListener("click", () => {
      $("tab-fit").click();
      show(Number(button.dataset.patient));
    });
  }
  show(0);
  return {
    show,
    patient: () => chosen.wholeId,
    values: (kind) => [...array(block(), chosen[kind])],
    drawNow: () => stage.drawNow(),
  };
}

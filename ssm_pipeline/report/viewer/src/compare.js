// Comparisons with covariates: the effect on the mean shape, where it is significant, and scores.
import { array } from "./data.js";
import { legend, lookup } from "./colours.js";
import { vertexNormals } from "./geometry.js";
import { scatterChart } from "./scatter.js";
import { createStage } from "./stage.js";
import { paint, paintedSurface, reach } from "./surface.js";

const $ = (id) => document.getElementById(id);
const MASKED = [0.5, 0.48, 0.44]; // linear light; where the effect is not significant
const LEVEL = 0.05;

/** Call with the first comparison, and with another whenever the user chooses it. */
function withEach(comparisons, use) {
  $("compare-formula")?.addEventListener("change", (event) => use(comparisons[Number(event.target.value)], event.target.value));
  use(comparisons[0], "0");
}

const fillWith = (select, names) => select.replaceChildren(...names.map((name, i) => new Option(name, i)));

/** compare { points, faces, comparisons [{ formula, effects, covariates }], cases, scores, share }. */
export function startCompare(compare, block) {
  const mean = array(block(), compare.points);
  const faces = new Uint32Array(array(block(), compare.faces));
  const colours = lookup("diverging");
  const positions = new Float32Array(mean);
  const stage = createStage($("compare-stage"), 1.1 * reach(mean), "The mean shape, coloured by the effect, in 3D");
  const shape = paintedSurface(positions, faces);
  shape.frustumCulled = false;
  stage.scene.add(shape);
  let effects, effect, shownShare = 0;

  function choose(index) {
    const place = effects[index];
    effect = { ...place, ...Object.fromEntries(["displacement", "along", "p", "q"].map((name) => [name, array(block(), place[name])])) };
    update();
  }

  function update() {
    const times = Number($("compare-scale").value), mask = $("compare-mask").value;
    for (let i = 0; i < positions.length; i++) positions[i] = mean[i] + times * effect.displacement[i];
    const { position, normal } = shape.geometry.attributes;
    vertexNormals(positions, faces, normal.array);
    position.needsUpdate = normal.needsUpdate = true;
    let shown = 0;
    paint(shape, (v) => {
      if (mask !== "all" && effect[mask][v] >= LEVEL) return MASKED;
      shown++;
      const at = 3 * Math.max(0, Math.min(255, Math.round(127.5 * (1 + effect.along[v] / effect.rangeMm))));
      return [colours[at], colours[at + 1], colours[at + 2]];
    });
    shownShare = shown / effect.p.length;
    $("compare-scale-value").textContent = `${times < 0 ? "−" : "+"}${Math.abs(times).toFixed(2)} times`;
    legend($("compare-legend"), "diverging", `−${effect.rangeMm} mm or less (inward)`, `+${effect.rangeMm} mm or more (outward)`);
    const readings = [["Largest effect", `${effect.largestMm.toFixed(2)} mm`], ["Surface with q < 0.05", `${effect.sharePercent.toFixed(0)} %`], ["Coloured now", `${(100 * shownShare).toFixed(0)} %`]];
    $("compare-readouts").replaceChildren(...readings.map(([name, value]) => {
      const cell = document.createElement("div");
      cell.append(Object.assign(document.createElement("dt"), { textContent: name }), Object.assign(document.createElement("dd"), { textContent: value }));
      return cell;
    }));
    const grey = mask === "all" ? "" : ` Grey: ${mask} is 0.05 or more.`;
    $("compare-caption").textContent = `${effect.name}: displacement of the mean shape along its surface normal, in mm.${grey} Drag to rotate, scroll or pinch to zoom. On the keyboard, the arrow keys rotate and + and − zoom.`;
    stage.draw();
  }

  $("compare-effect").addEventListener("change", (event) => choose(Number(event.target.value)));
  $("compare-mask").addEventListener("change", update);
  $("compare-scale").addEventListener("input", update);
  withEach(compare.comparisons, (comparison) => {
    ({ effects } = comparison);
    fillWith($("compare-effect"), effects.map((e) => e.name));
    choose(0);
  });
  return { positions: () => positions.slice(), shownShare: () => shownShare, drawNow: stage.drawNow };
}

/** The tests and the scores of the chosen comparison. */
export function showCompared(compare) {
  const select = $("scores-covariate");
  let covariates;
  const show = () => {
    const covariate = covariates[Number(select.value)];
    $("scores-charts").replaceChildren(...compare.scores.map((scores, mode) =>
      scatterChart(covariate, scores, compare.cases, `Mode ${mode + 1} (${(100 * compare.share[mode]).toFixed(1)} % of variance)`),
    ));
  };
  select.addEventListener("change", show);
  withEach(compare.comparisons, (comparison, index) => {
    for (const part of document.querySelectorAll(".compared")) part.hidden = part.dataset.comparison !== index;
    ({ covariates } = comparison);
    fillWith(select, covariates.map((c) => c.name));
    show();
  });
}

// The Modes tab: the model's instance for any scores, computed on the CPU from the GLB's targets.
import { BufferAttribute, BufferGeometry, DoubleSide, Mesh, MeshLambertMaterial } from "three";
import { array } from "./data.js";
import { legend, lookup } from "./colours.js";
import { measure, vertexNormals } from "./geometry.js";
import { saveBlob, stl } from "./save.js";
import { createStage } from "./stage.js";
import { ownSurface, reach, removeFrom } from "./surface.js";

const $ = (id) => document.getElementById(id);
const signed = (value, digits = 2) => `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(digits)}`;

export function startModes(study, model, casesBlock) {
  const { mean, faces, modes } = model;
  const scores = new Float64Array(modes.length);
  const meanNormals = vertexNormals(mean, faces, new Float32Array(mean.length));
  const meanMeasures = measure(mean, faces);
  const colours = lookup("diverging");
  const geometry = new BufferGeometry();
  const positions = new Float32Array(mean);
  geometry.setAttribute("position", new BufferAttribute(positions, 3));
  geometry.setAttribute("normal", new BufferAttribute(new Float32Array(meanNormals), 3));
  geometry.setAttribute("color", new BufferAttribute(new Float32Array(mean.length), 3));
  geometry.setIndex(new BufferAttribute(faces, 1));
  const radius = 1.05 * reach(mean);
  const stage = createStage($("modes-stage"), radius, "The shape for the chosen modes, in 3D");
  const shape = new Mesh(geometry, new MeshLambertMaterial({ vertexColors: true, side: DoubleSide }));
  shape.frustumCulled = false;
  stage.scene.add(shape);
  let own = null; // the chosen case's own surface
  let chosen = null;
  let playing = null;

  legend($("modes-legend"), "diverging", `−${study.colourRangeMm} mm or less (inward)`, `+${study.colourRangeMm} mm or more (outward)`);
  const rows = modes.map((_, mode) => sliderRow(mode));
  const readouts = makeReadouts();
  const select = $("modes-case");
  select.append(new Option("none (free)", ""), ...study.cases.map((c, i) => new Option(c.id, i)));

  function sliderRow(mode) {
    const row = Object.assign(document.createElement("div"), { className: "slider" });
    const share = (100 * study.share[mode]).toFixed(1);
    row.innerHTML = `<label for="mode-${mode}"><span>Mode ${mode + 1} <small>${share} % of variance</small></span><output></output></label>
      <div class="line"><div class="track"><input type="range" id="mode-${mode}" step="0.01"><div class="ticks"></div></div>
      <button class="play" aria-pressed="false" aria-label="Play mode ${mode + 1}" title="Play mode ${mode + 1}">▶</button></div>`;
    const [input, output, ticks, play] = ["input", "output", ".ticks", ".play"].map((s) => row.querySelector(s));
    input.min = -study.sliderRange;
    input.max = study.sliderRange;
    input.value = 0;
    input.addEventListener("input", () => {
      stop();
      scores[mode] = Number(input.value);
      update();
    });
    play.addEventListener("click", () => (playing?.mode === mode ? stop() : start(mode)));
    // Out of the tab order: hundreds of marks would bury the sliders. The case list does the same.
    const marks = study.cases.map((c, index) => {
      const mark = document.createElement("button");
      const at = Math.max(-1, Math.min(1, c.scores[mode] / study.sliderRange));
      mark.tabIndex = -1;
      mark.style.left = `${50 + 50 * at}%`;
      mark.title = `${c.id}: ${signed(c.scores[mode])} SD`;
      mark.setAttribute("aria-label", mark.title);
      mark.addEventListener("click", () => choose(index));
      return mark;
    });
    ticks.append(...marks);
    $("modes-sliders").append(row);
    return { input, output, play, marks };
  }

  function makeReadouts() {
    const names = ["Volume (ml)", "Surface (cm²)", "Left–right (mm)", "Front–back (mm)", "Head–foot (mm)"];
    const cells = names.map((name) => {
      const cell = document.createElement("div");
      cell.innerHTML = `<dt>${name}</dt><dd></dd>`;
      $("modes-readouts").append(cell);
      return cell.querySelector("dd");
    });
    const values = (m) => [m.volumeMl, m.areaCm2, ...m.extentsMm];
    const means = values(meanMeasures);
    return (measures) => {
      values(measures).forEach((value, i) => {
        const change = (100 * (value - means[i])) / means[i];
        cells[i].innerHTML = `${value.toFixed(value < 20 ? 2 : 1)}<small>${signed(change, 1)} %</small>`;
      });
    };
  }

  function start(mode) {
    stop();
    playing = { mode, from: performance.now(), base: scores[mode] };
    rows[mode].play.setAttribute("aria-pressed", "true");
    rows[mode].play.textContent = "❚❚";
    const step = (now) => {
      if (playing?.mode !== mode) return;
      // Starts at the slider's present value and swings ± 2 SD, once in four seconds.
      const phase = Math.asin(Math.max(-1, Math.min(1, playing.base / 2)));
      scores[mode] = 2 * Math.sin(phase + ((now - playing.from) / 4000) * 2 * Math.PI);
      update();
      requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  function stop() {
    if (!playing) return;
    rows[playing.mode].play.setAttribute("aria-pressed", "false");
    rows[playing.mode].play.textContent = "▶";
    playing = null;
  }

  function choose(index) {
    stop();
    chosen = index;
    select.value = index ?? "";
    scores.set(index === null ? new Float64Array(scores.length) : study.cases[index].scores);
    showOwn();
    update();
  }

  function showOwn() {
    if (own) removeFrom(stage.scene, own);
    own = null;
    const place = chosen === null ? null : study.cases[chosen].mesh;
    if (!place || !$("modes-own").checked) return;
    own = ownSurface(array(casesBlock(), place.points), new Uint32Array(array(casesBlock(), place.faces)));
    stage.scene.add(own);
  }

  function note() {
    if (chosen === null) return "";
    const c = study.cases[chosen];
    const exact = c.scores.every((value, mode) => Math.abs(value - scores[mode]) < 1e-9);
    if (!exact) return `Based on case ${c.id}, changed with the sliders.`;
    const overlay = own ? " Green: the case's own surface." : "";
    return `Case ${c.id} reconstructed from ${scores.length} modes: mean distance of corresponding points ${c.reconstructionMm.toFixed(2)} mm.${overlay}`;
  }

  function update() {
    positions.set(mean);
    for (let mode = 0; mode < modes.length; mode++) {
      const score = scores[mode], displacement = modes[mode];
      if (score) for (let i = 0; i < positions.length; i++) positions[i] += score * displacement[i];
    }
    vertexNormals(positions, faces, geometry.attributes.normal.array);
    const paint = geometry.attributes.color.array;
    for (let v = 0; v < positions.length; v += 3) {
      const mm = (positions[v] - mean[v]) * meanNormals[v] + (positions[v + 1] - mean[v + 1]) * meanNormals[v + 1] + (positions[v + 2] - mean[v + 2]) * meanNormals[v + 2];
      const at = 3 * Math.max(0, Math.min(255, Math.round(127.5 * (1 + mm / study.colourRangeMm))));
      paint[v] = colours[at]; paint[v + 1] = colours[at + 1]; paint[v + 2] = colours[at + 2];
    }
    for (const name of ["position", "normal", "color"]) geometry.attributes[name].needsUpdate = true;
    rows.forEach(({ input, output, marks }, mode) => {
      input.value = scores[mode];
      output.textContent = `${signed(scores[mode])} SD`;
      input.setAttribute("aria-valuetext", output.textContent);
      marks.forEach((mark, i) => mark.classList.toggle("chosen", i === chosen));
    });
    readouts(measure(positions, faces));
    $("modes-note").textContent = note();
    stage.draw();
  }

  select.addEventListener("change", () => choose(select.value === "" ? null : Number(select.value)));
  $("modes-own").addEventListener("change", () => {
    showOwn();
    update();
  });
  $("modes-reset").addEventListener("click", () => choose(null));
  /** Named after the case, or after the modes that are not at 0. */
  const fileName = (extension) => {
    const moved = scores.reduce((found, score, mode) => (score ? [...found, `mode${mode + 1}_${signed(score)}`] : found), []);
    const shown = chosen !== null ? study.cases[chosen].id : moved.slice(0, 3).join("_") || "mean";
    return `${study.study}_${shown.replace("−", "-")}.${extension}`;
  };
  $("modes-picture").addEventListener("click", () => {
    stage.drawNow(); // the browser keeps the picture only until the next frame
    stage.canvas.toBlob((blob) => saveBlob(blob, fileName("png")));
  });
  $("modes-stl").addEventListener("click", () => saveBlob(stl(positions, faces, "shape model; mm, LPS"), fileName("stl")));
  update();

  return {
    positions: () => positions.slice(),
    scores: () => [...scores],
    setScores(values) {
      stop();
      scores.fill(0);
      scores.set(values);
      update();
    },
    chooseCase: choose,
    measures: () => measure(positions, faces),
    drawNow: stage.drawNow,
  };
}

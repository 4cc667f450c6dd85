// The Interpolation tab: X(t, t_s) = pose(t) + t_s · offset(t), linear between the stored times.
import { BufferAttribute, BufferGeometry, DoubleSide, Mesh, MeshLambertMaterial } from "three";
import { array, block } from "./data.js";
import { legend, lookup } from "./colours.js";
import { cotangents, distortion, vertexNormals } from "./geometry.js";
import { showDistortion } from "./distortion.js";
import { createStage } from "./stage.js";
import { saveBlob } from "./save.js";
import { zip } from "./zip.js";

const $ = (id) => document.getElementById(id);
const MOST = 20; // a triangle that collapses shall not be the mean
const mean = (values) => values.reduce((sum, value) => sum + Math.min(value, MOST), 0) / values.length;
const FRAMES = 41; // of a saved series: t in steps of 0.025
const KEPT = 2, WORST = 4; // conformal distortion at the ends of the colour bar
const BONE = [0.69, 0.6, 0.46]; // linear light

export function startInterpolation(study) {
  const stageBox = $("interpolation-stage");
  const colours = lookup("sequential");
  const inputs = { t: $("interpolation-t"), ts: $("interpolation-ts") };
  const outputs = { t: $("interpolation-t-value"), ts: $("interpolation-ts-value") };
  const play = $("interpolation-play");
  let stage, path, shape, playing = null;

  legend($("interpolation-legend"), "sequential", `${KEPT} (unchanged)`, `${WORST} or more`);
  $("interpolation-pair").append(...study.paths.map((p, i) => new Option(`${p.template} → ${p.case}`, i)));

  function load(index) {
    const place = study.paths[index];
    const buffer = block(place.block);
    const faces = new Uint32Array(array(buffer, place.faces));
    const pose = array(buffer, place.pose);
    const count = pose.length / place.times.length;
    path = { ...place, faces, pose, offsets: array(buffer, place.offsets), count };
    path.cotangents = cotangents(pose.subarray(0, count), faces);
    path.positions = new Float32Array(count);
    path.normals = new Float32Array(count);
    path.distortion = new Float32Array(faces.length / 3);
    path.straight = new Float32Array(count);
    path.straightDistortion = new Float32Array(faces.length / 3);
    if (study.distortion.length) showDistortion($("interpolation-chart"), study.distortion, index);
    let radius = 0;
    for (let i = 0; i < pose.length; i += 3) radius = Math.max(radius, Math.hypot(pose[i], pose[i + 1], pose[i + 2]));
    stage ??= createStage(stageBox, 1.05 * radius, "The interpolated shape, in 3D");
    if (shape) {
      stage.scene.remove(shape);
      shape.geometry.dispose();
      shape.material.dispose();
    }
    // Triangles don't share corners here: each has its own colour.
    const geometry = new BufferGeometry();
    for (const name of ["position", "normal", "color"]) {
      geometry.setAttribute(name, new BufferAttribute(new Float32Array(3 * faces.length), 3));
    }
    shape = new Mesh(geometry, new MeshLambertMaterial({ vertexColors: true, side: DoubleSide }));
    shape.frustumCulled = false;
    stage.scene.add(shape);
    update();
  }

  function update() {
    if ($("interpolation-together").checked) inputs.ts.value = inputs.t.value;
    const t = Number(inputs.t.value), ts = Number(inputs.ts.value);
    const { times, count, faces } = path;
    let upper = times.findIndex((time) => time >= t);
    upper = Math.max(1, upper === -1 ? times.length - 1 : upper);
    const w = (t - times[upper - 1]) / (times[upper] - times[upper - 1]);
    const low = (upper - 1) * count, high = upper * count;
    for (let i = 0; i < count; i++) {
      path.positions[i] = (1 - w) * (path.pose[low + i] + ts * path.offsets[low + i]) + w * (path.pose[high + i] + ts * path.offsets[high + i]);
    }
    vertexNormals(path.positions, faces, path.normals);
    distortion(path.positions, faces, path.cotangents, path.distortion);
    const painted = $("interpolation-colour").checked;
    $("interpolation-legend").style.visibility = painted ? "visible" : "hidden";
    const { position, normal, color } = shape.geometry.attributes;
    for (let f = 0; f < faces.length; f++) {
      const at = 3 * Math.max(0, Math.min(255, Math.round((255 * (path.distortion[(f / 3) | 0] - KEPT)) / (WORST - KEPT))));
      for (let k = 0; k < 3; k++) {
        position.array[3 * f + k] = path.positions[3 * faces[f] + k];
        normal.array[3 * f + k] = path.normals[3 * faces[f] + k];
        color.array[3 * f + k] = painted ? colours[at + k] : BONE[k];
      }
    }
    for (const attribute of [position, normal, color]) attribute.needsUpdate = true;
    outputs.t.textContent = t.toFixed(2);
    outputs.ts.textContent = ts.toFixed(2);
    const sorted = Float32Array.from(path.distortion).sort();
    const readings = [["Mean distortion", mean(sorted)], ["95th percentile", sorted[Math.floor(0.95 * (sorted.length - 1))]], ["Mean on the straight line", straight(t)]];
    $("interpolation-readouts").innerHTML = readings.map(([k, v]) => `<div><dt>${k}</dt><dd>${v.toFixed(3)}</dd></div>`).join("");
    stage.draw();
  }

  /** Mean distortion where every point goes evenly from X(0, 0) to X(1, 1). */
  function straight(t) {
    const { pose, offsets, count, faces } = path;
    const last = pose.length - count;
    for (let i = 0; i < count; i++) {
      path.straight[i] = (1 - t) * pose[i] + t * (pose[last + i] + offsets[last + i]);
    }
    return mean(distortion(path.straight, faces, path.cotangents, path.straightDistortion));
  }

  const SECONDS = 4;
  /** Run t once from 0 to 1; resolves at the end or when stopped. */
  function run() {
    return new Promise((resolve) => {
      playing = resolve;
      play.setAttribute("aria-pressed", "true");
      play.textContent = "Stop";
      const from = performance.now();
      const step = (now) => {
        if (playing !== resolve) return;
        inputs.t.value = Math.min(1, (now - from) / 1000 / SECONDS);
        update();
        if (now - from >= SECONDS * 1000) stop();
        else requestAnimationFrame(step);
      };
      requestAnimationFrame(step);
    });
  }

  function stop() {
    const resolve = playing;
    playing = null;
    play.setAttribute("aria-pressed", "false");
    play.textContent = "Play";
    resolve?.();
  }

  function save(blob, extension) {
    saveBlob(blob, `${study.study}_${path.template}_${path.case}_t${Number(inputs.t.value).toFixed(2)}.${extension}`);
  }

  $("interpolation-pair").addEventListener("change", (event) => {
    stop();
    load(Number(event.target.value));
  });
  for (const input of Object.values(inputs)) {
    input.addEventListener("input", () => {
      if (input === inputs.ts) $("interpolation-together").checked = false;
      stop();
      update();
    });
  }
  $("interpolation-colour").addEventListener("change", update);
  $("interpolation-together").addEventListener("change", update);
  play.addEventListener("click", () => (playing ? stop() : run()));
  $("interpolation-picture").addEventListener("click", () => {
    stage.drawNow(); // the drawing buffer is only there right after drawing
    stage.canvas.toBlob((blob) => save(blob, "png"));
  });
  const frames = $("interpolation-frames");
  frames.addEventListener("click", async () => {
    stop();
    frames.disabled = true;
    const files = [];
    for (let i = 0; i < FRAMES; i++) {
      inputs.t.value = i / (FRAMES - 1);
      update();
      stage.drawNow();
      const blob = await new Promise((resolve) => stage.canvas.toBlob(resolve));
      const name = `frame_${String(i).padStart(3, "0")}.png`;
      files.push({ name, bytes: new Uint8Array(await blob.arrayBuffer()) });
    }
    save(zip(files), "zip");
    frames.disabled = false;
  });
  const video = $("interpolation-video");
  video.hidden = !window.MediaRecorder?.isTypeSupported("video/webm");
  video.addEventListener("click", async () => {
    stop();
    const recorder = new MediaRecorder(stage.canvas.captureStream(30), { mimeType: "video/webm", videoBitsPerSecond: 8e6 });
    const chunks = [];
    recorder.ondataavailable = (event) => chunks.push(event.data);
    recorder.onstop = () => save(new Blob(chunks, { type: "video/webm" }), "webm");
    stage.keepSharp = true;
    recorder.start();
    await run();
    // The encoder lags behind on slow machines; what it has not seen is lost at stop.
    await new Promise((resolve) => setTimeout(resolve, 1000));
    recorder.stop();
    stage.keepSharp = false;
  });
  load(0);

  return {
    positions: () => path.positions.slice(),
    distortion: () => path.distortion.slice(),
    set(t, ts) {
      stop();
      $("interpolation-together").checked = t === ts;
      inputs.t.value = t;
      inputs.ts.value = ts;
      update();
    },
  };
}

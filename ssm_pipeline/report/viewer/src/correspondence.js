// The Correspondence tab: every case with the template's grid on it, turned together.
// One WebGL renderer draws all pictures in turn; each cell keeps its copy in a plain canvas.
import {
  BufferAttribute, BufferGeometry, Group, InstancedMesh, Matrix4, Mesh, MeshBasicMaterial,
  OrthographicCamera, Scene, ShaderMaterial, SphereGeometry, Vector3, WebGLRenderer,
} from "three";
import { array } from "./data.js";
import { vertexNormals } from "./geometry.js";
import { OBLIQUE } from "./stage.js";

const $ = (id) => document.getElementById(id);

const VERTEX = `
attribute vec3 templatePosition;
attribute vec3 templateNormal;
varying vec3 vPosition; varying vec3 vNormal; varying vec3 vTemplateNormal;
void main() {
  vPosition = templatePosition;
  vTemplateNormal = templateNormal;
  vNormal = normalMatrix * normal;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;
// Lines are as wide along the surface wherever they lie: dividing by the sine of the angle between
// grid plane and surface keeps a plane that only touches the surface from painting a blot.
const FRAGMENT = `
uniform vec3 low; uniform vec3 high; uniform float spacing; uniform bool grid;
varying vec3 vPosition; varying vec3 vNormal; varying vec3 vTemplateNormal;
void main() {
  vec3 colour = vec3(0.83, 0.78, 0.69);
  if (grid) {
    colour = 0.37 + 0.59 * (vPosition - low) / (high - low);
    vec3 n = normalize(vTemplateNormal);
    vec3 toPlane = abs(fract(vPosition / spacing + 0.5) - 0.5) / sqrt(max(1.0 - n * n, 1e-6));
    float nearest = min(toPlane.x, min(toPlane.y, toPlane.z));
    colour = mix(vec3(0.14, 0.16, 0.19), colour, smoothstep(0.035, 0.07, nearest));
  }
  float light = 0.55 + 0.5 * max(dot(normalize(vNormal), normalize(vec3(-0.3, 0.4, 1.0))), 0.0);
  gl_FragColor = vec4(colour * light, 1.0);
}`;

export function startCorrespondence(study, model, casesBlock) {
  const { faces } = model;
  const template = array(casesBlock(), study.template.points);
  const templateNormals = vertexNormals(template, faces, new Float32Array(template.length));
  const { low, high } = box(template);
  const uniforms = { low: { value: low }, high: { value: high }, spacing: { value: study.template.gridMm }, grid: { value: true } };
  const material = new ShaderMaterial({ vertexShader: VERTEX, fragmentShader: FRAGMENT, uniforms });
  const shared = {
    index: new BufferAttribute(faces, 1),
    templatePosition: new BufferAttribute(template, 3),
    templateNormal: new BufferAttribute(templateNormals, 3),
  };
  const renderer = new WebGLRenderer({ antialias: true, alpha: true });
  const camera = new OrthographicCamera();
  camera.up.set(0, 0, 1);
  const scene = new Scene();
  let direction = OBLIQUE.clone().normalize();
  let radius = 0;

  const marks = () => $("correspondence-landmarks")?.checked ?? false;
  const cells = study.cases.map((c) => {
    const points = array(casesBlock(), c.points);
    const { low: a, high: b } = box(points);
    const centre = a.clone().add(b).multiplyScalar(0.5);
    for (let v = 0; v < points.length; v += 3) {
      radius = Math.max(radius, Math.hypot(points[v] - centre.x, points[v + 1] - centre.y, points[v + 2] - centre.z));
    }
    const isTemplate = study.template.isCase && c.id === study.template.id;
    const fit = c.fit.surface_mm;
    const element = document.createElement("div");
    element.className = isTemplate ? "cell template" : "cell";
    const canvas = document.createElement("canvas");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `Case ${c.id} with the grid of the template`);
    const name = Object.assign(document.createElement("div"), { textContent: isTemplate ? `${c.id} (template)` : c.id, title: c.wholeId });
    const error = Object.assign(document.createElement("span"), {
      innerHTML: fit == null ? "fit not measured" : `mean ${fit.toFixed(2)} mm<br>95 %: ${c.fit.hd95_mm.toFixed(2)} mm`,
    });
    element.append(canvas, name, error);
    return { case: c, points, centre, element, canvas, fit: fit ?? -1, group: null, visible: false };
  });

  /** Geometry is made when a cell is first seen. */
  function groupOf(cell) {
    if (cell.group) return cell.group;
    const geometry = new BufferGeometry();
    geometry.setIndex(shared.index);
    geometry.setAttribute("templatePosition", shared.templatePosition);
    geometry.setAttribute("templateNormal", shared.templateNormal);
    geometry.setAttribute("position", new BufferAttribute(cell.points, 3));
    geometry.setAttribute("normal", new BufferAttribute(vertexNormals(cell.points, faces, new Float32Array(cell.points.length)), 3));
    cell.group = new Group();
    cell.group.position.copy(cell.centre).negate();
    cell.group.add(new Mesh(geometry, material));
    if (cell.case.landmarks.length) {
      const balls = new InstancedMesh(new SphereGeometry(radius / 28, 16, 12), new MeshBasicMaterial({ color: 0xd01c1c }), cell.case.landmarks.length);
      cell.case.landmarks.forEach((p, i) => balls.setMatrixAt(i, new Matrix4().makeTranslation(...p)));
      balls.name = "landmarks";
      cell.group.add(balls);
    }
    return cell.group;
  }

  let size = 0;
  function drawCell(cell) {
    const group = groupOf(cell);
    for (const child of group.children) if (child.name === "landmarks") child.visible = marks();
    scene.add(group);
    renderer.render(scene, camera);
    scene.remove(group);
    if (cell.canvas.width !== size) cell.canvas.width = cell.canvas.height = size;
    const context = cell.canvas.getContext("2d");
    context.clearRect(0, 0, size, size);
    context.drawImage(renderer.domElement, 0, 0);
  }

  let scheduled = false;
  function draw() {
    if (scheduled) return;
    scheduled = true;
    requestAnimationFrame(() => {
      scheduled = false;
      const wanted = Math.round(cells[0].canvas.clientWidth * Math.min(window.devicePixelRatio, 2));
      if (!wanted) return; // a hidden tab
      if (wanted !== size) renderer.setSize((size = wanted), size, false);
      Object.assign(camera, { left: -radius, right: radius, top: radius, bottom: -radius, near: radius, far: 5 * radius });
      camera.position.copy(direction).multiplyScalar(3 * radius);
      camera.lookAt(0, 0, 0);
      camera.updateProjectionMatrix();
      for (const cell of cells) if (cell.visible) drawCell(cell);
    });
  }

  const grid = $("correspondence-cells");
  function order() {
    const by = $("correspondence-order").value;
    const sign = by === "best" ? 1 : -1;
    const compare = by === "name" ? (p, q) => p.case.id.localeCompare(q.case.id, "en", { numeric: true }) : (p, q) => sign * (p.fit - q.fit);
    // The template leads whatever the order: it is what the others are read against.
    const lead = (p, q) => q.element.classList.contains("template") - p.element.classList.contains("template");
    grid.replaceChildren(...[...cells].sort((p, q) => lead(p, q) || compare(p, q)).map((cell) => cell.element));
    draw();
  }

  const seen = new IntersectionObserver((entries) => {
    for (const entry of entries) cells.find((cell) => cell.element === entry.target).visible = entry.isIntersecting;
    draw();
  }, { rootMargin: "200px" });
  cells.forEach((cell) => seen.observe(cell.element));
  new ResizeObserver(draw).observe(grid);

  const turn = (dx, dy) => {
    const azimuth = Math.atan2(direction.y, direction.x) - dx;
    const height = Math.max(-1.5, Math.min(1.5, Math.asin(direction.z) + dy));
    direction = new Vector3(Math.cos(height) * Math.cos(azimuth), Math.cos(height) * Math.sin(azimuth), Math.sin(height));
    draw();
  };
  let held = null;
  grid.addEventListener("pointerdown", (event) => {
    if (event.target.tagName !== "CANVAS") return;
    held = [event.clientX, event.clientY];
    grid.setPointerCapture(event.pointerId);
  });
  grid.addEventListener("pointermove", (event) => {
    if (!held) return;
    turn((event.clientX - held[0]) / 90, (event.clientY - held[1]) / 90);
    held = [event.clientX, event.clientY];
  });
  for (const name of ["pointerup", "pointercancel"]) grid.addEventListener(name, () => (held = null));
  grid.tabIndex = 0;
  grid.setAttribute("role", "group");
  grid.setAttribute("aria-label", "All cases; the arrow keys rotate them together");
  grid.addEventListener("keydown", (event) => {
    const by = { ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0], ArrowUp: [0, 0.15], ArrowDown: [0, -0.15] }[event.key];
    if (!by) return;
    event.preventDefault();
    turn(...by);
  });
  $("correspondence-order").addEventListener("change", order);
  $("correspondence-paint").addEventListener("change", (event) => {
    uniforms.grid.value = event.target.value === "grid";
    draw();
  });
  $("correspondence-landmarks")?.addEventListener("change", draw);
  const landmarks = study.landmarks.length ? ` Red: the template's landmarks (${study.landmarks.join(", ")}), mapped to each case.` : "";
  const source = study.template.isCase ? `template ${study.template.id}` : "the mean shape";
  $("correspondence-caption").textContent = `A grid of ${study.template.gridMm} mm painted on ${source} and mapped to every case by the correspondences. The same colour marks corresponding points; regular, unbroken cells indicate a smooth correspondence. Numbers: mean and 95th percentile distance between the mapped template and the case's surface. All cases are shown at the same scale. Drag any of them to rotate all.${landmarks}`;
  order();
  return { order: () => [...grid.children].map((element) => element.children[1].textContent) };
}

function box(points) {
  const low = new Vector3(Infinity, Infinity, Infinity), high = new Vector3(-Infinity, -Infinity, -Infinity), p = new Vector3();
  for (let v = 0; v < points.length; v += 3) {
    p.set(points[v], points[v + 1], points[v + 2]);
    low.min(p);
    high.max(p);
  }
  return { low, high };
}

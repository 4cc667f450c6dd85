// A 3D view that draws only when something changes. World: LPS mm, so "up" is +z (superior).
import {
  DirectionalLight, HemisphereLight, PerspectiveCamera, Scene, Spherical, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";

export const OBLIQUE = new Vector3(0.55, -0.8, 0.2);
const VIEWS = {
  Front: new Vector3(0, -1, 0), Left: new Vector3(1, 0, 0), Back: new Vector3(0, 1, 0),
  Right: new Vector3(-1, 0, 0), Top: new Vector3(0, -0.001, 1),
};

export function addLights(scene, camera) {
  scene.add(new HemisphereLight(0xffffff, 0x8a8f98, 1.5));
  const lamp = new DirectionalLight(0xffffff, 1.9);
  lamp.position.set(-0.4, 0.5, 1);
  camera.add(lamp); // moves with the viewer: no side is ever dark
  camera.add(lamp.target);
  lamp.target.position.set(0, 0, -1);
  scene.add(camera);
}

/** Whether the browser draws without a graphics card (remote desktops, virtual machines). */
const drawsInSoftware = (() => {
  const context = document.createElement("canvas").getContext("webgl2");
  if (!context) return false;
  const info = context.getExtension("WEBGL_debug_renderer_info");
  const name = context.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : context.RENDERER);
  context.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
})();

/** { scene, canvas, draw(), drawNow(), keepSharp } inside `place`, showing a ball of `radius` mm. */
export function createStage(place, radius, label) {
  const container = Object.assign(document.createElement("div"), { className: "view" });
  // In software, antialiasing halves the frames per second (7 against 14, measured).
  const renderer = new WebGLRenderer({ antialias: !drawsInSoftware, alpha: true });
  const sharp = drawsInSoftware ? 1.5 : Math.min(window.devicePixelRatio, 2);
  renderer.setPixelRatio(sharp);
  const canvas = renderer.domElement;
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", label);
  const scene = new Scene();
  const camera = new PerspectiveCamera(26, 1, 1, 20 * radius);
  camera.up.set(0, 0, 1);
  addLights(scene, camera);
  const controls = new OrbitControls(camera, canvas);
  controls.enablePan = false;
  controls.minDistance = 1.2 * radius;
  controls.maxDistance = 12 * radius;

  let scheduled = false;
  let settling = 0;
  const stage = { scene, canvas, keepSharp: false };
  const drawAt = (ratio) => {
    scheduled = false;
    if (renderer.getPixelRatio() !== ratio) renderer.setPixelRatio(ratio);
    renderer.render(scene, camera);
  };
  const drawNow = () => drawAt(sharp);
  const draw = () => {
    if (scheduled) return;
    scheduled = true;
    if (!drawsInSoftware || stage.keepSharp) {
      requestAnimationFrame(drawNow);
      return;
    }
    requestAnimationFrame(() => drawAt(sharp / 3)); // coarse while things move, sharp at rest
    clearTimeout(settling);
    settling = setTimeout(drawNow, 250);
  };
  const lookFrom = (direction) => {
    const half = Math.tan((camera.fov * Math.PI) / 360) * Math.min(1, camera.aspect);
    camera.position.copy(direction).normalize().multiplyScalar((1.08 * radius) / half);
    controls.update();
    draw();
  };
  const resize = () => {
    const { clientWidth, clientHeight } = container;
    if (!clientWidth || !clientHeight) return; // a hidden tab
    renderer.setPixelRatio(sharp);
    renderer.setSize(clientWidth, clientHeight, false);
    const before = Math.min(1, camera.aspect);
    camera.aspect = clientWidth / clientHeight;
    camera.position.multiplyScalar(before / Math.min(1, camera.aspect));
    camera.updateProjectionMatrix();
    drawNow(); // at once: setSize has cleared the canvas
  };
  canvas.addEventListener("keydown", (event) => {
    const turn = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    const zoom = { "+": 0.9, "=": 0.9, "-": 1.1 }[event.key];
    if (!turn && !zoom) return;
    event.preventDefault();
    if (zoom) camera.position.multiplyScalar(zoom);
    if (turn) {
      // Spherical's pole is y; ours is z.
      const at = new Spherical().setFromVector3(new Vector3(camera.position.x, camera.position.z, -camera.position.y));
      at.theta += turn[0] * 0.12;
      at.phi += turn[1] * 0.12;
      at.makeSafe();
      const v = new Vector3().setFromSpherical(at);
      camera.position.set(v.x, -v.z, v.y);
    }
    controls.update();
    draw();
  });
  controls.addEventListener("change", draw);
  const views = Object.assign(document.createElement("div"), { className: "views" });
  for (const [name, direction] of Object.entries(VIEWS)) {
    const button = Object.assign(document.createElement("button"), { textContent: name });
    button.title = `Look from: ${name.toLowerCase()}`;
    button.addEventListener("click", () => lookFrom(direction));
    views.append(button);
  }
  container.append(canvas);
  place.append(views, container);
  lookFrom(OBLIQUE);
  resize();
  new ResizeObserver(resize).observe(container);
  return Object.assign(stage, { draw, drawNow });
}

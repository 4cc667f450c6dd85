// Surfaces for the 3D views: with a colour a vertex, or see-through.
import { BufferAttribute, BufferGeometry, DoubleSide, Mesh, MeshBasicMaterial, MeshLambertMaterial } from "three";
import { vertexNormals } from "./geometry.js";

function geometryOf(positions, faces) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(positions, 3));
  geometry.setAttribute("normal", new BufferAttribute(vertexNormals(positions, faces, new Float32Array(positions.length)), 3));
  geometry.setIndex(new BufferAttribute(faces, 1));
  return geometry;
}

/** A surface to be painted: set colours by `paint`. */
export function paintedSurface(positions, faces) {
  const geometry = geometryOf(positions, faces);
  geometry.setAttribute("color", new BufferAttribute(new Float32Array(positions.length), 3));
  return new Mesh(geometry, new MeshLambertMaterial({ vertexColors: true, side: DoubleSide }));
}

/** Colour of each vertex, colourOf(v) → [r, g, b] in linear light. */
export function paint(mesh, colourOf) {
  const { color } = mesh.geometry.attributes;
  for (let v = 0; v < color.count; v++) color.array.set(colourOf(v), 3 * v);
  color.needsUpdate = true;
}

/** The patient's own surface; see-through where it lies over another. */
export function ownSurface(positions, faces, opacity = 0.45) {
  const material = new MeshLambertMaterial({ color: 0x2e9c8f, transparent: opacity < 1, opacity, depthWrite: opacity === 1, side: DoubleSide });
  return new Mesh(geometryOf(positions, faces), material);
}

/** The same as a net of its edges, which leaves the colours below in sight. */
export function ownNet(positions, faces) {
  return new Mesh(geometryOf(positions, faces), new MeshBasicMaterial({ color: 0x1f7a70, wireframe: true, transparent: true, opacity: 0.35 }));
}

export function removeFrom(scene, mesh) {
  scene.remove(mesh);
  mesh.geometry.dispose();
  mesh.material.dispose();
}

/** Largest distance of a vertex from the origin, mm. */
export function reach(points) {
  let largest = 0;
  for (let v = 0; v < points.length; v += 3) largest = Math.max(largest, Math.hypot(points[v], points[v + 1], points[v + 2]));
  return largest;
}

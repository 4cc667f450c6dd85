// Saves what the page made as a file of the reader's computer.

export function saveBlob(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

/** A surface as binary STL: 80 bytes of text, the number of triangles, 50 bytes per triangle. */
export function stl(positions, faces, text) {
  const count = faces.length / 3;
  const view = new DataView(new ArrayBuffer(84 + 50 * count));
  new Uint8Array(view.buffer).set(new TextEncoder().encode(text).subarray(0, 80));
  view.setUint32(80, count, true);
  const corner = (f, k) => [0, 1, 2].map((d) => positions[3 * faces[3 * f + k] + d]);
  for (let f = 0; f < count; f++) {
    const [a, b, c] = [0, 1, 2].map((k) => corner(f, k));
    const [u, v] = [b, c].map((p) => p.map((x, d) => x - a[d]));
    const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    const length = Math.hypot(...n) || 1;
    [...n.map((x) => x / length), ...a, ...b, ...c].forEach((x, i) => view.setFloat32(84 + 50 * f + 4 * i, x, true));
  }
  return new Blob([view.buffer], { type: "model/stl" });
}

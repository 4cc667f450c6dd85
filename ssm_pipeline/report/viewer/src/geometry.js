// Measures of a triangle mesh: flat arrays, positions 3 a vertex in mm, faces 3 a triangle.

/** Unit vertex normals, the mean of the triangles' normals weighted by area, into `out`. */
export function vertexNormals(positions, faces, out) {
  out.fill(0);
  for (let f = 0; f < faces.length; f += 3) {
    const a = 3 * faces[f], b = 3 * faces[f + 1], c = 3 * faces[f + 2];
    const ux = positions[b] - positions[a], uy = positions[b + 1] - positions[a + 1], uz = positions[b + 2] - positions[a + 2];
    const vx = positions[c] - positions[a], vy = positions[c + 1] - positions[a + 1], vz = positions[c + 2] - positions[a + 2];
    const nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx;
    out[a] += nx; out[a + 1] += ny; out[a + 2] += nz;
    out[b] += nx; out[b + 1] += ny; out[b + 2] += nz;
    out[c] += nx; out[c + 1] += ny; out[c + 2] += nz;
  }
  for (let v = 0; v < out.length; v += 3) {
    const length = Math.hypot(out[v], out[v + 1], out[v + 2]) || 1;
    out[v] /= length; out[v + 1] /= length; out[v + 2] /= length;
  }
  return out;
}

/** { volumeMl, areaCm2, extentsMm: [left-right, front-back, head-foot] } of a closed surface. */
export function measure(positions, faces) {
  let volume = 0, area = 0;
  for (let f = 0; f < faces.length; f += 3) {
    const a = 3 * faces[f], b = 3 * faces[f + 1], c = 3 * faces[f + 2];
    const ax = positions[a], ay = positions[a + 1], az = positions[a + 2];
    const bx = positions[b], by = positions[b + 1], bz = positions[b + 2];
    const cx = positions[c], cy = positions[c + 1], cz = positions[c + 2];
    volume += ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx);
    const ux = bx - ax, uy = by - ay, uz = bz - az, vx = cx - ax, vy = cy - ay, vz = cz - az;
    area += Math.hypot(uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx);
  }
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  for (let v = 0; v < positions.length; v++) {
    const axis = v % 3;
    if (positions[v] < low[axis]) low[axis] = positions[v];
    if (positions[v] > high[axis]) high[axis] = positions[v];
  }
  return {
    volumeMl: volume / 6 / 1e3,
    areaCm2: area / 2 / 1e2,
    extentsMm: high.map((value, axis) => value - low[axis]),
  };
}

/** Per triangle of the rest shape: the three cotangents, of the angles opposite each edge. */
export function cotangents(rest, faces) {
  const out = new Float32Array(faces.length);
  for (let f = 0; f < faces.length; f += 3) {
    for (let k = 0; k < 3; k++) {
      const o = 3 * faces[f + k], p = 3 * faces[f + (k + 1) % 3], q = 3 * faces[f + (k + 2) % 3];
      const ux = rest[p] - rest[o], uy = rest[p + 1] - rest[o + 1], uz = rest[p + 2] - rest[o + 2];
      const vx = rest[q] - rest[o], vy = rest[q + 1] - rest[o + 1], vz = rest[q + 2] - rest[o + 2];
      const cross = Math.hypot(uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx);
      out[f + k] = (ux * vx + uy * vy + uz * vz) / Math.max(cross, 1e-12);
    }
  }
  return out;
}

/**
 * Conformal distortion of each triangle against the rest shape, s1/s2 + s2/s1 with s1, s2 the
 * singular values of its map: 2 where angles are kept. Hormann and Greiner 2000 (MIPS).
 */
export function distortion(positions, faces, cotangent, out) {
  for (let f = 0, t = 0; f < faces.length; f += 3, t++) {
    const a = 3 * faces[f], b = 3 * faces[f + 1], c = 3 * faces[f + 2];
    let energy = 0;
    const corners = [a, b, c];
    for (let k = 0; k < 3; k++) {
      const p = corners[(k + 1) % 3], q = corners[(k + 2) % 3];
      const x = positions[p] - positions[q], y = positions[p + 1] - positions[q + 1], z = positions[p + 2] - positions[q + 2];
      energy += cotangent[f + k] * (x * x + y * y + z * z);
    }
    const ux = positions[b] - positions[a], uy = positions[b + 1] - positions[a + 1], uz = positions[b + 2] - positions[a + 2];
    const vx = positions[c] - positions[a], vy = positions[c + 1] - positions[a + 1], vz = positions[c + 2] - positions[a + 2];
    const twiceArea = Math.hypot(uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx);
    out[t] = energy / Math.max(twiceArea, 1e-12);
  }
  return out;
}

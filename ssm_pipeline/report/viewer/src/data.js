// Reads what the page holds: base64 blocks, quantised points, and the model's GLB.

/** Bytes of the script element with this id. */
export function block(id) {
  const text = atob(document.getElementById(id).textContent.trim());
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes.buffer;
}

const TYPES = { int16: Int16Array, uint16: Uint16Array, uint32: Uint32Array };

/** An array of a block; points come back as Float32Array in millimetres. */
export function array(buffer, place) {
  const length = place.shape.reduce((a, b) => a * b, 1);
  const raw = new TYPES[place.type](buffer, place.offset, length);
  if (place.scale === undefined) return raw;
  const points = new Float32Array(length);
  for (let i = 0; i < length; i++) points[i] = place.origin + place.scale * raw[i];
  return points;
}

/** Mean, faces and one displacement a mode (+1 SD, mm), from the GLB that `export` writes. */
export function readModel(buffer) {
  const view = new DataView(buffer);
  const jsonLength = view.getUint32(12, true);
  const tree = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 20, jsonLength)));
  const start = 20 + jsonLength + 8;
  const read = (index) => {
    const accessor = tree.accessors[index];
    const offset = start + tree.bufferViews[accessor.bufferView].byteOffset;
    return accessor.type === "VEC3"
      ? new Float32Array(buffer, offset, 3 * accessor.count)
      : new Uint32Array(buffer, offset, accessor.count);
  };
  const primitive = tree.meshes[0].primitives[0];
  return {
    mean: read(primitive.attributes.POSITION),
    faces: read(primitive.indices),
    modes: primitive.targets.map((target) => read(target.POSITION)),
  };
}

// Colour maps (sRGB stops, mixed linearly) and the legends that explain them.

const MAPS = {
  // ColorBrewer RdBu, reversed: blue inward, white at the mean, red outward.
  diverging: ["#053061", "#2166ac", "#4393c3", "#92c5de", "#d1e5f0", "#f7f7f7", "#fddbc7", "#f4a582", "#d6604d", "#b2182b", "#67001f"],
  // ColorBrewer YlOrBr.
  sequential: ["#fffbe6", "#fff0b8", "#fee391", "#fec44f", "#fe9929", "#ec7014", "#cc4c02", "#993404", "#662506"],
};

const toLinear = (c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);

/** 256 RGB triples in linear light, which is what the renderer mixes and shades in. */
export function lookup(name) {
  const stops = MAPS[name].map((hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255));
  const table = new Float32Array(256 * 3);
  for (let i = 0; i < 256; i++) {
    const at = (i / 255) * (stops.length - 1);
    const low = Math.min(Math.floor(at), stops.length - 2);
    for (let k = 0; k < 3; k++) {
      table[3 * i + k] = toLinear(stops[low][k] + (at - low) * (stops[low + 1][k] - stops[low][k]));
    }
  }
  return table;
}

/** Fill a legend element: a colour bar between two labels. */
export function legend(element, name, low, high, title = "") {
  const bar = document.createElement("i");
  bar.style.background = `linear-gradient(to right, ${MAPS[name].join(",")})`;
  if (title) bar.title = title;
  const label = (text) => Object.assign(document.createElement("span"), { textContent: text });
  element.replaceChildren(label(low), bar, label(high));
}

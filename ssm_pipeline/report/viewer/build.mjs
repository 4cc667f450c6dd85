// Bundles src/ and three.js into viewer.js, which the report page embeds. Run: npm ci && npm run build
import { copyFile } from "node:fs/promises";
import { build } from "esbuild";

await build({
  entryPoints: ["src/main.js"],
  outfile: "viewer.js",
  bundle: true,
  minify: true,
  format: "iife",
  target: "es2022",
  charset: "utf8",
  legalComments: "inline",
});
await copyFile("node_modules/three/LICENSE", "LICENSE-three.txt");

// Bundles src/ and three.js into viewer.js, which the report page embeds. Run: npm ci && npm run build
import { createHash } from "node:crypto";
import { copyFile, readdir, readFile, writeFile } from "node:fs/promises";
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

// What viewer.js was built of, so that a test without Node can tell whether it still is.
const sources = (await readdir("src", { recursive: true }))
  .filter((name) => name.endsWith(".js"))
  .map((name) => `src/${name.replaceAll("\\", "/")}`)
  .concat("package-lock.json")
  .sort();
const digest = createHash("sha256");
for (const name of sources) digest.update(name).update(await readFile(name));
const viewer = createHash("sha256").update(await readFile("viewer.js"));
const built = { sources: digest.digest("hex"), viewer: viewer.digest("hex") };
await writeFile("viewer.built.json", `${JSON.stringify(built, null, 2)}\n`);

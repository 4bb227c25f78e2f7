// Builds the page into service/web/static: two scripts (three.js comes only when a head is to be shown), one style
// sheet, the pictures of the gallery, and the licences of what is bundled.
import { build } from "esbuild";
import { copyFile, cp, mkdir, readFile, rm, writeFile } from "node:fs/promises";
import { fileURLToPath } from "node:url";

const here = fileURLToPath(new URL("./", import.meta.url));
const source = here + "src/";
const target = fileURLToPath(new URL(process.env.WEB_OUT ?? "../service/web/static/", import.meta.url));

await rm(target, { recursive: true, force: true });
await mkdir(target, { recursive: true });
await build({
  absWorkingDir: source,
  entryPoints: ["app.ts", "viewer.ts", "app.css"],
  outdir: target,
  bundle: true,
  minify: true,
  format: "esm",
  target: ["chrome111", "firefox115", "safari16.4"],
  external: ["./viewer.js"],
  legalComments: "none",
  charset: "utf8",
  logLevel: "warning",
});
for (const name of ["index.html", "icon.svg"]) await copyFile(source + name, target + name);
// Made by `python -m tests.web.gallery`.
await copyFile(here + "gallery/sample.jpg", target + "sample.jpg");
await cp(here + "gallery/", target + "gallery/", { recursive: true, filter: (path) => !path.endsWith("sample.jpg") });

const three = fileURLToPath(new URL("node_modules/three/", import.meta.url));
const { version } = JSON.parse(await readFile(three + "package.json", "utf8"));
const licence = (await readFile(three + "LICENSE", "utf8")).trim();
await writeFile(
  target + "LICENSES.txt",
  `viewer.js contains parts of three.js ${version} (https://threejs.org), under this licence:\n\n${licence}\n\n` +
    "sample.jpg and the pictures in gallery/ show or were made from NASA's portrait of the astronaut Eileen Collins\n" +
    "(service/data/sample/astronaut.png), which is in the public domain. NASA asks not to use a likeness for advertising\n" +
    "and endorses nothing here.\n\n" +
    "All else in this folder is part of AvatarMe on a CPU, under the Apache License 2.0.\n",
);

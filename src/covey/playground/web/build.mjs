// Builds ../static from the sources: reproducible, and with the hash of its sources, so that tests can tell whether it is up to date.

import { build } from "esbuild";
import { createHash } from "node:crypto";
import { cpSync, mkdirSync, readdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { dirname, join, relative } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const out = process.argv[2] ?? join(here, "..", "static");
const common = { bundle: true, minify: true, format: "iife", target: "es2022", charset: "utf8", legalComments: "none", absWorkingDir: here };

rmSync(out, { recursive: true, force: true });
mkdirSync(out, { recursive: true });
await build({ ...common, entryPoints: ["src/main.ts"], outfile: join(out, "app.js") });
const licence = readFileSync(join(here, "node_modules", "three", "LICENSE"), "utf8").trim();
await build({
  ...common, entryPoints: ["src/scene3d.ts"], outfile: join(out, "scene3d.js"), globalName: "coveyScene3d", banner: { js: `/* three.js:\n${licence}\n*/` },
});
for (const file of ["index.html", "style.css"]) cpSync(join(here, file), join(out, file));

const sources = readdirSync(here, { recursive: true, withFileTypes: true })
  .filter((entry) => entry.isFile())
  .map((entry) => relative(here, join(entry.parentPath ?? entry.path, entry.name)).replaceAll("\\", "/"))
  .filter((name) => !name.startsWith("node_modules/"))
  .sort();
const sha256 = (data) => createHash("sha256").update(data).digest("hex");
const digest = (folder, names) => Object.fromEntries(names.map((name) => [name, sha256(readFileSync(join(folder, name)))]));
const record = { sources: digest(here, sources), built: digest(out, readdirSync(out).sort()) };
writeFileSync(join(out, "build.json"), JSON.stringify(record, null, 1) + "\n");

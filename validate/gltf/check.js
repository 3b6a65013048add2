#!/usr/bin/env node
// Runs the Khronos glTF validator over .glb and .gltf files: prints every message, and exits 1 when a file has an error
// or a warning (2 when called badly). Infos and hints are printed and do not count.
//
//   validate/gltf/check.js out/cow.glb
//
// The validator (npm package gltf-validator, version in package.json beside this file) is fetched by npm on first use,
// into the folder that MOOMILL_NODE names, else build/gltf-validator of the project.
"use strict";
const { execFileSync } = require("child_process");
const fs = require("fs");
const path = require("path");

const home = process.env.MOOMILL_NODE || path.join(__dirname, "..", "..", "build", "gltf-validator");

function complain(sentence) {
  console.error("check.js: " + sentence);
  process.exit(2);
}

function load() {
  const wanted = require("./package.json").dependencies["gltf-validator"];
  const installed = path.join(home, "node_modules", "gltf-validator");
  const version = () => {
    try {
      return JSON.parse(fs.readFileSync(path.join(installed, "package.json"), "utf8")).version;
    } catch {
      return null;
    }
  };
  if (version() !== wanted) {
    try {
      fs.mkdirSync(home, { recursive: true });
      fs.copyFileSync(path.join(__dirname, "package.json"), path.join(home, "package.json"));
      execFileSync("npm", ["install", "--silent", "--no-audit", "--no-fund"], { cwd: home, stdio: ["ignore", "ignore", "inherit"] });
    } catch (error) {
      complain(`npm could not install gltf-validator into ${home} (${error.message.split("\n")[0]}); install npm (section crosscheck of apt-packages.txt) and check the network`);
    }
  }
  return require(installed);
}

async function main() {
  const files = process.argv.slice(2);
  if (files.length === 0 || files[0].startsWith("-")) complain("name the files: validate/gltf/check.js out/cow.glb");
  for (const file of files)
    if (!fs.existsSync(file)) complain(`there is no file ${file}; build it by: moomill rig build cow -o ${file}`);
  const validator = load();
  const severities = ["error", "warning", "info", "hint"];
  let bad = 0;
  for (const file of files) {
    const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)), {
      uri: path.basename(file),
      maxIssues: 1000,
      externalResourceFunction: async (uri) => new Uint8Array(fs.readFileSync(path.join(path.dirname(file), decodeURIComponent(uri)))),
    });
    const i = report.issues;
    for (const m of i.messages) console.log(`${severities[m.severity].padEnd(8)}${file} ${m.pointer || (m.offset !== undefined ? "byte " + m.offset : "")}: ${m.code}: ${m.message}`);
    if (i.truncated) console.log(`${file}: more messages than were listed`);
    const info = report.info;
    console.log(`${file}: ${i.numErrors} errors, ${i.numWarnings} warnings, ${i.numInfos} infos, ${i.numHints} hints (glTF ${info.version}, ${info.totalVertexCount} vertices, ${info.totalTriangleCount} triangles, ${info.animationCount} animations, at most ${info.maxInfluences} influences)`);
    if (i.numErrors + i.numWarnings > 0) bad += 1;
  }
  process.exit(bad > 0 ? 1 : 0);
}

main().catch((error) => {
  console.error("check.js: " + (error && error.message ? error.message : error));
  process.exit(1);
});

// Compiles rosplc.st and your program with STruC++, and creates all files that OpenPLC's runtime compiles:
//   node build.mjs STRUCPP PROGRAM.st FOLDER
// STRUCPP is a built checkout of STruC++; FOLDER is core/generated of a runtime, or a folder to zip and upload.
import { createHash } from "node:crypto";
import { cpSync, mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";

const [strucpp, program, folder] = process.argv.slice(2);
if (!folder) {
  console.error("usage: node build.mjs STRUCPP PROGRAM.st FOLDER");
  process.exit(2);
}
const here = dirname(fileURLToPath(import.meta.url));
const { compile } = await import(pathToFileURL(resolve(strucpp, "dist/index.js")));
const blocks = readFileSync(join(here, "rosplc.st"), "utf8");
const text = blocks + readFileSync(program, "utf8");
const made = compile(text, { headerFileName: "generated.hpp" });
if (!made.success) {
  const before = blocks.split("\n").length - 1;
  for (const { line, message } of made.errors) {
    console.error(line > before ? `${program}:${line - before}: ${message}` : `rosplc.st:${line}: ${message}`);
  }
  process.exit(1);
}
mkdirSync(folder, { recursive: true });
cpSync(join(here, "generated"), folder, { recursive: true });
cpSync(join(strucpp, "src/runtime/include"), join(folder, "strucpp_runtime/include"), { recursive: true });
const md5 = createHash("md5").update(text).digest("hex");
const files = {
  "generated.hpp": made.headerCode,
  "generated.cpp": made.cppCode,
  "generated_debug.cpp": made.debugTableCpp,
  "defines.h": `#define PROGRAM_MD5 "${md5}"\n`,
};
for (const [name, content] of Object.entries(files)) {
  writeFileSync(join(folder, name), content);
}

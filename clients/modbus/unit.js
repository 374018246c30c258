// What both JavaScript examples do with a unit: they read R of skin at ten distances. A `unit` has
//   write(address, registers)  which writes an array of registers
//   read(address, count)       which resolves to a Buffer with the bytes of `count` registers
// When the daemon answers with an exception, both reject with an error whose `exception` is its
// code.
"use strict";

const RADII_MM = [0.1, 0.2, 0.5, 1, 1.5, 2, 3, 4, 6, 8];
const BUSY_EXCEPTION = 6;
const [BUSY, DONE] = [1, 2]; // values of the register `status`
const PATIENCE_MS = 60000;

const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

// Returns the registers of these floats, most significant word first.
function floats(values) {
  const bytes = Buffer.alloc(4 * values.length);
  values.forEach((value, i) => bytes.writeFloatBE(value, 4 * i));
  return Array.from({ length: 2 * values.length }, (_, i) => bytes.readUInt16BE(2 * i));
}

// Throws what the daemon says of the last error.
async function fail(unit) {
  const error = await unit.read(302, 2);
  const text = (await unit.read(620, 40)).toString("ascii").replace(/\0+$/, "");
  throw new Error(`error ${error.readUInt16BE(0)} at register ${error.readUInt16BE(2)}: ${text}`);
}

// Writes registers. While another master's job runs, a commit is refused as busy: writes it again
// until that job has ended.
async function write(unit, address, registers) {
  const giveUp = Date.now() + PATIENCE_MS;
  for (;;) {
    try {
      return await unit.write(address, registers);
    } catch (error) {
      if (error.exception === undefined) {
        throw error;
      }
      if (error.exception !== BUSY_EXCEPTION || Date.now() > giveUp) {
        await fail(unit);
      }
    }
    await pause(50);
  }
}

// Other masters may have written anything into the unit. So this first sets all registers to their
// defaults, then writes what the job depends on, and waits until the job with its token is done.
async function printProfile(unit, model) {
  await write(unit, 251, [1]); // defaults
  await write(unit, 101, [model]); // the evaluator stays f32, the moments exact
  await write(unit, 106, floats([0.032, 0.74, 0, 1.3])); // sigma_a, sigma_s, g, eta
  await write(unit, 115, [RADII_MM.length]); // a list of ten distances
  await write(unit, 120, floats(RADII_MM));
  const before = await unit.read(301, 1);
  const token = (before.readUInt16BE(0) % 65535) + 1; // not that of the job that was done last
  await write(unit, 100, [token]); // commit
  let head;
  while ((head = await unit.read(300, 2)).readUInt16BE(0) === BUSY) {
    await pause(20);
  }
  if (head.readUInt16BE(0) !== DONE) {
    await fail(unit);
  }
  if (head.readUInt16BE(2) !== token) {
    throw new Error(`another master's job has taken the place of ${token}`);
  }
  const values = await unit.read(312, 2 * RADII_MM.length);
  RADII_MM.forEach((r, i) => {
    console.log(`${r} mm: ${values.readFloatBE(4 * i).toPrecision(9)} 1/mm^2`);
  });
}

module.exports = { printProfile };

// R of skin at ten distances, with modbus-serial (npm): node profile.js HOST:PORT [MODEL].
// MODEL is an id of the list of models in REGISTERS.md.
"use strict";
const ModbusRTU = require("modbus-serial");

const RADII_MM = [0.1, 0.2, 0.5, 1, 1.5, 2, 3, 4, 6, 8];
const BUSY_EXCEPTION = 6;
const [BUSY, DONE] = [1, 2]; // values of the register `status`
const PATIENCE_MS = 60000;

const client = new ModbusRTU();
const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
const read = async (address, count) => (await client.readHoldingRegisters(address, count)).buffer;

// Returns the registers of these floats, most significant word first.
function floats(values) {
  const bytes = Buffer.alloc(4 * values.length);
  values.forEach((value, i) => bytes.writeFloatBE(value, 4 * i));
  return Array.from({ length: 2 * values.length }, (_, i) => bytes.readUInt16BE(2 * i));
}

// Throws what the daemon says of the last error.
async function fail() {
  const error = await read(302, 2);
  const text = (await read(620, 40)).toString("ascii").replace(/\0+$/, "");
  throw new Error(`error ${error.readUInt16BE(0)} at register ${error.readUInt16BE(2)}: ${text}`);
}

// Writes registers. While another master's job runs, a commit is refused as busy: writes it again
// until that job has ended.
async function write(address, registers) {
  for (const giveUp = Date.now() + PATIENCE_MS; ; await pause(50)) {
    try {
      return await client.writeRegisters(address, registers);
    } catch (error) {
      if (error.modbusCode === undefined) {
        throw error;
      }
      if (error.modbusCode !== BUSY_EXCEPTION || Date.now() > giveUp) {
        await fail();
      }
    }
  }
}

// Other masters may have written anything into the unit. So this first sets all registers to their
// defaults, then writes what the job depends on, and waits until the job with its token is done.
async function printProfile(model) {
  await write(251, [1]); // defaults
  await write(101, [model]); // the evaluator stays f32, the moments exact
  await write(106, floats([0.032, 0.74, 0, 1.3])); // sigma_a, sigma_s, g, eta
  await write(115, [RADII_MM.length]); // a list of ten distances
  await write(120, floats(RADII_MM));
  const token = ((await read(301, 1)).readUInt16BE(0) % 65535) + 1; // not that of the last job
  await write(100, [token]); // commit
  let head;
  while ((head = await read(300, 2)).readUInt16BE(0) === BUSY) {
    await pause(20);
  }
  if (head.readUInt16BE(0) !== DONE) {
    await fail();
  }
  if (head.readUInt16BE(2) !== token) {
    throw new Error(`another master's job has taken the place of ${token}`);
  }
  const values = await read(312, 2 * RADII_MM.length);
  RADII_MM.forEach((r, i) => {
    console.log(`${r} mm: ${values.readFloatBE(4 * i).toPrecision(9)} 1/mm^2`);
  });
}

// Ends the program with its usage: for --help, or with what is wrong.
function usage(what) {
  (what ? console.error : console.log)(`${what ? `${what}\n` : ""}node profile.js HOST:PORT [MODEL]
MODEL is an id of the list of models in REGISTERS.md (default: 2).`);
  process.exit(what ? 2 : 0);
}

async function main([where = "nothing", model = "2", ...more]) {
  if ([where, model, ...more].some((word) => word === "--help" || word === "-h")) {
    usage();
  }
  if (!/^.+:\d+$/.test(where)) {
    usage(`${where} is given: give HOST:PORT`);
  }
  if (more.length > 0 || !(Number(model) > 0 && Number(model) < 65536)) {
    usage(`${[model, ...more].join(" ")}: give the id of a model`);
  }
  await client.connectTCP(where.replace(/:\d+$/, ""), { port: Number(where.replace(/.*:/, "")) });
  client.setID(1);
  client.setTimeout(2000);
  await printProfile(Number(model)).finally(() => client.close(() => {}));
}

main(process.argv.slice(2)).catch((error) => {
  console.error(error.message);
  process.exitCode = 1;
});

// What both JavaScript examples do with a unit: they read R of skin at ten distances, or fit
// coefficients to readings. A `unit` has
//   write(address, registers)  which writes an array of registers
//   read(address, count)       which resolves to a Buffer with the bytes of `count` registers
// When the daemon answers with an exception, both reject with an error whose `exception` is its
// code.
"use strict";

const RADII_MM = [0.1, 0.2, 0.5, 1, 1.5, 2, 3, 4, 6, 8];
const BUSY_EXCEPTION = 6;
const [BUSY, DONE, UNFITTED] = [1, 2, 5]; // values of the register `status`
const TRANSPORT = 29;
const READINGS = ["1,.02292,.00046", "2,.00781,.00016", "3,.00343,.00007", "5,.000775,.000016"];
const SCALES = ["absolute", "free"];
const FIT = { g: "0", eta: "1.4", scale: "absolute" }; // by name; eta: that of READINGS
const PATIENCE_MS = 60000;

const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

// Returns the registers of these floats, most significant word first.
function floats(values) {
  const bytes = Buffer.alloc(4 * values.length);
  values.forEach((value, i) => bytes.writeFloatBE(value, 4 * i));
  return Array.from({ length: 2 * values.length }, (_, i) => bytes.readUInt16BE(2 * i));
}

async function text(unit, address, count) {
  return (await unit.read(address, count)).toString("ascii").replace(/\0+$/, "");
}

// Throws what the daemon says of the last error.
async function fail(unit, errorAt = 302, textAt = 620) {
  const error = await unit.read(errorAt, 2);
  const allowed = await text(unit, textAt, 40);
  throw new Error(`error ${error.readUInt16BE(0)} at register ${error.readUInt16BE(2)}: ${allowed}`);
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

// Finds the coefficients of a medium from readings: mm, reading and standard error of each. An
// instrument writes its places once, and its readings each time.
async function printFit(unit, named, readings) {
  const known = { ...FIT, ...named };
  await write(unit, 251, [1]); // defaults
  await write(unit, 101, [TRANSPORT]);
  await write(unit, 110, floats([Number(known.g), Number(known.eta)]));
  await write(unit, 8001, [SCALES.indexOf(known.scale) + 1]);
  await write(unit, 8015, [readings.length, ...floats(readings.map(([mm]) => mm))]);
  await write(unit, 8204, floats(readings.flatMap(([, value, error]) => [value, error])));
  const before = await unit.read(8321, 1);
  const token = (before.readUInt16BE(0) % 65535) + 1;
  await write(unit, 8200, [token]); // commit
  let head;
  while ((head = await unit.read(8320, 26)).readUInt16BE(0) === BUSY) {
    await pause(20);
  }
  if (head.readUInt16BE(0) === UNFITTED) {
    throw new Error(`the fit is no success: ${await text(unit, 8460, 8)}`);
  }
  if (head.readUInt16BE(0) !== DONE) {
    await fail(unit, 8322, 8420);
  }
  const float = (i) => head.readFloatBE(16 + 4 * i);
  const [a, s, aError, sError, chiSquared, factor, factorError] = [0, 1, 2, 3, 5, 7, 8].map(float);
  const told = (value, error) => `${value.toPrecision(6)} +- ${error.toPrecision(2)}`;
  console.log(`sigma_a ${told(a, aError)}, sigma_s' ${told(s, sError)} 1/mm`);
  if (known.scale === "free") {
    console.log(`factor ${told(factor, factorError)}`);
  }
  const assumed = await unit.read(8410, 4);
  const [g, eta] = [0, 4].map((at) => Number(assumed.readFloatBE(at).toPrecision(6)));
  const [gFrom, scaleFrom] = ["g", "scale"].map((name) => (name in named ? "" : " (default)"));
  console.log(`with g ${g}${gFrom}, eta ${eta}, scale ${known.scale}${scaleFrom}`);
  console.log(`chi-squared ${chiSquared.toPrecision(4)} of ${readings.length} readings`);
}

// Ends the program with its usage: for --help, or with what is wrong.
function usage(what) {
  const name = process.argv[1].replace(/.*\//, "");
  (what ? console.error : console.log)(`${what ? `${what}\n` : ""}node ${name} HOST:PORT [MODEL]
node ${name} HOST:PORT fit [g=0] [scale=absolute|free] [eta=X MM,READING,ERROR...]
MODEL is an id of the list of models in REGISTERS.md (default: 2).`);
  process.exit(what ? 2 : 0);
}

function readFit(given) {
  const named = {};
  for (const one of given.filter((word) => word.includes("="))) {
    const [name, value] = one.split("=", 2);
    const isNumber = value !== "" && Number.isFinite(Number(value));
    const good = name === "scale" ? SCALES.includes(value) : isNumber;
    if (!Object.keys(FIT).includes(name) || !good) {
      usage(`${one}: fit takes g= and eta= with a number, and scale=absolute or scale=free`);
    }
    named[name] = value;
  }
  const own = given.filter((word) => !word.includes("="));
  if (own.length && !named.eta) {
    usage("give eta=X: a wrong eta gives wrong coefficients that fit as well");
  }
  const readings = (own.length ? own : READINGS).map((one) => {
    const numbers = one.split(",").map((text) => (text === "" ? NaN : Number(text)));
    const good = numbers.length === 3 && numbers.every(Number.isFinite);
    return good ? numbers : usage(`${one}: give MM,READING,ERROR`);
  });
  const least = named.scale === "free" ? 3 : 2;
  if (readings.length < least || readings.length > 25) {
    usage(`${readings.length} readings: give ${least} to 25`);
  }
  return (unit) => printFit(unit, named, readings);
}

// Reads the words of the command line: HOST:PORT, and the number of a model, or fit and readings.
// Returns the host, the port, and what to do with a unit.
function read(words) {
  const [where, what = "2", ...more] = words;
  if (words.includes("--help") || words.includes("-h")) {
    usage();
  }
  if (!/^.+:\d+$/.test(where || "")) {
    usage(`${where || "nothing"} is given: give HOST:PORT`);
  }
  if (what !== "fit" && (more.length > 0 || !(Number(what) > 0 && Number(what) < 65536))) {
    usage(`${[what, ...more].join(" ")}: give the id of a model, or fit`);
  }
  const work = what === "fit" ? readFit(more) : (unit) => printProfile(unit, Number(what));
  return { host: where.replace(/:\d+$/, ""), port: Number(where.replace(/.*:/, "")), work };
}

module.exports = { read };

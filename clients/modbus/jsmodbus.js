// R of skin at ten distances, with jsmodbus (npm): node jsmodbus.js HOST:PORT
"use strict";
const net = require("net");
const Modbus = require("jsmodbus");

const RADII_MM = [0.1, 0.2, 0.5, 1, 1.5, 2, 3, 4, 6, 8];

// Returns the bytes of registers that hold these floats, most significant word first.
function floats(values) {
  const bytes = Buffer.alloc(4 * values.length);
  values.forEach((value, i) => bytes.writeFloatBE(value, 4 * i));
  return bytes;
}

async function ask(client) {
  await client.writeMultipleRegisters(106, floats([0.032, 0.74, 0, 1.3])); // sigma_a ... eta
  await client.writeMultipleRegisters(114, [1, RADII_MM.length]); // spacing: a list; its length
  await client.writeMultipleRegisters(120, floats(RADII_MM));
  await client.writeSingleRegister(100, 1); // commit
  const status = await client.readHoldingRegisters(300, 2);
  const [state, done] = status.response.body.valuesAsArray;
  if (state !== 2 || done !== 1) {
    throw new Error(`status ${state}: see registers 302, 303 and 620`);
  }
  const values = await client.readHoldingRegisters(312, 2 * RADII_MM.length);
  RADII_MM.forEach((r, i) => {
    const R = values.response.body.valuesAsBuffer.readFloatBE(4 * i);
    console.log(`${r} mm: ${R.toPrecision(9)} 1/mm^2`);
  });
}

const [host, port] = process.argv[2].split(":");
const socket = net.connect({ host, port: Number(port) });
const client = new Modbus.client.TCP(socket, 1);
socket.on("error", (error) => {
  console.error(error.message);
  process.exit(1);
});
socket.on("connect", () => {
  ask(client)
    .catch((error) => {
      console.error(error.message);
      process.exitCode = 1;
    })
    .finally(() => socket.end());
});

// R of skin at ten distances, with modbus-serial (npm): node profile.js HOST:PORT
"use strict";
const ModbusRTU = require("modbus-serial");

const RADII_MM = [0.1, 0.2, 0.5, 1, 1.5, 2, 3, 4, 6, 8];

// Returns the registers of these floats, most significant word first.
function floats(values) {
  const bytes = Buffer.alloc(4 * values.length);
  values.forEach((value, i) => bytes.writeFloatBE(value, 4 * i));
  return Array.from({ length: 2 * values.length }, (_, i) => bytes.readUInt16BE(2 * i));
}

async function main(where) {
  const [host, port] = where.split(":");
  const client = new ModbusRTU();
  await client.connectTCP(host, { port: Number(port) });
  client.setID(1);
  client.setTimeout(2000);
  await client.writeRegisters(106, floats([0.032, 0.74, 0, 1.3])); // sigma_a, sigma_s, g, eta
  await client.writeRegisters(114, [1, RADII_MM.length]); // spacing: a list; its length
  await client.writeRegisters(120, floats(RADII_MM));
  await client.writeRegister(100, 1); // commit
  const { data } = await client.readHoldingRegisters(300, 2);
  if (data[0] !== 2 || data[1] !== 1) {
    throw new Error(`status ${data[0]}: see registers 302, 303 and 620`);
  }
  const { buffer } = await client.readHoldingRegisters(312, 2 * RADII_MM.length);
  RADII_MM.forEach((r, i) => {
    console.log(`${r} mm: ${buffer.readFloatBE(4 * i).toPrecision(9)} 1/mm^2`);
  });
  client.close(() => {});
}

main(process.argv[2]).catch((error) => {
  console.error(error.message);
  process.exit(1);
});

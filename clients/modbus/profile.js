// R of skin at ten distances, with modbus-serial (npm): node profile.js HOST:PORT [MODEL].
// MODEL is an id of the list of models in REGISTERS.md. With fit in its place, coefficients are
// fitted to readings: see --help.
"use strict";
const ModbusRTU = require("modbus-serial");
const { read } = require("./unit.js");

// Adds the code of an exception to the error.
function tell(error) {
  throw Object.assign(error, { exception: error.modbusCode });
}

async function main() {
  const { host, port, work } = read(process.argv.slice(2));
  const client = new ModbusRTU();
  await client.connectTCP(host, { port });
  client.setID(1);
  client.setTimeout(2000);
  const unit = {
    write: (address, registers) => client.writeRegisters(address, registers).catch(tell),
    read: async (address, count) =>
      (await client.readHoldingRegisters(address, count).catch(tell)).buffer,
  };
  try {
    await work(unit);
  } finally {
    client.close(() => {});
  }
}

main().catch((error) => {
  console.error(error.message);
  process.exitCode = 1;
});

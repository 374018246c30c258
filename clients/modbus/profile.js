// R of skin at ten distances, with modbus-serial (npm): node profile.js HOST:PORT [MODEL].
// MODEL is an id of the list of models in REGISTERS.md. With fit [eta=X MM,READING,ERROR...] in its place,
// coefficients are fitted to readings.
"use strict";
const ModbusRTU = require("modbus-serial");
const { work } = require("./unit.js");

// Adds the code of an exception to the error.
function tell(error) {
  throw Object.assign(error, { exception: error.modbusCode });
}

async function main(where, ...what) {
  const [host, port] = where.split(":");
  const client = new ModbusRTU();
  await client.connectTCP(host, { port: Number(port) });
  client.setID(1);
  client.setTimeout(2000);
  const unit = {
    write: (address, registers) => client.writeRegisters(address, registers).catch(tell),
    read: async (address, count) =>
      (await client.readHoldingRegisters(address, count).catch(tell)).buffer,
  };
  try {
    await work(unit, ...what);
  } finally {
    client.close(() => {});
  }
}

main(...process.argv.slice(2)).catch((error) => {
  console.error(error.message);
  process.exitCode = 1;
});

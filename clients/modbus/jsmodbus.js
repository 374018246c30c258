// R of skin at ten distances, with jsmodbus (npm): node jsmodbus.js HOST:PORT [MODEL].
// MODEL is an id of the list of models in REGISTERS.md. With fit in its place, coefficients are
// fitted to readings: see --help.
"use strict";
const net = require("net");
const Modbus = require("jsmodbus");
const { read } = require("./unit.js");

// Adds the code of an exception to the error.
function tell(error) {
  const body = error.response && error.response.body;
  throw Object.assign(new Error(error.message), { exception: body && body.code });
}

const { host, port, work } = read(process.argv.slice(2));
const socket = net.connect({ host, port });
const client = new Modbus.client.TCP(socket, 1);
const unit = {
  write: (address, registers) => client.writeMultipleRegisters(address, registers).catch(tell),
  read: async (address, count) =>
    (await client.readHoldingRegisters(address, count).catch(tell)).response.body.valuesAsBuffer,
};
socket.on("error", (error) => {
  console.error(error.message);
  process.exit(1);
});
socket.on("connect", () => {
  work(unit)
    .catch((error) => {
      console.error(error.message);
      process.exitCode = 1;
    })
    .finally(() => socket.end());
});

"""Reads R of skin at ten distances with pymodbus: profile.py HOST:PORT, or profile.py DEVICE,BAUD.

One request of function 23 writes the medium and the distances, commits, and reads the values."""

import struct
import sys

from pymodbus.client import ModbusSerialClient, ModbusTcpClient

RADII_MM = [0.1, 0.2, 0.5, 1, 1.5, 2, 3, 4, 6, 8]
TOKEN, BETTER, F32, EXACT, LIST = 1, 2, 2, 1, 1

where = sys.argv[1]
if where.startswith("/"):
    device, _, baud = where.rpartition(",")
    client = ModbusSerialClient(device, baudrate=int(baud), parity="N")
else:
    host, _, port = where.rpartition(":")
    client = ModbusTcpClient(host, port=int(port))
if not client.connect():
    sys.exit(f"nobody answers at {where}")

# The fields of registers 100 and up: commit, model, evaluator, moments, tolerance (0: none),
# sigma_a, sigma_s, g, eta, spacing, number of distances, start and stop of a grid (unused here),
# distances.
fields = [TOKEN, BETTER, F32, EXACT, 0, 0.032, 0.74, 0, 1.3, LIST, len(RADII_MM), 0, 0, *RADII_MM]
job = struct.pack(f">4H5f2H2f{len(RADII_MM)}f", *fields)
answer = client.readwrite_registers(
    write_address=100,
    write_registers=list(struct.unpack(f">{len(job) // 2}H", job)),
    read_address=300,
    read_count=12 + 2 * len(RADII_MM),
    unit=1,
)
client.close()
if answer.isError():
    sys.exit(str(answer))
status, done, *_ = answer.registers
if (status, done) != (2, TOKEN):
    sys.exit(f"status {status}: see registers 302, 303 and 620")
values = struct.pack(f">{2 * len(RADII_MM)}H", *answer.registers[12:])
for r, value in zip(RADII_MM, struct.unpack(f">{len(RADII_MM)}f", values)):
    print(f"{r:g} mm: {value:.9g} 1/mm^2")

/* modbus: a Modbus master's requests over TCP, and masters that behave badly. */
#ifndef DIPOLED_BENCH_SERVICE_MODBUS_H
#define DIPOLED_BENCH_SERVICE_MODBUS_H

#include "tests/bench/service/target.h"

/* Jobs in one transaction each: function 23 writes 20 registers (commit, model, medium, a grid of 4
 * distances) and reads 20 (status to R), of 32 units with a medium each. The expected values are
 * computed here. */
enum { MODBUS_UNITS = 32 };
void modbus_make_jobs(struct target *target);

/* Three processes, each with a connection of its own: one sends a byte every 0.4 s, one asks and
 * never reads, one asks for an unknown function 100 times a second. Returns when the daemon takes
 * no more of the second. They end with the benchmark, or before. */
enum { MODBUS_RUDE = 3 };
void modbus_start_rude(const struct target_address *address, pid_t rude[MODBUS_RUDE]);

#endif

/* modbus: the requests of a Modbus master over TCP, and masters that behave badly. */
#ifndef DIPOLED_BENCH_SERVICE_MODBUS_H
#define DIPOLED_BENCH_SERVICE_MODBUS_H

#include "tests/bench/service/target.h"

/* Makes one job for each of 32 units, which all have different media. A job is one transaction:
 * function 23 writes 20 registers (commit, model, medium, a grid of 4 distances) and reads 20
 * (status to R). The expected values are computed in this process. */
enum { MODBUS_UNITS = 32 };
void modbus_make_jobs(struct target *target);

/* Starts three processes with a connection each. The first sends one byte every 0.4 s, the second
 * sends requests and never reads, and the third asks for an unknown function 100 times a second.
 * Returns when the daemon reads no more from the second one. The caller may end them with
 * child_end(); they end with the benchmark at the latest. */
enum { MODBUS_RUDE = 3 };
void modbus_start_rude(const struct target_address *address, pid_t rude[MODBUS_RUDE]);

#endif

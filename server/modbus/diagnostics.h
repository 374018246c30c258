/* diagnostics: the counters of a serial line, and function 8, which returns them (MODBUS
 * Application Protocol Specification V1.1b3, section 6.8). */
#ifndef DIPOLED_MODBUS_DIAGNOSTICS_H
#define DIPOLED_MODBUS_DIAGNOSTICS_H

#include "server/modbus/codec.h"

/* The counters, in the order of the sub-functions 11 to 18 that return them. They wrap at 65536. */
enum modbus_counter {
  MODBUS_COUNTER_BUS_MESSAGES,    /* frames from and to anybody */
  MODBUS_COUNTER_BUS_ERRORS,      /* wrong checksums, unfinished frames, noise */
  MODBUS_COUNTER_EXCEPTIONS,      /* answers that were exceptions */
  MODBUS_COUNTER_SERVER_MESSAGES, /* requests to the unit or to all units */
  MODBUS_COUNTER_NO_RESPONSES,    /* requests to the unit or to all units that were not answered */
  MODBUS_COUNTER_NAKS,            /* exceptions 07 */
  MODBUS_COUNTER_BUSY,            /* exceptions 06 */
  MODBUS_COUNTER_OVERRUNS,        /* silences before which the device lost characters */
  MODBUS_COUNTERS
};

/* Bits of the diagnostic register. */
enum { MODBUS_DIAGNOSTIC_ECHO = 1 /* there was an echo */ };

struct modbus_diagnostics {
  uint16_t counters[MODBUS_COUNTERS];
  uint16_t diagnostic_register;
  bool listen_only; /* whether requests are neither carried out nor answered */
};

/* Counts an answer if it is an exception. */
void modbus_diagnostics_count(struct modbus_diagnostics *diagnostics, const uint8_t *pdu);

/* Returns whether a request to the unit is carried out. In listen-only mode, only a restart is. */
bool modbus_diagnostics_allows(const struct modbus_diagnostics *diagnostics, const uint8_t *pdu,
                               size_t bytes);

/* Carries out a request of function 8. Writes the answer's PDU and returns its length. Returns 0 if
 * there is no answer. */
size_t modbus_diagnostics_answer(struct modbus_diagnostics *diagnostics, const uint8_t *pdu,
                                 size_t bytes, uint8_t answer[MODBUS_PDU_MAX]);

#endif

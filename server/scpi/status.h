/* status: the registers and the error queue of one SCPI client (IEEE 488.2, SCPI-99 volume 2, 20). */
#ifndef DIPOLED_SCPI_STATUS_H
#define DIPOLED_SCPI_STATUS_H

#include "proto/wire.h"

enum {
  SCPI_ERRORS_MAX = 16,
  SCPI_ERROR_BYTES = 200, /* of number and text, with a zero byte */
};

/* The errors of SCPI-99 that are made here, and those that the list of statuses names. */
#define SCPI_ERRORS(E)                                                                             \
  E(-100, COMMAND, "Command error")                                                                \
  E(-101, UNDEFINED_CHARACTER, "Invalid character")                                                \
  E(-103, BAD_SEPARATOR, "Invalid separator")                                                      \
  E(-104, BAD_TYPE, "Data type error")                                                             \
  E(-108, NOT_ALLOWED, "Parameter not allowed")                                                    \
  E(-109, MISSING, "Missing parameter")                                                            \
  E(-113, UNDEFINED_HEADER, "Undefined header")                                                    \
  E(-121, BAD_DECIMAL, "Invalid character in number")                                              \
  E(-123, BIG_EXPONENT, "Exponent too large")                                                      \
  E(-124, TOO_MANY_DIGITS, "Too many digits")                                                      \
  E(-131, BAD_SUFFIX, "Invalid suffix")                                                            \
  E(-151, BAD_STRING, "Invalid string data")                                                       \
  E(-161, BAD_BLOCK, "Invalid block data")                                                         \
  E(-203, PROTECTED, "Command protected")                                                          \
  E(-220, BAD_PARAMETER, "Parameter error")                                                        \
  E(-221, CONFLICT, "Settings conflict")                                                           \
  E(-222, OUT_OF_RANGE, "Data out of range")                                                       \
  E(-223, TOO_MUCH, "Too much data")                                                               \
  E(-224, BAD_VALUE, "Illegal parameter value")                                                    \
  E(-226, UNEQUAL_LISTS, "Lists not same length")                                                  \
  E(-230, STALE, "Data corrupt or stale")                                                          \
  E(-300, DEVICE, "Device-specific error")                                                         \
  E(-321, NO_MEMORY, "Out of memory")                                                              \
  E(-350, OVERFLOW, "Queue overflow")                                                              \
  E(-363, OVERRUN, "Input buffer overrun")                                                         \
  E(-365, TIME_OUT, "Time out error")
#define SCPI_ERROR(number, IDENT, text) SCPI_##IDENT = (number),
enum scpi_error { SCPI_NO_ERROR, SCPI_ERRORS(SCPI_ERROR) };
#undef SCPI_ERROR

/* Bits of `events`, and of the conditions. */
enum {
  SCPI_EVENT_COMPLETE = 1,
  SCPI_EVENT_POWER_ON = 128,
  SCPI_OPERATION_MEASURING = 16,
};

struct scpi_register {
  uint16_t condition, event, enable;
};

struct scpi_status {
  uint16_t events, events_enable; /* *ESR? and *ESE */
  uint16_t service_enable;        /* *SRE */
  struct scpi_register operation, questionable;
  unsigned first, count; /* of errors[], a ring */
  char errors[SCPI_ERRORS_MAX][SCPI_ERROR_BYTES];
};

/* Sets a condition. Bits that were 0 and become 1 are events. */
void scpi_status_set(struct scpi_register *status, uint16_t condition);

/* Puts an error into the queue, and sets the bit of its class in `events`. field, allowed: what its
 * text says besides; or NULL. If the queue is full, its last error becomes -350. */
void scpi_status_fail(struct scpi_status *status, int number, const char *field,
                      const char *allowed);
void scpi_status_refuse(struct scpi_status *status, const wire_error *error);

/* Takes the oldest error out of the queue: its number, and its text in quotes. The text stays valid
 * until the next error. */
const char *scpi_status_take(struct scpi_status *status);

/* Returns the status byte. answers: whether an answer waits to be sent. */
unsigned scpi_status_byte(const struct scpi_status *status, bool answers);

#endif

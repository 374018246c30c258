/* answer: carries out a Modbus request on the registers of its unit, and makes the PDU of the
 * answer. It knows neither sockets nor serial lines.
 */
#ifndef DIPOLED_MODBUS_ANSWER_H
#define DIPOLED_MODBUS_ANSWER_H

#include "server/modbus/codec.h"
#include "server/modbus/unit.h"
#include "server/net/roles.h"

/* What a master may do. */
struct modbus_permissions {
  bool write;                  /* whether it may use functions that write */
  struct roles_rights *rights; /* by its certificate; NULL: nothing else limits it */
};

/* Carries out a request to the unit of this number, which is 0 if there is no such unit, and writes
 * the answer, which may be an exception. What the permissions do not allow gets exception 01, as
 * functions that write do with --modbus-read-only. pdu: the request, whose first byte is less than
 * 0x80. Returns the length of the answer. Returns 0 if the request has put a job into the batch:
 * *waits_for is then the unit, and the client's finish() has to call modbus_answer_late(). */
size_t modbus_answer(struct modbus_units *units, struct client *client,
                     const struct modbus_permissions *may, unsigned number, const uint8_t *pdu,
                     size_t bytes, uint8_t answer[MODBUS_PDU_MAX], struct modbus_unit **waits_for);

/* Makes the answer to a request whose job has been evaluated. Returns the length of the answer. */
size_t modbus_answer_late(const struct modbus_unit *unit, const uint8_t *pdu, size_t bytes,
                          uint8_t answer[MODBUS_PDU_MAX]);

/* Logs a request that was refused. Does nothing unless the answer is an exception. number: of the
 * unit, as in the request. key, from: who has asked, as "peer" and its address. */
void modbus_answer_log(const uint8_t *pdu, size_t bytes, const uint8_t *answer, unsigned number,
                       const char *key, const char *from);

#endif

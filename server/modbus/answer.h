/* answer: carries out a request on the registers of its unit, and makes the answer's PDU. It knows
 * neither sockets nor serial lines.
 */
#ifndef DIPOLED_MODBUS_ANSWER_H
#define DIPOLED_MODBUS_ANSWER_H

#include "server/modbus/codec.h"
#include "server/modbus/unit.h"

/* Carries out a request to the unit of a number (0 if there is no such unit), and writes the
 * answer, which may be an exception. `pdu` has at least 1 byte, which is less than 0x80. Returns
 * the length of the answer. Returns 0 if the request has put a job into the batch: then *waits_for
 * is the unit, and the client's finish() is called when modbus_answer_late() can make the
 * answer. */
size_t modbus_answer(struct modbus_units *units, struct client *client, unsigned number,
                     const uint8_t *pdu, size_t bytes, uint8_t answer[MODBUS_PDU_MAX],
                     struct modbus_unit **waits_for);

/* The answer to such a request; returns its length. */
size_t modbus_answer_late(const struct modbus_unit *unit, const uint8_t *pdu, size_t bytes,
                          uint8_t answer[MODBUS_PDU_MAX]);

#endif

/* reply: carries out a Modbus request on the registers of its unit, and makes the PDU of the
 * reply. It knows neither sockets nor serial lines.
 */
#ifndef DIPOLED_MODBUS_REPLY_H
#define DIPOLED_MODBUS_REPLY_H

#include "server/modbus/codec.h"
#include "server/modbus/unit.h"

/* Carries out a request to the unit of this number, which is 0 if there is no such unit, and writes
 * the reply, which may be an exception. roles: of the master (server/net/roles.h); without those that
 * a function needs, it gets exception 01. pdu: the request, whose first byte is less than 0x80. Returns the length of the reply. Returns 0 if the request has put a job into the batch:
 * *waits_for is then the unit, and the client's finish() has to call modbus_late_reply(). */
size_t modbus_carry_out(struct modbus_units *units, struct client *client, unsigned roles,
                        unsigned number, const uint8_t *pdu, size_t bytes,
                        uint8_t reply[MODBUS_PDU_MAX], struct modbus_unit **waits_for);

/* Makes the reply to a request whose job has been evaluated. Returns the length of the reply. */
size_t modbus_late_reply(struct modbus_unit *unit, const uint8_t *pdu, size_t bytes,
                         uint8_t reply[MODBUS_PDU_MAX]);

/* Logs a request that was refused. Does nothing unless the reply is an exception. number: of the
 * unit, as in the request. key, from: who has sent it, as "peer" and its address. */
void modbus_log_refusal(const uint8_t *pdu, size_t bytes, const uint8_t *reply, unsigned number,
                        const char *key, const char *from);

#endif

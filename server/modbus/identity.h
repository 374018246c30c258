/* identity: the functions that say who answers: 17 (report server id) and 43/14 (read device
 * identification).
 */
#ifndef DIPOLED_MODBUS_IDENTITY_H
#define DIPOLED_MODBUS_IDENTITY_H

#include <stddef.h>
#include <stdint.h>

/* Writes the answer's PDU (at most MODBUS_PDU_MAX bytes) and returns its length. */
size_t modbus_identity_report(unsigned unit, uint8_t *answer);

/* The same for a PDU of function 43/14, which has 4 bytes; 0: *exception says what is wrong. */
size_t modbus_identity_read(const uint8_t *pdu, uint8_t *answer, unsigned *exception);

#endif

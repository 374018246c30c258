/* rtu: frames of Modbus RTU in what arrived on a line: unit, PDU, checksum. */
#ifndef DIPOLED_MODBUS_RTU_H
#define DIPOLED_MODBUS_RTU_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { MODBUS_RTU_MIN = 4, MODBUS_RTU_MAX = 256 };

/* The checksum (CRC-16, polynomial 0xa001 reflected, from 0xffff), low byte first on the line. */
uint16_t modbus_rtu_checksum(const uint8_t *bytes, size_t count);

/* Whether the bytes are one frame. */
bool modbus_rtu_is_frame(const uint8_t *bytes, size_t count);

/* Finds the request at the end of what has arrived before a silence: for `unit`, or for all (0).
 * Before it there may be frames from and to other devices, which adapters deliver together, and
 * noise. Its length, and *begin; 0: there is none, and if *begin is count there is noise. */
size_t modbus_rtu_find(const uint8_t *bytes, size_t count, unsigned unit, size_t *begin);

#endif

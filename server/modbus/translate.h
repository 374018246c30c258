/* translate: from the input of a register map to an eval request of the binary protocol, and from
 * its reply to the output: so that both protocols are answered by the same code, with the same
 * bits.
 */
#ifndef DIPOLED_MODBUS_TRANSLATE_H
#define DIPOLED_MODBUS_TRANSLATE_H

#include "proto/eval.h"
#include "proto/registers.h"

enum {
  MODBUS_QUESTION_BYTES = (int)WIRE_BYTES_eval_request + (int)WIRE_BYTES_medium +
                          CORE_PARAMETERS_END * (int)WIRE_BYTES_parameter +
                          REGISTERS_RADII_MAX * (int)sizeof(double),
  MODBUS_REPLY_BYTES = (int)WIRE_BYTES_eval_reply + (int)WIRE_BYTES_channel +
                       2 * REGISTERS_RADII_MAX * (int)sizeof(double),
};

/* The payload of the request, at a multiple of 8; its length, at most MODBUS_QUESTION_BYTES. */
size_t modbus_translate_input(const uint16_t image[REGISTERS_END], uint8_t *question);

/* Writes the results of a reply to such a request: all of the output and the float64 block but
 * status, done, sequence and the error. */
void modbus_translate_reply(const uint8_t *question, const uint8_t *reply,
                            uint16_t image[REGISTERS_END]);

#endif

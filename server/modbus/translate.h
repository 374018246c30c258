/* translate: makes an eval request of the binary protocol from the input registers, and fills the
 * output registers from the reply. So the same code answers both protocols, with the same bits.
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
                       3 * REGISTERS_RADII_MAX * (int)sizeof(double),
};

/* Writes the payload of the request to `question`, which is at a multiple of 8. Returns the length
 * of the payload, at most MODBUS_QUESTION_BYTES. */
size_t modbus_translate_input(const uint16_t image[REGISTERS_END], uint8_t *question);

/* Writes the results of a reply into the output block and the float64 block of registers. question:
 * the request. The caller sets the registers for status, done, sequence and the error. */
void modbus_translate_reply(const uint8_t *question, const uint8_t *reply,
                            uint16_t image[REGISTERS_END]);

#endif

/* translate: for each kind of job, makes a request of the binary protocol from the input registers,
 * and fills the output registers from the reply. So the same code serves both protocols, with the
 * same bits.
 */
#ifndef DIPOLED_MODBUS_TRANSLATE_H
#define DIPOLED_MODBUS_TRANSLATE_H

#include "proto/eval.h"
#include "proto/fit.h"
#include "proto/mc.h"
#include "proto/registers.h"
#include "server/net/text.h"

/* Writes the payload of the request. Returns false if there is no memory. */
bool modbus_translate_input(enum registers_job_kind kind, const uint16_t image[REGISTERS_END],
                            struct text *payload);

/* Writes the results of a reply into the output registers, or the progress of an mc job. request:
 * the request. The caller sets the registers for status, done, sequence and the error. Returns the
 * status: DONE, UNFITTED for a fit that is no success, or ERROR if a reading is wrong; *error then
 * says which, and no results are written. */
enum registers_status modbus_translate_reply(enum registers_job_kind kind, const uint8_t *request,
                                             const uint8_t *reply, size_t reply_bytes,
                                             uint16_t image[REGISTERS_END], wire_error *error);

#endif

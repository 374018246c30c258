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

enum {
  /* Bytes of the longest request, that of the fit of a tissue, and room for parameters. */
  MODBUS_REQUEST_BYTES =
      (int)WIRE_BYTES_fit_tissue_request +
      (REGISTERS_PROPERTIES_MAX + CORE_PARAMETERS_END) * (int)WIRE_BYTES_parameter +
      REGISTERS_SOUGHT_MAX * (int)WIRE_BYTES_sought +
      (5 * REGISTERS_PLACES_MAX + REGISTERS_WAVELENGTHS_MAX + 2 * REGISTERS_TISSUE_READINGS_MAX) *
          (int)sizeof(double),
  /* Bytes of the longest reply, that of an mc: edges, photons, and R with its errors. */
  MODBUS_REPLY_BYTES =
      (int)WIRE_BYTES_mc_reply + (int)WIRE_BYTES_mc_energy +
      (REGISTERS_RADII_MAX + 1 + 3 * CORE_MC_SIDES * REGISTERS_RADII_MAX) * (int)sizeof(double),
};

/* Writes the payload of the request to `request`, which is at a multiple of 8. Returns the length
 * of the payload, at most MODBUS_REQUEST_BYTES. */
size_t modbus_translate_input(enum registers_job_kind kind, const uint16_t image[REGISTERS_END],
                              uint8_t *request);

/* Writes the results of a reply into the output registers, or the progress of an mc job. request:
 * the request. The caller sets the registers for status, done, sequence and the error. Returns the
 * status: DONE, UNFITTED for a fit that is no success, or ERROR if a reading is wrong; *error then
 * says which, and no results are written. */
enum registers_status modbus_translate_reply(enum registers_job_kind kind, const uint8_t *request,
                                             const uint8_t *reply, size_t reply_bytes,
                                             uint16_t image[REGISTERS_END], wire_error *error);

#endif

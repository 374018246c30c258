/* query: writes the media and parameters of requests. The library checks only the fields on which
 * the layout of a frame depends; the daemon checks all others. */
#ifndef LIBDIPOLE_QUERY_H
#define LIBDIPOLE_QUERY_H

#include "clients/c/dipole.h"

/* Fails if dipole_id() did not find the model. */
bool libdipole_model_check(unsigned model, dipole_error *error);

/* Checks the count and the ids of parameters. */
bool libdipole_parameters_check(const dipole_parameter *parameters, size_t count,
                                dipole_error *error);

/* These write bytes at `at` and return the address behind them. */
uint8_t *libdipole_parameters_put(uint8_t *at, const dipole_parameter *parameters, size_t count);
uint8_t *libdipole_medium_put(uint8_t *at, const dipole_medium *medium);

/* Fails unless each of several numbers fits into 16 bits. all: their bits, combined with |. names:
 * the names of the fields, for the error message. */
bool libdipole_check_u16(unsigned all, const char *names, dipole_error *error);

#endif

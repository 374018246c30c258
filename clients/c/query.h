/* query: what requests with media and parameters are made of. Only what a frame's layout depends on
 * is checked here: the daemon judges all the rest. */
#ifndef LIBDIPOLE_QUERY_H
#define LIBDIPOLE_QUERY_H

#include "clients/c/dipole.h"

/* Checks the count and the ids of parameters. */
bool libdipole_parameters_check(const dipole_parameter *parameters, size_t count,
                                dipole_error *error);

/* These write bytes at `at` and return what follows them. */
uint8_t *libdipole_parameters_put(uint8_t *at, const dipole_parameter *parameters, size_t count);
uint8_t *libdipole_medium_put(uint8_t *at, const dipole_medium *medium);

/* Fails unless all of the numbers fit into 16 bits. names: of the fields, for the error. */
bool libdipole_check_u16(unsigned all, const char *names, dipole_error *error);

#endif

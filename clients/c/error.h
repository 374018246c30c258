/* error: fills in errors. The names in libdipole's own headers start with libdipole_: the shared
 * library exports only dipole_*, and a program that links the static library is unlikely to use
 * them. */
#ifndef LIBDIPOLE_ERROR_H
#define LIBDIPOLE_ERROR_H

#include "clients/c/dipole.h"

/* All of these fill *error and return false. */
bool libdipole_fail(dipole_error *error, enum dipole_error_kind kind, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

/* number: an errno, which the text explains. what: the text before that. */
bool libdipole_fail_errno(dipole_error *error, enum dipole_error_kind kind, int number,
                          const char *what);

bool libdipole_fail_memory(dipole_error *error);

/* Kind PROTOCOL. what: ends the sentence "the peer does not speak this protocol: ...". */
bool libdipole_fail_protocol(dipole_error *error, const char *what);

/* What the payload of an error frame says. info: the daemon's lists, or empty before they are here.
 * medium_count, value_count: how many media and listed values the request has, for naming the one
 * at fault. */
bool libdipole_fail_refused(dipole_error *error, const dipole_info *info, uint32_t medium_count,
                            uint64_t value_count, const uint8_t *payload);

/* Replaces control characters and what is not UTF-8 by question marks: a peer's text may be printed
 * on a terminal. */
void libdipole_clean_text(char *text);

#endif

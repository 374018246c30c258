/* error: fills in errors. Names in the library's private headers start with libdipole_. The shared
 * library exports only dipole_*, and a program that links the static library is unlikely to have
 * its own names, which start with libdipole_. */
#ifndef LIBDIPOLE_ERROR_H
#define LIBDIPOLE_ERROR_H

#include "clients/c/dipole.h"

/* The libdipole_fail functions all fill *error and return false. */
bool libdipole_fail(dipole_error *error, enum dipole_error_kind kind, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

/* Writes the text "WHAT: REASON". number: the errno that gives the reason. */
bool libdipole_fail_errno(dipole_error *error, enum dipole_error_kind kind, int number,
                          const char *what);

/* Fails with kind ARGUMENT. Returns false. */
bool libdipole_fail_argument(dipole_error *error, const char *text);

bool libdipole_fail_memory(dipole_error *error);

/* Fails with kind PROTOCOL. what: completes "the peer does not speak this protocol: ...". */
bool libdipole_fail_protocol(dipole_error *error, const char *what);

/* Fails with kind REFUSED and what the payload of an error frame says. info: the daemon's lists,
 * which are empty before the reply to hello. medium_count, value_count: how many media and listed
 * values the request has, so that the text can say which of them is at fault. */
bool libdipole_fail_refused(dipole_error *error, const dipole_info *info, uint32_t medium_count,
                            uint32_t layer_count, uint64_t value_count, const uint8_t *payload);

/* Returns how many bytes the UTF-8 character at text has; 0 if it is not well-formed. */
size_t libdipole_character_bytes(const char *text);

/* Replaces control characters, and bytes that are not UTF-8, by question marks, so that a peer's
 * text is harmless on a terminal. */
void libdipole_clean_text(char *text);

#endif

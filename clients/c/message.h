/* message: makes requests of fields and arrays, by their names in proto/messages.def. */
#ifndef LIBDIPOLE_MESSAGE_H
#define LIBDIPOLE_MESSAGE_H

#include "clients/c/query.h"

/* A request that has been made: the structures with which it begins, and its parts. */
typedef struct libdipole_made {
  const schema_payload *payload;
  _Alignas(8) uint8_t start[256];
  const void *parts[SCHEMA_PARTS];
  uint64_t counts[SCHEMA_PARTS]; /* elements that are given */
} libdipole_made;

/* Makes a request. What is not given has its default or, of an array that is NULL, 0. Checks that
 * numbers fit into their fields, and that arrays have as many elements as the fields say. */
bool libdipole_make(libdipole_made *made, const schema_payload *payload, const dipole_field *fields,
                    size_t count, dipole_error *error);

#define LIBDIPOLE_COUNT(array) (sizeof(array) / sizeof(array)[0])

/* An array that may be NULL: its numbers are then 0. */
#define LIBDIPOLE_OR_ZEROS(name, array, number)                                                    \
  { name, .elements = array, .count = (array) != NULL ? (number) : 0 }

#endif

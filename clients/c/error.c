#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "clients/c/error.h"
#include "proto/wire.h"

bool libdipole_fail(dipole_error *error, enum dipole_error_kind kind, const char *format, ...) {
  va_list arguments;
  *error = (dipole_error){.kind = kind};
  va_start(arguments, format);
  vsnprintf(error->text, sizeof error->text, format, arguments);
  va_end(arguments);
  return false;
}

bool libdipole_fail_errno(dipole_error *error, enum dipole_error_kind kind, int number,
                          const char *what) {
  char buffer[128];
  return libdipole_fail(error, kind, "%s: %s", what, strerror_r(number, buffer, sizeof buffer));
}

bool libdipole_fail_memory(dipole_error *error) {
  return libdipole_fail(error, DIPOLE_ERROR_MEMORY, "out of memory");
}

bool libdipole_fail_protocol(dipole_error *error, const char *what) {
  return libdipole_fail(error, DIPOLE_ERROR_PROTOCOL, "the peer does not speak this protocol: %s",
                        what);
}

/* ---- refusals ------------------------------------------------------------------------------ */

_Static_assert(sizeof((dipole_error *)0)->field == sizeof((wire_error *)0)->field, "field");
_Static_assert(sizeof((dipole_error *)0)->allowed == sizeof((wire_error *)0)->allowed, "allowed");

/* Returns the daemon's name for a status, or this library's own name if the daemon's lists lack it.
 */
static const char *status_name(const dipole_info *info, unsigned status) {
  for (size_t i = 0; i < info->choice_count; i++) {
    if (info->choices[i].kind == DIPOLE_STATUS && info->choices[i].id == status) {
      return info->choices[i].name;
    }
  }
  return wire_status_name(status);
}

static bool is_medium_field(const char *field) {
#define SAME_NAME(kind, name, meaning) || strcmp(field, #name) == 0
  return false WIRE_FIELDS_medium(SAME_NAME, , );
#undef SAME_NAME
}

/* Returns whether the field is a list of numbers. */
static bool is_listed_field(const char *field) {
  return strcmp(field, "r") == 0 || strcmp(field, "u") == 0 || strcmp(field, "albedo") == 0 ||
         strcmp(field, "length") == 0;
}

/* Writes the place of the fault, counted from 1, if there are several: " of medium 2 of 3". */
static void describe_place(const wire_error *from, uint32_t medium_count, uint64_t value_count,
                           char *place, size_t bytes) {
  const unsigned long long number = from->index + 1;
  place[0] = '\0';
  if (is_medium_field(from->field) && from->index < medium_count && medium_count > 1) {
    snprintf(place, bytes, " of medium %llu of %lu", number, (unsigned long)medium_count);
  } else if (is_listed_field(from->field) && from->index < value_count && value_count > 1) {
    snprintf(place, bytes, " number %llu of %llu", number, (unsigned long long)value_count);
  }
}

/* Returns whether the daemon or the time is at fault, and not a value that the caller has chosen.
 * The text of such a status says more than the field does. */
static bool is_about_the_daemon(unsigned status) {
  return status == WIRE_STATUS_BUSY || status == WIRE_STATUS_SHUTTING_DOWN ||
         status == WIRE_STATUS_TIMEOUT || status == WIRE_STATUS_DEADLINE;
}

bool libdipole_fail_refused(dipole_error *error, const dipole_info *info, uint32_t medium_count,
                            uint64_t value_count, const uint8_t *payload) {
  wire_error from;
  char place[64];
  wire_get_error(payload, &from);
  libdipole_clean_text(from.field);
  libdipole_clean_text(from.allowed);
  const char *name = status_name(info, from.status);
  char what[192] = "", later[32] = "";
  if (from.field[0] != '\0') {
    describe_place(&from, medium_count, value_count, place, sizeof place);
    snprintf(what, sizeof what, ": %s%s: allowed: %s", from.field, place, from.allowed);
  }
  if (from.retry_after_ms > 0) {
    snprintf(later, sizeof later, " (in %lu ms)", (unsigned long)from.retry_after_ms);
  }
  if (what[0] != '\0' && !is_about_the_daemon(from.status)) {
    libdipole_fail(error, DIPOLE_ERROR_REFUSED, "%s%s", name, what);
  } else {
    libdipole_fail(error, DIPOLE_ERROR_REFUSED, "%s: %s%s%s", name, wire_status_text(from.status),
                   later, what);
  }
  error->status = from.status;
  error->index = from.index;
  error->retry_after_ms = from.retry_after_ms;
  memcpy(error->field, from.field, sizeof error->field);
  memcpy(error->allowed, from.allowed, sizeof error->allowed);
  return false;
}

/* ---- a peer's text ------------------------------------------------------------------------- */

/* Returns the number of bytes of the UTF-8 character at text, or 1 if it is not well-formed. Does
 * not reject overlong forms and surrogates, which are harmless on a terminal. */
static size_t character_bytes(const unsigned char *text) {
  const size_t bytes = text[0] >= 0xf0 ? 4 : text[0] >= 0xe0 ? 3 : text[0] >= 0xc2 ? 2 : 1;
  if (text[0] > 0xf4) {
    return 1;
  }
  for (size_t i = 1; i < bytes; i++) {
    if ((text[i] & 0xc0) != 0x80) { /* This is also true for the terminating zero. */
      return 1;
    }
  }
  return bytes;
}

/* Returns whether a character is a control character: below U+0020, or U+007F to U+009F. */
static bool is_control(const unsigned char *text, size_t bytes) {
  return bytes == 1 ? text[0] < 0x20 || text[0] == 0x7f
                    : bytes == 2 && text[0] == 0xc2 && text[1] < 0xa0;
}

void libdipole_clean_text(char *text) {
  unsigned char *at = (unsigned char *)text;
  while (*at != '\0') {
    const size_t bytes = character_bytes(at);
    if (is_control(at, bytes) || (bytes == 1 && *at >= 0x80)) {
      memset(at, '?', bytes);
    }
    at += bytes;
  }
}

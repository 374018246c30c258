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

bool libdipole_fail_argument(dipole_error *error, const char *text) {
  return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "%s", text);
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

/* Returns the daemon's name for a status, or this library's if the daemon's lists lack it. */
static const char *status_name(const dipole_info *info, unsigned status) {
  for (size_t i = 0; i < info->choice_count; i++) {
    if (info->choices[i].kind == DIPOLE_STATUS && info->choices[i].id == status) {
      return info->choices[i].name;
    }
  }
  return wire_status_of(status)->name;
}

static bool is_medium_field(const char *field) {
#define SAME_NAME(kind, name, meaning, ...) || strcmp(field, #name) == 0
  return false WIRE_FIELDS_medium(SAME_NAME, , );
#undef SAME_NAME
}

/* Returns whether the field is a list of numbers. */
static bool is_listed_field(const char *field) {
  return strcmp(field, "r") == 0 || strcmp(field, "u") == 0 || strcmp(field, "albedo") == 0 ||
         strcmp(field, "length") == 0;
}

/* Writes the place of the fault, counted from 1, if there are several: " of medium 2 of 3". */
static void describe_place(const wire_error *from, uint32_t medium_count, uint32_t layer_count,
                           uint64_t value_count, char *place, size_t bytes) {
  const unsigned long long number = from->index + 1;
  place[0] = '\0';
  if (is_medium_field(from->field) && layer_count > 1) {
    snprintf(place, bytes, " of layer %llu of medium %llu", from->index % layer_count + 1ULL,
             from->index / layer_count + 1ULL);
  } else if (is_medium_field(from->field) && from->index < medium_count && medium_count > 1) {
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
                            uint32_t layer_count, uint64_t value_count, const uint8_t *payload) {
  wire_error from;
  char place[64];
  wire_get_error(payload, &from);
  libdipole_clean_text(from.field);
  libdipole_clean_text(from.allowed);
  const char *name = status_name(info, from.status);
  char what[192] = "", later[32] = "";
  if (from.field[0] != '\0') {
    describe_place(&from, medium_count, layer_count, value_count, place, sizeof place);
    snprintf(what, sizeof what, ": %s%s: allowed: %s", from.field, place, from.allowed);
  }
  if (from.retry_after_ms > 0) {
    snprintf(later, sizeof later, " (in %lu ms)", (unsigned long)from.retry_after_ms);
  }
  if (what[0] != '\0' && !is_about_the_daemon(from.status)) {
    libdipole_fail(error, DIPOLE_ERROR_REFUSED, "%s%s", name, what);
  } else {
    libdipole_fail(error, DIPOLE_ERROR_REFUSED, "%s: %s%s%s", name,
                   wire_status_of(from.status)->text, later, what);
  }
  error->status = from.status;
  error->index = from.index;
  error->retry_after_ms = from.retry_after_ms;
  memcpy(error->field, from.field, sizeof error->field);
  memcpy(error->allowed, from.allowed, sizeof error->allowed);
  return false;
}

/* ---- a peer's text ------------------------------------------------------------------------- */

size_t libdipole_character_bytes(const char *text) {
  static const uint32_t least[] = {0, 0, 0x80, 0x800, 0x10000}; /* no overlong forms */
  const unsigned char *at = (const unsigned char *)text;
  const size_t bytes = at[0] >= 0xf0 ? 4 : at[0] >= 0xe0 ? 3 : at[0] >= 0xc0 ? 2 : 1;
  uint32_t code = bytes == 1 ? at[0] : at[0] & (0x7fU >> bytes);
  for (size_t i = 1; i < bytes; i++) {
    if ((at[i] & 0xc0) != 0x80) { /* This is also true for the terminating zero. */
      return 0;
    }
    code = code << 6 | (at[i] & 0x3fU);
  }
  const bool is_surrogate = code >> 11 == 0xd800 >> 11;
  return (bytes == 1 && code >= 0x80) || at[0] >= 0xf8 || code < least[bytes] || code > 0x10ffff ||
                 is_surrogate
             ? 0
             : bytes;
}

/* Returns whether a character is a control character: below U+0020, or U+007F to U+009F. */
static bool is_control(const unsigned char *text, size_t bytes) {
  return bytes == 1 ? text[0] < 0x20 || text[0] == 0x7f
                    : bytes == 2 && text[0] == 0xc2 && text[1] < 0xa0;
}

void libdipole_clean_text(char *text) {
  unsigned char *at = (unsigned char *)text;
  while (*at != '\0') {
    const size_t bytes = libdipole_character_bytes((const char *)at);
    const size_t replaced = bytes == 0 ? 1 : is_control(at, bytes) ? bytes : 0;
    memset(at, '?', replaced);
    at += bytes > 0 ? bytes : 1;
  }
}

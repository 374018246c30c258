#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "clients/c/client.h"

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

/* The daemon's name for a status; ours before its lists are here, or when they lack it. */
static const char *status_name(const dipole_client *client, unsigned status) {
  for (size_t i = 0; i < client->info.choice_count; i++) {
    const dipole_choice *choice = &client->info.choices[i];
    if (choice->kind == DIPOLE_STATUS && choice->id == status) {
      return choice->name;
    }
  }
  return wire_status_name(status);
}

static bool is_medium_field(const char *field) {
#define SAME_NAME(kind, name, meaning) || strcmp(field, #name) == 0
  return false WIRE_FIELDS_medium(SAME_NAME, , );
#undef SAME_NAME
}

/* Of a list of numbers. */
static bool is_listed_field(const char *field) {
  return strcmp(field, "r") == 0 || strcmp(field, "u") == 0 || strcmp(field, "albedo") == 0 ||
         strcmp(field, "length") == 0;
}

/* " of medium 2 of 3": which of several the field belongs to, counted from one. */
static void describe_place(const libdipole_pending *pending, const wire_error *from, char *place,
                           size_t bytes) {
  place[0] = '\0';
  if (pending == NULL) {
    return;
  }
  if (is_medium_field(from->field) && from->index < pending->medium_count &&
      pending->medium_count > 1) {
    snprintf(place, bytes, " of medium %llu of %lu", (unsigned long long)from->index + 1,
             (unsigned long)pending->medium_count);
  } else if (is_listed_field(from->field) && from->index < pending->radius_count &&
             pending->radius_count > 1) {
    snprintf(place, bytes, " number %llu of %llu", (unsigned long long)from->index + 1,
             (unsigned long long)pending->radius_count);
  }
}

bool libdipole_refused(const dipole_client *client, const libdipole_pending *pending,
                       const libdipole_frame *frame, dipole_error *error) {
  wire_error from;
  char place[64];
  wire_get_error(frame->payload, &from);
  libdipole_clean_text(from.field);
  libdipole_clean_text(from.allowed);
  const char *name = status_name(client, from.status);
  if (from.field[0] != '\0') {
    describe_place(pending, &from, place, sizeof place);
    libdipole_fail(error, DIPOLE_ERROR_REFUSED, "%s: %s%s: allowed: %s", name, from.field, place,
                   from.allowed);
  } else if (from.retry_after_ms > 0) {
    libdipole_fail(error, DIPOLE_ERROR_REFUSED, "%s: %s (in %lu ms)", name,
                   wire_status_text(from.status), (unsigned long)from.retry_after_ms);
  } else {
    libdipole_fail(error, DIPOLE_ERROR_REFUSED, "%s: %s", name, wire_status_text(from.status));
  }
  error->status = from.status;
  error->index = from.index;
  error->retry_after_ms = from.retry_after_ms;
  memcpy(error->field, from.field, sizeof error->field);
  memcpy(error->allowed, from.allowed, sizeof error->allowed);
  return false;
}

_Static_assert(sizeof((dipole_error *)0)->field == sizeof((wire_error *)0)->field, "field");
_Static_assert(sizeof((dipole_error *)0)->allowed == sizeof((wire_error *)0)->allowed, "allowed");

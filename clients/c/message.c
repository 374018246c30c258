#include "clients/c/message.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/c/error.h"
#include "clients/c/query.h"

/* Finds a message whose reply is one frame; NULL: there is none of this name. */
static const schema_message *find_message(const char *name) {
  for (const schema_message *one = schema_messages; one->type != 0; one++) {
    if (strcmp(one->name, name) == 0 && one->type != WIRE_TYPE_MC &&
        one->reply != &schema_nothing && schema_field_of(one->reply, "part_count") == NULL) {
      return one;
    }
  }
  return NULL;
}

static bool set_field(const schema_field *field, double number, uint8_t *at, dipole_error *error) {
  const double most = field->kind == SCHEMA_u16   ? UINT16_MAX
                      : field->kind == SCHEMA_u32 ? UINT32_MAX
                                                  : 0x1p53;
  if (field->kind != SCHEMA_f64 && !(number >= 0 && number <= most && number == floor(number))) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "%s is a whole number from 0 to %.0f",
                          field->name, most);
  }
  if (field->list != NULL && !field->bits && !field->or_zero && !(number > 0)) {
    return libdipole_fail(
        error, DIPOLE_ERROR_ARGUMENT,
        "%s is 0, which is what dipole_id() returns for a name that the daemon does "
        "not have",
        field->name);
  }
  schema_put_number(field, number, at);
  return true;
}

static bool fail_too_much(dipole_error *error) {
  return libdipole_fail_argument(error, "this is more than a frame holds: request less at a time");
}

/* Sets an array, and the field that counts its elements alone. */
static bool set_part(libdipole_made *made, unsigned index, const dipole_field *given,
                     dipole_error *error) {
  const schema_part *part = &made->payload->parts[index];
  const schema_number *count = &part->count[0];
  const bool alone = count->name != NULL && count[1].name == NULL && part->times + part->more == 0;
  if (given->elements == NULL) {
    return given->count == 0 ||
           libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "%s is NULL although its count is not 0",
                          part->name);
  }
  if (alone && count->bytes < 8 && given->count >> (8 * count->bytes) != 0) {
    return fail_too_much(error);
  }
  made->parts[index] = given->elements;
  made->counts[index] = given->count;
  memcpy(made->start + count->offset, &given->count, alone ? count->bytes : 0);
  return part->structure != &schema_structures[SCHEMA_STRUCTURE_parameter] ||
         libdipole_query_check(1, 0, given->elements, given->count, error);
}

static bool set_given(libdipole_made *made, const dipole_field *given, dipole_error *error) {
  size_t at;
  const schema_field *field = schema_field_at(made->payload, given->name, &at);
  if (field != NULL) {
    return set_field(field, given->number, made->start + at, error);
  }
  for (unsigned i = 0; made->payload->parts[i].name != NULL; i++) {
    if (strcmp(made->payload->parts[i].name, given->name) == 0) {
      return set_part(made, i, given, error);
    }
  }
  return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "%s has no %s", made->payload->name,
                        given->name);
}

/* Checks that the arrays have as many elements as the fields say. */
static bool check_counts(const libdipole_made *made, dipole_error *error) {
  schema_layout layout;
  if (!schema_lay_out(made->payload, made->start, UINT32_MAX, &layout, NULL)) {
    return fail_too_much(error);
  }
  for (unsigned i = 0; made->payload->parts[i].name != NULL; i++) {
    if (made->parts[i] != NULL && made->counts[i] != layout.parts[i].count) {
      return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                            "%s has %llu elements, where the other fields want %llu",
                            made->payload->parts[i].name, (unsigned long long)made->counts[i],
                            (unsigned long long)layout.parts[i].count);
    }
  }
  return true;
}

bool libdipole_make(libdipole_made *made, const schema_payload *payload, const dipole_field *fields,
                    size_t count, dipole_error *error) {
  *made = (libdipole_made){.payload = payload};
  uint8_t *at = made->start;
  for (int i = 0; i < 2 && payload->structures[i] != NULL; i++) {
    for (const schema_field *field = payload->structures[i]->fields; field->name != NULL; field++) {
      schema_put_number(field, field->usual, at);
      at += field->bytes;
    }
  }
  for (size_t i = 0; i < count; i++) {
    if (!set_given(made, &fields[i], error)) {
      return false;
    }
  }
  return check_counts(made, error);
}

enum { REPLY_START_MAX_BYTES = 512 };

/* The longest reply of which the daemon alone counts elements: more than its lists and tables take. */
#define UNASKED_MAX_BYTES ((uint64_t)1 << 26)

/* Sets those fields with which a reply begins that are the request's by their names. */
static void repeat_fields(const libdipole_made *made, const schema_payload *reply, uint8_t *start) {
  assert(reply->fixed_bytes <= REPLY_START_MAX_BYTES);
  for (const schema_field *field = reply->structures[0]->fields; field->name != NULL; field++) {
    size_t at;
    const schema_field *own = schema_field_at(made->payload, field->name, &at);
    if (own != NULL) {
      schema_put_number(field, schema_number_at(own, made->start + at), start);
    }
    start += field->bytes;
  }
}

static uint64_t longest_reply(const libdipole_made *made, const schema_payload *reply) {
  uint8_t start[REPLY_START_MAX_BYTES];
  memset(start, 0xff, sizeof start);
  repeat_fields(made, reply, start);
  const uint64_t bytes = schema_bytes(reply, start);
  return bytes <= UINT32_MAX ? bytes : UNASKED_MAX_BYTES;
}

/* Returns whether a reply has its length and repeats the request's fields of the same names. */
static bool is_reply_to(const libdipole_made *made, const schema_payload *reply,
                        const libdipole_frame *frame) {
  schema_layout layout;
  uint8_t start[REPLY_START_MAX_BYTES];
  memcpy(start, frame->payload, reply->fixed_bytes);
  repeat_fields(made, reply, start);
  return schema_is_whole(reply, frame->payload, frame->payload_bytes, &layout) &&
         memcmp(start, frame->payload, reply->fixed_bytes) == 0;
}

bool dipole_call(dipole_client *client, const char *message, const dipole_field *fields,
                 size_t field_count, unsigned deadline_ms, dipole_reply **reply,
                 dipole_error *error) {
  error = error != NULL ? error : &(dipole_error){0};
  const schema_message *found = find_message(message);
  if (found == NULL) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                          "%s is no message with a reply of one frame", message);
  }
  libdipole_made made;
  libdipole_pending pending = {.kind = &libdipole_plain,
                               .type = (uint16_t)found->type,
                               .deadline_ms = deadline_ms,
                               .reply_bytes_min = found->reply->fixed_bytes};
  libdipole_frame *frame = NULL;
  if (!libdipole_make(&made, found->request, fields, field_count, error)) {
    return false;
  }
  pending.reply_bytes_max = longest_reply(&made, found->reply);
  if (!libdipole_request_put(client, &pending, made.payload, made.start, made.parts, error) ||
      (frame = libdipole_reply(client, &pending, error)) == NULL) {
    return false;
  }
  if (!is_reply_to(&made, found->reply, frame)) {
    free(frame);
    return libdipole_bad_reply(client, "a reply is not that to its request", error);
  }
  frame->reply.payload = found->reply;
  *reply = &frame->reply;
  return true;
}

double dipole_reply_number(const dipole_reply *reply, const char *field) {
  const libdipole_frame *frame = (const void *)reply;
  size_t at;
  const schema_field *found = schema_field_at(reply->payload, field, &at);
  return found != NULL ? schema_number_at(found, frame->payload + at) : (double)NAN;
}

const void *dipole_reply_array(const dipole_reply *reply, const char *name, uint64_t *count) {
  const libdipole_frame *frame = (const void *)reply;
  schema_layout layout;
  schema_lay_out(reply->payload, frame->payload, UINT64_MAX, &layout, NULL);
  for (unsigned i = 0; reply->payload->parts[i].name != NULL; i++) {
    if (strcmp(reply->payload->parts[i].name, name) == 0 && layout.parts[i].count > 0) {
      *count = layout.parts[i].count;
      return frame->payload + layout.parts[i].at;
    }
  }
  *count = 0;
  return NULL;
}

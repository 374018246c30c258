#include "server/http/reply.h"

#include <assert.h>
#include <stdio.h>
#include <string.h>

#include "proto/eval.h"
#include "proto/fit.h"
#include "proto/gather.h"
#include "proto/table.h"
#include "proto/varying.h"

/* The fields of a structure, and the digits of the name of a set. */
#define FIELDS(structure) (schema_structures[SCHEMA_STRUCTURE_##structure].fields)
enum { NAME_DIGITS = 32 };

/* ---- fields ---------------------------------------------------------------------------------- */

/* Writes a choice by its name, or the names of a sum of choices. */
static void write_choice(struct text *text, const schema_field *field, unsigned number) {
  const core_choice *entry = field->bits ? NULL : core_choice_by_id(field->list, number);
  if (!field->bits) {
    http_text_string(text, field->name, entry != NULL ? entry->name : "");
    return;
  }
  http_text_begin(text, field->name, '[');
  for (entry = field->list; entry->name != NULL; entry++) {
    if ((entry->id & number) != 0) {
      http_text_string(text, NULL, entry->name);
    }
  }
  http_text_end(text, ']');
}

static void write_one(struct text *text, const char *key, enum schema_kind kind, const uint8_t *at,
                      size_t bytes) {
  if (kind == SCHEMA_f64) {
    http_text_number(text, key, schema_real_at(at, 0, false));
  } else {
    http_text_count(text, key, schema_bits_at(at, bytes));
  }
}

static void write_field(struct text *text, const schema_field *field, const uint8_t *at) {
  const size_t bytes = field->count == 1 ? field->bytes : field->bytes / field->count;
  if (field->list != NULL) {
    write_choice(text, field, (unsigned)schema_bits_at(at, bytes));
  } else if (field->kind == SCHEMA_text) {
    char string[129];
    assert(field->count < sizeof string);
    memcpy(string, at, field->count);
    string[field->count] = '\0';
    http_text_string(text, field->name, string);
  } else if (schema_is_name(field)) {
    char digits[NAME_DIGITS + 1];
    for (size_t i = 0; i < field->bytes; i++) {
      snprintf(digits + 2 * i, 3, "%02x", at[i]);
    }
    http_text_string(text, field->name, digits);
  } else if (field->count == 1) {
    write_one(text, field->name, field->kind, at, bytes);
  } else {
    http_text_begin(text, field->name, '[');
    for (unsigned i = 0; i < field->count; i++) {
      write_one(text, NULL, field->kind, at + i * bytes, bytes);
    }
    http_text_end(text, ']');
  }
}

/* Writes the fields of a structure into an open object. Returns where the structure ends. */
static const uint8_t *write_fields(struct text *text, const schema_field *fields,
                                   const uint8_t *at) {
  for (; fields->name != NULL; fields++) {
    if (!fields->hidden) {
      write_field(text, fields, at);
    }
    at += fields->bytes;
  }
  return at;
}

static const uint8_t *write_object(struct text *text, const char *key, const schema_field *fields,
                                   const uint8_t *at) {
  http_text_begin(text, key, '{');
  at = write_fields(text, fields, at);
  http_text_end(text, '}');
  return at;
}

/* Writes the units of those fields that have one. */
static void write_units(struct text *text, const schema_field *fields) {
  for (; fields->name != NULL; fields++) {
    if (fields->unit != NULL) {
      http_text_string(text, fields->name, fields->unit);
    }
  }
}

/* ---- eval and sample ------------------------------------------------------------------------- */

static void write_quantity_units(struct text *text, unsigned wanted) {
  const bool by_f = core_is_at_frequencies(wanted);
  for (const core_choice *one = core_quantities; one->name != NULL; one++) {
    if ((one->id & wanted) != 0) {
      http_text_string(text, one->name,
                       one->id == CORE_QUANTITY_R                ? WIRE_R_UNIT
                       : one->id == CORE_QUANTITY_RADIUS && by_f ? "1/mm"
                                                                 : one->about);
    }
  }
}

/* Writes a medium: the fields of its one layer, or a list of several layers. Returns the end of the
 * layers in the request. */
static const uint8_t *write_medium(struct text *text, const uint8_t *at, uint32_t layer_count) {
  if (layer_count == 1) {
    return write_fields(text, FIELDS(medium), at);
  }
  http_text_begin(text, "layers", '[');
  for (uint32_t i = 0; i < layer_count; i++) {
    at = write_object(text, NULL, FIELDS(medium), at);
  }
  http_text_end(text, ']');
  return at;
}

static void write_channel(struct text *text, const uint8_t *payload, const uint8_t *medium,
                          uint32_t layer_count, const wire_eval_reply *fixed,
                          const eval_layout *layout, uint32_t channel, unsigned wanted) {
  const bool single = core_evaluator_bytes(fixed->evaluator) == sizeof(float);
  http_text_begin(text, NULL, '{');
  write_medium(text, medium, layer_count);
  http_text_number(text, "albedo", schema_real_at(payload + eval_albedo_offset(0), channel, false));
  if ((fixed->wanted & CORE_QUANTITY_BALANCE) != 0) {
    write_object(text, "balance", FIELDS(balance),
                 payload + layout->balances_offset + channel * (size_t)WIRE_BYTES_balance);
  }
  http_text_begin(text, "errors", '{');
  for (const core_choice *one = core_quantities; one->name != NULL; one++) {
    if ((one->id & fixed->wanted & ~(unsigned)CORE_QUANTITY_MODEL_ERROR) != 0) {
      write_object(text, one->name, FIELDS(quantity_error),
                   payload + eval_error_offset(layout, wanted, channel, one->id));
    }
  }
  http_text_end(text, '}');
  for (const core_choice *one = core_quantities; one->name != NULL; one++) {
    if ((one->id & fixed->wanted) != 0 && eval_is_array(wanted, one->id)) {
      http_text_numbers(text, one->name,
                        payload + eval_array_offset(layout, wanted, channel, one->id), fixed->count,
                        single);
    }
  }
  http_text_end(text, '}');
}

/* Writes the results of an eval. media: the layers in the request. */
static void write_eval(struct text *text, const uint8_t *media, uint32_t layer_count,
                       const uint8_t *payload, size_t payload_bytes, bool drawn) {
  wire_eval_reply fixed;
  eval_layout layout;
  const bool parsed = eval_reply_parse(payload, payload_bytes, drawn, &fixed, &layout);
  assert(parsed);
  (void)parsed;
  const unsigned wanted = fixed.wanted | (drawn ? EVAL_DRAWN : 0);
  write_fields(text, FIELDS(eval_reply), payload);
  http_text_begin(text, "units", '{');
  write_units(text, FIELDS(medium));
  http_text_string(text, "numerical_error_per_mm", "1/mm");
  write_quantity_units(text, fixed.wanted);
  http_text_end(text, '}');
  if ((fixed.wanted & CORE_QUANTITY_RADIUS) != 0 && !drawn) {
    const bool single = core_evaluator_bytes(fixed.evaluator) == sizeof(float);
    http_text_begin(text, "r", '[');
    for (uint64_t i = 0; i < fixed.count; i++) {
      http_text_number(text, NULL, schema_real_at(payload + layout.radius_offset, i, single));
    }
    http_text_end(text, ']');
  }
  http_text_begin(text, "channels", '[');
  for (uint32_t i = 0; i < fixed.channel_count; i++) {
    write_channel(text, payload, media + (size_t)i * layer_count * WIRE_BYTES_medium, layer_count,
                  &fixed, &layout, i, wanted);
  }
  http_text_end(text, ']');
}

/* ---- the other replies ----------------------------------------------------------------------- */

/* Writes the parts of a reply, for messages without a function of their own here, and their units. */
static void write_parts(struct text *text, const schema_payload *reply, const uint8_t *payload) {
  schema_layout layout;
  schema_lay_out(reply, payload, UINT64_MAX, &layout, NULL);
  http_text_begin(text, "units", '{');
  write_units(text, reply->structures[0]->fields);
  for (const schema_part *part = reply->parts; part->name != NULL; part++) {
    if (part->kind == SCHEMA_LIST) {
      write_units(text, part->structure->fields);
    } else if (part->unit != NULL) {
      http_text_string(text, part->name, part->unit);
    }
  }
  http_text_end(text, '}');
  for (unsigned i = 0; reply->parts[i].name != NULL; i++) {
    const schema_part *part = &reply->parts[i];
    const uint8_t *at = payload + layout.parts[i].at;
    if (part->kind != SCHEMA_LIST) {
      http_text_numbers(text, part->name, at, layout.parts[i].count,
                        layout.parts[i].bytes == sizeof(float));
      continue;
    }
    http_text_begin(text, part->name, '[');
    for (uint64_t n = 0; n < layout.parts[i].count; n++) {
      at = write_object(text, NULL, part->structure->fields, at);
    }
    http_text_end(text, ']');
  }
}

static void write_table(struct text *text, const uint8_t *payload) {
  wire_table_reply fixed;
  wire_get_table_reply(payload, &fixed);
  const uint8_t *at = write_fields(text, FIELDS(table_reply), payload);
  at = write_medium(text, at, fixed.layer_count);
  http_text_begin(text, "units", '{');
  write_units(text, FIELDS(medium));
  write_units(text, FIELDS(table_reply));
  http_text_end(text, '}');
  http_text_begin(text, "parameters", '{');
  for (unsigned i = 0; i < fixed.parameter_count; i++, at += WIRE_BYTES_parameter) {
    wire_parameter parameter;
    wire_get_parameter(at, &parameter);
    http_text_number(text, core_choice_by_id(core_parameter_list, parameter.parameter)->name,
                     parameter.value);
  }
  http_text_end(text, '}');
  http_text_begin(text, "words", '[');
  for (uint32_t i = 0; i < fixed.word_count; i++) {
    http_text_count(text, NULL, schema_bits_at(at + i * sizeof(uint32_t), sizeof(uint32_t)));
  }
  http_text_end(text, ']');
}

/* The design says what was assumed of the media. */
static void write_fit(struct text *text, const uint8_t *design, bool g_is_default,
                      const uint8_t *payload) {
  wire_fit_reply fixed;
  wire_fit_design assumed;
  wire_get_fit_design(design, &assumed);
  http_text_number(text, "g", assumed.g);
  http_text_raw(text, "g_is_default", g_is_default ? "true" : "false");
  http_text_number(text, "eta", assumed.eta);
  wire_get_fit_reply(payload, &fixed);
  const uint8_t *at = write_fields(text, FIELDS(fit_reply), payload);
  const uint8_t *residuals = payload + fit_residuals_offset(fixed.count);
  http_text_begin(text, "units", '{');
  write_units(text, FIELDS(fitted));
  http_text_end(text, '}');
  http_text_begin(text, "sets", '[');
  for (uint64_t i = 0; i < fixed.count; i++) {
    http_text_begin(text, NULL, '{');
    at = write_fields(text, FIELDS(fitted), at);
    if (fixed.reading_count > 0) {
      http_text_numbers(text, "residuals", residuals + i * fixed.reading_count * sizeof(double),
                        fixed.reading_count, false);
    }
    http_text_end(text, '}');
  }
  http_text_end(text, ']');
}

/* Writes those arrays of a varying reply that are in a list, whose bits are moved left. */
static void write_arrays(struct text *text, const core_choice *list, unsigned left,
                         const uint8_t *payload, const wire_varying_reply *fixed,
                         const varying_layout *layout) {
  for (const core_choice *one = list; one->name != NULL; one++) {
    const uint32_t array = (uint32_t)one->id << left;
    if ((layout->arrays & array) != 0) {
      http_text_numbers(text, one->name, payload + varying_array_offset(layout, array),
                        fixed->count, core_evaluator_bytes(fixed->evaluator) == sizeof(float));
    }
  }
}

static void write_varying(struct text *text, const uint8_t *payload, size_t payload_bytes) {
  wire_varying_reply fixed;
  varying_layout layout;
  const bool parsed = varying_reply_parse(payload, payload_bytes, &fixed, &layout);
  assert(parsed);
  (void)parsed;
  write_fields(text, FIELDS(varying_reply), payload);
  http_text_begin(text, "units", '{');
  for (const core_choice *one = core_coefficients; one->name != NULL; one++) {
    if ((one->id & fixed.coefficients) != 0) {
      http_text_string(text, one->name, one->id == CORE_COEFFICIENT_SCATTERED ? "1" : "1/mm");
    }
  }
  write_quantity_units(text, fixed.wanted);
  http_text_end(text, '}');
  write_arrays(text, core_coefficients, 0, payload, &fixed, &layout);
  write_arrays(text, core_quantities, VARYING_QUANTITY_SHIFT, payload, &fixed, &layout);
  http_text_begin(text, "statuses", '[');
  for (uint64_t i = 0; i < fixed.count; i++) {
    http_text_string(
        text, NULL,
        core_choice_by_id(core_value_statuses, payload[layout.status_offset + i])->name);
  }
  http_text_end(text, ']');
}

/* Writes the results of a gather. media: the layers in the request. */
static void write_gather(struct text *text, const uint8_t *media, uint32_t layer_count,
                         const uint8_t *payload) {
  wire_gather_reply fixed;
  wire_get_gather_reply(payload, &fixed);
  const uint8_t *sums = payload + gather_sums_offset(fixed.channel_count);
  write_fields(text, FIELDS(gather_reply), payload);
  http_text_begin(text, "units", '{');
  write_units(text, FIELDS(medium));
  http_text_string(text, "M", "W/mm^2");
  http_text_end(text, '}');
  http_text_begin(text, "channels", '[');
  for (uint32_t channel = 0; channel < fixed.channel_count; channel++) {
    http_text_begin(text, NULL, '{');
    write_medium(text, media + (size_t)channel * layer_count * WIRE_BYTES_medium, layer_count);
    write_fields(text, FIELDS(quantity_error),
                 payload + WIRE_BYTES_gather_reply + channel * (size_t)WIRE_BYTES_quantity_error);
    http_text_begin(text, "M", '[');
    for (uint64_t i = 0; i < fixed.count; i++) {
      http_text_number(text, NULL, schema_real_at(sums, i * fixed.channel_count + channel, false));
    }
    http_text_end(text, ']');
    http_text_end(text, '}');
  }
  http_text_end(text, ']');
}

/* Returns the number of layers of each medium of a request. */
static uint32_t layers_of(const schema_message *message, const uint8_t *request) {
  uint16_t count;
  memcpy(&count, request + message->request->parts[0].count[0].offset, sizeof count);
  return count;
}

void http_reply_write(const schema_message *message, const uint8_t *request, bool g_is_default,
                      const uint8_t *payload, size_t payload_bytes, struct text *text) {
  const uint8_t *media = request + message->request->fixed_bytes;
  http_text_begin(text, NULL, '{');
  switch (message->type) {
  case WIRE_TYPE_EVAL:
    write_eval(text, media, layers_of(message, request), payload, payload_bytes, false);
    break;
  case WIRE_TYPE_SAMPLE:
    write_eval(text, media, layers_of(message, request), payload, payload_bytes, true);
    break;
  case WIRE_TYPE_FIT:
    write_fit(text, request + WIRE_BYTES_fit_request, g_is_default, payload);
    break;
  case WIRE_TYPE_TABLE:
    write_table(text, payload);
    break;
  case WIRE_TYPE_VARYING:
    write_varying(text, payload, payload_bytes);
    break;
  case WIRE_TYPE_GATHER:
    write_gather(text, media, layers_of(message, request), payload);
    break;
  default:
    write_fields(text, message->reply->structures[0]->fields, payload);
    if (message->reply->parts[0].name != NULL) {
      write_parts(text, message->reply, payload);
    }
  }
  http_text_end(text, '}');
}

/* ---- lists ----------------------------------------------------------------------------------- */

/* The names of the lists of choices, in the order of their kinds. */
static const char *const list_names[] = {
#define WIRE_LIST(kind, IDENT, name, plural, list) [kind] = plural,
#include "proto/messages.def"
};

void http_reply_write_models(const uint8_t *payload, struct text *text) {
  wire_hello_reply fixed;
  unsigned kind = 0;
  wire_get_hello_reply(payload, &fixed);
  http_text_begin(text, NULL, '{');
  const uint8_t *at = write_fields(text, FIELDS(hello_reply), payload);
  for (uint32_t i = 0; i < fixed.choice_count; i++, at += WIRE_BYTES_choice) {
    wire_choice choice;
    wire_get_choice(at, &choice);
    if (choice.kind != kind) {
      if (kind > 0) {
        http_text_end(text, ']');
      }
      kind = choice.kind;
      assert(kind < sizeof list_names / sizeof list_names[0] && list_names[kind] != NULL);
      http_text_begin(text, list_names[kind], '[');
    }
    http_text_begin(text, NULL, '{');
    http_text_count(text, "id", choice.id);
    http_text_string(text, "name", choice.name);
    http_text_string(text, "about", choice.about);
    http_text_end(text, '}');
  }
  http_text_end(text, ']');
  http_text_begin(text, "limits", '{');
  for (uint32_t i = 0; i < fixed.limit_count; i++, at += WIRE_BYTES_value) {
    wire_value value;
    wire_get_value(at, &value);
    http_text_count(text, value.name, value.value);
  }
  http_text_end(text, '}');
  http_text_end(text, '}');
}

void http_reply_write_media(const uint8_t *payload, struct text *text) {
  http_text_begin(text, NULL, '{');
  write_parts(text, &schema_media_reply, payload);
  http_text_end(text, '}');
}

/* ---- errors ---------------------------------------------------------------------------------- */

/* Writes what is allowed. Where the protocol's message hello lists it, HTTP has a path. */
static void write_allowed(struct text *text, const char *allowed) {
  static const char in_hello[] = "the list in hello";
  char here[sizeof((wire_error *)NULL)->allowed];
  const size_t length = strlen(allowed), end = strlen(in_hello);
  const bool listed = length >= end && strcmp(allowed + length - end, in_hello) == 0;
  snprintf(here, sizeof here, "%.*s%s", (int)(listed ? length - end : length), allowed,
           listed ? "/v1/models" : "");
  http_text_string(text, "allowed", here);
}

unsigned http_reply_write_error(const wire_error *error, struct text *text) {
  http_text_begin(text, NULL, '{');
  http_text_string(text, "status", wire_status_of(error->status)->name);
  http_text_string(text, "text", wire_status_of(error->status)->text);
  http_text_string(text, "field", error->field);
  write_allowed(text, error->allowed);
  http_text_count(text, "index", error->index);
  http_text_count(text, "retry_after_ms", error->retry_after_ms);
  http_text_end(text, '}');
  return wire_status_of(error->status)->http;
}

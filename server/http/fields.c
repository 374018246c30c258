#include "server/http/fields.h"

#include <limits.h>
#include <string.h>

#define FIELD(field, of, values, about)                                                            \
  {.name = field, .kind = HTTP_##of, .count = values, .meaning = about},
#define ONE(kind, field, meaning) FIELD(#field, kind, 1, meaning)
#define ARRAY(kind, field, count, meaning) FIELD(#field, kind, count, meaning)
#define TEXT(field, bytes, meaning) FIELD(#field, text, bytes, meaning)
#define WIRE_STRUCTURE(structure)                                                                  \
  struct http_field http_fields_of_##structure[] = {                                               \
      WIRE_FIELDS_##structure(ONE, ARRAY, TEXT){.name = NULL}};
#include "proto/messages.def"

const struct http_message http_messages[] = {
    {WIRE_TYPE_EVAL,
     "Evaluates a model for media at radii",
     {http_fields_of_eval_request},
     http_fields_of_eval_reply,
     UINT_MAX,
     true,
     CORE_QUANTITY_RADIUS | CORE_QUANTITY_R | CORE_QUANTITY_ALBEDO,
     {{"r", "radius_count", "spacing", "mm; the radii, with spacing list", HTTP_GIVEN}}},
    {WIRE_TYPE_OFFERS,
     "Lists the models that could answer an eval with a tolerance",
     {http_fields_of_eval_request},
     http_fields_of_offers_reply,
     UINT_MAX,
     true,
     CORE_QUANTITY_R,
     {{"r", "radius_count", "spacing", "mm; the radii, with spacing list", HTTP_GIVEN}}},
    {WIRE_TYPE_SAMPLE,
     "Draws radii in proportion to the light that leaves there",
     {http_fields_of_sample_request},
     http_fields_of_eval_reply,
     UINT_MAX,
     true,
     CORE_QUANTITY_RADIUS,
     {{"u", "sample_count", "draw", "the numbers from 0 to 1, with draw list", HTTP_GIVEN}}},
    {WIRE_TYPE_INVERT,
     "Finds the media that have given albedos and lengths",
     {http_fields_of_invert_request},
     http_fields_of_invert_reply,
     0,
     false,
     0,
     {{"albedo", "medium_count", NULL, "diffuse albedos, 0 to 1", HTTP_GIVEN},
      {"length", "medium_count", NULL, "mm; lengths, as `given` says, 1e-14 to 1e14", HTTP_GIVEN}}},
    {WIRE_TYPE_TABLE,
     "Makes the table of a medium, to be evaluated at home",
     {http_fields_of_table_request},
     http_fields_of_table_reply,
     1,
     true,
     0,
     {{0}}},
    {WIRE_TYPE_FIT,
     "Finds the coefficients of media from readings",
     {http_fields_of_fit_request, http_fields_of_fit_design},
     http_fields_of_fit_reply,
     0,
     true,
     0,
     {{"at", "reading_count", NULL, "mm, or 1/mm; where the readings were taken", HTTP_GIVEN},
      {"source", "reading_count", NULL, "mm; diameters of the light; else 0", HTTP_ZEROS},
      {"detector", "reading_count", NULL, "mm; diameters of the detector; else 0", HTTP_ZEROS},
      {"values", "set_count", NULL, "the readings, or a list of them for each set", HTTP_SETS},
      {"errors", "set_count", NULL, "their standard errors, in the same form", HTTP_SETS}}},
    {WIRE_TYPE_VARYING,
     "Evaluates values each of which has a medium of its own",
     {http_fields_of_varying_request},
     http_fields_of_varying_reply,
     0,
     true,
     0,
     {{"sigma_a", "value_count", NULL, "1/mm; or one for all values", HTTP_EACH},
      {"sigma_s", "value_count", NULL, "1/mm; or one for all values", HTTP_EACH},
      {"colour", "value_count", NULL, "in place of sigma_a: diffuse albedos, 0 to 1", HTTP_EACH},
      {"length", "value_count", NULL, "mm; in place of sigma_s: lengths, as `given` says",
       HTTP_EACH},
      {"r", "value_count", NULL, "mm; the radii", HTTP_EACH},
      {"u", "value_count", NULL, "in place of r: numbers from 0 to 1, for which radii are drawn",
       HTTP_EACH}}},
    {WIRE_TYPE_POINTS,
     "Sends a set of points that hold power, which gathers name",
     {http_fields_of_points_request},
     http_fields_of_points_reply,
     0,
     false,
     0,
     {{"x", "point_count", NULL, "mm; or one for all points", HTTP_AXIS},
      {"y", "point_count", NULL, "mm; or one for all points", HTTP_AXIS},
      {"z", "point_count", NULL, "mm; or one for all points", HTTP_AXIS},
      {"power", "channel_count", NULL, "W; the powers, or a list of them for each channel",
       HTTP_SETS}}},
    {WIRE_TYPE_GATHER,
     "Sums the light of a set of points at positions",
     {http_fields_of_gather_request},
     http_fields_of_gather_reply,
     UINT_MAX,
     true,
     0,
     {{"x", "query_count", NULL, "mm; or one for all positions", HTTP_AXIS},
      {"y", "query_count", NULL, "mm; or one for all positions", HTTP_AXIS},
      {"z", "query_count", NULL, "mm; or one for all positions", HTTP_AXIS}}},
    {0, NULL, {NULL}, NULL, 0, false, 0, {{NULL, NULL, NULL, NULL, HTTP_GIVEN}}},
};

/* ---- completing the structures --------------------------------------------------------------- */

static size_t bytes_of(enum http_kind kind) {
  static const size_t bytes[] = {[HTTP_u16] = WIRE_SIZE_u16,
                                 [HTTP_u32] = WIRE_SIZE_u32,
                                 [HTTP_u64] = WIRE_SIZE_u64,
                                 [HTTP_f64] = WIRE_SIZE_f64,
                                 [HTTP_text] = 1};
  return bytes[kind];
}

static void find_choices(struct http_field *field) {
  static const struct {
    const char *field;
    const core_choice *list;
    bool bits;
  } lists[] = {
      {"model", core_models, false},
      {"evaluator", core_evaluators, false},
      {"moments", core_moments_list, false},
      {"spacing", core_spacings, false},
      {"draw", core_draws, false},
      {"given", core_lengths, false},
      {"axis", core_fit_axes, false},
      {"scale", core_fit_scales, false},
      {"status", core_fit_statuses, false},
      {"wanted", core_quantities, true},
      {"notes", core_notes, true},
      {"light", core_lights, false},
      {"coefficients", core_coefficients, true},
  };
  for (size_t i = 0; i < sizeof lists / sizeof lists[0]; i++) {
    if (strcmp(lists[i].field, field->name) == 0) {
      field->bits = lists[i].bits;
      field->choices = lists[i].list;
    }
  }
}

static const char *unit_of(const struct http_field *field) {
  static const char *const units[] = {"1/mm", "mm", "ns"};
  for (size_t i = 0; i < sizeof units / sizeof units[0]; i++) {
    const size_t length = strlen(units[i]);
    if (strncmp(field->meaning, units[i], length) == 0 &&
        (field->meaning[length] == ';' || field->meaning[length] == ' ')) {
      return units[i];
    }
  }
  return NULL;
}

static bool is_internal(const char *field) {
  static const char *const names[] = {
      "zero",       "zero_too",    "medium_count",  "part",         "parameter_count",
      "part_count", "first",       "channel_count", "choice_count", "limit_count",
      "numbers",    "point_first", "part_points",   "point_next"};
  for (size_t i = 0; i < sizeof names / sizeof names[0]; i++) {
    if (strcmp(names[i], field) == 0) {
      return true;
    }
  }
  return false;
}

static void complete(struct http_field *fields) {
  for (; fields->name != NULL; fields++) {
    fields->key = http_key_of(fields->name);
    fields->bytes = bytes_of(fields->kind) * fields->count;
    fields->internal = is_internal(fields->name);
    fields->unit = unit_of(fields);
    find_choices(fields);
  }
}

void http_fields_init(void) {
#define WIRE_STRUCTURE(name) complete(http_fields_of_##name);
#include "proto/messages.def"
}

const struct http_field *http_field_of(const struct http_message *message, const char *name) {
  for (int i = 0; i < HTTP_STRUCTURES && message->request[i] != NULL; i++) {
    for (const struct http_field *field = message->request[i]; field->name != NULL; field++) {
      if (!field->internal && strcmp(field->name, name) == 0) {
        return field;
      }
    }
  }
  return NULL;
}

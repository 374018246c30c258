#include "server/http/question.h"

#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/channels.h"
#include "proto/gather.h"
#include "proto/varying.h"

/* As in all clients. */
#define USUAL_ETA 1.3

WIRE_COLD static wire_error bad(const char *field, const char *allowed) {
  return wire_error_make(WIRE_STATUS_BAD_VALUE, field, allowed);
}

/* ---- the payload ----------------------------------------------------------------------------- */

const schema_part *http_question_list(const schema_payload *request, unsigned index,
                                      const char **name) {
  static const char *const axes[] = {"x", "y", "z"};
  for (const schema_part *part = request->parts; part->name != NULL; part++) {
    const bool positions = part->form == SCHEMA_POSITIONS;
    const unsigned names = part->about == NULL || part->kind == SCHEMA_LIST ? 0 : positions ? 3 : 1;
    if (index < names) {
      *name = positions ? axes[index] : part->name;
      return part;
    }
    index -= names;
  }
  return NULL;
}

unsigned http_question_media(const schema_payload *request) {
  return request->structures[1] == &schema_structures[SCHEMA_STRUCTURE_medium] ? 1
         : request->parts[0].name != NULL && strcmp(request->parts[0].name, "medium") == 0
             ? UINT_MAX
             : 0;
}

const schema_field *http_question_fields(const schema_payload *request, unsigned index) {
  const schema_structure *structure = index < 2 ? request->structures[index] : NULL;
  return structure != NULL && structure != &schema_structures[SCHEMA_STRUCTURE_medium]
             ? structure->fields
             : NULL;
}

bool http_question_has_parameters(const schema_payload *request) {
  return schema_field_of(request, "parameter_count") != NULL;
}

struct question {
  const schema_message *message;
  const struct http_values *values;
  struct http_text *payload;
  size_t bytes_max; /* of the payload */
  uint32_t medium_count;
  uint32_t parameter_count;
  bool g_is_default;
  wire_error error; /* what is wrong, after a function has returned false */
};

WIRE_COLD static bool fail(struct question *q, wire_error error) {
  q->error = error;
  return false;
}

/* The fault is that of an element of a list. */
WIRE_COLD static bool fail_at(struct question *q, wire_error error, size_t index) {
  error.index = index;
  return fail(q, error);
}

/* Returns whether a value could be read. */
static bool was_read(struct question *q, wire_error error) {
  return error.status == WIRE_STATUS_OK || fail(q, error);
}

static wire_error not_a_number(const char *field) {
  return bad(field, "a number, with a point as in 0.05 (0,05 is two), or inf or -inf");
}

static struct http_value get(const struct question *q, const char *name) {
  return http_values_get(q->values, name);
}

/* Writes a number of so many bytes, the lowest first. */
static void put_le(uint8_t *at, uint64_t number, size_t bytes) {
  for (size_t i = 0; i < bytes; i++) {
    at[i] = (uint8_t)(number >> (8 * i));
  }
}

/* Adds bytes, which start as 0, to the payload. On failure returns NULL. */
static uint8_t *add(struct question *q, size_t bytes) {
  if (bytes > q->bytes_max - q->payload->count) {
    fail(q, wire_error_make(WIRE_STATUS_TOO_LARGE, "body",
                            "over HTTP as many values as a frame of max_part_bytes holds"));
    return NULL;
  }
  char *at = http_text_room(q->payload, bytes);
  if (at == NULL) {
    fail(q, wire_error_busy("max_total_bytes", "less data at a time: max_total_bytes are in use",
                            1000));
    return NULL;
  }
  memset(at, 0, bytes);
  q->payload->count += bytes;
  return (uint8_t *)at;
}

static bool add_medium(struct question *q, const wire_medium *medium) {
  if (q->medium_count == http_question_media(q->message->request)) {
    return fail(q, wire_error_make(WIRE_STATUS_BAD_COUNT, "medium",
                                   "one medium: a measured one has three, so give coefficients"));
  }
  uint8_t *at = add(q, WIRE_BYTES_medium);
  if (at == NULL) {
    return false;
  }
  wire_put_medium(at, medium);
  q->medium_count++;
  return true;
}

static bool add_measured(struct question *q, const char *name, size_t index) {
  const core_measured_medium *measured = core_measured_medium_by_name(name);
  bool good =
      measured != NULL || fail_at(q, bad("medium", "a name of /v1/media, or coefficients"), index);
  for (int i = 0; good && i < 3; i++) {
    const core_medium *from = &measured->channel[i];
    const wire_medium medium = {from->sigma_a_per_mm, from->sigma_s_per_mm, from->g, from->eta};
    good = add_medium(q, &medium);
  }
  return good;
}

/* The coefficients of a medium, in the order of their fields. */
enum { COEFFICIENTS = 4 };
static const schema_payload medium_alone = {
    .structures = {&schema_structures[SCHEMA_STRUCTURE_medium]}};
#define medium_fields (schema_structures[SCHEMA_STRUCTURE_medium].fields)

static wire_error eta_of_fit(void) {
  return bad("eta", "a number: the index inside over outside, which has no default in a fit");
}

/* Reads coefficients, the next element of each. */
static bool read_coefficients(struct question *q, struct http_elements elements[COEFFICIENTS],
                              size_t index, wire_medium *medium) {
  double *const to[COEFFICIENTS] = {&medium->sigma_a, &medium->sigma_s, &medium->g, &medium->eta};
  for (int i = 0; i < COEFFICIENTS; i++) {
    const char *name = medium_fields[i].name;
    if (!http_value_given(elements[i].list)) {
      if (to[i] == &medium->sigma_a || to[i] == &medium->sigma_s) {
        return fail_at(
            q, bad(name, "a number: a medium needs sigma_a and sigma_s, or a name as medium"),
            index);
      }
      if (to[i] == &medium->eta && isnan(medium->eta)) {
        return fail_at(q, eta_of_fit(), index);
      }
    } else if (!http_elements_number(&elements[i], to[i])) {
      return fail_at(q, not_a_number(name), index);
    }
  }
  return true;
}

static void find_coefficients(const struct http_values *values,
                              struct http_elements elements[COEFFICIENTS]) {
  for (int i = 0; i < COEFFICIENTS; i++) {
    elements[i] = http_elements_of(http_values_get(values, medium_fields[i].name));
  }
}

static bool is_coefficient(const void *context, const char *name) {
  const struct http_values *values = context;
  for (int i = 0; i < COEFFICIENTS; i++) {
    if (http_values_same(name, medium_fields[i].name)) {
      return !json_is_array(http_values_get(values, name).json);
    }
  }
  return false;
}

/* Reads a medium from an object with its coefficients. usual_eta: NAN if there is none. */
static bool read_medium(struct question *q, const char *field, struct http_value value,
                        size_t index, double usual_eta, wire_medium *medium) {
  struct http_values values;
  struct http_elements elements[COEFFICIENTS];
  if (!http_values_of_object(&values, value)) {
    return fail_at(q, bad(field, "names of /v1/media, or objects of coefficients"), index);
  }
  if (http_values_unknown(&values, is_coefficient, &values) != NULL) {
    return fail_at(q, bad(field, "objects of sigma_a, sigma_s, g and eta, each one number"), index);
  }
  *medium = (wire_medium){.eta = usual_eta};
  find_coefficients(&values, elements);
  return read_coefficients(q, elements, index, medium);
}

/* Writes the known medium of a fit, which has one with scale `reference` alone. */
static bool add_reference(struct question *q) {
  const struct http_value object = get(q, "reference"), scale = get(q, "scale");
  uint64_t id = 0;
  if (q->message->type != WIRE_TYPE_FIT) {
    return true;
  }
  if (http_value_given(scale) &&
      !was_read(q, http_value_read_choice(scale, "scale", core_fit_scales, false, &id))) {
    return false;
  }
  if ((id == CORE_FIT_SCALE_REFERENCE) != json_is_object(object.json)) {
    return fail(q,
                bad("reference", "with scale reference an object of coefficients, else nothing"));
  }
  if (!http_value_given(object)) {
    return true;
  }
  wire_medium medium;
  if (!read_medium(q, "reference", object, 0, (double)NAN, &medium)) {
    return false;
  }
  uint8_t *at = add(q, WIRE_BYTES_medium);
  if (at == NULL) {
    return false;
  }
  wire_put_medium(at, &medium);
  return true;
}

/* Reads lists of coefficients. A list of one holds for all media. */
static bool add_lists(struct question *q) {
  struct http_elements elements[COEFFICIENTS];
  size_t count = 1;
  bool good = true;
  find_coefficients(q->values, elements);
  for (int i = 0; i < COEFFICIENTS; i++) {
    const size_t length = http_value_count(elements[i].list);
    if (length == 0 || (count > 1 && length > 1 && length != count)) {
      return fail(q, wire_error_make(WIRE_STATUS_BAD_COUNT, medium_fields[i].name,
                                     "one value, or as many as the others"));
    }
    count = length > count ? length : count;
  }
  for (size_t i = 0; good && i < count; i++) {
    wire_medium medium = {.eta = USUAL_ETA};
    good = read_coefficients(q, elements, i, &medium) && add_medium(q, &medium);
  }
  return good;
}

static bool add_named_media(struct question *q, struct http_value media) {
  struct http_elements elements = http_elements_of(media);
  const size_t count = http_value_count(media);
  bool good = true;
  for (size_t i = 0; good && i < count; i++) {
    const struct http_value item = http_elements_next(&elements);
    const char *name = http_value_text(item);
    wire_medium medium;
    good = name != NULL
               ? add_measured(q, name, i)
               : read_medium(q, "medium", item, i, USUAL_ETA, &medium) && add_medium(q, &medium);
  }
  return good;
}

static bool add_media(struct question *q) {
  const struct http_value media = get(q, "medium");
  if (http_question_media(q->message->request) == 0) {
    return true;
  }
  if (!http_value_given(media)) {
    return add_lists(q);
  }
  for (int i = 0; i < COEFFICIENTS; i++) {
    if (http_value_given(get(q, medium_fields[i].name))) {
      return fail(q, bad(medium_fields[i].name, "nothing beside medium"));
    }
  }
  return add_named_media(q, media);
}

/* The models whose names a parameter takes, besides their ids. */
static const core_choice *choices_of_parameter(unsigned id) {
  return id == CORE_PARAMETER_FIT_MODEL ? core_models
         : id == CORE_PARAMETER_PHASE   ? core_phases
                                        : NULL;
}

/* Returns a request's field that JSON has, or NULL. */
static const schema_field *shown_field(const schema_message *message, const char *name) {
  const schema_field *field;
  for (unsigned i = 0; (field = http_question_fields(message->request, i)) != NULL; i++) {
    for (; field->name != NULL; field++) {
      if (!field->hidden && http_values_same(field->name, name)) {
        return field;
      }
    }
  }
  return NULL;
}

static bool add_parameters(struct question *q) {
  for (const core_choice *one = core_parameter_list; one->name != NULL; one++) {
    const struct http_value value = get(q, one->name);
    wire_parameter parameter = {.parameter = (uint16_t)one->id};
    const core_choice *list = choices_of_parameter(one->id);
    if (!http_value_given(value) || !http_question_has_parameters(q->message->request) ||
        shown_field(q->message, one->name) != NULL) {
      continue;
    }
    uint64_t id = 0;
    const bool named = list != NULL && http_value_text(value) != NULL;
    if (named && !was_read(q, http_value_read_choice(value, one->name, list, false, &id))) {
      return false;
    }
    if (!named && !http_value_number(value, &parameter.value)) {
      return fail(q, not_a_number(one->name));
    }
    parameter.value = list != NULL && id > 0 ? (double)id : parameter.value;
    uint8_t *at = add(q, WIRE_BYTES_parameter);
    if (at == NULL) {
      return false;
    }
    wire_put_parameter(at, &parameter);
    q->parameter_count++;
  }
  return true;
}

/* Writes a number in single precision. Returns false if it is too large or too small for it. */
static bool put_single(uint8_t *at, double number) {
  const float single = (float)number;
  memcpy(at, &single, sizeof single);
  return isfinite(single) == isfinite(number) && (single != 0) == (number != 0);
}

/* Writes `count` numbers: those of a list, or its only one again and again. */
static bool add_numbers(struct question *q, const char *name, struct http_value list, size_t count,
                        bool single) {
  const size_t bytes = single ? sizeof(float) : sizeof(double);
  struct http_elements elements = http_elements_of(list);
  uint8_t *at = add(q, (size_t)wire_padded(count * bytes));
  if (at == NULL) {
    return false;
  }
  for (size_t i = 0; i < count; i++, at += bytes) {
    double number;
    bool good = http_elements_number(&elements, &number);
    if (good && single) {
      good = put_single(at, number);
    } else if (good) {
      memcpy(at, &number, sizeof number);
    }
    if (!good) {
      return fail_at(q,
                     isnan(number) ? not_a_number(name)
                                   : bad(name, "1e-45 to 3.4e38, 0 or inf: single precision; "
                                               "f64 has more"),
                     i);
    }
  }
  return true;
}

/* Returns whether a list of readings is one of JSON, with a list for each set. */
static bool is_nested(struct http_value list) {
  return json_is_array(json_array_get(list.json, 0));
}

/* Returns how many sets of readings a list has. */
static size_t sets_of(struct http_value list) {
  return is_nested(list) ? http_value_count(list) : 1;
}

/* Writes the readings of all sets, each as many as `count`. */
static bool add_sets(struct question *q, const char *name, struct http_value list, size_t count) {
  const size_t sets = sets_of(list);
  bool good = true;
  for (size_t i = 0; good && i < sets; i++) {
    const struct http_value set =
        is_nested(list) ? (struct http_value){.json = json_array_get(list.json, i)} : list;
    good = http_value_count(set) == count
               ? add_numbers(q, name, set, count, false)
               : fail(q, wire_error_make(WIRE_STATUS_BAD_COUNT, name,
                                         "as many in each set as in `at`"));
  }
  return good;
}

/* ---- the fixed part -------------------------------------------------------------------------- */

/* Returns the list that another field can replace by a rule, if this field says so or counts it; NULL
 * if there is none. */
static const schema_part *ruled_list(const schema_message *message, const char *field) {
  const char *name;
  const schema_part *part;
  for (unsigned i = 0; (part = http_question_list(message->request, i, &name)) != NULL; i++) {
    if (part->form == SCHEMA_GIVEN && part->when.name != NULL &&
        (http_values_same(part->when.name, field) ||
         http_values_same(part->count[0].name, field))) {
      return part;
    }
  }
  return NULL;
}

/* Returns whether the media of a varying request are given by colours. */
static bool is_coloured(const struct question *q) {
  return http_value_given(get(q, "colour"));
}

/* Returns what the third array of a varying request holds. */
static enum varying_numbers numbers_of(const struct question *q) {
  return http_value_given(get(q, "r"))   ? VARYING_RADII
         : http_value_given(get(q, "u")) ? VARYING_DRAWN
                                         : VARYING_NONE;
}

static bool is_gather(const struct question *q) {
  return q->message->type == WIRE_TYPE_GATHER;
}

/* Returns whether the usual evaluator is the table: for transport, named or not, where the table can
 * be as exact as the tolerance. */
static bool is_tabled(const struct question *q) {
  const struct http_value model = get(q, "model");
  uint64_t id = CORE_MODEL_TRANSPORT;
  double tolerance;
  http_value_number(get(q, "tolerance"), &tolerance); /* NaN if it is not given */
  if (http_value_given(model)) {
    http_value_read_choice(model, "model", core_models, false, &id); /* one at fault is refused */
  }
  return id == CORE_MODEL_TRANSPORT && !(tolerance < CORE_LUT_TOLERANCE_MIN);
}

/* Returns whether the request leaves the choice of the model to its tolerance. */
static bool chooses_by_tolerance(const struct question *q) {
  return q->message->type == WIRE_TYPE_OFFERS ||
         (q->message->type == WIRE_TYPE_EVAL && http_value_given(get(q, "tolerance")));
}

/* What holds for the quantities and coefficients of a varying request that leaves them out. */
static unsigned usual_of_varying(const struct question *q, const char *field) {
  static const unsigned quantities[VARYING_NUMBERS] = {
      [VARYING_RADII] = CORE_QUANTITY_R, [VARYING_DRAWN] = CORE_QUANTITY_RADIUS};
  const enum varying_numbers numbers = numbers_of(q);
  return http_values_same(field, "wanted") ? quantities[numbers]
         : is_coloured(q) && numbers == VARYING_NONE
             ? (unsigned)CORE_COEFFICIENT_SIGMA_A | (unsigned)CORE_COEFFICIENT_SIGMA_S
             : 0;
}

/* What holds for a choice that the request leaves out, where it depends on others. */
static unsigned usual_choice(const struct question *q, const schema_field *field) {
  const bool varying = q->message->type == WIRE_TYPE_VARYING;
  const schema_part *list = ruled_list(q->message, field->name);
  if (list != NULL && http_value_given(get(q, list->name))) {
    return (unsigned)list->is;
  }
  if (varying && field->bits) {
    return usual_of_varying(q, field->name);
  }
  if ((varying && field->or_zero && !is_coloured(q)) ||
      (http_values_same(field->name, "model") && chooses_by_tolerance(q))) {
    return 0;
  }
  if (field->bits && q->message->type == WIRE_TYPE_OFFERS) {
    return CORE_QUANTITY_R;
  }
  return http_values_same(field->name, "evaluator") && !varying && is_tabled(q)
             ? CORE_EVALUATOR_LUT
             : (unsigned)field->usual;
}

static bool read_choice(struct question *q, const schema_field *field, uint64_t *number) {
  const struct http_value value = get(q, field->name);
  const schema_part *list = ruled_list(q->message, field->name);
  if (http_value_given(value)) {
    return was_read(q,
                    http_value_read_choice(value, field->name, field->list, field->bits, number)) &&
           (list == NULL || !http_value_given(get(q, list->name)) || *number == list->is ||
            fail(q, bad(field->name, "list, beside a list of numbers")));
  }
  *number = usual_choice(q, field);
  return *number != 0 || field->or_zero || field->bits ||
         fail(q, wire_error_not_in_list(field->name, field->list, "one of"));
}

/* Reads a number that is no choice and no count of an array. */
static bool read_plain(struct question *q, const schema_field *field, uint64_t *number) {
  static const uint64_t most[] = {
      [SCHEMA_u16] = UINT16_MAX, [SCHEMA_u32] = UINT32_MAX, [SCHEMA_u64] = UINT64_MAX};
  const struct http_value value = get(q, field->name);
  double real = field->usual;
  bool good = true;
  if (field->kind != SCHEMA_f64) {
    *number = (uint64_t)real;
    return !http_value_given(value) ||
           was_read(q, http_value_read_count(value, field->name, most[field->kind], number));
  }
  if (http_value_given(value)) {
    good = http_value_number(value, &real) || fail(q, not_a_number(field->name));
  } else if (field->required) {
    return fail(q, eta_of_fit());
  } else {
    q->g_is_default |= http_values_same(field->name, "g");
  }
  memcpy(number, &real, sizeof real);
  return good;
}

/* Returns the length of the longest list that is given, of those that may be one number for all. */
static size_t longest(const struct question *q) {
  const char *name;
  const schema_part *part;
  size_t count = 0;
  for (unsigned i = 0; (part = http_question_list(q->message->request, i, &name)) != NULL; i++) {
    const bool counts = part->form == SCHEMA_EACH || part->form == SCHEMA_POSITIONS;
    const struct http_value value = get(q, name);
    const size_t length = counts && http_value_given(value) ? http_value_count(value) : 0;
    count = length > count ? length : count;
  }
  return count;
}

/* Returns a number that JSON does not have: it counts elements that follow, or is 0. */
static uint64_t counted(const struct question *q, const schema_field *field) {
  for (const schema_part *part = q->message->request->parts; part->name != NULL; part++) {
    const char *first = part->count[0].name, *second = part->count[1].name;
    if ((first == NULL || !http_values_same(first, field->name)) &&
        (second == NULL || !http_values_same(second, field->name))) {
      continue;
    }
    const struct http_value list = get(q, part->name);
    return part->form == SCHEMA_EACH || part->form == SCHEMA_POSITIONS  ? longest(q)
           : part->form == SCHEMA_CHANNELS || part->form == SCHEMA_SETS ? sets_of(list)
           : part->kind != SCHEMA_LIST && http_value_given(list)        ? http_value_count(list)
           : http_values_same(part->name, "medium")                     ? q->medium_count
           : http_values_same(part->name, "parameter")                  ? q->parameter_count
                                                                        : 0;
  }
  return http_values_same(field->name, "numbers")       ? numbers_of(q)
         : http_values_same(field->name, "point_count") ? longest(q)
                                                        : 0;
}

static bool read_field(struct question *q, const schema_field *field, uint64_t *number) {
  if (field->list != NULL) {
    const bool read = read_choice(q, field, number);
    const unsigned type = q->message->type;
    if (http_values_same(field->name, "wanted") && *number != 0 &&
        (type == WIRE_TYPE_EVAL || type == WIRE_TYPE_SAMPLE || type == WIRE_TYPE_VARYING)) {
      *number |= CORE_QUANTITY_MODEL_ERROR; /* always, as in Python */
    }
    return read;
  }
  if (field->hidden) {
    *number = counted(q, field);
    return true;
  }
  const schema_part *list = ruled_list(q->message, field->name);
  const struct http_value values = get(q, list != NULL ? list->name : "");
  if (http_value_given(values)) {
    *number = http_value_count(values);
    return !http_value_given(get(q, field->name)) ||
           fail(q, bad(field->name, "nothing beside the list that it counts"));
  }
  return read_plain(q, field, number);
}

enum { NAME_DIGITS = 32 };

/* Reads the name of a set, which a request that sends the points may leave out. */
static bool put_name(struct question *q, const schema_field *field, uint8_t *at) {
  const struct http_value value = get(q, field->name);
  const char *digits = http_value_given(value) ? http_value_text(value) : "";
  const size_t count = digits != NULL ? strlen(digits) : 0;
  if (!http_value_given(value) && !is_gather(q)) {
    return true;
  }
  if (count != NAME_DIGITS || strspn(digits, "0123456789abcdef") != count) {
    return fail(q, bad(field->name, "32 hexadecimal digits: the `set` of /v1/points"));
  }
  for (size_t i = 0; i < schema_field_bytes(field); i++) {
    const char pair[3] = {digits[2 * i], digits[2 * i + 1], '\0'};
    at[i] = (uint8_t)strtoul(pair, NULL, 16);
  }
  return true;
}

/* Writes a structure of the fixed part at *offset, which it moves. Sets *single to whether the
 * evaluator has single precision. */
static bool put_fixed(struct question *q, const schema_field *fields, size_t *offset,
                      bool *single) {
  for (const schema_field *field = fields; field->name != NULL; field++) {
    uint64_t number = 0;
    uint8_t *at = (uint8_t *)q->payload->bytes + *offset;
    if (!(schema_is_name(field) ? put_name(q, field, at) : read_field(q, field, &number))) {
      return false;
    }
    if (!schema_is_name(field)) {
      put_le(at, number, schema_field_bytes(field));
    }
    *offset += schema_field_bytes(field);
    if (http_values_same(field->name, "evaluator")) {
      *single = core_evaluator_bytes((unsigned)number) == sizeof(float);
    }
  }
  return true;
}

/* ---- all of it ------------------------------------------------------------------------------- */

static bool is_known(const void *context, const char *key) {
  const schema_message *message = context;
  const char *name;
  for (unsigned i = 0; http_question_list(message->request, i, &name) != NULL; i++) {
    if (http_values_same(name, key)) {
      return true;
    }
  }
  const bool media = http_question_media(message->request) > 0;
  return shown_field(message, key) != NULL || strcmp(key, "deadline_ms") == 0 ||
         (media && (strcmp(key, "medium") == 0 || schema_field_of(&medium_alone, key) != NULL)) ||
         (message->type == WIRE_TYPE_FIT && strcmp(key, "reference") == 0) ||
         (http_question_has_parameters(message->request) &&
          core_choice_by_name(core_parameter_list, key) != NULL);
}

/* Returns whether an error can name a key: a short text of printable ASCII. */
static bool can_be_named(const char *key) {
  size_t length = 0;
  while (key[length] > ' ' && key[length] <= '~') {
    length++;
  }
  return key[length] == '\0' && length > 0 && length < sizeof((wire_error *)NULL)->field;
}

static bool check_keys(struct question *q) {
  const char *key = http_values_unknown(q->values, is_known, q->message);
  return key == NULL || fail(q, bad(can_be_named(key) ? key : "body",
                                    "only fields that /v1/openapi.json lists for this request"));
}

/* Checks that a varying request has one pair of lists for its media, and at most one list of
 * numbers. */
static bool check_pairs(struct question *q) {
  const bool coloured = is_coloured(q) || http_value_given(get(q, "length"));
  const char *const wanted[] = {coloured ? "colour" : "sigma_a", coloured ? "length" : "sigma_s"};
  const char *const others[] = {coloured ? "sigma_a" : "given", coloured ? "sigma_s" : "light"};
  for (int i = 0; i < 2; i++) {
    if (http_value_given(get(q, others[i]))) {
      return fail(q, bad(others[i], coloured ? "nothing beside colour and length"
                                             : "nothing beside sigma_a and sigma_s"));
    }
    if (!http_value_given(get(q, wanted[i]))) {
      return fail(q, bad(wanted[i], "numbers: give sigma_a and sigma_s, or colour and length"));
    }
  }
  return !http_value_given(get(q, "r")) || !http_value_given(get(q, "u")) ||
         fail(q, bad("u", "nothing beside r"));
}

static bool add_each(struct question *q, const char *name, struct http_value value, bool single) {
  const size_t count = longest(q);
  if (!http_value_given(value)) {
    return true;
  }
  return http_value_count(value) == count || http_value_count(value) == 1
             ? add_numbers(q, name, value, count, single)
             : fail(q, wire_error_make(WIRE_STATUS_BAD_COUNT, name,
                                       "one value, or as many as the others"));
}

static bool add_list(struct question *q, const schema_part *list, bool single) {
  const char *first_name;
  const struct http_value value = get(q, list->name);
  http_question_list(q->message->request, 0, &first_name);
  const struct http_value first = get(q, first_name);
  const size_t count = http_value_given(first) ? http_value_count(first) : 0;
  if (!http_value_given(value) && list->form == SCHEMA_ZEROS) {
    return add(q, count * sizeof(double)) != NULL;
  }
  if (list->form == SCHEMA_EACH) {
    return add_each(q, list->name, value, single);
  }
  if (!http_value_given(value)) {
    return list->when.name != NULL || fail(q, bad(list->name, "a list: it has to be given"));
  }
  if (list->form == SCHEMA_SETS) {
    return add_sets(q, list->name, value, count);
  }
  return http_value_count(value) == count
             ? add_numbers(q, list->name, value, count, single)
             : fail(q, wire_error_make(WIRE_STATUS_BAD_COUNT, list->name,
                                       "as many as in the other list"));
}

/* Writes the coordinates of positions. */
static bool add_positions(struct question *q) {
  const size_t count = longest(q);
  uint8_t *all = add(q, count * GATHER_AXES * sizeof(double));
  if (all == NULL) {
    return false;
  }
  for (unsigned axis = 0; axis < GATHER_AXES; axis++) {
    const char *name;
    http_question_list(q->message->request, axis, &name);
    const struct http_value value = get(q, name);
    struct http_elements elements = http_elements_of(value);
    if (!http_value_given(value)) {
      return fail(q, bad(name, "numbers, or one for all: it has to be given"));
    }
    if (http_value_count(value) != count && http_value_count(value) != 1) {
      return fail(
          q, wire_error_make(WIRE_STATUS_BAD_COUNT, name, "one value, or as many as the others"));
    }
    for (size_t i = 0; i < count; i++) {
      double number;
      if (!http_elements_number(&elements, &number)) {
        return fail_at(q, not_a_number(name), i);
      }
      memcpy(all + (i * GATHER_AXES + axis) * sizeof number, &number, sizeof number);
    }
  }
  return true;
}

/* Writes the powers of points: those of all channels of the first point, and so on. */
static bool add_powers(struct question *q, const char *name, struct http_value list) {
  const size_t count = longest(q), channels = sets_of(list);
  uint8_t *all = add(q, (size_t)wire_padded(count * channels * sizeof(float)));
  if (all == NULL) {
    return false;
  }
  for (size_t c = 0; c < channels; c++) {
    const struct http_value set =
        is_nested(list) ? (struct http_value){.json = json_array_get(list.json, c)} : list;
    struct http_elements elements = http_elements_of(set);
    if (http_value_count(set) != count && http_value_count(set) != 1) {
      return fail(q, wire_error_make(WIRE_STATUS_BAD_COUNT, name,
                                     "one value in each channel, or as many as points"));
    }
    for (size_t i = 0; i < count; i++) {
      double number;
      if (!http_elements_number(&elements, &number)) {
        return fail_at(q, not_a_number(name), i);
      }
      const float single = (float)number;
      memcpy(all + (i * channels + c) * sizeof single, &single, sizeof single);
    }
  }
  return true;
}

/* Names the set that is written, unless the request does. */
static bool name_points(struct question *q) {
  wire_points_request fixed;
  uint8_t *at = (uint8_t *)q->payload->bytes;
  wire_get_points_request(at, &fixed);
  if (!http_value_given(get(q, "set"))) {
    const uint8_t *xyz = at + WIRE_BYTES_points_request;
    const uint8_t *power = xyz + fixed.point_count * GATHER_AXES * sizeof(double);
    gather_name name;
    gather_name_start(&name, fixed.channel_count, fixed.point_count);
    gather_name_add(&name, fixed.point_count, (const double *)(const void *)xyz,
                    (const float *)(const void *)power);
    gather_name_end(&name, fixed.set);
    wire_put_points_request(at, &fixed);
  }
  return true;
}

static bool add_points(struct question *q) {
  const struct http_value power = get(q, "power");
  if (!http_value_given(power)) {
    return fail(q, bad("power", "numbers: it has to be given"));
  }
  _Static_assert(CORE_GATHER_CHANNELS_MAX == 8, "the error says so");
  return (sets_of(power) <= CORE_GATHER_CHANNELS_MAX ||
          fail(q, wire_error_make(WIRE_STATUS_BAD_COUNT, "channel_count", "1 to 8"))) &&
         add_positions(q) && add_powers(q, "power", power) && name_points(q);
}

static bool add_all_lists(struct question *q, bool single) {
  const char *name;
  const schema_part *part = http_question_list(q->message->request, 0, &name);
  if (part != NULL && part->form == SCHEMA_POSITIONS) {
    return q->message->type == WIRE_TYPE_POINTS ? add_points(q) : add_positions(q);
  }
  bool good = true;
  for (unsigned i = 0; good && (part = http_question_list(q->message->request, i, &name)) != NULL;
       i++) {
    good = add_list(q, part, single && part->kind == SCHEMA_REAL);
  }
  return good;
}

static bool read_deadline(struct question *q, uint32_t *deadline_ms) {
  const struct http_value value = get(q, "deadline_ms");
  uint64_t limit_ms = 0;
  const bool good = !http_value_given(value) ||
                    was_read(q, http_value_read_count(value, "deadline_ms", UINT32_MAX, &limit_ms));
  *deadline_ms = (uint32_t)limit_ms;
  return good;
}

/* Writes the whole payload. */
static bool put_all(struct question *q, uint32_t *deadline_ms) {
  const schema_payload *request = q->message->request;
  const size_t medium_bytes = http_question_media(request) == 1 ? WIRE_BYTES_medium : 0;
  const schema_field *fields;
  size_t offset = 0;
  bool single = false;
  bool good = check_keys(q) && read_deadline(q, deadline_ms) &&
              (q->message->type != WIRE_TYPE_VARYING || check_pairs(q)) &&
              add(q, request->fixed_bytes - medium_bytes) != NULL && add_media(q) &&
              add_parameters(q) && add_reference(q);
  for (unsigned i = 0; good && (fields = http_question_fields(request, i)) != NULL; i++) {
    good = put_fixed(q, fields, &offset, &single);
  }
  return good && add_all_lists(q, single);
}

wire_error http_question_translate(const schema_message *message, const struct http_values *values,
                                   struct http_text *payload, size_t bytes_max,
                                   uint32_t *deadline_ms, bool *g_is_default) {
  struct question q = {
      .message = message, .values = values, .payload = payload, .bytes_max = bytes_max};
  *deadline_ms = 0;
  const bool good = put_all(&q, deadline_ms);
  *g_is_default = q.g_is_default;
  return good ? wire_error_none() : q.error;
}

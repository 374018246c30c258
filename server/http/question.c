#include "server/http/question.h"

#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "proto/channels.h"
#include "proto/varying.h"

#define USUAL_ETA 1.3 /* as in all clients */

static wire_error bad(const char *field, const char *allowed) {
  return wire_error_make(WIRE_STATUS_BAD_VALUE, field, allowed);
}

static wire_error no_memory(void) {
  return wire_error_busy("max_total_bytes", "less at a time: max_total_bytes are in use", 1000);
}

static bool is_good(const wire_error *error) {
  return error->status == WIRE_STATUS_OK;
}

/* ---- the payload ----------------------------------------------------------------------------- */

struct question {
  const struct http_message *message;
  const struct http_values *values;
  struct http_text *payload;
  uint32_t medium_count;
  uint32_t parameter_count;
};

static struct http_value get(const struct question *q, const char *name) {
  return http_values_get(q->values, name);
}

/* Writes a number of so many bytes, the lowest first. */
static void put_le(uint8_t *at, uint64_t number, size_t bytes) {
  for (size_t i = 0; i < bytes; i++) {
    at[i] = (uint8_t)(number >> (8 * i));
  }
}

/* Adds bytes, which start as 0, to the payload. Returns NULL if there is no memory. */
static uint8_t *add(const struct question *q, size_t bytes) {
  char *at = http_text_room(q->payload, bytes);
  if (at != NULL) {
    memset(at, 0, bytes);
    q->payload->count += bytes;
  }
  return (uint8_t *)at;
}

static wire_error add_medium(struct question *q, const wire_medium *medium) {
  if (q->medium_count == q->message->media_most) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, "medium",
                           "one medium: a measured one has three, so give coefficients");
  }
  uint8_t *at = add(q, WIRE_BYTES_medium);
  if (at == NULL) {
    return no_memory();
  }
  wire_put_medium(at, medium);
  q->medium_count++;
  return wire_error_none();
}

static wire_error add_measured(struct question *q, const char *name) {
  const core_measured_medium *measured = core_measured_medium_by_name(name);
  wire_error error =
      measured != NULL ? wire_error_none() : bad("medium", "a name of /v1/media, or coefficients");
  for (int i = 0; is_good(&error) && i < 3; i++) {
    const core_medium *from = &measured->channel[i];
    const wire_medium medium = {from->sigma_a_per_mm, from->sigma_s_per_mm, from->g, from->eta};
    error = add_medium(q, &medium);
  }
  return error;
}

/* The coefficients of a medium, in the order of their fields. */
enum { COEFFICIENTS = 4 };

/* Reads coefficients, the next element of each. */
static wire_error read_coefficients(struct http_elements elements[COEFFICIENTS], size_t index,
                                    wire_medium *medium) {
  double *const to[COEFFICIENTS] = {&medium->sigma_a, &medium->sigma_s, &medium->g, &medium->eta};
  wire_error error = wire_error_none();
  for (int i = 0; is_good(&error) && i < COEFFICIENTS; i++) {
    const char *name = http_fields_of_medium[i].name;
    if (http_value_given(elements[i].list)) {
      error = http_value_read_number(http_elements_next(&elements[i]), name, to[i]);
      error.index = index;
    } else if (to[i] == &medium->sigma_a || to[i] == &medium->sigma_s) {
      error = bad(name, "a number: a medium needs sigma_a and sigma_s");
    }
  }
  return error;
}

static void find_coefficients(const struct http_values *values,
                              struct http_elements elements[COEFFICIENTS]) {
  for (int i = 0; i < COEFFICIENTS; i++) {
    elements[i] = http_elements_of(http_values_get(values, http_fields_of_medium[i].name));
  }
}

static bool is_coefficient(const void *context, const char *name) {
  const struct http_values *values = context;
  for (int i = 0; i < COEFFICIENTS; i++) {
    if (http_values_same(name, http_fields_of_medium[i].name)) {
      return !json_is_array(http_values_get(values, name).json);
    }
  }
  return false;
}

/* Reads a medium from an object with its coefficients. */
static wire_error read_medium(const char *field, struct http_value value, wire_medium *medium) {
  struct http_values values;
  struct http_elements elements[COEFFICIENTS];
  if (!http_values_of_object(&values, value)) {
    return bad(field, "names of /v1/media, or objects of coefficients");
  }
  if (http_values_unknown(&values, is_coefficient, &values) != NULL) {
    return bad(field, "objects of sigma_a, sigma_s, g and eta, each one number");
  }
  *medium = (wire_medium){.eta = USUAL_ETA};
  find_coefficients(&values, elements);
  return read_coefficients(elements, 0, medium);
}

/* Writes the known medium of a fit, which has one with scale `reference` alone. */
static wire_error add_reference(const struct question *q) {
  const struct http_value object = get(q, "reference"), scale = get(q, "scale");
  uint64_t id = 0;
  if (q->message->type != WIRE_TYPE_FIT) {
    return wire_error_none();
  }
  wire_error error = http_value_given(scale)
                         ? http_value_read_choice(scale, "scale", core_fit_scales, false, &id)
                         : wire_error_none();
  if (is_good(&error) && (id == CORE_FIT_SCALE_REFERENCE) != json_is_object(object.json)) {
    error = bad("reference", "with scale reference an object of coefficients, else nothing");
  }
  if (!is_good(&error) || !http_value_given(object)) {
    return error;
  }
  wire_medium medium;
  error = read_medium("reference", object, &medium);
  uint8_t *at = is_good(&error) ? add(q, WIRE_BYTES_medium) : NULL;
  if (at != NULL) {
    wire_put_medium(at, &medium);
  }
  return at == NULL && is_good(&error) ? no_memory() : error;
}

/* Reads lists of coefficients. A list of one holds for all media. */
static wire_error add_lists(struct question *q) {
  struct http_elements elements[COEFFICIENTS];
  size_t count = 1;
  wire_error error = wire_error_none();
  find_coefficients(q->values, elements);
  for (int i = 0; i < COEFFICIENTS; i++) {
    const size_t length = http_value_count(elements[i].list);
    if (length == 0 || (count > 1 && length > 1 && length != count)) {
      return wire_error_make(WIRE_STATUS_BAD_COUNT, http_fields_of_medium[i].name,
                             "one value, or as many as the others");
    }
    count = length > count ? length : count;
  }
  for (size_t i = 0; is_good(&error) && i < count; i++) {
    wire_medium medium = {.eta = USUAL_ETA};
    error = read_coefficients(elements, i, &medium);
    error = is_good(&error) ? add_medium(q, &medium) : error;
  }
  return error;
}

static wire_error add_named_media(struct question *q, struct http_value media) {
  struct http_elements elements = http_elements_of(media);
  const size_t count = http_value_count(media);
  wire_error error = wire_error_none();
  for (size_t i = 0; is_good(&error) && i < count; i++) {
    const struct http_value item = http_elements_next(&elements);
    const char *name = http_value_text(item);
    wire_medium medium;
    if (name != NULL) {
      error = add_measured(q, name);
      continue;
    }
    error = read_medium("medium", item, &medium);
    error = is_good(&error) ? add_medium(q, &medium) : error;
  }
  return error;
}

static wire_error add_media(struct question *q) {
  const struct http_value media = get(q, "medium");
  if (q->message->media_most == 0) {
    return wire_error_none();
  }
  if (!http_value_given(media)) {
    return add_lists(q);
  }
  for (int i = 0; i < COEFFICIENTS; i++) {
    if (http_value_given(get(q, http_fields_of_medium[i].name))) {
      return bad(http_fields_of_medium[i].name, "nothing beside medium");
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

static wire_error add_parameters(struct question *q) {
  for (const core_choice *one = core_parameter_list; one->name != NULL; one++) {
    const struct http_value value = get(q, one->name);
    wire_parameter parameter = {.parameter = (uint16_t)one->id};
    const core_choice *list = choices_of_parameter(one->id);
    if (!http_value_given(value) || !q->message->parameters) {
      continue;
    }
    uint64_t id = 0;
    wire_error error = list != NULL && http_value_text(value) != NULL
                           ? http_value_read_choice(value, one->name, list, false, &id)
                           : http_value_read_number(value, one->name, &parameter.value);
    if (!is_good(&error)) {
      return error;
    }
    parameter.value = list != NULL && id > 0 ? (double)id : parameter.value;
    uint8_t *at = add(q, WIRE_BYTES_parameter);
    if (at == NULL) {
      return no_memory();
    }
    wire_put_parameter(at, &parameter);
    q->parameter_count++;
  }
  return wire_error_none();
}

/* Writes a number in single precision. Returns false if it is too large or too small for it. */
static bool put_single(uint8_t *at, double number) {
  const float single = (float)number;
  memcpy(at, &single, sizeof single);
  return isfinite(single) == isfinite(number) && (single != 0) == (number != 0);
}

/* Writes `count` numbers: those of a list, or its only one again and again. */
static wire_error add_numbers(const struct question *q, const char *name, struct http_value list,
                              size_t count, bool single) {
  const size_t bytes = single ? sizeof(float) : sizeof(double);
  struct http_elements elements = http_elements_of(list);
  uint8_t *at = add(q, (size_t)wire_padded(count * bytes));
  if (at == NULL) {
    return no_memory();
  }
  for (size_t i = 0; i < count; i++, at += bytes) {
    const struct http_value value = http_elements_next(&elements);
    double number;
    bool good = http_value_number(value, &number);
    if (good && single) {
      good = put_single(at, number);
    } else if (good) {
      memcpy(at, &number, sizeof number);
    }
    if (!good) {
      wire_error error = http_value_read_number(value, name, &number);
      error = is_good(&error)
                  ? bad(name, "1e-45 to 3.4e38, 0 or inf: single precision; f64 has more")
                  : error;
      error.index = i;
      return error;
    }
  }
  return wire_error_none();
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
static wire_error add_sets(const struct question *q, const char *name, struct http_value list,
                           size_t count) {
  const size_t sets = sets_of(list);
  wire_error error = wire_error_none();
  for (size_t i = 0; is_good(&error) && i < sets; i++) {
    const struct http_value set =
        is_nested(list) ? (struct http_value){.json = json_array_get(list.json, i)} : list;
    error = http_value_count(set) == count
                ? add_numbers(q, name, set, count, false)
                : wire_error_make(WIRE_STATUS_BAD_COUNT, name, "as many in each set as in `at`");
  }
  return error;
}

/* ---- the fixed part -------------------------------------------------------------------------- */

/* Returns the list that a field counts or whose rule the field is; NULL if there is none. */
static const struct http_list *list_of(const struct http_message *message, const char *field) {
  for (int i = 0; i < HTTP_LISTS && message->lists[i].name != NULL; i++) {
    const struct http_list *list = &message->lists[i];
    if (http_values_same(list->count, field) || (list->rule != NULL && http_values_same(list->rule, field))) {
      return list;
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

/* What holds for a choice that the request leaves out, as of the command line: transport by table
 * unless a model or a tolerance is given. "": none, and the field is 0. */
static const char *usual_choice(const struct question *q, const char *field) {
  const struct http_list *list = list_of(q->message, field);
  const bool named = http_value_given(get(q, "model"));
  if (list != NULL) {
    return http_value_given(get(q, list->name)) || strcmp(field, "draw") != 0 ? "list" : "random";
  }
  if (q->message->type == WIRE_TYPE_VARYING) { /* as in Python */
    const char *usual = strcmp(field, "evaluator") == 0 ? "f32"
                        : strcmp(field, "given") == 0   ? "mean-free-path"
                        : strcmp(field, "light") == 0   ? "beam"
                                                        : NULL;
    if (usual != NULL) {
      return strcmp(field, "evaluator") == 0 || is_coloured(q) ? usual : "";
    }
  }
  return strcmp(field, "model") == 0       ? "transport"
         : strcmp(field, "evaluator") == 0 ? (named ? "f64" : "lut")
         : strcmp(field, "moments") == 0   ? "exact"
         : strcmp(field, "axis") == 0      ? "r"
         : strcmp(field, "scale") == 0     ? "absolute"
                                           : NULL;
}

/* What holds for a sum of choices that the request leaves out: names with commas between them. */
static const char *usual_choices(const struct question *q, const char *field) {
  static const char *const quantities[VARYING_NUMBERS] = {
      [VARYING_NONE] = "", [VARYING_RADII] = "R", [VARYING_DRAWN] = "r"};
  if (q->message->type != WIRE_TYPE_VARYING) {
    return q->message->wanted;
  }
  const enum varying_numbers numbers = numbers_of(q);
  return strcmp(field, "wanted") == 0                ? quantities[numbers]
         : is_coloured(q) && numbers == VARYING_NONE ? "sigma_a,sigma_s"
                                                     : "";
}

/* Returns whether the request leaves the choice of the model to its tolerance. */
static bool chooses_by_tolerance(const struct question *q) {
  return q->message->request[0] == http_fields_of_eval_request &&
         (q->message->type == WIRE_TYPE_OFFERS || http_value_given(get(q, "tolerance")));
}

static wire_error read_choice(const struct question *q, const struct http_field *field,
                              uint64_t *number) {
  const struct http_value value = get(q, field->name);
  if (http_value_given(value)) {
    return http_value_read_choice(value, field->name, field->choices, field->bits, number);
  }
  if (strcmp(field->name, "model") == 0 && chooses_by_tolerance(q)) {
    *number = 0;
    return wire_error_none();
  }
  if (field->bits) {
    char names[64], *rest = names, *name;
    snprintf(names, sizeof names, "%s", usual_choices(q, field->name));
    while ((name = strsep(&rest, ",")) != NULL && name[0] != '\0') {
      *number |= core_choice_by_name(field->choices, name)->id;
    }
    return wire_error_none();
  }
  const char *usual = usual_choice(q, field->name);
  if (usual == NULL) {
    return wire_error_not_in_list(field->name, field->choices, "one of");
  }
  *number = usual[0] != '\0' ? core_choice_by_name(field->choices, usual)->id : 0;
  return wire_error_none();
}

/* Reads a number that is no choice and no count of an array. One that is not given is 0. */
static wire_error read_plain(const struct question *q, const struct http_field *field,
                             uint64_t *number) {
  static const uint64_t most[] = {
      [HTTP_u16] = UINT16_MAX, [HTTP_u32] = UINT32_MAX, [HTTP_u64] = UINT64_MAX};
  const struct http_value value = get(q, field->name);
  double real = strcmp(field->name, "eta") == 0 ? USUAL_ETA : 0;
  if (!http_value_given(value)) {
    memcpy(number, &real, sizeof real); /* 0 has the same bits in every kind */
    return wire_error_none();
  }
  if (field->kind != HTTP_f64) {
    return http_value_read_count(value, field->name, most[field->kind], number);
  }
  const wire_error error = http_value_read_number(value, field->name, &real);
  memcpy(number, &real, sizeof real);
  return error;
}

/* Returns the length of the longest list that is given. */
static size_t longest(const struct question *q) {
  size_t count = 0;
  for (int i = 0; i < HTTP_LISTS && q->message->lists[i].name != NULL; i++) {
    const struct http_value value = get(q, q->message->lists[i].name);
    const size_t length = http_value_given(value) ? http_value_count(value) : 0;
    count = length > count ? length : count;
  }
  return count;
}

static wire_error read_field(const struct question *q, const struct http_field *field,
                             uint64_t *number) {
  if (field->choices != NULL) {
    return read_choice(q, field, number);
  }
  const struct http_list *list = list_of(q->message, field->name);
  const struct http_value values = get(q, list != NULL ? list->name : "");
  if (list != NULL && list->kind == HTTP_EACH) {
    *number = longest(q);
    return wire_error_none();
  }
  if (list != NULL && http_value_given(values)) {
    *number = list->kind == HTTP_SETS ? sets_of(values) : http_value_count(values);
    return !http_value_given(get(q, field->name))
               ? wire_error_none()
               : bad(field->name, "nothing beside the list that it counts");
  }
  if (list == NULL && field->internal) {
    *number = strcmp(field->name, "medium_count") == 0      ? q->medium_count
              : strcmp(field->name, "parameter_count") == 0 ? q->parameter_count
              : strcmp(field->name, "numbers") == 0         ? numbers_of(q)
                                                            : 0;
    return wire_error_none();
  }
  return read_plain(q, field, number);
}

static size_t bytes_of(const struct http_message *message) {
  size_t bytes = 0;
  for (int i = 0; i < HTTP_STRUCTURES && message->request[i] != NULL; i++) {
    for (const struct http_field *field = message->request[i]; field->name != NULL; field++) {
      bytes += field->bytes;
    }
  }
  return bytes;
}

/* Writes a structure of the fixed part at *offset, which it moves. Sets *single to whether the
 * evaluator has single precision. */
static wire_error put_fixed(const struct question *q, const struct http_field *fields,
                            size_t *offset, bool *single) {
  wire_error error = wire_error_none();
  for (const struct http_field *field = fields; field->name != NULL; field++) {
    uint64_t number = 0;
    error = read_field(q, field, &number);
    if (!is_good(&error)) {
      return error;
    }
    put_le((uint8_t *)q->payload->bytes + *offset, number, field->bytes);
    *offset += field->bytes;
    if (strcmp(field->name, "evaluator") == 0) {
      *single = core_evaluator_bytes((unsigned)number) == sizeof(float);
    }
  }
  return error;
}

/* ---- all of it ------------------------------------------------------------------------------- */

static bool is_known(const void *context, const char *key) {
  const struct http_message *message = context;
  for (int i = 0; i < HTTP_STRUCTURES && message->request[i] != NULL; i++) {
    for (const struct http_field *field = message->request[i]; field->name != NULL; field++) {
      if (http_values_same(field->name, key) && !field->internal) {
        const struct http_list *list = list_of(message, key);
        return list == NULL || list->rule != NULL;
      }
    }
  }
  for (int i = 0; i < HTTP_LISTS && message->lists[i].name != NULL; i++) {
    if (http_values_same(message->lists[i].name, key)) {
      return true;
    }
  }
  for (int i = 0; message->media_most > 0 && i < COEFFICIENTS; i++) {
    if (http_values_same(http_fields_of_medium[i].name, key)) {
      return true;
    }
  }
  return strcmp(key, "deadline_ms") == 0 ||
         (message->media_most > 0 && strcmp(key, "medium") == 0) ||
         (message->type == WIRE_TYPE_FIT && strcmp(key, "reference") == 0) ||
         (message->parameters && core_choice_by_name(core_parameter_list, key) != NULL);
}

/* Returns whether an error can name a key: a short text of printable ASCII. */
static bool can_be_named(const char *key) {
  size_t length = 0;
  while (key[length] > ' ' && key[length] <= '~') {
    length++;
  }
  return key[length] == '\0' && length > 0 && length < sizeof((wire_error *)NULL)->field;
}

static wire_error check_keys(const struct question *q) {
  const char *key = http_values_unknown(q->values, is_known, q->message);
  return key == NULL ? wire_error_none()
                     : bad(can_be_named(key) ? key : "body",
                           "only fields that /v1/openapi.json lists for this request");
}

/* Checks that a varying request has one pair of lists for its media, and at most one list of
 * numbers. */
static wire_error check_pairs(const struct question *q) {
  const bool coloured = is_coloured(q) || http_value_given(get(q, "length"));
  const char *const wanted[] = {coloured ? "colour" : "sigma_a", coloured ? "length" : "sigma_s"};
  const char *const others[] = {coloured ? "sigma_a" : "given", coloured ? "sigma_s" : "light"};
  for (int i = 0; i < 2; i++) {
    if (http_value_given(get(q, others[i]))) {
      return bad(others[i], coloured ? "nothing beside colour and length"
                                     : "nothing beside sigma_a and sigma_s");
    }
    if (!http_value_given(get(q, wanted[i]))) {
      return bad(wanted[i], "numbers: give sigma_a and sigma_s, or colour and length");
    }
  }
  return http_value_given(get(q, "r")) && http_value_given(get(q, "u"))
             ? bad("u", "nothing beside r")
             : wire_error_none();
}

static wire_error add_each(const struct question *q, const char *name, struct http_value value,
                           bool single) {
  const size_t count = longest(q);
  if (!http_value_given(value)) {
    return wire_error_none();
  }
  return http_value_count(value) == count || http_value_count(value) == 1
             ? add_numbers(q, name, value, count, single)
             : wire_error_make(WIRE_STATUS_BAD_COUNT, name, "one value, or as many as the others");
}

static wire_error add_list(const struct question *q, const struct http_list *list, bool single) {
  const struct http_value value = get(q, list->name), first = get(q, q->message->lists[0].name);
  const size_t count = http_value_given(first) ? http_value_count(first) : 0;
  if (!http_value_given(value) && list->kind == HTTP_ZEROS) {
    return add(q, count * sizeof(double)) != NULL ? wire_error_none() : no_memory();
  }
  if (list->kind == HTTP_EACH) {
    return add_each(q, list->name, value, single);
  }
  if (!http_value_given(value)) {
    return list->rule != NULL ? wire_error_none() : bad(list->name, "a list: it has to be given");
  }
  if (list->kind == HTTP_SETS) {
    return add_sets(q, list->name, value, count);
  }
  return http_value_count(value) == count
             ? add_numbers(q, list->name, value, count, single)
             : wire_error_make(WIRE_STATUS_BAD_COUNT, list->name, "as many as in the other list");
}

static wire_error add_all_lists(const struct question *q, bool single) {
  wire_error error = wire_error_none();
  for (int i = 0; is_good(&error) && i < HTTP_LISTS && q->message->lists[i].name != NULL; i++) {
    error = add_list(q, &q->message->lists[i], single);
  }
  return error;
}

static wire_error read_deadline(const struct question *q, uint32_t *deadline_ms) {
  const struct http_value value = get(q, "deadline_ms");
  uint64_t limit_ms = 0;
  const wire_error error = http_value_given(value)
                               ? http_value_read_count(value, "deadline_ms", UINT32_MAX, &limit_ms)
                               : wire_error_none();
  *deadline_ms = (uint32_t)limit_ms;
  return error;
}

wire_error http_question_translate(const struct http_message *message,
                                   const struct http_values *values, struct http_text *payload,
                                   uint32_t *deadline_ms) {
  struct question q = {message, values, payload, 0, 0};
  size_t offset = 0;
  bool single = false;
  *deadline_ms = 0;
  wire_error error = check_keys(&q);
  if (is_good(&error)) {
    error = read_deadline(&q, deadline_ms);
  }
  if (is_good(&error) && message->type == WIRE_TYPE_VARYING) {
    error = check_pairs(&q);
  }
  if (is_good(&error) && add(&q, bytes_of(message)) == NULL) {
    error = no_memory();
  }
  if (is_good(&error)) {
    error = add_media(&q);
  }
  if (is_good(&error)) {
    error = add_parameters(&q);
  }
  if (is_good(&error)) {
    error = add_reference(&q);
  }
  for (int i = 0; is_good(&error) && i < HTTP_STRUCTURES && message->request[i] != NULL; i++) {
    error = put_fixed(&q, message->request[i], &offset, &single);
  }
  return is_good(&error) ? add_all_lists(&q, single) : error;
}

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

#include "core/fit/spectral.h"
#include "proto/decimal.h"
#include "proto/eval.h"
#include "proto/mc.h"
#include "server/net/worker.h"
#include "server/observe/health.h"
#include "server/scpi/session.h"
#include "server/store/media.h"

enum { HEADER_BYTES = 64 }; /* of the longest header */

enum outcome { FAILED, DONE, WAITS }; /* FAILED is false, too */
enum { SET = 1, QUERY = 2, BOTH = 3, TAKE = 4 | QUERY };

/* A command of proto/scpi.def. */
struct scpi_command {
  const char *pattern;
  unsigned forms;
  enum outcome (*carry_out)(struct scpi_session *s, const struct scpi_command *command,
                            struct scpi_unit *unit);
  size_t number; /* an offset in the session, a quantity or a part, as the function takes it */
  enum scpi_task_index task;
  const schema_structure *structure; /* that has the fields which `parameters` names */
  const char *parameters;
};

#define FIELDS_OF(name) (&schema_structures[SCHEMA_STRUCTURE_##name])
#define COMMAND(name)                                                                              \
  static enum outcome name(struct scpi_session *s, const struct scpi_command *command,             \
                           struct scpi_unit *unit)
#define UNUSED (void)s, (void)command, (void)unit

static enum outcome fail_with(struct scpi_session *s, int number, const char *field,
                              const char *allowed) {
  scpi_status_fail(&s->status, number, field, allowed);
  return FAILED;
}

/* Returns whether there is no error; else notes it. */
static bool is_good(struct scpi_session *s, wire_error error) {
  if (error.status != WIRE_STATUS_OK) {
    scpi_status_refuse(&s->status, &error);
  }
  return error.status == WIRE_STATUS_OK;
}

/* ---- answers --------------------------------------------------------------------------------- */

/* Answers with a text, behind those of the units before. */
static enum outcome answer(struct scpi_session *s, const char *text) {
  text_add(&s->answers, ";", s->answers.count > 0);
  text_add(&s->answers, text, strlen(text));
  return DONE;
}

static enum outcome answer_integer(struct scpi_session *s, unsigned value) {
  char text[16];
  snprintf(text, sizeof text, "%u", value);
  return answer(s, text);
}

/* Begins the block of an answer. */
static void answer_block(struct scpi_session *s, size_t bytes) {
  char head[32];
  const int digits = snprintf(head, sizeof head, "%zu", bytes);
  snprintf(head, sizeof head, "#%d%zu", digits, bytes);
  answer(s, head);
}

/* Writes the shortest decimal with the same bits; what is no number as SCPI has it. */
static size_t put_decimal(double value, bool single, char text[DECIMAL_BYTES]) {
  if (isfinite(value)) {
    return single ? decimal_write_single((float)value, text) : decimal_write(value, text);
  }
  return (size_t)snprintf(text, DECIMAL_BYTES, "%s",
                          isnan(value) ? "9.91E37"
                          : value > 0  ? "9.9E37"
                                       : "-9.9E37");
}

static enum outcome answer_decimals(struct scpi_session *s, const void *values, size_t count,
                                    bool single) {
  answer(s, count > 0 ? "" : "\"\"");
  for (size_t i = 0; i < count; i++) {
    char text[DECIMAL_BYTES + 1] = ",";
    const size_t bytes = put_decimal(schema_real_at(values, i, single), single, text + 1);
    text_add(&s->answers, text + (i == 0), bytes + (i > 0));
  }
  return DONE;
}

/* Makes a number of this machine, which is little-endian, one of the client, or the other way round. */
static void order_bytes(const struct scpi_session *s, uint8_t *at, size_t bytes) {
  for (size_t i = 0; s->settings.order != SCPI_SWAPPED && i < bytes / 2; i++) {
    const uint8_t byte = at[i];
    at[i] = at[bytes - 1 - i];
    at[bytes - 1 - i] = byte;
  }
}

static size_t format_bytes(const struct scpi_session *s) {
  return s->settings.format == SCPI_REAL_32 ? sizeof(float) : sizeof(double);
}

/* Answers with float or double values in the client's format. */
static enum outcome answer_values(struct scpi_session *s, const void *values, size_t count,
                                  bool single) {
  if (s->settings.format == SCPI_ASCII) {
    return answer_decimals(s, values, count, single);
  }
  const size_t each = format_bytes(s);
  answer_block(s, count * each);
  uint8_t *to = (uint8_t *)text_room(&s->answers, count * each);
  for (size_t i = 0; to != NULL && i < count; i++, to += each) {
    schema_put_real(to, 0, each == sizeof(float), schema_real_at(values, i, single));
    order_bytes(s, to, each);
  }
  s->answers.count += to != NULL ? count * each : 0;
  return DONE;
}

/* ---- parameters ------------------------------------------------------------------------------ */

/* Takes a parameter; notes an error if there is none. */
static bool take_parameter(struct scpi_session *s, struct scpi_unit *unit,
                           struct scpi_parameter *parameter) {
  int error = scpi_next_parameter(unit, parameter);
  error = error == 0 && parameter->kind == SCPI_NOTHING ? SCPI_MISSING : error;
  return error == 0 || fail_with(s, error, NULL, NULL);
}

/* Returns whether all parameters have been taken. */
static bool took_all(struct scpi_session *s, struct scpi_unit *unit) {
  struct scpi_parameter parameter;
  const int error = scpi_next_parameter(unit, &parameter);
  return (error == 0 && parameter.kind == SCPI_NOTHING) ||
         fail_with(s, error != 0 ? error : SCPI_NOT_ALLOWED, NULL, NULL);
}

static bool is_word(const struct scpi_parameter *parameter, const char *word) {
  return (parameter->kind == SCPI_WORD || parameter->kind == SCPI_STRING) &&
         scpi_is_word(parameter->text, parameter->bytes, word, strlen(word));
}

/* Returns whether a parameter is a whole name. */
static bool is_name(const struct scpi_parameter *parameter, const char *name) {
  return strlen(name) == parameter->bytes &&
         strncasecmp(name, parameter->text, parameter->bytes) == 0;
}

/* Reads a number. field: says what MIN, MAX and OFF are; NULL: there are none. */
static bool read_number(struct scpi_session *s, const struct scpi_parameter *parameter,
                        const schema_field *field, double *value) {
  const bool ranged = field != NULL && (field->spans || field->ranged);
  const bool optional = field != NULL && isnan(field->usual);
  const struct {
    bool holds;
    const char *word;
    double value;
  } words[] = {{true, "INFinity", INFINITY},
               {true, "NINFinity", -INFINITY},
               {!optional, "NAN", NAN},
               {optional, "OFF", NAN},
               {ranged, "MINimum", ranged ? field->least : 0},
               {ranged, "MAXimum", ranged ? field->most : 0}};
  for (size_t i = 0; i < sizeof words / sizeof words[0]; i++) {
    if (words[i].holds && is_word(parameter, words[i].word)) {
      *value = words[i].value;
      return true;
    }
  }
  const int error = scpi_read_decimal(parameter, value);
  return error == 0 || fail_with(s, error, NULL, NULL);
}

/* Adds the numbers of a block. */
static bool add_block(struct scpi_session *s, const struct scpi_parameter *block, struct text *to) {
  const size_t each = format_bytes(s);
  if (s->settings.format == SCPI_ASCII || block->bytes % each != 0) {
    return fail_with(s, SCPI_BAD_BLOCK, "FORMat",
                     "REAL,32 or REAL,64, as the numbers of the block");
  }
  for (size_t at = 0; at < block->bytes; at += each) {
    uint8_t bytes[sizeof(double)];
    memcpy(bytes, block->text + at, each);
    order_bytes(s, bytes, each);
    const double value = schema_real_at(bytes, 0, each == sizeof(float));
    text_add(to, &value, sizeof value);
  }
  return true;
}

/* Takes all parameters, numbers and blocks, into the list GIVEN. */
static bool take_list(struct scpi_session *s, struct scpi_unit *unit) {
  struct text *list = &s->lists[SCPI_GIVEN];
  struct scpi_parameter parameter;
  bool good = true;
  text_reset(list);
  do {
    double value;
    good = take_parameter(s, unit, &parameter);
    if (good && parameter.kind == SCPI_BLOCK) {
      good = add_block(s, &parameter, list);
    } else if (good && (good = read_number(s, &parameter, NULL, &value))) {
      text_add(list, &value, sizeof value);
    }
  } while (good && unit->more);
  return good && (!list->failed || fail_with(s, SCPI_NO_MEMORY, NULL, NULL));
}

static size_t length_of(const struct scpi_session *s, enum scpi_list list) {
  return s->lists[list].count / sizeof(double);
}

/* ---- fields ---------------------------------------------------------------------------------- */

/* Returns a structure's field by its name, and sets *at to its offset. */
static const schema_field *field_named(const schema_structure *structure, const char *name,
                                       size_t bytes, size_t *at) {
  const schema_field *field = structure->fields;
  *at = 0;
  while (strncmp(field->name, name, bytes) != 0 || field->name[bytes] != '\0') {
    *at += field++->bytes;
  }
  return field;
}

/* Returns the next field that a command's parameters name, as in <g>,<eta>[,<thickness>], or NULL.
 * *next: where they go on. A structure without a name has one field. */
static const schema_field *next_field(const struct scpi_command *command, const char **next,
                                      size_t *at) {
  const bool one = command->structure->name == NULL;
  const char *name = one ? *next : strchr(*next, '<');
  *at = 0;
  if (name == NULL || *name == '\0') {
    return NULL;
  }
  const size_t bytes = one ? strlen(name) : strcspn(++name, ">");
  *next = name + bytes;
  return one ? command->structure->fields : field_named(command->structure, name, bytes, at);
}

/* Returns how many letters the short form of a name has: its capitals; else four, or three if the
 * fourth is a vowel. */
static size_t short_bytes(const char *name) {
  const size_t capitals = strspn(name, "ABCDEFGHIJKLMNOPQRSTUVWXYZ");
  return capitals > 0 ? capitals : strlen(name) > 3 && strchr("aeiou", name[3]) != NULL ? 3 : 4;
}

/* Reads an entry of a list by its id, its name, or the name's short form or what stands before a unit,
 * if no other has the same. */
static bool read_choice(struct scpi_session *s, const struct scpi_parameter *parameter,
                        const schema_field *field, double *id) {
  if (parameter->kind == SCPI_DECIMAL) {
    return read_number(s, parameter, field, id);
  }
  unsigned found = 0;
  *id = 0;
  for (const core_choice *one = field->list; one->name != NULL; one++) {
    if (is_name(parameter, one->name)) {
      *id = one->id;
      return true;
    }
    if (strncasecmp(parameter->text, one->name, parameter->bytes) == 0 &&
        (parameter->bytes == short_bytes(one->name) || one->name[parameter->bytes] == '_')) {
      *id = one->id;
      found++;
    }
  }
  return found == 1 || (field->or_zero && is_word(parameter, "AUTO")) ||
         fail_with(s, SCPI_BAD_VALUE, field->name,
                   field->allowed != NULL ? field->allowed
                                          : "a name that `dipole info` lists, or its id");
}

/* Returns whether the number of a field is one that its kind has. */
static bool is_fit(const schema_field *field, double value) {
  const double end = field->bytes < 8 ? ldexp(1, 8 * (int)field->bytes) : 0x1p53;
  return field->kind == SCHEMA_f64 || (value >= 0 && value == floor(value) && value < end);
}

static void set_defaults(struct scpi_settings *to);

/* Returns the default of a field that lies at `at` in the settings. */
static double usual_of(const struct scpi_session *s, const schema_field *field, const uint8_t *at) {
  struct scpi_settings usual;
  const uintptr_t offset = (uintptr_t)at - (uintptr_t)&s->settings;
  set_defaults(&usual);
  return offset < sizeof usual ? schema_number_at(field, (const uint8_t *)&usual + offset) : 0;
}

/* Takes the value of a field that lies at `from` in the session, and writes it to `to`. */
static bool take_field(struct scpi_session *s, struct scpi_unit *unit, const schema_field *field,
                       const void *from, void *to) {
  struct scpi_parameter parameter;
  double value = 0;
  uint64_t bits = 0;
  if (!take_parameter(s, unit, &parameter)) {
    return false;
  }
  if (is_word(&parameter, "DEFault")) {
    value = usual_of(s, field, from);
  } else if (!(field->list != NULL ? read_choice(s, &parameter, field, &value)
                                   : read_number(s, &parameter, field, &value))) {
    return false;
  }
  if (!is_fit(field, value)) {
    return fail_with(s, SCPI_OUT_OF_RANGE, field->name,
                     "an integer from 0 on, below 2^53 and as large as the field");
  }
  schema_put_number(field, value, &bits);
  memcpy(to, &bits, field->bytes);
  return is_good(s, schema_check_value(field, bits));
}

/* Answers with a field; a comma stands before those that are not the first of a unit. */
static void answer_field(struct scpi_session *s, const schema_field *field, const uint8_t *at,
                         bool first) {
  const double value = schema_number_at(field, at);
  const core_choice *one =
      field->list != NULL ? core_choice_by_id(field->list, (unsigned)value) : NULL;
  char text[64];
  if (one != NULL) {
    const bool short_form = one->name[0] <= 'Z';
    snprintf(text, sizeof text, "%.*s", short_form ? (int)short_bytes(one->name) : 63, one->name);
  } else if (field->list != NULL || (isnan(value) && isnan(field->usual))) {
    strcpy(text, field->list != NULL ? "AUTO" : "OFF");
  } else if (field->kind == SCHEMA_f64) {
    put_decimal(value, false, text);
  } else {
    snprintf(text, sizeof text, "%.0f", value);
  }
  text_add(&s->answers, first ? ";" : ",", s->answers.count > 0);
  text_add(&s->answers, text, strlen(text));
}

/* Sets or tells the fields of a structure in the session. All are set, or none. */
static enum outcome use_structure(struct scpi_session *s, const struct scpi_command *command,
                                  struct scpi_unit *unit, uint8_t *structure) {
  uint8_t copy[sizeof(wire_mc_request)];
  const char *next = command->parameters;
  const size_t bytes = command->structure->bytes;
  const schema_field *field;
  bool optional = false;
  size_t at;
  memcpy(copy, structure, bytes);
  for (bool first = true; (field = next_field(command, &next, &at)) != NULL; first = false) {
    if (unit->query) {
      answer_field(s, field, copy + at, first);
    } else if (optional && !unit->more) {
      schema_put_number(field, usual_of(s, field, structure + at), copy + at);
    } else if (!take_field(s, unit, field, structure + at, copy + at)) {
      return FAILED;
    }
    optional = *next == '>' && next[1] == '[';
  }
  if (!unit->query && !took_all(s, unit)) {
    return FAILED;
  }
  memcpy(structure, copy, bytes);
  if (command->forms == TAKE) {
    memset(structure, 0, bytes);
  }
  return DONE;
}

COMMAND(use_fields) {
  return use_structure(s, command, unit, (uint8_t *)s + command->number);
}

/* Sets a structure of a request to the defaults of messages.def. */
static void set_usual(const schema_structure *structure, void *to) {
  uint8_t *at = to;
  for (const schema_field *field = structure->fields; field->name != NULL; field++) {
    schema_put_number(field, field->usual, at);
    at += field->bytes;
  }
}

_Static_assert(sizeof(wire_mc_request) >= sizeof(wire_eval_request) &&
                   sizeof(wire_medium) == sizeof(core_medium),
               "there is room for the fields of all commands");

static void set_defaults(struct scpi_settings *to) {
  *to = (struct scpi_settings){.parameters = core_parameters_none()};
  set_usual(FIELDS_OF(eval_request), &to->eval);
  set_usual(FIELDS_OF(fit_request), &to->fit.request);
  set_usual(FIELDS_OF(fit_design), &to->fit.design);
  set_usual(FIELDS_OF(mc_request), &to->mc);
  set_usual(FIELDS_OF(tissue_request), &to->tissue);
  set_usual(FIELDS_OF(medium), &to->reference);
  for (int i = 0; i < CORE_LAYERS_MAX; i++) {
    set_usual(FIELDS_OF(medium), &to->layers[i]);
  }
  for (int i = 0; i < CORE_PROPERTIES_END; i++) {
    to->properties[i] = NAN;
  }
  to->eval.evaluator = CORE_EVALUATOR_LUT;
  to->eval.medium_count = 1;
  to->fit.request.set_count = 1;
  to->mc.spacing = CORE_SPACING_LINEAR;
  to->mc.radius_stop = 10;
  to->mc.ring_count = 50;
  to->mc.photons = 1000000;
  to->tissue.wavelength_count = 1;
}

/* ---- IEEE 488.2 and the status --------------------------------------------------------------- */

COMMAND(clear_status) {
  UNUSED;
  s->status.events = s->status.operation.event = s->status.questionable.event = 0;
  s->status.count = 0;
  s->completes = false;
  return DONE;
}

COMMAND(preset_status) {
  UNUSED;
  s->status.operation.enable = s->status.questionable.enable = 0;
  return DONE;
}

COMMAND(note_completion) {
  UNUSED;
  s->completes = scpi_session_measures(s);
  s->status.events |= s->completes ? 0 : SCPI_EVENT_COMPLETE;
  return DONE;
}

COMMAND(wait_for_jobs) {
  UNUSED;
  s->held = scpi_session_measures(s);
  return s->held ? WAITS : unit->query ? answer(s, "1") : DONE;
}

COMMAND(reset_settings) {
  UNUSED;
  for (int i = 0; i < SCPI_TASKS; i++) {
    call_drop(&s->tasks[i]);
  }
  for (int i = 0; i < SCPI_LISTS; i++) {
    text_reset(&s->lists[i]);
  }
  s->completes = false;
  scpi_status_set(&s->status.operation, 0);
  set_defaults(&s->settings);
  return DONE;
}

enum { IDENTITY, ERROR, VERSION, STATUS_BYTE, HEALTH, ERROR_COUNT };

COMMAND(tell) {
  (void)unit;
  switch (command->number) {
  case IDENTITY:
    return answer(s, "dipoled,dipoled,0," DIPOLED_VERSION);
  case ERROR:
    return answer(s, scpi_status_take(&s->status));
  case VERSION:
    return answer(s, "1999.0");
  case STATUS_BYTE:
    return answer_integer(s, scpi_status_byte(&s->status, s->answers.count > 0));
  case HEALTH:
    return answer_integer(s, health_of(s->server) != HEALTH_OK);
  default:
    return answer_integer(s, s->status.count);
  }
}

/* ---- settings -------------------------------------------------------------------------------- */

COMMAND(use_numbers) {
  struct text *list = &s->lists[command->number], *given = &s->lists[SCPI_GIVEN];
  if (unit->query) {
    return answer_values(s, list->bytes, list->count / sizeof(double), false);
  }
  if (!take_list(s, unit)) {
    return FAILED;
  }
  const struct text before = *list;
  *list = *given;
  *given = before;
  return DONE;
}

static bool has_medium(struct scpi_session *s) {
  return s->settings.layer_count > 0 ||
         fail_with(s, SCPI_CONFLICT, "MEDium", "a medium, which has no default");
}

COMMAND(use_medium) {
  struct scpi_settings *settings = &s->settings;
  const bool listed = strchr(command->pattern, '<') != NULL; /* as LAYer<n> */
  const unsigned layer = listed ? unit->number : 1;
  if (unit->query && !has_medium(s)) {
    return FAILED;
  }
  if (layer < 1 || layer > settings->layer_count + !unit->query || layer > CORE_LAYERS_MAX) {
    return fail_with(s, SCPI_CONFLICT, "MEDium", "a layer that there is, or the next one, up to 8");
  }
  wire_medium *medium = &settings->layers[layer - 1], before = *medium;
  if (!use_structure(s, command, unit, (uint8_t *)medium) || unit->query) {
    return unit->query ? DONE : FAILED;
  }
  if (!is_good(s, job_error(core_medium_check((const core_medium *)(const void *)medium)))) {
    *medium = before;
    return FAILED;
  }
  settings->named = NULL;
  if (!listed || layer > settings->layer_count) {
    settings->layer_count = layer;
  }
  return DONE;
}

/* Sets the layers to those of a measured medium's channel. */
static enum outcome use_measured(struct scpi_session *s, const core_measured_medium *named,
                                 unsigned channel) {
  s->settings.named = named;
  s->settings.channel = channel;
  s->settings.layer_count = (unsigned)named->layer_count;
  memcpy(s->settings.layers, named->channel + (channel - 1) * named->layer_count,
         named->layer_count * sizeof(wire_medium));
  return DONE;
}

COMMAND(use_named_medium) {
  struct scpi_parameter parameter;
  size_t count;
  if (unit->query) {
    return answer(s, s->settings.named != NULL ? s->settings.named->name : "\"\"");
  }
  if (!take_parameter(s, unit, &parameter) || !took_all(s, unit)) {
    return FAILED;
  }
  const core_measured_medium *all = media_all(&count);
  for (size_t i = 0; i < count; i++) {
    if (is_name(&parameter, all[i].name)) {
      return use_measured(s, &all[i], 1);
    }
  }
  return fail_with(s, SCPI_BAD_VALUE, command->pattern, "a name that `dipole media` lists");
}

COMMAND(use_channel) {
  if (!unit->query && s->settings.named == NULL) {
    return fail_with(s, SCPI_CONFLICT, command->pattern, "behind MEDium:NAME");
  }
  const enum outcome outcome = use_fields(s, command, unit);
  return outcome == DONE && !unit->query ? use_measured(s, s->settings.named, s->settings.channel)
                                         : outcome;
}

COMMAND(use_option) {
  const enum core_parameter id =
      (command->number - offsetof(struct scpi_session, settings.parameters.value)) / sizeof(double);
  double *at = &s->settings.parameters.value[id], before = *at;
  const enum outcome outcome = use_fields(s, command, unit);
  if (outcome == DONE && !isnan(*at) && !is_good(s, job_error(core_parameter_check(id, *at)))) {
    *at = before;
    return FAILED;
  }
  return outcome;
}

COMMAND(use_property) {
  uint16_t id;
  return !take_field(s, unit, FIELDS_OF(sought)->fields, NULL, &id) ||
                 (unit->query && !took_all(s, unit))
             ? FAILED
             : use_structure(s, command, unit, (uint8_t *)&s->settings.properties[id]);
}

COMMAND(use_unknowns) {
  wire_sought sought[CORE_PROPERTIES_END] = {{0}};
  const schema_field *property = FIELDS_OF(sought)->fields;
  bool first = true;
  (void)command;
  for (unsigned id = 0; id < CORE_PROPERTIES_END && unit->query; id++) {
    if (s->settings.sought[id].property != 0) {
      answer_field(s, property, (const uint8_t *)&s->settings.sought[id].property, first);
      first = false;
    }
  }
  if (unit->query) {
    return first ? answer(s, "\"\"") : DONE;
  }
  do {
    uint16_t id;
    if (!take_field(s, unit, property, NULL, &id)) {
      return FAILED;
    }
    sought[id].property = id;
  } while (unit->more);
  memcpy(s->settings.sought, sought, sizeof sought);
  return DONE;
}

COMMAND(use_limit) {
  const schema_field *fields = FIELDS_OF(sought)->fields;
  wire_sought one = {0};
  if (!take_field(s, unit, fields, NULL, &one.property) ||
      !take_field(s, unit, fields + 3, NULL, &one.low) ||
      !take_field(s, unit, fields + 4, NULL, &one.high) || !took_all(s, unit)) {
    return FAILED;
  }
  if (s->settings.sought[one.property].property == 0) {
    return fail_with(s, SCPI_CONFLICT, command->pattern, "a property of FIT:SPECtrum:UNKNown");
  }
  s->settings.sought[one.property] = one;
  return DONE;
}

COMMAND(use_format) {
  static const char *const told[] = {"ASC", "REAL,32", "REAL,64"};
  struct scpi_parameter word, size;
  double bits = 64;
  (void)command;
  if (unit->query) {
    return answer(s, told[s->settings.format]);
  }
  if (!take_parameter(s, unit, &word)) {
    return FAILED;
  }
  const bool real = is_word(&word, "REAL");
  if ((real && unit->more &&
       !(take_parameter(s, unit, &size) && read_number(s, &size, NULL, &bits))) ||
      !took_all(s, unit)) {
    return FAILED;
  }
  if (!(real ? bits == 32 || bits == 64 : is_word(&word, "ASCii") || is_word(&word, "DEFault"))) {
    return fail_with(s, SCPI_BAD_VALUE, "FORMat", "ASCii, REAL,32 or REAL,64");
  }
  s->settings.format = !real ? SCPI_ASCII : bits == 32 ? SCPI_REAL_32 : SCPI_REAL_64;
  return DONE;
}

/* ---- jobs ------------------------------------------------------------------------------------ */

/* Returns the numbers of a list; NULL if it is empty. */
static const void *numbers_of(const struct scpi_session *s, enum scpi_list list) {
  return length_of(s, list) > 0 ? s->lists[list].bytes : NULL;
}

/* Starts a job whose request begins with these structures. Its parts come from the settings, by their
 * names. given: its parameters; places: its radii. */
static bool start_task(struct scpi_session *s, enum scpi_task_index index, enum wire_type type,
                       const void *start, const wire_parameter *given, const struct text *places) {
  const struct {
    const char *part;
    const void *elements;
  } sources[] = {{"medium", s->settings.layers},
                 {"parameter", given},
                 {"property", given},
                 {"reference", &s->settings.reference},
                 {"wavelength", index == SCPI_SPECTRUM ? numbers_of(s, SCPI_WAVELENGTHS)
                                                       : &s->settings.wavelength_nm},
                 {"sought", s->lists[SCPI_GIVEN].bytes},
                 {"mhz", numbers_of(s, SCPI_MHZ)},
                 {"quantity", numbers_of(s, SCPI_QUANTITIES)},
                 {"r", places != NULL ? places->bytes : NULL},
                 {"at", s->lists[SCPI_PLACES].bytes},
                 {"values", s->lists[SCPI_READINGS].bytes},
                 {"errors", s->lists[SCPI_DEVIATIONS].bytes}};
  const schema_payload *payload = schema_messages[type - 1].request;
  struct text *text = &s->tasks[index].payload;
  schema_layout layout;
  text_reset(text);
  if (!schema_lay_out(payload, start, s->server->options.max_frame_bytes, &layout, NULL)) {
    return fail_with(s, SCPI_TOO_MUCH, NULL, NULL);
  }
  uint8_t *bytes = (uint8_t *)text_room(text, (size_t)layout.payload_bytes);
  if (bytes == NULL) {
    return fail_with(s, SCPI_NO_MEMORY, NULL, NULL);
  }
  text->count = (size_t)layout.payload_bytes;
  memcpy(bytes, start, payload->fixed_bytes);
  for (unsigned i = 0; payload->parts[i].name != NULL; i++) {
    const void *elements = NULL;
    for (size_t k = 0; k < sizeof sources / sizeof sources[0]; k++) {
      elements =
          strcmp(sources[k].part, payload->parts[i].name) == 0 ? sources[k].elements : elements;
    }
    const bool narrow = layout.parts[i].bytes == sizeof(float);
    schema_put_part(bytes, &layout, i, narrow ? NULL : elements);
    for (uint64_t k = 0; narrow && k < layout.parts[i].count; k++) {
      schema_put_real(bytes + layout.parts[i].at, k, true, schema_real_at(elements, k, false));
    }
  }
  call_start(&s->tasks[index], type, &s->client->profiles, 0);
  worker_run_later(s->client);
  return true;
}

static const schema_payload *const replies[] = {[SCPI_FIT] = &schema_fit_reply,
                                                [SCPI_SPECTRUM] = &schema_fit_tissue_reply,
                                                [SCPI_MC] = &schema_mc_reply};

/* Returns the reply of a job that has ended; notes an error if there is none. */
static const uint8_t *reply_of(struct scpi_session *s, const struct scpi_command *command,
                               schema_layout *layout) {
  const struct call *task = &s->tasks[command->task];
  if (task->state != CALL_DONE) {
    fail_with(s, SCPI_STALE, command->pattern, "when a job has ended: see *OPC?");
    return NULL;
  }
  const uint8_t *reply = (const uint8_t *)task->reply.bytes;
  schema_lay_out(replies[command->task], reply, UINT64_MAX, layout, NULL);
  return reply;
}

/* Answers with the fields that `parameters` lists of a part's structures; sd_X is the root of
 * variance_X. */
COMMAND(tell_fields) {
  double values[CORE_SPECTRAL_UNKNOWNS_MAX * sizeof(wire_tissue_estimate) / sizeof(double)];
  size_t count = 0, bytes, at;
  schema_layout layout;
  const uint8_t *reply = reply_of(s, command, &layout);
  if (reply == NULL || !took_all(s, unit)) {
    return FAILED;
  }
  reply += layout.parts[command->number].at;
  for (size_t i = 0; i < layout.parts[command->number].count; i++) {
    for (const char *name = command->parameters; *name != '\0';
         name += bytes + strspn(name + bytes, ", ")) {
      char text[HEADER_BYTES];
      const bool root = strncmp(name, "sd_", 3) == 0;
      bytes = strcspn(name, ",");
      snprintf(text, sizeof text, "%s%.*s", root ? "variance_" : "", (int)bytes - 3 * root,
               name + 3 * root);
      const schema_field *field = field_named(command->structure, text, strlen(text), &at);
      const double value = schema_number_at(field, reply + i * command->structure->bytes + at);
      values[count++] = root ? sqrt(value) : value;
    }
  }
  return answer_values(s, values, count, false);
}

COMMAND(tell_array) {
  schema_layout layout;
  const uint8_t *reply = reply_of(s, command, &layout);
  (void)unit;
  return reply == NULL ? FAILED
                       : answer_values(s, reply + layout.parts[command->number].at,
                                       layout.parts[command->number].count, false);
}

/* ---- evals and media of tissues --------------------------------------------------------------- */

COMMAND(ask_quantity) {
  const bool given = command->parameters[0] != '\0';
  const unsigned quantity = (unsigned)command->number;
  const bool total = (quantity & (CORE_QUANTITY_ALBEDO | CORE_QUANTITY_BALANCE)) != 0;
  core_parameters parameters = s->settings.parameters;
  wire_parameter list[CORE_PARAMETERS_END];
  wire_eval_request start = s->settings.eval;
  if (given && !take_list(s, unit)) {
    return FAILED;
  }
  const enum scpi_list places = given ? SCPI_GIVEN : SCPI_RADII;
  if (!given && !total && length_of(s, places) == 0) {
    return answer_values(s, NULL, 0, false);
  }
  if ((quantity & CORE_MODULATED) == 0) {
    parameters.value[CORE_PARAMETER_MHZ] = NAN;
  }
  start.wanted = quantity | CORE_QUANTITY_MODEL_ERROR;
  start.layer_count = s->settings.layer_count;
  start.parameter_count = schema_put_numbers(list, parameters.value, CORE_PARAMETERS_END);
  start.radius_count = total ? 0 : length_of(s, places);
  s->waits_for = command;
  return has_medium(s) && start_task(s, SCPI_EVAL, WIRE_TYPE_EVAL, &start, list, &s->lists[places])
             ? WAITS
             : FAILED;
}

/* Answers with the values of an eval that has ended, and keeps its errors. */
static void answer_eval(struct scpi_session *s, const struct scpi_command *command) {
  const struct text *reply = &s->tasks[SCPI_EVAL].reply;
  const uint8_t *bytes = (const uint8_t *)reply->bytes;
  const unsigned quantity = (unsigned)command->number;
  wire_eval_reply fixed;
  eval_layout layout;
  eval_reply_parse(bytes, reply->count, false, &fixed, &layout);
  wire_get_quantity_error(bytes + eval_error_offset(&layout, fixed.wanted, 0, quantity),
                          &s->errors);
  if (quantity == CORE_QUANTITY_ALBEDO) {
    answer_values(s, bytes + eval_albedo_offset(0), 1, false);
  } else if (quantity == CORE_QUANTITY_BALANCE) {
    answer_values(s, bytes + layout.balances_offset, WIRE_BYTES_balance / sizeof(double), false);
  } else {
    answer_values(s, bytes + eval_array_offset(&layout, fixed.wanted, 0, quantity), fixed.count,
                  core_evaluator_bytes(fixed.evaluator) == sizeof(float));
  }
}

COMMAND(tell_eval_errors) {
  UNUSED;
  return answer_decimals(s, &s->errors, 3, false);
}

/* Makes the medium of the tissue at a wavelength. */
COMMAND(use_wavelength) {
  wire_parameter list[CORE_PROPERTIES_END];
  wire_tissue_request start = s->settings.tissue;
  s->wavelength_before_nm = s->settings.wavelength_nm;
  const enum outcome outcome = use_fields(s, command, unit);
  if (outcome != DONE || unit->query) {
    return outcome;
  }
  start.property_count = schema_put_numbers(list, s->settings.properties, CORE_PROPERTIES_END);
  s->waits_for = command;
  const bool started = start_task(s, SCPI_EVAL, WIRE_TYPE_TISSUE, &start, list, NULL);
  s->settings.wavelength_nm = started ? s->settings.wavelength_nm : s->wavelength_before_nm;
  return started ? WAITS : FAILED;
}

/* Takes the medium of a tissue that has been made. */
static void take_tissue(struct scpi_session *s) {
  const uint8_t *reply = (const uint8_t *)s->tasks[SCPI_EVAL].reply.bytes;
  wire_get_medium(reply + WIRE_BYTES_tissue_reply, &s->settings.layers[0]);
  s->settings.layer_count = 1;
  s->settings.named = NULL;
}

/* ---- fits and Monte Carlo -------------------------------------------------------------------- */

static bool is_under_way(const struct call *task) {
  return task->state == CALL_RUNS || task->state == CALL_ENDS;
}

/* Notes in the status which overlapped jobs are under way, and that all have ended. */
static enum outcome note_jobs(struct scpi_session *s) {
  const bool measures = scpi_session_measures(s);
  scpi_status_set(&s->status.operation, measures ? SCPI_OPERATION_MEASURING : 0);
  if (!measures) {
    s->status.events |= s->completes ? SCPI_EVENT_COMPLETE : 0;
    s->completes = s->held = false;
  }
  return DONE;
}

/* Returns whether a job of this kind can be started. */
static bool is_free(struct scpi_session *s, const struct scpi_command *command,
                    enum scpi_task_index index) {
  return is_under_way(&s->tasks[index])
             ? fail_with(s, SCPI_CONFLICT, command->pattern, "when the one that runs has ended")
             : true;
}

/* Returns whether there are as many READings and ERRors. */
static bool has_readings(struct scpi_session *s, size_t count, const char *needed) {
  return (length_of(s, SCPI_READINGS) == count && length_of(s, SCPI_DEVIATIONS) == count) ||
         fail_with(s, SCPI_UNEQUAL_LISTS, "FIT", needed);
}

COMMAND(start_fit) {
  const size_t count = length_of(s, SCPI_PLACES);
  const wire_medium *medium = &s->settings.layers[0];
  fit_start start = s->settings.fit;
  (void)unit;
  if (!is_free(s, command, SCPI_FIT) || !has_medium(s) ||
      !has_readings(s, count, "as many PLACes, READings and ERRors")) {
    return FAILED;
  }
  if (s->settings.layer_count > 1) {
    return fail_with(s, SCPI_CONFLICT, "MEDium", "one layer: its g, eta and thickness");
  }
  start.design.reading_count = (uint32_t)count;
  start.design.g = medium->g;
  start.design.eta = medium->eta;
  start.design.thickness = medium->thickness;
  return start_task(s, SCPI_FIT, WIRE_TYPE_FIT, &start, NULL, NULL) ? note_jobs(s) : FAILED;
}

COMMAND(start_spectrum) {
  const size_t places = length_of(s, SCPI_PLACES), wavelengths = length_of(s, SCPI_WAVELENGTHS);
  const size_t mhz = length_of(s, SCPI_MHZ), quantities = length_of(s, SCPI_QUANTITIES);
  wire_parameter list[CORE_PROPERTIES_END];
  wire_fit_tissue_request start = {.set_count = 1,
                                   .model = s->settings.fit.design.model,
                                   .axis = s->settings.fit.design.axis,
                                   .scale = s->settings.fit.design.scale,
                                   .tissue = s->settings.tissue.tissue,
                                   .haemoglobin = s->settings.tissue.haemoglobin,
                                   .wavelength_count = (uint32_t)wavelengths,
                                   .place_count = (uint32_t)places};
  (void)unit;
  if (!is_free(s, command, SCPI_SPECTRUM) ||
      !has_readings(s, places * wavelengths, "READings and ERRors: WAVelengths times PLACes")) {
    return FAILED;
  }
  if ((mhz > 0 && mhz != places) || (quantities > 0 && quantities != places)) {
    return fail_with(s, SCPI_UNEQUAL_LISTS, command->pattern, "MHZ and QUANtities as PLACes");
  }
  text_reset(&s->lists[SCPI_GIVEN]);
  for (unsigned id = 0; id < CORE_PROPERTIES_END; id++) {
    if (s->settings.sought[id].property != 0) {
      text_add(&s->lists[SCPI_GIVEN], &s->settings.sought[id], sizeof(wire_sought));
      start.sought_count++;
    }
  }
  start.property_count = schema_put_numbers(list, s->settings.properties, CORE_PROPERTIES_END);
  return start_task(s, SCPI_SPECTRUM, WIRE_TYPE_FIT_TISSUE, &start, list, NULL) ? note_jobs(s)
                                                                                : FAILED;
}

/* Sets the bits of STATus:QUEStionable that a fit which has ended has. */
static void note_fit(struct scpi_session *s, enum scpi_task_index index) {
  static const uint8_t bits[] = {
      [CORE_FIT_STATUS_AT_BOUND] = 9,     [CORE_FIT_STATUS_UNDETERMINED] = 10,
      [CORE_FIT_STATUS_UNFINISHED] = 10,  [CORE_FIT_STATUS_REFUSED] = 10,
      [CORE_FIT_STATUS_IMPLAUSIBLE] = 11, [CORE_FIT_STATUS_AMBIGUOUS] = 12};
  uint16_t status; /* the first field of what was found */
  memcpy(&status, s->tasks[index].reply.bytes + replies[index]->fixed_bytes, sizeof status);
  const unsigned bit = status < sizeof bits ? bits[status] : 0;
  scpi_status_set(&s->status.questionable, (uint16_t)(bit > 0 ? 1U << bit : 0));
}

COMMAND(start_mc) {
  wire_mc_request start = s->settings.mc;
  (void)unit;
  start.layer_count = s->settings.layer_count;
  return is_free(s, command, SCPI_MC) && has_medium(s) &&
                 start_task(s, SCPI_MC, WIRE_TYPE_MC, &start, NULL, NULL)
             ? note_jobs(s)
             : FAILED;
}

COMMAND(tell_progress) {
  const struct call *task = &s->tasks[SCPI_MC];
  wire_mc_reply reply = {.photons_expected = s->settings.mc.photons, .error_total = INFINITY};
  (void)unit;
  if (task->state == CALL_NONE) {
    return fail_with(s, SCPI_STALE, command->pattern, "when MC:STARt has begun");
  }
  if (task->reply.count >= WIRE_BYTES_mc_reply) {
    wire_get_mc_reply((const uint8_t *)task->reply.bytes, &reply);
  }
  const double values[] = {(double)reply.photons, (double)reply.photons_expected, reply.error_total,
                           reply.state};
  return answer_decimals(s, values, 4, false);
}

/* Answers with the values of a side, or their standard errors. */
COMMAND(tell_rings) {
  wire_mc_reply fixed;
  schema_layout layout;
  uint32_t side = 1;
  const uint8_t *reply = reply_of(s, command, &layout);
  if (reply == NULL) {
    return FAILED;
  }
  wire_get_mc_reply(reply, &fixed);
  const schema_field field = {.name = command->pattern,
                              .kind = SCHEMA_u32,
                              .count = 1,
                              .bytes = sizeof(uint32_t),
                              .ranged = true,
                              .least = 1,
                              .most = fixed.side_count};
  if (unit->at < unit->end && (!take_field(s, unit, &field, NULL, &side) || !took_all(s, unit))) {
    return FAILED;
  }
  return answer_values(s, reply + mc_rings_offset(&layout, 0, side - 1, command->number == 1),
                       fixed.ring_count, false);
}

COMMAND(abort_job) {
  (void)unit;
  call_stop(&s->tasks[command->number], JOB_CANCELLED);
  return note_jobs(s);
}

/* ---- the list -------------------------------------------------------------------------------- */

#define RANGE(from, to) .ranged = true, .least = (from), .most = (to)
#define USUAL(number) .usual = (number)
#define ORDER .list = orders, .allowed = "NORMal or SWAPped"
static const core_choice orders[] = {
    {SCPI_NORMAL, "NORMal", ""}, {SCPI_SWAPPED, "SWAPped", ""}, {0, NULL, NULL}};

/* A structure with one field, which is a member of the session. */
#define ONE_FIELD(header, value, ...)                                                              \
  &(const schema_structure) {                                                                      \
    NULL,                                                                                          \
        (const schema_field[]){{.name = header,                                                    \
                                .kind = SCHEMA_##value,                                            \
                                .count = 1,                                                        \
                                .bytes = WIRE_SIZE_##value,                                        \
                                __VA_ARGS__},                                                      \
                               {.name = NULL}},                                                    \
        WIRE_SIZE_##value                                                                          \
  }
#define AT(member) offsetof(struct scpi_session, member)

static const struct scpi_command commands[] = {
#define SCPI_COMMAND(pattern, FORMS, function, number, parameters, about)                          \
  {pattern, FORMS, function, number, SCPI_MC, NULL, parameters},
#define SCPI_REGISTER(pattern, FORMS, member, largest, about)                                      \
  {pattern, FORMS, use_fields, AT(status.member), 0, ONE_FIELD(pattern, u16, RANGE(0, largest)),   \
   "<n>"},
#define SCPI_FIELDS(pattern, function, member, structure, parameters, about)                       \
  {pattern, BOTH, function, AT(settings.member), 0, FIELDS_OF(structure), parameters},
#define SCPI_FIELD(pattern, FORMS, function, member, value, attributes, parameters, about)         \
  {pattern,   FORMS, function, AT(settings.member), 0, ONE_FIELD(pattern, value, attributes),      \
   parameters},
#define SCPI_NUMBERS(pattern, FORMS, LIST, parameters, about)                                      \
  {pattern, FORMS, use_numbers, SCPI_##LIST, 0, NULL, parameters},
#define SCPI_QUANTITY(pattern, QUANTITY, parameters, about)                                        \
  {pattern, QUERY, ask_quantity, CORE_QUANTITY_##QUANTITY, 0, NULL, parameters},
#define SCPI_REPLY(pattern, TASK, part, structure, fields)                                         \
  {pattern, QUERY, tell_fields, part, SCPI_##TASK, FIELDS_OF(structure), fields},
#define SCPI_ARRAY(pattern, TASK, part, about)                                                     \
  {pattern, QUERY, tell_array, part, SCPI_##TASK, NULL, ""},
#include "proto/scpi.def"
};

enum { COMMANDS = sizeof commands / sizeof commands[0] };

static const struct scpi_command *find_command(const char *header, size_t bytes, bool query,
                                               unsigned *number) {
  for (const struct scpi_command *one = commands; one < commands + COMMANDS; one++) {
    if ((one->forms & (query ? QUERY : SET)) != 0 &&
        scpi_matches(one->pattern, header, bytes, number)) {
      return one;
    }
  }
  return NULL;
}

/* Writes the header that a unit has at the node of the last command, whose optional nodes count or
 * not. */
static size_t join_header(const char *pattern, bool optional, const struct scpi_unit *unit,
                          char text[2 * HEADER_BYTES]) {
  size_t bytes = 0, node = 0;
  for (bool inside = false; *pattern != '\0'; pattern++) {
    inside = *pattern == '[' || (inside && *pattern != ']');
    if (strchr("[]", *pattern) == NULL && (optional || !inside)) {
      node = *pattern == ':' ? bytes + 1 : node;
      text[bytes++] = *pattern;
    }
  }
  memcpy(text + node, unit->header, unit->header_bytes);
  return node + unit->header_bytes;
}

/* Returns the command of a unit: from the root, or at the node of the last one. */
static const struct scpi_command *command_of(const struct scpi_session *s, struct scpi_unit *unit) {
  const struct scpi_command *found = NULL;
  if (unit->header_bytes > HEADER_BYTES) {
    return NULL;
  }
  if (unit->rooted || s->command == NULL) {
    return find_command(unit->header, unit->header_bytes, unit->query, &unit->number);
  }
  for (int optional = 0; found == NULL && optional < 2; optional++) {
    char text[2 * HEADER_BYTES];
    const size_t bytes = join_header(s->command->pattern, optional, unit, text);
    found = find_command(text, bytes, unit->query, &unit->number);
  }
  return found;
}

/* ---- the session ----------------------------------------------------------------------------- */

void scpi_session_init(struct scpi_session *s, struct client *client, struct server *server) {
  s->client = client;
  s->server = server;
  s->errors = (wire_quantity_error){NAN, NAN, NAN};
  s->status.events = SCPI_EVENT_POWER_ON;
  text_init(&s->answers, &server->buffers);
  for (int i = 0; i < SCPI_LISTS; i++) {
    text_init(&s->lists[i], &server->buffers);
  }
  for (int i = 0; i < SCPI_TASKS; i++) {
    call_init(&s->tasks[i], client, &server->buffers, true);
  }
  set_defaults(&s->settings);
}

void scpi_session_free(struct scpi_session *s) {
  text_free(&s->answers);
  for (int i = 0; i < SCPI_LISTS; i++) {
    text_free(&s->lists[i]);
  }
  for (int i = 0; i < SCPI_TASKS; i++) {
    call_free(&s->tasks[i]);
  }
}

bool scpi_session_measures(const struct scpi_session *s) {
  return is_under_way(&s->tasks[SCPI_FIT]) || is_under_way(&s->tasks[SCPI_SPECTRUM]) ||
         is_under_way(&s->tasks[SCPI_MC]);
}

static enum outcome carry_out(struct scpi_session *s, struct scpi_unit *unit) {
  const struct scpi_command *command = command_of(s, unit);
  if (command == NULL) {
    char header[HEADER_BYTES + 2];
    const int most = (int)(unit->header_bytes < HEADER_BYTES ? unit->header_bytes : HEADER_BYTES);
    snprintf(header, sizeof header, "%.*s%s", most, unit->header, unit->query ? "?" : "");
    return fail_with(s, SCPI_UNDEFINED_HEADER, header, NULL);
  }
  if (command->pattern[0] != '*') {
    s->command = command;
  }
  if ((command->parameters[0] == '\0' || (unit->query && command->forms != QUERY)) &&
      !took_all(s, unit)) {
    return FAILED;
  }
  return command->carry_out(s, command, unit);
}

bool scpi_session_step(struct scpi_session *s, const char *message, size_t count, size_t *at) {
  struct scpi_unit unit;
  size_t next = *at;
  s->command = next == 0 ? NULL : s->command;
  const int error = scpi_next_unit(message, count, &next, &unit);
  const enum outcome outcome = error != 0               ? fail_with(s, error, NULL, NULL)
                               : unit.header_bytes == 0 ? DONE
                                                        : carry_out(s, &unit);
  if (outcome != WAITS) {
    s->waits_for = NULL;
  }
  *at = outcome == WAITS && s->held ? *at : next;
  return outcome == WAITS || (outcome == DONE && next < count);
}

void scpi_session_end_message(struct scpi_session *s) {
  if (s->answers.failed) {
    text_free(&s->answers);
    fail_with(s, SCPI_NO_MEMORY, NULL, NULL);
  }
  text_add(&s->answers, "\n", s->answers.count > 0);
}

void scpi_session_run(struct scpi_session *s, uint64_t *budget) {
  for (int i = 0; i < SCPI_TASKS; i++) {
    call_on(&s->tasks[i], budget);
  }
}

bool scpi_session_finish(struct scpi_session *s) {
  bool good = true;
  for (int i = 0; i < SCPI_TASKS; i++) {
    struct call *task = &s->tasks[i];
    if (!call_take_end(task)) {
      continue;
    }
    const bool refused = task->state == CALL_NONE;
    text_reset(&task->payload);
    const bool tissue = i == SCPI_EVAL && s->waits_for->carry_out == use_wavelength;
    if (refused) {
      scpi_status_refuse(&s->status, &task->error);
      s->settings.wavelength_nm = tissue ? s->wavelength_before_nm : s->settings.wavelength_nm;
    } else if (tissue) {
      take_tissue(s);
    } else if (i == SCPI_EVAL) {
      answer_eval(s, s->waits_for);
    } else if (i != SCPI_MC) {
      note_fit(s, i);
    }
    if (i == SCPI_EVAL) {
      good = !refused;
      s->waits_for = NULL;
      text_reset(&task->reply);
    }
    note_jobs(s);
  }
  return good;
}

void scpi_session_stop(struct scpi_session *s, bool all) {
  for (int i = SCPI_FIT; i < SCPI_TASKS; i++) {
    if (all) {
      call_drop(&s->tasks[i]);
    } else if (i == SCPI_MC) {
      call_stop(&s->tasks[i], JOB_DAEMON_STOPS);
    }
  }
  note_jobs(s);
}

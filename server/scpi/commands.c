#include <math.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

#include "proto/decimal.h"
#include "proto/eval.h"
#include "proto/fit.h"
#include "proto/mc.h"
#include "server/net/worker.h"
#include "server/observe/health.h"
#include "server/scpi/session.h"
#include "server/store/media.h"

enum {
  MISSING = -109,
  NOT_ALLOWED = -108,
  UNDEFINED_HEADER = -113,
  BAD_TYPE = -104,
  BAD_BLOCK = -161,
  CONFLICT = -221,
  OUT_OF_RANGE = -222,
  BAD_VALUE = -224,
  UNEQUAL_LISTS = -226,
  STALE = -230,
  NO_MEMORY = -321,
  HEADER_BYTES = 64, /* the longest header */
};

enum outcome { FAILED, DONE, WAITS }; /* FAILED is false, too */
enum { SET = 1, QUERY = 2, BOTH = 3, TAKE = 4 | QUERY };

/* A command of proto/scpi.def. */
struct scpi_command {
  const char *pattern;
  unsigned forms;
  enum outcome (*carry_out)(struct scpi_session *s, const struct scpi_command *command,
                            struct scpi_unit *unit);
  size_t number;                     /* an offset, a quantity or a part, as the function takes it */
  unsigned most;                     /* of a register; or a task */
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

/* Adds a text: the answer of a unit, or its next value. */
static enum outcome add_answer(struct scpi_session *s, char separator, const char *text) {
  http_text_add(&s->answers, &separator, s->answers.count > 0);
  http_text_add(&s->answers, text, strlen(text));
  return DONE;
}

static enum outcome answer_integer(struct scpi_session *s, uint64_t value) {
  char text[24];
  snprintf(text, sizeof text, "%llu", (unsigned long long)value);
  return add_answer(s, ';', text);
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

static double value_at(const uint8_t *values, size_t index, bool single) {
  float narrow;
  double value;
  if (single) {
    memcpy(&narrow, values + index * sizeof narrow, sizeof narrow);
    return (double)narrow;
  }
  memcpy(&value, values + index * sizeof value, sizeof value);
  return value;
}

static enum outcome answer_decimals(struct scpi_session *s, const void *values, size_t count,
                                    bool single) {
  add_answer(s, ';', count > 0 ? "" : "\"\"");
  for (size_t i = 0; i < count; i++) {
    char text[DECIMAL_BYTES + 1] = ",";
    const size_t bytes = put_decimal(value_at(values, i, single), single, text + 1);
    http_text_add(&s->answers, text + (i == 0), bytes + (i > 0));
  }
  return DONE;
}

/* Makes a number of this machine, which is little-endian, big-endian, or the other way round. */
static void reverse_bytes(uint8_t *at, size_t bytes) {
  for (size_t i = 0; i < bytes / 2; i++) {
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
  char head[32];
  const size_t each = format_bytes(s);
  const int digits = snprintf(head, sizeof head, "%zu", count * each);
  snprintf(head, sizeof head, "#%d%zu", digits, count * each);
  add_answer(s, ';', head);
  uint8_t *to = (uint8_t *)http_text_room(&s->answers, count * each);
  for (size_t i = 0; to != NULL && i < count; i++, to += each) {
    const double value = value_at(values, i, single);
    const float narrow = (float)value;
    memcpy(to, each == sizeof narrow ? (const void *)&narrow : (const void *)&value, each);
    if (!s->settings.swapped) {
      reverse_bytes(to, each);
    }
  }
  s->answers.count += to != NULL ? count * each : 0;
  return DONE;
}

/* ---- parameters ------------------------------------------------------------------------------ */

/* Takes a parameter; notes an error if there is none. */
static bool take_parameter(struct scpi_session *s, struct scpi_unit *unit,
                           struct scpi_parameter *parameter) {
  int error = scpi_next_parameter(unit, parameter);
  error = error == 0 && parameter->kind == SCPI_NOTHING ? MISSING : error;
  return error == 0 || fail_with(s, error, NULL, NULL);
}

/* Returns whether all parameters have been taken. */
static bool took_all(struct scpi_session *s, struct scpi_unit *unit) {
  struct scpi_parameter parameter;
  const int error = scpi_next_parameter(unit, &parameter);
  return (error == 0 && parameter.kind == SCPI_NOTHING) ||
         fail_with(s, error != 0 ? error : NOT_ALLOWED, NULL, NULL);
}

static bool is_word(const struct scpi_parameter *parameter, const char *word) {
  return (parameter->kind == SCPI_WORD || parameter->kind == SCPI_STRING) &&
         scpi_is_word(parameter->text, parameter->bytes, word, strlen(word));
}

/* Takes one of some words. Returns its position, or -1. */
static int take_word(struct scpi_session *s, struct scpi_unit *unit, const char *const words[],
                     const char *field, const char *allowed) {
  struct scpi_parameter parameter;
  if (!take_parameter(s, unit, &parameter)) {
    return -1;
  }
  for (int i = 0; words[i] != NULL; i++) {
    if (is_word(&parameter, words[i])) {
      return i;
    }
  }
  fail_with(s, BAD_VALUE, field, allowed);
  return -1;
}

/* Reads a number. field: says what MIN and MAX are; NULL: there are none. */
static bool read_number(struct scpi_session *s, const struct scpi_parameter *parameter,
                        const schema_field *field, double *value) {
  static const char *const words[] = {"INFinity", "NINFinity", "NAN", "MINimum", "MAXimum"};
  const bool ranged = field != NULL && (field->spans || field->ranged);
  const double values[] = {INFINITY, -INFINITY, NAN, ranged ? field->least : 0,
                           ranged ? field->most : 0};
  for (int i = 0; i < (ranged ? 5 : 3); i++) {
    if (is_word(parameter, words[i])) {
      *value = values[i];
      return true;
    }
  }
  const int error = scpi_read_decimal(parameter, value);
  return error == 0 || fail_with(s, error, NULL, NULL);
}

/* Takes an integer that is the only parameter. */
static bool take_integer(struct scpi_session *s, struct scpi_unit *unit, const char *field,
                         unsigned least, unsigned most, unsigned *value) {
  struct scpi_parameter parameter;
  double number;
  char allowed[48];
  if (!take_parameter(s, unit, &parameter) || !read_number(s, &parameter, NULL, &number) ||
      !took_all(s, unit)) {
    return false;
  }
  snprintf(allowed, sizeof allowed, "an integer from %u to %u", least, most);
  const bool good = number >= least && number <= most && number == floor(number);
  *value = good ? (unsigned)number : 0;
  return good || fail_with(s, OUT_OF_RANGE, field, allowed);
}

/* Adds the numbers of a block. */
static bool add_block(struct scpi_session *s, const struct scpi_parameter *block,
                      struct http_text *to) {
  const size_t each = format_bytes(s);
  if (s->settings.format == SCPI_ASCII || block->bytes % each != 0) {
    return fail_with(s, BAD_BLOCK, "FORMat", "REAL,32 or REAL,64, as the numbers of the block");
  }
  for (size_t at = 0; at < block->bytes; at += each) {
    uint8_t bytes[sizeof(double)];
    memcpy(bytes, block->text + at, each);
    if (!s->settings.swapped) {
      reverse_bytes(bytes, each);
    }
    const double value = value_at(bytes, 0, each == sizeof(float));
    http_text_add(to, (const char *)&value, sizeof value);
  }
  return true;
}

/* Takes all parameters, numbers and blocks, into the list GIVEN. */
static bool take_list(struct scpi_session *s, struct scpi_unit *unit) {
  struct http_text *list = &s->lists[SCPI_GIVEN];
  struct scpi_parameter parameter;
  bool good = true;
  http_text_reset(list);
  do {
    double value;
    good = take_parameter(s, unit, &parameter);
    if (good && parameter.kind == SCPI_BLOCK) {
      good = add_block(s, &parameter, list);
    } else if (good && (good = read_number(s, &parameter, NULL, &value))) {
      http_text_add(list, (const char *)&value, sizeof value);
    }
  } while (good && unit->more);
  return good && (!list->failed || fail_with(s, NO_MEMORY, NULL, NULL));
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
    *at += schema_field_bytes(field++);
  }
  return field;
}

/* Returns the next field that a command's parameters name, as in <g>,<eta>[,<thickness>], or NULL.
 * *next: where they go on. */
static const schema_field *next_field(const struct scpi_command *command, const char **next,
                                      size_t *at) {
  const char *name = strchr(*next, '<');
  if (name == NULL) {
    return NULL;
  }
  const size_t bytes = strcspn(++name, ">");
  *next = name + bytes;
  return field_named(command->structure, name, bytes, at);
}

/* Reads an entry of a list by its id, its name, or the name's short form if no other has the same. */
static bool read_choice(struct scpi_session *s, const struct scpi_parameter *parameter,
                        const schema_field *field, double *id) {
  if (parameter->kind == SCPI_DECIMAL) {
    return read_number(s, parameter, field, id);
  }
  unsigned found = 0;
  *id = 0;
  for (const core_choice *one = field->list; one->name != NULL; one++) {
    /* four letters, or three if the fourth is a vowel */
    const size_t length = strlen(one->name);
    const size_t capitals = length > 3 && strchr("aeiou", one->name[3]) != NULL ? 3 : 4;
    if (strncasecmp(parameter->text, one->name, parameter->bytes) == 0 &&
        (parameter->bytes == length || parameter->bytes == capitals)) {
      *id = one->id;
      found++;
      if (parameter->bytes == length) {
        return true;
      }
    }
  }
  return found == 1 || (field->or_zero && is_word(parameter, "AUTO")) ||
         fail_with(s, BAD_VALUE, field->name, "a name that `dipole` lists, or its id");
}

/* Writes the number of a field as its kind has it. Returns false if it does not fit. */
static bool put_number(const schema_field *field, double value, void *at) {
  const size_t bytes = schema_field_bytes(field);
  const bool real = field->kind == SCHEMA_f64;
  const double end = bytes < 8 ? ldexp(1, 8 * (int)bytes) : 0x1p53; /* then not all are doubles */
  const bool fits = value >= 0 && value == floor(value) && value < end;
  const uint64_t integer = fits && !real ? (uint64_t)value : 0;
  memcpy(at, real ? (const void *)&value : (const void *)&integer, bytes);
  return fits || real;
}

static double number_at(const schema_field *field, const uint8_t *at) {
  uint64_t integer = 0;
  double real;
  memcpy(&integer, at, schema_field_bytes(field));
  memcpy(&real, &integer, sizeof real);
  return field->kind == SCHEMA_f64 ? real : (double)integer;
}

/* Takes the value of a field. usual: what DEF stands for. */
static bool take_field(struct scpi_session *s, struct scpi_unit *unit, const schema_field *field,
                       const uint8_t *usual, uint8_t *at) {
  struct scpi_parameter parameter;
  double value;
  uint64_t bits = 0;
  if (!take_parameter(s, unit, &parameter)) {
    return false;
  }
  if (is_word(&parameter, "DEFault")) {
    value = number_at(field, usual);
  } else if (!(field->list != NULL ? read_choice(s, &parameter, field, &value)
                                   : read_number(s, &parameter, field, &value))) {
    return false;
  }
  if (!put_number(field, value, &bits)) {
    return fail_with(s, OUT_OF_RANGE, field->name,
                     "an integer from 0 on, below 2^53 and as large as the field");
  }
  memcpy(at, &bits, schema_field_bytes(field));
  return is_good(s, schema_check_value(field, bits));
}

/* Answers with a field; a comma stands before those that are not the first of a unit. */
static void answer_field(struct scpi_session *s, const schema_field *field, const uint8_t *at,
                         bool first) {
  const double value = number_at(field, at);
  const core_choice *one =
      field->list != NULL ? core_choice_by_id(field->list, (unsigned)value) : NULL;
  char text[DECIMAL_BYTES];
  if (field->kind == SCHEMA_f64) {
    put_decimal(value, false, text);
  } else {
    snprintf(text, sizeof text, "%.0f", value);
  }
  add_answer(s, first ? ';' : ',', field->list == NULL ? text : one != NULL ? one->name : "AUTO");
}

static void set_defaults(struct scpi_settings *to);

/* Sets or tells the fields of a structure in the settings. All are set, or none. */
static enum outcome use_structure(struct scpi_session *s, const struct scpi_command *command,
                                  struct scpi_unit *unit, void *structure) {
  struct scpi_settings usual;
  uint8_t copy[sizeof(wire_mc_request)];
  const char *next = command->parameters;
  const size_t bytes = command->structure->bytes;
  const schema_field *field;
  bool optional = false;
  size_t at;
  set_defaults(&usual);
  const uint8_t *from = (uint8_t *)&usual + ((uint8_t *)structure - (uint8_t *)&s->settings);
  memcpy(copy, structure, bytes);
  for (bool first = true; (field = next_field(command, &next, &at)) != NULL; first = false) {
    if (unit->query) {
      answer_field(s, field, copy + at, first);
    } else if (optional && !unit->more) {
      memcpy(copy + at, from + at, schema_field_bytes(field));
    } else if (!take_field(s, unit, field, from + at, copy + at)) {
      return FAILED;
    }
    optional = next[1] == '[';
  }
  if (!unit->query && !took_all(s, unit)) {
    return FAILED;
  }
  memcpy(structure, copy, bytes);
  return DONE;
}

COMMAND(use_fields) {
  return use_structure(s, command, unit, (uint8_t *)&s->settings + command->number);
}

/* Sets a structure of a request to the defaults of messages.def. */
static void set_usual(const schema_structure *structure, void *to) {
  uint8_t *at = to;
  for (const schema_field *field = structure->fields; field->name != NULL; field++) {
    put_number(field, field->usual, at);
    at += schema_field_bytes(field);
  }
}

_Static_assert(sizeof(wire_eval_request) == WIRE_BYTES_eval_request &&
                   sizeof(fit_start) == WIRE_BYTES_fit_request + WIRE_BYTES_fit_design &&
                   sizeof(wire_mc_request) == WIRE_BYTES_mc_request &&
                   sizeof(wire_mc_request) >= sizeof(wire_eval_request) &&
                   sizeof(wire_tissue_request) == WIRE_BYTES_tissue_request &&
                   sizeof(wire_medium) == sizeof(core_medium),
               "requests lie in memory as on the wire");

static void set_defaults(struct scpi_settings *to) {
  *to = (struct scpi_settings){.parameters = core_parameters_none()};
  set_usual(FIELDS_OF(eval_request), &to->eval);
  set_usual(FIELDS_OF(fit_request), &to->fit.request);
  set_usual(FIELDS_OF(fit_design), &to->fit.design);
  set_usual(FIELDS_OF(mc_request), &to->mc);
  set_usual(FIELDS_OF(tissue_request), &to->tissue);
  to->eval.evaluator = CORE_EVALUATOR_LUT;
  to->eval.medium_count = 1;
  to->fit.request.set_count = 1;
  to->mc.spacing = CORE_SPACING_LINEAR;
  to->mc.radius_stop = 10;
  to->mc.ring_count = 50;
  to->mc.photons = 1000000;
  to->tissue.wavelength_count = 1;
  set_usual(FIELDS_OF(medium), &to->reference);
  for (int i = 0; i < CORE_LAYERS_MAX; i++) {
    set_usual(FIELDS_OF(medium), &to->layers[i]);
  }
  for (int i = 0; i < CORE_PROPERTIES_END; i++) {
    to->properties[i] = NAN;
  }
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

COMMAND(use_register) {
  uint16_t *at = (uint16_t *)(void *)((char *)&s->status + command->number);
  unsigned value = 0;
  if (unit->query) {
    answer_integer(s, *at);
    *at = command->forms == TAKE ? 0 : *at;
    return DONE;
  }
  if (!take_integer(s, unit, command->pattern, 0, command->most, &value)) {
    return FAILED;
  }
  *at = (uint16_t)value;
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
  return s->held ? WAITS : unit->query ? add_answer(s, ';', "1") : DONE;
}

COMMAND(reset_settings) {
  UNUSED;
  for (int i = 0; i < SCPI_TASKS; i++) {
    scpi_task_drop(&s->tasks[i]);
  }
  for (int i = 0; i < SCPI_LISTS; i++) {
    http_text_reset(&s->lists[i]);
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
    return add_answer(s, ';', "dipoled,dipoled,0," DIPOLED_VERSION);
  case ERROR:
    return add_answer(s, ';', scpi_status_take(&s->status));
  case VERSION:
    return add_answer(s, ';', "1999.0");
  case STATUS_BYTE:
    return answer_integer(s, scpi_status_byte(&s->status, s->answers.count > 0));
  case HEALTH:
    return answer_integer(s, health_of(s->server) != HEALTH_OK);
  default:
    return answer_integer(s, s->status.count);
  }
}

COMMAND(tell_headers);

/* ---- settings -------------------------------------------------------------------------------- */

COMMAND(use_numbers) {
  struct http_text *list = &s->lists[command->number], *given = &s->lists[SCPI_GIVEN];
  if (unit->query) {
    return answer_values(s, list->bytes, list->count / sizeof(double), false);
  }
  if (!take_list(s, unit)) {
    return FAILED;
  }
  const struct http_text before = *list;
  *list = *given;
  *given = before;
  return DONE;
}

COMMAND(use_medium) {
  struct scpi_settings *settings = &s->settings;
  const bool listed = strchr(command->pattern, '<') != NULL; /* as LAYer<n> */
  const unsigned layer = listed ? unit->number : 1;
  if (layer < 1 || layer > settings->layer_count + !unit->query || layer > CORE_LAYERS_MAX) {
    return fail_with(s, CONFLICT, "MEDium", "a layer that there is, or the next one, up to 8");
  }
  wire_medium *medium = &settings->layers[layer - 1], before = *medium;
  if (!use_structure(s, command, unit, medium) || unit->query) {
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
  (void)command;
  if (unit->query) {
    return add_answer(s, ';', s->settings.named != NULL ? s->settings.named->name : "\"\"");
  }
  if (!take_parameter(s, unit, &parameter) || !took_all(s, unit)) {
    return FAILED;
  }
  const core_measured_medium *all = media_all(&count);
  for (size_t i = 0; i < count; i++) {
    if (strlen(all[i].name) == parameter.bytes &&
        strncasecmp(all[i].name, parameter.text, parameter.bytes) == 0) {
      return use_measured(s, &all[i], 1);
    }
  }
  return fail_with(s, BAD_VALUE, "MEDium:NAME", "a name that `dipole media` lists");
}

COMMAND(use_channel) {
  unsigned channel = 0;
  (void)command;
  if (unit->query) {
    return answer_integer(s, s->settings.channel);
  }
  if (s->settings.named == NULL) {
    return fail_with(s, CONFLICT, "MEDium:CHANnel", "behind MEDium:NAME");
  }
  return take_integer(s, unit, "MEDium:CHANnel", 1, 3, &channel)
             ? use_measured(s, s->settings.named, channel)
             : FAILED;
}

COMMAND(use_parameter) {
  double *at = &s->settings.parameters.value[command->number], value = NAN;
  struct scpi_parameter parameter;
  if (unit->query) {
    return isnan(*at) ? add_answer(s, ';', "OFF") : answer_decimals(s, at, 1, false);
  }
  if (!take_parameter(s, unit, &parameter) || !took_all(s, unit) ||
      (!is_word(&parameter, "OFF") &&
       (!read_number(s, &parameter, NULL, &value) ||
        !is_good(s, job_error(core_parameter_check(command->number, value)))))) {
    return FAILED;
  }
  *at = value;
  return DONE;
}

COMMAND(use_format) {
  static const char *const told[] = {"ASC", "REAL,32", "REAL,64"};
  static const char *const words[] = {"ASCii", "REAL", NULL};
  static const char allowed[] = "ASCii, REAL,32 or REAL,64";
  unsigned bits = 64;
  (void)command;
  if (unit->query) {
    return add_answer(s, ';', told[s->settings.format]);
  }
  const int word = take_word(s, unit, words, "FORMat", allowed);
  if (word < 0 || (word == 1 && unit->more && !take_integer(s, unit, "FORMat", 32, 64, &bits)) ||
      !took_all(s, unit)) {
    return FAILED;
  }
  if (bits != 32 && bits != 64) {
    return fail_with(s, BAD_VALUE, "FORMat", allowed);
  }
  s->settings.format = word == 0 ? SCPI_ASCII : bits == 32 ? SCPI_REAL_32 : SCPI_REAL_64;
  return DONE;
}

COMMAND(use_byte_order) {
  static const char *const words[] = {"NORMal", "SWAPped", NULL};
  (void)command;
  if (unit->query) {
    return add_answer(s, ';', s->settings.swapped ? "SWAP" : "NORM");
  }
  const int word = take_word(s, unit, words, "FORMat:BORDer", "NORMal or SWAPped");
  if (word < 0 || !took_all(s, unit)) {
    return FAILED;
  }
  s->settings.swapped = word == 1;
  return DONE;
}

/* ---- evals ----------------------------------------------------------------------------------- */

/* Makes room for a payload that begins with these structures. Returns NULL if there is none. */
static uint8_t *begin_payload(struct scpi_session *s, enum scpi_task_index index,
                              const schema_payload *payload, const void *start,
                              schema_layout *layout) {
  struct http_text *text = &s->tasks[index].payload;
  uint8_t *bytes = NULL;
  http_text_reset(text);
  if (!schema_lay_out(payload, start, s->server->options.max_frame_bytes, layout, NULL)) {
    fail_with(s, -223, NULL, NULL);
  } else if ((bytes = (uint8_t *)http_text_room(text, (size_t)layout->payload_bytes)) == NULL) {
    fail_with(s, NO_MEMORY, NULL, NULL);
  } else {
    text->count = (size_t)layout->payload_bytes;
    memset(bytes, 0, text->count);
    memcpy(bytes, start, payload->fixed_bytes);
  }
  return bytes;
}

static bool has_medium(struct scpi_session *s) {
  return s->settings.layer_count > 0 ||
         fail_with(s, CONFLICT, "MEDium", "a medium, which has no default");
}

/* Starts a job for which the unit waits. */
static enum outcome wait_for(struct scpi_session *s, const struct scpi_command *command,
                             enum wire_type type) {
  s->waits_for = command;
  scpi_task_start(&s->tasks[SCPI_EVAL], type);
  return WAITS;
}

static enum outcome start_eval(struct scpi_session *s, const struct scpi_command *command,
                               const struct http_text *places) {
  core_parameters parameters = s->settings.parameters;
  wire_eval_request start = s->settings.eval;
  schema_layout layout;
  if (!has_medium(s)) {
    return FAILED;
  }
  if ((command->number & (CORE_QUANTITY_PHASE | CORE_QUANTITY_MODULATION)) == 0) {
    parameters.value[CORE_PARAMETER_MHZ] = NAN;
  }
  start.wanted = (uint32_t)command->number | CORE_QUANTITY_MODEL_ERROR;
  start.layer_count = s->settings.layer_count;
  start.parameter_count = (uint16_t)schema_count_parameters(&parameters);
  start.radius_count = places != NULL ? places->count / sizeof(double) : 0;
  uint8_t *payload = begin_payload(s, SCPI_EVAL, &schema_eval_request, &start, &layout);
  if (payload == NULL) {
    return FAILED;
  }
  schema_put_part(payload, &layout, EVAL_MEDIA, s->settings.layers);
  schema_put_parameters(payload + layout.parts[EVAL_PARAMETERS].at, &parameters);
  const size_t each = core_evaluator_bytes(start.evaluator);
  for (size_t i = 0; i < start.radius_count; i++) {
    const double place = value_at((const uint8_t *)places->bytes, i, false);
    const float narrow = (float)place;
    memcpy(payload + layout.parts[EVAL_RADII].at + i * each,
           each == sizeof narrow ? (const void *)&narrow : (const void *)&place, each);
  }
  return wait_for(s, command, WIRE_TYPE_EVAL);
}

COMMAND(ask_quantity) {
  const bool given = command->parameters[0] != '\0';
  const bool albedo = command->number == CORE_QUANTITY_ALBEDO;
  if (given && !take_list(s, unit)) {
    return FAILED;
  }
  if (!given && !albedo && length_of(s, SCPI_RADII) == 0) {
    return answer_values(s, NULL, 0, false);
  }
  return start_eval(s, command, albedo ? NULL : &s->lists[given ? SCPI_GIVEN : SCPI_RADII]);
}

/* Answers with the values of an eval that has ended, and keeps its errors. */
static void answer_eval(struct scpi_session *s, const struct scpi_command *command) {
  const struct http_text *reply = &s->tasks[SCPI_EVAL].reply;
  const uint8_t *bytes = (const uint8_t *)reply->bytes;
  const unsigned quantity = (unsigned)command->number;
  wire_eval_reply fixed;
  eval_layout layout;
  eval_reply_parse(bytes, reply->count, false, &fixed, &layout);
  wire_get_quantity_error(bytes + eval_error_offset(&layout, fixed.wanted, 0, quantity),
                          &s->errors);
  if (quantity == CORE_QUANTITY_ALBEDO) {
    answer_values(s, bytes + eval_albedo_offset(0), 1, false);
  } else {
    answer_values(s, bytes + eval_array_offset(&layout, fixed.wanted, 0, quantity), fixed.count,
                  core_evaluator_bytes(fixed.evaluator) == sizeof(float));
  }
}

COMMAND(tell_eval_errors) {
  UNUSED;
  return answer_decimals(s, &s->errors, 3, false);
}

/* ---- tissue ---------------------------------------------------------------------------------- */

COMMAND(use_property) {
  struct scpi_parameter parameter;
  double value = NAN;
  (void)command;
  if (!take_parameter(s, unit, &parameter)) {
    return FAILED;
  }
  const core_choice *one = core_properties;
  while (one->name != NULL && (strlen(one->name) != parameter.bytes ||
                               strncasecmp(one->name, parameter.text, parameter.bytes) != 0)) {
    one++;
  }
  if (one->name == NULL) {
    return fail_with(s, BAD_VALUE, "property", "a name of core/TISSUE.md, as hbo2_uM");
  }
  double *property = &s->settings.properties[one->id];
  if (unit->query) {
    return took_all(s, unit) ? answer_decimals(s, property, 1, false) : FAILED;
  }
  if (!take_parameter(s, unit, &parameter) || !took_all(s, unit) ||
      (!is_word(&parameter, "OFF") && !read_number(s, &parameter, NULL, &value))) {
    return FAILED;
  }
  *property = value;
  return DONE;
}

/* Makes the medium of the tissue at a wavelength. */
COMMAND(use_wavelength) {
  struct scpi_parameter parameter;
  wire_tissue_request start = s->settings.tissue;
  schema_layout layout;
  double value;
  if (unit->query) {
    return answer_decimals(s, &s->settings.wavelength_nm, 1, false);
  }
  if (!take_parameter(s, unit, &parameter) || !read_number(s, &parameter, NULL, &value) ||
      !took_all(s, unit)) {
    return FAILED;
  }
  for (int i = 0; i < CORE_PROPERTIES_END; i++) {
    start.property_count += !isnan(s->settings.properties[i]);
  }
  uint8_t *payload = begin_payload(s, SCPI_EVAL, &schema_tissue_request, &start, &layout);
  if (payload == NULL) {
    return FAILED;
  }
  uint8_t *at = payload + layout.parts[0].at;
  for (int i = 0; i < CORE_PROPERTIES_END; i++) {
    const wire_parameter property = {.parameter = (uint16_t)i, .value = s->settings.properties[i]};
    if (!isnan(property.value)) {
      wire_put_parameter(at, &property);
      at += WIRE_BYTES_parameter;
    }
  }
  schema_put_part(payload, &layout, 1, &value);
  s->settings.wavelength_nm = value;
  return wait_for(s, command, WIRE_TYPE_TISSUE);
}

/* Takes the medium of a tissue that has been made. */
static void take_tissue(struct scpi_session *s) {
  const uint8_t *reply = (const uint8_t *)s->tasks[SCPI_EVAL].reply.bytes;
  wire_get_medium(reply + WIRE_BYTES_tissue_reply, &s->settings.layers[0]);
  s->settings.layer_count = 1;
  s->settings.named = NULL;
}

/* ---- overlapped jobs ------------------------------------------------------------------------- */

/* Notes in the status which overlapped jobs are under way, and that all have ended. */
static void note_jobs(struct scpi_session *s) {
  const bool measures = scpi_session_measures(s);
  scpi_status_set(&s->status.operation, measures ? SCPI_OPERATION_MEASURING : 0);
  if (!measures) {
    s->status.events |= s->completes ? SCPI_EVENT_COMPLETE : 0;
    s->completes = s->held = false;
  }
}

static enum outcome start_overlapped(struct scpi_session *s, enum scpi_task_index index,
                                     enum wire_type type) {
  scpi_task_start(&s->tasks[index], type);
  note_jobs(s);
  return DONE;
}

/* Returns whether a job of this kind can be started. */
static bool is_free(struct scpi_session *s, const struct scpi_command *command,
                    const struct scpi_task *task) {
  const bool runs = task->state == SCPI_TASK_RUNS || task->state == SCPI_TASK_ENDS;
  return runs ? fail_with(s, CONFLICT, command->pattern, "when the one that runs has ended")
              : has_medium(s);
}

COMMAND(start_fit) {
  const size_t count = length_of(s, SCPI_PLACES);
  const wire_medium *medium = &s->settings.layers[0];
  fit_start start = s->settings.fit;
  schema_layout layout;
  (void)unit;
  if (!is_free(s, command, &s->tasks[SCPI_FIT])) {
    return FAILED;
  }
  if (s->settings.layer_count > 1) {
    return fail_with(s, CONFLICT, "MEDium", "one layer: its g, eta and thickness");
  }
  if (length_of(s, SCPI_READINGS) != count || length_of(s, SCPI_DEVIATIONS) != count) {
    return fail_with(s, UNEQUAL_LISTS, "FIT", "as many PLACes, READings and ERRors");
  }
  start.design.reading_count = (uint32_t)count;
  start.design.g = medium->g;
  start.design.eta = medium->eta;
  start.design.thickness = medium->thickness;
  uint8_t *payload = begin_payload(s, SCPI_FIT, &schema_fit_request, &start, &layout);
  if (payload == NULL) {
    return FAILED;
  }
  schema_put_part(payload, &layout, FIT_REFERENCE, &s->settings.reference);
  schema_put_part(payload, &layout, FIT_AT, s->lists[SCPI_PLACES].bytes);
  schema_put_part(payload, &layout, FIT_VALUES, s->lists[SCPI_READINGS].bytes);
  schema_put_part(payload, &layout, FIT_ERRORS, s->lists[SCPI_DEVIATIONS].bytes);
  return start_overlapped(s, SCPI_FIT, WIRE_TYPE_FIT);
}

/* Returns the reply of an overlapped job that has ended; notes an error if there is none. */
static const uint8_t *reply_of(struct scpi_session *s, const struct scpi_command *command,
                               enum scpi_task_index index) {
  if (s->tasks[index].state == SCPI_TASK_DONE) {
    return (const uint8_t *)s->tasks[index].reply.bytes;
  }
  fail_with(s, STALE, command->pattern, "when a job has ended: see *OPC?");
  return NULL;
}

/* The schema of a reply, which begins with a structure; then come its parts. */
static const schema_payload *const replies[] = {
    [SCPI_FIT] = &schema_fit_reply, [SCPI_MC] = &schema_mc_reply};

/* Answers with the fields of a part's first structure that `parameters` lists; sd_X is the root of
 * variance_X. */
COMMAND(tell_fields) {
  const uint8_t *reply = reply_of(s, command, command->most);
  double values[sizeof(wire_fitted) / sizeof(double)];
  size_t count = 0, bytes, at;
  schema_layout layout;
  if (reply == NULL || !took_all(s, unit)) {
    return FAILED;
  }
  schema_lay_out(replies[command->most], reply, UINT64_MAX, &layout, NULL);
  reply += layout.parts[command->number].at;
  for (const char *name = command->parameters; *name != '\0';
       name += bytes + strspn(name + bytes, ", ")) {
    char text[HEADER_BYTES];
    const bool root = strncmp(name, "sd_", 3) == 0;
    bytes = strcspn(name, ",");
    snprintf(text, sizeof text, "%s%.*s", root ? "variance_" : "", (int)bytes - 3 * root,
             name + 3 * root);
    const schema_field *field = field_named(command->structure, text, strlen(text), &at);
    const double value = number_at(field, reply + at);
    values[count++] = root ? sqrt(value) : value;
  }
  return answer_values(s, values, count, false);
}

/* Sets the bits of STATus:QUEStionable that a fit which has ended has. */
static void note_fit(struct scpi_session *s) {
  static const uint8_t bits[] = {
      [CORE_FIT_STATUS_AT_BOUND] = 9,     [CORE_FIT_STATUS_UNDETERMINED] = 10,
      [CORE_FIT_STATUS_UNFINISHED] = 10,  [CORE_FIT_STATUS_REFUSED] = 10,
      [CORE_FIT_STATUS_IMPLAUSIBLE] = 11, [CORE_FIT_STATUS_AMBIGUOUS] = 12};
  wire_fitted fitted;
  wire_get_fitted((const uint8_t *)s->tasks[SCPI_FIT].reply.bytes + WIRE_BYTES_fit_reply, &fitted);
  const unsigned bit = fitted.status < sizeof bits ? bits[fitted.status] : 0;
  scpi_status_set(&s->status.questionable, (uint16_t)(bit > 0 ? 1U << bit : 0));
}

COMMAND(start_mc) {
  wire_mc_request start = s->settings.mc;
  schema_layout layout;
  (void)unit;
  if (!is_free(s, command, &s->tasks[SCPI_MC])) {
    return FAILED;
  }
  start.layer_count = s->settings.layer_count;
  uint8_t *payload = begin_payload(s, SCPI_MC, &schema_mc_request, &start, &layout);
  if (payload == NULL) {
    return FAILED;
  }
  schema_put_part(payload, &layout, 0, s->settings.layers);
  return start_overlapped(s, SCPI_MC, WIRE_TYPE_MC);
}

COMMAND(tell_progress) {
  const struct scpi_task *task = &s->tasks[SCPI_MC];
  wire_mc_reply reply = {.photons_expected = s->settings.mc.photons, .error_total = INFINITY};
  (void)unit;
  if (task->state == SCPI_TASK_NONE) {
    reply_of(s, command, SCPI_MC);
    return FAILED;
  }
  if (task->reply.count >= WIRE_BYTES_mc_reply) {
    wire_get_mc_reply((const uint8_t *)task->reply.bytes, &reply);
  }
  const double values[] = {(double)reply.photons, (double)reply.photons_expected, reply.error_total,
                           reply.state};
  return answer_decimals(s, values, 4, false);
}

enum { MC_VALUES, MC_DEVIATIONS, MC_EDGES };

COMMAND(tell_mc) {
  wire_mc_reply fixed;
  mc_layout layout;
  unsigned side = 1;
  const uint8_t *reply = reply_of(s, command, SCPI_MC);
  if (reply == NULL) {
    return FAILED;
  }
  mc_reply_parse(reply, s->tasks[SCPI_MC].reply.count, &fixed, &layout);
  if (command->number == MC_EDGES) {
    return answer_values(s, reply + layout.edges_offset, fixed.ring_count + 1, false);
  }
  if (unit->at < unit->end &&
      !take_integer(s, unit, command->pattern, 1, fixed.side_count, &side)) {
    return FAILED;
  }
  return answer_values(s,
                       reply + mc_rings_offset(&layout, fixed.side_count, fixed.ring_count, 0,
                                               side - 1, command->number == MC_DEVIATIONS),
                       fixed.ring_count, false);
}

/* Ends a job: Monte Carlo soon, with its results so far. */
static void stop_job(struct scpi_task *task, enum job_stop why) {
  if (task->state == SCPI_TASK_RUNS && task->run.state != RUN_IDLE &&
      task->run.job->kind->stop != NULL) {
    task->run.job->kind->stop(task->run.job, why);
  } else if (task->state == SCPI_TASK_RUNS) {
    scpi_task_drop(task);
  }
}

COMMAND(abort_job) {
  (void)unit;
  stop_job(&s->tasks[command->number], JOB_CANCELLED);
  note_jobs(s);
  return DONE;
}

/* ---- the list -------------------------------------------------------------------------------- */

static const struct scpi_command commands[] = {
#define SCPI_COMMAND(pattern, FORMS, function, number, parameters, about)                          \
  {pattern, FORMS, function, number, 0, NULL, parameters},
#define SCPI_REGISTER(pattern, FORMS, member, most, about)                                         \
  {pattern, FORMS, use_register, offsetof(struct scpi_status, member), most, NULL, "<n>"},
#define SCPI_FIELDS(pattern, function, member, structure, parameters, about)                       \
  {pattern,   BOTH, function, offsetof(struct scpi_settings, member), 0, FIELDS_OF(structure),     \
   parameters},
#define SCPI_NUMBERS(pattern, FORMS, LIST, parameters, about)                                      \
  {pattern, FORMS, use_numbers, SCPI_##LIST, 0, NULL, parameters},
#define SCPI_QUANTITY(pattern, QUANTITY, parameters, about)                                        \
  {pattern, QUERY, ask_quantity, CORE_QUANTITY_##QUANTITY, 0, NULL, parameters},
#define SCPI_REPLY(pattern, TASK, part, structure, fields)                                         \
  {pattern, QUERY, tell_fields, part, SCPI_##TASK, FIELDS_OF(structure), fields},
#include "proto/scpi.def"
};

enum { COMMANDS = sizeof commands / sizeof commands[0] };

COMMAND(tell_headers) {
  UNUSED;
  struct http_text list;
  char head[32];
  http_text_init(&list, &s->server->buffers);
  for (const struct scpi_command *one = commands; one < commands + COMMANDS; one++) {
    const char *forms = one->forms == SET ? "/nquery/\n" : one->forms == BOTH ? "\n" : "/qonly/\n";
    http_text_add(&list, ":", one->pattern[0] != '*');
    http_text_add(&list, one->pattern, strlen(one->pattern));
    http_text_add(&list, forms, strlen(forms));
  }
  const int digits = snprintf(head, sizeof head, "%zu", list.count);
  snprintf(head, sizeof head, "#%d%zu", digits, list.count);
  add_answer(s, ';', head);
  http_text_add(&s->answers, list.bytes, list.count);
  http_text_free(&list);
  return DONE;
}

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
  http_text_init(&s->answers, &server->buffers);
  for (int i = 0; i < SCPI_LISTS; i++) {
    http_text_init(&s->lists[i], &server->buffers);
  }
  for (int i = 0; i < SCPI_TASKS; i++) {
    scpi_task_init(&s->tasks[i], s);
  }
  set_defaults(&s->settings);
}

void scpi_session_free(struct scpi_session *s) {
  http_text_free(&s->answers);
  for (int i = 0; i < SCPI_LISTS; i++) {
    http_text_free(&s->lists[i]);
  }
  for (int i = 0; i < SCPI_TASKS; i++) {
    http_text_free(&s->tasks[i].payload);
    http_text_free(&s->tasks[i].reply);
  }
}

bool scpi_session_measures(const struct scpi_session *s) {
  bool measures = false;
  for (int i = SCPI_FIT; i < SCPI_TASKS; i++) {
    measures |= s->tasks[i].state == SCPI_TASK_RUNS || s->tasks[i].state == SCPI_TASK_ENDS;
  }
  return measures;
}

static enum outcome carry_out(struct scpi_session *s, struct scpi_unit *unit) {
  const struct scpi_command *command = command_of(s, unit);
  if (command == NULL) {
    char header[HEADER_BYTES + 2];
    const int most = (int)(unit->header_bytes < HEADER_BYTES ? unit->header_bytes : HEADER_BYTES);
    snprintf(header, sizeof header, "%.*s%s", most, unit->header, unit->query ? "?" : "");
    return fail_with(s, UNDEFINED_HEADER, header, NULL);
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
  if (outcome == WAITS) {
    *at = s->held ? *at : next;
    return true;
  }
  *at = next;
  return outcome == DONE && next < count;
}

void scpi_session_end_message(struct scpi_session *s) {
  if (s->answers.failed) {
    http_text_free(&s->answers);
    fail_with(s, NO_MEMORY, NULL, NULL);
  }
  http_text_add(&s->answers, "\n", s->answers.count > 0);
}

void scpi_session_run(struct scpi_session *s, uint64_t *budget) {
  for (int i = 0; i < SCPI_TASKS; i++) {
    struct run *run = &s->tasks[i].run;
    run_on(run, budget);
    if (run->state == RUN_GOES_ON || run->state == RUN_HAS_PART) {
      worker_run_later(s->client);
    }
  }
}

bool scpi_session_finish(struct scpi_session *s) {
  bool good = true;
  for (int i = 0; i < SCPI_TASKS; i++) {
    struct scpi_task *task = &s->tasks[i];
    if (task->state != SCPI_TASK_ENDS) {
      continue;
    }
    const bool refused = task->error.status != WIRE_STATUS_OK;
    task->state = refused ? SCPI_TASK_NONE : SCPI_TASK_DONE;
    http_text_reset(&task->payload);
    if (refused) {
      scpi_status_refuse(&s->status, &task->error);
    } else if (i == SCPI_EVAL && s->waits_for->carry_out == use_wavelength) {
      take_tissue(s);
    } else if (i == SCPI_EVAL) {
      answer_eval(s, s->waits_for);
    } else if (i == SCPI_FIT) {
      note_fit(s);
    }
    if (i == SCPI_EVAL) {
      good = !refused;
      s->waits_for = NULL;
      http_text_reset(&task->reply);
    }
    note_jobs(s);
  }
  return good;
}

void scpi_session_stop(struct scpi_session *s, bool all) {
  for (int i = SCPI_FIT; i < SCPI_TASKS; i++) {
    if (all) {
      scpi_task_drop(&s->tasks[i]);
    } else if (i == SCPI_MC) {
      stop_job(&s->tasks[i], JOB_DAEMON_STOPS);
    }
  }
  note_jobs(s);
}

#include "server/http/openapi.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/varying.h"
#include "server/http/question.h"

#define REFERENCE(name) "{\"$ref\":\"#/components/schemas/" name "\"}"
#define NUMBER REFERENCE("Number")
#define FIELDS(structure) (schema_structures[SCHEMA_STRUCTURE_##structure].fields)

static const schema_payload header = {.structures = {&schema_structures[SCHEMA_STRUCTURE_header]}};

/* ---- schemas --------------------------------------------------------------------------------- */

static void write_names(struct http_text *text, const core_choice *list) {
  http_text_begin(text, "enum", '[');
  for (; list->name != NULL; list++) {
    http_text_string(text, NULL, list->name);
  }
  http_text_end(text, ']');
}

/* Writes the members of the schema for the names of a list. */
static void write_choice(struct http_text *text, const core_choice *list, bool bits) {
  http_text_string(text, "type", bits ? "array" : "string");
  if (bits) {
    http_text_begin(text, "items", '{');
    http_text_string(text, "type", "string");
    write_names(text, list);
    http_text_end(text, '}');
  } else {
    write_names(text, list);
  }
}

static void write_scalar(struct http_text *text, enum schema_kind kind) {
  switch (kind) {
  case SCHEMA_f64:
    http_text_raw(text, "allOf", "[" NUMBER "]");
    break;
  case SCHEMA_u64:
    http_text_raw(text, "oneOf",
                  "[{\"type\":\"integer\",\"minimum\":0},{\"type\":\"string\",\"pattern\":"
                  "\"^[0-9]{1,20}$\"}]");
    break;
  case SCHEMA_u16:
  case SCHEMA_u32:
    http_text_string(text, "type", "integer");
    break;
  default:
    http_text_string(text, "type", "string");
    break;
  }
}

static void write_description(struct http_text *text, const char *unit, const char *meaning) {
  char both[256];
  snprintf(both, sizeof both, "%s%s%s", unit != NULL ? unit : "",
           unit != NULL && meaning[0] != '\0' ? "; " : "", meaning);
  if (both[0] != '\0') {
    http_text_string(text, "description", both);
  }
}

/* Returns whether what holds for a choice that a request leaves out depends on others (question.c). */
static bool depends_on_others(const schema_field *field) {
  return field->bits || field->or_zero || field->list == core_models ||
         field->list == core_evaluators || field->list == core_spacings;
}

/* Writes what holds for a field of a request. */
static void write_attributes(struct http_text *text, const schema_field *field) {
  if (field->list != NULL && field->usual > 0 && !depends_on_others(field)) {
    http_text_string(text, "default", core_choice_by_id(field->list, (unsigned)field->usual)->name);
  } else if (field->list == NULL && field->kind != SCHEMA_u64 && !field->required) {
    http_text_number(text, "default", field->usual);
  }
  if (field->spans && field->list == NULL) {
    http_text_number(text, "minimum", field->or_zero ? 0 : field->least);
    if (isfinite(field->most)) {
      http_text_number(text, "maximum", field->most);
    }
  }
}

static void write_members(struct http_text *text, const schema_field *field) {
  if (field->list != NULL) {
    write_choice(text, field->list, field->bits);
  } else if (schema_is_name(field)) {
    http_text_string(text, "type", "string");
    http_text_string(text, "pattern", "^[0-9a-f]{32}$");
  } else if (field->kind == SCHEMA_text || field->count == 1) {
    write_scalar(text, field->kind);
  } else {
    http_text_string(text, "type", "array");
    http_text_begin(text, "items", '{');
    write_scalar(text, field->kind);
    http_text_end(text, '}');
  }
  write_description(text, field->unit, field->meaning);
}

static void write_property(struct http_text *text, const schema_field *field) {
  http_text_begin(text, field->name, '{');
  write_members(text, field);
  http_text_end(text, '}');
}

static void write_properties(struct http_text *text, const schema_field *fields) {
  for (; fields->name != NULL; fields++) {
    if (!fields->hidden) {
      write_property(text, fields);
    }
  }
}

static void begin_object(struct http_text *text, const char *name) {
  http_text_begin(text, name, '{');
  http_text_string(text, "type", "object");
  http_text_begin(text, "properties", '{');
}

static void end_object(struct http_text *text) {
  http_text_end(text, '}');
  http_text_end(text, '}');
}

static void write_list(struct http_text *text, const char *name, const char *items,
                       const char *description) {
  http_text_begin(text, name, '{');
  http_text_string(text, "type", "array");
  http_text_raw(text, "items", items);
  if (description != NULL) {
    http_text_string(text, "description", description);
  }
  http_text_end(text, '}');
}

static void write_units(struct http_text *text) {
  http_text_raw(text, "units",
                "{\"type\":\"object\",\"additionalProperties\":{\"type\":\"string\"}}");
}

/* ---- what a request says --------------------------------------------------------------------- */

/* Calls write() for each field of a request, with its name, and with the members of its schema to
 * be written by write_request_field(). */
struct request_field {
  const char *name;
  const schema_field *field;    /* a field of a structure, or NULL */
  const core_choice *parameter; /* else a parameter, or NULL */
  const char *description;      /* else a list of numbers, or of media */
};

enum { REQUEST_FIELDS_MAX = 64 };

/* Fills in the fields that a request may have. Returns how many there are. */
static size_t list_request_fields(const schema_message *message,
                                  struct request_field fields[REQUEST_FIELDS_MAX]) {
  const schema_payload *request = message->request;
  const schema_field *field;
  const schema_part *part;
  const char *name;
  size_t count = 0;
  for (unsigned i = 0; (field = http_question_fields(request, i)) != NULL; i++) {
    for (; field->name != NULL; field++) {
      if (!field->hidden) {
        fields[count++] = (struct request_field){field->name, field, NULL, NULL};
      }
    }
  }
  if (message->type == WIRE_TYPE_FIT) {
    fields[count++] =
        (struct request_field){"reference", NULL, NULL, "the known medium, with scale reference"};
  }
  for (unsigned i = 0; (part = http_question_list(request, i, &name)) != NULL; i++) {
    fields[count++] = (struct request_field){name, NULL, NULL, part->about};
  }
  if (http_question_media(request) > 0) {
    fields[count++] = (struct request_field){
        "medium", NULL, NULL, "names of /v1/media, of three channels each; else the coefficients"};
    for (field = FIELDS(medium); field->name != NULL; field++) {
      fields[count++] = (struct request_field){field->name, NULL, NULL, field->meaning};
    }
  }
  for (const core_choice *one = core_parameter_list;
       http_question_has_parameters(request) && one->name != NULL; one++) {
    if (schema_field_of(request, one->name) == NULL) {
      fields[count++] = (struct request_field){one->name, NULL, one, NULL};
    }
  }
  fields[count++] =
      (struct request_field){"deadline_ms", schema_field_of(&header, "deadline_ms"), NULL, NULL};
  return count;
}

static void write_request_field(struct http_text *text, const struct request_field *field) {
  if (field->field != NULL) {
    write_members(text, field->field);
    write_attributes(text, field->field);
  } else if (field->parameter != NULL) {
    write_scalar(text, SCHEMA_f64);
    http_text_string(text, "description", field->parameter->about);
  } else {
    http_text_string(text, "type", "array");
    http_text_raw(text, "items", strcmp(field->name, "medium") == 0 ? REFERENCE("Medium") : NUMBER);
    http_text_string(text, "description", field->description);
  }
}

/* ---- paths ----------------------------------------------------------------------------------- */

static void write_responses(struct http_text *text, const char *schema) {
  static const struct {
    const char *status;
    const char *meaning;
  } faults[] = {{"400", "a field is wrong"},
                {"404", "the daemon does not have the set of points: send it to /v1/points"},
                {"413", "the request or the reply is too large for HTTP"},
                {"429", "the daemon is at a limit; Retry-After says when to try again"},
                {"503", "the daemon stops, or the deadline has passed"}};
  http_text_begin(text, "responses", '{');
  http_text_begin(text, "200", '{');
  http_text_string(text, "description", "the answer");
  http_text_raw(text, "content", "{\"application/json\":{\"schema\":");
  http_text_add(text, schema, strlen(schema));
  http_text_add(text, "}}", 2);
  http_text_end(text, '}');
  for (size_t i = 0; i < sizeof faults / sizeof faults[0]; i++) {
    http_text_begin(text, faults[i].status, '{');
    http_text_string(text, "description", faults[i].meaning);
    http_text_raw(text, "content", "{\"application/json\":{\"schema\":" REFERENCE("Error") "}}");
    http_text_end(text, '}');
  }
  http_text_end(text, '}');
}

static void write_get(struct http_text *text, const schema_message *message, const char *schema) {
  struct request_field fields[REQUEST_FIELDS_MAX];
  const size_t count = list_request_fields(message, fields);
  char id[32];
  snprintf(id, sizeof id, "get_%s", message->name);
  http_text_begin(text, "get", '{');
  http_text_string(text, "operationId", id);
  http_text_string(text, "summary", message->about);
  http_text_begin(text, "parameters", '[');
  for (size_t i = 0; i < count; i++) {
    http_text_begin(text, NULL, '{');
    http_text_string(text, "name", fields[i].name);
    http_text_string(text, "in", "query");
    http_text_string(text, "style", "form");
    http_text_bool(text, "explode", false);
    http_text_begin(text, "schema", '{');
    if (strcmp(fields[i].name, "medium") == 0) {
      http_text_raw(text, "type", "\"array\",\"items\":{\"type\":\"string\"}");
    } else {
      write_request_field(text, &fields[i]);
    }
    http_text_end(text, '}');
    http_text_end(text, '}');
  }
  http_text_end(text, ']');
  write_responses(text, schema);
  http_text_end(text, '}');
}

static void write_message(struct http_text *text, const schema_message *message) {
  const char *name = message->name;
  char path[40], schema[80], body[80];
  snprintf(path, sizeof path, "/v1/%s", name);
  snprintf(schema, sizeof schema, REFERENCE("%s_reply"), name);
  snprintf(body, sizeof body, REFERENCE("%s_request"), name);
  http_text_begin(text, path, '{');
  write_get(text, message, schema);
  http_text_begin(text, "post", '{');
  http_text_string(text, "operationId", name);
  http_text_string(text, "summary", message->about);
  http_text_begin(text, "requestBody", '{');
  http_text_bool(text, "required", true);
  http_text_raw(text, "content", "{\"application/json\":{\"schema\":");
  http_text_add(text, body, strlen(body));
  http_text_add(text, "}}", 2);
  http_text_end(text, '}');
  write_responses(text, schema);
  http_text_end(text, '}');
  http_text_end(text, '}');
}

static void write_list_path(struct http_text *text, const char *path, const char *id,
                            const char *summary) {
  http_text_begin(text, path, '{');
  http_text_begin(text, "get", '{');
  http_text_string(text, "operationId", id);
  http_text_string(text, "summary", summary);
  write_responses(text, "{\"type\":\"object\"}");
  http_text_end(text, '}');
  http_text_end(text, '}');
}

/* ---- components ------------------------------------------------------------------------------ */

static void write_request_schema(struct http_text *text, const schema_message *message) {
  struct request_field fields[REQUEST_FIELDS_MAX];
  const size_t count = list_request_fields(message, fields);
  char name[32];
  snprintf(name, sizeof name, "%s_request", message->name);
  begin_object(text, name);
  for (size_t i = 0; i < count; i++) {
    http_text_begin(text, fields[i].name, '{');
    write_request_field(text, &fields[i]);
    http_text_end(text, '}');
  }
  http_text_end(text, '}');
  http_text_bool(text, "additionalProperties", false);
  http_text_end(text, '}');
}

/* Writes the schemas of arrays of numbers, with the names of a list. */
static void write_choice_lists(struct http_text *text, const core_choice *list) {
  for (; list->name != NULL; list++) {
    write_list(text, list->name, NUMBER, list->about);
  }
}

static void write_reply_schema(struct http_text *text, const schema_message *message) {
  char name[32];
  snprintf(name, sizeof name, "%s_reply", message->name);
  begin_object(text, name);
  const schema_field *fields = message->reply->structures[0]->fields;
  write_properties(text, fields);
  if (message->reply->parts[0].name != NULL) {
    write_units(text);
  }
  if (fields == FIELDS(eval_reply)) {
    write_list(text, "r", NUMBER, "mm; the radii of an eval, if they are wanted");
    write_list(text, "channels", REFERENCE("Channel"), NULL);
  } else if (fields == FIELDS(gather_reply)) {
    write_list(text, "channels", REFERENCE("Gathered"), NULL);
  } else if (fields == FIELDS(fit_reply)) {
    http_text_raw(text, "g", NUMBER);
    http_text_raw(text, "g_is_default", "{\"type\":\"boolean\"}");
    http_text_raw(text, "eta", NUMBER);
    write_list(text, "sets", REFERENCE("Fitted"), NULL);
  } else if (fields == FIELDS(varying_reply)) {
    write_choice_lists(text, core_coefficients);
    write_choice_lists(text, core_quantities);
    http_text_begin(text, "statuses", '{');
    http_text_string(text, "type", "array");
    http_text_begin(text, "items", '{');
    write_choice(text, core_value_statuses, false);
    http_text_end(text, '}');
    http_text_end(text, '}');
  } else if (fields != FIELDS(table_reply)) {
    for (const schema_part *part = message->reply->parts; part->name != NULL; part++) {
      write_list(text, part->name, part->kind == SCHEMA_LIST ? REFERENCE("Offer") : NUMBER,
                 part->about);
    }
  } else {
    http_text_raw(text, "parameters", "{\"type\":\"object\"}");
    write_list(text, "words", "{\"type\":\"integer\"}", "32 bits each");
  }
  end_object(text);
}

static void write_channel_schema(struct http_text *text) {
  begin_object(text, "Channel");
  write_properties(text, FIELDS(medium));
  http_text_raw(text, "albedo", NUMBER);
  http_text_raw(text, "errors",
                "{\"type\":\"object\",\"description\":\"of each wanted quantity\","
                "\"additionalProperties\":" REFERENCE("Errors") "}");
  for (const core_choice *one = core_quantities; one->name != NULL; one++) {
    if (one->id != CORE_QUANTITY_ALBEDO && one->id != CORE_QUANTITY_MODEL_ERROR) {
      write_list(text, one->name, NUMBER, one->about);
    }
  }
  end_object(text);
}

static void write_components(struct http_text *text) {
  http_text_begin(text, "components", '{');
  http_text_begin(text, "schemas", '{');
  http_text_raw(text, "Number",
                "{\"nullable\":true,\"description\":\"A number; infinities are texts. In answers, "
                "null is a number that is not known.\",\"oneOf\":[{\"type\":\"number\"},"
                "{\"type\":\"string\",\"enum\":[\"inf\",\"-inf\"]}]}");
  http_text_raw(text, "Medium",
                "{\"oneOf\":[{\"type\":\"string\"}," REFERENCE("Coefficients") "]}");
  begin_object(text, "Coefficients");
  write_properties(text, FIELDS(medium));
  end_object(text);
  begin_object(text, "Error");
  http_text_raw(text, "text", "{\"type\":\"string\"}");
  for (const schema_field *field = FIELDS(error); field->name != NULL; field++) {
    if (strcmp(field->name, "status") == 0) {
      http_text_raw(text, "status", "{\"type\":\"string\"}");
    } else if (!field->hidden) {
      write_property(text, field);
    }
  }
  end_object(text);
  http_text_raw(text, "Readings",
                "{\"oneOf\":[" NUMBER ",{\"type\":\"array\",\"items\":" NUMBER "}]}");
  begin_object(text, "Fitted");
  write_properties(text, FIELDS(fitted));
  write_list(text, "residuals", NUMBER, "of the readings, if they are wanted");
  end_object(text);
  begin_object(text, "Errors");
  write_properties(text, FIELDS(quantity_error));
  end_object(text);
  begin_object(text, "Gathered");
  write_properties(text, FIELDS(medium));
  write_properties(text, FIELDS(quantity_error));
  write_list(text, "M", NUMBER, "W/mm^2; the sums, in the order of the positions");
  end_object(text);
  begin_object(text, "Offer");
  write_properties(text, FIELDS(offer));
  end_object(text);
  write_channel_schema(text);
  for (const schema_message *one = schema_messages; one->type != 0; one++) {
    if (one->about != NULL) {
      write_request_schema(text, one);
      write_reply_schema(text, one);
    }
  }
  http_text_end(text, '}');
  http_text_end(text, '}');
}

void http_openapi_write(struct http_text *text) {
  http_text_begin(text, NULL, '{');
  http_text_string(text, "openapi", "3.0.3");
  http_text_begin(text, "info", '{');
  http_text_string(text, "title", "dipoled");
  http_text_string(text, "version", DIPOLED_VERSION);
  http_text_string(text, "description",
                   "Evaluates subsurface-scattering profiles R(r). Fields, limits and errors are "
                   "those of the binary protocol (PROTOCOL.md).");
  http_text_end(text, '}');
  http_text_raw(text, "servers", "[{\"url\":\"/\"}]");
  http_text_begin(text, "paths", '{');
  for (const schema_message *one = schema_messages; one->type != 0; one++) {
    if (one->about != NULL) {
      write_message(text, one);
    }
  }
  write_list_path(text, "/v1/models", "models",
                  "Lists models, evaluators, parameters and the other choices, and the limits");
  write_list_path(text, "/v1/media", "media", "Lists the measured media");
  write_list_path(text, "/v1/openapi.json", "openapi", "This document");
  write_list_path(text, "/healthz", "health", "Whether the daemon serves; 503 if not");
  write_list_path(text, "/readyz", "readiness",
                  "Whether the daemon serves and has capacity for more clients; 503 if not");
  http_text_end(text, '}');
  write_components(text);
  http_text_end(text, '}');
}

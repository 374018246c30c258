#include "server/http/openapi.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "core/varying.h"
#include "server/http/request.h"

#define REFERENCE(name) "{'$ref':'#/components/schemas/" name "'}"
#define NUMBER REFERENCE("Number")
#define STRING "{'type':'string'}"
#define FIELDS(structure) (schema_structures[SCHEMA_STRUCTURE_##structure].fields)

/* Adds JSON, where ' stands for ", %s for a name and %t for a text. A comma that would come first in
 * an object or an array is left out. */
static void put_json(struct text *text, const char *form, ...) {
  va_list arguments;
  va_start(arguments, form);
  const char last = text->count > 0 ? text->bytes[text->count - 1] : '{';
  form += form[0] == ',' && (last == '{' || last == '[');
  for (; *form != '\0'; form++) {
    if (*form != '%') {
      text_add(text, *form == '\'' ? "\"" : form, 1);
    } else if (*++form == 's') {
      const char *name = va_arg(arguments, const char *);
      text_add(text, name, strlen(name));
    } else {
      text->filled = false;
      const char *string = va_arg(arguments, const char *);
      http_text_string(text, NULL, string != NULL ? string : "");
    }
  }
  va_end(arguments);
}

/* ---- schemas --------------------------------------------------------------------------------- */

/* Adds the members of the schema for the names of a list. */
static void put_choice(struct text *text, const core_choice *list, bool bits) {
  put_json(text, bits ? ",'type':'array','items':{'type':'string','enum':["
                      : ",'type':'string','enum':[");
  for (; list->name != NULL; list++) {
    put_json(text, ",%t", list->name);
  }
  put_json(text, bits ? "]}" : "]");
}

static void put_kind(struct text *text, enum schema_kind kind) {
  put_json(text, kind == SCHEMA_f64   ? ",'allOf':[" NUMBER "]"
                 : kind == SCHEMA_u64 ? ",'oneOf':[{'type':'integer','minimum':0},"
                                        "{'type':'string','pattern':'^[0-9]{1,20}$'}]"
                 : kind == SCHEMA_u16 || kind == SCHEMA_u32 ? ",'type':'integer'"
                                                            : ",'type':'string'");
}

/* Returns whether what holds for a choice that a request leaves out depends on others (request.c). */
static bool depends_on_others(const schema_field *field) {
  return field->bits || field->or_zero || field->list == core_models ||
         field->list == core_evaluators || field->list == core_spacings;
}

static void put_number(struct text *text, const char *key, double number) {
  text->filled = true;
  http_text_number(text, key, number);
}

/* Adds the default and the range of a field of a request. */
static void put_attributes(struct text *text, const schema_field *field) {
  if (field->list != NULL && field->usual > 0 && !depends_on_others(field)) {
    put_json(text, ",'default':%t", core_choice_by_id(field->list, (unsigned)field->usual)->name);
  } else if (field->list == NULL && field->kind != SCHEMA_u64 && !field->required) {
    put_number(text, "default", field->usual);
  }
  if (field->spans && field->list == NULL) {
    put_number(text, "minimum", field->or_zero ? 0 : field->least);
    if (isfinite(field->most)) {
      put_number(text, "maximum", field->most);
    }
  }
}

static void put_members(struct text *text, const schema_field *field) {
  const bool is_array = field->count > 1 && field->kind != SCHEMA_text;
  char description[256];
  if (field->list != NULL) {
    put_choice(text, field->list, field->bits);
  } else if (schema_is_name(field)) {
    put_json(text, ",'type':'string','pattern':'^[0-9a-f]{32}$'");
  } else {
    put_json(text, is_array ? ",'type':'array','items':{" : "");
    put_kind(text, field->kind);
    put_json(text, is_array ? "}" : "");
  }
  snprintf(description, sizeof description, "%s%s%s", field->unit != NULL ? field->unit : "",
           field->unit != NULL && field->meaning[0] != '\0' ? "; " : "", field->meaning);
  if (description[0] != '\0') {
    put_json(text, ",'description':%t", description);
  }
}

static void put_properties(struct text *text, const schema_field *fields) {
  for (; fields->name != NULL; fields++) {
    if (!fields->hidden) {
      put_json(text, ",'%s':{", fields->name);
      put_members(text, fields);
      put_json(text, "}");
    }
  }
}

static void begin_object(struct text *text, const char *name, const char *suffix) {
  put_json(text, ",'%s%s':{'type':'object','properties':{", name, suffix);
}

static void put_object(struct text *text, const char *name, const schema_field *fields) {
  begin_object(text, name, "");
  put_properties(text, fields);
  put_json(text, "}}");
}

static void put_list(struct text *text, const char *name, const char *items,
                     const char *description) {
  put_json(text, ",'%s':{'type':'array','items':", name);
  put_json(text, items);
  put_json(text, ",'description':%t}", description);
}

/* ---- what a request says --------------------------------------------------------------------- */

/* Begins the schema of a request's field, or adds the parameter of a query that refers to it and returns
 * false. */
static bool begin_field(struct text *text, const schema_message *message, bool in_query,
                        const char *name) {
  if (!in_query) {
    put_json(text, ",'%s':{", name);
    return true;
  }
  put_json(text, ",{'name':'%s','in':'query','style':'form','explode':false,'schema':", name);
  if (strcmp(name, "medium") == 0) {
    put_json(text, "{'type':'array','items':" STRING "}}");
  } else {
    put_json(text, "{'$ref':'#/components/schemas/%s_request/properties/%s'}}", message->name,
             name);
  }
  return false;
}

static void put_field(struct text *text, const schema_message *message, bool in_query,
                      const schema_field *field) {
  if (begin_field(text, message, in_query, field->name)) {
    put_members(text, field);
    put_attributes(text, field);
    put_json(text, "}");
  }
}

static void put_list_field(struct text *text, const schema_message *message, bool in_query,
                           const char *name, const char *items, const char *description) {
  if (begin_field(text, message, in_query, name)) {
    put_json(text, "'type':'array','items':");
    put_json(text, items);
    put_json(text, ",'description':%t}", description);
  }
}

/* Adds the fields that a request may have: to a body's schema, or as parameters of a query. */
static void put_request(struct text *text, const schema_message *message, bool in_query) {
  static const schema_payload header = {
      .structures = {&schema_structures[SCHEMA_STRUCTURE_header]}};
  const schema_payload *request = message->request;
  const schema_field *field;
  const schema_part *part;
  const char *name;
  for (int i = 0; i < 2 && request->structures[i] != NULL; i++) {
    for (field = request->structures[i]->fields; field->name != NULL; field++) {
      if (!field->hidden) {
        put_field(text, message, in_query, field);
      }
    }
  }
  if (message->type == WIRE_TYPE_FIT && begin_field(text, message, in_query, "reference")) {
    put_json(text, "'allOf':[" REFERENCE(
                       "Coefficients") "],"
                                       "'description':'the known medium, with scale reference'}");
  }
  if (message->type == WIRE_TYPE_FIT_TISSUE) {
    put_list_field(text, message, in_query, "sought",
                   "{'oneOf':[" STRING "," REFERENCE("Sought") "]}",
                   "names of properties, or limits with them");
  }
  for (unsigned i = 0; (part = http_request_list(request, i, &name)) != NULL; i++) {
    put_list_field(text, message, in_query, name, NUMBER, part->about);
  }
  if (http_request_media(request) > 0) {
    put_list_field(
        text, message, in_query, "medium", REFERENCE("Medium"),
        "names of /v1/media, of three channels each; else coefficients, or lists of layers");
    for (field = FIELDS(medium); field->name != NULL; field++) {
      put_list_field(text, message, in_query, field->name, NUMBER, field->meaning);
    }
  }
  for (const core_choice *one = http_request_numbers(request); one->name != NULL; one++) {
    if (schema_field_of(request, one->name) == NULL &&
        begin_field(text, message, in_query, one->name)) {
      put_kind(text, SCHEMA_f64);
      put_json(text, ",'description':%t}", one->about);
    }
  }
  put_field(text, message, in_query, schema_field_of(&header, "deadline_ms"));
}

/* ---- paths and replies ----------------------------------------------------------------------- */

#define REPLIES(schema)                                                                            \
  ",'responses':{'200':{'description':'the "                                                       \
  "reply','content':{'application/json':{'schema':" schema                                         \
  "}}},'default':{'$ref':'#/components/responses/Error'}}}"

static void put_path(struct text *text, const schema_message *message) {
  const char *name = message->name;
  put_json(text, ",'/v1/%s':{'get':{'operationId':'get_%s','summary':%t,'parameters':[", name, name,
           message->about);
  put_request(text, message, true);
  put_json(text, "]" REPLIES(REFERENCE("%s_reply")), name);
  put_json(text,
           ",'post':{'operationId':'%s','summary':%t,'requestBody':{'required':true,'content':"
           "{'application/json':{'schema':" REFERENCE("%s_request") "}}}" REPLIES(
               REFERENCE("%s_reply")) "}",
           name, message->about, name, name);
}

static void put_list_path(struct text *text, const char *path, const char *id,
                          const char *summary) {
  put_json(text, ",'%s':{'get':{'operationId':'%s','summary':%t" REPLIES("{'type':'object'}") "}",
           path, id, summary);
}

/* Adds arrays of numbers with the names of a list. */
static void put_arrays(struct text *text, const core_choice *list) {
  for (; list->name != NULL; list++) {
    put_list(text, list->name, NUMBER, list->about);
  }
}

/* Adds the medium of a channel. */
static void put_medium(struct text *text) {
  put_properties(text, FIELDS(medium));
  put_list(text, "layers", REFERENCE("Coefficients"), "of several layers, in place of these");
}

/* Adds what a reply has besides its fields. */
static void put_reply_parts(struct text *text, const schema_payload *reply) {
  const schema_field *fields = reply->structures[0]->fields;
  if (fields == FIELDS(eval_reply)) {
    put_list(text, "r", NUMBER, "mm; the radii of an eval, if they are wanted");
    put_list(text, "channels", REFERENCE("Channel"), "one for each medium");
  } else if (fields == FIELDS(gather_reply)) {
    put_list(text, "channels", REFERENCE("Gathered"), "one for each medium");
  } else if (fields == FIELDS(fit_reply)) {
    put_json(text, ",'g':" NUMBER ",'g_is_default':{'type':'boolean'},'eta':" NUMBER);
    put_list(text, "sets", REFERENCE("Fitted"), "one for each set of readings");
  } else if (fields == FIELDS(varying_reply)) {
    put_arrays(text, core_coefficients);
    put_arrays(text, core_quantities);
    put_json(text, ",'statuses':{'type':'array','items':{");
    put_choice(text, core_value_statuses, false);
    put_json(text, "}}");
  } else if (fields == FIELDS(table_reply)) {
    put_medium(text);
    put_json(text, ",'parameters':{'type':'object'}");
    put_list(text, "words", "{'type':'integer'}", "32 bits each");
  } else {
    for (const schema_part *part = reply->parts; part->name != NULL; part++) {
      const bool numbers = part->kind != SCHEMA_LIST;
      put_json(text, ",'%s':{'type':'array','items':", part->name);
      put_json(text, numbers ? NUMBER : REFERENCE("%s"), numbers ? NULL : part->structure->name);
      put_json(text, ",'description':%t}", part->about);
    }
  }
}

static void put_message_schemas(struct text *text, const schema_message *message) {
  begin_object(text, message->name, "_request");
  put_request(text, message, false);
  put_json(text, "},'additionalProperties':false}");
  begin_object(text, message->name, "_reply");
  put_properties(text, message->reply->structures[0]->fields);
  if (message->reply->parts[0].name != NULL) {
    put_json(text, ",'units':{'type':'object','additionalProperties':" STRING "}");
    put_reply_parts(text, message->reply);
  }
  put_json(text, "}}");
}

/* Returns whether a reply has a list of these structures. */
static bool is_listed(const schema_structure *structure) {
  for (const schema_message *one = schema_messages; one->type != 0; one++) {
    for (const schema_part *part = one->reply->parts; part->name != NULL; part++) {
      if (part->structure == structure) {
        return true;
      }
    }
  }
  return false;
}

static void put_schemas(struct text *text) {
  put_json(text,
           ",'Number':{'nullable':true,'description':'A number; infinities are texts. In replies, "
           "null is a number that is not known.','oneOf':[{'type':'number'},"
           "{'type':'string','enum':['inf','-inf']}]},'Medium':{'oneOf':[" STRING "," REFERENCE(
               "Coefficients") ",{'type':'array','items':" REFERENCE("Coefficients") "}]}");
  put_object(text, "Coefficients", FIELDS(medium));
  begin_object(text, "Error", "");
  put_json(text, "'status':" STRING ",'text':" STRING);
  put_properties(text, FIELDS(error) + 1);
  put_json(text, "}}");
  begin_object(text, "Fitted", "");
  put_properties(text, FIELDS(fitted));
  put_list(text, "residuals", NUMBER, "of the readings, if they are wanted");
  put_json(text, "}}");
  begin_object(text, "Gathered", "");
  put_medium(text);
  put_properties(text, FIELDS(quantity_error));
  put_list(text, "M", NUMBER, "W/mm^2; the sums, in the order of the positions");
  put_json(text, "}}");
  put_object(text, "Sought", FIELDS(sought));
  for (int i = 0; i < SCHEMA_STRUCTURES; i++) {
    if (is_listed(&schema_structures[i])) {
      put_object(text, schema_structures[i].name, schema_structures[i].fields);
    }
  }
  begin_object(text, "Channel", "");
  put_medium(text);
  put_json(text, ",'errors':{'type':'object','description':'of each wanted quantity',"
                 "'additionalProperties':" REFERENCE(
                     "quantity_error") "},'albedo':" NUMBER ",'balance':" REFERENCE("balance"));
  for (const core_choice *one = core_quantities; one->name != NULL; one++) {
    if ((one->id & CORE_OF_CHANNEL) == 0) {
      put_list(text, one->name, NUMBER, one->about);
    }
  }
  put_json(text, "}}");
}

void http_openapi_write(struct text *text) {
  put_json(text,
           "{'openapi':'3.0.3','info':{'title':'dipoled','version':'" DIPOLED_VERSION
           "','description':'Evaluates subsurface-scattering profiles R(r). Fields, limits and "
           "errors are those of the binary protocol (PROTOCOL.md).'},'servers':[{'url':'/'}],"
           "'paths':{");
  for (const schema_message *one = schema_messages; one->type != 0; one++) {
    if (one->about != NULL) {
      put_path(text, one);
    }
  }
  put_list_path(text, "/v1/models", "models",
                "Lists models, evaluators, parameters and the other choices, and the limits");
  put_list_path(text, "/v1/media", "media", "Lists the measured media");
  put_list_path(text, "/v1/openapi.json", "openapi", "This document");
  put_list_path(text, "/healthz", "health", "Whether the daemon serves; 503 if not");
  put_list_path(text, "/readyz", "readiness",
                "Whether the daemon serves and has capacity for more clients; 503 if not");
  put_json(text,
           "},'components':{'responses':{'Error':{'description':'400: a field is wrong. 404: the "
           "daemon does not have the set of points: send it to /v1/points. 413: the request or the "
           "reply is too large for HTTP. 429: the daemon is at a limit; Retry-After says when to "
           "try again. 503: the daemon stops, or the deadline has passed.','content':"
           "{'application/json':{'schema':" REFERENCE("Error") "}}}},'schemas':{");
  put_schemas(text);
  for (const schema_message *one = schema_messages; one->type != 0; one++) {
    if (one->about != NULL) {
      put_message_schemas(text, one);
    }
  }
  put_json(text, "}}}");
}

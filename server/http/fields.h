/* fields: the structures of proto/messages.def as data, from which requests and answers in JSON and
 * the OpenAPI document are made, and the requests that HTTP offers. */
#ifndef DIPOLED_HTTP_FIELDS_H
#define DIPOLED_HTTP_FIELDS_H

#include "core/core.h"
#include "proto/wire.h"
#include "server/http/text.h"

enum http_kind { HTTP_u16, HTTP_u32, HTTP_u64, HTTP_f64, HTTP_text };

struct http_field {
  const char *name; /* NULL ends a list of fields */
  enum http_kind kind;
  unsigned count; /* how many values, or bytes of text */
  const char *meaning;

  /* http_fields_init() sets these. */
  struct http_key key;
  size_t bytes;               /* on the wire, of all values */
  const core_choice *choices; /* the list that the field chooses from; NULL if it is a number */
  bool bits;                  /* whether its value is a sum of entries of that list */
  bool internal;    /* whether JSON leaves the field out: it is padding, or counts what is an array
                  * there, or numbers the parts of a reply, which has one part there */
  const char *unit; /* with which its meaning begins; NULL: none */
};

/* The structures: http_fields_of_eval_request and so on. */
#define WIRE_STRUCTURE(name) extern struct http_field http_fields_of_##name[];
#include "proto/messages.def"

/* Completes the structures. Call it once, before anything else of server/http. */
void http_fields_init(void);

/* Returns whether a field is the name of a set of points: in JSON, its bytes as a text of so many
 * hexadecimal digits. */
enum { HTTP_NAME_DIGITS = 32 };
static inline bool http_field_is_name(const struct http_field *field) {
  return field->kind == HTTP_u64 && field->count == 2;
}

/* A list of numbers at the end of a request. */
struct http_list {
  const char *name;  /* NULL: there is none */
  const char *count; /* the field that holds its length */
  const char *rule;  /* the field that says so, with the entry `list`; NULL: there is none */
  const char *meaning;
  enum {
    HTTP_GIVEN, /* the list has to be given, unless it has a rule */
    HTTP_ZEROS, /* without it, all its numbers are 0 */
    HTTP_SETS,  /* a list, or a list of lists: one for each set of readings */
    HTTP_AXIS,  /* a list, or one number for all: coordinates of positions, x, y and z in turn */
    HTTP_EACH,  /* a list, or one number for all; which lists are given is checked elsewhere */
  } kind;
};

enum { HTTP_LISTS = 6, HTTP_STRUCTURES = 2 };

/* A request that HTTP offers: POST and GET /v1/NAME. */
struct http_message {
  enum wire_type type;
  const char *about;
  const struct http_field *request[HTTP_STRUCTURES]; /* NULL: there is one alone */
  const struct http_field *reply;
  unsigned media_most; /* 0: it has no media; 1: it has one; UINT_MAX: any number */
  bool parameters;     /* whether it has parameters */
  unsigned wanted;     /* the quantities that are wanted if the request does not say */
  struct http_list lists[HTTP_LISTS];
};

/* Returns a request's field, which is not internal, or NULL. */
const struct http_field *http_field_of(const struct http_message *message, const char *name);

/* The list of these requests, which ends with type 0. */
extern const struct http_message http_messages[];

#endif

#include "clients/cli/material.h"

#include <errno.h>
#include <expat.h>
#include <jansson.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/profile.h"

enum { FILE_MAX = 1 << 24 };

/* Adds a parameter unless there is no room or the count is not 0, 1 or 3. */
static void add_parameter(cli_material *of, const char *name, size_t count, const double *values) {
  if (of->count < CLI_MATERIAL_MAX && strlen(name) < CLI_MATERIAL_BYTES &&
      (count == 0 || count == 1 || count == 3)) {
    strcpy(of->items[of->count].name, name);
    of->items[of->count].count = count;
    memcpy(of->items[of->count].values, values, count * sizeof *values);
    of->count++;
  }
}

const double *cli_material_find(const cli_material *of, const char *name, size_t *count) {
  for (size_t i = 0; i < of->count; i++) {
    if (strcmp(of->items[i].name, name) == 0) {
      *count = of->items[i].count;
      return of->items[i].values;
    }
  }
  return NULL;
}

/* Reads up to 3 numbers with commas or blanks between them. Returns how many there are; 0 if there is
 * something else before the character `last`. */
static size_t read_numbers(const char *text, char last, double values[3]) {
  size_t count = 0;
  for (text += strspn(text, " ,\n\t"); *text != last; text += strspn(text, " ,\n\t")) {
    char *end;
    const double value = strtod(text, &end);
    if (end == text || count == 3) {
      return 0;
    }
    values[count++] = value;
    text = end;
  }
  return count;
}

void cli_material_add(cli_material *of, const char *name, const char *numbers) {
  double values[3];
  size_t count;
  if (cli_material_find(of, name, &count) == NULL) {
    count = read_numbers(numbers, '\0', values);
    add_parameter(of, name, count, values);
  }
}

/* Returns a whole file as a text; NULL if it cannot be read. */
static char *read_text(const char *file) {
  FILE *from = strcmp(file, "-") == 0 ? stdin : fopen(file, "rbe");
  char *text = cli_allocate(FILE_MAX + 1, 1);
  const size_t bytes = from != NULL ? fread(text, 1, FILE_MAX, from) : 0;
  if (from == NULL || ferror(from) != 0) {
    cli_fail("cannot read %s: %s", file, strerror(errno));
    text = NULL;
  } else if (bytes == 0) {
    cli_fail("%s is empty", file);
    text = NULL;
  } else if (bytes == FILE_MAX || strlen(text) < bytes) {
    cli_fail("%s: it is larger than 16 MiB, or no text", file);
    text = NULL;
  }
  if (from != NULL && from != stdin) {
    fclose(from);
  }
  return text;
}

/* ---- MaterialX ------------------------------------------------------------------------------- */

typedef struct mtlx_reading {
  const char *element;
  cli_material *of;
  bool inside, done; /* whether the element is open, or has been */
} mtlx_reading;

static void on_element(void *context, const XML_Char *name, const XML_Char **attributes) {
  mtlx_reading *reading = context;
  const char *input = NULL, *value = NULL;
  bool srgb = false;
  if (strcmp(name, reading->element) == 0 && !reading->done) {
    reading->inside = true;
  }
  if (!reading->inside || strcmp(name, "input") != 0) {
    return;
  }
  for (size_t i = 0; attributes[i] != NULL; i += 2) {
    input = strcmp(attributes[i], "name") == 0 ? attributes[i + 1] : input;
    value = strcmp(attributes[i], "value") == 0 ? attributes[i + 1] : value;
    srgb = srgb || (strcmp(attributes[i], "colorspace") == 0 &&
                    strcmp(attributes[i + 1], "srgb_texture") == 0);
  }
  if (input != NULL) { /* without a value it is connected to a node */
    double values[3];
    const size_t count = value != NULL ? read_numbers(value, '\0', values) : 0;
    for (size_t i = 0; srgb && i < count; i++) {
      values[i] = cli_srgb_to_linear(values[i]);
    }
    add_parameter(reading->of, input, count, values);
  }
}

static void on_element_end(void *context, const XML_Char *name) {
  mtlx_reading *reading = context;
  if (reading->inside && strcmp(name, reading->element) == 0) {
    reading->inside = false;
    reading->done = true;
  }
}

bool cli_material_read_mtlx(const char *file, const char *element, cli_material *of) {
  mtlx_reading reading = {.element = element, .of = of};
  char *text = read_text(file);
  XML_Parser parser = text != NULL ? XML_ParserCreate(NULL) : NULL;
  if (parser == NULL) {
    return false;
  }
  XML_SetUserData(parser, &reading);
  XML_SetElementHandler(parser, on_element, on_element_end);
  bool good = XML_Parse(parser, text, (int)strlen(text), 1) == XML_STATUS_OK;
  if (!good) {
    cli_fail("%s: line %lu: %s", file, XML_GetCurrentLineNumber(parser),
             XML_ErrorString(XML_GetErrorCode(parser)));
  } else if (!reading.done) {
    cli_fail("%s: it has no element %s, which this --from reads", file, element);
    good = false;
  }
  XML_ParserFree(parser);
  return good;
}

/* ---- glTF ------------------------------------------------------------------------------------ */

bool cli_material_read_gltf(const char *file, const char *extension, cli_material *of) {
  char *text = read_text(file);
  const char *name;
  json_error_t error;
  json_t *root = text != NULL ? json_loads(text, JSON_REJECT_DUPLICATES, &error) : NULL;
  if (root == NULL) {
    if (text != NULL) {
      cli_fail("%s: line %d: %s", file, error.line, error.text);
    }
    return false;
  }
  json_t *materials = json_object_get(root, "materials"), *part, *value;
  json_t *all = json_object_get(root, "extensions");
  for (size_t i = 0; i < json_array_size(materials) && json_object_get(all, extension) == NULL;
       i++) {
    all = json_object_get(json_array_get(materials, i), "extensions");
  }
  if (json_object_get(all, extension) == NULL) {
    cli_fail("%s: no material has the extension %s", file, extension);
    json_decref(root);
    return false;
  }
  const char *part_name;
  json_object_foreach(all, part_name, part) {
    json_object_foreach(part, name, value) {
      double values[3] = {json_number_value(value)};
      for (size_t i = 0; i < 3 && i < json_array_size(value); i++) {
        values[i] = json_number_value(json_array_get(value, i));
      }
      add_parameter(of, name, json_is_number(value) ? 1 : json_array_size(value), values);
    }
  }
  json_decref(root);
  return true;
}

/* ---- pbrt ------------------------------------------------------------------------------------ */

/* Parameters are "type name" and a value or several in brackets. */
bool cli_material_read_pbrt(const char *file, cli_material *of) {
  char *text = read_text(file), *const first = text != NULL ? strstr(text, "\"subsurface\"") : NULL;
  if (text != NULL && first == NULL) {
    cli_fail("%s: it has no material \"subsurface\"", file);
  }
  for (char *at = first; at != NULL && (at = strchr(at, '"')) != NULL;) {
    char *const end = strchr(at + 1, '"'), *name;
    if (end == NULL) {
      break;
    }
    *end = '\0';
    name = strchr(at + 1, ' ');
    at = end + 1;
    const char *value = at + strspn(at, " \n\t");
    double values[3] = {0};
    const bool bracketed = *value == '[';
    const size_t count = bracketed ? read_numbers(value + 1, ']', values) : 1;
    if (name != NULL && (bracketed || strspn(value, "+-.0123456789") > 0)) {
      values[0] = bracketed ? values[0] : strtod(value, NULL);
      add_parameter(of, name + 1, count, values);
    }
  }
  return first != NULL;
}
